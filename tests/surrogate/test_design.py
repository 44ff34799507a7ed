import numpy as np
import pytest

from surrogate.build import build
from surrogate.design.adaptive import next_wrenches
from surrogate.design.initial import first_design
from surrogate.table.axes import clean_rows
from surrogate.table.rows import LoadRange, Rows, Tolerance
from tests.surrogate.responses import HIGH, RANGE, coupled, full_wrenches, smooth, table

EMPTY = build(Rows.empty(), RANGE)


def test_the_first_design_has_centre_faces_corners_and_a_sequence_for_every_axis() -> None:
    scaled = first_design(RANGE) / HIGH
    assert len(scaled) == 67  # 3 x 27; no load and the twelve pure moments asked but once
    assert not scaled[0].any()
    assert (np.abs(scaled).sum(axis=1) == 1).sum() == 12
    assert (np.abs(scaled[:, [0, 4, 5]]) == 1).all(axis=1).sum() == 8
    assert (np.abs(scaled) <= 1).all()
    assert len(np.unique(scaled, axis=0)) == 67


def test_the_first_design_loads_one_axis_at_a_time() -> None:
    rows = Rows.of(first_design(RANGE), np.zeros((67, 6)))
    assert clean_rows(rows, RANGE).any(axis=1).all()


def test_refinement_gives_full_wrenches_their_share_and_one_axis_the_rest() -> None:
    scaled, counts = first_design(RANGE) / HIGH, []
    for _ in range(4):
        surrogate = build(table(coupled, scaled), RANGE, off_axis="exclude")
        asked = next_wrenches(surrogate, 20).wrenches
        scaled = np.concatenate((scaled, asked / HIGH))
        assert len(asked) == 20
        full = ~clean_rows(Rows.of(asked, asked), RANGE).any(axis=1)
        loads = (asked != 0).sum(axis=1)
        assert (loads[full] == 6).all()
        counts.append(int(full.sum()))
    assert counts[0] == 10  # what the first design lacks, but never more than half of a round
    assert 0.1 <= sum(counts) / len(scaled) <= 0.36


def test_a_scene_of_one_axis_asks_for_no_full_wrench() -> None:
    high = np.array([0, 0, 5000.0, 500.0, 500.0, 0])
    scene = LoadRange(-high, high)
    surrogate = build(Rows.of(first_design(scene), smooth(first_design(scene) / HIGH)), scene)
    asked = next_wrenches(surrogate, 30).wrenches
    assert len(asked) == 30
    assert (asked[:, [0, 1, 5]] == 0).all()


def test_rows_with_tangents_shorten_the_first_design_to_faces_and_corners() -> None:
    first = first_design(RANGE)
    assert len(first_design(RANGE, tangents=True)) == 37  # 1 + 12 + 24
    one = Rows.of(first[:1], np.zeros((1, 6)), compliance=np.eye(6)[None])
    assert len(next_wrenches(build(one, RANGE), 100).wrenches) == 36


def test_a_small_budget_is_spent_on_all_axes_alike() -> None:
    first = next_wrenches(EMPTY, 13)
    assert first.stage == "first"
    assert (np.abs(first.wrenches) > 0).any(axis=0).all()


def test_rows_and_pending_wrenches_are_not_asked_again() -> None:
    first = next_wrenches(EMPTY, 20).wrenches
    surrogate = build(table(smooth, first[:10] / HIGH), RANGE)
    rest = next_wrenches(surrogate, 1000, pending=first[10:])
    assert len(rest.wrenches) == 47
    together = np.concatenate((first, rest.wrenches))
    assert len(np.unique(together / HIGH, axis=0)) == 67


def test_an_axis_without_loads_is_left_out_and_a_planar_one_gets_a_planar_design() -> None:
    high = np.array([0, 0, 5000.0, 0, 200.0, 0])  # F_z and M_y
    scaled = first_design(LoadRange(-high, high))
    assert (scaled[:, [0, 1, 3, 5]] == 0).all()
    assert 15 <= len(scaled) <= 20
    assert len(first_design(LoadRange(np.zeros(6), np.zeros(6)))) == 0


