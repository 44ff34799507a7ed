"""A deformed surface as a file: binary glTF 2.0, and VTU for ParaView."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.fields.shape import Deformed

GLTF_MEDIA_TYPE = "model/gltf-binary"

_FLOAT, _UNSIGNED = 5126, 5125  # values of componentType
_VERTICES, _INDICES = 34962, 34963  # values of a bufferView's target
_Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # quaternion: minus a quarter turn about x
_MATERIAL = {
    "doubleSided": True,
    "pbrMetallicRoughness": {
        "baseColorFactor": [0.62, 0.68, 0.75, 1.0],
        "metallicFactor": 0.1,
        "roughnessFactor": 0.8,
    },
}


class _Arrays:
    """The arrays of a .glb file: their bytes, and the entries that describe them."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: NDArray[Any], target: int) -> int:
        """Add an array, shape (n,) or (n, 3), and return the number of its accessor."""
        floats = target == _VERTICES
        numbers = np.ascontiguousarray(values, dtype="<f4" if floats else "<u4")
        columns = numbers.reshape(len(numbers), -1)
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": numbers.nbytes}
        accessor = {
            "bufferView": len(self.views),
            "componentType": _FLOAT if floats else _UNSIGNED,
            "count": len(numbers),
            "type": "VEC3" if numbers.ndim == 2 else "SCALAR",
            "min": columns.min(axis=0).tolist(),
            "max": columns.max(axis=0).tolist(),
        }
        self.content.extend(numbers.tobytes())  # all lengths are multiples of four bytes
        self.views.append(view | {"target": target})
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_gltf(surface: Deformed) -> bytes:
    """Return the .glb file of a deformed surface: the undeformed mesh, and a morph target.

    The mesh is in the interface frame, in metres; its node rotates z up to y up, which is glTF's.
    Numbers are float32, with an accuracy of 1e-7. Weight 1 of the morph target shows the deformed
    part, 0 the undeformed one, 100 a hundredfold exaggeration.

    The error of each vertex, m, is the attribute ``_ERROR``, if it is known; the wrench, the
    coverage, the largest of each part of those errors, ``within_tolerance`` and the largest stress
    are in the mesh's ``extras``.
    """
    arrays = _Arrays()
    attributes = {"POSITION": arrays.add(surface.geometry.vertices, _VERTICES)}
    indices = arrays.add(surface.geometry.triangles.ravel(), _INDICES)
    moved = {"POSITION": arrays.add(surface.displacement, _VERTICES)}
    if surface.error is not None:
        attributes["_ERROR"] = arrays.add(surface.error, _VERTICES)

    extras = {
        "targetNames": ["displacement"],
        "wrench": list(surface.wrench),
        "coverage": surface.coverage,
        "within_tolerance": surface.within_tolerance,
        **({} if surface.parts is None else {"error_parts": surface.parts.largest()}),
        "stress": None if surface.stress is None else surface.stress._asdict(),
    }
    primitive = {"attributes": attributes, "indices": indices, "targets": [moved], "mode": 4}
    mesh = {"name": surface.component, "primitives": [primitive | {"material": 0}]}
    document = {
        "asset": {"version": "2.0", "generator": "wrenchbook"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": surface.component, "mesh": 0, "rotation": _Z_UP_TO_Y_UP}],
        "meshes": [mesh | {"weights": [1.0], "extras": extras}],
        "materials": [_MATERIAL],
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
        "buffers": [{"byteLength": len(arrays.content)}],
    }

    text = json.dumps(document, allow_nan=False).encode()
    chunks = _chunk(b"JSON", text, b" ") + _chunk(b"BIN\x00", bytes(arrays.content), b"\x00")
    length = 12 + len(chunks)
    return b"glTF" + (2).to_bytes(4, "little") + length.to_bytes(4, "little") + chunks


def _chunk(kind: bytes, content: bytes, filler: bytes) -> bytes:
    content += filler * (-len(content) % 4)
    return len(content).to_bytes(4, "little") + kind + content


VTU_MEDIA_TYPE = "application/vnd.vtk.unstructuredgrid+xml"

_TRIANGLE = 5
_TYPES = {"<f8": "Float64", "<i8": "Int64", "|u1": "UInt8"}


def write_vtu(surface: Deformed) -> bytes:
    """Return the .vtu file: undeformed triangles, in metres, with displacement and error.

    Numbers are unrounded float64. Beside ``error`` are its parts ``error_table``, ``error_mesh``
    and ``error_linearity``, if they are known.
    """
    triangles = surface.geometry.triangles.astype("<i8")
    fields = {"displacement": surface.displacement, "error": surface.error}
    if surface.parts:
        fields |= {f"error_{cause}": part for cause, part in surface.parts.by_cause.items()}
    known = {name: values for name, values in fields.items() if values is not None}
    count = len(triangles)
    lines = (
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">',
        "<UnstructuredGrid>",
        f'<Piece NumberOfPoints="{len(surface.geometry.vertices)}" NumberOfCells="{count}">',
        '<PointData Vectors="displacement">',
        *(_array(name, values.astype("<f8")) for name, values in known.items()),
        "</PointData>",
        "<Points>" + _array("Points", surface.geometry.vertices.astype("<f8")) + "</Points>",
        "<Cells>",
        _array("connectivity", triangles.ravel()),
        _array("offsets", np.arange(3, 3 * count + 1, 3, dtype="<i8")),
        _array("types", np.full(count, _TRIANGLE, dtype="|u1")),
        "</Cells></Piece></UnstructuredGrid></VTKFile>",
    )
    return "\n".join(lines).encode()


def _array(name: str, values: NDArray[Any]) -> str:
    content = values.nbytes.to_bytes(8, "little") + np.ascontiguousarray(values).tobytes()
    columns = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    text = base64.b64encode(content).decode("ascii")
    kind = _TYPES[values.dtype.str]
    return f'<DataArray type="{kind}" Name="{name}"{columns} format="binary">{text}</DataArray>'
