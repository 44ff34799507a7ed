"""HDF5 of h5py and MATLAB files: a dataset or a variable a column."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.read import read_table_file

LOADS = {"Fz [kN]": [-0.5, -1.0, -1.5], "uz": [-0.1, -0.2, -0.31]}
EXPECTED = ([-500.0, -1000.0, -1500.0], [-1e-4, -2e-4, -3.1e-4])


def read(path: Path) -> tuple[tuple[list[float], list[float]], list[str]]:
    report = ReadReport()
    options = Options(missing_loads="zero")
    pieces = list(read_table_file(path, options, report))
    read = [] if report.mistakes.whole else pieces
    loads = [load for piece in read for load in piece.wrench[:, 2].tolist()]
    moved = [one for piece in read for one in piece.displacement[:, 2].tolist()]
    return (loads, moved), [mistake.message for mistake in report.mistakes.listed()]


def write(path: Path, columns: dict[str, Any], group: str = "", unit: str = "units") -> Path:
    with h5py.File(path, "w") as file:
        inside = file.require_group(group) if group else file
        for name, values in columns.items():
            inside[name] = values
        inside["uz"].attrs[unit] = "mm"
    return path


@pytest.mark.parametrize("group", ["", "run 3"])
@pytest.mark.parametrize("unit", ["unit", "units"])
def test_datasets_of_one_length_are_columns(tmp_path: Path, group: str, unit: str):
    assert read(write(tmp_path / "a", LOADS, group, unit)) == (EXPECTED, [])


def test_single_numbers_and_texts_beside_the_columns_are_left_out(tmp_path: Path):
    path = write(tmp_path / "a", {**LOADS, "rate": 100.0})
    assert read(path) == (EXPECTED, [])


def test_a_dataset_of_named_fields_is_a_table(tmp_path: Path):
    table = np.zeros(3, dtype=[("Fz [kN]", "f8"), ("uz_mm", "f8")])
    table["Fz [kN]"], table["uz_mm"] = LOADS["Fz [kN]"], LOADS["uz"]
    with h5py.File(tmp_path / "a", "w") as file:
        file["log"] = table
    assert read(tmp_path / "a") == (EXPECTED, [])


def test_a_matrix_names_its_columns_by_an_attribute(tmp_path: Path):
    with h5py.File(tmp_path / "a", "w") as file:
        file["log"] = np.column_stack(list(LOADS.values()))
        file["log"].attrs["columns"], file["log"].attrs["units"] = ["Fz", "uz"], ["kN", "mm"]
    assert read(tmp_path / "a") == (EXPECTED, [])


def test_matlab_vectors_of_level_7_3_are_columns(tmp_path: Path):
    columns = {name: np.array(values)[None] for name, values in LOADS.items()}
    assert read(write(tmp_path / "a", columns)) == (EXPECTED, [])


NAMED = {"Fz_kN": LOADS["Fz [kN]"], "uz_mm": LOADS["uz"]}


@pytest.mark.parametrize("content", [NAMED, {"log": NAMED}], ids=["variables", "struct"])
def test_matlab_vectors_are_columns(tmp_path: Path, content: dict[str, Any]):
    savemat(tmp_path / "a.mat", content)
    assert read(tmp_path / "a.mat") == (EXPECTED, [])


def test_an_empty_cell_of_a_load_is_named(tmp_path: Path):
    path = write(tmp_path / "a", {**LOADS, "Fz [kN]": [-0.5, np.nan, -1.5]})
    found, messages = read(path)
    assert found[0] == [-500.0, -1500.0]
    assert messages == ["is empty; write 0 for no load"]


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({**LOADS, "Fz [kN]": [1.0]}, "has no columns of one length (Fz [kN]: 1, uz [mm]: 3)"),
        ({**LOADS, "image": np.zeros((4, 4))}, "holds image of shape (4, 4)"),
        ({**LOADS, "z": np.zeros(3, dtype=complex)}, "type complex128"),
    ],
)
def test_hdf5_that_is_no_table_says_why(tmp_path: Path, columns: dict[str, Any], says: str):
    found, (message,) = read(write(tmp_path / "a", columns))
    assert found == ([], [])
    assert says in message


def test_data_in_another_file_is_refused(tmp_path: Path):
    other = write(tmp_path / "other", LOADS)
    with h5py.File(tmp_path / "a", "w") as file:
        file["uz"] = h5py.ExternalLink(str(other), "uz")
        file["Fz [kN]"] = LOADS["Fz [kN]"]
    found, (message,) = read(tmp_path / "a")
    assert found == ([], [])
    assert "points to data in other files" in message


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"a": [1.0, 2.0], "b": [1.0, 2.0, 3.0]}, "their lengths are [2, 3]"),
        ({"a": np.zeros((2, 2))}, "a is none"),
        ({"a": np.array([1, "x"], dtype=object)}, "a is none"),
        ({"a": "1"}, "no table of numeric vectors"),
    ],
)
def test_a_matlab_file_that_is_no_table_says_why(tmp_path: Path, content: dict, says: str):
    savemat(tmp_path / "a.mat", content)
    found, (message,) = read(tmp_path / "a.mat")
    assert found == ([], [])
    assert says in message


@pytest.mark.parametrize("cut", [120, 200, 300])
def test_a_damaged_matlab_file_is_named(tmp_path: Path, cut: int):
    savemat(tmp_path / "a.mat", NAMED)
    path = tmp_path / "b.mat"
    path.write_bytes((tmp_path / "a.mat").read_bytes()[:cut])
    found, (message,) = read(path)
    assert found == ([], [])
    assert "is no readable MATLAB file" in message or "no table" in message
