"""The default method of a table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .kriging import Kriging
from .table.compliance import ComplianceFit
from .table.rows import Floats, LoadRange, Rows


@dataclass(frozen=True)
class MethodChoice:
    """The default method of a table."""

    method: str
    reason: str
    # Root mean square error at rows left out, over the outputs' ranges, dimensionless, for each
    # method; only outputs that vary count. Empty where no methods were compared.
    errors: dict[str, float]


def choose(
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    kriging: Callable[[], Kriging | None],
    *,
    linear: bool = False,
) -> MethodChoice:
    """Return the default method for rows inside the load range, by the first rule that holds.

    The compliance of a linear component is exact. A kriging answers wherever the rows allow one: on
    single-axis rows of nine synthetic responses, measured or solved, its errors are three to ten
    times smaller than those of the axes. Otherwise the axes answer, from all rows that have the
    other outputs, without an error bar.

    `kriging`: makes the interpolator, or returns None if the rows allow none.
    """
    has_axes = load_range.space.is_default
    if not len(rows):
        reason = "the table has no rows: fill it, or import measured ones"
        return MethodChoice("additive" if has_axes else "linear", reason, {})
    if linear and fit.complete:
        return MethodChoice("linear", "the component is linear: one compliance answers all", {})
    interpolator = kriging()
    if interpolator is not None:
        # fmax and fmin skip the empty cells of measured rows.
        width = np.fmax.reduce(rows.displacement) - np.fmin.reduce(rows.displacement)
        size = np.where(interpolator.scaling.constant, 0.0, width)
        error = _score(interpolator.left_out(), size)
        if np.isnan(error):
            reason = "too few rows to show its error at left-out rows; solve or import more"
            return MethodChoice("kriging", reason, {})
        reason = f"predicts left-out rows within {100 * error:.2g} % of the range"
        return MethodChoice("kriging", reason, {"kriging": error})
    if not has_axes:
        reason = "too few rows for kriging: a fitted compliance answers; solve or import more rows"
        return MethodChoice("linear", reason, {})
    if linear:
        reason = "the component is linear, but not all loads have rows: fill the table"
    else:
        reason = (
            "rows are too few for kriging or contradict each other: those of single axes answer, "
            "without error bars; solve or import more, and withdraw wrong ones"
        )
    return MethodChoice("additive", reason, {})


def _score(errors: Floats, size: Floats) -> float:
    """Return the root mean square of errors (k, 6) over the outputs' ranges (6,).

    Only outputs that vary count: an error over a range of zero or of rounding has no meaning. The
    score is NaN where no error is known.
    """
    known = np.isfinite(errors).any(axis=1)
    varying = size > 0
    if not varying.any():
        return 0.0
    if not np.isfinite(errors[:, varying]).any():
        return float("nan")
    return float(np.sqrt(np.nanmean((errors[known][:, varying] / size[varying]) ** 2)))
