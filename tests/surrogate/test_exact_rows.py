"""A row answers its own wrench, and one a rounding error beside it, with a bar that grows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, full_wrenches, six, smooth, table
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.merging import RowIndex
from wrenchbook.surrogate.table.rows import Rows, Tolerance

SMOOTH = RESPONSES["smooth"]
BESIDE = (0.0, 1e-16, 1e-12, 1e-9, 1e-7, 9e-7)  # of the range


@cache
def few(*, tangents: bool = True) -> Table:
    """A table of too few rows to cover anything between them."""
    rows = solved(SMOOTH, 0.9 * full_wrenches(6, 3))
    if not tangents:
        rows = Rows.of(rows.wrench, rows.displacement)
    return build(replace(rows, source=np.full(len(rows), "fea")), RANGE)


def test_a_reading_whose_uncertainty_nobody_stated_has_no_error() -> None:
    """It was covered with an error of 0, at 3 % noise."""
    rows = table(smooth, 0.9 * full_wrenches(6, 3))
    stated = replace(rows, uncertainty=np.full((6, 6), 2e-6))
    result = [packed_of(build(item, RANGE)).batch(rows.wrench) for item in (rows, stated)]
    assert (result[0].coverage == 1).all()
    assert np.isnan(result[0].errors).all()
    assert (result[1].coverage == 0).all()
    assert (result[1].errors == 2e-6).all()


def test_readings_that_repeat_tell_their_noise_without_a_kriging() -> None:
    rng, sigma, held, known = np.random.default_rng(8), 1e-6, [], []
    for _ in range(200):
        wrench = 0.9 * full_wrenches(3, 3) * RANGE.scale
        moved = smooth(0.9 * full_wrenches(3, 3)) + rng.normal(size=(4, 3, 6)) * sigma
        rows = Rows.of(np.tile(wrench, (4, 1)), moved.reshape(12, 6))
        result = packed_of(build(rows, RANGE)).batch(wrench)
        assert (result.coverage == 0).all()
        held.append(np.abs(result.outputs - smooth(0.9 * full_wrenches(3, 3))) <= result.errors)
        known.append(result.errors)
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)
    assert np.median(known) == pytest.approx(sigma, rel=0.5)  # 2.26 sigma over the root of four


def steps(count: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(-1, 1, (count, 6)) * RANGE.scale


@pytest.mark.parametrize("tangents", [True, False])
def test_a_rounding_error_beside_a_row_is_covered_as_the_row_is(tangents: bool) -> None:
    """A load at rest, 1e-12 off the solved one, was thin, and answered by another number."""
    table = few(tangents=tangents)
    for row, step in zip(table.rows.wrench, steps(6), strict=True):
        for share in BESIDE:
            asked = row + share * step
            result = table.answer(asked.tolist())
            assert (result.coverage, result.method) == ("covered", "row")
            assert result.displacement is not None
            assert result.error is not None
            missed = np.abs(np.array(result.displacement) - SMOOTH(asked[None] / HIGH)[0])
            assert (missed <= np.array(result.error) + 1e-18).all()  # of numbers below 0.01
            reported = packed_of(table).answer(asked.tolist())
            assert reported.exact == bool((asked == row).all())
            assert reported.source == table.rows.source[0]
        assert table.answer((row + 3e-6 * step).tolist()).coverage != "covered"


@pytest.mark.parametrize("tangents", [True, False])
def test_the_bar_beside_a_row_grows_from_the_rows_own_in_proportion(tangents: bool) -> None:
    table, step = few(tangents=tangents), steps(1)[0]
    row = table.rows.wrench[1]
    shares = np.array([0.0, 1e-9, 1e-8, 1e-7, 9e-7])
    bars = table.batch(row + shares[:, None] * step).error
    np.testing.assert_array_equal(bars[0], 0.0)
    slopes = bars[1:] / shares[1:, None]
    np.testing.assert_allclose(slopes, np.tile(slopes[-1], (4, 1)), rtol=1e-5)
    assert (bars[-1] > 0).all()
    assert (bars[-1] < 1e-5 * np.ptp(table.rows.displacement, axis=0)).all()


def test_single_answers_batches_and_derivatives_beside_a_row_agree() -> None:
    table = few()
    asked = np.concatenate([table.rows.wrench + share * steps(6) for share in (*BESIDE, 3e-6)])
    packed = packed_of(table)
    result, slopes = packed.batch(asked), packed.derivatives(asked)
    for place, wrench in enumerate(asked.tolist()):
        answer = packed.answer(wrench)
        np.testing.assert_array_equal(answer.outputs, result.outputs[place])
        np.testing.assert_array_equal(six(answer.error), result.errors[place])
        np.testing.assert_array_equal(packed.derivative(wrench), slopes[place])
    np.testing.assert_array_equal(slopes[:36], np.tile(table.rows.compliance, (6, 1, 1)))


def test_the_answer_beside_a_row_has_the_slope_that_is_told() -> None:
    table, step = few(), steps(1)[0]
    ends = table.rows.wrench[2] + np.array([[-8e-7], [8e-7]]) * step
    low, high = table.batch(ends).displacement
    reported = table.rows.compliance[2] @ step
    np.testing.assert_allclose((high - low) / 16e-7, reported, rtol=1e-6, atol=1e-9)


def test_a_row_stands_for_no_wrench_where_that_alone_moves_more_than_is_allowed() -> None:
    table, step = few(), steps(1)[0]
    row, fine = table.rows.wrench[0], Tolerance(1e-12, 1e-12)
    assert table.answer(row.tolist(), fine).coverage == "covered"
    assert table.answer((row + 1e-12 * step).tolist(), fine).coverage == "covered"
    assert table.answer((row + 9e-7 * step).tolist(), fine, "kriging").coverage == "thin"


def test_one_row_at_rest_says_nothing_of_the_loads_beside_it() -> None:
    stated = np.full((1, 6), 1e-6)
    table = build(Rows.of(np.zeros((1, 6)), np.zeros((1, 6)), uncertainty=stated), RANGE)
    assert table.answer([0.0] * 6).coverage == "covered"
    assert table.answer([1e-4, 0, 0, 0, 0, 0]).coverage != "covered"


def test_a_row_within_the_range_answers_for_nothing_beyond_it() -> None:
    table = build(solved(SMOOTH, np.array([[1.0] * 6, [-1.0] * 6])), RANGE)
    assert table.answer((HIGH * (1 - 1e-9)).tolist()).method == "row"
    assert table.answer((HIGH * (1 + 1e-7)).tolist()).coverage == "outside"


def test_a_partly_measured_table_answers_beside_a_row_as_well() -> None:
    whole = few()
    lacking = whole.rows.displacement.copy()
    lacking[:, 1] = np.nan
    partial = build(Rows.of(whole.rows.wrench, lacking), RANGE)
    for asked in (whole.rows.wrench[:2] + 1e-9 * steps(2)).tolist():
        full, rig = whole.answer(asked), partial.answer(asked)
        assert full.method == rig.method == "row"
        assert full.displacement is not None
        assert rig.displacement is not None
        assert rig.displacement[1] is None
        np.testing.assert_allclose(rig.displacement[2], full.displacement[2], rtol=1e-6)


def test_of_rows_close_together_the_nearest_is_found_and_of_equally_near_ones_the_first() -> None:
    base = np.random.default_rng(1).uniform(-1, 1, (300, 6)) * HIGH
    wrenches = np.concatenate((base, base + 5e-7 * HIGH, base))
    index = RowIndex(wrenches, RANGE.scale)
    asked = base + 2e-7 * HIGH
    assert index.indices(asked).tolist() == list(range(300))
    assert index.indices(base + 4e-7 * HIGH).tolist() == list(range(300, 600))
    assert (index.indices(base - 1.1e-6 * HIGH) == -1).all()
    assert index.indices(np.full((1, 6), 1e300)).tolist() == [-1]
    assert index.indices(np.full((1, 6), 1e308)).tolist() == [-1]
