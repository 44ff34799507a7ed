"""Run times of the kriging: builds and updates."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, solved, spread_wrenches
from tests.surrogate.responses import RANGE
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.kriging.equations import equations_of, scaling_of, within
from wrenchbook.surrogate.kriging.likelihood import estimated
from wrenchbook.surrogate.kriging.settings import DEFAULTS
from wrenchbook.surrogate.table.merging import merge

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
    inside = within(rows, RANGE)
    scaling = scaling_of(inside, RANGE)
    equations = equations_of(inside, scaling, merge(inside, RANGE).readings)
    first = best(lambda: Kriging.build(rows, RANGE), 2)
    estimate = best(lambda: estimated(equations, scaling, DEFAULTS), 1)
    before = Kriging.build(rows.take(np.arange(len(rows) - 1)), RANGE)
    bordered = best(lambda: Kriging.build(rows, RANGE, before), 3)
    print(
        f"\n{solves} solves: first build {first:.2f} s (of it the estimate {estimate:.2f} s), "
        f"one more row {bordered:.3f} s"
    )
    assert bordered < (1 if solves <= 120 else 3)
    assert first < (1 if solves <= 120 else 6)
