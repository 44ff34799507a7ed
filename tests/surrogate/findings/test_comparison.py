"""Rows that differ from a table by a factor or an offset are named, others are not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.surrogate.findings.rigs import Rig
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.findings.comparison import comparison_findings, scale_factor
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import Rows

NOISE = 0.003  # of each output's range


def compared(rig, factor=1.0, offset=0.0, **more):
    noise = NOISE * rig.size * rig.rng.normal(size=rig.displacement.shape)
    moved = factor * rig.displacement + offset * rig.size + noise
    bars = np.broadcast_to(2 * NOISE * rig.size, moved.shape)
    return comparison_findings(moved, rig.displacement, bars, solves=False, **more)


def test_twenty_campaigns_of_one_part_agree():
    assert [compared(Rig(seed)) for seed in range(20)] == [[]] * 20


@pytest.mark.parametrize(("factor", "offset"), [(1.05, 0.0), (0.9, 0.0), (1.0, 0.05)])
def test_another_factor_or_offset_is_named_with_its_size(factor, offset):
    for seed in range(20):
        rig = Rig(seed)
        (result,) = compared(rig, factor, offset)
        assert (result.cause, set(result.numbers["differ"])) == (
            "campaign",
            {"ux", "uy", "uz", "rx", "ry", "rz"},
        )
        one = result.numbers["differ"]["uz"]
        assert abs(one["factor"] - factor) < 0.01
        assert abs(one["offset"] / rig.size[2] - offset) < 0.01


def test_a_rig_ten_percent_softer_than_the_solves_is_named_from_six_rows():
    rig = Rig(3, ("random",))
    expected = rig.displacement[:6]
    (result,) = comparison_findings(1.1 * expected, expected, 1e-3 * np.abs(expected), solves=True)
    assert result.cause == "solves"
    assert "1.1 times" in result.message


def test_an_offset_of_rounding_is_not_named():
    rig = Rig(3, ("random",))
    expected = rig.displacement[:6]
    bars = 1e-3 * np.abs(expected)
    (result,) = comparison_findings(1.1 * expected, expected, bars, solves=True)
    assert "(ux is 1.1 times theirs, uy" in result.message
    (result,) = comparison_findings(1.1 * expected + rig.size, expected, bars, solves=True)
    assert f"{rig.size[0]:+.2g} m, uy" in result.message


def test_the_factor_of_a_dead_channel_is_zero():
    """It was 4.44e-16, a rounding error."""
    rig = Rig(3, ("random",))
    expected = rig.displacement[:6]
    moved = expected * [0, 1000, 1.1, 1.1, 1.1, 1.1]
    (result,) = comparison_findings(moved, expected, 1e-3 * np.abs(expected), solves=True)
    assert "(ux is 0 times theirs, uy is 1000 times theirs" in result.message


def test_outputs_that_the_table_does_not_know_are_not_compared():
    rig = Rig(4, ("random",))
    unknown = np.full_like(rig.displacement, np.nan)
    assert comparison_findings(2 * rig.displacement, rig.displacement, unknown, solves=False) == []


@pytest.mark.parametrize("softer", [1.1, 1.0])
def test_bars_of_solves_and_of_a_softer_rig_at_some_of_their_wrenches_hold_both(softer):
    rng, response = np.random.default_rng(1), RESPONSES["smooth"]
    x, asked = (rng.uniform(-0.6, 0.6, (count, 6)) for count in (25, 100))
    measured = x[:8]
    moved = softer * response(measured) * (1 + 1e-3 * rng.normal(size=(8, 6)))
    solves = replace(solved(response, x), source=np.full(len(x), "fea"))
    rig = Rows.of(measured * HIGH, moved, seq=np.arange(100, 108), source=["rig"] * 8)
    table = build(solves + rig, RANGE)
    result = packed_of(table).batch(asked * HIGH)
    known = np.isfinite(result.errors)
    for factor in (1.0, softer):
        off = np.abs(result.outputs - factor * response(asked))
        assert (off > result.errors)[known].mean() < 0.05
    # Noise of readings at the solves' wrenches is in the answers there, and tells of no rig.
    size = np.ptp(response(asked), axis=0)
    assert (table.rig_error > 1e-3 * size).any() == (softer > 1)


def readings(seed, kind):
    """Measured and expected displacements of a rig 3 % softer, bars and stated uncertainties."""
    rng = np.random.default_rng(seed)
    count = {"few": 5, "noise": 40, "stated": 40}.get(kind, 600)
    expected = rng.uniform(-1, 1, count)
    bars, stated = np.zeros(count), np.full(count, np.nan)
    noise = rng.normal(0, 0.01, count)
    if kind == "stated":
        stated = rng.uniform(0.002, 0.05, count)
        noise = rng.normal(0, stated / 2)
    if kind == "drift":
        expected = np.sin(np.linspace(0, 20, count))
        noise += rng.normal(0, 0.02) * np.linspace(-1, 1, count)
    true = expected
    if kind == "reference":
        bars, true = 0.02 * np.abs(expected), expected / (1 + rng.uniform(-0.02, 0.02))
    return 1.03 * true + noise, expected, bars, stated


@pytest.mark.parametrize("kind", ["noise", "stated", "few", "drift", "reference"])
def test_the_interval_of_a_factor_holds_the_true_one(kind):
    held = 0
    for seed in range(200):
        factor, half_width, _ = scale_factor(*readings(seed, kind))
        held += abs(factor - 1.03) <= half_width
    assert held >= 0.92 * 200


def test_stated_uncertainties_weigh_the_rows_of_a_factor():
    y, x, bars, stated = readings(1, "stated")
    weights = stated**-2.0
    factor, half_width, _ = scale_factor(y, x, bars, stated)
    assert factor == pytest.approx((weights @ (x * y)) / (weights @ x**2), rel=1e-12)
    assert half_width < scale_factor(y, x, bars, np.full_like(stated, np.nan))[1]


def test_a_factor_without_a_bar_of_its_answers_has_no_interval():
    y, x, bars, stated = readings(2, "noise")
    bars[3] = np.nan
    factor, half_width, of_answers = scale_factor(y, x, bars, stated)
    assert factor == pytest.approx(1.03, abs=0.02)
    assert np.isnan([half_width, of_answers]).all()


def test_a_factor_of_two_rows_has_no_interval():
    y, x, bars, stated = (values[:2] for values in readings(2, "noise"))
    factor, half_width, _ = scale_factor(y, x, bars, stated)
    assert factor == pytest.approx(1.03, abs=0.1)
    assert np.isnan(half_width)
