"""Which method answers where nobody asks for one, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..composition.composition import Composition
from ..kriging import Kriging
from ..table.axes import clean_rows
from ..table.compliance import ComplianceFit
from ..table.rows import Floats, LoadRange, Rows

CLEARLY = 0.8  # of griddata's error: a kriging that is no better than that is not worth its cost
ENOUGH_FULL = 20  # full wrenches that show what loads of several axes do together: measured on
# `plate_thin`, with fewer and no tangents 3 to 26 % of the errors lie inside the bars (DESIGN 3)
# With tangents, which bend across axes where loads act together, so many hold 86 to 100 % of the
# errors on five made-up responses; without any, from clean rows alone, 22 to 100 % (a product of
# three forces is zero, and so are its slopes, wherever one axis is loaded).
ENOUGH_WITH_TANGENTS = 4
NOT_TOLD = (
    f"no tangents and fewer than {ENOUGH_FULL} full wrenches: kriging would not know what loads of "
    "several axes do together"
)
FOLDS = 4  # griddata predicts a quarter of the rows from the others: as many as it can be made from


@dataclass(frozen=True)
class Choice:
    """The default method of a table.

    Attributes
    ----------
    method : str
    reason : str
    errors : dict of str to float
        Root mean square at rows left out, over the outputs' ranges, dimensionless, by method;
        of the outputs that vary; empty where none were compared.
    """

    method: str
    reason: str
    errors: dict[str, float]


def full_needed(rows: Rows) -> int:
    """Return how many full wrenches must show what loads of several axes do together.

    Fewer where rows bring tangents: twenty of them, or half the rows of a smaller table.
    """
    tangents = int(np.isfinite(rows.compliance).all(axis=(1, 2)).sum())
    told = tangents >= min(ENOUGH_FULL, max(len(rows) / 2, 1))
    return ENOUGH_WITH_TANGENTS if told else ENOUGH_FULL


def knows_interaction(rows: Rows, load_range: LoadRange) -> bool:
    """Return whether enough rows are full wrenches to show what loads of several axes do."""
    full = int((~clean_rows(rows, load_range).any(axis=1)).sum())
    return full >= full_needed(rows)


def linear_choice(fit: ComplianceFit) -> Choice:
    """Return the default of a linear component, by what of its compliance is known."""
    if fit.complete:
        return Choice("linear", "the component is linear: its compliance is exact", {})
    reason = "the component is linear, but its compliance is not known in all loads yet"
    return Choice("griddata", reason, {})


def choose(
    rows: Rows,
    load_range: LoadRange,
    kriging: Kriging | None,
    compose: Callable[[Rows], Composition],
) -> Choice:
    """Return the default of a nonlinear component's rows inside the load range.

    Parameters
    ----------
    compose
        Makes a composition of some of the rows.
    """
    if kriging is None:
        return Choice("griddata", "there are too few rows for kriging", {})
    if _interaction_untold(rows, load_range):
        return Choice("griddata", NOT_TOLD, {})
    errors = kriging.left_out()
    size = np.where(kriging.scaling.silent, 0.0, np.ptp(rows.displacement, axis=0))
    ours = _score(errors, size)
    theirs = _score(_griddata_errors(rows, compose), size)
    scores = {"kriging": ours, "griddata": theirs}
    told = f"{ours:.2g} of the range against griddata's {theirs:.2g}"
    if not ours < CLEARLY * theirs:
        return Choice("griddata", f"kriging errs at left-out rows by {told}", scores)
    return Choice("kriging", f"its error at left-out rows is {told}", scores)


def without_kriging(rows: Rows, load_range: LoadRange, detail: str) -> Choice:
    """Return the default of rows that one factor does not hold.

    Parameters
    ----------
    detail : str
        How the kriging that answers on request does.
    """
    if _interaction_untold(rows, load_range):
        return Choice("griddata", NOT_TOLD, {})
    reason = "kriging by nearest rows takes milliseconds an answer; ask for it by name"
    return Choice("griddata", f"{detail}: {reason}", {})


def _interaction_untold(rows: Rows, load_range: LoadRange) -> bool:
    """Return whether neither tangents nor full wrenches tell what loads do together."""
    return full_needed(rows) == ENOUGH_FULL and not knows_interaction(rows, load_range)


def _griddata_errors(rows: Rows, compose: Callable[[Rows], Composition]) -> Floats:
    """Return griddata's errors (k, 6), m and rad, at rows it was not made from."""
    errors = []
    for fold in range(FOLDS):
        left = np.arange(fold, len(rows), FOLDS)
        rest = compose(rows.take(np.setdiff1d(np.arange(len(rows)), left)))
        errors.append(rows.displacement[left] - rest.evaluate(rows.wrench[left]).displacement)
    return np.concatenate(errors)


def _score(errors: Floats, size: Floats) -> float:
    """Return the root mean square of errors (k, 6) over the outputs' ranges (6,).

    Of the outputs that vary: what a range of rounding, or none, is missed by says nothing.
    """
    known, varying = np.isfinite(errors).any(axis=1), size > 0
    if not (known.any() and varying.any()):
        return 0.0
    return float(np.sqrt(np.nanmean((errors[known][:, varying] / size[varying]) ** 2)))
