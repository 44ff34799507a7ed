"""Error by the number of solves: random and filled tables, with and without second derivatives.

Tables start empty; the finite elements run here, warm. All is checked on random wrenches that no
table contains. FILL_SOLVES names the numbers of solves, comma-separated. On the random solves
griddata and the kriging of SMT (with slopes: GEKPLS), of scikit-learn and of OpenTURNS answer too,
where they are installed. The tables of surrogate/README.md come from this output.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import NearestNDInterpolator, griddata

from tests.benchmarks.peers import HOW, MISSING, openturns_kriging, sklearn_kriging, smt_kriging
from tests.surrogate.law import build
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
from wrenchbook.surrogate.design import next_wrenches
from wrenchbook.surrogate.table.rows import LoadRange, Rows

COMPONENTS = Path(__file__).parents[2] / "data" / "components"
ROUND = 24
CHECKED = 60
NEAR_ZERO = 1e-3  # of the largest output of its kind: below it a range is taken as that

# The loads that a scene has (the spring's guide takes up the others), and the largest worst error
# over range, %, by the number of solves.
LOADS = {"plate_thin": (0, 1, 2, 3, 4, 5), "plate": (0, 1, 2, 3, 4, 5), "spring": (2, 5)}
RANDOM = {
    "plate_thin": {6: 0.6, 15: 0.2, 30: 0.05, 60: 0.02},
    "spring": {4: np.inf},
}
FILLED = {
    "plate_thin": {15: 0.09, 30: 0.0215, 60: 0.0075},
    "plate": {15: 0.01},
    "spring": {6: 0.001},
}
MEDIAN = {"plate_thin": {6: 0.4, 15: 0.13, 30: 0.018, 60: 0.007}}
INSIDE = 0.9


class Lab:
    """A component's solver, its scene's load range, and wrenches no table contains."""

    def __init__(self, name: str) -> None:
        bundle = read_bundle(COMPONENTS / name)
        self.solver = Solver(bundle)
        self.loads = list(LOADS[name])
        used = np.isin(np.arange(6), self.loads)
        low, high = (np.where(used, end, 0.0) for end in (bundle.range.low, bundle.range.high))
        self.range = LoadRange(low, high)
        self.checked = self.random(CHECKED, 20261121)
        self.truth = self.rows(self.checked).displacement

    def random(self, count: int, seed: int) -> np.ndarray:
        """Return uniform wrenches of the range, shape (count, 6)."""
        part = np.random.default_rng(seed).uniform(size=(count, 6))
        return self.range.low + part * (self.range.high - self.range.low)

    def rows(self, wrenches: np.ndarray) -> Rows:
        solved = [self.solver.solve(wrench) for wrench in wrenches]
        return Rows.of(
            wrenches,
            [solution.displacement for solution in solved],
            compliance=[solution.compliance for solution in solved],
            curvature=[solution.curvature for solution in solved],
            source=["fea"] * len(solved),
        )

    def percent(self, displacement: np.ndarray) -> np.ndarray:
        """Return each output's RMS error, % of its range."""
        span = np.ptp(self.truth, axis=0)
        floor = NEAR_ZERO * np.repeat([span[:3].max(), span[3:].max()], 3)
        error = np.sqrt(((displacement - self.truth) ** 2).mean(axis=0))
        return 100 * error / np.maximum(span, floor)

    def griddata(self, rows: Rows, scale: np.ndarray, checked: np.ndarray) -> np.ndarray:
        """Return scipy's griddata in all loads at once, the nearest row outside their hull."""
        points, asked = (
            wrench[:, self.loads] / scale[self.loads] for wrench in (rows.wrench, checked)
        )
        far = NearestNDInterpolator(points, rows.displacement)(asked)
        if len(points) < len(self.loads) + 2:
            return far
        result = griddata(points, rows.displacement, asked)
        return np.where(np.isnan(result), far, result)


lab_of = functools.cache(Lab)  # both tests check the same solves


def numbers(goals: dict[int, float]) -> list[int]:
    named = os.environ.get("FILL_SOLVES")
    return [int(part) for part in named.split(",")] if named else list(goals)


def gradients(rows: Rows, scale: np.ndarray, checked: np.ndarray) -> np.ndarray:
    return smt_kriging(rows, scale, checked, gradients=True)


