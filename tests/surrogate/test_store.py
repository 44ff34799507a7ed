import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, smooth, table
from tests.surrogate.tables.write import COMPONENTS, HERE
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table import hdf5 as store
from wrenchbook.surrogate.table.hdf5 import TableFileError, read_table, write_table
from wrenchbook.surrogate.table.meta import SCHEMA_VERSION, TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

META = TableMeta(component="plate", last_seq=41, load_range=RANGE, fingerprint="abc", title="Plate")
NUMBERS = st.floats(-1e9, 1e9)
WORDS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8)


@st.composite
def tables(draw: st.DrawFn) -> Rows:
    n = draw(st.integers(0, 4))
    doubtful = st.one_of(NUMBERS, st.just(float("nan")))
    return Rows.of(
        draw(arrays(float, (n, 6), elements=NUMBERS)),
        draw(arrays(float, (n, 6), elements=NUMBERS)),
        seq=draw(arrays(np.int64, n)),
        compliance=draw(arrays(float, (n, 6, 6), elements=doubtful)),
        uncertainty=draw(arrays(float, (n, 6), elements=doubtful)),
        source=draw(st.lists(WORDS, min_size=n, max_size=n)),
        fingerprint=draw(st.lists(WORDS, min_size=n, max_size=n)),
    )


def assert_same(one: Rows, other: Rows) -> None:
    for name in ("seq", "wrench", "displacement", "compliance", "uncertainty"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), strict=True)
    assert one.source.tolist() == other.source.tolist()
    assert one.fingerprint.tolist() == other.fingerprint.tolist()


@settings(max_examples=40)
@given(tables(), st.integers(0, 2**62), WORDS)
def test_what_is_written_is_read_back(rows: Rows, last_seq: int, title: str) -> None:
    meta = TableMeta("bar", last_seq, RANGE, "f00", title)
    with tempfile.TemporaryDirectory() as folder:
        write_table(Path(folder) / "bar.h5", rows, meta)
        result, about = read_table(Path(folder) / "bar.h5")
    assert_same(result, rows)
    assert (about.component, about.last_seq, about.title) == ("bar", last_seq, title)
    assert about.fingerprint == "f00"
    np.testing.assert_array_equal(about.load_range.high, HIGH)


def test_a_full_disk_is_an_error_and_no_end_of_the_process(tmp_path: Path) -> None:
    """libhdf5 ended server and doctor by a segmentation fault, as at a limit of file sizes."""
    write_table(tmp_path / "plate.h5", table(smooth, clean_wrenches(10, 1)), META)
    before = (tmp_path / "plate.h5").read_bytes()
    program = """
import resource, sys
from tests.surrogate import test_store as t
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    t.write_table(sys.argv[1], t.table(t.smooth, t.clean_wrenches(600, 1)), t.META)
except OSError as error:
    print(error.strerror)
"""
    command = [sys.executable, "-c", program, str(tmp_path / "plate.h5")]
    ended = subprocess.run(command, cwd=HERE.parents[2], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (0, "File too large\n"), ended.stderr
    assert (tmp_path / "plate.h5").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["plate.h5"]


def test_third_derivatives_of_some_rows_are_read_back_to_the_bit(tmp_path: Path) -> None:
    curvature = np.random.default_rng(1).normal(size=(3, 56)) * 1e-12
    curvature[1] = np.nan
    rows = Rows.of(np.eye(6)[:3], np.eye(6)[:3], curvature=curvature)
    write_table(tmp_path / "plate.h5", rows, META)
    result, _ = read_table(tmp_path / "plate.h5")
    assert result.curvature.tobytes() == rows.curvature.tobytes()


def test_a_file_has_no_third_derivatives_where_no_row_brings_one(tmp_path: Path) -> None:
    write_table(tmp_path / "plate.h5", table(smooth, clean_wrenches(10, 1)), META)
    with h5py.File(tmp_path / "plate.h5") as file:
        assert "rows/curvature" not in file
    results, _ = read_table(tmp_path / "plate.h5")
    assert results.curvature.shape == (len(results), 0)


def test_a_file_with_another_number_of_third_derivatives_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "plate.h5", "w") as file:
        store._write_meta(file, META)
        store._write_rows(file, table(smooth, clean_wrenches(10, 1)))
        file["rows/curvature"] = np.zeros((10, 55))
    with pytest.raises(TableFileError, match=r"curvature has shape \(\d+, 55\)"):
        read_table(tmp_path / "plate.h5")


def test_a_table_says_its_units_and_its_contract(tmp_path: Path) -> None:
    write_table(tmp_path / "plate.h5", table(smooth, clean_wrenches(10, 1)), META)
    with h5py.File(tmp_path / "plate.h5") as file:
        assert file.attrs["schema_version"] == SCHEMA_VERSION
        assert file.attrs["last_seq"] == 41
        assert "ON the deformable component" in str(file.attrs["contract"])
        assert file["rows/wrench"].attrs["units"] == "N, N, N, N·m, N·m, N·m"
        assert str(file["rows/displacement"].attrs["units"]).startswith("m, m, m, rad")


