"""The scene plan: what it decides, and that filling follows it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, coupled, full_wrenches, table
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.reasons import UNKNOWN_ERROR
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.scene.plan import (
    Need,
    NeedError,
    design_of,
    first_solves,
    need_of,
    plan_of,
)
from wrenchbook.surrogate.scene.savings import measured
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import OUTPUTS

TIGHT, LOOSE = Tolerance(1e-9, 1e-9), Tolerance(1.0, 1.0)


CORNERS = np.array(list(product((-1.0, 1.0), repeat=6)))
COUNTS = {"strongly_coupled": 150}  # the kriging's errors are known with more rows alone


@cache
def filled(kind: str = "hardening") -> Table:
    """Return a table whose errors are known up to the corners of the range."""
    return build(solved(RESPONSES[kind], spread(COUNTS.get(kind, 40))), RANGE)


def spread(count: int) -> np.ndarray:
    """Return the corners of all six loads and random wrenches, scaled, (64 + count, 6)."""
    return np.concatenate((CORNERS, full_wrenches(count, 3)))


def empty(**more: bool) -> Table:
    return build(Rows.empty(), RANGE, **more)  # type: ignore[arg-type]


def need(spans: dict[int, tuple[float, float]], **more: object) -> Need:
    """Return a need of scaled spans by load; the others cannot occur."""
    bounds = np.zeros((6, 2))
    for load, ends in spans.items():
        bounds[load] = np.array(ends) * HIGH[load]
    return need_of(RANGE, bounds, **more)  # type: ignore[arg-type]


PLANAR = {0: (-1.0, 1.0), 2: (-1.0, 1.0), 4: (-1.0, 1.0)}


def test_loads_that_cannot_occur_drop_their_dimension_on_every_axis() -> None:
    reported = need({0: (-1, 1), 2: (0, 1), 4: (0.5, 0.5)}).axes()
    assert reported == {
        "x": {"inputs": ["fx", "my"], "dimensions": 1},
        "z": {"inputs": ["fz", "my"], "dimensions": 1},
    }


def test_an_axis_none_of_whose_outputs_is_read_is_not_composed() -> None:
    assert list(need(PLANAR, outputs=(2,)).axes()) == ["z"]
    assert list(need(PLANAR, outputs=(3,)).axes()) == ["x", "z"]


def test_a_planar_scene_needs_six_first_solves_instead_of_nine() -> None:
    assert plan_of(empty(), need(PLANAR)).solves == (9, 6)


@pytest.mark.parametrize("kind", ["empty", "filled"])
def test_the_solves_that_a_fill_asks_for_are_those_of_the_plan(kind: str) -> None:
    bare, wanted = empty(), need(PLANAR)
    plan = plan_of(bare if kind == "empty" else filled(), wanted)
    design = design_of(bare, plan, 100)
    # Its rows show that solves of the filled table bring no second derivatives.
    assert plan.solves[1] == {"empty": 6, "filled": 9}[kind]
    assert len(design.wrenches) == 6
    assert (design.wrenches[:, [1, 3, 5]] == 0).all()


def test_without_rows_the_plan_says_what_one_solve_would_tell() -> None:
    plan = plan_of(empty(), need(PLANAR, tolerance=TIGHT))
    assert plan.decision == "table"
    assert "solve one wrench for the tangent compliance" in plan.reason
    assert np.isnan(plan.bound).all()


def test_one_solve_tells_no_bound_since_no_row_shows_how_large_errors_are() -> None:
    one = build(solved(RESPONSES["hardening"], full_wrenches(1, 1)), RANGE)
    plan = plan_of(one, need(PLANAR))
    assert np.isnan(plan.bound).all()
    assert plan.reason == UNKNOWN_ERROR
    assert np.isfinite(plan_of(filled(), need(PLANAR)).bound).all()


def test_a_component_that_moves_less_than_the_tolerance_is_rigid_and_needs_no_solve() -> None:
    plan = plan_of(filled(), need(PLANAR, tolerance=LOOSE))
    assert (plan.decision, plan.solves) == ("rigid", (15, 0))
    design = design_of(filled(), plan, 10)
    assert (len(design.wrenches), design.stage) == (0, "met")


def test_outputs_that_are_not_read_have_no_say_in_rigid() -> None:
    table_, only_rotation = filled(), Tolerance(1e-9, 1.0)
    assert plan_of(table_, need(PLANAR, tolerance=only_rotation)).decision == "table"
    read = need(PLANAR, tolerance=only_rotation, outputs=(3, 4, 5))
    assert plan_of(table_, read).decision == "rigid"


def test_the_bound_holds_what_the_solver_may_be_wrong_by() -> None:
    own = build(solved(RESPONSES["smooth"], spread(40)), RANGE)
    before = plan_of(own, need(PLANAR)).bound
    reported = {"mesh": np.full((6, 6), 1e-6).tolist(), "loads": HIGH.tolist()}
    own.solver_error = SolverError(reported)
    after = plan_of(own, need(PLANAR)).bound
    loads = np.abs([need(PLANAR).span.low, need(PLANAR).span.high]).max(axis=0)
    np.testing.assert_allclose(after - before, 1e-6 * loads.sum(), rtol=1e-6)


def test_no_answer_of_the_scene_exceeds_the_bound() -> None:
    for kind in ("hardening", "smooth", "strongly_coupled", "boundary_layer"):
        wanted = need({0: (0, 1), 2: (-1, 0.2), 3: (-1, 1), 5: (0.3, 0.3)})
        bound = plan_of(filled(kind), wanted).bound
        low, high = wanted.span.low, wanted.span.high
        asked = low + np.random.default_rng(5).uniform(size=(4000, 6)) * (high - low)
        assert (np.abs(RESPONSES[kind](asked / HIGH)) <= bound).all(), kind


@pytest.mark.parametrize("size", [1e-6, 1e-2])
def test_a_scene_of_small_loads_is_bounded_by_what_they_do(size: float) -> None:
    """A load of 0.001 N was said to move a plate by up to 0.4 mm, and never was rigid."""
    table_ = build(solved(RESPONSES["smooth"], full_wrenches(80, 3)), RANGE, tolerance=LOOSE)
    wanted = need({0: (-size, size), 4: (0.0, size)})
    plan = plan_of(table_, wanted)
    corners = np.array([[x, 0, 0, 0, m, 0] for x in (-size, size) for m in (0, size)])
    moved = np.abs(RESPONSES["smooth"](corners)).max(axis=0)
    bars = table_.batch(corners * HIGH).error.max(axis=0)
    assert (plan.bound >= moved).all()
    assert (plan.bound <= 3 * (moved + 2 * bars)).all()


def test_without_a_tolerance_nothing_is_rigid() -> None:
    assert plan_of(filled(), need({0: (-1e-6, 1e-6)})).decision == "table"


def test_a_linear_component_needs_one_compliance() -> None:
    plan = plan_of(empty(linear=True), need(PLANAR))
    assert (plan.decision, plan.solves, plan.compliance) == ("linear", (1, 1), None)
    row = solved(RESPONSES["nearly_linear"], full_wrenches(1, 1))
    row = replace(row, displacement=row.wrench @ row.compliance[0].T)  # as linear solves have it
    one = build(row, RANGE, linear=True)
    matrix = plan_of(one, need(PLANAR)).compliance
    assert matrix is not None
    np.testing.assert_array_equal(matrix[:, [1, 3, 5]], 0.0)
    np.testing.assert_allclose(matrix[:, [0, 2, 4]], one.groups[0].fit.matrix[:, [0, 2, 4]])


def test_a_response_that_is_linear_within_the_tolerance_needs_one_compliance() -> None:
    wanted = need({0: (-0.2, 0.2), 4: (-0.2, 0.2)}, tolerance=Tolerance(2e-5, 2e-5))
    plan = plan_of(filled("nearly_linear"), wanted)
    assert plan.decision == "linear"
    assert plan.compliance is not None
    low, high = wanted.span.low, wanted.span.high
    asked = low + np.random.default_rng(5).uniform(size=(500, 6)) * (high - low)
    missed = asked @ plan.compliance.T - RESPONSES["nearly_linear"](asked / HIGH)
    assert np.abs(missed).max() <= 2e-5


def test_a_response_that_bends_by_more_than_the_tolerance_needs_its_table() -> None:
    plan = plan_of(filled("smooth"), need(PLANAR, tolerance=TIGHT))
    assert (plan.decision, plan.compliance) == ("table", None)
    assert "would miss" in plan.reason


def test_a_scene_without_load_is_rigid_unless_a_measured_table_has_an_offset() -> None:
    plan = plan_of(empty(), need({}))
    assert (plan.decision, plan.solves) == ("rigid", (9, 0))
    np.testing.assert_array_equal(plan.bound, 0.0)
    scaled = np.concatenate((np.zeros((1, 6)), full_wrenches(30, 1)))
    offset = build(Rows.of(scaled * HIGH, coupled(scaled) + 1e-3), RANGE)
    measured_plan = plan_of(offset, need({}, tolerance=Tolerance(1e-4, 1e-4)), solved=False)
    assert measured_plan.decision != "rigid"
    assert (measured_plan.bound >= 1e-3).all()


def test_a_scene_of_one_wrench_needs_one_solve_and_then_none() -> None:
    wanted = need({0: (0.5, 0.5), 4: (0.2, 0.2)})
    plan = plan_of(empty(), wanted)
    assert plan.solves == (9, 1)
    asked = design_of(empty(), plan, 10).wrenches
    np.testing.assert_array_equal(asked, wanted.span.low[None])
    known = build(solved(RESPONSES["hardening"], asked / HIGH), RANGE)
    assert design_of(known, plan_of(known, wanted), 10).stage == "met"


def test_one_sided_loads_are_solved_on_their_side_only() -> None:
    asked = design_of(empty(), plan_of(empty(), need({2: (-1, 0), 4: (0, 1)})), 30).wrenches
    assert (asked[:, 2] <= 0).all()
    assert (asked[:, 4] >= 0).all()


def test_a_load_held_at_a_value_keeps_it_in_every_solve() -> None:
    asked = design_of(empty(), plan_of(empty(), need({0: (0.5, 0.5), 2: (-1, 1)})), 30).wrenches
    assert len(asked) == 4
    np.testing.assert_array_equal(asked[:, 0], 0.5 * HIGH[0])


def test_a_load_on_a_locked_freedom_is_none_of_the_scenes() -> None:
    whole = need_of(RANGE, idle=(0, 1, 3, 4))
    assert whole.loads == ["fz", "mz"]
    assert first_solves(empty(), whole.span) == 5


@pytest.mark.parametrize(
    ("ends", "told"),
    [
        ((1.0, -1.0), "the low end of fx, 1000 N, must not be above the high end, -1000"),
        ((-1.0, 1.5), "within -1000 to 1000 N, the load range, not -1000 to 1500"),
        ((-1.5, 0.0), "fx must lie within -1000 to 1000 N, the load range"),
    ],
)
def test_loads_that_cannot_be_are_named(ends: tuple[float, float], told: str) -> None:
    with pytest.raises(NeedError, match=told):
        need({0: ends})


def test_a_component_whose_range_leaves_zero_out_may_be_unloaded() -> None:
    pushed = LoadRange(np.r_[100.0, -HIGH[1:]], np.r_[1000.0, HIGH[1:]])
    assert need_of(pushed, np.zeros((6, 2))).loads == []


SPAN = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(lambda pair: tuple(sorted(pair)))


@settings(max_examples=30)
@given(
    spans=st.dictionaries(st.integers(0, 5), SPAN),
    outputs=st.sets(st.integers(0, 5), min_size=1),
    rows=st.booleans(),
)
def test_a_scenes_plan_is_a_part_of_the_whole_plan(spans, outputs, rows) -> None:
    chosen = filled() if rows else empty()
    all_ = plan_of(chosen, need_of(RANGE))
    part = plan_of(chosen, need(spans, outputs=tuple(outputs)))
    assert set(part.need.loads) <= set(all_.need.loads)
    assert {OUTPUTS[k] for k in outputs} == set(part.need.output_names())
    assert part.solves[1] <= part.solves[0] == all_.solves[1]
    for name, axis in part.need.axes().items():
        whole = all_.need.axes()[name]
        assert set(axis["inputs"]) <= set(whole["inputs"])  # type: ignore[call-overload]
        assert axis["dimensions"] <= whole["dimensions"]  # type: ignore[operator]
    asked = design_of(chosen, part, 4).wrenches
    assert not part.need.beyond(asked).any()


def test_what_is_saved_is_measured_and_says_how() -> None:
    table = build(solved(RESPONSES["hardening"], spread(40)), RANGE)
    table.packed = PackedTable.from_bytes(b"".join(pack(table)))
    saved = measured(table, plan_of(table, need(PLANAR)))
    assert saved.build_s is not None
    assert saved.memory_bytes is not None
    assert 0 < saved.build_s < table.build_s  # type: ignore[union-attr]
    assert saved.memory_bytes > 0
    assert all(
        "measured" in reported or "counted" in reported for reported in saved.origin.values()
    )


def test_nothing_is_said_to_be_saved_where_there_are_no_rows() -> None:
    saved = measured(empty(), plan_of(empty(), need(PLANAR)))
    assert (saved.build_s, saved.memory_bytes, saved.us_per_answer) == (None, None, None)
    assert set(saved.origin.values()) == {"not measured: there are no rows yet"}


def test_a_rig_that_measured_some_outputs_has_a_bound_of_those() -> None:
    rows = table(coupled, np.concatenate((CORNERS, full_wrenches(60, 1))))
    moved = rows.displacement.copy()
    moved[:, 3:] = np.nan
    between_rows = dict.fromkeys(PLANAR, (-0.9, 0.9))
    scene = need(between_rows, tolerance=LOOSE)
    plan = plan_of(build(Rows.of(rows.wrench, moved), RANGE), scene)
    assert np.isfinite(plan.bound[:3]).all()
    assert np.isnan(plan.bound[3:]).all()
    assert plan.decision == "table"
