"""Wall time of the solver beside CalculiX: the same mesh, one thread each, in turn.

Both are whole programs from cold: each round starts a new process that reads the component or the
deck, solves one wrench and prints the answer. In between, the solver's own part is told apart from
what Python takes to start and import.

`make bench NAME=fea` prints the medians and their ratios. CalculiX runs with its own default
tolerance, and with the 1e-7 that a comparison of answers needs; then answers are compared.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from statistics import median

import numpy as np
import pytest

from tests.benchmarks.kinds_of_parts import kinds
from tests.validation import calculix
from tests.validation.calculix import LINEAR, NONLINEAR, worst_gap
from tests.validation.clamped import attached, shipped
from tests.validation.plate import WRENCH
from wrenchbook.fea.accuracy.convergence import finer
from wrenchbook.fea.solve import Solver

ROUNDS = int(os.environ.get("WRENCHBOOK_BENCH_ROUNDS", "3"))
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "CCX_NPROC_EQUATION_SOLVER"), "1"
)
LOADS = {"plate_thin": WRENCH, "spring": (0.0, 0.0, -10.0, 0.0, 0.0, 0.0)}
TIGHT = {False: LINEAR, True: NONLINEAR}

COLD = """
import json, sys, time
started = time.perf_counter()
from dataclasses import replace
from wrenchbook.fea.solve import Solver
from tests.validation.clamped import attached, shipped
imported = time.perf_counter()
name, nonlinear, wrench = json.loads(sys.argv[1])
part = attached(shipped(name), coupling="rigid")
part = replace(part, analysis=replace(part.analysis, nonlinear=nonlinear))
found = Solver(part).solve(wrench)
done = time.perf_counter()
print(json.dumps([found.displacement.tolist(), imported - started, done - imported]))
"""


pytestmark = pytest.mark.skipif(not calculix.installed(), reason=calculix.ABSENT)


def part_of(name: str, nonlinear: bool):
    part = attached(shipped(name), coupling="rigid")
    return replace(part, analysis=replace(part.analysis, nonlinear=nonlinear))


def own(name: str, nonlinear: bool) -> tuple[np.ndarray, float, float]:
    """Return the answer, the wall time of the whole process, and of the solver in it, s."""
    asked = json.dumps([name, nonlinear, LOADS[name]])
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", COLD, asked],
        env={**os.environ, **ONE_THREAD},
        check=True,
        capture_output=True,
        text=True,
    )
    whole = time.perf_counter() - started
    displacement, _, solver = json.loads(done.stdout)
    return np.array(displacement), whole, solver


def side_by_side(name: str, nonlinear: bool, tight: bool, rounds: int) -> dict[str, float]:
    """Solve in turn; return medians, s, and the largest relative difference of the answers."""
    part = part_of(name, nonlinear)
    times: dict[str, list[float]] = {"process": [], "solver": [], "ccx": []}
    gap = 0.0
    for _ in range(rounds):
        result, whole, solver = own(name, nonlinear)
        turn = result[3:] if nonlinear else None
        reply = calculix.solve_rigid(part, LOADS[name], turn, tight=tight)
        gap = max(gap, worst_gap(result, reply.displacement))
        for key, seconds in (("process", whole), ("solver", solver), ("ccx", reply.seconds)):
            times[key].append(seconds)
    medians = {key: median(seconds) for key, seconds in times.items()}
    kind = "nonlinear" if nonlinear else "linear"
    how = "1e-7" if tight else "default"
    print(
        f"\n{name:<10} {kind:<9} {Solver(part).unknowns:>6} unknowns, ccx tolerance {how:<7}: "
        f"ccx {medians['ccx']:6.2f} s, own solver {medians['solver']:5.2f} s "
        f"(ratio {medians['solver'] / medians['ccx']:.2f}), whole process with imports "
        f"{medians['process']:5.2f} s (ratio {medians['process'] / medians['ccx']:.2f}), "
        f"answers {gap:.0e} apart"
    )
    return medians | {"gap": gap}


@pytest.mark.parametrize("name", list(LOADS))
def test_a_linear_solve_takes_at_most_1_2_times_as_long_as_calculix(name: str) -> None:
    result = side_by_side(name, nonlinear=False, tight=True, rounds=2 * ROUNDS + 1)
    assert result["gap"] < LINEAR
    assert result["solver"] <= 1.2 * result["ccx"]


@pytest.mark.parametrize("name", list(LOADS))
def test_a_nonlinear_solve_takes_at_most_half_as_long_as_calculix(name: str) -> None:
    """CalculiX at its own default tolerance, the less exact answer; 20 times as long: one round."""
    result = side_by_side(name, nonlinear=True, tight=False, rounds=1)
    assert result["process"] <= 0.5 * result["ccx"]


@pytest.mark.parametrize("name", list(LOADS))
def test_a_nonlinear_solve_agrees_with_calculix_when_that_converges_as_far(name: str) -> None:
    result = side_by_side(name, nonlinear=True, tight=True, rounds=1)
    assert result["gap"] < NONLINEAR
    assert result["process"] <= 0.5 * result["ccx"]


def test_six_loads_of_fifteen_thousand_unknowns_and_each_later_solve() -> None:
    """The plate at 15,000 unknowns against one ccx run of it; a later solve is 6x6 algebra."""
    part = attached(shipped("plate", cells=10, rings=5), coupling="rigid")
    part = replace(part, analysis=replace(part.analysis, nonlinear=False))
    calls = []
    for _ in range(ROUNDS):
        started = time.perf_counter()
        solver = Solver(part)
        solver.solve(WRENCH)
        first = time.perf_counter() - started
        started = time.perf_counter()
        for _ in range(200):
            solver.solve(WRENCH)
        later = (time.perf_counter() - started) / 200
        calls.append((first, later, calculix.solve_rigid(part, WRENCH).seconds))
    first, later, ccx = (median(column) for column in zip(*calls, strict=True))
    print(
        f"\nplate      linear    {solver.unknowns:>6} unknowns: "
        f"ccx, one load {ccx:.2f} s, own set-up and six loads {first:.2f} s "
        f"(ratio {first / ccx:.2f}), each later solve {1e3 * later:.3f} ms"
    )
    assert first <= 1.2 * ccx
    assert later < 1e-3 * first


@pytest.mark.parametrize("name", [name for name, _ in kinds()])
def test_each_of_the_ten_kinds_agrees_with_calculix_or_is_nearer_to_a_finer_mesh(name, tmp_path):
    """Linear, at a wrench of all six loads; above nu 0.4 volumetric strains are projected here."""
    bundle, _, _ = dict(kinds())[name](name, tmp_path)
    bundle = replace(bundle, analysis=replace(bundle.analysis, nonlinear=False))
    wrench = 0.5 * bundle.range.high * (1.0, -0.7, 0.5, 0.3, -0.6, 0.8)
    started = time.process_time()
    solver = Solver(bundle)
    result = solver.solve(wrench).displacement
    seconds = time.process_time() - started
    reply = calculix.solve_rigid(solver.component, wrench)
    gap = worst_gap(result, reply.displacement)
    print(
        f"\n{name:<22} {solver.unknowns:>6} unknowns: ccx {reply.seconds:.2f} s, own with the mesh "
        f"{seconds:.2f} s, answers {gap:.0e} apart"
    )
    if max(material.poisson_ratio for material in bundle.materials) > 0.4 and gap > LINEAR:
        halved = finer(solver)
        quartered = halved and finer(halved)
        assert quartered
        truth = quartered.linear.compliance @ wrench
        assert worst_gap(result, truth) < worst_gap(reply.displacement, truth)
    else:
        assert gap < LINEAR
