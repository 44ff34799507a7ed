"""The compliance stored with a solve is the derivative of the answer, on all shipped components.

The reference is the central difference of solves at two steps, extrapolated (Richardson): what the
extrapolation still changes bounds its own error, and that is tested first.
"""

from functools import cache

import numpy as np
import pytest

from tests.slow import slow, slow_but
from tests.validation.clamped import shipped
from wrenchbook.fea.solve import Solver

SPRING_LOADS = [(-9.9, 0.0), (-8.0, 0.005), (-1.0, -0.01), (2.0, 0.01)]
"""F_z, N, and M_z, N·m: over the shipped range of -10 to 2 N and 0.01 N·m."""


@cache
def solver_of(name):
    return Solver(shipped(name))


def load_scale(solver):
    """Return the half widths of the load range, shape (6,), N and N·m."""
    loads = solver.component.bundle.range
    return 0.5 * (loads.high - loads.low)


def extrapolated_difference(solver, wrench, direction, step, start):
    """Return du/d(direction), shape (6,), and a bound of its error from two steps."""

    def central(h):
        ends = (solver.solve(wrench + s * h * direction, start=start) for s in (1, -1))
        above, below = (result.displacement for result in ends)
        return (above - below) / (2 * h)

    coarse, fine = central(2 * step), central(step)
    return fine + (fine - coarse) / 3, np.abs(fine - coarse)


@pytest.mark.parametrize(("force", "moment"), slow_but({(-8.0, 0.005)}, SPRING_LOADS))
def test_the_tangent_of_the_slender_spring_is_that_of_its_answers(force, moment):
    solver = solver_of("spring")
    wrench = np.array([0, 0, force, 0, 0, moment], dtype=float)
    result = solver.solve(wrench)
    for column, step in ((2, 1e-2), (5, 1e-4)):
        truth, own_error = extrapolated_difference(
            solver, wrench, np.eye(6)[column], step, result.state
        )
        reported = result.compliance[:, column]
        moving = [2, 5]
        assert (own_error[moving] <= 5e-7 * np.abs(truth[moving])).all()
        assert reported[moving] == pytest.approx(truth[moving], rel=1e-6, abs=0)


@pytest.mark.parametrize("name", ["plate_thin", slow("plate")])
def test_the_tangent_of_a_plate_is_that_of_its_answers(name):
    solver = solver_of(name)
    scale = load_scale(solver)
    random = np.random.default_rng(5)
    for share in (0.2, 0.9):
        wrench = share * scale * random.uniform(-1, 1, 6)
        direction = scale * random.uniform(-1, 1, 6)
        result = solver.solve(wrench)
        truth, own_error = extrapolated_difference(solver, wrench, direction, 2.5e-4, result.state)
        reported = result.compliance @ direction
        size = np.array([np.abs(truth[:3]).max()] * 3 + [np.abs(truth[3:]).max()] * 3)
        assert (own_error <= 5e-7 * size).all()
        assert (np.abs(reported - truth) <= 1e-6 * size).all()


@pytest.mark.parametrize("load", [slow(-9.5), -9.9, slow(-7.0), slow(-3.0)])
def test_a_slender_part_s_answer_is_not_moved_by_more_newton_steps(load):
    solver = solver_of("spring")
    wrench = np.array([0, 0, load, 0, 0, 0], dtype=float)
    result = solver.solve(wrench)
    again = solver.solve(wrench, start=result.state)
    moving = [2, 5]
    assert again.displacement[moving] == pytest.approx(result.displacement[moving], rel=1e-9, abs=0)
