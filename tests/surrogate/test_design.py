from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import wrenchbook.surrogate.kriging.calibration as calibration
from tests.surrogate.energies import Part, part, stiffening
from tests.surrogate.kriging.responses import solved
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, coupled, full_wrenches, smooth, table
from wrenchbook.surrogate import design
from wrenchbook.surrogate.answer import allowed_by
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.design import (
    ENOUGH,
    HYPERCUBE,
    Known,
    first_design,
    next_wrenches,
    spread_wrenches,
)
from wrenchbook.surrogate.table.axes import single_axis_rows
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.spread import sample_of, weakest

EMPTY = build(Rows.empty(), RANGE)
FIRST = first_design(RANGE, Known(RANGE, np.empty((0, 6)), np.empty((0, 6))), 15)
BENT = part(stiffening, 1)
FILLED = build(solved(coupled, FIRST / HIGH), RANGE)


def test_the_first_design_is_no_load_then_a_hypercube_then_an_even_spread() -> None:
    scaled = FIRST / HIGH
    assert not scaled[0].any()
    np.testing.assert_allclose(scaled[1:9], HYPERCUBE / 8)
    np.testing.assert_allclose(FIRST[9:], spread_wrenches(RANGE, 6))
    assert not single_axis_rows(Rows.of(FIRST[1:], FIRST[1:]), RANGE).any()


def test_solves_that_bring_second_derivatives_have_a_first_design_of_nine() -> None:
    first = next_wrenches(EMPTY, 100)
    np.testing.assert_array_equal(first.wrenches, FIRST[:9])
    rows = BENT.rows(first.wrenches / HIGH)
    assert next_wrenches(build(rows, RANGE), 6).stage == "refine"


def test_solves_without_second_derivatives_have_a_first_design_of_fifteen() -> None:
    rows = solved(coupled, FIRST[:9] / HIGH)
    further = next_wrenches(build(rows, RANGE), 100)
    assert further.stage == "first"
    np.testing.assert_array_equal(further.wrenches, FIRST[9:])


def test_the_hypercube_keeps_the_signs_of_the_loads_apart() -> None:
    signs = np.sign(HYPERCUBE)
    np.testing.assert_array_equal(signs.T @ signs, 8 * np.eye(6))


@pytest.mark.parametrize("count", [3, 4])
def test_a_short_first_design_goes_to_both_sides_of_each_load(count: int) -> None:
    low, high = HYPERCUBE[:count].min(axis=0), HYPERCUBE[:count].max(axis=0)
    assert (low < 0).all()
    assert (high > 0).all()


def test_no_load_of_the_first_design_has_a_value_twice() -> None:
    """Rows left out show nothing between the values that a load has in all rows."""
    for load in FIRST.T:
        assert len(np.unique(load)) == len(FIRST)


def test_bars_of_the_first_design_hold_between_its_values_of_the_main_load() -> None:
    """A plate that stiffens by its normal load: with zero load and corners 59 % of u_z held."""
    bends = np.diag([0.5, 0.5, 3.0, 0.5, 0.5, 0.3])
    bends[[0, 1, 2, 2, 2, 2, 3, 4], [4, 3, 0, 1, 3, 4, 1, 0]] = 0.15
    plate = Part(np.diag([20.0, 20.0, 200.0, 60.0, 60.0, 20.0]), bends, stiffening, 100.0)
    rows = plate.rows(FIRST[:9] / HIGH)
    true = plate.rows(np.random.default_rng(5).uniform(-1, 1, (300, 6)), second=False)
    reported = build(rows, RANGE).batch(true.wrench)
    assert (np.abs(reported.displacement - true.displacement) <= reported.error).mean(0).min() > 0.9


