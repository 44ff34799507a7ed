"""Nonlinear analysis: large rotations, tangents, the load path."""

import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.clamped import shipped
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.linalg.multifrontal import MultifrontalFactor
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver import load_steps as path
from wrenchbook.fea.solver import newton

YOUNG = 70e9
COUPLINGS = ["rigid", "distributed"]


def strip(coupling="rigid", thickness=0.01, **changes):
    """A thin cantilever along z, 1 m by 10 mm wide, without Poisson's effect."""
    mesh = box("hex20", (2, 2, 32), (thickness, 0.01, 1.0))
    options = {"young": YOUNG, "poisson": 0.0, "nonlinear": True, **changes}
    return component(mesh, coupling=coupling, **options)


def plate(coupling="distributed", **changes):
    """A plate clamped at one edge, loaded at the other, bent well beyond its thickness."""
    mesh = box("hex20", (5, 4, 2), (0.3, 0.2, 0.003))
    options = {"young": YOUNG, "poisson": 0.33, "nonlinear": True, **changes}
    return component(mesh, fixed="x0", section="x1", coupling=coupling, **options)


BENDING = YOUNG * 0.01**4 / 12
PLATE_WRENCH = np.array([300.0, 150.0, -25.0, 2.0, 4.0, 3.0])


@pytest.mark.parametrize("thickness", [0.01, 0.001])
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_a_tip_moment_bends_a_strip_into_a_circle(coupling, thickness):
    angle = np.radians(19)
    moment = YOUNG * 0.01 * thickness**3 / 12 * angle
    result = Solver(strip(coupling, thickness)).solve([0, 0, 0, 0, moment, 0])
    ux, _, uz, _, ry, _ = result.displacement
    assert ry == pytest.approx(angle, rel=2e-4)
    assert ux == pytest.approx((1 - np.cos(angle)) / angle, rel=2e-4)
    assert uz == pytest.approx(np.sin(angle) / angle - 1, rel=2e-4)


def elastica(force):
    """Integrate theta'' = -force cos(theta) / (E I), theta(0) = 0, theta'(1) = 0."""

    def shoot(curvature):
        def slope(_, y):
            return [y[1], -force / BENDING * np.cos(y[0]), np.sin(y[0]), np.cos(y[0]) - 1]

        return solve_ivp(slope, (0, 1), [0, curvature, 0, 0], rtol=1e-10, atol=1e-12).y[:, -1]

    curvature = brentq(lambda k: shoot(k)[1], 0, 2 * force / BENDING)
    theta, _, sideways, along = shoot(curvature)
    return sideways, along, theta


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_a_tip_force_bends_a_strip_into_the_elastica(coupling):
    force = 0.65 * BENDING
    sideways, along, theta = elastica(force)
    result = Solver(strip(coupling)).solve([force, 0, 0, 0, 0, 0])
    assert result.displacement[0] == pytest.approx(sideways, rel=3e-4)
    assert result.displacement[2] == pytest.approx(along, rel=5e-4)
    assert result.displacement[4] == pytest.approx(theta, rel=3e-4)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_the_compliance_is_the_derivative_of_the_displacement(coupling):
    built = Solver(plate(coupling))
    result = built.solve(PLATE_WRENCH)
    linear = built.solve(1e-6 * PLATE_WRENCH)
    assert np.abs(result.displacement / (1e6 * linear.displacement) - 1).max() > 0.1
    for load in range(6):
        step = np.zeros(6)
        step[load] = 1e-3 * (1.0 if load < 3 else 0.1)
        ahead, behind = (built.solve(PLATE_WRENCH + s * step).displacement for s in (1, -1))
        slope = (ahead - behind) / (2 * step[load])
        scale = np.sqrt(np.abs(np.diagonal(result.compliance) * result.compliance[load, load]))
        assert np.abs((result.compliance[:, load] - slope) / scale).max() < 1e-5


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_small_loads_give_the_linear_answer_down_to_1e_minus_12_of_the_range(coupling):
    built = Solver(plate(coupling))
    expected = built.compliance @ PLATE_WRENCH
    for size in (1e-6, 1e-9, 1e-12):
        result = built.solve(size * PLATE_WRENCH)
        scale = np.abs(expected).reshape(2, 3).max(axis=1).repeat(3)
        gap = np.abs(result.displacement / size - expected) / scale
        assert gap.max() < 1e-3 * max(size, 1e-6) / 1e-6
        assert result.work == pytest.approx(result.strain_energy, rel=1e-5)


