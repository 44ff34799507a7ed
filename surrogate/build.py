"""A version of a table: the interpolators of its rows, which are then packed.

Rows may lack outputs, such as those of a test rig that measured only u_z. Outputs that the same
rows have make one group with the interpolators of just those rows, so no NaN enters one.

Where a table does not cover a wrench, a row within 1e-6 of the load range of it answers. Rows as
near to each other are merged (`table.merging`), so a wrench as near to a row is the row's: a queue
rounds wrenches so, and a load that comes to rest is a rounding error off the solved wrench. The
row's tangent leads from its wrench to that of the query. The error bar is the row's uncertainty,
and grows by that step. A row without a tangent answers with its own displacement; its error bar
grows by twice the step of a proportional response. That response is the steeper of two: the range
of each output over the load range, and the row's displacement (the largest translation or rotation,
since a small load may move most) over its wrench.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import thread_time
from typing import Any

import numpy as np
from scipy.special import stdtrit

from .answer import limits_of
from .axes.axes import Axes, build_axes
from .calibration import LEVEL
from .findings.comparison import MAX_COMPARED_ROWS, beyond_noise
from .findings.find import without_effects
from .kriging import Kriging, SingularCovarianceError, TooFewRowsError
from .kriging.readings import sessions_of
from .kriging.serial import dependence_of
from .solver_error import SolverError, bars_are_complete
from .table.axes import OffAxis, count_multi_axis
from .table.compliance import ComplianceFit, fit_compliance
from .table.merging import RowIndex, merge, row_conflicts
from .table.rows import Floats, LoadRange, Rows, Tolerance, nulls

STEEPER = 2.0  # largest slope of a row without a tangent, over the slope of a proportional response


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
        reason = f"predicts left-out rows within {max(100 * error, 1e-3):.2g} % of the range"
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


class Group:
    """The interpolators of outputs that the same rows have.

    `outputs`: indices, in `OUTPUTS`, of the outputs that the group answers. Arrays of six outputs
    hold 0 for the others, and these are ignored.
    `rows`: all rows that have these outputs, in ascending order of `seq`.
    `merged`: the same rows, with repeated ones merged.
    `used`: the merged rows within the load range, from which answers are computed.
    `members`: the numbers (`seq`) of the rows merged into each of `used`.
    `choice`: the default method, and its reason.
    `has_axes`: whether straight direction influence is defined: one interface without further
    inputs.
    `full_wrenches`: rows that load more than one axis.
    `row_index`: finds the row of `rows` at or next to a wrench.
    `row_uncertainty` (k, 6), m and rad: uncertainty of the rows of `merged`; NaN where unknown.
    `steepest` (6,), m and rad: the largest movement of each output over half the load range that a
    row without a tangent is assumed to have.
    `build_s`, s: processor time of the build.
    """

    def __init__(
        self,
        rows: Rows,
        load_range: LoadRange,
        *,
        tolerance: Tolerance | None = None,
        linear: bool = False,
        off_axis: OffAxis = "correct",
        before: Group | None = None,
        locked: Sequence[int] = (),
        outputs: tuple[int, ...] = (),
    ) -> None:
        """Build from rows; axes with the same points are taken from the version `before`."""
        started = thread_time()
        self.has_axes = load_range.space.is_default
        self.outputs = outputs or tuple(range(len(load_range.space.outputs)))
        self.rows = rows
        self.load_range = load_range
        self.tolerance = tolerance
        self.linear = linear
        self.locked = tuple(locked)
        self._off_axis: OffAxis = off_axis
        self.merged = merge(rows, load_range)
        self.used, self.members, self._observations = self.merged.usable()
        self.fit: ComplianceFit = fit_compliance(self.used, load_range, linear=linear)
        self._earlier_axes: Axes | None = vars(before).get("axes") if before is not None else None
        self.choice: MethodChoice = choose(
            self.used, load_range, self.fit, lambda: self.kriging, linear=linear
        )
        self.full_wrenches = count_multi_axis(self.used, load_range) if self.has_axes else 0
        self.row_index = RowIndex(rows.wrench, load_range.scale)
        self.steepest = STEEPER * self.ranges
        # Solves at one wrench repeat to the last bit. Readings at one wrench have noise, even if
        # they happen to agree, so their scatter is no measure of it.
        stated, readings = self.merged.rows.uncertainty, self.merged.observations.number
        noise = self._noise_of_a_reading() / np.sqrt(np.maximum(readings, 1.0))
        self.row_uncertainty = np.where(readings > 0, noise, np.nan_to_num(stated))
        self.build_s = thread_time() - started

    def _noise_of_a_reading(self) -> Floats:
        """Return the noise of one reading, 95 %, (m,), m and rad; NaN where unknown.

        This is the kriging's estimate, or else the scatter of all repeated readings with Student's
        t.
        """
        number, scatter = self.merged.observations
        freedom = np.maximum(number - 1, 0.0).sum(axis=0)
        total = scatter.sum(axis=0)
        repeated = np.where(total > 0, total / np.maximum(freedom, 1.0), np.nan)
        noise = stdtrit(np.maximum(freedom, 1.0), (1 + LEVEL) / 2) * np.sqrt(repeated)
        if not self.by_kriging or self.kriging is None:
            return noise
        by_kriging = self.observation_noise * self.kriging.noise_widening
        by_kriging = np.where(np.isnan(by_kriging), noise, by_kriging)
        return np.where(self.kriging.scaling.constant, self.kriging.floor, by_kriging)

    @property
    def default(self) -> str:
        """The method that answers a query without `method`."""
        return self.choice.method

    @cached_property
    def axes(self) -> Axes:
        """The three axes of the straight direction influence, built when they are first needed."""
        earlier = self._earlier_axes
        self._earlier_axes = None
        return build_axes(self.used, self.load_range, self.fit, self._off_axis, earlier)

    @property
    def by_axes(self) -> bool:
        """Whether the default method is `griddata` or `additive`."""
        return len(self.used) > 0 and self.default in ("griddata", "additive")

    @property
    def observation_noise(self) -> Floats:
        """Noise of an observation, 95 %, (6,), m and rad; NaN where it is not known."""
        if not self.by_kriging or self.kriging is None:
            return np.full(self.rows.displacement.shape[1], np.nan)
        return self.kriging.observation_noise

    @property
    def by_kriging(self) -> bool:
        """Whether the kriging answers by default; only then error bars have a confidence level."""
        return self.default == "kriging" and self.kriging is not None

    @cached_property
    def kriging(self) -> Kriging | None:
        """The kriging; None for linear components, and where rows are too few or contradictory."""
        if self.linear:
            return None
        is_reading = ~self.rows.is_solved & self.load_range.holds(self.rows.wrench)
        readings = self.rows.take(np.flatnonzero(is_reading))
        try:
            return Kriging.build(
                self.used,
                self.load_range,
                observations=self._observations,
                dependence=dependence_of(readings, self.load_range),
            )
        except (TooFewRowsError, SingularCovarianceError):
            return None

    @property
    def allowed(self) -> Floats:
        """The largest error of each output, shape (m,), m and rad, of covered answers."""
        return limits_of(self.used, self.tolerance, self.outputs)

    @cached_property
    def ranges(self) -> Floats:
        """The variation of each output over the rows and from zero, shape (m,), m and rad."""
        moved = self.used.displacement
        return moved.max(axis=0, initial=0.0) - moved.min(axis=0, initial=0.0)

    @property
    def is_exact(self) -> bool:
        """Whether the compliance alone answers, with its error bars."""
        by_compliance = self.linear or (not self.has_axes and self.default == "linear")
        return by_compliance and self.fit.complete

    @property
    def can_answer(self) -> bool:
        """Whether the group has rows and a method that answers from them."""
        by_axes_or_kriging = self.has_axes or self.by_kriging
        return len(self.used) > 0 and (by_axes_or_kriging or self.is_exact)

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the rows cover the load range, JSON-able; takes seconds for 100,000 rows."""
        fit = self.fit
        no_axes = self.default == "linear" or not self.has_axes
        kriging = self.kriging if self.by_kriging else None
        return {
            "rows": len(self.rows),
            "beyond_range": int((~self.load_range.holds(self.rows.wrench)).sum()),
            "used_rows": len(self.used),
            "compliance": {
                "origin": fit.origin,
                "loads": [self.rows.space.input_names[load] for load in np.flatnonzero(fit.known)],
                "error": fit.error.tolist(),
            },
            "axes": [] if no_axes else self.axes.summary(),
            "method": self.default,
            "method_reason": self.choice.reason,
            "method_detail": kriging.detail if kriging else "",
            "errors_left_out": self.choice.errors,
            "full_wrench_rows": self.full_wrenches,
        }


