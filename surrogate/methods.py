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

MOST_INTERACTION = 200  # full wrenches that tell what the axes miss: one quick factor

MOST = 6000  # rows composed for this: three times what one axis leaves out


class AxesErrors(NamedTuple):
    """Errors (k, 6), m and rad, of two methods at k rows."""

    griddata: Floats
    additive: Floats


def axes_errors(rows: Rows, axes: Axes) -> AxesErrors:
    """Return the errors at the rows that each axis they belong to was triangulated without.

    Composition is linear in what the axes answer: an answer without a row differs from that with
    it by what its axes then miss at it. A full wrench that is no axis' own is in no answer anyway.
    """
    deviation, used, left = np.zeros((3, len(rows), 6)), *np.zeros((2, 3, len(rows)), dtype=bool)
    for index, table in enumerate(axes.tables):
        if table is not None:
            _put_deviations(table, deviation[index], used[index], left[index])
    known = np.flatnonzero((left | ~used).all(axis=0))
    if len(known) > MOST:
        known = known[np.linspace(0, len(known) - 1, MOST).astype(np.intp)]
    some, deviation, used = rows.take(known), deviation[:, known], used[:, known]
    composed = axes.evaluate(some.wrench)
    clean = np.zeros(len(rows), dtype=bool)
    for table in axes.tables:
        if table is not None:
            clean[[group[0] for group in table.rows.members]] |= table.rows.single_axis
    # A moment alone belongs to two axes, and both answer it once together.
    often = np.where(clean[known], 1.0 / np.maximum(used.sum(axis=0), 1), 1.0)
    additive = composed.additive - some.displacement + often[:, None] * deviation.sum(axis=0)
    griddata = additive.copy()
    for index, axis in enumerate(AXES):
        own = axis.outputs[0]
        griddata[:, own] = composed.griddata[:, own] - some.displacement[:, own]
        griddata[:, own] += deviation[index, :, own]
    return AxesErrors(griddata, additive)


