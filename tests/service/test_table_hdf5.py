"""HDF5 tables that somebody else has made."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from tests.service.table_files import ReadTable, read_hdf5
from wrenchbook.service.formats import write_hdf5
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

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
    found = [(error.row, error.field) for error in table.errors]
    assert found == [(2, "uncertainty[2]"), (3, "uncertainty[0]"), (5, "compliance[0][1]")]
    assert "all 36 tangents or none" in table.errors[2].message


def test_a_file_of_hdf5_without_columns_says_so(tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["x"] = 1
    assert "no columns of one length" in only_error(read_hdf5(path.read_bytes())).message


def test_no_rows_say_so():
    assert only_error(read_hdf5(write_hdf5(Rows.empty(), (), META))).message == "there is no row"


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
        assert "rows/wrench outside of itself" in error.message
    assert "no group rows" in only_error(read_hdf5(changed(linked_group))).message


def test_a_small_file_cannot_unpack_to_more_than_memory_should_hold(changed):
    def swollen(file):
        del file["rows/wrench"]
        file["rows"].create_dataset("wrench", (10**9, 6), "f8", chunks=(1000, 6))

    content = changed(swollen)
    assert len(content) < 100_000
    assert "unpacks to more than 1024 MiB" in only_error(read_hdf5(content)).message


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
    assert "may mean packed or unpacked values" in error.message


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