@dataclass
class Table:
    """One version of a table, made by `build`."""

    # all rows as measured, in ascending order of `seq`; NaN where an output was not measured
    rows: Rows
    load_range: LoadRange
    # Groups of outputs that the same rows have, the group of the fewest rows first, as it limits
    # the coverage. An output that no row has is in no group.
    groups: tuple[Group, ...]
    tolerance: Tolerance | None  # m and rad
    linear: bool  # whether the component is linear, so that its 6x6 compliance is exact
    version: int
    # indices, in `LOADS`, of the loads on locked freedoms: every call sets them to zero first
    locked: tuple[int, ...]
    # error of the solver; the table's own error bars leave it out
    solver_error: SolverError | None
    bars_are_complete: bool
    rig_error: Floats  # (6,), m and rad: see `findings.find.without_effects`: in no error bar here
    # the `PackedTable` of this table; None until it is packed
    packed: Any = None

    @cached_property
    def observation_noise(self) -> Floats:
        """Noise of an observation, 95 %, (6,), m and rad; NaN where it is not known."""
        noise = np.full(self.rows.displacement.shape[1], np.nan)
        for group in self.groups:
            noise[list(group.outputs)] = group.observation_noise[list(group.outputs)]
        return noise

    def coverage_summary(self) -> dict[str, Any]:
        """Return the coverage of the load range by the table, as JSON-able values."""
        summary = self.groups[0].coverage_summary() | {
            "table_version": self.version,
            "rig_error": nulls(self.rig_error.tolist()),
            **row_conflicts(self.rows, self.load_range, self.observation_noise),
            "noise_of_a_reading": nulls(self.observation_noise.tolist()),
        }
        if not self.rows.partial:
            return summary
        measured = np.isfinite(self.rows.displacement).sum(axis=0).tolist()
        names = self.rows.space.output_names
        return {
            **summary,
            "rows": len(self.rows),
            "rows_per_output": dict(zip(names, measured, strict=True)),
            "unmeasured": [name for name, count in zip(names, measured, strict=True) if not count],
        }


