"""A table's kriging: exact at rows, invariant, calibrated, updated."""

import pickle

import numpy as np
import pytest

from tests.surrogate.kriging.responses import (
    NOISE,
    RESPONSES,
    noisy_rows,
    solved,
    spread_wrenches,
)
from tests.surrogate.responses import HIGH, RANGE, full_wrenches, table
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kriging import (
    Kriging,
    KrigingSettings,
    TooFewRowsError,
)
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows

COUPLED = RESPONSES["strongly_coupled"]
WRENCHES = spread_wrenches(6, 14, 11)
ROWS = solved(COUPLED, WRENCHES)
ASKED = full_wrenches(60, 12) * HIGH


@pytest.fixture(scope="module")
def kriging() -> Kriging:
    return Kriging.build(ROWS, RANGE)


def slopes(rows: Rows, wrenches: np.ndarray, load_range: LoadRange = RANGE) -> np.ndarray:
    """The kernel's du/dw, (n, 6, 6), SI, of the kriging of rows."""
    packed = packed_of(build(rows, load_range))
    return packed.derivatives(wrenches, method="kriging", without_rows=True)


def _size(rows: Rows) -> np.ndarray:
    return np.ptp(rows.displacement, axis=0)


def test_answers_and_derivatives_at_rows_are_the_rows(kriging: Kriging) -> None:
    displacement, bar = kriging.answer_many(ROWS.wrench)
    derivative = slopes(ROWS, ROWS.wrench)
    size = _size(ROWS)
    nugget = kriging.settings.nugget * kriging.hyperparameters.prior(1)[0]
    allowed = np.sqrt(nugget) * kriging.deviation * kriging.scaling.spread
    assert (allowed / size).max() < 2e-4
    assert (np.abs(displacement - ROWS.displacement) <= allowed).all()
    assert (np.abs(derivative - ROWS.compliance) * HIGH / size[:, None]).max() < 1e-6
    assert (bar > 0).all()


def test_derivatives_equal_differences(kriging: Kriging) -> None:
    step = 3e-4 * HIGH  # rounding and the differences' own error are alike: 2e-7
    derivative = slopes(ROWS, ASKED)
    for load in range(6):
        way = step * np.eye(6)[load]
        ahead, behind = kriging.answer_many(ASKED + way)[0], kriging.answer_many(ASKED - way)[0]
        difference = (ahead - behind) / (2 * step[load])
        scaled = np.abs(derivative[:, :, load] - difference) * HIGH[load] / _size(ROWS)
        assert scaled.max() < 1e-6


@pytest.mark.exact("ties of equally far rows decide neighbourhoods and left-out groups by rounding")
def test_answers_do_not_depend_on_units(kriging: Kriging) -> None:
    loads, moved = np.array([1e3, 1e3, 1e3, 1e-2, 1e-2, 1e-2]), np.array([1e3] * 3 + [57.3] * 3)
    rows = Rows.of(
        ROWS.wrench * loads,
        ROWS.displacement * moved,
        compliance=ROWS.compliance * moved[:, None] / loads,
    )
    other = Kriging.build(rows, LoadRange(-HIGH * loads, HIGH * loads))
    for reported, expected in zip(
        other.answer_many(ASKED * loads), kriging.answer_many(ASKED), strict=True
    ):
        np.testing.assert_allclose(
            reported / moved / _size(ROWS), expected / _size(ROWS), atol=1e-9
        )


def test_a_pickled_kriging_answers_the_same(kriging: Kriging) -> None:
    again = pickle.loads(pickle.dumps(kriging))
    np.testing.assert_array_equal(again.answer_many(ASKED)[0], kriging.answer_many(ASKED)[0])
    np.testing.assert_array_equal(again.answer_many(ASKED)[1], kriging.answer_many(ASKED)[1])


