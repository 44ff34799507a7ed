"""The savings of a scene's plan, measured on the current table."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, thread_time

import numpy as np

from ..build import Table
from ..kernel.binding import PackedTable
from ..packed.writer import packed_of
from ..table.rows import Floats
from .cut import cut
from .plan import ScenePlan

ANSWERS = 32  # single answers timed in a run, enough for the clock's resolution
RUNS = 5  # runs of which the best counts: interruptions only make a run longer


@dataclass(frozen=True)
class Savings:
    """The savings of the scene's table against the component's."""

    build_s: float | None  # s: processor time of building; None without a table
    memory_bytes: int | None  # size of the packed table
    us_per_answer: float | None  # time of one answer to a wrench of the scene
    origin: dict[str, str]  # the source of each number


def not_measured(why: str) -> Savings:
    """Return savings without numbers."""
    keys = ("build_s", "memory_bytes", "us_per_answer")
    return Savings(None, None, None, dict.fromkeys(keys, f"not measured: {why}"))


def measured(table: Table, plan: ScenePlan) -> Savings:
    """Return the savings of the scene's table against the component's.

    A component that is rigid in the scene needs no table, so everything is saved.
    """
    if not any(len(surrogate.used) for surrogate in table.groups):
        return not_measured("there are no rows yet")
    # Wrenches of the scene, (k, n), N and N·m.
    low, high = plan.need.span.low, plan.need.span.high
    wrenches = low + np.random.default_rng(0).uniform(size=(ANSWERS, len(low))) * (high - low)
    packed = packed_of(table)
    built_s = sum(surrogate.build_s for surrogate in table.groups)
    before = built_s, packed.size, _us(packed, wrenches)
    after = 0.0, 0, 0.0
    if plan.decision != "rigid":
        started = thread_time()
        content = b"".join(cut(packed, plan.need))
        took = thread_time() - started
        after = took, len(content), _us(PackedTable.from_bytes(content), wrenches)
    origin = {
        "build_s": f"measured, processor time: {before[0]:.3g} s for the whole table when it was "
        f"built, {after[0]:.3g} s for cutting the scene's from it now",
        "memory_bytes": f"counted: {before[1]} bytes in the whole table, {after[1]} in the scene's",
        "us_per_answer": f"measured now, best of {RUNS} runs of {ANSWERS} wrenches of the scene: "
        f"{before[2]:.3g} µs by the whole table, {after[2]:.3g} µs by the scene's",
    }
    # The cut of a small table can cost as much as it saves: the savings are then zero. `origin` has
    # both figures.
    build_s, memory, answer_us = (
        max(whole - part, 0) for whole, part in zip(before, after, strict=True)
    )
    return Savings(build_s, int(memory), answer_us, origin)


def _us(table: PackedTable, wrenches: Floats) -> float:
    """Return the time of one answer, µs: the best of some runs."""
    queries = [tuple(wrench) for wrench in wrenches.tolist()]
    times = []
    for _ in range(RUNS):
        started = perf_counter()
        for wrench in queries:
            table.answer(wrench)
        times.append(perf_counter() - started)
    return 1e6 * min(times) / len(queries)
