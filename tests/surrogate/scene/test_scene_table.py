"""A packed table cut to a scene: the same bits as the whole, from less."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.surrogate.kernel.kinds import table_of
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, coupled, full_wrenches, table
from wrenchbook.surrogate.answer import UnknownMethodError
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import Need, need_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Input, space_of

PLANAR = (0, 2, 4)  # fx, fz, my
MESH = SolverError(
    {
        "mesh": np.full((6, 6), 1e-9).tolist(),
        "mesh_stiffness": np.full((6, 6), 10.0).tolist(),
        "loads": HIGH.tolist(),
    }
)


@cache
def built(kind: str) -> Table:
    """Tables of each default method, and one of a rig that measured some outputs in some rows."""
    mixed = np.concatenate((np.zeros((1, 6)), clean_wrenches(9, 1), full_wrenches(25, 2)))
    if kind == "kriging":
        rows = solved(RESPONSES["hardening"], full_wrenches(40, 3))
        return build(rows, RANGE, solver_error=MESH)
    if kind == "axes":  # of a linear component of which no row tells M_z there is no kriging
        reported = np.unique(clean_wrenches(14, 4) * np.array([1, 1, 1, 1, 1, 0]), axis=0)
        return build(table(coupled, reported), RANGE, linear=True)
    if kind == "clean":
        return build(table(coupled, clean_wrenches(14, 4)), RANGE)
    if kind == "clean and full":
        return build(table(coupled, mixed), RANGE, tolerance=Tolerance(1e-4, 1e-3))
    if kind == "linear":
        return build(solved(RESPONSES["nearly_linear"], full_wrenches(1, 5)), RANGE, linear=True)
    if kind == "few":
        return build(solved(RESPONSES["hardening"], full_wrenches(2, 5)), RANGE)
    if kind == "in part measured":
        rows = table(coupled, mixed)
        rows.displacement[20:, 3:] = np.nan
        return build(rows, RANGE, solver_error=MESH)
    if kind in ("softening", "second derivatives"):
        return table_of(kind)
    rows = table(coupled, mixed)
    lacking = rows.displacement.copy()
    lacking[10:, 3:] = np.nan
    lacking[:, 1] = np.nan
    return build(Rows.of(rows.wrench, lacking), RANGE)


KINDS = (
    *("kriging", "second derivatives", "axes", "clean", "clean and full"),
    *("linear", "few", "softening", "partial", "in part measured"),
)


def packed(full: Table) -> PackedTable:
    return PackedTable.from_bytes(b"".join(pack(full)))


@cache
def whole(kind: str) -> PackedTable:
    return packed(built(kind))


def scene_of(full: PackedTable, wanted: Need, plan: dict | None = None) -> PackedTable:
    content = cut(full, wanted, plan)
    return PackedTable.from_bytes(b"".join(content))


def need(
    loads: tuple[int, ...] = PLANAR, outputs: tuple[int, ...] = tuple(range(6)), kind: str = ""
) -> Need:
    span = built(kind).load_range if kind else RANGE
    ends = np.column_stack((span.low, span.high)) * np.isin(np.arange(6), loads)[:, None]
    return need_of(span, ends, outputs)


def within(wanted: Need, count: int = 60, seed: int = 9) -> np.ndarray:
    low, high = wanted.span.low, wanted.span.high
    return np.random.default_rng(seed).uniform(size=(count, 6)) * (high - low) + low


def assert_same(part: PackedTable, full: PackedTable, wanted: Need, wrenches: np.ndarray) -> None:
    """Compare the outputs that are read, and coverage where those are all there are.

    An output that is not read may be beyond 20 degrees or 10 m: then the whole gives no estimate.
    """
    read = list(wanted.outputs)
    given = np.isfinite(full.batch(wrenches).outputs).any(axis=1) | (len(read) == 6)
    own, other = part.batch(wrenches[given]), full.batch(wrenches[given])
    np.testing.assert_array_equal(own.outputs[:, read], other.outputs[:, read])
    if len(read) == 6:
        np.testing.assert_array_equal(own.errors, other.errors)
        np.testing.assert_array_equal(own.coverage, other.coverage)
    known = np.isfinite(other.errors[:, read])
    np.testing.assert_array_equal(own.errors[:, read][known], other.errors[:, read][known])
    held = np.isfinite(other.outputs[:, read]).any(axis=1)  # where none is, a scene is outside
    assert (own.coverage <= other.coverage)[held].all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_planar_scene_has_the_bits_of_the_whole_table(kind: str) -> None:
    wanted = need(kind=kind)
    rows = built(kind).rows.wrench * np.isin(np.arange(6), PLANAR)
    asked = np.concatenate((within(wanted), rows[:10], np.zeros((1, 6))))
    assert_same(scene_of(whole(kind), wanted), whole(kind), wanted, asked)


@pytest.mark.parametrize("kind", KINDS)
def test_single_replies_are_those_of_the_whole_table(kind: str) -> None:
    wanted = need(kind=kind)
    part = scene_of(whole(kind), wanted)
    for wrench in np.concatenate((within(wanted, 12), np.zeros((1, 6)))).tolist():
        assert part.answer(wrench) == whole(kind).answer(wrench)


@settings(max_examples=60)
@example("in part measured", [(0.0, 0.0)] * 6, ["zero"] * 6, {0})  # answered by a row not read
@given(
    kind=st.sampled_from(KINDS),
    ends=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=6, max_size=6),
    held=st.lists(st.sampled_from(["free", "zero", "fixed"]), min_size=6, max_size=6),
    outputs=st.sets(st.integers(0, 5), min_size=1),
)
def test_any_scene_has_the_bits_of_the_whole_table(kind, ends, held, outputs) -> None:
    span = built(kind).load_range
    bounds = np.array([sorted(pair) for pair in ends]) * np.minimum(span.high, -span.low)[:, None]
    for load, how in enumerate(held):
        if how == "zero":
            bounds[load] = 0.0
        elif how == "fixed":
            bounds[load] = bounds[load, 0]
    wanted = need_of(span, bounds, tuple(outputs))
    assert_same(scene_of(whole(kind), wanted), whole(kind), wanted, within(wanted, 20))


@pytest.mark.parametrize("kind", ["kriging", "in part measured"])
def test_the_discretisation_error_follows_from_outputs_too_that_are_not_read(kind: str) -> None:
    wanted = need(PLANAR, (2,))
    for wrench in within(wanted, 5).tolist():
        own, other = scene_of(whole(kind), wanted).answer(wrench), whole(kind).answer(wrench)
        assert own.discretisation is not None
        assert other.discretisation is not None
        assert own.discretisation[2] == other.discretisation[2] > 0


def test_the_file_carries_the_plan_and_the_outputs_that_are_read() -> None:
    part = scene_of(whole("kriging"), need(PLANAR, (2, 4)), {"decision": "table"})
    assert part.meta["scene"] == {"outputs": ["uz", "ry"], "plan": {"decision": "table"}}


def test_a_scene_of_one_axis_keeps_less_than_two_thirds_of_the_bytes() -> None:
    assert scene_of(whole("axes"), need((2,))).size < whole("axes").size * 2 / 3


def test_an_output_that_is_not_read_is_not_answered_and_not_judged() -> None:
    tight = (1e-12,) * 3 + (1.0,) * 3  # no translation is that sure, every rotation is
    wanted = need(PLANAR, (3, 4))
    wrench = within(wanted, 1)[0].tolist()
    result = scene_of(whole("kriging"), wanted).answer(wrench, tight)
    assert result.coverage == "covered"
    assert result.outputs is not None
    assert [output is None for output in result.outputs] == [True] * 3 + [False, False, True]
    assert result.missing == ("ux", "uy", "uz", "rz")
    assert whole("kriging").answer(wrench, tight).coverage == "thin"


def test_a_load_that_cannot_occur_has_no_answer_and_is_named() -> None:
    part = scene_of(whole("kriging"), need())
    result = part.answer([10.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    assert (result.coverage, result.outputs, result.error) == ("outside", None, None)
    assert result.reason == "fy = 3 N cannot occur in the scene: 0..0 N"
    assert np.isnan(part.batch([[10.0, 3.0, 0.0, 0.0, 0.0, 0.0]]).outputs).all()


def test_a_load_beyond_the_scenes_range_is_flagged_and_estimated_without_an_error() -> None:
    part = scene_of(whole("kriging"), need_of(RANGE, np.array([[-10.0, 10.0]] * 6)))
    wrench = [11.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    result = part.answer(wrench)
    assert (result.coverage, result.error) == ("outside", None)
    assert result.outputs == whole("kriging").answer(wrench).outputs


def test_a_row_of_the_scene_answers_its_own_wrench_where_nothing_else_does() -> None:
    rows = built("axes").rows.wrench
    part = scene_of(whole("axes"), need((0, 4, 5)))
    occurring = rows[(rows[:, [1, 2, 3]] == 0).all(axis=1)]
    assert len(occurring)
    for wrench in occurring.tolist():
        result = part.answer(wrench, (1e-12,) * 6)
        assert result.method == "row"
        assert result == whole("axes").answer(wrench, (1e-12,) * 6)
    assert len(part.arrays["g0/row/wrench"]) == len(occurring) < len(rows)


def test_a_row_beyond_the_scene_answers_nothing() -> None:
    wrench = built("axes").rows.wrench[0].tolist()
    part = scene_of(whole("axes"), need_of(RANGE, np.array([[-1e-3, 1e-3]] * 6)))
    assert part.answer(wrench).coverage == "outside"


@pytest.mark.parametrize("kind", KINDS)
def test_the_derivative_by_loads_that_occur_is_that_of_the_whole_table(kind: str) -> None:
    wanted = need(kind=kind)
    asked, full = within(wanted, 10), whole(kind)
    own, other = scene_of(full, wanted).derivatives(asked), full.derivatives(asked)
    np.testing.assert_array_equal(own[:, :, PLANAR], other[:, :, PLANAR])
    unknown = np.isnan(own) & np.isfinite(other)
    assert not unknown[:, :, PLANAR].any()


def test_the_derivative_by_a_load_of_an_axis_that_is_left_out_is_unknown() -> None:
    result = scene_of(whole("axes"), need((2,))).derivatives(within(need((2,)), 3))
    assert np.isnan(result[:, :, [0, 1, 3, 4, 5]]).all()
    assert np.isfinite(result[:, :, 2]).all()


def test_a_method_that_is_not_kept_is_refused_by_name() -> None:
    part = scene_of(whole("kriging"), need())
    assert part.answer([0.0] * 6, method="kriging").method == "kriging"
    with pytest.raises(UnknownMethodError, match="download the complete table"):
        part.answer([0.0] * 6, method="griddata")


def test_a_load_on_a_locked_freedom_changes_nothing() -> None:
    bounds = np.column_stack((-HIGH, HIGH))
    wanted = need_of(RANGE, bounds, idle=(5,))
    assert wanted.loads == ["fx", "fy", "fz", "mx", "my"]
    part = scene_of(whole("kriging"), wanted)
    free, loaded = ([50.0, 0.0, 0.0, 0.0, 0.0, mz] for mz in (0.0, 1e9))
    assert part.answer(free) == part.answer(loaded)


def test_a_scene_without_rows_answers_that_there_are_none() -> None:
    part = scene_of(packed(build(Rows.empty(), RANGE)), need())
    result = part.answer([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert (result.coverage, result.outputs, result.reason) == (
        "outside", None, "the table has no rows",
    )  # fmt: skip


def test_only_rotations_of_a_rig_that_measured_none_are_nothing() -> None:
    rows = table(coupled, full_wrenches(30, 1))
    moved = rows.displacement.copy()
    moved[:, 3:] = np.nan
    full = packed(build(Rows.of(rows.wrench, moved), RANGE))
    part = scene_of(full, need(PLANAR, (3, 4, 5)))
    for wrench in ([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 6):
        result = part.answer(wrench)
        assert (result.outputs, result.coverage) == (None, "outside")
        assert result.reason == "not measured in any row: rx, ry, rz"


@pytest.mark.parametrize(("temperature", "loads"), [(0.0, ["temperature"]), (20.0, [])])
def test_a_temperature_other_than_its_reference_occurs_in_a_scene(temperature, loads):
    space = space_of(("left", "right"), [Input("temperature", "degC", "scalar", zero=20.0)])
    ends = np.array([[0.0, 0.0]] * 12 + [[temperature, temperature]])
    wanted = need_of(LoadRange([-1.0] * 12 + [0.0], [1.0] * 12 + [40.0], space), ends)
    assert wanted.loads == loads
