"""The path followed by its length: to the whole load, or to that at which the part gives way."""

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.solver.test_nonlinear import PLATE_WRENCH, plate
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.load_steps import LoadPath

YOUNG = 1e9
GUIDE = ("ux", "uy", "rx", "ry", "rz")


def refuse_load_control(monkeypatch):
    monkeypatch.setattr(LoadPath, "_explained", lambda path, found, target: False)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_where_load_control_is_refused_the_length_of_the_path_leads_to_the_same_answer(
    coupling, monkeypatch
):
    built = Solver(plate(coupling))
    expected = built.solve(PLATE_WRENCH)
    refuse_load_control(monkeypatch)
    found = built.solve(PLATE_WRENCH)
    np.testing.assert_allclose(found.displacement, expected.displacement, rtol=1e-6, atol=1e-10)
    scale = np.sqrt(np.abs(np.diagonal(expected.compliance)))
    gap = (found.compliance - expected.compliance) / np.outer(scale, scale)
    assert np.abs(gap).max() < 1e-5
    assert found.work == pytest.approx(found.strain_energy, rel=1e-4)
    factors = [step.load_factor for step in found.history]
    assert len(set(factors)) > 10
    assert factors[-1] == 1.0


def guided(mesh):
    return component(mesh, young=YOUNG, poisson=0.0, nonlinear=True, locked=GUIDE)


def test_loads_over_eighteen_decades_move_a_guided_bar_by_the_closed_form():
    bar = Solver(guided(box("hex20", (2, 2, 4), (0.1, 0.1, 0.4))))
    for force in (*(10.0**n for n in range(-9, 8)), -1.0, -1e3, -1e6):
        strain = force / (YOUNG * 0.01)
        found = bar.solve([0, 0, force, 0, 0, 0]).displacement[2] / 0.4
        expected = strain - 1.5 * strain**2  # of (1 + e) (e + e^2/2) = strain
        if abs(strain) > 1e-6:
            law = np.polynomial.Polynomial([-strain, 1.0, 1.5, 0.5])
            expected = brentq(law, -0.4, 5, xtol=1e-15)
        assert found == pytest.approx(expected, rel=1e-9)


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
