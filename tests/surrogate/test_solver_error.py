"""The solver's own share of an error bar."""

import numpy as np
import pytest
from hypothesis import strategies as st

from tests.surrogate.law import build
from tests.surrogate.law.solver_share import widened, widened_many
from tests.surrogate.law.whole_bars import solver_parts, whole_bar, whole_bars
from tests.surrogate.softening import SHORT, SOFT, column, softening_table
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

MESH = np.abs(np.random.default_rng(5).normal(size=(6, 6))) * 1e-6
LOADS = [1e3, 1e3, 2e3, 10.0, 10.0, 0.0]
TOLD = {"mesh": MESH.tolist(), "loads": LOADS, "mesh_basis": "words"}
BENT = TOLD | {"linearity": [1e-5] * 3 + [1e-4] * 3, "buckling": None}
load = st.floats(-1e4, 1e4, allow_subnormal=False)


def test_the_parts_add_up_to_what_a_bar_grows_by():
    error, wrench = SolverError(BENT), [100.0, -200.0, 3.0, 1.0, -2.0, 0.0]
    parts = error.parts(wrench)
    np.testing.assert_allclose(parts["mesh"], MESH @ np.abs(wrench), rtol=1e-5)
    np.testing.assert_allclose(parts["linearity"], 0.2**2 * np.array(BENT["linearity"]))
    grown = np.sum([parts["mesh"], parts["linearity"]], axis=0)
    np.testing.assert_allclose(widened(error, (0.0,) * 6, wrench), grown, rtol=1e-12)


def test_what_is_not_known_stays_unknown():
    error = SolverError({"mesh": None, "loads": LOADS, "mesh_basis": "why"})
    assert error.parts([1.0] * 6) == {"mesh": None}
    assert widened(error, (1.0,) * 6, (1.0,) * 6) == (1.0,) * 6
    assert widened(SolverError(TOLD), None, (1.0,) * 6) is None
    assert widened(SolverError(TOLD), (None, *(0.0,) * 5), (1.0,) * 6)[0] is None


@pytest.mark.parametrize(
    "told",
    [
        {},
        TOLD | {"mesh": [[1.0]]},
        TOLD | {"mesh": (-MESH).tolist()},
        TOLD | {"loads": [float("nan")] * 6},
        BENT | {"linearity": ["x"] * 6},
        TOLD | {"mesh_stiffness": [[1.0]]},
        TOLD | {"mesh_growth": [-1.0] * 6},
    ],
)
def test_what_is_no_estimate_is_refused(told):
    with pytest.raises(ValueError, match=r"solver's error|could not convert"):
        SolverError(told)


def test_the_meshs_share_grows_as_rows_say_where_a_part_softens():
    rows = column([0.0, 0.5, 0.8])
    lacking = column([0.0, 0.5, 0.8], stiffer=-SHORT).displacement - rows.displacement
    assert abs(lacking[2, 2] / lacking[0, 2]) > 24
    told = widened_many(SolverError(SOFT).grown(rows), np.zeros((3, 6)), rows.wrench)
    # T D u is the first order of what the mesh changes: at 0.8 a few in a hundred are left out.
    assert (1.04 * told >= np.abs(lacking)).all()
    assert told[2, 2] < 1.2 * abs(lacking[2, 2])


def told_by_tangents(rows):
    """Return the mesh's share at rows (k, 6) by their own tangents."""
    error = SolverError(SOFT).grown(rows)
    return widened_many(
        error, np.zeros((len(rows), 6)), rows.wrench, rows.displacement, rows.compliance
    )


def test_with_the_tangent_the_meshs_share_is_that_of_each_answer():
    rows = column([0.0, 0.5, 0.8])
    lacking = column([0.0, 0.5, 0.8], stiffer=-SHORT).displacement - rows.displacement
    assert SolverError(SOFT).grown(rows).needs_tangent
    np.testing.assert_allclose(told_by_tangents(rows), np.abs(lacking), rtol=0.05, atol=1e-12)


def test_where_no_tangent_is_known_the_square_of_the_load_stands_for_it():
    rows = column([0.5, 0.8])
    error = SolverError(SOFT).grown(rows)
    by_square = widened_many(error, np.zeros((2, 6)), rows.wrench)
    for unknown in (np.full((2, 6, 6), np.nan), np.zeros((2, 6, 6))):
        told = widened_many(error, np.zeros((2, 6)), rows.wrench, rows.displacement, unknown)
        np.testing.assert_array_equal(told, by_square)


