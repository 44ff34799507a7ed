"""Error by the number of solves: fill with the default method, beside griddata and SMT's kriging.

Tables start empty; the finite elements run here, warm, and fill asks. All is checked on random
wrenches that no table contains. FILL_SOLVES names the numbers of solves, comma-separated. The peers
get as many solves: griddata the rows that fill asked for, SMT's kriging and its gradient-enhanced
one a Latin hypercube of their own (they have no design with tangents).
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import NearestNDInterpolator, griddata
from scipy.stats import qmc

from tests.benchmarks.peers import SMT_MISSING, smt_kriging
from tests.surrogate.law import build
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
from wrenchbook.surrogate.design import next_wrenches
from wrenchbook.surrogate.surrogate import Surrogate
from wrenchbook.surrogate.table.rows import LoadRange, Rows

COMPONENTS = Path(__file__).parents[2] / "data" / "components"
ROUND = 24
CHECKED = 60
NEAR_ZERO = 1e-3  # of the largest output of its kind: below it a range is taken as that

# The loads that a scene has (the spring's guide takes up the others), and the largest worst error
# over range, %, by the number of solves.
LOADS = {"plate_thin": (0, 1, 2, 3, 4, 5), "plate": (0, 1, 2, 3, 4, 5), "spring": (2, 5)}
GOALS = {
    "plate_thin": {15: 0.7, 30: 0.12, 60: 0.08, 120: 0.04},
    "plate": {15: 0.01},
    "spring": {6: 0.01},
}
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
        self.checked = self.within(np.random.default_rng(20261121).uniform(size=(CHECKED, 6)))
        self.truth = self.rows(self.checked).displacement

    def within(self, part: np.ndarray) -> np.ndarray:
        """Return wrenches at parts (n, 6) of the range."""
        return self.range.low + part * (self.range.high - self.range.low)

    def rows(self, wrenches: np.ndarray) -> Rows:
        solved = [self.solver.solve(wrench) for wrench in wrenches]
        return Rows.of(
            wrenches,
            [one.displacement for one in solved],
            compliance=[one.compliance for one in solved],
            source=["fea"] * len(solved),
        )

    def percent(self, displacement: np.ndarray) -> float:
        """Return the worst output's RMS error, % of its range."""
        span = np.ptp(self.truth, axis=0)
        floor = NEAR_ZERO * np.repeat([span[:3].max(), span[3:].max()], 3)
        error = np.sqrt(((displacement - self.truth) ** 2).mean(axis=0))
        return float(100 * (error / np.maximum(span, floor)).max())

    def griddata(self, rows: Rows) -> np.ndarray:
        """Return scipy's griddata in all loads at once, the nearest row outside their hull."""
        points, asked = (
            wrench[:, self.loads] / self.range.scale[self.loads]
            for wrench in (rows.wrench, self.checked)
        )
        far = NearestNDInterpolator(points, rows.displacement)(asked)
        if len(points) < len(self.loads) + 2:
            return far
        told = griddata(points, rows.displacement, asked)
        return np.where(np.isnan(told), far, told)


def solves_of(name: str) -> list[int]:
    named = os.environ.get("FILL_SOLVES")
    return [int(one) for one in named.split(",")] if named else list(GOALS[name])


def grown(lab: Lab, rows: Rows, solves: int) -> tuple[Rows, Surrogate, float]:
    """Fill up to so many solves; return rows, table and the longest time a design took, s."""
    longest = 0.0
    table = build(rows, lab.range)
    while len(rows) < solves:
        started = time.perf_counter()
        asked = next_wrenches(table, min(ROUND, solves - len(rows))).wrenches
        longest = max(longest, time.perf_counter() - started)
        rows = rows + lab.rows(asked)
        table = build(rows, lab.range)
    return rows, table, longest


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", list(GOALS))
def test_error_by_the_number_of_solves(name: str) -> None:
    lab, rows = Lab(name), Rows.empty()
    print(f"\n{name}: worst output's RMS over range, %, at {CHECKED} wrenches not in the table")
    heads = ("solves", "fill", "inside %", "by", "griddata", "SMT KRG", "design, s")
    print("".join(f"{head:>10}" for head in heads))
    if SMT_MISSING:
        print(SMT_MISSING)
    missed = []
    for solves in solves_of(name):
        rows, table, took = grown(lab, rows, solves)
        found = table.batch(lab.checked)
        error = lab.percent(found.displacement)
        inside = float((np.abs(found.displacement - lab.truth) <= found.error).mean(axis=0).min())
        peer = "-"
        if not SMT_MISSING and len(lab.loads) == 6 and solves <= 60:
            own = lab.rows(lab.within(qmc.LatinHypercube(6, rng=solves).random(solves)))
            peer = f"{lab.percent(smt_kriging(own, lab.range.scale, lab.checked)):.3f}"
        plain = f"{lab.percent(lab.griddata(rows)):.2f}"
        told = (f"{solves}", f"{error:.4f}", f"{100 * inside:.0f}", table.default, plain, peer)
        print("".join(f"{one:>10}" for one in (*told, f"{took:.2f}")), flush=True)
        goal = GOALS[name].get(solves, np.inf)
        if error > goal or inside < INSIDE:
            missed.append(f"{solves} solves: {error:.3f} % (goal {goal} %), {inside:.0%} inside")
    assert not missed
