"""The default method of a table, chosen by errors at rows left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .axes.axes import Axes
from .axes.axis_table import AxisTable
from .kriging import Kriging, SingularCovarianceError, TooFewRowsError
from .table.axes import AXES, LoadAxis, count_multi_axis, single_axis_rows
from .table.compliance import ComplianceFit
from .table.rows import ROUNDING, Floats, LoadRange, Rows
from .table.space import LOADS, OUTPUTS

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


class AxesErrors(NamedTuple):
    """Errors (k, 6), m and rad, of two methods at k rows."""

    griddata: Floats
    additive: Floats


def axes_errors(rows: Rows, axes: Axes) -> AxesErrors:
    """Return the errors at the rows that were left out of all their axes.

    Composition is linear in the answers of the axes: an answer without a row differs from that with
    it by the errors of its axes there. A full wrench that belongs to no axis is in no answer
    anyway.
    """
    deviation, used, left_out = (
        np.zeros((3, len(rows), 6)),
        *np.zeros((2, 3, len(rows)), dtype=bool),
    )
    for index, table in enumerate(axes.tables):
        if table is not None:
            _put_deviations(table, deviation[index], used[index], left_out[index])
    known = np.flatnonzero((left_out | ~used).all(axis=0))
    if len(known) > MAX_COMPOSED:
        known = known[np.linspace(0, len(known) - 1, MAX_COMPOSED).astype(np.intp)]
    compared, deviation, used = rows.take(known), deviation[:, known], used[:, known]
    composed = axes.evaluate(compared.wrench)
    clean = np.zeros(len(rows), dtype=bool)
    for table in axes.tables:
        if table is not None:
            clean[[group[0] for group in table.rows.members]] |= table.rows.single_axis
    # A moment alone belongs to two axes, each of which counts half.
    fraction = np.where(clean[known], 1.0 / np.maximum(used.sum(axis=0), 1), 1.0)
    additive = composed.additive - compared.displacement + fraction[:, None] * deviation.sum(axis=0)
    griddata = additive.copy()
    for index, axis in enumerate(AXES):
        output = axis.outputs[0]
        griddata[:, output] = composed.griddata[:, output] - compared.displacement[:, output]
        griddata[:, output] += deviation[index, :, output]
    return AxesErrors(griddata, additive)


def _put_deviations(
    table: AxisTable, deviation: Floats, used: NDArray[np.bool_], left_out: NDArray[np.bool_]
) -> None:
    """Fill in an axis' errors at its left-out rows, (n, 6), and which rows are its points, (n,)."""
    used[list(chain.from_iterable(table.rows.members))] = True
    if table.others is not None:  # left out of the triangulation already: answers have their errors
        return
    groups = [table.rows.members[point] for point in table.left_out.indices.tolist()]
    rows = list(chain.from_iterable(groups))
    deviation[rows] = np.repeat(table.left_out.errors, [len(group) for group in groups], axis=0)
    left_out[rows] = True


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
    axes: Callable[[], Axes],
    kriging: Callable[[], Kriging | None],
    *,
    linear: bool = False,
    too_large: str = "",
) -> MethodChoice:
    """Return the default of rows inside the load range, by the first rule that holds.

    Solves with tangents are answered by a kriging that knows its errors: on 320 tables of nine
    made-up responses the axes had the smaller error at left-out rows in six, of single loads over a
    kink, and at other wrenches the kriging was 5 to 30 % nearer to the truth even there.

    Parameters
    ----------
    axes, kriging
        Make the interpolators; the kriging is None if the rows allow none.
    linear : bool
        Whether the component is linear.
    too_large : str
        Why a factor does not hold the rows; empty if it does.
    """
    has_axes = load_range.space.is_default
    if not len(rows):
        return MethodChoice("griddata" if has_axes else "linear", "there are no rows", {})
    if linear and fit.complete:
        return MethodChoice("linear", "the component is linear: its compliance is exact", {})
    solved = bool(np.isfinite(rows.compliance).all())
    interpolator = kriging() if solved or not has_axes else None
    if not has_axes and interpolator is None:
        reason = "there are too few rows for kriging: the compliance that fits them answers"
        return MethodChoice("linear", reason, {})
    if interpolator is not None and (interpolator.knows_errors or not has_axes):
        size = np.where(interpolator.scaling.constant, 0.0, np.ptp(rows.displacement, axis=0))
        error = _score(interpolator.left_out(), size)
        scores = {} if np.isnan(error) else {"kriging": error}
        if not has_axes:
            reason = "griddata and additive are of one interface alone"
            return MethodChoice("kriging", reason, scores)
        if scores:
            reason = f"all rows bring tangents, and its error at left-out rows is {error:.2g} of "
            return MethodChoice("kriging", f"{reason}the range", scores)
    return _choose_by_errors(rows, load_range, axes(), kriging, linear, too_large)


