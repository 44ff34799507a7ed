"""Convert a built table into its packed file, with everything that an answer needs.

`arrays` describes each array; those of group k of outputs are named ``gK/...``. `check` refuses a
name, type or shape that is not described there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..answer import METHODS, allowed_by
from ..build import Group, Table
from ..kernel.binding import PackedTable
from ..kernel.format import pieces
from ..kriging import Kriging
from ..kriging.calibration import Calibration
from ..kriging.factor import Neighbourhoods
from ..solver_error import SolverError
from ..table.rows import LONGEST, TRANSLATION_LIMIT, ZERO_LOAD, Floats
from .arrays import check, named
from .axes_arrays import axes_arrays, buckets_of

LANES, PANEL = 8, 16  # WB_LANES and WB_PANEL of surrogate/kernel/wb_internal.h

Array = NDArray[np.generic]


def pack(
    table: Table,
    *,
    component: str = "",
    fingerprint: str = "",
    contract: Mapping[str, Any] | None = None,
    interface: Mapping[str, Any] | None = None,
    origin: Mapping[str, str] | None = None,
) -> list[bytes]:
    """Return the packed file of a table as pieces of bytes.

    `component`, `fingerprint`: the component and setup of the rows.
    `contract`, `interface`: meaning of loads and displacements, in words; stored as they are.
    `origin`: digests of the table's sources; stored as they are.
    """
    arrays = dict(_space_arrays(table, len(table.groups))) | dict(_solver_arrays(table))
    sources = _Sources(table)
    for number, group in enumerate(table.groups):
        arrays |= named(f"g{number}/", dict(_group_arrays(group, sources)))
    # The gaps of each axis; None if the compliance answers, which needs no axes.
    first = table.groups[0]
    no_axes = not first.has_axes or (table.linear and first.fit.complete)
    meta = {
        "contract": dict(contract or {}),
        "interface": dict(interface or {}),
        "space": table.load_range.space.as_json(),
        "groups": [_group_meta(group) for group in table.groups],
        "sources": sources.lists,
        "solver_error": None if table.solver_error is None else table.solver_error.values,
        "summary": table.coverage_summary(),
        "gaps": None if no_axes else first.axes.gaps(table.load_range),
        "provenance": {
            "component": component,
            "fingerprint": fingerprint,
            "origin": dict(origin or {}),
            "version": table.version,
            "rows": len(table.rows),
            "sources": dict(Counter(table.rows.source.tolist())),
            "linear": table.linear,
        },
    }
    return pieces(check(arrays), _plain(meta))


def packed_of(table: Table) -> PackedTable:
    """Return the packed form of a built table; cached in the table."""
    if table.packed is None:
        table.packed = PackedTable.from_bytes(b"".join(pack(table)))
    return table.packed


def _plain(value: Any) -> Any:
    """Return a value for JSON: None for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _space_arrays(table: Table, groups: int) -> Iterator[tuple[str, Array]]:
    """Yield the arrays that are the same for all outputs."""
    span, space = table.load_range, table.load_range.space
    inputs, outputs = len(space.inputs), len(space.outputs)
    yield "space/sizes", np.array([inputs, outputs, groups], dtype=np.int32)
    yield "space/range", np.stack((span.low, span.high))
    yield "space/ends", span.ends
    yield "space/scale", span.scale
    yield "space/small", ZERO_LOAD * span.scale
    yield "space/locked", np.isin(np.arange(inputs), table.locked).astype(np.int32)
    none = np.full(outputs, np.nan)
    limits = none if table.tolerance is None else allowed_by(table.tolerance, space)
    yield "space/tolerance", np.array(limits, dtype=float)
    if table.rig_error.any():
        yield "space/rig_error", table.rig_error
    yield "space/limit", np.where(space.is_rotation, np.inf, TRANSLATION_LIMIT)
    rotations = np.flatnonzero(space.is_rotation)[::3]  # three an interface
    yield "space/vector_first", rotations.astype(np.int32)
    yield "space/vector_limit", np.full(len(rotations), LONGEST)


def _solver_arrays(table: Table) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of the solver's error."""
    error, complete = table.solver_error, table.bars_are_complete
    flags = [False, complete, False, True, complete]
    if error is not None:
        flags = [error.stiffness is not None, error.mesh is not None]
        flags += ["linearity" in error.values, error.linearity is not None, complete]
    yield "solver/flags", np.array(flags, dtype=np.int32)
    error = error or SolverError({"loads": [0.0] * len(table.load_range.low)})
    yield from named("solver/", error.packed).items()


