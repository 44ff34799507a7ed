"""Starting from the state of a nearby solve: the same answer, whatever the start."""

import numpy as np
import pytest

from tests.fea.solver.test_nonlinear import PLATE_WRENCH, plate
from tests.fea.test_failures import arch
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.arc_length import ArcPath
from wrenchbook.fea.solver.newton import Equilibrium, find_equilibrium

SCALE = np.array([300.0, 150, 25, 2, 4, 3])


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_start_changes_no_digit_that_counts(coupling):
    built = Solver(plate(coupling))
    near = built.solve(0.9 * PLATE_WRENCH)
    cold = built.solve(PLATE_WRENCH)
    warm = built.solve(PLATE_WRENCH, start=near.state)
    np.testing.assert_allclose(warm.displacement, cold.displacement, rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(warm.compliance, cold.compliance, rtol=1e-5, atol=1e-12)
    assert warm.strain_energy == pytest.approx(cold.strain_energy, rel=1e-6)
    assert len(warm.history) <= len(cold.history)


def test_a_chain_of_starts_ends_where_one_solve_does():
    built = Solver(plate())
    state = None
    turned = PLATE_WRENCH * np.array([1, -1, 0.5, 1, -1, 1])
    for share in (0.3, 0.6, 0.8, 1.0):
        wrench = share * PLATE_WRENCH + (1 - share) * turned
        found = built.solve(wrench, start=state)
        state = found.state
    cold = built.solve(PLATE_WRENCH)
    np.testing.assert_allclose(found.displacement, cold.displacement, rtol=1e-6, atol=1e-10)


@pytest.fixture(scope="module")
def snapped():
    """An arch that only sinks, and its stable state under 4000 N with the crown snapped through."""
    built = Solver(arch(locked=("ux", "uy", "rx", "ry", "rz")))
    system, down = built._system, np.array([0, 0, -1.0, 0, 0, 0])
    rest = Equilibrium(system.balance_at_rest, system.undeformed, 0)
    path = ArcPath(system, down, 4e4, 0.0, rest, 1 / 64, lambda _: lambda *_: None)
    sign, sunk = 1.0, 0.0
    while sunk > -0.065:  # the arc as it is, but past the limit with less load
        point = path._point
        ahead = sign * path._length / point.speed
        normal = path._field(point) / point.speed
        rate = (ahead * part for part in point.rate)
        found = path._correct(*rate, point.size + ahead, normal)
        if found is None:
            path._length *= 0.5
            continue
        path._point, before = path._point_at(*found), point
        moved = path._point.equilibrium.balance.state.nodes - before.equilibrium.balance.state.nodes
        sign = np.sign(np.vdot(path._field(path._point), moved))
        sunk = path._point.equilibrium.balance.state.interface[2]
        path._length *= 1.4 if path._point.equilibrium.iterations < 6 else 1.0
    far = path._point.equilibrium
    far = find_equilibrium(
        system, system.reload(far.balance, 4000 * down), far.tangent, lambda *_: None
    )
    assert far.tangent.stable
    assert far.balance.state.interface[2] < -0.06
    return built, far.balance.state


def test_a_start_on_a_far_branch_does_not_lead_there(snapped):
    built, state = snapped
    wrench = [0, 0, -4000, 0, 0, 0]
    cold = built.solve(wrench)
    warm = built.solve(wrench, start=state)
    assert cold.displacement[2] == pytest.approx(-7.75e-3, rel=1e-2)
    np.testing.assert_allclose(warm.displacement, cold.displacement, rtol=1e-6, atol=1e-9)


def test_past_the_limit_a_start_on_the_far_branch_is_no_excuse(snapped):
    built, state = snapped
    with pytest.raises(SolveFailed, match=r"snaps through at 0\.8") as caught:
        built.solve([0, 0, -5000, 0, 0, 0], start=state)
    assert caught.value.kind == "snap_through"
