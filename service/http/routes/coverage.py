"""Routes of a table's coverage and compliance, and of the data of plots; they queue nothing."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from fastapi import Query
from numpy.typing import NDArray
from starlette.responses import Response

from wrenchbook.fea.bundle.read import BundleError
from wrenchbook.service.contract import COVERAGE, LOADS, OUTPUTS
from wrenchbook.service.http.openapi import answers, component_router, refused
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.routes import Newest, Opened, json_reply
from wrenchbook.service.library.bundles import known_faces_of, surface_of
from wrenchbook.service.library.component import require_single_wrench
from wrenchbook.service.messages import Matrix, Message, Six, Slopes
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.axes import AXES, LoadAxis
from wrenchbook.surrogate.table.physics_checks import check_physics
from wrenchbook.surrogate.table.rows import ZERO_LOAD, Floats, LoadRange

router = component_router("components")
MAX_ROWS = 5_000  # rows that a browser rotates in 3-D without delay; the reply is then some 1 MB
SAMPLE = 128  # wrenches: they give the covered part of a range to some 4 %
CELLS = 7  # cells of each load in the grid of an axis; odd: zero load is the middle of one

Load = Literal["fx", "fy", "fz", "mx", "my", "mz"]
Number = Annotated[float, Query(allow_inf_nan=False)]
Positions = NDArray[np.intp]
ErrorBars = Sequence[Sequence[float | None] | None]


class Compliance(Message):
    component: str
    table_version: int
    tangent: Slopes
    tangent_origin: str
    origin: Literal["stored", "fitted", "none"]
    matrix: Matrix
    offset: Six
    known_loads: Sequence[str]
    error: Six
    rows: Sequence[str]
    columns: Sequence[str]
    rows_checked: int
    ok: bool | None
    checks: dict[str, Any]


@router.get("/coverage", responses=answers(dict[str, Any], "hull, gaps and contradictory rows"))
def coverage(name: str, table: Newest) -> Response:
    """Hull and gaps of each axis, and contradictory rows."""
    gaps = table.packed.meta["gaps"]
    if not table.load_range.space.is_default:
        gaps = []  # only the six loads of one interface form axes
    elif gaps is None:
        gaps = table.surrogate().groups[0].axes.gaps(table.load_range)
    return json_reply({"component": name, **table.summary, "gaps": gaps})


@router.get("/compliance", response_model=Compliance)
def compliance(name: str, table: Newest) -> Response:
    """Compliance at zero load, mean compliance over the load range, and physics checks."""
    fit = table.fit
    tangent, tangent_origin = table.packed.tangent_at_zero()
    space = table.load_range.space
    measured = np.any(np.isfinite(table.rows.displacement), axis=0)
    return json_reply(
        Compliance(
            component=name,
            table_version=table.version,
            tangent=tangent,
            tangent_origin=tangent_origin,
            origin=cast(Any, fit.origin),
            matrix=np.where(measured[:, None], fit.matrix, np.nan),
            offset=np.ascontiguousarray(np.broadcast_to(fit.offset, len(space.outputs))),
            known_loads=[
                load for load, known in zip(space.input_names, fit.known, strict=True) if known
            ],
            error=np.where(measured, fit.error, np.nan),
            rows=[f"{output.name} [{output.unit}]" for output in space.outputs],
            columns=[f"{load.name} [{load.unit}]" for load in space.inputs],
            **check_physics(table.rows, table.load_range, fit, table.tolerance),
        )
    )


@router.get("/glance")
def glance(name: str, workspace: Opened) -> Response:
    """Covered, thin and outside fractions of the load range, and error bars."""
    table = workspace.tables.surrogate(name)
    load_range = table.load_range
    outputs = len(load_range.space.outputs)
    # A Latin hypercube (McKay, Beckman and Conover 1979) is even in each input.
    layers = np.tile(np.arange(SAMPLE), (len(load_range.low), 1))
    layers = np.random.default_rng(SAMPLE).permuted(layers, axis=1).T
    wrenches = load_range.low + (layers + 0.5) / SAMPLE * (load_range.high - load_range.low)

    replies = [table.packed.answer(wrench) for wrench in wrenches.tolist()]
    within = [reply.within_tolerance for reply in replies if reply.coverage == "covered"]
    axes = AXES if load_range.space.is_default else ()
    inside = table.rows.wrench[load_range.holds(table.rows.wrench)]
    reach = np.stack((inside.min(axis=0), inside.max(axis=0)), axis=1) if len(inside) else None
    body = {
        "component": name,
        "table_version": table.version,
        "shares": COVERAGE,
        "whole": _fractions(table, wrenches),
        "error": _median([reply.error for reply in replies], outputs),
        "interpolation": _median([reply.interpolation for reply in replies], outputs),
        "allowed": table.allowed,
        "bars_are_whole": table.bars_are_complete,
        # The fraction of wrenches that are covered and within the tolerance; unknown if a covered
        # one cannot be compared with it.
        "within_tolerance": None if None in within else sum(map(bool, within)) / SAMPLE,
        "axes": {axis.name: _fractions(table, _grid(load_range, axis)) for axis in axes},
        "reach": reach,
    }
    return json_reply(body)


def _fractions(table: ServedTable, wrenches: Floats) -> list[float]:
    """Return the fractions of wrenches (n, inputs) that are covered, thin and outside."""
    coverage = table.packed.batch(wrenches).coverage
    return (np.bincount(coverage, minlength=3) / len(wrenches)).tolist()


def _median(bars: ErrorBars, outputs: int) -> Floats:
    """Return the median of each output's error bars; an unknown one counts as the largest."""
    return np.median(np.nan_to_num(_as_array(bars, outputs), nan=np.inf), axis=0)


