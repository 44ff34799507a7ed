"""Which method answers where nobody asks for one, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..composition.composition import Composition
from ..kriging import Kriging
from ..table.axes import clean_rows
from ..table.rows import Floats, LoadRange, Rows

CLEARLY = 0.8  # of griddata's error: a kriging that is no better than that is not worth its cost
ENOUGH_FULL = 20  # full wrenches that show what loads of several axes do together: measured on
# `plate_thin`, with fewer and no tangents 3 to 26 % of the errors lie inside the bars (DESIGN 3)
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
        empty where none were compared.
    """

    method: str
    reason: str
    errors: dict[str, float]


def knows_interaction(rows: Rows, load_range: LoadRange) -> bool:
    """Return whether rows show what loads of several axes do together.

    Full wrenches do, and so do rows with a tangent: twenty of either, or tangents in half the rows
    of a smaller table.
    """
    tangents = int(np.isfinite(rows.compliance).all(axis=(1, 2)).sum())
    full = int((~clean_rows(rows, load_range).any(axis=1)).sum())
    return full >= ENOUGH_FULL or tangents >= min(ENOUGH_FULL, max(len(rows) / 2, 1))


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
    if not knows_interaction(rows, load_range):
        reason = f"no tangents and fewer than {ENOUGH_FULL} full wrenches: kriging would not know"
        return Choice("griddata", f"{reason} what loads of several axes do together", {})
    if not kriging.is_dense:
        reason = "kriging by nearest rows takes milliseconds an answer; ask for it by name"
        return Choice("griddata", f"{kriging.detail}: {reason}", {})
    size = np.maximum(np.ptp(rows.displacement, axis=0), np.finfo(float).tiny)
    errors, _ = kriging.left_out()
    ours = _score(errors, size)
    theirs = _score(_griddata_errors(rows, compose), size)
    scores = {"kriging": ours, "griddata": theirs}
    told = f"{ours:.2g} of the range against griddata's {theirs:.2g}"
    if not ours < CLEARLY * theirs:
        return Choice("griddata", f"kriging errs at left-out rows by {told}", scores)
    return Choice("kriging", f"its error at left-out rows is {told}", scores)


def _griddata_errors(rows: Rows, compose: Callable[[Rows], Composition]) -> Floats:
    """Return griddata's errors (k, 6), m and rad, at rows it was not made from."""
    errors = []
    for fold in range(FOLDS):
        left = np.arange(fold, len(rows), FOLDS)
        rest = compose(rows.take(np.setdiff1d(np.arange(len(rows)), left)))
        errors.append(rows.displacement[left] - rest.evaluate(rows.wrench[left]).displacement)
    return np.concatenate(errors)


def _score(errors: Floats, size: Floats) -> float:
    """Return the root mean square of errors (k, 6) over the outputs' ranges (6,)."""
    known = np.isfinite(errors).any(axis=1)
    return float(np.sqrt(np.nanmean((errors[known] / size) ** 2)))
