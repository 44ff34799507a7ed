"""The solver's own share of an error bar."""

import numpy as np
import pytest

from tests.surrogate.law import build, mesh_errors
from tests.surrogate.softening import SHORT, SOFT, column, softening_table
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

MESH = np.abs(np.random.default_rng(5).normal(size=(6, 6))) * 1e-6
LOADS = [1e3, 1e3, 2e3, 10.0, 10.0, 0.0]
TOLD = {"mesh": MESH.tolist(), "loads": LOADS, "mesh_basis": "words"}
BENT = TOLD | {"linearity": [1e-5] * 3 + [1e-4] * 3, "buckling": None}
UNIT = LoadRange(-np.ones(6), np.ones(6))


def test_the_parts_add_up_to_what_a_bar_grows_by():
    error, wrench = SolverError(BENT), [100.0, -200.0, 3.0, 1.0, -2.0, 0.0]
    parts = error.parts(wrench)
    np.testing.assert_allclose(parts["mesh"], MESH @ np.abs(wrench), rtol=1e-5)
    np.testing.assert_allclose(parts["linearity"], 0.2**2 * np.array(BENT["linearity"]))
    rows = Rows.of([wrench], np.ones(6), source=["fea"])
    result = packed_of(build(rows, UNIT, solver_error=error)).answer(rows.wrench[0].tolist())
    grown = np.sum([parts["mesh"], parts["linearity"]], axis=0)
    assert result.interpolation == (0.0,) * 6
    np.testing.assert_allclose(result.error, grown, rtol=1e-5)


def test_second_derivatives_make_the_linearity_error_a_function_of_the_loads_directions():
    second = np.random.default_rng(5).normal(size=(6, 6, 6)) * 1e-9
    second += second.swapaxes(1, 2)
    remainder, wrench = [1e-6] * 6, np.array([100.0, -200.0, 3.0, 1.0, -2.0, 0.0])
    told = {"second_derivatives": second.tolist(), "linearity_remainder": remainder}
    error = SolverError(BENT | told)
    expected = 0.5 * np.abs(second @ wrench @ wrench) + 0.2**3 * np.array(remainder)
    np.testing.assert_allclose(error.parts(wrench)["linearity"], expected, rtol=1e-12)
    assert error.at_full_range()["linearity"] == BENT["linearity"]
    rows = Rows.of([wrench], np.ones(6), source=["fea"])
    result = packed_of(build(rows, UNIT, solver_error=error)).answer(wrench.tolist())
    np.testing.assert_allclose(result.linearity, expected, rtol=1e-12)


def test_a_saturated_linearity_error_grows_in_the_end_with_the_load():
    """The law R s^3 (1 + b) / (1 + b s^2), or R s^2 (1 + b) / (1 + b s), at s = 0.2."""
    second, b = np.zeros((6, 6, 6)).tolist(), np.array([0.0, 1.0, 10.0, 0.0, 100.0, 0.5])
    told = BENT | {"linearity_saturation": b.tolist()}
    wrench, remainder = np.array([100.0, -200.0, 3.0, 1.0, -2.0, 0.0]), np.full(6, 1e-6)
    for more, size, power in (
        ({}, np.array(BENT["linearity"]), 0.2),
        ({"second_derivatives": second, "linearity_remainder": remainder}, remainder, 0.2**2),
    ):
        error = SolverError(told | more)
        expected = size * 0.2 * power * (1 + b) / (1 + b * power)
        np.testing.assert_allclose(error.parts(wrench)["linearity"], expected, rtol=1e-12)
        rows = Rows.of([wrench], np.ones(6), source=["fea"])
        result = packed_of(build(rows, UNIT, solver_error=error)).answer(wrench.tolist())
        np.testing.assert_allclose(result.linearity, expected, rtol=1e-12)


def test_what_is_not_known_stays_unknown():
    error = SolverError({"mesh": None, "loads": LOADS, "mesh_basis": "why"})
    assert error.parts([1.0] * 6) == {"mesh": None}
    rows = Rows.of(0.5 * np.eye(6), 1e-3 * np.eye(6), source=["fea"] * 6)
    result = packed_of(build(rows, UNIT, solver_error=error)).answer([0.1] * 6)
    assert result.discretisation is None
    assert result.error == result.interpolation
    nothing = packed_of(build(Rows.empty(), UNIT, solver_error=SolverError(TOLD)))
    assert nothing.answer([0.1] * 6).error is None


@pytest.mark.parametrize(
    "told",
    [
        {},
        TOLD | {"mesh": [[1.0]]},
        TOLD | {"mesh": (-MESH).tolist()},
        TOLD | {"loads": [float("nan")] * 6},
        BENT | {"linearity": ["x"] * 6},
        BENT | {"linearity_saturation": [-0.1] * 6},
        BENT | {"second_derivatives": [[0.0] * 6] * 6, "linearity_remainder": [0.0] * 6},
        BENT | {"second_derivatives": np.zeros((6, 6, 6)).tolist()},
        TOLD | {"mesh_stiffness": [[1.0]]},
    ],
)
def test_what_is_no_estimate_is_refused(told):
    with pytest.raises(ValueError, match=r"solver error|could not convert"):
        SolverError(told)


def lacking_of(rows):
    """Return what a column of those pushes lacks for its mesh, (k, 6)."""
    pushed = -rows.wrench[:, 0]
    return column(pushed, stiffer=-SHORT).displacement - rows.displacement


