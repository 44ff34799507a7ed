"""A built table as a file that is mapped: the same answers to the last bit, from one copy."""

import mmap

import numpy as np
import pytest

from service.tables.image import ImageError, read_image, write_image
from surrogate.build import build
from surrogate.table.rows import LoadRange, Rows
from tests.service.live import FULL, clean_wrenches, full_wrenches, moved, tangents

RANGE = LoadRange(-FULL, FULL)
METHODS = (None, "griddata", "additive", "tangent", "kriging", "linear", "nearest")


def clean():
    wrenches = clean_wrenches()
    return Rows.of(wrenches, moved(wrenches), source=["measured"] * len(wrenches))


def solved():
    wrenches = full_wrenches(16)
    return Rows.of(wrenches, moved(wrenches), compliance=tangents(wrenches))


def one_force():
    wrenches = np.zeros((9, 6))
    wrenches[:, 2] = np.linspace(-100, 100, 9)
    return Rows.of(wrenches, moved(wrenches))


def missing_outputs():
    rows = clean()
    displacement = rows.displacement.copy()
    displacement[:, 4:] = np.nan
    displacement[3, 2] = np.nan
    return Rows.of(rows.wrench, displacement)


def few():
    wrenches = np.zeros((40, 6))
    wrenches[:, 2] = np.linspace(-100, 100, 40)
    return Rows.of(wrenches, 1e-6 * wrenches)


TABLES = {
    "clean": (clean, False),
    "solved": (solved, False),
    "one force": (one_force, False),
    "missing outputs": (missing_outputs, False),
    "linear": (lambda: Rows.of(np.eye(6) * FULL, 1e-6 * np.eye(6) * FULL), True),
    "empty": (Rows.empty, False),
}


@pytest.fixture(scope="module", params=TABLES, ids=lambda name: name.replace(" ", "_"))
def pair(request, tmp_path_factory):
    rows, linear = TABLES[request.param]
    built = build(rows(), RANGE, linear=linear, version=7)
    path = tmp_path_factory.mktemp("images") / "one.table"
    write_image(built, path)
    return built, read_image(path)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_a_mapped_table_answers_the_same_bits(pair, method):
    built, mapped = pair
    wrenches = np.concatenate((full_wrenches(40, 3), 0.7 * clean_wrenches()))
    one, other = (table.batch(wrenches, method=method) for table in pair)
    assert one.displacement.tobytes() == other.displacement.tobytes()
    assert one.error.tobytes() == other.error.tobytes()
    assert one.coverage.tobytes() == other.coverage.tobytes()
    derivatives = [table.derivatives(wrenches, method).tobytes() for table in pair]
    assert derivatives[0] == derivatives[1]
    for wrench in wrenches[::9].tolist():
        assert repr(built.answer(wrench, None, method)) == repr(mapped.answer(wrench, None, method))


def test_a_mapped_table_says_the_same_of_itself(pair):
    built, mapped = pair
    assert repr(built.coverage_summary()) == repr(mapped.coverage_summary())
    assert (built.version, built.default) == (mapped.version, mapped.default)


def test_the_next_version_built_from_a_mapped_one_is_that_built_from_nothing(tmp_path):
    write_image(build(clean(), RANGE), tmp_path / "one.table")
    mapped = read_image(tmp_path / "one.table")
    more = full_wrenches(2, 9)
    rows = mapped.rows + Rows.of(more, moved(more), seq=np.array([900, 901]))
    ways = [build(rows, RANGE, version=9, before=one) for one in (mapped, None)]
    asked = full_wrenches(20, 4)
    one, other = (table.batch(asked) for table in ways)
    assert one.displacement.tobytes() == other.displacement.tobytes()
    assert one.error.tobytes() == other.error.tobytes()


def base_of(array):
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array.base


def test_large_arrays_stay_in_the_file(pair):
    _, mapped = pair
    if mapped.rows.wrench.nbytes < 1024:
        return  # those are not
    assert isinstance(base_of(mapped.rows.wrench), mmap.mmap)


def test_what_is_written_into_a_mapped_array_changes_no_file(tmp_path):
    path = tmp_path / "one.table"
    write_image(build(few(), RANGE, linear=True), path)
    before = path.read_bytes()
    read_image(path).rows.displacement[:] = 1.0
    assert path.read_bytes() == before


def test_a_column_that_nobody_knows_takes_no_memory(tmp_path):
    write_image(build(few(), RANGE, linear=True), tmp_path / "one.table")
    assert not any(read_image(tmp_path / "one.table").rows.compliance.strides)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_a_flipped_byte_is_noticed(tmp_path, share):
    path = tmp_path / "one.table"
    write_image(build(few(), RANGE, linear=True), path)
    content = bytearray(path.read_bytes())
    content[int(share * len(content))] ^= 1
    path.write_bytes(content)
    with pytest.raises(ImageError, match="table"):
        read_image(path)


@pytest.mark.parametrize("kept", [0.0, 0.01, 0.6, 0.9999])
def test_a_file_that_is_cut_off_is_noticed(tmp_path, kept):
    path = tmp_path / "one.table"
    write_image(build(few(), RANGE, linear=True), path)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(ImageError):
        read_image(path)


def test_a_file_of_another_version_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "one.table"
    write_image(build(few(), RANGE, linear=True), path)
    monkeypatch.setattr("service.tables.image._made_by", lambda: "wrenchbook 99")
    with pytest.raises(ImageError, match="wrenchbook 99"):
        read_image(path)


def test_a_file_with_anything_but_a_table_is_refused(tmp_path):
    path = tmp_path / "one.table"
    write_image(mmap.mmap, path)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ImageError, match="nothing of the kind"):
        read_image(path)


def test_a_full_disk_leaves_the_file_that_was_there(tmp_path, monkeypatch):
    path = tmp_path / "one.table"
    write_image(build(few(), RANGE, linear=True), path)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(OSError, match="No space"):
        write_image(build(Rows.empty(), RANGE), path)
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["one.table"]
