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
    assert table.row.tolist() == [1, 4, 5]


def test_an_uncertainty_below_zero_and_half_a_tangent_are_named():
    uncertainty = np.zeros((6, 6))
    uncertainty[1, 2], uncertainty[2, 0] = -1, np.inf
    compliance = np.full((6, 6, 6), np.nan)
    compliance[4, 0, 0] = 1.0
    rows = Rows.of(ROWS.wrench, ROWS.displacement, uncertainty=uncertainty, compliance=compliance)
    table = read_hdf5(write_hdf5(rows, range(6), META))
    found = [(error.row, error.field) for error in table.errors]
    assert found == [(2, "uncertainty[2]"), (3, "uncertainty[0]"), (5, "compliance")]
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
