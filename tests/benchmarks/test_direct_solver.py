"""The direct solver beside SuperLU and PARDISO: order, factor, six solves and the factor's size.

One thread, seconds of processor time, medians. The times of the solver here include the cells'
matrices; SuperLU and PARDISO are given the assembled one ("assembly"). "Again" is a factor with the
same pattern, as in each iteration of Newton's method. PARDISO runs if pypardiso can be imported.
"""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable
from statistics import median
from typing import Any

os.environ["MKL_NUM_THREADS"] = "1"  # before pypardiso loads it

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.linalg.test_multifrontal import matrix_of
from tests.validation.clamped import shipped
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.solve import Solver

ROUNDS = int(os.environ.get("WRENCHBOOK_BENCH_ROUNDS", "3"))
ENTRY = 8e-6  # MB of a number of a factor; indices are not counted


def block(cells: tuple[int, int, int]) -> ComponentModel:
    mesh = box("hex20", cells, tuple(0.01 * n for n in cells))
    return component(mesh, fixed="x0", section="x1")


PARTS: dict[str, Callable[[], ComponentModel]] = {
    "plate": lambda: shipped("plate"),
    "plate_thin": lambda: shipped("plate_thin"),
    "block of 12 x 12 x 12 hex20": lambda: block((12, 12, 12)),
    "slab of 40 x 40 x 3 hex20": lambda: block((40, 40, 3)),
}


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    started = time.process_time()
    result = call()
    return time.process_time() - started, result


def own(part: ComponentModel) -> dict[str, float]:
    body = Solver(part).body
    order, _ = timed(lambda: body.scatter)
    tangent = body.tangent(None)
    factor, created = timed(lambda: tangent.factor)
    solves, _ = timed(lambda: created.solve(np.ones((created.unknowns, 6))))
    fronts = [front for front in created._fronts if front.pivots.size]
    megabytes = sum(front.L.nbytes + front.W.nbytes for front in fronts) / 1e6
    return {"order": order, "factor": factor, "solves": solves, "MB": megabytes}


def superlu(matrix: Any) -> dict[str, float]:
    options = {"SymmetricMode": True}
    factor, created = timed(lambda: splu(matrix, "MMD_AT_PLUS_A", 0.0, options=options))
    solves, _ = timed(lambda: created.solve(np.ones((matrix.shape[0], 6))))
    return {"factor": factor, "solves": solves, "MB": ENTRY * created.nnz}


def pardiso(matrix: Any) -> dict[str, float]:
    import pypardiso

    upper, loads = sparse.triu(matrix).tocsr(), np.ones((matrix.shape[0], 6), order="F")
    solver = pypardiso.PyPardisoSolver(mtype=2)
    solver.set_iparm(2, 2)  # METIS
    solver.set_iparm(18, -1)  # count the factor's entries
    times = {}
    for name, phase in (("factor", 12), ("again", 22), ("solves", 33)):
        solver.set_phase(phase)
        times[name], _ = timed(lambda: solver._call_pardiso(upper, loads))
    return times | {"MB": ENTRY * solver.get_iparm(18)}


def medians(call: Callable[..., dict[str, float]], *arguments: Any) -> dict[str, float]:
    rows = [call(*arguments) for _ in range(ROUNDS)]
    return {key: median(row[key] for row in rows) for key in rows[0]}


@pytest.mark.parametrize("name", PARTS)
def test_the_factor_is_smaller_and_sooner_there_than_superlus(name: str, capsys) -> None:
    part = PARTS[name]()
    body = Solver(part).body
    with threadpool_limits(1):
        assembly, matrix = timed(lambda: matrix_of(body, body.tangent(None)))
        ours, lu, theirs = medians(own, part), medians(superlu, matrix), "not installed"
        if importlib.util.find_spec("pypardiso"):
            row = medians(pardiso, matrix)
            times = " / ".join(f"{row[key]:.2f}" for key in ("factor", "again", "solves"))
            theirs = f"{times} / {row['MB']:.0f}"
    times = " + ".join(f"{ours[key]:.2f}" for key in ("order", "factor", "solves"))
    with capsys.disabled():
        print(
            f"\n| {name} | {matrix.shape[0]:,} | {times} | {ours['MB']:.0f} | {assembly:.2f} "
            f"| {lu['factor']:.2f} / {lu['solves']:.2f} / {lu['MB']:.0f} | {theirs} |"
        )
    assert ours["MB"] < lu["MB"]
    assert ours["order"] + ours["factor"] < lu["factor"]
