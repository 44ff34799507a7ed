"""Noise of readings averages out; hysteresis and drift do not, and error bars hold them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from tests.slow import slow, slow_but
from tests.surrogate.findings.rigs import Rig
from tests.surrogate.kriging.responses import RESPONSES
from tests.surrogate.responses import HIGH, RANGE, full_wrenches
from wrenchbook.surrogate.answer import within_tolerance_many
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.findings.find import error_of_a_reading, without_effects
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

ASKED = full_wrenches(400, 77)
AXIAL = LoadRange(np.array([0, 0, 0, 0, 0, 0.0]), np.array([0, 0, 900.0, 0, 0, 0]))


def noisy(kind: str, count: int, noise: float, seed: int = 0) -> tuple[Rows, np.ndarray]:
    """Rows of a response with noise of a part of each output's range, and the ranges, m and rad."""
    rng = np.random.default_rng([seed, count])
    loads = rng.uniform(-1, 1, (count, 6))
    moved = RESPONSES[kind](loads)
    size = np.ptp(moved, axis=0)
    moved += noise * size * rng.normal(size=moved.shape)
    return Rows.of(loads * HIGH, moved, source=["rig"] * count), size


def bars_of(kind: str, count: int, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error bars and true errors of the mean, (k, 6), and whether answers are covered, (k,)."""
    rows, _ = noisy(kind, count, noise)
    result = packed_of(build(rows, RANGE)).batch(ASKED * HIGH)
    return result.errors, np.abs(result.outputs - RESPONSES[kind](ASKED)), result.coverage == 0


@pytest.mark.parametrize("kind", slow_but({"clearance"}, ["smooth", "hardening", "clearance"]))
def test_error_bars_sharpen_with_noisy_rows_and_hold(kind: str) -> None:
    """With noise of 1 % of the range they were 25 to 35 thousandths of it at 200 and 1,000 rows."""
    few, many = bars_of(kind, 200, 0.01), bars_of(kind, 800, 0.01)
    assert np.nanmedian(many[0]) < 0.75 * np.nanmedian(few[0])
    for bars, errors, _ in (few, many):
        known = np.isfinite(bars).all(axis=1)
        assert (errors <= bars)[known].mean() > 0.9
        ratio = np.median(bars[known], axis=0) / np.median(errors[known], axis=0)
        assert np.median(ratio) < 6


def test_noise_of_one_percent_leaves_answers_covered() -> None:
    """391 of 400 were thin at 1,000 rows, whatever rows were added."""
    bars, errors, covered = bars_of("clearance", 800, 0.01)
    assert covered.mean() > 0.8
    assert (errors <= bars)[covered].mean() > 0.9


def test_a_kink_is_not_taken_for_noise() -> None:
    bars, errors, _ = bars_of("kinked", 400, 0.001)
    known = np.isfinite(bars).all(axis=1)
    assert (errors <= bars)[known].mean() > 0.9


def test_the_error_bar_of_a_reading_holds_readings() -> None:
    rows, size = noisy("clearance", 400, 0.01)
    table = build(rows, RANGE)
    np.testing.assert_allclose(table.observation_noise, 1.96 * 0.01 * size, rtol=0.3)
    packed = packed_of(table)
    rng, held = np.random.default_rng(5), []
    for wrench in ASKED[:200]:
        result = packed.answer(wrench * HIGH)
        if result.error is None or None in result.error:
            continue
        parts = np.array(result.error), np.array(result.interpolation), table.observation_noise
        reading = RESPONSES["clearance"](wrench[None])[0] + 0.01 * size * rng.normal(size=6)
        held.append(np.abs(reading - result.outputs) <= error_of_a_reading(*parts))
    assert np.mean(held) > 0.9


def loop(width: float) -> Rows:
    """A ramp up and down three times at equal wrenches, with a loop of so much of the range."""
    ramp = np.concatenate([np.linspace(0, 900, 31), np.linspace(900, 0, 31)] * 3)
    moved, wrench = np.zeros((len(ramp), 6)), np.zeros((len(ramp), 6))
    wrench[:, 2] = ramp
    branch = np.sign(np.diff(ramp, prepend=-1.0))
    rng = np.random.default_rng(3)
    moved[:, 2] = 4e-4 * (ramp / 900 - width / 2 * branch) + 1e-7 * rng.normal(size=len(ramp))
    return Rows.of(wrench, moved, source=["rig"] * len(ramp))


@pytest.mark.parametrize("width", [0.02, 0.08])
def test_hysteresis_on_equal_wrenches_is_not_averaged_away(width: float) -> None:
    """A loop of 8 % from 177.0 to 209.9 um was answered as 193.4 +- 1.4 um, covered."""
    result = packed_of(build(loop(width), AXIAL)).answer([0, 0, 450, 0, 0, 0])
    up, down = 4e-4 * (0.5 - width / 2), 4e-4 * (0.5 + width / 2)
    assert result.outputs is not None
    assert result.error is not None
    assert result.outputs[2] - result.error[2] <= up
    assert result.outputs[2] + result.error[2] >= down
    assert result.measurement is not None
    assert result.measurement[2] == pytest.approx(width / 2 * 4e-4, rel=0.3)


@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_noise_of_repeated_readings_is_no_effect(noise: float) -> None:
    rng = np.random.default_rng(2)
    loads = np.repeat(rng.uniform(-1, 1, (40, 6)), 5, axis=0)
    moved = RESPONSES["smooth"](loads)
    moved += noise * np.ptp(moved, axis=0) * rng.normal(size=moved.shape)
    rows = Rows.of(loads * HIGH, moved, source=["rig"] * 200)
    shuffled = rows.take(rng.permutation(200))
    same, error = without_effects(shuffled, RANGE)
    assert same is shuffled
    assert not error.any()


def test_both_branches_of_motions_are_inside() -> None:
    """Answers follow the branch that was measured nearby; 70 to 80 % were inside."""
    held = []
    for seed in (11, 12, 13):
        rig = Rig(seed, ("motion",))
        rig.noise = 0.003
        rows = rig.measured("hysteresis of 2 %")
        asked = rig.wrench[::5] * 0.98
        result = packed_of(build(rows, rig.range)).batch(asked)
        known = np.isfinite(result.errors).all(axis=1)
        for sign in (-1, 1):
            true = rig.respond(asked) + sign * 0.01 * rig.size
            held.append((np.abs(result.outputs - true) <= result.errors)[known].mean())
    assert np.mean(held) > 0.9


def sessions(
    counts: tuple[int, ...], factors: tuple[float, ...], noise: float, output: int | None = None
) -> tuple[Rows, np.ndarray]:
    """Rows of several imports of one part, and what each reads in place of it, (s, 6)."""
    rng = np.random.default_rng([3, *counts])
    scales = np.ones((len(counts), 6))
    scales[:, range(6) if output is None else [output]] = np.reshape(factors, (-1, 1))
    session = np.repeat(np.arange(len(counts)), counts)
    loads = rng.uniform(-1, 1, (len(session), 6))
    moved = RESPONSES["clearance"](loads)
    off = noise * np.ptp(moved, axis=0) * rng.normal(size=moved.shape)
    moved = scales[session] * moved + off
    rows = Rows.of(loads * HIGH, moved, source=["rig"] * len(loads), session=1.0 + session)
    return rows, scales


@pytest.mark.parametrize("output", [None, 1])
@pytest.mark.parametrize(
    ("counts", "factors", "noise"),
    [
        slow(((150, 150), (1.0, 1.02), 0.002)),
        slow(((150, 150), (1.0, 1.02), 0.01)),
        ((60, 60), (1.0, 1.1), 0.002),
        slow(((60, 60), (1.0, 1.1), 0.01)),
        slow(((100, 30), (1.0, 1.05), 0.002)),
        slow(((60, 60, 60), (1.0, 1.05, 0.95), 0.01)),
    ],
)
def test_bars_hold_sessions_that_differ_by_a_factor(
    counts: tuple[int, ...], factors: tuple[float, ...], noise: float, output: int | None
) -> None:
    """Of covered answers 21 to 53 % were outside of either session's truth."""
    rows, scales = sessions(counts, factors, noise, output)
    result, truth = packed_of(build(rows, RANGE)).batch(ASKED * HIGH), RESPONSES["clearance"](ASKED)
    known = np.isfinite(result.errors).all(axis=1)
    for scale in scales:
        outside = np.abs(result.outputs - scale * truth) > result.errors
        assert outside[known].mean(axis=0).max() <= 0.1


@pytest.mark.parametrize(
    ("counts", "noise"),
    slow_but(
        {((60, 60), 0.01)},
        product([(150, 150), (60, 60), (40, 40, 40), (150, 20)], [0.001, 0.01, 0.03]),
    ),
)
def test_sessions_of_one_truth_widen_no_bar_by_a_tenth(
    counts: tuple[int, ...], noise: float
) -> None:
    rows, _ = sessions(counts, (1.0,) * len(counts), noise)
    table = build(rows, RANGE)
    bars = packed_of(table).batch(ASKED * HIGH).errors
    assert (table.rig_error <= 0.1 * np.nanmedian(bars, axis=0)).all()


def test_the_offset_of_a_session_counts_once() -> None:
    rows, _ = sessions((150, 150), (1.0, 1.0), 0.002)
    size = np.ptp(rows.displacement, axis=0)
    moved = rows.displacement + 0.03 * size * (rows.session == 2)[:, None]
    rows = replace(rows, displacement=moved)
    alone = without_effects(rows, RANGE)[1]
    np.testing.assert_allclose(build(rows, RANGE).rig_error, alone, rtol=0.05)
    assert (alone > 0.015 * size).all()


@pytest.mark.parametrize("is_dead", [True, False])
def test_a_dead_channel_may_jitter_by_a_digit_and_a_coarse_one_follows_its_load(
    is_dead: bool,
) -> None:
    rows, size = noisy("clearance", 150, 0.001)
    digit, moved = size[2] / 3, rows.displacement.copy()
    jitter = np.random.default_rng(5).integers(-1, 2, len(rows))
    moved[:, 2] = 1e-9 * jitter if is_dead else digit * np.round(moved[:, 2] / digit)
    error = without_effects(replace(rows, displacement=moved), RANGE)[1]
    assert np.isnan(error).tolist() == [False, False, is_dead, False, False, False]


@pytest.mark.parametrize(("load", "error"), [(1.0, None), (0.002, 0.0)])
def test_a_dead_channel_has_no_bar_and_zeros_of_a_planar_test_have(
    load: float, error: float | None
) -> None:
    rows, _ = noisy("smooth", 60, 0.001)
    wrench, moved = rows.wrench.copy(), rows.displacement.copy()
    wrench[:, 2], moved[:, 2] = load * wrench[:, 2], 0.0
    table = build(replace(rows, wrench=wrench, displacement=moved), RANGE)
    assert table.coverage_summary()["rig_error"][2] == error
    reply = packed_of(table).answer(wrench[0], (1.0,) * 6)
    assert reply.error is not None
    assert reply.outputs is not None
    assert (reply.error[2] is None) == (error is None)
    assert reply.within_tolerance is (None if error is None else True)
    bars = np.array([reply.error], dtype=float)
    many = within_tolerance_many(np.array([reply.outputs], float), bars, Tolerance(1.0, 1.0))
    assert many == [reply.within_tolerance]
