"""Rows that differ from a table by a factor or an offset are named, others are not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.surrogate.findings.rigs import Rig
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.findings.comparison import comparison_findings
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
        (found,) = compared(rig, factor, offset)
        assert (found.cause, set(found.numbers["differ"])) == (
            "campaign",
            {"ux", "uy", "uz", "rx", "ry", "rz"},
        )
        one = found.numbers["differ"]["uz"]
        assert abs(one["factor"] - factor) < 0.01
        assert abs(one["offset"] / rig.size[2] - offset) < 0.01


def test_a_rig_ten_percent_softer_than_the_solves_is_named_from_six_rows():
    rig = Rig(3, ("random",))
    expected = rig.displacement[:6]
    (found,) = comparison_findings(1.1 * expected, expected, 1e-3 * np.abs(expected), solves=True)
    assert found.cause == "solves"
    assert "1.1 times" in found.message


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
    found = packed_of(table).batch(asked * HIGH)
    known = np.isfinite(found.errors)
    for factor in (1.0, softer):
        off = np.abs(found.outputs - factor * response(asked))
        assert (off > found.errors)[known].mean() < 0.05
    # Noise of readings at the solves' wrenches is in the answers there, and tells of no rig.
    size = np.ptp(response(asked), axis=0)
    assert (table.rig_error > 1e-3 * size).any() == (softer > 1)