def test_rows_outside_the_load_range_take_no_part(kriging: Kriging) -> None:
    far = Rows.of(ROWS.wrench[:2] * 25, np.ones((2, 6)))
    reported = Kriging.build(ROWS + far, RANGE).answer_many(ASKED)[0]
    np.testing.assert_array_equal(reported, kriging.answer_many(ASKED)[0])


def test_rows_at_one_wrench_are_one_row() -> None:
    again = Rows.of(
        ROWS.wrench[:3] + 1e-7 * HIGH, ROWS.displacement[:3], compliance=ROWS.compliance[:3]
    )
    merged = Kriging.build(ROWS + again, RANGE)
    assert len(merged.equations) == len(ROWS)


def test_rows_that_contradict_each_other_at_one_wrench_are_met_between() -> None:
    other = Rows.of(ROWS.wrench[-1:], ROWS.displacement[-1:] + 2e-4)
    kriging = Kriging.build(ROWS + other, RANGE)
    displacement, bar = kriging.answer_many(ROWS.wrench[-1:])
    part = (displacement[0] - ROWS.displacement[-1]) / 2e-4
    assert (part > -0.1).all()
    assert (part < 1.1).all()
    assert (bar > 1e-5).all()


def test_fewer_than_four_rows_are_refused() -> None:
    with pytest.raises(TooFewRowsError, match="solve or import more"):
        Kriging.build(ROWS.take(np.arange(3)), RANGE)


def test_a_load_that_cannot_occur_drops_out() -> None:
    x = WRENCHES.copy()
    x[:, 4] = 0.0
    high = np.where(np.arange(6) == 4, 0.0, HIGH)
    rows = solved(COUPLED, x)
    load_range = LoadRange(-high, high)
    kriging = Kriging.build(rows, load_range)
    assert kriging.equations.count == 6 * len(kriging.equations)
    asked = ASKED * (np.arange(6) != 4)
    error = np.abs(kriging.answer_many(asked)[0] - COUPLED(asked / HIGH))
    assert (np.sqrt((error**2).mean(axis=0)) / _size(rows)).max() < 0.05
    used = build(rows, load_range).groups[0].used  # rows that only differ by it are one
    mean = used.compliance[:, :, 4].mean(axis=0)
    np.testing.assert_allclose(slopes(rows, asked[:1], load_range)[0, :, 4], mean, rtol=1e-12)


def test_a_load_that_moves_nothing_drops_out() -> None:
    def idle(x: np.ndarray) -> np.ndarray:
        return COUPLED(x * (np.arange(6) != 5))

    kriging = Kriging.build(solved(idle, WRENCHES), RANGE)
    assert kriging.equations.count == 6 * len(kriging.equations)
    turned = ASKED * [1, 1, 1, 1, 1, -1]
    np.testing.assert_array_equal(kriging.answer_many(ASKED)[0], kriging.answer_many(turned)[0])


def test_an_output_that_nothing_moves_is_answered_with_a_bar() -> None:
    def locked(x: np.ndarray) -> np.ndarray:
        return np.where(np.arange(6) == 3, 2e-5, COUPLED(x))

    displacement, bar = Kriging.build(solved(locked, WRENCHES), RANGE).answer_many(ASKED)
    assert (np.abs(displacement[:, 3] - 2e-5) <= bar[:, 3]).all()
    assert (bar[:, 3] > 0).all()
    assert bar[:, 3].max() < 1e-12


def test_outputs_not_measured_are_answered_from_the_rows_that_bring_them() -> None:
    displacement = ROWS.displacement.copy()
    displacement[1::2, 4] = np.nan
    kriging = Kriging.build(Rows.of(ROWS.wrench, displacement, compliance=ROWS.compliance), RANGE)
    reported, bar = kriging.answer_many(ASKED)
    error = np.abs(reported - COUPLED(ASKED / HIGH))
    assert (error <= bar).mean(axis=0).min() >= 0.9
    known = ROWS.take(np.arange(0, len(ROWS), 2))
    at_rows, _ = kriging.answer_many(known.wrench)
    assert (np.abs(at_rows - known.displacement)[:, 4] / _size(ROWS)[4]).max() < 1e-3