def cells(results: list[str]) -> None:
    print("".join(f"{result:>11}" for result in results), flush=True)


def judged(lab: Lab, rows: Rows) -> tuple[list[str], float, float, float]:
    """Return a line of a table, its worst and median output's error and the part inside."""
    started = time.process_time()
    table = build(rows, lab.range)
    built = time.process_time() - started
    result = table.batch(lab.checked)
    known = np.isfinite(result.error).all(axis=1)
    inside = ratio = np.nan
    if known.any():
        missed = np.abs(result.displacement - lab.truth)[known]
        inside = float((missed <= result.error[known]).mean(axis=0).min())
        typical = np.median(missed, axis=0)
        moved = typical > 0
        ratio = float(np.median(np.median(result.error[known], axis=0)[moved] / typical[moved]))
    error = lab.percent(result.displacement)
    line = [f"{error.max():.4f}", f"{np.median(error):.4f}", f"{100 * inside:.0f}", f"{ratio:.1f}"]
    return [*line, f"{built:.2f}"], float(error.max()), float(np.median(error)), inside


HEADS = ["solves", "worst", "median", "inside", "bar/error", "build, s"]


def complaints(name: str, count: int, worst: float, median: float, inside: float, goal: float):
    middle = MEDIAN.get(name, {}).get(count, np.inf) if goal != np.inf else np.inf
    if worst > goal:
        yield f"{name}, {count} solves: worst output {worst:.4f} % (goal {goal} %)"
    if median > middle:
        yield f"{name}, {count} solves: median output {median:.4f} % (goal {middle} %)"
    if inside < INSIDE:
        yield f"{name}, {count} solves: {inside:.0%} inside"


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", list(RANDOM))
def test_random_solves(name: str) -> None:
    lab, missed = lab_of(name), []
    peers: dict[str, Callable[[Rows, np.ndarray, np.ndarray], np.ndarray]]
    peers = {"griddata": lab.griddata}
    if MISSING:
        print(f"\nnot installed, so left out: {MISSING} ({HOW})")
    elif len(lab.loads) == 6:
        peers |= {"SMT KRG": smt_kriging, "GEKPLS": gradients}
        peers |= {"sklearn": sklearn_kriging, "OpenTURNS": openturns_kriging}
    print(f"\n{name}, random solves: RMS over range, %, at {CHECKED} wrenches not in the table;")
    print("then without second derivatives: worst, median; then the worst output of peers")
    cells([*HEADS, "plain", "", *peers])
    for count in numbers(RANDOM[name]):
        rows = lab.rows(lab.random(count, count))
        line, *figures = judged(lab, rows)
        plain = Rows.of(rows.wrench, rows.displacement, compliance=rows.compliance)
        without = lab.percent(build(plain, lab.range).batch(lab.checked).displacement)
        others = [
            lab.percent(answer(rows, lab.range.scale, lab.checked)).max()
            for answer in peers.values()
        ]
        cells(
            [f"{count}", *line, f"{without.max():.4f}", f"{np.median(without):.4f}"]
            + [f"{other:.3f}" for other in others]
        )
        missed += complaints(name, count, *figures, RANDOM[name].get(count, np.inf))
    assert not missed, "\n".join(missed)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", list(FILLED))
def test_filled_tables(name: str) -> None:
    lab, rows, missed = lab_of(name), Rows.empty(), []
    print(f"\n{name}, filled: RMS over range, %, at {CHECKED} wrenches not in the table")
    cells([*HEADS, "design, s"])
    for count in numbers(FILLED[name]):
        longest = 0.0
        while len(rows) < count:
            table = build(rows, lab.range)
            started = time.process_time()
            chosen = next_wrenches(table, min(ROUND, count - len(rows))).wrenches
            longest = max(longest, time.process_time() - started)
            rows = rows + lab.rows(chosen)
        line, worst, _, inside = judged(lab, rows)
        cells([f"{count}", *line, f"{longest:.2f}"])
        goal = FILLED[name].get(count, np.inf)
        missed += complaints("", count, worst, 0.0, inside, goal)
    assert not missed, f"{name}: " + "\n".join(missed)
