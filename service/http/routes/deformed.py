"""The deformed surface of a component under a wrench, with its largest stress."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated, Literal, cast

import numpy as np
from fastapi import Query
from numpy.typing import NDArray
from starlette.responses import Response

from wrenchbook.service.contract import Coverage
from wrenchbook.service.fields import surface_files
from wrenchbook.service.http.openapi import BYTES, answers, component_router
from wrenchbook.service.http.routes import Newest, Opened, attached, json_reply
from wrenchbook.service.library.component import Component, interface_of, require_single_wrench
from wrenchbook.service.messages import DeformedShape, Stress
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import Workspace

router = component_router("components", codes=(404, 409, 422))

_Number = Annotated[float, Query(allow_inf_nan=False)]
_FILES = {  # by format: the writer, the media type, the ending of the name
    "gltf": (surface_files.write_gltf, surface_files.GLTF_MEDIA_TYPE, "glb"),
    "vtu": (surface_files.write_vtu, surface_files.VTU_MEDIA_TYPE, "vtu"),
}


@router.get(
    "/deformed",
    responses=answers(
        DeformedShape,
        "surface and displacement; see `coverage` outside the load range or with too few rows",
        content={surface_files.GLTF_MEDIA_TYPE: BYTES, surface_files.VTU_MEDIA_TYPE: BYTES},
    ),
)
async def deformed(
    name: str,
    workspace: Opened,
    table: Newest,
    fx: _Number = 0.0,
    fy: _Number = 0.0,
    fz: _Number = 0.0,
    mx: _Number = 0.0,
    my: _Number = 0.0,
    mz: _Number = 0.0,
    format: Literal["json", "gltf", "vtu"] = "json",  # noqa: A002 (the contract's word)
) -> Response:
    """Deformed surface and largest stress under a wrench."""
    component = workspace.library.as_read(name)
    require_single_wrench(name, component.space)
    loads = np.array([fx, fy, fz, mx, my, mz])
    # In its own small pool of threads: it reads files and multiplies large arrays.
    loop = asyncio.get_running_loop()
    return await loop.run_in_executor(
        workspace.shapes.threads, _reply, workspace, component, table, loads, format
    )


def _reply(
    workspace: Workspace,
    component: Component,
    table: ServedTable,
    loads: NDArray[np.float64],
    form: str,
) -> Response:
    """Return the deformed surface under `loads`, shape (6,), N and N·m, in a format."""
    name = component.name
    shape = workspace.deformed(component, table, loads)
    if form != "json":
        write, kind, ending = _FILES[form]
        headers = {
            **attached(f"{name}.{ending}"),
            "Wrenchbook-Coverage": shape.coverage,
            "Wrenchbook-Within-Tolerance": json.dumps(shape.within_tolerance),
        }
        return Response(write(shape), 200, headers, kind)

    geometry = shape.geometry
    count = len(geometry.vertices)
    stress = None
    if shape.stress is not None:
        stress = Stress(**{**shape.stress._asdict(), "at": np.array(shape.stress.at)})
    interface = interface_of(component) or {}
    simplified: dict[Literal["from", "to"], int] = {"from": geometry.full_vertices, "to": count}
    reply = DeformedShape(
        component=name,
        force=np.array(shape.wrench[:3]),
        moment=np.array(shape.wrench[3:]),
        frame={"point": interface.get("point"), "axes": interface.get("axes")},
        vertices=geometry.vertices,
        triangles=geometry.triangles,
        displacement=np.ascontiguousarray(shape.displacement),
        error=shape.error,
        error_parts=None if shape.parts is None else shape.parts.largest(),
        within_tolerance=shape.within_tolerance,
        simplified=simplified if count < geometry.full_vertices else None,
        stress=stress,
        source=shape.source,
        rows=shape.rows,
        coverage=cast(Coverage, shape.coverage),
        reason=shape.reason,
    )
    return json_reply(reply)
