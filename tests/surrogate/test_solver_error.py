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
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

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
    ],
)
def test_what_is_no_estimate_is_refused(told):
    with pytest.raises(ValueError, match=r"solver's error|could not convert"):
        SolverError(told)


def lacking_of(rows):
    """Return what a column of those pushes lacks for its mesh, (k, 6)."""
    pushed = -rows.wrench[:, 0]
    return column(pushed, stiffer=-SHORT).displacement - rows.displacement


def shares_of(rows, tangents):
    """Return the mesh's share at rows (k, 6) by such tangents."""
    none = np.zeros((len(rows), 6))
    return widened_many(SolverError(SOFT), none, rows.wrench, rows.displacement, tangents)


def test_the_meshs_share_is_that_of_each_answer_where_a_part_softens():
    rows = column([0.0, 0.5, 0.8])
    lacking, told = np.abs(lacking_of(rows)), shares_of(rows, rows.compliance)
    assert lacking[2, 2] > 24 * lacking[0, 2]
    # T D u is the first order of what the mesh changes: at 0.8 a few in a hundred are left out.
    assert (told >= 0.96 * lacking).all()
    assert (told[:, 2] <= 1.01 * lacking[:, 2]).all()


def test_an_output_of_second_order_has_its_meshs_share():
    rows = column([0.5])
    told = shares_of(rows, rows.compliance)
    assert told[0, 0] == pytest.approx(abs(lacking_of(rows)[0, 0]), rel=0.05)


def test_where_no_tangent_is_known_the_compliance_at_small_loads_stands_for_it():
    rows = column([0.5, 0.8])
    at_small = np.abs(rows.wrench) @ np.array(SOFT["mesh"]).T
    for unknown in (None, np.full((2, 6, 6), np.nan), np.zeros((2, 6, 6))):
        np.testing.assert_allclose(shares_of(rows, unknown), at_small, rtol=1e-12)


def test_an_estimate_of_an_older_version_still_gives_a_bar():
    """It has what its mesh lacks of the compliance, and no stiffness."""
    old = SolverError({name: told for name, told in SOFT.items() if name != "mesh_stiffness"})
    assert not old.can_grow
    table = build(softening_table().rows, LoadRange(-np.ones(6), np.ones(6)), solver_error=old)
    wrench = column([0.62]).wrench[0].tolist()
    parts = solver_parts(table, wrench, table.answer(wrench), None)
    assert parts["mesh"][2] == pytest.approx(SHORT * 0.01)
    assert table.bars_are_complete


def test_whole_bars_are_the_same_one_by_one_and_in_a_batch_and_hold_the_mesh():
    table = softening_table()
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
    bar = whole_bar(table, wrench, answer, None)
    assert 1.05 * bar[2] >= lacking_of(rows)[3, 2]
    many = whole_bars(table, rows.wrench[3:], table.batch(rows.wrench[3:]))
    np.testing.assert_array_equal(many[0], np.array(bar, dtype=float))


def test_a_row_without_a_tangent_has_the_meshs_share_by_that_of_the_method():
    rows = column(np.linspace(0.0, 0.85, 18))
    rows.compliance[9] = np.nan
    table = build(rows, LoadRange(-np.ones(6), np.ones(6)), solver_error=SolverError(SOFT))
    wrench = rows.wrench[9].tolist()
    answer = table.answer(wrench, Tolerance(1e-12, 1e-12))
    assert answer.method == "row"
    mesh = solver_parts(table, wrench, answer, None)["mesh"]
    assert mesh[2] == pytest.approx(abs(lacking_of(rows)[9, 2]), rel=0.15)


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
