"""Properties of any table, by Hypothesis: rows, their order, their neighbourhood, the outside."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

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
from wrenchbook.surrogate.table.rows import Rows

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=15)
FEWER = settings(max_examples=6)  # of whole tables, each with its kriging


def some_table(seed: int, most: int = 40) -> Rows:
    """Return rows of random points, some of them on a coarse grid, some twice."""
    rng = np.random.default_rng(seed)
    scaled = clean_wrenches(int(rng.integers(9, most)), seed)
    coarse = rng.uniform(size=len(scaled)) < 0.3
    scaled[coarse] = np.round(scaled[coarse] * 2) / 2
    rows = table(smooth, scaled)
    again = rng.choice(len(rows), 3)
    return rows + Rows.of(
        rows.wrench[again], rows.displacement[again], seq=len(rows) + np.arange(1, 4)
    )


@FEW
@given(SEEDS)
def test_a_row_returns_itself(seed: int) -> None:
    rows = some_table(seed)
    reported = axes_of(rows).by_method(rows.wrench)  # rounding may put those on the hull beyond it
    off = np.array([[1, 2, 3], [0, 2, 4], [0, 1, 5]])
    for axis in range(3):
        mine = (rows.wrench[:, off[axis]] == 0).all(axis=1)
        exact = rows.displacement[mine, axis]
        np.testing.assert_allclose(reported.displacement[mine, axis], exact, rtol=0, atol=1e-12)


@FEW
@given(SEEDS)
def test_a_row_of_a_table_of_one_axis_returns_all_its_outputs(seed: int) -> None:
    rows = some_table(seed)
    rows = rows.take((rows.wrench[:, 1:4] == 0).all(axis=1))
    reported = axes_of(rows).by_method(rows.wrench)
    inside = reported.coverage != 2
    outputs = [0, 3, 4, 5]
    np.testing.assert_allclose(
        reported.displacement[inside][:, outputs],
        rows.displacement[inside][:, outputs],
        rtol=0,
        atol=1e-12,
    )
    assert inside.any()


@FEWER
@given(SEEDS)
def test_the_order_of_rows_changes_nothing(seed: int) -> None:
    rows = some_table(seed, 16)
    shuffled = rows.take(np.random.default_rng(seed).permutation(len(rows)))
    asked = full_wrenches(40, seed) * HIGH
    one, other = (build(each, RANGE).batch(asked) for each in (rows, shuffled))
    np.testing.assert_array_equal(one.coverage, other.coverage)
    np.testing.assert_allclose(one.displacement, other.displacement, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(one.error, other.error, rtol=1e-6, atol=1e-12)


@FEW
@given(SEEDS)
def test_one_more_row_changes_only_the_simplices_around_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # The eight corners lie on one sphere: which way their faces are parted would be arbitrary.
    scaled = clean_wrenches(60, seed) * rng.uniform(0.9, 1.0, (180, 6))
    rows = table(smooth, scaled)
    new = np.zeros(6)
    new[[0, 4, 5]] = rng.uniform(-0.8, 0.8, 3)
    more = rows + Rows.of(new * HIGH, smooth(new[None]) + 1e-3, seq=[10_000])
    before, after = axes_of(rows), axes_of(more)
    asked = np.zeros((300, 6))
    asked[:, [0, 4, 5]] = rng.uniform(-0.85, 0.85, (300, 3))
    old = before.by_method(asked * HIGH).displacement[:, 0]
    fresh = after.by_method(asked * HIGH).displacement[:, 0]
    table_x = after.axes.tables[0]
    assert table_x is not None
    shape = table_x.triangulation
    place = int(((shape.points - new[[0, 4, 5]]) ** 2).sum(axis=1).argmin())
    touched = (shape.simplices[shape.locate(asked[:, [0, 4, 5]])] == place).any(axis=1)
    np.testing.assert_allclose(fresh[~touched], old[~touched], rtol=0, atol=1e-12)
    assert (~touched).mean() > 0.2


@FEWER
@given(SEEDS, st.floats(1.01, 5.0))
def test_outside_is_never_covered(seed: int, beyond: float) -> None:
    surrogate = build(some_table(seed, 16), RANGE)
    rng = np.random.default_rng(seed)
    asked = rng.uniform(-1, 1, (40, 6))
    asked[np.arange(40), rng.integers(0, 6, 40)] = beyond * rng.choice([-1, 1], 40)
    assert (surrogate.batch(asked * HIGH).coverage == 2).all()
    assert all(surrogate.answer(w).coverage == "outside" for w in (asked[:5] * HIGH).tolist())
