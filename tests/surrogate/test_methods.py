"""The methods: what they are exact for, which is better where, which answers, and what they say."""

import numpy as np
import pytest

from tests.surrogate.calibrating import calibration, shipped
from tests.surrogate.kriging.responses import solved, spread_wrenches
from tests.surrogate.law import build
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    axes_of,
    clean_wrenches,
    full_wrenches,
    smooth,
    table,
)
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.table.rows import LoadRange, Rows

PLATE = shipped("plate_thin", 40, 60)
PLATE_TABLE = build(PLATE.rows, PLATE.load_range)


def test_axes_of_the_axes_alone_answers_as_that_of_a_whole_table() -> None:
    rows = table(smooth, np.concatenate((clean_wrenches(20, 1), full_wrenches(10, 2))))
    asked = np.concatenate((full_wrenches(100, 3), clean_wrenches(10, 4))) * 1.05 * HIGH
    alone, whole = axes_of(rows).by_method(asked), build(rows, RANGE)
    reported = whole.batch(asked, method="griddata")
    np.testing.assert_array_equal(alone.displacement, reported.displacement)
    np.testing.assert_array_equal(alone.coverage == 2, reported.coverage == 2)


@pytest.mark.parametrize("method", METHODS)
def test_beyond_the_load_range_no_method_covers(method: str) -> None:
    answer = PLATE_TABLE.answer([1200.0, 0, 0, 0, 0, 0], None, method)
    assert answer.coverage == "outside"
    assert answer.reason
    assert answer.displacement is not None


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_the_derivative_of_its_own_answer(method: str) -> None:
    wrench, step = 0.3 * PLATE.asked[:1], 1e-5 * PLATE.load_range.scale
    slope = PLATE_TABLE.derivatives(wrench, method)[0]
    ends = [
        PLATE_TABLE.batch(wrench + sign * np.diag(step), None, method).displacement
        for sign in (1, -1)
    ]
    reported = ((ends[0] - ends[1]) / (2 * step[:, None])).T
    np.testing.assert_allclose(
        slope * step, reported * step, rtol=1e-3, atol=1e-3 * np.abs(slope * step).max(axis=1).min()
    )


def test_kriging_answers_full_wrenches_of_the_thin_plate_fifteen_times_better_than_griddata() -> (
    None
):
    rms = {
        method: calibration(PLATE_TABLE, PLATE.asked, PLATE.true, method).rms
        for method in ("griddata", "kriging")
    }
    assert (15 * rms["kriging"] < rms["griddata"]).all()
    assert rms["kriging"].max() < 0.001


@pytest.mark.parametrize("method", METHODS)
def test_the_bars_of_the_methods_hold_on_the_thin_plate(method: str) -> None:
    assert calibration(PLATE_TABLE, PLATE.asked, PLATE.true, method).inside.min() >= 0.9


def test_the_default_is_kriging_where_solves_bring_tangents_and_says_why() -> None:
    assert PLATE_TABLE.default == "kriging"
    assert 0.0 < PLATE_TABLE.choice.errors["kriging"] < 0.01
    assert PLATE_TABLE.choice.errors.keys() == {"kriging"}
    assert "left-out rows" in PLATE_TABLE.choice.reason
    assert PLATE_TABLE.answer(PLATE.asked[0].tolist()).method == "kriging"


@pytest.mark.parametrize("full", [0, 5, 40])
def test_kriging_answers_measured_rows_whatever_they_load(full: int) -> None:
    surrogate = build(table(smooth, spread_wrenches(30, full, 1)), RANGE)
    assert surrogate.default == "kriging"


def test_with_too_few_rows_for_a_kriging_the_axes_answer() -> None:
    few = build(table(smooth, full_wrenches(3, 1)), RANGE)
    assert (few.default, few.kriging) == ("additive", None)
    asked = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert few.answer(asked, None, "kriging").displacement is not None


def test_a_kriging_that_answers_no_row_left_out_is_not_told_to_have_an_error_of_zero(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One second derivative of 1e308 left no error at any row, which counted as 0."""
    monkeypatch.setattr(Kriging, "left_out", lambda own: np.full((len(own.errors), 6), np.nan))
    rows = solved(smooth, spread_wrenches(20, 30, 5))
    choice = build(rows, RANGE).table.groups[0].choice
    assert choice.errors == {}
    assert "to show its error at left-out rows" in choice.reason


def test_another_method_takes_its_difference_from_kriging_into_its_bar() -> None:
    best, plain = (PLATE_TABLE.batch(PLATE.asked, None, name) for name in ("kriging", "griddata"))
    known = plain.coverage != 2
    apart = np.abs(best.displacement - plain.displacement)
    np.testing.assert_allclose(plain.error[known], (apart + best.error)[known], rtol=1e-6)


def test_a_table_too_large_for_one_factor_answers_by_the_kriging_and_says_so() -> None:
    surrogate = build(solved(smooth, spread_wrenches(120, 60, 2)), RANGE)
    assert surrogate.default == "kriging"
    assert " of 2940 equations)" in surrogate.coverage_summary()["method_detail"]


def test_pushes_beside_the_middle_are_answered_between_them_by_default() -> None:
    """No row loads several axes, and none has a moment alone: the axes answer nothing of it."""
    pushes = [
        [0, 0, -f, 0, x * f, 0] for x in np.linspace(-0.06, 0.06, 5) for f in range(0, 1001, 250)
    ]
    wrench = np.unique(np.array(pushes, dtype=float), axis=0)
    load_range = LoadRange(-np.repeat([1000.0, 100.0], 3), np.repeat([1000.0, 100.0], 3))
    compliance = np.diag(np.repeat([1e-6, 1e-5], 3))
    compliance[0, 4] = compliance[4, 0] = 2e-6

    def moved(loads: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(loads / load_range.scale, axis=1, keepdims=True)
        return loads @ compliance * (1 + 0.1 * size**2)

    surrogate = build(Rows.of(wrench, moved(wrench)), load_range)
    between = np.array([[0, 0, -450.0, 0, 9.0, 0]])
    answer = surrogate.answer(between[0])
    assert (answer.coverage, answer.method) == ("covered", "kriging")
    error = np.abs(np.array(answer.displacement) - moved(between)[0])
    assert error.max() < 1e-4 * np.abs(moved(between)).max()
