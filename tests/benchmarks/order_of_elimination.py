"""One component in one solver, in a process of its own: ``order_of_elimination.py WHO NAME ..``.

Prints as JSON what it took. WHO is ``own``, ``solve`` or ``pardiso`` (pypardiso, in whichever
Python has it: the matrix comes in the file that NAME is).
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path


def _own(name: str, folder: str) -> dict[str, float]:
    from tests.benchmarks.unstructured import part_of
    from wrenchbook.fea.solve import Solver

    solver = Solver(part_of(name, Path(folder)))
    body = solver._system.body
    started = time.process_time()
    _ = body.scatter
    ordered = time.process_time()
    tangent = solver._system.undeformed.tangent
    # Another factor with the same pattern: the first one's time has the coupling's work in it. The
    # cells' matrices, made on its way, are timed by themselves: PARDISO is given its matrix.
    del tangent.__dict__["factor"]
    before = time.process_time()
    factor = tangent.factor
    first = time.process_time()
    _ = tangent.matrices
    cells = time.process_time() - first
    return {
        "unknowns": factor.unknowns,
        "order": ordered - started,
        "cells": cells,
        "factor": first - before - cells,
    }


def _solve(name: str, folder: str) -> dict[str, float]:
    """Solve and no more, for the memory of it."""
    from tests.benchmarks.unstructured import part_of
    from wrenchbook.fea.solve import Solver

    imported = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    Solver(part_of(name, Path(folder))).solve([300.0, -200.0, 900.0, 3.0, -2.0, 1.0])
    return {"imported": imported}


def _pardiso(path: str) -> dict[str, float]:
    import numpy as np
    import pypardiso
    import scipy.sparse as sparse

    matrix = sparse.load_npz(path).tocsr()
    solver = pypardiso.PyPardisoSolver(mtype=2)
    solver.set_iparm(2, 2)  # METIS
    load = np.ones(matrix.shape[0])
    times = []
    for phase in (11, 22):
        solver.set_phase(phase)
        started = time.process_time()
        solver._call_pardiso(matrix, load)
        times.append(time.process_time() - started)
    return {"unknowns": matrix.shape[0], "order": times[0], "factor": times[1]}


if __name__ == "__main__":
    found = {"own": _own, "solve": _solve, "pardiso": _pardiso}[sys.argv[1]](*sys.argv[2:])
    print(json.dumps(found))
