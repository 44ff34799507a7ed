"""Run times of the surrogate against the scipy calls it contains, side by side in one run."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from surrogate.rows import Tolerance
from surrogate.surrogate import Surrogate
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table

ASKED = full_wrenches(2000, 7) * 0.9


def microseconds(call: Callable[[int], object], count: int = 2000) -> float:
    """Return the best of seven mean times of one call, µs."""
    best = float("inf")
    for _ in range(7):
        start = time.perf_counter()
        for place in range(count):
            call(place)
        best = min(best, time.perf_counter() - start)
    return best / count * 1e6


def built(per_axis: int) -> tuple[Surrogate, list[LinearNDInterpolator], float]:
    rows = table(smooth, clean_wrenches(per_axis, 1))
    start = time.perf_counter()
    surrogate = Surrogate.build(rows, RANGE, tolerance=Tolerance(1.0, 1.0))
    seconds = time.perf_counter() - start
    bare = [
        LinearNDInterpolator(axis.interpolant.delaunay, axis.values)
        for axis in surrogate.composition.tables
        if axis is not None
    ]
    return surrogate, bare, seconds


def test_a_full_answer_costs_at_most_five_times_its_three_bare_interpolations() -> None:
    surrogate, bare, _ = built(1000)
    points = [
        np.ascontiguousarray(ASKED[:, list(axis.axis.inputs)])
        for axis in surrogate.composition.tables
        if axis is not None
    ]
    wrenches = (ASKED * HIGH).tolist()
    assert all(surrogate.answer(wrench).coverage == "covered" for wrench in wrenches[:100])

    def three(place: int) -> None:
        for interpolator, inputs in zip(bare, points, strict=True):
            interpolator(inputs[place])

    alone = microseconds(three)
    full = microseconds(lambda place: surrogate.answer(wrenches[place]))
    print(f"\nthree bare calls {alone:.1f} µs, full answer {full:.1f} µs, ratio {full / alone:.2f}")
    assert full <= 5 * alone


def test_a_batch_and_a_build_of_ten_thousand_rows() -> None:
    surrogate, bare, seconds = built(3400)
    asked = full_wrenches(100_000, 3) * 0.95
    start = time.perf_counter()
    batch = surrogate.batch(asked * HIGH)
    ours = time.perf_counter() - start
    start = time.perf_counter()
    for interpolator, axis in zip(bare, surrogate.composition.tables, strict=True):
        assert axis is not None
        interpolator(asked[:, list(axis.axis.inputs)])
    theirs = time.perf_counter() - start
    print(
        f"\nbuild {seconds:.1f} s; 100,000 wrenches {ours:.2f} s, three bare calls {theirs:.2f} s"
    )
    assert (batch.coverage == 0).all()
    assert seconds < 20