def test_the_answer_does_not_depend_on_the_load_steps(monkeypatch):
    built = Solver(plate())
    at_once = built.solve(PLATE_WRENCH)
    monkeypatch.setattr(path, "FIRST_STEP", 0.1)
    in_steps = built.solve(PLATE_WRENCH)
    assert len({step.load_factor for step in in_steps.history}) > 3
    np.testing.assert_allclose(in_steps.displacement, at_once.displacement, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(in_steps.strain_energy, at_once.strain_energy, rtol=1e-9)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_external_work_becomes_strain_energy(coupling, monkeypatch):
    built = Solver(plate(coupling))
    force = [*PLATE_WRENCH[:3], 0, 0, 0]  # dead forces have a potential, spatial moments have not
    result = built.solve(force)
    assert result.work == pytest.approx(result.strain_energy, rel=0.02)
    monkeypatch.setattr(path, "FIRST_STEP", 0.02)
    monkeypatch.setattr(path, "GROWTH", 1.0)
    assert built.solve(force).work == pytest.approx(result.strain_energy, rel=1e-5)


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_corrections_with_an_old_tangent_save_a_factorisation_and_change_no_answer(
    share, monkeypatch
):
    solver = Solver(plate())
    created = []
    linearise = System.linearise
    monkeypatch.setattr(System, "linearise", lambda *a: created.append(1) or linearise(*a))
    answer = solver.solve(share * PLATE_WRENCH)
    with_chords = len(created)
    monkeypatch.setattr(newton, "_MAX_CHORDS", 0)
    plain = solver.solve(share * PLATE_WRENCH)
    assert with_chords < len(created) - with_chords
    scale = np.abs(plain.displacement).max()
    np.testing.assert_allclose(answer.displacement, plain.displacement, rtol=0, atol=1e-10 * scale)


@pytest.mark.parametrize(
    ("size", "energy", "norm", "done"),
    [
        (1e-7, 1e-6, 1e-6, True),
        (1e-5, 1e-6, 1e-6, False),
        (1e-7, 1e-4, 1e-6, False),
        (1e-7, 1e-6, 1e-4, False),
    ],
)
def test_a_last_correction_is_small_in_displacement_energy_and_forces(size, energy, norm, done):
    balance = SimpleNamespace(norm=norm, scale=1.0)
    assert newton.Correction(balance, (None, None), size, energy).converged is done


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_the_first_correction_of_a_small_load_is_the_whole_strain_energy(coupling, monkeypatch):
    """Its work at supports, nodes and interface over twice the energy, of which it is the root."""
    sizes, correct = [], newton.correct

    def noted(*arguments):
        step = correct(*arguments)
        sizes.append(step.energy)
        return step

    monkeypatch.setattr(newton, "correct", noted)
    Solver(plate(coupling)).solve(1e-3 * PLATE_WRENCH)
    assert sizes[0] == pytest.approx(1, rel=1e-3)


def test_steps_of_a_slender_part_aim_at_the_stress_of_the_next():
    """With the stress of the state itself a spring at nearly its full load takes 13 iterations."""
    result = Solver(shipped("spring", cells_per_turn=8)).solve([0, 0, -8.0, 0, 0, 0])
    assert {step.load_factor for step in result.history} == {1.0}
    assert len(result.history) <= 7


@pytest.mark.parametrize("size", [1e-5, 1e-2])
def test_corrections_that_stay_small_are_given_up_as_roundoff(size, monkeypatch):
    balance = SimpleNamespace(norm=1.0, scale=1.0, state=SimpleNamespace(interface=np.zeros(6)))
    tangent = SimpleNamespace(correction=lambda _: (None, None), release=lambda: None)
    step = newton.Correction(balance, (None, None), size, 1.0)
    monkeypatch.setattr(newton, "correct", lambda *_: step)
    system, reported = SimpleNamespace(linearise=lambda *_: tangent), []
    with pytest.raises(newton.Stuck) as caught:
        newton.find_equilibrium(system, balance, tangent, lambda *one: reported.append(one))
    assert (caught.value.at_roundoff, len(reported)) == ((True, 3) if size < 1e-3 else (False, 16))


@pytest.mark.parametrize(("coupling", "most"), [("rigid", 15), ("distributed", 14)])
def test_an_iteration_that_turns_the_interface_beyond_half_a_turn_is_given_up(coupling, most):
    with pytest.raises(SolveFailed, match="rotation_too_large") as caught:
        Solver(strip(coupling)).solve([0, 0, 0, 0, BENDING * np.radians(200), 0])
    assert len(caught.value.history) < most  # it went on for ten more


def test_the_history_and_the_progress_tell_each_iteration():
    reported = []
    result = Solver(plate()).solve(PLATE_WRENCH, lambda done, text: reported.append((done, text)))
    assert [step.iteration for step in result.history] == list(range(1, len(result.history) + 1))
    assert {step.load_factor for step in result.history} == {1.0}
    assert result.history[-1].residual_norm < 1e-4
    fractions = [done for done, _ in reported]
    assert fractions == sorted(fractions)
    assert reported[-1][0] == 1.0
    assert reported[0][1] == "load factor 1.00, iteration 1"


def test_a_spatial_moment_about_several_axes_is_not_conservative_but_in_balance():
    """Turning the order of two large moments changes nothing: both act in full at the end."""
    built = Solver(strip())
    both = built.solve([0, 0, 0, 0.15 * BENDING, 0.2 * BENDING, 0.0])
    assert both.displacement[3] == pytest.approx(0.15, rel=2e-3)
    assert both.displacement[4] == pytest.approx(0.2, rel=2e-3)
    # The tip's moment acts about fixed axes, so the bent strip is also twisted by it.
    assert abs(both.displacement[5]) < 1e-3 * 0.2


@pytest.mark.parametrize("kind", ["hex8", "hex27", "tet10", "wedge15", "tet4"])
def test_every_kind_of_cell_converges(kind):
    mesh = box(kind, (5, 4, 2), (0.3, 0.2, 0.01))
    part = component(mesh, fixed="x0", section="x1", young=YOUNG, nonlinear=True)
    linear = Solver(replace(part, analysis=replace(part.analysis, nonlinear=False)))
    wrench = [0, 0, -800, 0, 0, 20]
    result, small = Solver(part).solve(wrench), linear.solve(wrench)
    assert result.displacement[2] == pytest.approx(small.displacement[2], rel=0.1)
    assert result.displacement[2] != pytest.approx(small.displacement[2], rel=1e-7)


@pytest.mark.parametrize("load", ["wrench", "weight", "near"])
def test_a_solve_holds_one_factor_at_a_time(load, monkeypatch):
    held, before = weakref.WeakSet(), []
    start = MultifrontalFactor.__init__

    def counted(self, *arguments):
        before.append(len(held))
        start(self, *arguments)
        held.add(self)

    near = Solver(plate()).solve(0.9 * PLATE_WRENCH).state if load == "near" else None
    part = plate()
    if load == "weight":
        heavy = tuple(replace(material, density=2700.0) for material in part.materials)
        pulled = replace(part.analysis, gravity=(0.0, 0.0, -9.81))
        part = replace(part, materials=heavy, analysis=pulled)
    built = Solver(part)
    monkeypatch.setattr(MultifrontalFactor, "__init__", counted)
    built.solve(PLATE_WRENCH, start=near)
    assert len(before) > 2
    assert not any(before)
