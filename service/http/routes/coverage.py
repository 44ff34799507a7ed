"""Coverage of a component's table, and its compliance with checks of physics."""

from __future__ import annotations

from typing import Any

import numpy as np
from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.http.openapi import answers, refused
from wrenchbook.service.http.replies import json_reply
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.http.schemas import Compliance
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import CATCH_UP_S
from wrenchbook.surrogate.describe import axis_gaps
from wrenchbook.surrogate.table.physics_checks import check_physics

router = APIRouter(prefix="/v1/components/{name}", tags=["components"], responses=refused(404, 422))


@router.get(
    "/coverage",
    summary="Hull and gaps per axis, and rows that contradict each other",
    responses=answers(dict[str, Any], "hull and gaps"),
)
async def coverage(name: str, workspace: Opened) -> Response:
    return await run_in_threadpool(_coverage, name, await workspace.newest(name, CATCH_UP_S))


def _coverage(name: str, table: ServedTable) -> Response:
    gaps = table.packed.words["gaps"]
    if not table.load_range.space.is_default:
        gaps = []  # its table has no axes
    elif gaps is None:
        gaps = axis_gaps(table.surrogate().composition, table.load_range)
    body = {"component": name, **table.summary, "gaps": gaps}
    return json_reply(body)


@router.get(
    "/compliance",
    summary="The 6x6 at zero load, its mean over the load range, and what breaks physics",
    response_model=Compliance,
)
async def compliance(name: str, workspace: Opened) -> Response:
    return await run_in_threadpool(_compliance, name, await workspace.newest(name, CATCH_UP_S))


def _compliance(name: str, table: ServedTable) -> Response:
    fit, tangent, space = table.fit, table.packed.words["tangent"], table.load_range.space
    body: dict[str, Any] = {
        "component": name,
        "table_version": table.version,
        "tangent": tangent["matrix"],
        "tangent_origin": tangent["origin"],
        "origin": fit.origin,
        "matrix": fit.matrix.tolist(),
        "offset": np.broadcast_to(fit.offset, len(space.outputs)).tolist(),
        "known_loads": [
            load for load, known in zip(space.input_names, fit.known, strict=True) if known
        ],
        "error": fit.error.tolist(),
        "rows": [f"{output.name} [{output.unit}]" for output in space.outputs],
        "columns": [f"{load.name} [{load.unit}]" for load in space.inputs],
        **check_physics(table.rows, table.load_range, fit, table.tolerance),
    }
    return json_reply(body)