def test_a_fill_names_no_error_that_its_rows_do_not_show() -> None:
    alone = LoadRange(-HIGH * [0, 0, 1, 0, 0, 0], HIGH * [0, 0, 1, 0, 0, 0])
    few, asked = build(Rows.empty(), alone), np.empty((0, 6))
    while (first := next_wrenches(few, 100)).stage == "first":
        asked = np.concatenate((asked, first.wrenches))
        few = build(solved(coupled, asked / HIGH), alone)
    assert few.answer(alone.high / 2).error is None
    further = next_wrenches(few, 1, tolerance=Tolerance(1e-9, 1e-9))
    assert further.reason == "the rows are too few to show the interpolation error"


def test_rows_and_pending_wrenches_are_not_asked_again() -> None:
    surrogate = build(table(smooth, FIRST[:5] / HIGH), RANGE)
    rest = next_wrenches(surrogate, 1000, pending=FIRST[5:12])
    assert rest.stage == "first"
    np.testing.assert_array_equal(rest.wrenches, FIRST[12:])


def test_a_fill_whose_first_design_is_still_being_solved_goes_on_spreading() -> None:
    more = next_wrenches(EMPTY, 10, pending=FIRST).wrenches
    assert len(np.unique(np.concatenate((FIRST, more)), axis=0)) == 25


def speck(width: float) -> LoadRange:
    """Return a range of one load that is this part of its load range wide."""
    high = np.array([width / 2, 0, 0, 0, 0, 0]) * HIGH
    return LoadRange(-high, high)


@pytest.mark.parametrize("width", [1e-308, 1e-15, 3e-9])
def test_the_first_design_of_a_speck_has_the_few_wrenches_that_can_be_told_apart(
    width: float,
) -> None:
    first = next_wrenches(EMPTY, 100, span=speck(width))
    assert first.stage == "first"
    assert 1 <= len(first.wrenches) <= 5


def test_a_speck_is_met_once_all_its_wrenches_are_asked_for() -> None:
    asked = next_wrenches(EMPTY, 100, span=speck(1e-308)).wrenches
    assert next_wrenches(EMPTY, 100, span=speck(1e-308), pending=asked).stage == "met"


def test_loads_that_a_scene_does_not_have_stay_at_rest_and_shorten_the_first_design() -> None:
    high = np.array([0, 0, 5000.0, 0, 0, 200.0])
    scene = LoadRange(-high, high)
    first = next_wrenches(EMPTY, 100, span=scene).wrenches
    assert len(first) == 5
    assert (first[:, [0, 1, 3, 4]] == 0).all()
    asked = next_wrenches(FILLED, 12, span=scene)
    assert asked.stage == "refine"
    assert scene.holds(asked.wrenches).all()
    nothing = LoadRange(np.zeros(6), np.zeros(6))
    assert len(first_design(nothing, Known(RANGE, np.empty((0, 6)), np.empty((0, 6))), 9)) == 1


def test_a_one_sided_range_is_filled_within_itself() -> None:
    low, high = -HIGH, HIGH.copy()
    high[2], low[2] = -2000, -5000
    first = next_wrenches(build(Rows.empty(), LoadRange(low, high)), 100).wrenches
    assert LoadRange(low, high).holds(first).all()
    assert first[0].tolist() == [0, 0, -2000, 0, 0, 0]


def test_refinement_asks_where_the_bar_is_largest_and_spreads_out() -> None:
    one, many = (next_wrenches(FILLED, budget).wrenches for budget in (1, 30))
    np.testing.assert_array_equal(many[0], one[0])
    assert len(np.unique(many, axis=0)) == 30
    apart = (np.abs(many[:, None] - many[None]) / HIGH).max(axis=2)
    assert apart[np.triu_indices(30, 1)].min() > 0.1
    bar = FILLED.batch(one).error / FILLED.ranges
    elsewhere = FILLED.batch(spread_wrenches(RANGE, 200)).error / FILLED.ranges
    assert bar.max() > np.quantile(elsewhere.max(axis=1), 0.98)


def test_a_pending_wrench_counts_as_solved() -> None:
    one = next_wrenches(FILLED, 1).wrenches
    after = next_wrenches(FILLED, 5, pending=one).wrenches
    np.testing.assert_array_equal(after, next_wrenches(FILLED, 6).wrenches[1:])
    assert (np.abs(after - one) / HIGH).max(axis=1).min() > 0.1