def _as_array(bars: ErrorBars, outputs: int) -> Floats:
    """Return error bars as an array (n, outputs); NaN where they are not known."""
    return np.array([bar or (None,) * outputs for bar in bars], dtype=float)


def _ends(load_range: LoadRange) -> tuple[Floats, Floats]:
    """Return the range's ends, (6,) each, extended to zero load as for answers."""
    return np.minimum(load_range.low, 0.0), np.maximum(load_range.high, 0.0)


def _grid(load_range: LoadRange, axis: LoadAxis) -> Floats:
    """Return the middles of a grid's cells over the loads of an axis, (n, 6); other loads are zero.

    The cells have one size, and no point lies at the ends of the range, which rows hardly reach.
    """
    middles = np.linspace(*_ends(load_range), 2 * CELLS + 1)[1::2]
    loads = np.array(list(product(*(np.unique(middles[:, load]) for load in axis.inputs))))
    wrenches = np.zeros((len(loads), 6))
    wrenches[:, list(axis.inputs)] = loads
    return wrenches


@router.get("/surface")
def surface(name: str, workspace: Opened) -> Response:
    """Undeformed surface for a picture, at most 2000 vertices."""
    return json_reply({"component": name, **surface_of(*_meshed(workspace, name))})


@router.get("/faces")
def faces(name: str, workspace: Opened) -> Response:
    """Numbered faces of the mesh with their TOML, and a plotly figure."""
    folder, fingerprint = _meshed(workspace, name)
    try:
        return Response(known_faces_of(folder, fingerprint), media_type="application/json")
    except BundleError as error:
        raise HttpProblemError(404, "no-mesh", "No faces can be shown", str(error)) from error


def _meshed(workspace: Workspace, name: str) -> tuple[Path, str]:
    """Return folder and fingerprint of a component; HttpProblemError if it has no mesh."""
    component = workspace.library[name]
    if not component.has_fea:
        why = f"{name!r} has measured rows, but no mesh to draw. Use its table instead."
        raise HttpProblemError(404, "no-mesh", "The component has no mesh", why)
    return component.folder, component.fingerprint


@router.get("/drawing", responses=refused(409))
def drawing(
    name: str,
    table: Newest,
    axis: Literal["x", "y", "z"] | None = None,
    along: Load | None = None,
    most: Annotated[int, Query(ge=1, le=MAX_ROWS)] = 2_000,
) -> Response:
    """Rows for a plot, and the coverage of a grid."""
    require_single_wrench(name, table.load_range.space)
    rows = table.rows
    is_loaded = np.abs(rows.wrench) > ZERO_LOAD * table.load_range.scale
    candidates = np.arange(len(rows))
    if along is not None:  # rows without other loads
        candidates = np.flatnonzero(~np.delete(is_loaded, LOADS.index(along), axis=1).any(axis=1))
    drawn_axis = next((known for known in AXES if known.name == axis), None)
    is_single_axis: NDArray[np.bool_] = np.zeros(len(rows), dtype=bool)
    if drawn_axis is not None:
        is_single_axis = np.logical_not(is_loaded[:, drawn_axis.others].any(axis=1))

    # Rows of the axis come first: they show its response without the influence of others.
    of_axis = _spread(candidates[is_single_axis[candidates]], most)
    others = _spread(candidates[~is_single_axis[candidates]], most - len(of_axis))
    shown = np.sort(np.concatenate((of_axis, others)))
    shown_rows = rows.take(shown)
    body = {
        "component": name,
        "table_version": table.version,
        "of": len(candidates),
        "shown": len(shown),
        "row": shown_rows.seq,
        "wrench": np.ascontiguousarray(shown_rows.wrench),
        "displacement": np.ascontiguousarray(shown_rows.displacement),
        "clean": is_single_axis[shown],
        "source": [str(source) for source in shown_rows.source],
    }
    if drawn_axis is not None:
        grid = _grid(table.load_range, drawn_axis)
        body["inputs"] = [LOADS[load] for load in drawn_axis.inputs]
        body["grid"] = {"wrench": grid, "coverage": table.packed.batch(grid).coverage.tolist()}
    return json_reply(body)


def _spread(positions: Positions, count: int) -> Positions:
    """Return at most `count` evenly spread positions, with the first and the last."""
    if len(positions) <= count:
        return positions
    return positions[np.linspace(0, len(positions) - 1, count).astype(np.intp)]


@router.get("/response", responses=refused(409))
def response(
    name: str,
    table: Newest,
    load: Load,
    fx: Number = 0.0,
    fy: Number = 0.0,
    fz: Number = 0.0,
    mx: Number = 0.0,
    my: Number = 0.0,
    mz: Number = 0.0,
    points: Annotated[int, Query(ge=2, le=501)] = 121,
) -> Response:
    """Displacement along one load, with error bars."""
    require_single_wrench(name, table.load_range.space)
    low, high = _ends(table.load_range)
    wrenches = np.repeat([[fx, fy, fz, mx, my, mz]], points, axis=0)
    varied = LOADS.index(load)
    wrenches[:, varied] = np.linspace(low[varied], high[varied], points)
    replies = table.packed.batch(wrenches)
    interpolation = [table.packed.answer(wrench).interpolation for wrench in wrenches.tolist()]
    return json_reply(
        {
            "component": name,
            "table_version": table.version,
            "method": table.default,
            "load": load,
            "at": wrenches[:, varied].tolist(),
            "outputs": OUTPUTS,
            "displacement": replies.outputs,
            "error": replies.errors,
            "interpolation": _as_array(interpolation, len(OUTPUTS)),
            "bars_are_whole": table.bars_are_complete,
            "coverage": replies.coverage.tolist(),
        }
    )
