"""What single answers of a table cost, with compiled code and without."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import time
from typing import Any

import numpy as np

from service.files.child import child_command
from surrogate.answer import METHODS
from surrogate.build import AnyTable, build
from surrogate.table.rows import LoadRange, Rows

TIMED_QUERIES, TIMED_SECONDS = 2000, 0.5
MOST_SECONDS = 120.0  # of the other process: a build and half a second a method take far less

Times = dict[str, tuple[float, float]]


def answer_times(surrogate: AnyTable, method: str, wrenches: np.ndarray) -> tuple[float, float]:
    """Return median and 99 % of the times of single answers, µs.

    Parameters
    ----------
    wrenches : ndarray, shape (n, 6), N and N·m
        Asked in turn; the first once before, so that compiling is not counted.
    """
    asked = wrenches.tolist()
    surrogate.answer(asked[0], None, method)
    times: list[float] = []
    deadline = time.perf_counter() + TIMED_SECONDS
    while len(times) < TIMED_QUERIES and time.perf_counter() < deadline:
        wrench = asked[len(times) % len(asked)]
        started = time.perf_counter_ns()
        surrogate.answer(wrench, None, method)
        times.append((time.perf_counter_ns() - started) / 1e3)
    return float(np.median(times)), float(np.quantile(times, 0.99))


def times_without_fast(rows: Rows, load_range: LoadRange, wrenches: np.ndarray) -> Times:
    """Return the times of `answer_times` by method, as without the extra ``fast``.

    In a process of its own, which does not find numba; empty if that fails. The wrenches have
    shape (n, 6), N and N·m.
    """
    told = subprocess.run(
        child_command("service.report.without_fast"),
        input=pickle.dumps((rows, load_range, wrenches)),
        stdout=subprocess.PIPE,
        timeout=MOST_SECONDS,
        check=False,
    )
    return {} if told.returncode else json.loads(told.stdout)


def tell_times() -> None:
    """Read rows, range and wrenches from the standard input, and write the times to the output."""
    rows, load_range, wrenches = pickle.load(sys.stdin.buffer)
    surrogate = build(rows, load_range)
    times: dict[str, Any] = {
        method: answer_times(surrogate, method, wrenches) for method in METHODS
    }
    json.dump(times, sys.stdout)
