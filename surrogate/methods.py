"""The default method of a table, chosen by errors at rows left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .axes.axes import Axes
from .kriging import Kriging, SingularCovarianceError, TooFewRowsError
from .table.axes import single_axis_rows
from .table.compliance import ComplianceFit
from .table.rows import Floats, LoadRange, Rows

CLEARLY = 0.8  # of the axes' error: a kriging that is no better than that is not worth its cost
EXACT = 1e-9  # of the range: a kriging that errs by rounding alone needs no smaller error
ENOUGH_FULL = 20  # full wrenches that show what loads of several axes do together: measured on
# `plate_thin`, with fewer and no tangents 3 to 26 % of the errors lie inside the bars (DESIGN 3)
# With tangents, which bend across axes where loads act together, so many hold 86 to 100 % of the
# errors on five made-up responses; without any, from clean rows alone, 22 to 100 % (a product of
# three forces is zero, and so are its slopes, wherever one axis is loaded).
ENOUGH_WITH_TANGENTS = 4
INTERACTION_UNKNOWN = (
    f"no tangents and fewer than {ENOUGH_FULL} full wrenches: kriging would not know what loads of "
    "several axes do together"
)
LEFT_OUT = 0.95  # quantile of what griddata leaves out: as its error bars hold

MAX_INTERACTION = 200  # full wrenches of the interaction: the factor is quick

MAX_COMPOSED = 6000  # rows composed for this: three times the left-out points of an axis


@dataclass(frozen=True)
class MethodChoice:
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
    """Return the number of full wrenches that show the interaction of several axes.

    Fewer where rows bring tangents: twenty of them, or half the rows of a smaller table.
    """
    tangents = int(np.isfinite(rows.compliance).all(axis=(1, 2)).sum())
    enough = tangents >= min(ENOUGH_FULL, max(len(rows) / 2, 1))
    return ENOUGH_WITH_TANGENTS if enough else ENOUGH_FULL


def choose(
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    kriging: Callable[[], Kriging | None],
    *,
    linear: bool = False,
    too_large: str = "",
) -> MethodChoice:
    """Return the default of rows inside the load range, by the first rule that holds.

    The compliance of a linear component is exact. A kriging that knows its errors is nearer to the
    truth than the axes: on 320 tables of nine made-up responses it was worse at left-out rows in
    six, of single loads over a kink, and better between rows even there. Else the axes answer,
    with all that their rows show of the other outputs.

    Parameters
    ----------
    kriging
        Makes the interpolator, or None if the rows allow none.
    linear : bool
        Whether the component is linear.
    too_large : str
        Why a factor does not hold the rows; empty if it does.
    """
    has_axes = load_range.space.is_default
    if not len(rows):
        return MethodChoice("additive" if has_axes else "linear", "there are no rows", {})
    if linear and fit.complete:
        return MethodChoice("linear", "the component is linear: its compliance is exact", {})
    interpolator = kriging()
    if interpolator is not None and (interpolator.knows_errors or not has_axes):
        size = np.where(interpolator.scaling.constant, 0.0, np.ptp(rows.displacement, axis=0))
        error = _score(interpolator.left_out(), size)
        if not np.isnan(error):
            reason = f"its error at left-out rows is {error:.2g} of the range"
            return MethodChoice("kriging", reason, {"kriging": error})
        if not has_axes:
            return MethodChoice("kriging", "griddata and additive are of one interface alone", {})
    if not has_axes:
        reason = "there are too few rows for kriging: the compliance that fits them answers"
        return MethodChoice("linear", reason, {})
    if linear:
        reason = "the component is linear, but its compliance is not known in all loads yet"
        return MethodChoice("additive", reason, {})
    if interpolator is None:
        reason = too_large or "there are too few rows for kriging, or they contradict each other"
        return MethodChoice("additive", reason, {})
    return MethodChoice("additive", "the rows do not show how large errors of kriging are", {})


def _score(errors: Floats, size: Floats) -> float:
    """Return the root mean square of errors (k, 6) over the outputs' ranges (6,).

    Of the outputs that vary: an error over a range of rounding, or none, has no meaning. NaN
    where no error is known.
    """
    known, varying = np.isfinite(errors).any(axis=1), size > 0
    if not varying.any():
        return 0.0
    if not np.isfinite(errors[:, varying]).any():
        return float("nan")
    return float(np.sqrt(np.nanmean((errors[known][:, varying] / size[varying]) ** 2)))


def interaction_of(rows: Rows, load_range: LoadRange, axes: Axes) -> Kriging | None:
    """Return the kriging of `additive`'s residuals at full wrenches that no axis has.

    None where such wrenches are too few, or contradict each other.
    """
    full = np.flatnonzero(~single_axis_rows(rows, load_range).any(axis=1))
    tables = [table for table in axes.tables if table is not None]
    taken = [row for table in tables for group in table.rows.members for row in group]
    free = np.setdiff1d(full, taken)
    if len(free) < ENOUGH_FULL:
        return None
    fitted = rows.take(free[:MAX_INTERACTION])
    residual = fitted.displacement - axes.evaluate(fitted.wrench).additive
    blank = np.full_like(fitted.compliance, np.nan)
    try:
        return Kriging.build(replace(fitted, displacement=residual, compliance=blank), load_range)
    except (TooFewRowsError, SingularCovarianceError):
        return None
