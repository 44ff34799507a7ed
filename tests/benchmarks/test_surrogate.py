"""Processor time of building a packed table against the bare triangulations that it contains."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial import Delaunay

from tests.benchmarks.test_kernel import spent
from tests.surrogate.responses import RANGE, clean_wrenches, full_wrenches, smooth, table
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import Tolerance


@pytest.mark.timeout(300)
@pytest.mark.parametrize("rows", [1000, 10_000])
def test_what_a_build_takes_over_its_bare_triangulations(rows: int) -> None:
    scaled = np.concatenate((clean_wrenches(rows, 1), full_wrenches(20, 5)))
    held = table(smooth, scaled)
    points = [
        block[:, axis.inputs]
        for block, axis in zip(clean_wrenches(rows, 1).reshape(3, -1, 6), AXES, strict=True)
    ]
    bare = spent(lambda: [Delaunay(own) for own in points])
    ours = spent(lambda: build(held, RANGE), 3)
    whole = spent(lambda: packed_of(build(held, RANGE)), 3)
    print(
        f"\n{rows:,} rows an axis, 20 full wrenches: build {ours / bare:.1f} x (at most 3), "
        f"packed too {whole / bare:.1f} x"
    )


def test_growing_a_table_of_ten_thousand_rows_takes_less_than_ten_seconds() -> None:
    rows = table(smooth, clean_wrenches(10_000 // 3, 1))
    started = time.perf_counter()
    packed_of(build(rows, RANGE, tolerance=Tolerance(1.0, 1.0)))
    took = time.perf_counter() - started
    print(f"\n10,000 rows: build {took:.1f} s (less than 10)")
    assert took < 10
