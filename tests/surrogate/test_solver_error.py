"""The solver's own share of a bar: the same digits one by one and in an array, and in a file."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surrogate.build import build
from surrogate.solver_error import SolverError
from surrogate.table.hdf5 import read_table, write_table
from surrogate.table.meta import TableMeta
from surrogate.table.rows import LoadRange, Rows

MESH = np.abs(np.random.default_rng(5).normal(size=(6, 6))) * 1e-6
LOADS = [1e3, 1e3, 2e3, 10.0, 10.0, 0.0]
TOLD = {"mesh": MESH.tolist(), "loads": LOADS, "mesh_basis": "words"}
BENT = TOLD | {"linearity": [1e-5] * 3 + [1e-4] * 3, "buckling": None}
load = st.floats(-1e4, 1e4, allow_subnormal=False)


@settings(max_examples=50)
@given(st.lists(load, min_size=6, max_size=6), st.sampled_from([TOLD, BENT]))
def test_one_bar_and_many_are_widened_to_the_same_digits(wrench, told):
    error, bars = SolverError(told), (1e-9, 2e-9, 0.0, 1e-8, 1e-7, 3e-9)
    one = error.widened(bars, tuple(wrench))
    many = error.widened_many(np.array([bars, bars]), np.array([wrench, wrench]))
    assert one == tuple(many[0]) == tuple(many[1])


def test_the_parts_add_up_to_what_a_bar_grows_by():
    error, wrench = SolverError(BENT), [100.0, -200.0, 3.0, 1.0, -2.0, 0.0]
    parts = error.parts(wrench)
    np.testing.assert_allclose(parts["mesh"], MESH @ np.abs(wrench), rtol=1e-5)
    np.testing.assert_allclose(parts["linearity"], 0.2**2 * np.array(BENT["linearity"]))
    grown = np.sum([parts["mesh"], parts["linearity"]], axis=0)
    np.testing.assert_allclose(error.widened((0.0,) * 6, wrench), grown, rtol=1e-12)


def test_what_is_not_known_stays_unknown():
    error = SolverError({"mesh": None, "loads": LOADS, "mesh_basis": "why"})
    assert error.parts([1.0] * 6) == {"mesh": None}
    assert error.widened((1.0,) * 6, (1.0,) * 6) == (1.0,) * 6
    assert SolverError(TOLD).widened(None, (1.0,) * 6) is None
    assert SolverError(TOLD).widened((None, *(0.0,) * 5), (1.0,) * 6)[0] is None


@pytest.mark.parametrize(
    "told",
    [
        {},
        TOLD | {"mesh": [[1.0]]},
        TOLD | {"mesh": (-MESH).tolist()},
        TOLD | {"loads": [float("nan")] * 6},
        BENT | {"linearity": ["x"] * 6},
    ],
)
def test_what_is_no_estimate_is_refused(told):
    with pytest.raises(ValueError, match=r"solver's error|could not convert"):
        SolverError(told)


def test_a_table_file_carries_it_and_a_table_keeps_its_own_bars(tmp_path):
    span = LoadRange(-np.ones(6), np.ones(6))
    meta = TableMeta("part", 3, span, solver_error=BENT)
    write_table(tmp_path / "part.h5", Rows.empty(), meta)
    rows, read = read_table(tmp_path / "part.h5")
    assert read.solver_error == BENT
    table = build(rows, span, linear=True, solver_error=SolverError.read(read.solver_error))
    assert table.solver_error is not None
    assert table.answer([0.5] * 6).error is None
    write_table(tmp_path / "old.h5", Rows.empty(), TableMeta("part", 3, span))
    assert read_table(tmp_path / "old.h5")[1].solver_error is None


@pytest.mark.parametrize(
    ("source", "told", "whole"),
    [
        ("fea", None, False),
        ("fea", TOLD | {"mesh": None}, False),
        ("fea", TOLD, True),
        ("measured", None, True),
    ],
)
def test_bars_of_solved_rows_are_whole_only_with_what_the_solver_may_be_wrong_by(
    source, told, whole
):
    rows = Rows.of(0.5 * np.eye(6), 1e-3 * np.eye(6), source=["measured"] * 5 + [source])
    table = build(rows, LoadRange(-np.ones(6), np.ones(6)), solver_error=told and SolverError(told))
    assert table.bars_are_whole is whole
