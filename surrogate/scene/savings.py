"""What a scene's plan saves, measured here and now on the table there is."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, thread_time

import numpy as np

from ..build import AnyTable
from ..table.rows import Floats
from .memory import array_bytes
from .part import parts_of
from .plan import Plan
from .scene_table import SceneTable, scene_table

ANSWERS = 32  # single answers timed in a run
RUNS = 5  # of which the best counts: what interrupts a run only ever makes it longer


@dataclass(frozen=True)
class Savings:
    """What the scene's table needs less than the whole's.

    Attributes
    ----------
    build_s : float or None
        Processor time of building; None where there is no table yet.
    memory_bytes : int or None
        Of the arrays that answers keep.
    us_per_answer : float or None
        Of one answer to a wrench of the scene; may be below zero.
    origin : dict of str to str
        Where each number comes from.
    """

    build_s: float | None
    memory_bytes: int | None
    us_per_answer: float | None
    origin: dict[str, str]


def measured(table: AnyTable, plan: Plan) -> tuple[SceneTable | None, Savings]:
    """Return the scene's table, if there are rows, and what it saves against the whole's.

    A component that is rigid is left out: all of the whole's is saved, and there is no table.
    """
    if not any(len(surrogate.used) for _, surrogate in parts_of(table)):
        none = "not measured: there are no rows yet"
        keys = ("build_s", "memory_bytes", "us_per_answer")
        return None, Savings(None, None, None, dict.fromkeys(keys, none))
    wrenches = _wrenches(plan)
    whole = built_s(table), array_bytes(table), _us(table, wrenches)
    if plan.decision == "rigid":
        own, cut = (0.0, 0, 0.0), None
    else:
        started = thread_time()
        cut = scene_table(table, plan.need)
        cut.answer(wrenches[0].tolist())  # what is made at the first answer
        own = thread_time() - started, array_bytes(cut), _us(cut, wrenches)
    origin = {
        "build_s": f"measured, processor time: {whole[0]:.3g} s for the whole table when it was "
        f"built, {own[0]:.3g} s for cutting the scene's from it now",
        "memory_bytes": f"counted: {whole[1]} bytes of arrays in the whole table, {own[1]} in the "
        "scene's",
        "us_per_answer": f"measured now, best of {RUNS} runs of {ANSWERS} wrenches of the scene: "
        f"{whole[2]:.3g} µs by the whole table, {own[2]:.3g} µs by the scene's",
    }
    return cut, Savings(whole[0] - own[0], whole[1] - own[1], whole[2] - own[2], origin)


def built_s(table: AnyTable) -> float:
    """Return the processor time, s, that building a table took."""
    return sum(surrogate.build_s for _, surrogate in parts_of(table))


def _wrenches(plan: Plan) -> Floats:
    """Return wrenches of the scene, (n, 6), N and N·m."""
    low, high = plan.need.span.low, plan.need.span.high
    return low + np.random.default_rng(0).uniform(size=(ANSWERS, 6)) * (high - low)


def _us(table: AnyTable | SceneTable, wrenches: Floats) -> float:
    """Return the time of one answer, µs: the best of some runs."""
    asked, times = [tuple(wrench) for wrench in wrenches.tolist()], []
    for _ in range(RUNS):
        started = perf_counter()
        for wrench in asked:
            table.answer(wrench)
        times.append(perf_counter() - started)
    return 1e6 * min(times) / len(asked)
