"""HDF5, NetCDF and MATLAB tables that somebody else has made: a dataset or a variable a column."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from tests.service import table_files
from tests.service.table_files import ReadTable, read_hdf5, write_hdf5
from wrenchbook.surrogate.table.foreign import foreign_columns
from wrenchbook.surrogate.table.hdf5 import TableFileError, foreign_tables
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import Input, space_of

RANGE = LoadRange(-np.ones(6), np.ones(6))
META = TableMeta("plate", 9, RANGE)
ROWS = Rows.of(np.eye(6), 1e-3 * np.eye(6), source=["measured"] * 6)


@pytest.fixture
def changed(tmp_path):
    """Give the bytes of a table after somebody has worked on it."""

    def change(edit) -> bytes:
        path = tmp_path / "table.h5"
        path.write_bytes(write_hdf5(ROWS, range(1, 7), META))
        with h5py.File(path, "r+") as file:
            edit(file)
        return path.read_bytes()

    return change


def only_error(table: ReadTable):
    assert len(table.errors) == 1, table.errors
    return table.errors[0]


def test_a_row_beyond_a_limit_is_named_and_the_others_are_read():
    far = Rows.of(np.eye(6) * [1, 11, 1, 1, 1, 1], np.eye(6) * [1, 1, 11, 0.1, 0.1, 0.4])
    table = read_hdf5(write_hdf5(far, range(6), META), load_range=RANGE)
    assert [(error.row, error.field) for error in table.errors] == [
        (2, "wrench[1]"),
        (3, "displacement[2]"),
        (6, "displacement[5]"),
    ]
    assert table.seq.tolist() == [1, 4, 5]


def test_an_uncertainty_below_zero_and_half_a_tangent_are_named():
    uncertainty = np.zeros((6, 6))
    uncertainty[1, 2], uncertainty[2, 0] = -1, np.inf
    compliance = np.full((6, 6, 6), np.nan)
    compliance[4, 0, 0] = 1.0
    rows = Rows.of(ROWS.wrench, ROWS.displacement, uncertainty=uncertainty, compliance=compliance)
    table = read_hdf5(write_hdf5(rows, range(6), META))
    result = [(error.row, error.field) for error in table.errors]
    assert result == [(2, "uncertainty[2]"), (3, "uncertainty[0]"), (5, "compliance[0][1]")]
    assert "all 36 tangents or none" in table.errors[2].message


def test_a_file_of_hdf5_without_columns_says_so(tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["x"] = 1
    assert "has no columns" in only_error(read_hdf5(path.read_bytes())).message


def test_no_rows_say_so():
    assert (
        only_error(read_hdf5(write_hdf5(Rows.empty(), (), META))).message
        == "there is no row; add one"
    )


def test_a_table_cannot_point_at_files_of_the_server(changed, tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(b"k" * 288)

    def outside(file):
        del file["rows/wrench"]
        storage = [(str(secret), 0, 288)]
        file["rows"].create_dataset("wrench", (6, 6), "f8", external=storage)

    def linked(file):
        del file["rows/wrench"]
        file["rows/wrench"] = h5py.ExternalLink(str(secret), "/x")

    def virtual(file):
        del file["rows/wrench"]
        layout = h5py.VirtualLayout((6, 6), "f8")
        layout[:] = h5py.VirtualSource(str(secret), "x", (6, 6))
        file["rows"].create_virtual_dataset("wrench", layout)

    def linked_group(file):
        del file["rows"]
        file["rows"] = h5py.ExternalLink(str(secret), "/rows")

    for edit in (outside, linked, virtual):
        error = only_error(read_hdf5(changed(edit)))
        assert "rows/wrench in another file" in error.message
    assert "rows in another file" in only_error(read_hdf5(changed(linked_group))).message
    missing = only_error(read_hdf5(changed(lambda file: file.pop("load_range"))))
    assert "no group load_range" in missing.message


def test_an_edited_table_file_says_how_to_edit_its_rows(tmp_path):
    path = tmp_path / "edited.h5"
    content = write_hdf5(ROWS, range(1, 7), META)
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(TableFileError, match="differs from what wrenchbook wrote"):
        list(foreign_tables(path))


def test_a_group_in_the_place_of_a_column_and_long_texts_are_named(changed):
    def grouped(file):
        del file["rows/wrench"]
        file.create_group("rows/wrench")

    def long_texts(file):
        del file["rows/source"]
        file["rows"].create_dataset("source", data=np.array([b"x" * 2000] * 6))

    assert "rows/wrench, but not as a dataset" in only_error(read_hdf5(changed(grouped))).message
    message = only_error(read_hdf5(changed(long_texts))).message
    assert "strings of 2000 bytes in rows/source, over the limit of 1024" in message


def test_a_small_file_cannot_unpack_to_more_than_memory_should_hold(changed):
    def swollen(file):
        del file["rows/wrench"]
        file["rows"].create_dataset("wrench", (10**9, 6), "f8", chunks=(1000, 6))

    content = changed(swollen)
    assert len(content) < 100_000
    message = only_error(read_hdf5(content)).message
    assert re.search("unpacks to 457[0-9]{2} MiB, over the limit of 1024 MiB;", message)


def test_a_table_with_another_reference_temperature_is_refused_by_that_reference():
    cold, warm = (
        space_of(scalars=[Input("temperature", "K", "scalar", zero=zero)]) for zero in (0.0, 293.15)
    )
    rows = Rows.of(np.ones((1, 7)), np.ones((1, 6)), warm)
    sent = write_hdf5(rows, [1], TableMeta("rig", 1, LoadRange(-np.ones(7), np.ones(7), warm)))
    error = only_error(read_hdf5(sent, load_range=LoadRange(-np.ones(7), np.ones(7), cold)))
    assert (
        "it has temperature [K] with the reference 293.15 where this one has temperature [K] with "
        "the reference 0;" in error.message
    )


LOADS = ("fx [N]", "fy [N]", "fz [N]", "mx [Nm]", "my [Nm]", "mz [Nm]")
STORED = np.array([9150, -32768, -40], dtype="i2")


def packed(tmp_path, packing, stored=STORED) -> bytes:
    """Return a file of columns whose fx is packed."""
    path = tmp_path / "logger.nc"
    with h5py.File(path, "w") as file:
        for name in (*LOADS, "ux [m]"):
            file[name] = np.zeros(len(stored))
        del file["fx [N]"]
        file["fx [N]"] = stored
        file["fx [N]"].attrs.update(packing)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("packing", "loads"),
    [
        ({"scale_factor": 0.1}, [915.0, -3276.8, -4.0]),
        ({"add_offset": 100.0}, [9250.0, -32668.0, 60.0]),
        ({"scale_factor": np.array([0.01]), "add_offset": -50.0}, [41.5, -377.68, -50.4]),
    ],
)
def test_packed_loads_are_unpacked_as_the_cf_conventions_say(tmp_path, packing, loads):
    table = read_hdf5(packed(tmp_path, packing))
    assert table.errors == ()
    np.testing.assert_allclose(table.wrench[:, 0], loads, rtol=1e-12)


@pytest.mark.parametrize(
    "mark",
    [
        {"_FillValue": np.int16(-32768)},
        {"missing_value": [-32768, 7], "scale_factor": 1.0},
        {"valid_min": -1000},
        {"valid_range": [-1000, 10_000]},
    ],
)
def test_a_load_that_the_file_marks_as_missing_is_no_load(tmp_path, mark):
    table = read_hdf5(packed(tmp_path, mark))
    assert [(error.row, error.field) for error in table.errors] == [(2, "fx [N]")]
    assert table.wrench[:, 0].tolist() == [9150.0, -40.0]


def test_a_fill_value_of_64_bits_is_one_of_32_bits_too(tmp_path):
    stored = np.array([1.0, 1e20], dtype="f4")
    table = read_hdf5(packed(tmp_path, {"_FillValue": 1e20}, stored))
    assert only_error(table).row == 2


def test_a_displacement_that_the_file_marks_as_missing_was_not_measured(tmp_path):
    path = tmp_path / "logger.h5"
    with h5py.File(path, "w") as file:
        matrix = np.tile(np.arange(1, 9), (2, 1))
        matrix[1, 7] = -1
        file["log"] = matrix
        file["log"].attrs.update(columns=[*LOADS, "ux [m]", "uy [m]"], missing_value=-1)
    table = read_hdf5(path.read_bytes())
    assert table.errors == ()
    assert table.displacement[0, :2].tolist() == [7.0, 8.0]
    assert table.displacement[1, 0] == 7.0
    assert np.isnan(table.displacement[1, 1])


@pytest.mark.parametrize("limit", [{"valid_range": [-0.01, 0.01]}, {"valid_max": 100.0}])
def test_a_valid_range_that_may_be_of_packed_or_unpacked_integers_is_refused(tmp_path, limit):
    error = only_error(read_hdf5(packed(tmp_path, {"scale_factor": 1e-6} | limit)))
    assert "which is ambiguous" in error.message


def test_a_value_of_32_bits_at_a_valid_limit_of_64_bits_is_valid(tmp_path):
    stored = np.array([0.1, 0.05], dtype="f4")
    assert len(read_hdf5(packed(tmp_path, {"valid_max": 0.1}, stored))) == 2


def test_integers_that_stand_for_unsigned_ones_are_refused(tmp_path):
    stored = np.array([100, -5], dtype="i1")
    error = only_error(read_hdf5(packed(tmp_path, {"_Unsigned": "true"}, stored)))
    assert "_Unsigned" in error.message


@pytest.mark.parametrize("factor", ["0.1", [0.1, 0.2], np.nan])
def test_a_packing_that_is_no_number_is_named(tmp_path, factor):
    error = only_error(read_hdf5(packed(tmp_path, {"scale_factor": factor})))
    assert "fx [N] with the attribute scale_factor" in error.message


# -- a dataset or a variable a column -----------------------------------------------------------

COLUMNS = {"Fz [kN]": [-0.5, -1.0, -1.5], "uz": [-0.1, -0.2, -0.31]}
EXPECTED = ([-500.0, -1000.0, -1500.0], [-1e-4, -2e-4, -3.1e-4])


def read_columns(path: Path) -> tuple[tuple[list[float], list[float]], list[str]]:
    table, report = table_files.read(path.read_bytes())
    messages = [mistake.message for mistake in report.mistakes.listed()]
    return (table.wrench[:, 2].tolist(), table.displacement[:, 2].tolist()), messages


def write(path: Path, columns: dict[str, Any], group: str = "", unit: str = "units") -> Path:
    with h5py.File(path, "w") as file:
        inside = file.require_group(group) if group else file
        for name, values in columns.items():
            inside[name] = values
        inside["uz"].attrs[unit] = "mm"
    return path


@pytest.mark.parametrize("group", ["", "run 3", "rig/run 3"])
@pytest.mark.parametrize("unit", ["unit", "units"])
def test_datasets_of_one_length_are_columns(tmp_path: Path, group: str, unit: str):
    assert read_columns(write(tmp_path / "a", COLUMNS, group, unit)) == (EXPECTED, [])


def test_single_numbers_and_texts_beside_the_columns_are_left_out(tmp_path: Path):
    path = write(tmp_path / "a", {**COLUMNS, "rate": 100.0})
    assert read_columns(path) == (EXPECTED, [])


def test_a_dataset_of_named_fields_is_a_table(tmp_path: Path):
    table = np.zeros(3, dtype=[("Fz [kN]", "f8"), ("uz_mm", "f8")])
    table["Fz [kN]"], table["uz_mm"] = COLUMNS["Fz [kN]"], COLUMNS["uz"]
    with h5py.File(tmp_path / "a", "w") as file:
        file["log"] = table
    assert read_columns(tmp_path / "a") == (EXPECTED, [])


def test_a_matrix_names_its_columns_by_an_attribute(tmp_path: Path):
    with h5py.File(tmp_path / "a", "w") as file:
        file["log"] = np.column_stack(list(COLUMNS.values()))
        file["log"].attrs["columns"], file["log"].attrs["units"] = ["Fz", "uz"], ["kN", "mm"]
    assert read_columns(tmp_path / "a") == (EXPECTED, [])


def test_matlab_vectors_of_level_7_3_are_columns(tmp_path: Path):
    columns = {name: np.array(values)[None] for name, values in COLUMNS.items()}
    assert read_columns(write(tmp_path / "a", columns)) == (EXPECTED, [])


NAMED = {"Fz_kN": COLUMNS["Fz [kN]"], "uz_mm": COLUMNS["uz"]}


def test_a_matlab_file_of_one_row_is_read(tmp_path: Path):
    """Its scalars were no columns."""
    savemat(tmp_path / "a.mat", {"Fz_N": 1.5, "uz_mm": 2.0})
    assert read_columns(tmp_path / "a.mat") == (([1.5], [2e-3]), [])


@pytest.mark.parametrize("content", [NAMED, {"log": NAMED}], ids=["variables", "struct"])
def test_matlab_vectors_are_columns(tmp_path: Path, content: dict[str, Any]):
    savemat(tmp_path / "a.mat", content)
    assert read_columns(tmp_path / "a.mat") == (EXPECTED, [])


@pytest.mark.parametrize("shape", [(0, 1), (0, 0)])
def test_matlab_vectors_of_length_0_are_columns_without_rows(tmp_path: Path, shape):
    """They were no columns; in level 7.3 their shape was read as two rows."""
    savemat(tmp_path / "a.mat", {name: np.zeros(shape) for name in NAMED})
    with h5py.File(tmp_path / "b.mat", "w") as file:
        for name in NAMED:
            file[name] = np.array(shape, dtype=np.uint64)
            file[name].attrs["MATLAB_empty"] = 1
    for name in ("a.mat", "b.mat"):
        expected = (([], []), ["there is no row below the header; add one"])
        assert read_columns(tmp_path / name) == expected


def test_a_logical_vector_of_matlab_is_no_column_of_numbers(tmp_path: Path):
    """Its values were loads of 1 N and 0 N."""
    savemat(tmp_path / "a.mat", {"Fz_N": np.array([True, False]), "uz_mm": [1.0, 2.0]})
    with h5py.File(tmp_path / "b.mat", "w") as file:
        file["Fz_N"], file["uz_mm"] = np.array([[1, 0]], dtype=np.uint8), [[1.0, 2.0]]
        file["Fz_N"].attrs["MATLAB_class"] = np.bytes_("logical")
    for name in ("a.mat", "b.mat"):
        result, messages = read_columns(tmp_path / name)
        assert result == ([], [])
        assert messages[0].startswith("'True' is not a number")


def test_an_empty_cell_of_a_load_is_named(tmp_path: Path):
    path = write(tmp_path / "a", {**COLUMNS, "Fz [kN]": [-0.5, np.nan, -1.5]})
    result, messages = read_columns(path)
    assert result[0] == [-500.0, -1500.0]
    assert messages == ["is empty; write 0 for no load, split merged cells, or leave the row out"]


@pytest.mark.parametrize(
    ("levels", "says"),
    [
        (20, "has its columns below more than 8 groups; write them into one group"),
        (1000, "has groups in more than 64 levels; write the data into fewer"),
    ],
)
def test_deeply_nested_groups_are_refused_without_a_walk_to_each(tmp_path: Path, levels, says):
    path = tmp_path / "deep.h5"
    with h5py.File(path, "w") as file:
        group = file
        for _ in range(levels):
            group = group.create_group("g")
    start = time.process_time()
    with pytest.raises(TableFileError) as refusal:
        list(foreign_columns(path))
    assert str(refusal.value) == says
    assert time.process_time() - start < 1  # 1,000 levels took 5 s, 3,000 took 60


def test_columns_in_several_groups_are_named(tmp_path: Path):
    path = write(tmp_path / "a", COLUMNS, "rig/run 3")
    with h5py.File(path, "a") as file:
        file["rig/run 4/uz"] = [1.0]
    assert read_columns(path)[1] == [
        "has columns in several groups (run 3, run 4); send each as a file of its own"
    ]


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        (
            {**COLUMNS, "Fz [kN]": [1.0]},
            "has columns of several lengths (Fz [kN]: 1, uz [mm]: 3)",
        ),
        (
            {**COLUMNS, **{f"x{n}": np.zeros(3) for n in range(9)}, "z": [1.0]},
            "has columns of several lengths (Fz [kN]: 3, z: 1)",
        ),
        ({**COLUMNS, "image": np.zeros((4, 4))}, "has image of shape (4, 4)"),
        ({**COLUMNS, "z": np.zeros(3, dtype=complex)}, "type complex128"),
    ],
)
def test_hdf5_that_is_no_table_says_why(tmp_path: Path, columns: dict[str, Any], says: str):
    result, (message,) = read_columns(write(tmp_path / "a", columns))
    assert result == ([], [])
    assert says in message


def test_data_in_another_file_is_refused(tmp_path: Path):
    other = write(tmp_path / "other", COLUMNS)
    with h5py.File(tmp_path / "a", "w") as file:
        file["uz"] = h5py.ExternalLink(str(other), "uz")
        file["Fz [kN]"] = COLUMNS["Fz [kN]"]
    result, (message,) = read_columns(tmp_path / "a")
    assert result == ([], [])
    assert "refers to data in other files (uz)" in message


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"a": [1.0, 2.0], "b": [1.0, 2.0, 3.0]}, "their lengths are a 2, b 3"),
        ({"a": np.zeros((2, 2))}, "a is not one ("),
        ({"a": np.array([1, "x"], dtype=object)}, "a is not one ("),
        ({"a": "1"}, "must hold numeric vectors"),
    ],
)
def test_a_matlab_file_that_is_no_table_says_why(tmp_path: Path, content: dict, says: str):
    savemat(tmp_path / "a.mat", content)
    result, (message,) = read_columns(tmp_path / "a.mat")
    assert result == ([], [])
    assert says in message


@pytest.mark.parametrize("cut", [120, 200, 300])
def test_a_damaged_matlab_file_is_named(tmp_path: Path, cut: int):
    savemat(tmp_path / "a.mat", NAMED)
    path = tmp_path / "b.mat"
    path.write_bytes((tmp_path / "a.mat").read_bytes()[:cut])
    result, (message,) = read_columns(path)
    assert result == ([], [])
    assert "is damaged, or not a MATLAB file" in message or "not a table" in message