def test_a_one_sided_range_is_stretched_to_no_load_where_the_composition_reads_moments() -> None:
    low, high = -HIGH, HIGH.copy()
    high[2], low[2] = -2000, -5000
    design = first_design(LoadRange(low, high))
    assert design[:, 2].min() == -5000
    assert design[:, 2].max() == 0
    surrogate = build(Rows.of(design, smooth(design / HIGH)), LoadRange(low, high))
    assert surrogate.answer([0, 0, -3000.0, 100.0, 50.0, 0]).coverage == "covered"


def test_refinement_asks_where_the_error_bar_is_largest_and_spreads_out() -> None:
    surrogate = build(table(smooth, first_design(RANGE) / HIGH), RANGE)
    one = next_wrenches(surrogate, 1)
    assert one.stage == "refine"
    many = next_wrenches(surrogate, 30)
    np.testing.assert_array_equal(many.wrenches[0], one.wrenches[0])
    assert len(np.unique(many.wrenches, axis=0)) == 30
    after = next_wrenches(surrogate, 30, pending=one.wrenches).wrenches
    assert not (np.abs(after - one.wrenches) < 1e-9).all(axis=1).any()


def test_refinement_lowers_the_error_and_ends_at_the_tolerance() -> None:
    tolerance = Tolerance(4e-4, 8e-4)
    scaled = first_design(RANGE) / HIGH
    asked, errors, stages = full_wrenches(500, 1), [], []
    for _ in range(8):
        rows = table(smooth, scaled)
        surrogate = build(rows, RANGE, tolerance=tolerance, off_axis="exclude")
        answers = surrogate.batch(asked * HIGH)
        errors.append(np.abs(answers.displacement - smooth(asked)).mean())
        design = next_wrenches(surrogate, 40)
        stages.append(design.stage)
        if design.stage == "met":
            break
        scaled = np.concatenate((scaled, design.wrenches / HIGH))
    assert stages[-1] == "met"
    assert len(design.wrenches) == 0
    assert (answers.coverage == 0).mean() > 0.95
    assert errors[-1] <= errors[0]


def test_a_linear_component_needs_one_solve() -> None:
    linear = build(Rows.empty(), RANGE, linear=True)
    design = next_wrenches(linear, 10)
    assert design.stage == "first"
    assert len(design.wrenches) == 1
    assert len(next_wrenches(linear, 10, pending=design.wrenches).wrenches) == 0
    matrix = np.eye(6)[None] * 1e-8
    rows = Rows.of(design.wrenches, design.wrenches * 1e-8, compliance=matrix)
    assert next_wrenches(build(rows, RANGE, linear=True), 10).stage == "met"
    bare = Rows.of(design.wrenches, design.wrenches * 1e-8)
    assert len(next_wrenches(build(bare, RANGE, linear=True), 10).wrenches) == 5


@pytest.mark.parametrize("budget", [0, 1, 7])
def test_no_more_than_the_budget_is_asked(budget: int) -> None:
    assert len(next_wrenches(EMPTY, budget).wrenches) == budget
    surrogate = build(table(smooth, first_design(RANGE) / HIGH), RANGE)
    assert len(next_wrenches(surrogate, budget).wrenches) == budget


def test_a_table_is_not_done_before_full_wrenches_have_told_what_axes_leave_out() -> None:
    loose = Tolerance(1e3, 1e3)
    scaled = first_design(RANGE) / HIGH
    first = next_wrenches(build(table(smooth, scaled), RANGE), 30, tolerance=loose)
    assert (first.stage, len(first.wrenches)) == ("refine", 20)
    assert (first.wrenches != 0).all()
    scaled = np.concatenate((scaled, first.wrenches / HIGH))
    then = next_wrenches(build(table(smooth, scaled), RANGE), 30, tolerance=loose)
    assert then.stage == "met"