def test_each_fourth_wrench_is_of_an_even_spread_away_from_the_ends() -> None:
    many = np.abs(next_wrenches(FILLED, 24).wrenches / HIGH)
    even = (np.arange(15, 39) % 4) == 0
    assert many[even].mean() < 0.6
    assert many[~even].mean() > 0.65


def test_only_the_outputs_of_a_scene_count() -> None:
    every, first = (
        next_wrenches(FILLED, 1, outputs=outputs).wrenches[0] for outputs in (range(6), [0])
    )
    bars = FILLED.batch(np.array([every, first])).error[:, 0]
    assert bars[1] >= bars[0]


def test_refinement_ends_when_bars_are_within_the_tolerance_and_they_are() -> None:
    tolerance = Tolerance(1e-4, 1e-4)
    scaled, stages = FIRST / HIGH, []
    for _ in range(12):
        surrogate = build(solved(smooth, scaled), RANGE, tolerance=tolerance)
        design = next_wrenches(surrogate, 24)
        stages.append(design.stage)
        if design.stage == "met":
            break
        scaled = np.concatenate((scaled, design.wrenches / HIGH))
    assert stages[-1] == "met"
    assert not len(design.wrenches)
    asked = full_wrenches(500, 1)
    reported = surrogate.batch(asked * HIGH)
    assert (reported.coverage == 0).mean() > ENOUGH - 0.03
    error = np.abs(reported.displacement - smooth(asked))
    assert (error <= allowed_by(tolerance)).all(axis=1).mean() > ENOUGH - 0.03


def test_pending_wrenches_that_will_meet_the_tolerance_end_a_fill() -> None:
    usual = float(np.median(FILLED.batch(spread_wrenches(RANGE, 256)).error.max(axis=1)))
    tolerance = Tolerance(usual, usual)
    asked = next_wrenches(FILLED, 60, tolerance=tolerance)
    assert asked.stage == "refine"
    assert next_wrenches(FILLED, 60, tolerance=tolerance, pending=asked.wrenches).stage == "met"


def test_a_fill_that_ends_says_within_the_tolerance_of_the_interpolation_error_alone() -> None:
    reason = next_wrenches(FILLED, 60, tolerance=Tolerance(1.0, 1.0)).reason
    assert reason == (
        "the interpolation error of 100% of a sample of the range is within the tolerance"
    )


def test_a_table_without_tangents_is_filled_with_clean_and_full_wrenches() -> None:
    surrogate = build(table(smooth, FIRST / HIGH), RANGE)
    asked = next_wrenches(surrogate, 30).wrenches
    assert len(asked) == 30
    assert (asked != 0).any(axis=0).all()


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
    assert len(next_wrenches(FILLED, budget).wrenches) == budget


def test_a_table_whose_rows_lack_outputs_is_filled_for_those_that_fewest_rows_hold() -> None:
    scaled = full_wrenches(40, 8)
    moved = smooth(scaled)
    moved[15:, 3:] = np.nan  # a rig that measured no rotations
    rows = Rows.of(scaled * HIGH, moved)
    partial = build(rows, RANGE)
    assert partial.rows.partial
    asked = next_wrenches(partial, 12).wrenches
    thin = next_wrenches(replace(partial.table, groups=partial.groups[:1]), 12).wrenches
    np.testing.assert_array_equal(asked, thin)


