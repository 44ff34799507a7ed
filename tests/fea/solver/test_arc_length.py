"""The path followed by its length: to the whole load, or to that at which the part gives way."""

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.solver.test_nonlinear import PLATE_WRENCH, plate
from tests.fea.test_failures import arch
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.arc_length import ArcPath
from wrenchbook.fea.solver.load_steps import LoadPath
from wrenchbook.fea.solver.newton import Equilibrium, find_equilibrium

YOUNG = 1e9
GUIDE = ("ux", "uy", "rx", "ry", "rz")


def refuse_load_control(monkeypatch):
    monkeypatch.setattr(LoadPath, "_explained", lambda path, result, target: False)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_where_load_control_is_refused_the_length_of_the_path_leads_to_the_same_answer(
    coupling, monkeypatch
):
    built = Solver(plate(coupling))
    expected = built.solve(PLATE_WRENCH)
    refuse_load_control(monkeypatch)
    result = built.solve(PLATE_WRENCH)
    np.testing.assert_allclose(result.displacement, expected.displacement, rtol=1e-6, atol=1e-10)
    scale = np.sqrt(np.abs(np.diagonal(expected.compliance)))
    gap = (result.compliance - expected.compliance) / np.outer(scale, scale)
    assert np.abs(gap).max() < 1e-5
    assert result.work == pytest.approx(result.strain_energy, rel=1e-4)
    factors = [step.load_factor for step in result.history]
    assert len(set(factors)) > 10
    assert factors[-1] == 1.0


def guided(mesh):
    return component(mesh, young=YOUNG, poisson=0.0, nonlinear=True, locked=GUIDE)


def test_loads_over_eighteen_decades_move_a_guided_bar_by_the_closed_form():
    bar = Solver(guided(box("hex20", (2, 2, 4), (0.1, 0.1, 0.4))))
    for force in (*(10.0**n for n in range(-9, 8)), -1.0, -1e3, -1e6):
        strain = force / (YOUNG * 0.01)
        result = bar.solve([0, 0, force, 0, 0, 0]).displacement[2] / 0.4
        expected = strain - 1.5 * strain**2  # of (1 + e) (e + e^2/2) = strain
        if abs(strain) > 1e-6:
            law = np.polynomial.Polynomial([-strain, 1.0, 1.5, 0.5])
            expected = brentq(law, -0.4, 5, xtol=1e-15)
        assert result == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("times", [1.2, 4.0, 1000.0])
def test_a_squeezed_block_gives_way_at_the_closed_form_of_its_material(times):
    """F = E A l (1 - l^2)/2 has its maximum, E A / sqrt(27), at l = 1/sqrt(3)."""
    most = YOUNG / np.sqrt(27)
    built = Solver(guided(box("hex20", (2, 2, 2), (1.0, 1.0, 0.5))))
    assert built.solve([0, 0, -0.99 * most, 0, 0, 0]).displacement[2] < -0.15
    with pytest.raises(SolveFailed) as caught:
        built.solve([0, 0, -times * most, 0, 0, 0])
    assert caught.value.kind == "snap_through"
    assert caught.value.load_factor == pytest.approx(1 / times, rel=2e-3)


def test_a_turn_that_is_too_large_says_under_which_part_of_the_wrench():
    mesh = box("hex20", (2, 2, 16), (0.01, 0.01, 1.0))
    built = Solver(component(mesh, nonlinear=True))
    euler = np.pi**2 * 210e9 * 0.01**4 / 12 / 4
    with pytest.raises(SolveFailed, match=r"under 1?0?\.\d+ of this wrench already") as caught:
        built.solve([0.1, 0, -1.5 * euler, 0, 0, 0])
    assert caught.value.kind == "rotation_too_large"


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
        result = built.solve(wrench, start=state)
        state = result.state
    cold = built.solve(PLATE_WRENCH)
    np.testing.assert_allclose(result.displacement, cold.displacement, rtol=1e-6, atol=1e-10)


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
        results = path._correct(*rate, point.size + ahead, normal)
        if results is None:
            path._length *= 0.5
            continue
        path._point, before = path._point_at(*results), point
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
