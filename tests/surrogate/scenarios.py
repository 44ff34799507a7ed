"""Tables as the service makes them: along motions, in clusters, on demand; and what their bars do.

The truth is a kriging of all solves of a shipped component that stand in `tables/`, or a made-up
response; either gives values and tangents at any wrench without a solve.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from tests.surrogate.calibrating import TABLES
from tests.surrogate.kriging.responses import Response, solved
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE
from wrenchbook.surrogate import build as product
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

ASKED = 300  # wrenches that answers are judged at
JOINED = 0.05  # of the range: a wrench as near to an open job joins it (DESIGN 6)
ROUNDING = 1e-9  # of the largest displacement: what the arithmetic of a truth is known to


class Truth(NamedTuple):
    """A part whose displacement and tangent are known at every wrench."""

    name: str
    load_range: LoadRange
    tolerance: Tolerance | None
    rows: Callable[[np.ndarray], Rows]

    def at(self, parts: np.ndarray) -> np.ndarray:
        """Return wrenches at parts (n, 6) of -1 to 1 of the range."""
        low, high = self.load_range.low, self.load_range.high
        return (low + high) / 2 + parts * (high - low) / 2


class Verdict(NamedTuple):
    """What a table's answers are worth.

    Attributes
    ----------
    covered : float
        Part of the answers that the table covers.
    outside : float
        Part of the covered ones whose error is outside its bar in any output.
    worst : float
        The largest part outside in one output.
    ratio : float
        Median bar over median error, the median output, over all answers with bars.
    """

    covered: float
    outside: float
    worst: float
    ratio: float


TOLERANCES = {
    "plate_thin": Tolerance(1e-5, 1e-4),
    "plate": Tolerance(1e-6, 1e-5),
    "spring": Tolerance(5e-5, 5e-4),
}


@cache
def shipped_truth(name: str) -> Truth:
    """Return the truth of a shipped component: the kriging of all its solves."""
    with np.load(TABLES / f"{name}.npz") as file:
        count = len(file["compliance"])
        rows = Rows.of(
            file["wrench"][:count],
            file["displacement"][:count],
            compliance=file["compliance"].astype(float),
            source=["fea"] * count,
        )
        load_range = LoadRange(file["low"], file["high"])
    kriging = packed_of(product.build(rows, load_range))

    def solve(wrenches: np.ndarray) -> Rows:
        moved = kriging.batch(wrenches, method="kriging", without_rows=True).outputs
        tangents = kriging.derivatives(wrenches, method="kriging", without_rows=True)
        return Rows.of(wrenches, moved, compliance=tangents, source=["fea"] * len(wrenches))

    return Truth(name, load_range, TOLERANCES[name], solve)


def made_up(name: str, response: Response) -> Truth:
    """Return the truth of a made-up response of scaled loads, without a tolerance."""
    return Truth(name, RANGE, None, lambda wrenches: solved(response, wrenches / HIGH))


def spread(count: int, seed: int) -> np.ndarray:
    """Return random parts of the range, (count, 6)."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6))


def twins(count: int, apart: float, seed: int) -> np.ndarray:
    """Return spread parts and a twin of each, `apart` of the range away."""
    rng = np.random.default_rng(seed + 1)
    first = spread(count, seed)
    way = rng.normal(size=first.shape)
    way /= np.abs(way).max(axis=1, keepdims=True)
    return np.concatenate((first, np.clip(first + apart * way, -1, 1)))


