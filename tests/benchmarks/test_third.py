"""Second derivatives of each solve: error against differences of tangents, symmetry and cost.

Every shipped nonlinear component with its own mesh, and the further kinds of
tests/fea/solver/test_third_derivatives.py, at random inputs of 0.3, 0.6 and 0.9 of the range, each
along a random direction. Errors are relative to the largest entry, scaled by load range and output
size; the cost is the processor time of the second derivatives over that of the rest of the solve,
the least of five.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.fea.solver.test_third_derivatives import OTHERS, case, solver_of
from tests.fea.third_derivatives import asymmetry, error, range_of
from tests.validation.clamped import shipped
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver import third_derivatives

STEP, DOUBLINGS = 0.005, 6  # of the range: roundoff of slender parts' tangents wants long steps
SHIPPED = {
    "plate_thin": (STEP, DOUBLINGS),
    "plate": (STEP, DOUBLINGS),
    "spring": (0.05, 3, 24),  # its tangents scatter by 2e-8: each is the mean of 24
    "hot_bracket": (STEP, DOUBLINGS),
    "link": (STEP, DOUBLINGS),
}
SHARES = (0.3, 0.6, 0.9)
ROUNDS = 5


def errors_of(solver, scale, *how):
    """Return the errors and asymmetries at random inputs."""
    random, results = np.random.default_rng(23), []
    for share in SHARES:
        change = share * scale * random.uniform(-1, 1, len(scale))
        inputs = solver.component.reference_inputs + change
        direction = scale * random.uniform(-1, 1, len(scale))
        results.append((error(solver, inputs, direction, scale, *how), asymmetry(solver, inputs)))
    return np.array(results)


def cost_of(solver, inputs):
    """Return the seconds of a solve's second derivatives and of all else in it."""
    results = []
    for _ in range(ROUNDS):
        started = time.process_time()
        solution = solver.solve(inputs)
        whole = time.process_time() - started
        system = solver._system
        balance = system.balance(solution.state, inputs - solver.component.reference_inputs)
        tangent = system.linearise(balance)
        _ = tangent.nodal_response, tangent.border_response
        started = time.process_time()
        third_derivatives.third_derivatives(system, balance, tangent)
        results.append((time.process_time() - started, whole))
    own, whole = np.min(results, axis=0)
    return own, whole - own


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_components(name):
    solver = Solver(shipped(name))
    scale = range_of(solver)
    result = errors_of(solver, scale, *SHIPPED[name])
    inputs = solver.component.reference_inputs + np.where(scale == 1.0, 0.0, 0.5 * scale)
    own, rest = cost_of(solver, inputs)
    print(
        f"\n{name:12} error {result[:, 0].max():.1e}  "
        f"tangent symmetric to {result[:, 1].max():.1e}  "
        f"{1e3 * own:.0f} ms of a solve's {1e3 * rest:.0f} ms: {100 * own / rest:.1f} %"
    )
    assert result[:, 0].max() <= 1e-6
    assert result[:, 1].max() <= 1e-9


@pytest.mark.parametrize("name", OTHERS)
def test_other_kinds(name):
    result = errors_of(solver_of(name), case(name, 1.0)[2], STEP, DOUBLINGS)
    print(f"\n{name:26} error {result[:, 0].max():.1e}  symmetric to {result[:, 1].max():.1e}")
    assert result[:, 0].max() <= 1e-6
