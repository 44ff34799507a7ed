"""A deformed surface as a file: binary glTF 2.0, and VTU for ParaView."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.fields.shape import Deformed

GLTF_MEDIA_TYPE = "model/gltf-binary"

_FLOAT, _UNSIGNED = 5126, 5125  # componentType
_VERTICES, _INDICES = 34962, 34963  # target of a bufferView
_Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # quaternion: minus a quarter turn about x
_JSON, _BINARY = b"JSON", b"BIN\x00"
_MATERIAL = {
    "doubleSided": True,
    "pbrMetallicRoughness": {
        "baseColorFactor": [0.62, 0.68, 0.75, 1.0],
        "metallicFactor": 0.1,
        "roughnessFactor": 0.8,
    },
}


class _Buffer:
    """Arrays one after the other, with their views and accessors."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: NDArray[Any], target: int) -> int:
        """Add an array, shape (n,) or (n, 3), and return the number of its accessor."""
        floats = target == _VERTICES
        whole = np.ascontiguousarray(values, dtype="<f4" if floats else "<u4")
        view = {
            "buffer": 0,
            "byteOffset": len(self.content),
            "byteLength": whole.nbytes,
            "target": target,
        }
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": _FLOAT if floats else _UNSIGNED,
            "count": len(whole),
            "type": "VEC3" if whole.ndim == 2 else "SCALAR",
        }
        columns = whole.reshape(len(whole), -1)
        accessor["min"] = columns.min(axis=0).tolist()
        accessor["max"] = columns.max(axis=0).tolist()
        self.content += whole.tobytes()  # all are whole multiples of four bytes
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_gltf(shape: Deformed) -> bytes:
    """Return the .glb file of a deformed surface: the undeformed mesh, and a morph target.

    The mesh is in the interface frame, in metres; its node rotates z up to y up, which is glTF's.
    Numbers are float32, so right to 1e-7. Weight 1 of the morph target shows the deformed part, 0
    the undeformed one, 100 a hundredfold exaggeration.

    The error of each vertex, m, is the attribute ``_ERROR``, if it is known; the wrench, the
    coverage, the largest of each share of those errors, ``within_tolerance`` and the largest stress
    are in the mesh's ``extras``.
    """
    buffer = _Buffer()
    attributes = {"POSITION": buffer.add(shape.geometry.vertices, _VERTICES)}
    indices = buffer.add(shape.geometry.triangles.ravel(), _INDICES)
    moved = {"POSITION": buffer.add(shape.displacement, _VERTICES)}
    if shape.error is not None:
        attributes["_ERROR"] = buffer.add(shape.error, _VERTICES)
    primitive = {
        "attributes": attributes,
        "indices": indices,
        "targets": [moved],
        "material": 0,
        "mode": 4,
    }
    mesh = {
        "name": shape.component,
        "primitives": [primitive],
        "weights": [1.0],
        "extras": {"targetNames": ["displacement"], **_extras(shape)},
    }
    document = {
        "asset": {"version": "2.0", "generator": "wrenchbook"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": shape.component, "mesh": 0, "rotation": _Z_UP_TO_Y_UP}],
        "meshes": [mesh],
        "materials": [_MATERIAL],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    return _glb(document, bytes(buffer.content))


def _extras(shape: Deformed) -> dict[str, Any]:
    parts = {} if shape.parts is None else {"error_parts": shape.parts.largest()}
    return {
        "wrench": list(shape.wrench),
        "coverage": shape.coverage,
        "within_tolerance": shape.within_tolerance,
        **parts,
        "stress": None if shape.stress is None else shape.stress._asdict(),
    }


def _glb(document: dict[str, Any], content: bytes) -> bytes:
    text = json.dumps(document, allow_nan=False).encode()
    chunks = _chunk(_JSON, text, b" ") + _chunk(_BINARY, content, b"\x00")
    whole = 12 + len(chunks)
    return b"glTF" + (2).to_bytes(4, "little") + whole.to_bytes(4, "little") + chunks


def _chunk(kind: bytes, content: bytes, filler: bytes) -> bytes:
    content += filler * (-len(content) % 4)
    return len(content).to_bytes(4, "little") + kind + content


VTU_MEDIA_TYPE = "application/vnd.vtk.unstructuredgrid+xml"

_TRIANGLE = 5
_TYPES = {"<f8": "Float64", "<i8": "Int64", "|u1": "UInt8"}


def write_vtu(shape: Deformed) -> bytes:
    """Return the .vtu file: undeformed triangles, in metres, with displacement and error.

    Numbers are float64, as they are. Next to ``error`` are the parts it is the sum of, as
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