def motion(count: int, seed: int, turns: float = 1.0) -> np.ndarray:
    """Return parts along a smooth motion: each load a sum of two waves over `turns` periods."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 2 * np.pi * turns, count, endpoint=False)[:, None]
    phase, size = rng.uniform(0, 2 * np.pi, (2, 6)), rng.uniform(0.3, 0.6, (2, 6))
    return size[0] * np.sin(time + phase[0]) + (0.9 - size[0]) * np.sin(2.3 * time + phase[1])


def corner(count: int, seed: int) -> np.ndarray:
    """Return parts in one corner of the range: each load in the upper half of its range."""
    return np.random.default_rng(seed).uniform(0, 1, (count, 6))


def _table(truth: Truth, parts: np.ndarray) -> Table:
    rows = truth.rows(truth.at(parts))
    return build(rows, truth.load_range, tolerance=truth.tolerance)


def on_demand(truth: Truth, first: np.ndarray, path: np.ndarray, lot: int = 6) -> np.ndarray:
    """Return the parts that a loop along a path queues, `lot` solves at a time, after the first.

    A wrench that is not covered is queued unless an open job is within `JOINED` of the range.
    """
    parts = list(first)
    table = _table(truth, np.array(parts)) if parts else None
    queued: list[np.ndarray] = []
    for place, wrench in zip(path, truth.at(path), strict=True):
        if table is not None and table.answer(wrench.tolist()).coverage == "covered":
            continue
        if any(np.abs(place - other).max() / 2 < JOINED for other in queued):
            continue
        queued.append(place)
        if len(queued) == lot:
            parts += queued
            queued = []
            table = _table(truth, np.array(parts))
    return np.array(parts + queued)


SCENARIOS: dict[str, Callable[[Truth, int], np.ndarray]] = {
    "spread 15": lambda _, seed: spread(15, seed),
    "spread 30": lambda _, seed: spread(30, seed),
    "spread 60": lambda _, seed: spread(60, seed),
    "15 and twins 1e-5": lambda _, seed: twins(15, 1e-5, seed),
    "15 and twins 1e-4": lambda _, seed: twins(15, 1e-4, seed),
    "15 and twins 1e-3": lambda _, seed: twins(15, 1e-3, seed),
    "15 and twins 1e-2": lambda _, seed: twins(15, 1e-2, seed),
    "motion 16": lambda _, seed: motion(16, seed),
    "motion 60": lambda _, seed: motion(60, seed),
    "motion 150": lambda _, seed: motion(150, seed, 2.7),
    "motion 60, spread 13": lambda _, seed: np.concatenate((motion(60, seed), spread(13, seed))),
    "motion 60, spread 40": lambda _, seed: np.concatenate((motion(60, seed), spread(40, seed))),
    "on demand from empty": lambda truth, seed: on_demand(
        truth, spread(0, seed), motion(240, seed)
    ),
    "on demand after 13": lambda truth, seed: on_demand(truth, spread(13, seed), motion(240, seed)),
    "corner 30": lambda _, seed: corner(30, seed),
}


def asked_of(scenario: str, seed: int) -> np.ndarray:
    """Return the parts that a table is judged at: random ones and, of motions, ones beside them."""
    random = spread(ASKED, seed + 7919)
    if "motion" in scenario or "demand" in scenario:
        rng = np.random.default_rng(seed + 104729)
        turns = 2.7 if scenario == "motion 150" else 1.0
        near = motion(ASKED // 2, seed, turns) + rng.normal(scale=0.02, size=(ASKED // 2, 6))
        return np.concatenate((random[: ASKED // 2], np.clip(near, -1, 1)))
    return random


def judged(truth: Truth, parts: np.ndarray, asked: np.ndarray) -> Verdict:
    """Return what the answers of a table with rows at some parts are worth at others."""
    table = _table(truth, parts)
    wrenches = truth.at(asked)
    true, result = truth.rows(wrenches).displacement, table.batch(wrenches)
    covered = result.coverage == 0
    error = np.abs(result.displacement - true)
    rounding = ROUNDING * np.abs(true).max(axis=0)
    out = ~(error <= result.error + rounding)[covered]
    known = np.isfinite(result.error).all(axis=1)
    ratio = np.full(6, np.nan)
    if known.any():
        typical = np.maximum(np.median(error[known], axis=0), rounding + np.finfo(float).tiny)
        ratio = np.median(result.error[known], axis=0) / typical
    return Verdict(
        float(covered.mean()),
        float(out.any(axis=1).mean()) if covered.any() else 0.0,
        float(out.mean(axis=0).max()) if covered.any() else 0.0,
        float(np.median(ratio)),
    )