def _choose_by_errors(
    rows: Rows,
    load_range: LoadRange,
    axes: Axes,
    kriging: Callable[[], Kriging | None],
    linear: bool,
    too_large: str,
) -> MethodChoice:
    """Return the method whose errors at left-out rows are the least, if the rows show them."""
    errors = axes_errors(rows, axes)
    method, why = _of_the_axes(rows, load_range, axes, errors)
    if linear:
        reason = "the component is linear, but its compliance is not known in all loads yet"
        return MethodChoice(method, f"{reason}; {why}", {})
    of_axes = _scores(errors, np.ptp(rows.displacement, axis=0))
    needed = full_needed(rows)
    unknown = needed == ENOUGH_FULL and count_multi_axis(rows, load_range) < needed
    # Pushes beside a point have loads of one axis alone, and no moment alone for the other axes.
    clean = single_axis_rows(rows, load_range)
    moments_alone = bool((clean.sum(axis=1) == 2).any())
    pushes = clean.all(axis=0).any() and rows.wrench[:, 3:].any() and not moments_alone
    interpolator = kriging() if not too_large and (pushes or not unknown) else None
    if unknown and not (interpolator and interpolator.knows_errors):
        return MethodChoice(method, f"{INTERACTION_UNKNOWN}; {why}", of_axes)
    if too_large:
        return MethodChoice(method, f"{too_large}: kriging does not answer; {why}", of_axes)
    if interpolator is None:
        return MethodChoice(method, f"there are too few rows for kriging; {why}", {})
    size = np.where(interpolator.scaling.constant, 0.0, np.ptp(rows.displacement, axis=0))
    of_axes, error = _scores(errors, size), _score(interpolator.left_out(), size)
    if np.isnan(error):
        return MethodChoice(method, f"kriging answers no row that is left out; {why}", of_axes)
    scores = {"kriging": error} | of_axes
    if not of_axes or len(rows) <= 1 + rows.wrench.shape[1]:
        # The axes' fitted compliance passes through so few rows, the left-out one too.
        return MethodChoice("kriging", "the axes have too few rows to leave one out", scores)
    if interpolator.knows_errors and not all(
        table is None or table.law.known for table in axes.tables
    ):
        reason = "the axes have too few rows to tell the error of answers"
        return MethodChoice("kriging", reason, scores)
    best = min(of_axes, key=lambda name: of_axes[name])
    compared = f"{error:.2g} of the range against {best}'s {of_axes[best]:.2g}"
    if not error < max(CLEARLY * of_axes[best], EXACT):
        return MethodChoice(method, f"kriging errs at left-out rows by {compared}; {why}", scores)
    return MethodChoice("kriging", f"its error at left-out rows is {compared}", scores)


def _of_the_axes(
    rows: Rows, load_range: LoadRange, axes: Axes, errors: AxesErrors
) -> tuple[str, str]:
    """Return `griddata` or `additive`, and why.

    `griddata` takes a translation from its axis alone. The rows of the other axes show the
    neglected part: it must be within the error bars of the axis.
    """
    clean = single_axis_rows(rows, load_range)
    size = float(np.abs(rows.displacement[:, :3]).max(initial=0.0))
    rows_elsewhere = False
    for index, (axis, table) in enumerate(zip(AXES, axes.tables, strict=True)):
        others, output = clean.any(axis=1) & ~clean[:, index], axis.outputs[0]
        if not others.any():
            continue
        rows_elsewhere = True
        influence = float(np.quantile(_left_out_by(axis, rows.take(others), axes), LEFT_OUT))
        typical = np.nan if table is None else float(table.typical_error[output])
        if influence > ROUNDING * size and not influence <= typical:
            loads = ", ".join(LOADS[load] for load in axis.others)
            return "additive", (
                f"{loads} move {OUTPUTS[output]} by up to {influence:.2g} m, and its error bars by "
                f"{', '.join(LOADS[load] for load in axis.inputs)} are {typical:.2g} m"
            )
    scores = _scores(errors, np.ptp(rows.displacement, axis=0))
    if not rows_elsewhere and scores and scores["additive"] < scores["griddata"]:
        return "additive", "at left-out rows all axes together err less than each by itself"
    return "griddata", "what loads of other axes move a translation by is within its error bars"


def _left_out_by(axis: LoadAxis, rows: Rows, axes: Axes) -> Floats:
    """Return by how much rows of other axes, (k,), move a translation beyond its error bar, m.

    By loads that such a row does not have in common with the axis.
    """
    output = axis.outputs[0]
    shared = np.where(np.isin(np.arange(6), axis.inputs), rows.wrench, 0.0)
    alone = axes.evaluate(shared)
    difference = np.abs(rows.displacement[:, output] - alone.griddata[:, output])
    return np.maximum(difference - np.nan_to_num(alone.error[:, output]), 0.0)


def _scores(errors: AxesErrors, size: Floats) -> dict[str, float]:
    """Return both methods' `_score`; none if no row could be left out."""
    known = len(errors.additive) > 0
    return (
        {name: _score(method_errors, size) for name, method_errors in errors._asdict().items()}
        if known
        else {}
    )


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