def _put_deviations(
    table: AxisTable, deviation: Floats, used: NDArray[np.bool_], left: NDArray[np.bool_]
) -> None:
    """Fill, of all rows, what an axis misses them by, (n, 6), and which are its points, (n,)."""
    used[list(chain.from_iterable(table.rows.members))] = True
    if table.others is not None:  # they are no points of the axis: its answers miss them anyway
        return
    groups = [table.rows.members[place] for place in table.left_out.places.tolist()]
    rows = list(chain.from_iterable(groups))
    deviation[rows] = np.repeat(table.left_out.errors, [len(group) for group in groups], axis=0)
    left[rows] = True


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
    """Return how many full wrenches must show what loads of several axes do together.

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
    kink, and at other wrenches the kriging still was 5 to 30 % nearer to the truth.

    Parameters
    ----------
    axes, kriging
        Make the interpolators; the kriging is None if the rows allow none.
    linear : bool
        Whether the component is linear.
    too_large : str
        Why one factor does not hold the rows; empty if it does.
    """
    has_axes = load_range.space.is_default
    if not len(rows):
        return MethodChoice("griddata" if has_axes else "linear", "there are no rows", {})
    if linear and fit.complete:
        return MethodChoice("linear", "the component is linear: its compliance is exact", {})
    solved = bool(np.isfinite(rows.compliance).all())
    made = kriging() if solved or not has_axes else None
    if not has_axes and made is None:
        reason = "there are too few rows for kriging: the compliance that fits them answers"
        return MethodChoice("linear", reason, {})
    if made is not None and (made.knows_errors or not has_axes):
        size = np.where(made.scaling.constant, 0.0, np.ptp(rows.displacement, axis=0))
        error = _score(made.left_out(), size)
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
    made = kriging() if not too_large and (pushes or not unknown) else None
    if unknown and not (made and made.knows_errors):
        return MethodChoice(method, f"{INTERACTION_UNKNOWN}; {why}", of_axes)
    if too_large:
        return MethodChoice(method, f"{too_large}: kriging does not answer; {why}", of_axes)
    if made is None:
        return MethodChoice(method, f"there are too few rows for kriging; {why}", {})
    size = np.where(made.scaling.constant, 0.0, np.ptp(rows.displacement, axis=0))
    of_axes, error = _scores(errors, size), _score(made.left_out(), size)
    if np.isnan(error):
        return MethodChoice(method, f"kriging answers no row that is left out; {why}", of_axes)
    scores = {"kriging": error} | of_axes
    if not of_axes or len(rows) <= 1 + rows.wrench.shape[1]:
        # The axes' fitted compliance passes through so few rows, the left-out one too.
        return MethodChoice("kriging", "the axes have too few rows to leave one out", scores)
    if made.knows_errors and not all(table is None or table.law.known for table in axes.tables):
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

    `griddata` takes a translation from its own axis alone. What that leaves out, the rows of the
    other axes show: it must be within the error bars that the axis has anyway.
    """
    clean = single_axis_rows(rows, load_range)
    size = float(np.abs(rows.displacement[:, :3]).max(initial=0.0))
    shown = False
    for index, (axis, table) in enumerate(zip(AXES, axes.tables, strict=True)):
        others, own = clean.any(axis=1) & ~clean[:, index], axis.outputs[0]
        if not others.any():
            continue
        shown = True
        most = float(np.quantile(_left_out_by(axis, rows.take(others), axes), LEFT_OUT))
        typical = np.nan if table is None else float(table.typical_error[own])
        if most > ROUNDING * size and not most <= typical:
            loads = ", ".join(LOADS[load] for load in axis.others)
            return "additive", (
                f"{loads} move {OUTPUTS[own]} by up to {most:.2g} m, and its error bars by "
                f"{', '.join(LOADS[load] for load in axis.inputs)} are {typical:.2g} m"
            )
    scores = _scores(errors, np.ptp(rows.displacement, axis=0))
    if not shown and scores and scores["additive"] < scores["griddata"]:
        return "additive", "at left-out rows all axes together err less than each by itself"
    return "griddata", "what loads of other axes move a translation by is within its error bars"


def _left_out_by(axis: LoadAxis, rows: Rows, axes: Axes) -> Floats:
    """Return how far rows of other axes, (k,), move an axis' translation beyond its error bar, m.

    By other loads than those that such a row shares with the axis: one moment, or none.
    """
    own = axis.outputs[0]
    shared = np.where(np.isin(np.arange(6), axis.inputs), rows.wrench, 0.0)
    alone = axes.evaluate(shared)
    moved = np.abs(rows.displacement[:, own] - alone.griddata[:, own])
    return np.maximum(moved - np.nan_to_num(alone.rest[:, own]), 0.0)


def _scores(errors: AxesErrors, size: Floats) -> dict[str, float]:
    """Return both methods' `_score`; none if no row could be left out."""
    known = len(errors.additive) > 0
    return {name: _score(one, size) for name, one in errors._asdict().items()} if known else {}


def _score(errors: Floats, size: Floats) -> float:
    """Return the root mean square of errors (k, 6) over the outputs' ranges (6,).

    Of the outputs that vary: what a range of rounding, or none, is missed by says nothing. NaN
    where no error is known.
    """
    known, varying = np.isfinite(errors).any(axis=1), size > 0
    if not varying.any():
        return 0.0
    if not np.isfinite(errors[:, varying]).any():
        return float("nan")
    return float(np.sqrt(np.nanmean((errors[known][:, varying] / size[varying]) ** 2)))


def interaction_of(rows: Rows, load_range: LoadRange, axes: Axes) -> Kriging | None:
    """Return the kriging of what `additive` misses the full wrenches by that no axis has.

    None where such wrenches are too few, or contradict each other.
    """
    full = np.flatnonzero(~single_axis_rows(rows, load_range).any(axis=1))
    tables = [table for table in axes.tables if table is not None]
    taken = [place for table in tables for group in table.rows.members for place in group]
    free = np.setdiff1d(full, taken)
    if len(free) < ENOUGH_FULL:
        return None
    some = rows.take(free[:MOST_INTERACTION])
    missed = some.displacement - axes.evaluate(some.wrench).additive
    blank = np.full_like(some.compliance, np.nan)
    try:
        return Kriging.build(replace(some, displacement=missed, compliance=blank), load_range)
    except (TooFewRowsError, SingularCovarianceError):
        return None
