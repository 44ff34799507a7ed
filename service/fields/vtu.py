"""A deformed surface as VTU, for ParaView and its like: "warp by vector" shows it displaced."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.fields.shape import Deformed

MEDIA_TYPE = "application/vnd.vtk.unstructuredgrid+xml"

_TRIANGLE = 5
_TYPES = {"<f8": "Float64", "<i8": "Int64", "|u1": "UInt8"}


def write_vtu(shape: Deformed) -> bytes:
    """Return the .vtu file: undeformed triangles, in metres, with displacement and error.

    Numbers are float64, as they are. Beside ``error`` stand the shares it is the sum of, as
    ``error_table``, ``error_mesh`` and ``error_linearity``; one that is not known is left out.
    """
    return "\n".join(_lines(shape)).encode()


def _lines(shape: Deformed) -> Iterator[str]:
    geometry = shape.geometry
    triangles = geometry.triangles.astype("<i8")
    count = len(triangles)
    yield '<?xml version="1.0"?>'
    yield (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">'
    )
    yield "<UnstructuredGrid>"
    yield f'<Piece NumberOfPoints="{len(geometry.vertices)}" NumberOfCells="{count}">'
    yield '<PointData Vectors="displacement">'
    yield _array("displacement", shape.displacement.astype("<f8"))
    if shape.error is not None:
        yield _array("error", shape.error.astype("<f8"))
    for cause, share in (shape.parts.shares if shape.parts else {}).items():
        if share is not None:
            yield _array(f"error_{cause}", share.astype("<f8"))
    yield "</PointData>"
    yield "<Points>" + _array("Points", geometry.vertices.astype("<f8")) + "</Points>"
    yield "<Cells>"
    yield _array("connectivity", triangles.ravel())
    yield _array("offsets", np.arange(3, 3 * count + 1, 3, dtype="<i8"))
    yield _array("types", np.full(count, _TRIANGLE, dtype="|u1"))
    yield "</Cells></Piece></UnstructuredGrid></VTKFile>"


def _array(name: str, values: NDArray[Any]) -> str:
    whole = np.ascontiguousarray(values)
    content = whole.nbytes.to_bytes(8, "little") + whole.tobytes()
    columns = f' NumberOfComponents="{whole.shape[1]}"' if whole.ndim == 2 else ""
    text = base64.b64encode(content).decode("ascii")
    kind = _TYPES[whole.dtype.str]
    return f'<DataArray type="{kind}" Name="{name}"{columns} format="binary">{text}</DataArray>'