@pytest.mark.parametrize("moment", ["sync", "_write_rows"])
def test_a_crash_while_writing_leaves_the_old_table_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    path = tmp_path / "plate.h5"
    old = table(smooth, clean_wrenches(10, 1))
    write_table(path, old, META)

    def crash(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(store, moment, crash)
    with pytest.raises(KeyboardInterrupt):
        write_table(path, table(smooth, clean_wrenches(20, 2)), META)
    assert [file.name for file in tmp_path.iterdir()] == ["plate.h5"]
    assert_same(read_table(path)[0], old)


def test_a_newer_table_is_refused_and_says_what_to_do(tmp_path: Path) -> None:
    newer = TableMeta("plate", 1, RANGE, schema_version=SCHEMA_VERSION + 1)
    write_table(tmp_path / "plate.h5", Rows.empty(), newer)
    with pytest.raises(TableFileError, match="Install the newer wrenchbook"):
        read_table(tmp_path / "plate.h5")


def test_a_foreign_file_is_refused_and_says_what_to_do(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1, 2, 3]
    with pytest.raises(TableFileError, match="wrenchbook import"):
        read_table(tmp_path / "other.h5")
    (tmp_path / "text.h5").write_text("no table")
    with pytest.raises(TableFileError, match="Restore it"):
        read_table(tmp_path / "text.h5")


def test_a_damaged_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plate.h5"
    write_table(path, table(smooth, clean_wrenches(50, 1)), META)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(TableFileError):
        read_table(path)
    with h5py.File(path, "w") as file:
        file.attrs["format"] = store.FORMAT
        file.attrs["schema_version"] = 1
    with pytest.raises(TableFileError):
        read_table(path)


def test_no_file_is_not_a_damaged_table(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_table(tmp_path / "none.h5")


def test_a_folder_that_is_not_there_changes_nothing(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="none"):
        write_table(tmp_path / "none" / "plate.h5", Rows.empty(), META)
    assert LoadRange(RANGE.low, RANGE.high).high.tolist() == HIGH.tolist()


def test_no_flipped_bit_is_read_as_another_row(tmp_path: Path) -> None:
    """51 of 400 random damages changed a wrench or a displacement without a word."""
    path, rng = tmp_path / "plate.h5", np.random.default_rng(7)
    rows = table(smooth, clean_wrenches(30, 1))
    write_table(path, rows, META)
    whole = path.read_bytes()
    refused = 0
    for trial in range(600):
        damaged = bytearray(whole)
        place = int(rng.integers(len(whole))) if trial % 6 else int(rng.integers(90))
        damaged[place] ^= 1 << int(rng.integers(8)) if trial % 2 else int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            result, about = read_table(path)
        except TableFileError:
            refused += 1
            continue
        assert_same(result, rows)
        assert (about.last_seq, about.fingerprint) == (META.last_seq, META.fingerprint)
    assert refused > 550  # the others hit bytes of the user block that hold nothing


def test_a_table_of_the_first_schema_without_a_digest_is_read(tmp_path: Path) -> None:
    rows = table(smooth, clean_wrenches(10, 1))
    with h5py.File(tmp_path / "plate.h5", "w") as file:
        store._write_meta(file, TableMeta("plate", 41, RANGE, schema_version=1))
        store._write_rows(file, rows)
    result, about = read_table(tmp_path / "plate.h5")
    assert_same(result, rows)
    assert (about.last_seq, about.ledger) == (41, "")


def test_every_column_has_a_checksum_for_other_programs(tmp_path: Path) -> None:
    write_table(tmp_path / "plate.h5", table(smooth, clean_wrenches(10, 1)), META)
    with h5py.File(tmp_path / "plate.h5") as file:
        columns = file["rows"]
        assert isinstance(columns, h5py.Group)
        assert {name: column.fletcher32 for name, column in columns.items()} == dict.fromkeys(
            columns, True
        )


def test_a_stored_row_of_plate_thin_is_what_the_shipped_mesh_solves() -> None:
    """Else write the rows anew: `python -m tests.surrogate.tables.write plate_thin`."""
    with np.load(HERE / "plate_thin.npz") as file:
        wrench, displacement = file["wrench"], file["displacement"]
    bundle = read_bundle(COMPONENTS / "plate_thin")
    row = len(wrench) // 2
    solved = Solver(bundle).solve(wrench[row]).displacement
    error = np.abs(solved - displacement[row]) / np.ptp(displacement, axis=0)
    assert error.max() < 1e-6


FOLDER = Path(__file__).parent / "tables/version_0_2"


@pytest.fixture(scope="module")
def then():
    with np.load(FOLDER / "answers.npz") as file:
        return dict(file)


def test_an_hdf5_table_answers_as_it_did(then):
    rows, meta = read_table(FOLDER / "table.h5")
    assert meta.load_range.space.is_default
    table = build(rows, meta.load_range, tolerance=meta.tolerance, linear=False)
    result = packed_of(table).batch(then["wrenches"]).outputs
    # At no load the kriging answers too, and its sum has rounding errors.
    rounding = 1e-12 * np.abs(then["kriging"]).max()
    np.testing.assert_allclose(result, then["kriging"], rtol=1e-9, atol=rounding)
