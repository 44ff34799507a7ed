"""Where the fields of rows are kept, and what never gets in the way of a row."""

import json
import shutil
import types

import meshio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrenchbook.service.fields.record import (
    GEOMETRY,
    MAGIC,
    ROW,
    Column,
    DamagedFieldsError,
    SurfaceGeometry,
    pack,
    read_meta,
    unpack,
    write_files,
)
from wrenchbook.service.fields.shape import Deformed, LargestStress
from wrenchbook.service.fields.store import FieldStore, key_of
from wrenchbook.service.fields.surface_files import write_gltf, write_vtu

WRENCH = (1.0, -2.0, 0.1, 0.0, 0.0, 1e-300)


def fields(linear=False, scale=1.0):
    return types.SimpleNamespace(
        linear=linear,
        weight=False,
        vertices=np.arange(12.0).reshape(4, 3),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        full_vertices=4,
        displacement=scale * np.arange(12.0).reshape(4, 3),
        displacement_slopes=np.ones((4, 3, 6)),
        stress=np.ones((2, 6)),
        stress_slopes=np.ones((2, 6, 6)),
        places=np.zeros((2, 3)),
        materials=np.zeros(2, dtype=np.int32),
        regions=("all",),
        largest=1.5,
        largest_at=(0.0, 0.1, 0.2),
        largest_region="all",
    )


@pytest.fixture
def attempt(tmp_path):
    folder = tmp_path / "attempt"
    folder.mkdir()
    return folder


def kept(store, attempt, wrench=WRENCH, fingerprint="f1", **changes):
    write_files(attempt, wrench, fields(**changes))
    return store.take(attempt, "plate", fingerprint, wrench)


def test_what_a_solver_left_is_found_by_its_wrench(store, attempt):
    assert kept(store, attempt)
    assert store.find("plate", "f1", [(0.0,) * 6, WRENCH]) == [1]
    row = store.row("plate", "f1", WRENCH)
    np.testing.assert_array_equal(row.displacement, fields().displacement)
    geometry = store.geometry("plate", "f1", row.meta["geometry"])
    np.testing.assert_array_equal(geometry.triangles, fields().triangles)
    assert not list(attempt.iterdir())


def test_another_component_wrench_or_fingerprint_has_none(store, attempt):
    kept(store, attempt)
    assert store.find("bar", "f1", [WRENCH]) == []
    assert store.find("plate", "f2", [WRENCH]) == []
    with pytest.raises(DamagedFieldsError, match="cannot be read"):
        store.row("plate", "f2", WRENCH)


def test_zero_has_no_sign():
    assert key_of((0.0, 1, 2, 3, 4, 5)) == key_of((-0.0, 1, 2, 3, 4, 5))


def test_a_solver_that_left_nothing_costs_nothing(store, attempt):
    assert not store.take(attempt, "plate", "f1", WRENCH)
    (attempt / ROW).write_bytes(b"cut off")
    (attempt / GEOMETRY).write_bytes(b"cut off")
    assert not store.take(attempt, "plate", "f1", WRENCH)


def test_a_folder_that_cannot_be_written_costs_a_row_its_fields_only(tmp_path, attempt):
    (tmp_path / "file").write_text("in the way")
    assert not kept(FieldStore(tmp_path / "file"), attempt)


def test_it_never_takes_more_than_its_share(tmp_path, attempt):
    write_files(attempt, WRENCH, fields())
    size = sum(path.stat().st_size for path in attempt.iterdir())
    store = FieldStore(tmp_path / "fields", max_bytes=int(2.5 * size))
    taken = [kept(store, attempt, (float(i),) * 6) for i in range(10)]
    assert taken[:2] == [True, True]
    assert not taken[-1]
    held = sum(p.stat().st_size for p in (tmp_path / "fields").rglob("*") if p.is_file())
    assert held <= 2.5 * size


def test_older_set_ups_make_room_for_the_present_one(tmp_path, attempt):
    write_files(attempt, WRENCH, fields())
    size = sum(path.stat().st_size for path in attempt.iterdir())
    store = FieldStore(tmp_path / "fields", max_bytes=int(1.5 * size))
    assert kept(store, attempt, fingerprint="f1")
    assert kept(store, attempt, fingerprint="f2")
    assert store.find("plate", "f1", [WRENCH]) == []
    assert store.find("plate", "f2", [WRENCH]) == [0]


def test_a_linear_component_has_one_file_whatever_is_solved(store, attempt):
    assert store.linear("plate", "f1") is None
    for load in (1.0, 2.0):
        assert kept(store, attempt, (load,) * 6, linear=True)
    assert store.linear("plate", "f1").meta["linear"]
    assert len(list((store._folder / "plate" / "f1").glob("*.fields"))) == 1


def test_a_file_of_another_wrench_is_known_by_its_name_and_its_words(store, attempt):
    kept(store, attempt)
    folder = store._folder / "plate" / "f1"
    other = (5.0,) * 6
    shutil.copy(folder / f"{key_of(WRENCH)}.fields", folder / f"{key_of(other)}.fields")
    with pytest.raises(DamagedFieldsError, match="another wrench"):
        store.row("plate", "f1", other)


# -- their files ----------------------------------------------------------------------------------