def build(
    rows: Rows,
    load_range: LoadRange,
    *,
    tolerance: Tolerance | None = None,
    linear: bool = False,
    off_axis: OffAxis = "correct",
    version: int = 0,
    before: Table | None = None,
    solver_error: SolverError | None = None,
    locked: Sequence[int] = (),
) -> Table:
    """Build the table of valid rows of one fingerprint.

    Parameters
    ----------
    tolerance : Tolerance or None, m and rad
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is exact.
    off_axis : {"correct", "ignore", "exclude"}
        What becomes of rows that are clean for no axis.
    before : Table, optional
        Another version: axes with the same points are taken from it, to the last bit the same.
    solver_error : SolverError, optional
        Error of the solver of these rows; in no error bar of the table itself.
    locked : sequence of int
        Indices, in `LOADS`, of the loads on locked freedoms: answers leave these loads out.
    """
    # A fixed order makes the result independent of the order of arrival.
    if (np.diff(rows.seq) < 0).any():
        rows = rows.take(np.argsort(rows.seq, kind="stable"))
    known = {group.outputs: group for group in before.groups} if before is not None else {}
    of_part, rig_error = without_effects(rows, load_range)
    options: dict[str, Any] = {"tolerance": tolerance, "linear": linear, "off_axis": off_axis}
    groups = [
        Group(
            part, load_range, before=known.get(outputs), outputs=outputs, locked=locked, **options
        )
        for outputs, part in _by_output(of_part)
    ]
    rig_error = rig_error + _between_sources(of_part, load_range, groups)
    return Table(
        rows,
        load_range,
        tuple(sorted(groups, key=lambda group: len(group.rows))),
        tolerance,
        linear,
        version,
        tuple(locked),
        solver_error,
        bars_are_complete(rows, solver_error),
        rig_error,
    )


def _between_sources(rows: Rows, load_range: LoadRange, groups: Sequence[Group]) -> Floats:
    """Return the distance of the sources from the answers, (m,), m and rad.

    A source is the solver or a session of measured rows. Sources may differ from each other by a
    factor or an offset, counted over the range of each output; answers of a table whose rows
    contradict each other then agree with no source. Only outputs that the kriging answers have a
    distance.
    """
    source = np.zeros(len(rows), dtype=np.intp)
    largest = np.zeros(rows.displacement.shape[1])
    measured = ~rows.is_solved
    source[measured] = 1 + sessions_of(rows.take(np.flatnonzero(measured)))
    sources = np.unique(source)
    for group in groups if len(sources) > 1 else ():
        if group.kriging is None or not group.by_kriging:
            continue
        for number in sources:
            at = np.flatnonzero((source == number) & load_range.holds(rows.wrench))
            compared = rows.take(at[:: max(len(at) // MAX_COMPARED_ROWS, 1)])
            answers, _ = group.kriging.answer_many(compared.wrench)
            error = beyond_noise(compared.displacement, answers)
            outputs = list(group.outputs)
            largest[outputs] = np.maximum(largest, error)[outputs]
    return largest


def _by_output(rows: Rows) -> list[tuple[tuple[int, ...], Rows]]:
    """Return the groups of outputs that the same rows have, each with its rows.

    All other outputs of these rows are 0. Their slopes are 0 too, and third derivatives are
    dropped, so that no derivative contradicts the missing displacement.
    """
    if not rows.partial:
        return [(tuple(range(rows.displacement.shape[1])), rows)]
    known = np.isfinite(rows.displacement)
    all_outputs = np.arange(known.shape[1])
    outputs_of: dict[bytes, list[int]] = {}
    for output in all_outputs.tolist():
        outputs_of.setdefault(known[:, output].tobytes(), []).append(output)
    parts = []
    for outputs in outputs_of.values():
        group_rows = rows.take(known[:, outputs[0]])
        if len(group_rows):
            in_group = np.isin(all_outputs, outputs)
            displacement = np.where(in_group, group_rows.displacement, 0.0)
            partly = ~np.isfinite(group_rows.compliance).all(axis=(1, 2), keepdims=True)
            slopes = np.where(in_group[:, None] | partly, group_rows.compliance, 0.0)
            changed = {
                "displacement": displacement,
                "compliance": slopes,
                "curvature": np.empty((len(group_rows), 0)),
            }
            parts.append((tuple(outputs), replace(group_rows, **changed)))
    return parts
