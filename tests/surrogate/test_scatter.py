"""Designs that show little stay uncovered when loads scatter as load cells do, and noise shows."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from tests.slow import slow, slow_but
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import space_of

SCALE = np.array([900.0] * 3 + [90.0] * 3)
RANGE = LoadRange(-SCALE, SCALE)
ASKED = np.random.default_rng(77).uniform(-1, 1, (400, 6))
LINE = np.linspace(-0.93, 0.93, 40)


def table_of(scaled: np.ndarray, moved: np.ndarray):
    return packed_of(build(Rows.of(scaled * SCALE, moved), RANGE))


def scattered(scaled: np.ndarray, deviation: float) -> np.ndarray:
    rng = np.random.default_rng(4)
    return (scaled + rng.normal(0, deviation, scaled.shape)).clip(-1, 1)


@pytest.mark.parametrize("deviation", [0.0, 1e-6, 1e-5, 1e-3])
def test_a_composite_design_of_scattered_loads_covers_nothing(deviation: float) -> None:
    """At 1e-6 of the range 316 of 400 were covered, all outside, the worst 65,000 error bars."""
    pairs = [
        [a if k == i else b if k == j else 0.0 for k in range(6)]
        for i, j in combinations(range(6), 2)
        for a in (-0.95, 0.95)
        for b in (-0.95, 0.95)
    ]
    loads = scattered(np.array(pairs), deviation)
    moved = 5e-4 * loads / (1 + 0.3 * np.abs(loads).sum(axis=1, keepdims=True))
    assert table_of(loads, moved).batch(ASKED * SCALE).coverage.all()


@pytest.mark.parametrize("deviation", [0.0, 1e-4, 1e-3, 3e-3])
@pytest.mark.parametrize("values", [9, 21])
def test_scattered_sweeps_of_single_loads_cover_no_several_loads(
    deviation: float, values: int
) -> None:
    """At 1e-3 of the range all were covered, 99 % outside, by up to half of the range."""
    sweeps = [value * item for item in np.eye(6) for value in np.linspace(-1, 1, values)]
    loads = scattered(np.array(sweeps), deviation)
    rng = np.random.default_rng(0)
    first, second = np.array(list(combinations(range(6), 2))).T
    products = loads[:, first] * loads[:, second]
    moved = 5e-4 * loads + products @ (2e-4 * rng.normal(size=(15, 6)))
    assert table_of(loads, moved).batch(ASKED * SCALE).coverage.all()


@pytest.mark.parametrize("method", ["griddata", "additive"])
@pytest.mark.parametrize(
    ("values", "noise", "seed"), [slow((21, 1e-5, 1)), slow((21, 3e-6, 1)), (9, 1e-5, 2)]
)
def test_error_bars_of_noisy_sweeps_hold_the_noise(
    method: str, values: int, noise: float, seed: int
) -> None:
    """Of what was covered 63 to 92 % lay outside, by up to 1,600 error bars."""
    rng = np.random.default_rng(seed)
    sweeps = np.array([value * item for item in np.eye(6) for value in np.linspace(-1, 1, values)])
    table = table_of(sweeps, 5e-4 * sweeps + rng.normal(0, noise, sweeps.shape))
    asked = np.array([value * item for item in np.eye(6) for value in LINE])
    result = table.batch(asked * SCALE, (1e-3,) * 6, method)
    outside = np.abs(result.outputs - 5e-4 * asked) > result.errors
    assert not result.coverage.any()
    assert outside.mean() < 0.1


def cubic(loads: np.ndarray) -> np.ndarray:
    """Return a response of cubes and products of loads, (n, k), m and rad."""
    return 1e-3 * (loads + 0.15 * loads**3 + 0.1 * loads * np.roll(loads, 2, axis=1))


@pytest.mark.parametrize(
    ("count", "interfaces", "noise"),
    slow_but(
        {(20, 1, 0.005)},
        [
            (count, interfaces, noise)
            for count, interfaces in ((20, 1), (30, 1), (40, 1), (60, 1), (40, 2))
            for noise in (0.001, 0.005)
        ],
    ),
)
def test_bars_of_few_measured_rows_hold_their_readings(
    count: int, interfaces: int, noise: float
) -> None:
    """Noise was a third of what it is: 35 to 50 % of the readings were outside."""
    scale, names = np.tile(SCALE, interfaces), ("left", "right")
    space = space_of(names[:interfaces]) if interfaces > 1 else RANGE.space
    span, outside, ratios = LoadRange(-scale, scale, space), [], []
    for seed in range(12):
        rng = np.random.default_rng([seed, count])
        loads = rng.uniform(-1, 1, (count, len(scale)))
        off = rng.normal(size=loads.shape) * noise * np.ptp(cubic(loads), axis=0)
        rows = Rows.of(loads * scale, cubic(loads) + off, space, source=["rig"] * count)
        (group,) = build(rows, span).groups
        assert group.by_kriging
        outside.append(np.abs(off) > group.row_uncertainty)
        ratios.append(group.row_uncertainty / (1.96 * noise * np.ptp(cubic(loads), axis=0)))
    assert np.concatenate(outside).mean(axis=0).max() <= 0.1
    assert np.median(ratios) < (2.5 if count == 60 else 10)


def test_stated_uncertainties_are_the_bars_of_their_rows() -> None:
    rng = np.random.default_rng(6)
    loads, stated = rng.uniform(-1, 1, (40, 6)), np.full((40, 6), 2e-5)
    moved = cubic(loads) + 1e-5 * rng.normal(size=loads.shape)
    rows = Rows.of(loads * SCALE, moved, source=["rig"] * 40, uncertainty=stated)
    (group,) = build(rows, RANGE).groups
    np.testing.assert_allclose(group.row_uncertainty, stated, rtol=1e-12)