def test_a_table_of_which_no_row_tells_an_error_covers_nothing_but_has_next_wrenches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its error bars were infinite, or no numbers, and so was what would be left of them."""
    none = calibration.Errors(np.empty((0, 6)), np.empty((0, 6)), np.empty(0))
    # As rounding leaves it of a few rows.
    monkeypatch.setattr(calibration, "left_out_as_far", lambda *_: (none, none))
    wrenches = spread_wrenches(RANGE, 20)
    surrogate = build(Rows.of(wrenches, wrenches * 1e-6, source=["fea"] * 20), RANGE)
    assert surrogate.kriging is not None
    assert np.isnan(surrogate.kriging.answer_many(wrenches)[1]).all()
    assert len(next_wrenches(surrogate, 3, pending=-wrenches).wrenches) == 3


def elastic(count: int) -> Table:
    """A table of a part that stiffens, whose wide tolerance is met."""
    first = next_wrenches(EMPTY, count).wrenches
    return build(BENT.rows(first / HIGH), RANGE, tolerance=Tolerance(1.0, 1.0))


def test_a_fill_for_a_joint_goes_on_where_the_tolerance_alone_ends_it() -> None:
    filled = elastic(9)
    assert next_wrenches(filled, 6).stage == "met"
    design = next_wrenches(filled, 6, for_joint=True)
    assert design.stage == "refine"
    assert "times the tolerance (of a joint's wrench: 5% of the load range)" in design.reason
    assert 0 < len(design.wrenches) <= 6


def test_a_fill_for_a_joint_ends_with_a_positive_definite_compliance() -> None:
    filled = elastic(9)
    design = next_wrenches(filled, 12, for_joint=True)
    while design.stage != "met" and len(filled.rows) < 250:
        rows = filled.rows + BENT.rows(design.wrenches / HIGH)
        filled = build(rows, RANGE, tolerance=Tolerance(1.0, 1.0))
        design = next_wrenches(filled, 12, for_joint=True)
    assert design.stage == "met"
    assert "a joint's wrench 5% of the load range, the compliance positive d" in design.reason
    sample = sample_of(RANGE.ends, np.zeros(6), np.arange(6))
    assert (weakest(filled.derivatives(sample, "kriging"), HIGH)[0] > 0).all()


def test_a_fill_for_a_joint_does_not_end_while_the_part_moves_against_loads() -> None:
    rows = BENT.rows(FIRST / HIGH)
    against = Rows.of(rows.wrench, -rows.displacement, compliance=-rows.compliance)
    design = next_wrenches(build(against, RANGE, tolerance=Tolerance(1.0, 1.0)), 6, for_joint=True)
    assert design.stage == "refine"
    assert "not positive definite: the compliance at 512 wrenches" in design.reason
    assert len(design.wrenches) == 6


def test_the_direction_against_which_a_part_moves_is_found_whatever_the_units():
    scale = np.array([1000.0, 0.01])
    least, loads = weakest(np.array([[[1.0, 2.0], [2.0, 1.0]]]) / np.outer(scale, scale), scale)
    np.testing.assert_allclose(least, [-1.0])
    np.testing.assert_allclose(loads[0] / loads[0, 0], [1.0, -1.0])


def test_an_elastic_part_and_one_with_a_stiff_freedom_are_not_indefinite():
    matrices = np.array([np.diag([1.0, 1e-9]), np.diag([1.0, 0.0]), np.diag([1.0, -1e-30])])
    assert (weakest(matrices, np.ones(2))[0] >= 0.0).all()


def test_an_unknown_compliance_has_no_eigenvalue():
    least, _ = weakest(np.array([np.eye(2), np.full((2, 2), np.nan)]), np.ones(2))
    assert np.isfinite(least).tolist() == [True, False]


def test_a_tolerance_far_too_small_has_an_estimate_and_no_overflow(monkeypatch):
    """The error to the power of 1 / rate was beyond the largest float."""
    worst, rate = 1e6, 0.015
    before = worst * 2**rate
    kriging = SimpleNamespace(sigma_with=lambda _, points: np.full((len(points), 6), before))
    half = SimpleNamespace(groups=[SimpleNamespace(kriging=kriging)])
    monkeypatch.setattr(design, "build", lambda rows, load_range: half)
    rows = Rows.of(np.ones((60, 6)), np.ones((60, 6)))
    surrogate = SimpleNamespace(rows=rows, load_range=RANGE)
    fit = SimpleNamespace(surrogate=surrogate, allowed=np.ones(6), outputs=list(range(6)))
    told = design._Refinement._estimate_of_solves(fit, np.zeros((4, 6)), worst, 10)
    assert "more than a million further solves" in told
