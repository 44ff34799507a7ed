"""Which method answers where nobody asks for one, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from surrogate.composition.composition import Composition
from surrogate.kriging import Kriging
from surrogate.table.axes import clean_rows
from surrogate.table.rows import Floats, LoadRange, Rows

CLEARLY = 0.8  # of griddata's error: a kriging that is no better than that is not worth its cost
ENOUGH_FULL = 20  # full wrenches that show what loads of several axes do together: measured on
# `plate_thin`, with fewer and no tangents 3 to 26 % of the errors lie inside the bars (DESIGN 3)
FOLDS = 4  # griddata predicts a quarter of the rows from the others: as many as it can be made from
MOST_SCORED = 3000  # rows of tables that are triangulated again to score griddata
REGROWN = 1.25  # a choice holds until the table has grown by a quarter, as hyperparameters do


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
    rows : int
        Of the table when the choice was made.
    """

    method: str
    reason: str
    errors: dict[str, float]
    rows: int


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
    count = len(rows)
    if kriging is None:
        return Choice("griddata", "there are too few rows for kriging", {}, count)
    if not knows_interaction(rows, load_range):
        reason = f"no tangents and fewer than {ENOUGH_FULL} full wrenches: kriging would not know"
        return Choice("griddata", f"{reason} what loads of several axes do together", {}, count)
    size = np.maximum(np.ptp(rows.displacement, axis=0), np.finfo(float).tiny)
    errors, _ = kriging.left_out()
    ours = _score(errors, size)
    theirs = _score(_griddata_errors(rows, load_range, compose), size)
    scores = {"kriging": ours, "griddata": theirs}
    told = f"{ours:.2g} of the range against griddata's {theirs:.2g}"
    if not ours < CLEARLY * theirs:
        return Choice("griddata", f"kriging errs at left-out rows by {told}", scores, count)
    return Choice("kriging", f"its error at left-out rows is {told}", scores, count)


def _griddata_errors(
    rows: Rows, load_range: LoadRange, compose: Callable[[Rows], Composition]
) -> Floats:
    """Return griddata's errors (k, 6), m and rad, at rows it was not made from.

    Of a large table that is full wrenches only, which clean rows predict without them, or, where
    there are none, a quarter of the rows.
    """
    if len(rows) > MOST_SCORED:
        full = np.flatnonzero(~clean_rows(rows, load_range).any(axis=1))
        left = full if len(full) else np.arange(0, len(rows), FOLDS)
        rest = compose(rows.take(np.setdiff1d(np.arange(len(rows)), left)))
        return rows.displacement[left] - rest.evaluate(rows.wrench[left]).displacement
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