def test_whole_bars_are_the_same_one_by_one_and_in_a_batch_and_hold_the_mesh():
    table = softening_table()
    assert table.solver_error.needs_tangent
    asked = column([0.05, 0.33, 0.62, 0.8]).wrench
    found = table.batch(asked)
    many, share = whole_bars(table, asked, found), []
    for wrench, bars in zip(asked.tolist(), many, strict=True):
        answer = table.answer(wrench)
        one = whole_bar(table, wrench, answer, None)
        np.testing.assert_array_equal(np.array(one, dtype=float), bars)
        parts = solver_parts(table, wrench, answer, None)["mesh"]
        share.append(parts[2])
        own = (np.nan,) * 6 if answer.error is None else answer.error
        np.testing.assert_allclose(np.add(own, parts), bars, rtol=1e-12)
    true = column([0.05, 0.33, 0.62, 0.8], stiffer=-SHORT).displacement - found.displacement
    assert (1.05 * np.array(share) >= np.abs(true[:, 2])).all()
    assert (np.array(share) < 2 * np.abs(true[:, 2])).all()


def test_a_row_beyond_the_range_has_its_own_share_whatever_the_others_say():
    rows, span = column([0.0, 0.1, 0.2, 0.8]), LoadRange(-0.3 * np.ones(6), np.ones(6))
    told = SOFT | {"loads": [0.3, 1.0, 0.01, 1.0, 1.0, 1.0]}
    table = build(rows, span, solver_error=SolverError(told))
    wrench = rows.wrench[3].tolist()
    answer = table.answer(wrench)
    assert answer.method == "row"
    lacking = column([0.8], stiffer=-SHORT).displacement[0] - rows.displacement[3]
    bar = whole_bar(table, wrench, answer, None)
    assert 1.05 * bar[2] >= lacking[2]
    many = whole_bars(table, rows.wrench[3:], table.batch(rows.wrench[3:]))
    np.testing.assert_array_equal(many[0], np.array(bar, dtype=float))


def test_an_output_of_second_order_has_its_meshs_share():
    rows = column([0.5])
    bars = SolverError(SOFT).grown(rows).parts(rows.wrench[0].tolist())["mesh"]
    lacking = column([0.5], stiffer=-SHORT).displacement - rows.displacement
    assert bars[0] == pytest.approx(abs(lacking[0, 0]), rel=0.05)


def test_rows_of_a_linear_part_and_measured_ones_tell_of_no_growth():
    chance = np.random.default_rng(8)
    half, wrench = chance.normal(size=(6, 6)), chance.uniform(-1, 1, (20, 6))
    compliance = half @ half.T
    short = 0.1 * compliance
    stiffness = np.linalg.inv(compliance)
    told = {
        "mesh": np.abs(short).tolist(),
        "mesh_stiffness": (stiffness @ short @ stiffness).tolist(),
        "loads": [1.0] * 6,
    }
    tangents = np.tile(compliance, (20, 1, 1))
    linear = Rows.of(wrench, wrench @ compliance, compliance=tangents, source=["fea"] * 20)
    full = SolverError(told).at_full_range()["mesh"]
    assert (SolverError(told).grown(linear).growth <= 1e-9 * np.array(full)).all()
    measured = Rows.of(wrench, 9 * wrench @ compliance, compliance=9 * tangents)
    assert not SolverError(told).grown(measured).growth.any()


def test_rows_beyond_a_range_that_is_not_symmetric_tell_of_no_growth():
    pulled = LoadRange(np.array([-0.1, -1, -1, -1, -1, -1]), np.ones(6))
    error = SolverError(SOFT)
    assert not build(column([0.8]), pulled, solver_error=error).solver_error.growth.any()
    pushed = LoadRange(-np.ones(6), np.array([0.1, 1, 1, 1, 1, 1]))
    assert build(column([0.8]), pushed, solver_error=error).solver_error.growth[2] > 0


def test_growth_told_twice_is_the_same_and_goes_with_the_table_file(tmp_path):
    rows, span = column([0.3, 0.8]), LoadRange(-np.ones(6), np.ones(6))
    error = SolverError(SOFT).grown(rows)
    assert error.grown(rows).values == error.values
    write_table(tmp_path / "c.h5", rows, TableMeta("c", 3, span, solver_error=error.values))
    back, meta = read_table(tmp_path / "c.h5")
    table = build(back, span, solver_error=SolverError.read(meta.solver_error))
    assert table.solver_error.values == error.values


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
    assert table.bars_are_complete is whole
