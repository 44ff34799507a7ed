"""What a page draws of a table: bounded, whatever its size; nothing is counted or queued."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.answering.drawn import (
    grid_of,
    sample_of,
    shares_of,
    six_each,
    sweep_of,
    whole_bars,
)
from wrenchbook.service.contract import COVERAGE, LOADS, OUTPUTS
from wrenchbook.service.http.openapi import refused
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.replies import json_reply
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.library.bundles import surface_of
from wrenchbook.service.library.component import require_one_wrench
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import CLEAN, Rows

router = APIRouter(prefix="/v1/components/{name}", tags=["components"], responses=refused(404, 422))
CATCH_UP_S = 25.0
# What a browser turns in 3-D without delay; the reply is then some 1 MB.
MOST = 5_000

Load = Literal["fx", "fy", "fz", "mx", "my", "mz"]
Force = Annotated[float, Query(allow_inf_nan=False, description="N")]
Moment = Annotated[float, Query(allow_inf_nan=False, description="N·m")]
Places = NDArray[np.intp]


@router.get(
    "/glance",
    summary="Covered, thin and outside parts of the range, and whole error bars",
)
async def glance(name: str, workspace: Opened) -> Response:
    table = workspace.tables.surrogate(name)
    return json_reply(await run_in_threadpool(_glance, name, table))


def _glance(name: str, table: ServedTable) -> dict[str, Any]:
    require_one_wrench(name, table.load_range.space)
    axes = {axis.name: shares_of(table, grid_of(table.load_range, axis)) for axis in AXES}
    sample = sample_of(table.load_range)
    about = {"component": name, "table_version": table.version, "shares": COVERAGE}
    whole = {"whole": shares_of(table, sample), **whole_bars(table, sample)}
    return {**about, **whole, "axes": axes}


@router.get("/surface", summary="The undeformed surface, for a picture: at most 2000 vertices, m")
def surface(name: str, workspace: Opened) -> Response:
    component = workspace.library[name]
    if not component.has_fea:
        why = f"{name!r} has measured rows and no mesh, so there is nothing to draw."
        raise HttpProblemError(404, "no-mesh", "The component has no mesh", why)
    found = surface_of(component.folder, component.fingerprint)
    return json_reply({"component": name, **found})


@router.get("/drawing", summary="Rows to draw, at most `most`, and the coverage of a grid")
async def drawing(
    name: str,
    workspace: Opened,
    axis: Annotated[
        Literal["x", "y", "z"] | None, Query(description="rows that load it alone first; its grid")
    ] = None,
    along: Annotated[Load | None, Query(description="only rows that have no other load")] = None,
    most: Annotated[int, Query(ge=1, le=MOST)] = 2_000,
) -> Response:
    table = await workspace.newest(name, CATCH_UP_S)
    return json_reply(await run_in_threadpool(_rows, name, table, axis, along, most))


def _rows(
    name: str, table: ServedTable, axis: str | None, along: str | None, most: int
) -> dict[str, Any]:
    require_one_wrench(name, table.load_range.space)
    rows, drawn = table.rows, next((one for one in AXES if one.name == axis), None)
    loaded = _loaded(rows, table)
    chosen = np.arange(len(rows))
    clean: NDArray[np.bool_] = np.zeros(len(rows), dtype=bool)
    if along is not None:
        chosen = np.flatnonzero(~loaded[:, np.arange(6) != LOADS.index(along)].any(axis=1))
    if drawn is not None:
        clean = np.logical_not(loaded[:, drawn.others].any(axis=1))
    some = rows.take(shown := _spread(chosen, clean[chosen], most))
    body = {
        "component": name,
        "table_version": table.version,
        "of": len(chosen),
        "shown": len(shown),
        "row": some.seq,
        "wrench": np.ascontiguousarray(some.wrench),
        "displacement": np.ascontiguousarray(some.displacement),
        "clean": clean[shown],
        "source": [str(one) for one in some.source],
    }
    if drawn is None:
        return body
    grid = grid_of(table.load_range, drawn)
    covers = {"wrench": grid, "coverage": table.packed.batch(grid).coverage.tolist()}
    return body | {"inputs": [LOADS[load] for load in drawn.inputs], "grid": covers}


def _loaded(rows: Rows, table: ServedTable) -> NDArray[np.bool_]:
    """Return which loads each row has, shape (n, 6)."""
    return np.asarray(np.abs(rows.wrench) > CLEAN * table.load_range.scale)


def _spread(chosen: Places, first: NDArray[np.bool_], most: int) -> Places:
    """Return at most `most` of the chosen places, those that go first before others, in order."""
    picked = _every(chosen[first], most)
    rest = _every(chosen[~first], most - len(picked))
    return np.sort(np.concatenate((picked, rest)))


def _every(places: Places, most: int) -> Places:
    """Return evenly spread places, the first and the last among them."""
    if len(places) <= most:
        return places
    return places[np.linspace(0, len(places) - 1, most).astype(np.intp)]


@router.get("/response", summary="What the table answers along one load, with its whole error bars")
async def response(
    name: str,
    workspace: Opened,
    load: Load,
    fx: Force = 0.0,
    fy: Force = 0.0,
    fz: Force = 0.0,
    mx: Moment = 0.0,
    my: Moment = 0.0,
    mz: Moment = 0.0,
    points: Annotated[int, Query(ge=2, le=501)] = 121,
) -> Response:
    table = await workspace.newest(name, CATCH_UP_S)
    at = np.array([fx, fy, fz, mx, my, mz])
    return json_reply(await run_in_threadpool(_sweep, name, table, load, at, points))


def _sweep(name: str, table: ServedTable, load: str, at: Any, points: int) -> dict[str, Any]:
    require_one_wrench(name, table.load_range.space)
    wrenches = sweep_of(table.load_range, LOADS.index(load), at, points)
    found = table.packed.batch(wrenches)
    return {
        "component": name,
        "table_version": table.version,
        "method": table.default,
        "load": load,
        "at": wrenches[:, LOADS.index(load)].tolist(),
        "outputs": OUTPUTS,
        "displacement": found.outputs,
        "error": found.errors,
        "interpolation": six_each(
            [table.packed.answer(wrench).interpolation for wrench in wrenches.tolist()]
        ),
        "bars_are_whole": table.bars_are_whole,
        "coverage": found.coverage.tolist(),
    }
