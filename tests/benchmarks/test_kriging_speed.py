"""Run times of building the kriging."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from tests.surrogate.kriging.responses import RESPONSES, solved, spread_wrenches
from tests.surrogate.responses import RANGE
from wrenchbook.surrogate.kriging import Kriging

RESPONSE = RESPONSES["strongly_coupled"]


def best(call: Callable[[], object], repeats: int) -> float:
    """Return the best of some processor times of one call, s: others may use the machine too."""
    took = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        took.append(time.process_time() - start)
    return min(took)


def rows_of(count: int):
    """Return a table of so many solves, a third of them of one axis."""
    clean = count // 9
    return solved(RESPONSE, spread_wrenches(clean, count - 3 * clean, 1))


@pytest.mark.parametrize("solves", [30, 60, 120, 400])
def test_builds_are_ready_in_time(solves: int) -> None:
    rows = rows_of(solves)
    took = best(lambda: Kriging.build(rows, RANGE), 2)
    print(f"\n{solves} solves: {took:.2f} s")
    assert took < (1 if solves <= 120 else 6)