def test_measured_rows_are_smoothed_by_their_uncertainty() -> None:
    x, response = spread_wrenches(40, 60, 21), RESPONSES["smooth"]
    rows = noisy_rows(response, x, 21, told=True)
    true = response(ASKED / HIGH)
    smoothing = Kriging.build(rows, RANGE).answer_many(ASKED)[0] - true
    # solves repeat exactly: they are taken as they are
    solves = Rows.of(rows.wrench, rows.displacement, source=["fea"] * len(rows))
    exact = Kriging.build(solves, RANGE)
    through = exact.answer_many(ASKED)[0] - true
    assert (smoothing**2).mean() < 0.6 * (through**2).mean()
    reported, _ = exact.answer_many(rows.wrench)
    assert (np.abs(reported - rows.displacement) / _size(rows)).max() < 1e-3


def test_measured_rows_are_smoothed_as_well_where_nobody_stated_their_noise() -> None:
    x, response = spread_wrenches(40, 60, 21), RESPONSES["smooth"]
    true = response(ASKED / HIGH)
    stated, unstated = (
        Kriging.build(noisy_rows(response, x, 21, reported), RANGE).answer_many(ASKED)[0] - true
        for reported in (True, False)
    )
    assert (unstated**2).mean() < 1.2 * (stated**2).mean()


def test_repeated_readings_tell_their_noise() -> None:
    x, response = np.repeat(full_wrenches(30, 4), 4, axis=0), RESPONSES["smooth"]
    kriging = Kriging.build(noisy_rows(response, x, 22, told=False), RANGE)
    assert len(kriging.equations) == 30
    deviation = np.sqrt(kriging.observation_variance) * kriging.scaling.spread
    # ninety differences tell it to 8 %; of what may be response or noise the least is taken
    assert (deviation > 0.75 * NOISE).all()
    assert (deviation < 1.15 * NOISE).all()


def test_rows_that_do_not_err_are_found_to_have_no_noise() -> None:
    rows = table(RESPONSES["smooth"], spread_wrenches(30, 40, 5))
    kriging = Kriging.build(rows, RANGE)
    assert np.sqrt(kriging.observation_variance).max() < 1e-3  # as the answers' errors are
    reported, _ = kriging.answer_many(rows.wrench)
    assert (np.abs(reported - rows.displacement) / _size(rows)).max() < 1e-3


def test_pending_solves_lower_bars_where_they_are_and_nowhere_raise_them(kriging: Kriging) -> None:
    before = kriging.sigma_with(np.empty((0, 6)), ASKED)
    after = kriging.sigma_with(ASKED[:3], ASKED)
    assert (after <= before * (1 + 1e-12)).all()
    assert (after[:3] < 0.05 * before[:3]).all()
    reported = kriging.answer_many(ASKED)[1]
    known = np.isfinite(reported).all(axis=1)
    assert known.mean() > 0.9
    np.testing.assert_allclose(reported[known], before[known], rtol=1e-6)


def test_the_detail_tells_how_it_answers(kriging: Kriging) -> None:
    assert kriging.detail == "kriging, one factor over 32 rows (224 equations)"


def test_of_solves_too_many_for_one_factor_those_far_apart_answer_and_are_told() -> None:
    rows = solved(COUPLED, np.concatenate((full_wrenches(40, 31), 1e-2 * full_wrenches(40, 32))))
    kriging = Kriging.build(rows, RANGE, settings=KrigingSettings(dense_equations=300))
    assert kriging.detail == "kriging, one factor over 42 of 80 rows (294 of 560 equations)"
    assert (np.abs(kriging.equations.x).max(axis=1) > 0.05).sum() == 40
    assert np.isfinite(kriging.answer_many(ASKED)[1]).any()