FIELD = np.random.default_rng(1).standard_normal((50, 3)) * [1e-3, 1.0, 1e6]
NAMES = np.arange(12, dtype=np.int32).reshape(4, 3)


def example():
    columns = {"field": Column(FIELD, 44), "exact": Column(FIELD), "names": Column(NAMES)}
    return pack({"words": "plate", "number": 1 / 3}, columns)


def test_words_and_exact_columns_come_back_bit_for_bit():
    meta, columns = unpack(example())
    assert meta == {"words": "plate", "number": 1 / 3}
    np.testing.assert_array_equal(columns["exact"], FIELD)
    np.testing.assert_array_equal(columns["names"], NAMES)
    assert read_meta(example()) == meta


@given(
    st.sampled_from([8, 24, 30, 44, 50]),
    st.integers(0, 2**32 - 1),
    st.floats(-300, 300),
    st.integers(1, 40),
)
def test_a_rounded_column_is_right_to_its_bits(bits, seed, exponent, count):
    values = np.random.default_rng(seed).standard_normal((count, 4)) * 10.0**exponent
    _, columns = unpack(pack({}, {"a": Column(values, bits)}))
    size = np.abs(values).max(axis=0)
    assert (np.abs(columns["a"] - values) <= size * 2.0**-bits).all()


@pytest.mark.parametrize("shape", [(0, 3), (1, 3), (5, 0), (4, 3, 6)])
@pytest.mark.parametrize("bits", [0, 24])
def test_zeros_and_nothing_at_all_have_their_shape(shape, bits):
    _, columns = unpack(pack({}, {"a": Column(np.zeros(shape), bits)}))
    assert columns["a"].shape == shape
    assert not columns["a"].any()


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_what_is_not_finite_is_not_kept(number):
    with pytest.raises(ValueError, match="1 of the 2 numbers of a are not finite"):
        pack({}, {"a": Column(np.array([[1.0, number]]), 24)})


@settings(max_examples=200)
@given(st.data())
def test_no_byte_may_change(data):
    content = bytearray(example())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    try:
        result = unpack(bytes(content))
    except DamagedFieldsError:
        return
    # JSON may be written in two ways that say the same; then it says the same.
    np.testing.assert_array_equal(result[1]["exact"], FIELD)
    assert result[0] == unpack(example())[0]


@pytest.mark.parametrize("number", ["NaN", "1e999"])
def test_a_header_with_a_number_that_is_not_finite_is_damaged(number):
    header = f'{{"meta": {{"force": {number}}}, "columns": [], "digest": ""}}'.encode()
    with pytest.raises(DamagedFieldsError):
        unpack(MAGIC + len(header).to_bytes(4, "little") + header)


@pytest.mark.parametrize("part", [0, 3, 20, 24, 100, -1])
def test_no_byte_may_be_missing(part):
    with pytest.raises(DamagedFieldsError):
        unpack(example()[:part])


@pytest.mark.parametrize(
    ("header", "words"),
    [("[1]", "lacks the members meta"), ('{"meta": {}}', "or columns"), ("{", "of 1 bytes")],
)
def test_a_header_that_is_damaged_says_of_what_it_lacks(header, words):
    content = header.encode()
    with pytest.raises(DamagedFieldsError, match=words):
        unpack(MAGIC + len(content).to_bytes(4, "little") + content)


def test_a_field_takes_less_room_than_its_numbers():
    smooth = np.sin(np.linspace(0, 3, 3000)).reshape(-1, 3)
    assert len(pack({}, {"a": Column(smooth, 24)})) < 0.4 * smooth.nbytes


# -- glTF and VTU, read again by others -----------------------------------------------------------


VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) / 3
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
MOVED = 1e-4 * np.array([[0, 0, 0], [1, 2, 3], [-1, 0, 2], [0.5, 0, 0]])


def shape(error=True, stress=True):
    geometry = SurfaceGeometry(VERTICES, TRIANGLES, 4, np.zeros((0, 3)), np.zeros(0), ("all",), "d")
    reported = LargestStress(1e6, None, (0.0, 0.0, 0.1), "all", 2e6, None) if stress else None
    bars = 1e-6 * np.arange(1.0, 5.0) if error else None
    return Deformed("plate", (0.0, 0, -1, 0, 0, 0), geometry, MOVED, bars, reported, "rows")


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
    return document, [array_of(document, accessor, binary) for accessor in document["accessors"]]


def array_of(document, accessor, binary):
    view = document["bufferViews"][accessor["bufferView"]]
    assert view["byteOffset"] % 4 == 0
    kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
    columns = {"VEC3": 3, "SCALAR": 1}[accessor["type"]]
    raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    results = np.frombuffer(raw, kind).reshape(-1, columns)
    assert len(results) == accessor["count"]
    np.testing.assert_array_equal(results.min(axis=0), np.array(accessor["min"], kind))
    np.testing.assert_array_equal(results.max(axis=0), np.array(accessor["max"], kind))
    return results


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
    result = meshio.read(tmp_path / "a.vtu")
    np.testing.assert_array_equal(result.points, VERTICES)
    np.testing.assert_array_equal(result.cells_dict["triangle"], TRIANGLES)
    np.testing.assert_array_equal(result.point_data["displacement"], MOVED)
    np.testing.assert_array_equal(result.point_data["error"], shape().error)
