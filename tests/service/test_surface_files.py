"""glTF and VTU, read again by others."""

import json

import meshio
import numpy as np
import pytest

from wrenchbook.service.fields.record import SurfaceGeometry
from wrenchbook.service.fields.shape import Deformed, LargestStress
from wrenchbook.service.fields.surface_files import write_gltf, write_vtu

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) / 3
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
MOVED = 1e-4 * np.array([[0, 0, 0], [1, 2, 3], [-1, 0, 2], [0.5, 0, 0]])


def shape(error=True, stress=True):
    geometry = SurfaceGeometry(VERTICES, TRIANGLES, 4, np.zeros((0, 3)), np.zeros(0), ("all",), "d")
    told = LargestStress(1e6, None, (0.0, 0.0, 0.1), "all", 2e6, None) if stress else None
    bars = 1e-6 * np.arange(1.0, 5.0) if error else None
    return Deformed("plate", (0.0, 0, -1, 0, 0, 0), geometry, MOVED, bars, told, "rows")


def parsed(content):
    """Return the document and the arrays of a .glb, read by the letter of its specification."""
    assert content[:4] == b"glTF"
    version, length = (int.from_bytes(content[i : i + 4], "little") for i in (4, 8))
    assert (version, length) == (2, len(content))
    chunks, place = [], 12
    while place < length:
        size = int.from_bytes(content[place : place + 4], "little")
        assert size % 4 == 0
        chunks.append((content[place + 4 : place + 8], content[place + 8 : place + 8 + size]))
        place += 8 + size
    (first, text), (second, binary) = chunks
    assert (first, second) == (b"JSON", b"BIN\x00")
    document = json.loads(text)
    assert document["buffers"] == [{"byteLength": len(binary)}]
    return document, [array_of(document, one, binary) for one in document["accessors"]]


def array_of(document, accessor, binary):
    view = document["bufferViews"][accessor["bufferView"]]
    assert view["byteOffset"] % 4 == 0
    kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
    columns = {"VEC3": 3, "SCALAR": 1}[accessor["type"]]
    raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    found = np.frombuffer(raw, kind).reshape(-1, columns)
    assert len(found) == accessor["count"]
    np.testing.assert_array_equal(found.min(axis=0), np.array(accessor["min"], kind))
    np.testing.assert_array_equal(found.max(axis=0), np.array(accessor["max"], kind))
    return found


def test_a_glb_holds_the_surface_and_a_morph_target_that_moves_it():
    document, arrays = parsed(write_gltf(shape()))
    (mesh,) = document["meshes"]
    (primitive,) = mesh["primitives"]
    np.testing.assert_allclose(arrays[primitive["attributes"]["POSITION"]], VERTICES, rtol=1e-7)
    np.testing.assert_array_equal(arrays[primitive["indices"]].reshape(-1, 3), TRIANGLES)
    (target,) = primitive["targets"]
    np.testing.assert_allclose(arrays[target["POSITION"]], MOVED, rtol=1e-7)
    np.testing.assert_allclose(arrays[primitive["attributes"]["_ERROR"]][:, 0], shape().error)
    assert mesh["weights"] == [1.0]
    assert mesh["extras"]["stress"]["largest"] == 1e6
    assert document["scenes"][document["scene"]]["nodes"] == [0]


def test_its_node_turns_z_up_to_y_up():
    document, _ = parsed(write_gltf(shape()))
    x, y, z, w = document["nodes"][0]["rotation"]
    up = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    np.testing.assert_allclose(up, [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("write", [write_gltf, write_vtu])
def test_what_is_not_known_is_left_out(write):
    content = write(shape(error=False, stress=False))
    assert b"error" not in content.lower()


def test_meshio_reads_the_vtu_to_the_last_digit(tmp_path):
    (tmp_path / "a.vtu").write_bytes(write_vtu(shape()))
    found = meshio.read(tmp_path / "a.vtu")
    np.testing.assert_array_equal(found.points, VERTICES)
    np.testing.assert_array_equal(found.cells_dict["triangle"], TRIANGLES)
    np.testing.assert_array_equal(found.point_data["displacement"], MOVED)
    np.testing.assert_array_equal(found.point_data["error"], shape().error)