class _Sources:
    """The sources of the rows at each wrench, as indices into a list of lists of words."""

    def __init__(self, table: Table) -> None:
        self._numbers: dict[tuple[str, ...], int] = {}
        self._at: dict[bytes, list[str]] = {}
        sources = tuple(dict.fromkeys(table.rows.source.tolist()))
        self._single = sources if len(sources) == 1 else None
        if self._single:
            return
        wrenches = np.ascontiguousarray(table.rows.wrench)
        for wrench, source in zip(wrenches, table.rows.source.tolist(), strict=True):
            names = self._at.setdefault(wrench.tobytes(), [])
            if source not in names:
                names.append(source)

    @property
    def lists(self) -> list[list[str]]:
        """The lists of sources, by index."""
        return [list(sources) for sources in self._numbers]

    def numbers(self, wrenches: Floats) -> NDArray[np.int32]:
        """Return the index of the sources of the rows at each of the inputs (r, n), SI: (r,)."""
        if self._single:
            self._numbers[self._single] = 0
            return np.zeros(len(wrenches), dtype=np.int32)
        known = self._numbers
        lists = (tuple(self._at[wrench.tobytes()]) for wrench in wrenches)
        return np.array([known.setdefault(each, len(known)) for each in lists], dtype=np.int32)


def _group_arrays(group: Group, sources: _Sources) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of one group of outputs."""
    used, exact = group.can_answer, group.is_exact
    flags = [METHODS.index(group.default), exact, used, len(group.used) > 0]
    yield "flags", np.array(flags, dtype=np.int32)
    yield "outputs", np.isin(np.arange(len(group.fit.matrix)), group.outputs).astype(np.int32)
    yield "allowed", group.allowed
    yield "fit/matrix", group.fit.matrix
    yield "fit/bar", group.fit.error
    if group.fit.offset.any():
        yield "fit/offset", group.fit.offset
    yield "fit/known", group.fit.known.astype(np.int32)
    # The numbers (`seq`) of the rows from which the compliance is computed.
    members = group.members
    if group.fit.origin == "stored":
        members = tuple(members[row] for row in np.flatnonzero(group.used.has_tangent))
    yield "fit/rows", np.array(sorted(chain.from_iterable(members)), dtype=np.int64)
    # The rows that answer at their own wrenches, in the order of their keys.
    index, merged = group.row_index, group.merged.rows
    order = index.order
    owner = group.merged.owner[order]
    tangents = merged.compliance[owner]
    has_tangent = np.isfinite(tangents).any(axis=(1, 2))
    wrenches = np.ascontiguousarray(group.rows.wrench[order])
    bucket, start = buckets_of(index.keys)
    yield "row/key", index.keys
    yield "row/bucket", bucket
    yield "row/start", start
    yield "row/rates", index.rates
    yield "row/steepest", group.steepest
    yield "row/number", order.astype(np.int32)
    yield "row/seq", group.rows.seq[order]
    yield "row/wrench", wrenches
    yield "row/moved", merged.displacement[owner]
    yield "row/bar", group.row_uncertainty[owner]
    yield "row/tangent_of", np.where(has_tangent, np.cumsum(has_tangent) - 1, -1).astype(np.int32)
    yield "row/tangent", tangents[has_tangent]
    yield "row/source", sources.numbers(wrenches)
    if used and group.has_axes:
        yield from named("axes/", axes_arrays(group.axes, group.members)).items()
    if group.kriging is not None:
        yield from named("kriging/", dict(_kriging_arrays(group.kriging))).items()


def _group_meta(group: Group) -> dict[str, Any]:
    """Return the JSON entry of one group of outputs: names, method and its reason, coverage."""
    kriging = group.kriging
    return {
        "outputs": [group.rows.space.output_names[output] for output in group.outputs],
        "method": group.default,
        "method_reason": group.choice.reason,
        "kriging": "" if kriging is None else kriging.detail,
        "errors_left_out": group.choice.errors,
    }


def _kriging_arrays(kriging: Kriging) -> Iterator[tuple[str, Array]]:
    """Yield the names and arrays of a kriging, with a factor for each output group.

    Rows are innermost and padded to a multiple of `LANES`; padding rows have zero weight and no
    neighbourhood. The inverse factor T of each neighbourhood is stored in panels of `PANEL` rows,
    column after column, so that vector instructions read it in order.
    """
    scaling = kriging.scaling
    rows = len(kriging.equations)
    stride = -(-rows // LANES) * LANES
    x = np.pad(kriging.equations.x.T, ((0, 0), (0, stride - rows)))
    padded_weights = np.zeros((kriging.weights.shape[2], kriging.weights.shape[1], stride))
    padded_weights[:, :, :rows] = kriging.weights.transpose(2, 1, 0)
    yield "x", x
    terms = [neighbours.factor.hyperparameters.terms for neighbours in kriging.neighbourhoods]
    yield "terms", np.concatenate([np.column_stack(term) for term in terms])
    yield "weights", padded_weights.reshape(len(padded_weights), -1)
    if kriging.equations.n_derivatives > 1 + len(x):
        yield "smoothness", np.array([kriging.hyperparameters.smoothness], dtype=np.int32)
    yield "coefficients", kriging.coefficients
    yield "centre", scaling.centre
    yield "rate", np.where(scaling.active, 1 / scaling.half, 0.0)
    yield "offset", scaling.offset
    yield "spread", scaling.spread
    yield "deviation", kriging.deviation * scaling.spread
    yield "lost", kriging.rounding * scaling.spread
    yield "floor", kriging.floor
    yield "tangent", np.where(scaling.active & ~np.isnan(kriging.tangent), 0.0, kriging.tangent)
    yield "span", kriging.span
    yield "together", kriging.secondary_limits
    yield "span_loads", scaling.wrenches(kriging.span)
    yield "factor_count", np.array([len(kriging.neighbourhoods)], dtype=np.int32)
    factors = zip(kriging.neighbourhoods, kriging.calibrations, strict=True)
    for number, (neighbourhoods, calibration) in enumerate(factors):
        sizes = stride, len(kriging.deviation), kriging.equations.n_derivatives
        factor = dict(_factor_arrays(neighbourhoods, calibration, *sizes))
        yield from named(f"factor{number}/", factor).items()


def _factor_arrays(
    neighbourhoods: Neighbourhoods,
    calibration: Calibration,
    stride: int,
    outputs: int,
    derivatives: int,
) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of sigma and its calibration for the outputs of one factor."""
    factor, local_factors = neighbourhoods.factor, neighbourhoods.local_factors
    count = len(local_factors)
    padded = -(-max(len(local.columns) for local in local_factors) // PANEL) * PANEL
    equations = np.zeros((count, padded), dtype=np.int32)
    panels = np.zeros((count, PANEL * padded * (padded // PANEL + 1) // 2))
    trend = np.zeros((count, local_factors[0].TF.shape[1], padded))
    for index, local in enumerate(local_factors):
        size = len(local.columns)
        row, derivative = np.divmod(local.columns, derivatives)
        equations[index, :size] = derivative * stride + row
        # A lower triangle (e, e), dimensionless, in panels of rows, columns first.
        lower = np.zeros((padded, padded))
        lower[: len(local.T), : len(local.T)] = local.T
        panels[index] = np.concatenate(
            [lower[top : top + PANEL, : top + PANEL].T.ravel() for top in range(0, padded, PANEL)]
        )
        trend[index, :, :size] = local.TF.T

    rows = factor.output_group.rows
    number = np.zeros(stride, dtype=np.int32)
    number[rows] = neighbourhoods.number
    min_variance = np.full(stride, np.inf)
    min_variance[rows] = [local_factors[k].min_variance for k in neighbourhoods.number.tolist()]
    scale = np.zeros(outputs)
    scale[factor.output_group.outputs] = calibration.factors
    yield "outputs", np.isin(np.arange(outputs), factor.output_group.outputs).astype(np.int32)
    yield "number", number
    yield "equations", equations
    yield "panels", panels
    yield "trend", trend
    yield "min_variance", min_variance
    yield "penalty", np.where(np.isfinite(min_variance), 0.0, np.inf)
    yield "mean_covariance", factor.mean_covariance
    yield "scale", scale
    yield "max_sigma", np.array([calibration.max_sigma])
