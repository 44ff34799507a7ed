"""What single answers of a table cost."""

from __future__ import annotations

import time

import numpy as np

from wrenchbook.surrogate.kernel.binding import PackedTable

TIMED_QUERIES, TIMED_SECONDS = 2000, 0.5


def answer_times(table: PackedTable, method: str, wrenches: np.ndarray) -> tuple[float, float]:
    """Return median and 99 % of the times of single answers, µs.

    Parameters
    ----------
    wrenches : ndarray, shape (n, 6), N and N·m
        Asked in turn; the first once before, so that what a first answer makes is not counted.
    """
    asked = wrenches.tolist()
    table.answer(asked[0], None, method)
    times: list[float] = []
    deadline = time.perf_counter() + TIMED_SECONDS
    while len(times) < TIMED_QUERIES and time.perf_counter() < deadline:
        wrench = asked[len(times) % len(asked)]
        started = time.perf_counter_ns()
        table.answer(wrench, None, method)
        times.append((time.perf_counter_ns() - started) / 1e3)
    return float(np.median(times)), float(np.quantile(times, 0.99))