def shares_of(rows, tangents):
    """Return the mesh's share at rows (k, 6) by such tangents."""
    return mesh_errors(SolverError(SOFT), rows.wrench, rows.displacement, tangents)


def test_the_meshs_share_is_that_of_each_answer_where_a_part_softens():
    rows = column([0.0, 0.5, 0.8])
    lacking, reported = np.abs(lacking_of(rows)), shares_of(rows, rows.compliance)
    assert lacking[2, 2] > 24 * lacking[0, 2]
    # T D u is the first order of what the mesh changes: at 0.8 a few in a hundred are left out.
    assert (reported >= 0.96 * lacking).all()
    assert (reported[:, 2] <= 1.01 * lacking[:, 2]).all()


def test_an_output_of_second_order_has_its_meshs_share():
    rows = column([0.5])
    reported = shares_of(rows, rows.compliance)
    assert reported[0, 0] == pytest.approx(abs(lacking_of(rows)[0, 0]), rel=0.05)


def test_where_no_tangent_is_known_the_compliance_at_small_loads_stands_for_it():
    rows = column([0.5, 0.8])
    at_small = np.abs(rows.wrench) @ np.array(SOFT["mesh"]).T
    for unknown in (np.full((2, 6, 6), np.nan), np.zeros((2, 6, 6))):
        np.testing.assert_allclose(shares_of(rows, unknown), at_small, rtol=1e-12)


def test_an_estimate_of_an_older_version_still_gives_a_bar():
    """It has what its mesh lacks of the compliance, and no stiffness."""
    old = SolverError(
        {name: reported for name, reported in SOFT.items() if name != "mesh_stiffness"}
    )
    assert not old.can_grow
    table = build(softening_table().rows, UNIT, solver_error=old)
    wrench = column([0.62]).wrench[0].tolist()
    assert packed_of(table).answer(wrench).discretisation[2] == pytest.approx(SHORT * 0.01)
    assert table.bars_are_complete


def test_whole_bars_hold_what_the_mesh_lacks_and_not_twice_as_much():
    packed, pushed = packed_of(softening_table()), [0.05, 0.33, 0.62, 0.8]
    wrenches = column(pushed).wrench
    results = [packed.answer(wrench) for wrench in wrenches.tolist()]
    share = np.array([result.discretisation[2] for result in results])
    for one, errors in zip(results, packed.batch(wrenches).errors, strict=True):
        own = (np.nan,) * 6 if one.interpolation is None else one.interpolation
        np.testing.assert_allclose(np.add(own, one.discretisation), errors, rtol=1e-12)
    moved = np.array([result.outputs[2] for result in results])
    true = column(pushed, stiffer=-SHORT).displacement[:, 2] - moved
    assert (1.05 * share >= np.abs(true)).all()
    assert (share < 2 * np.abs(true)).all()


def test_a_row_beyond_the_range_has_its_own_share_whatever_the_others_say():
    rows, span = column([0.0, 0.1, 0.2, 0.8]), LoadRange(-0.3 * np.ones(6), np.ones(6))
    reported = SOFT | {"loads": [0.3, 1.0, 0.01, 1.0, 1.0, 1.0]}
    packed = packed_of(build(rows, span, solver_error=SolverError(reported)))
    result = packed.answer(rows.wrench[3].tolist())
    assert result.method == "row"
    assert 1.05 * result.error[2] >= lacking_of(rows)[3, 2]
    np.testing.assert_array_equal(packed.batch(rows.wrench[3:]).errors[0], result.error)


def test_a_row_without_a_tangent_has_the_meshs_share_by_that_of_the_method():
    rows = column(np.linspace(0.0, 0.85, 18))
    rows.compliance[9] = np.nan
    table = build(rows, UNIT, solver_error=SolverError(SOFT))
    result = packed_of(table).answer(rows.wrench[9].tolist(), [1e-12] * 6)
    assert result.method == "row"
    assert result.discretisation[2] == pytest.approx(abs(lacking_of(rows)[9, 2]), rel=0.15)


def test_a_table_file_carries_it_and_a_table_keeps_its_own_bars(tmp_path):
    meta = TableMeta("part", 3, UNIT, solver_error=BENT)
    write_table(tmp_path / "part.h5", Rows.empty(), meta)
    rows, read = read_table(tmp_path / "part.h5")
    assert read.solver_error == BENT
    table = build(rows, UNIT, linear=True, solver_error=SolverError.read(read.solver_error))
    assert table.solver_error is not None
    assert table.answer([0.5] * 6).error is None
    write_table(tmp_path / "old.h5", Rows.empty(), TableMeta("part", 3, UNIT))
    assert read_table(tmp_path / "old.h5")[1].solver_error is None


@pytest.mark.parametrize(
    ("source", "told", "whole"),
    [
        ("fea", None, False),
        ("fea", TOLD | {"mesh": None}, False),
        ("fea", TOLD, True),
        ("fea", TOLD | {"linearity": None}, False),
        ("measured", None, True),
    ],
)
def test_bars_of_solved_rows_are_whole_only_with_what_the_solver_may_be_wrong_by(
    source, told, whole
):
    rows = Rows.of(0.5 * np.eye(6), 1e-3 * np.eye(6), source=["measured"] * 5 + [source])
    table = build(rows, UNIT, solver_error=told and SolverError(told))
    assert table.bars_are_complete is whole
