"""The shipped components against theory: their meshes are fine enough for what they are for."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from fea.bundle import bundle_of, read_bundle
from fea.solve import Solver

SHIPPED = Path(__file__).parents[2] / "data" / "components"


def shipped(name, **interface):
    table = tomllib.loads((SHIPPED / name / "component.toml").read_text())
    table["interface"] |= interface
    return Solver(bundle_of(table, SHIPPED / name))


def test_the_bar_agrees_with_timoshenko_and_saint_venant_in_all_six_compliances():
    # Timoshenko's beam with Cowper's shear factor 10 (1 + nu) / (12 + 11 nu), and the torsion
    # constant 0.140577 h^4 of a square (Timoshenko and Goodier, Theory of Elasticity, 109).
    E, nu, L, h = 210e9, 0.3, 1.0, 0.02
    G, A, I = E / 2 / (1 + nu), h**2, h**4 / 12  # noqa: E741
    shear = 10 * (1 + nu) / (12 + 11 * nu) * G * A
    bend, turn = L**3 / 3 / E / I + L / shear, L / E / I
    expected = [L / E / A, bend, bend, L / G / (0.140577 * h**4), turn, turn]
    compliance = Solver(read_bundle(SHIPPED / "bar")).compliance
    np.testing.assert_allclose(np.diag(compliance), expected, rtol=5e-3)
    coupled = L**2 / 2 / E / I
    np.testing.assert_allclose(compliance[[1, 2], [5, 4]], [coupled, -coupled], rtol=5e-3)


def rod(s):
    """Force (N) and turn (degrees) of a spring shortened by `s` mm, free to turn.

    Love and Kirchhoff's thin inextensible rod, as ../shared/reference/spring.json writes it.
    """
    n, H, L, nu, G, d = 5.5, 88.0, 400.2926730568362, 0.28, 78125.0, 1.4
    a, J = 1 / (1 + nu), np.pi * d**4 / 32
    start, now = np.arcsin(H / L), np.arcsin((H - s) / L)
    stiff = np.cos(now) ** 2 + a * np.sin(now) ** 2
    theta = (
        2
        * np.pi
        * n
        * (1 - (np.cos(start) * np.cos(now) + a * np.sin(start) * np.sin(now)) / stiff)
    )
    phi = 2 * np.pi * n - theta
    r = L * np.cos(now) / phi
    force = G * J * (2 * np.pi * n * np.sin(start) - phi * np.sin(now)) / (L * r * np.cos(now))
    return force, np.degrees(theta)


def test_the_rod_theory_of_this_check_gives_the_published_rows():
    np.testing.assert_allclose(rod(1.0), [0.581903, 0.244179], rtol=2e-6)
    np.testing.assert_allclose(rod(10.0), [5.756801, 2.777071], rtol=2e-6)


@pytest.fixture(scope="module")
def spring():
    return Solver(read_bundle(SHIPPED / "spring"))


def test_the_spring_has_about_12_000_unknowns(spring):
    assert spring.unknowns == pytest.approx(12_000, rel=0.05)


@pytest.mark.parametrize(("locked", "stiffness"), [([], 582.6172697), ("guide", 585.0)])
def test_the_spring_has_the_small_load_stiffness_of_rod_theory(spring, locked, stiffness):
    solver = spring if locked == "guide" else shipped("spring", locked=locked)
    assert 1 / solver.compliance[2, 2] == pytest.approx(stiffness, rel=5e-3)


@pytest.mark.parametrize("s", [1.0, 5.0, 10.0])
def test_the_spring_turns_as_rod_theory_says_when_compressed(spring, s):
    force, turn = rod(s)
    guess = spring.solve([0, 0, -force, 0, 0, 0])
    # One Newton step in the force, to compare at the same shortening.
    miss = s / 1e3 + guess.displacement[2]
    force_now = force + miss / guess.compliance[2, 2]
    turn_now = -np.degrees(
        guess.displacement[5] - guess.compliance[5, 2] * miss / guess.compliance[2, 2]
    )
    assert turn_now == pytest.approx(turn, rel=1e-2)
    assert force_now == pytest.approx(force, rel=5e-3)


def test_a_distributed_robot_base_gives_1_9_times_the_axial_compliance_of_a_rigid_one():
    ratio = shipped("plate").compliance[2, 2] / shipped("plate", coupling="rigid").compliance[2, 2]
    assert ratio == pytest.approx(1.9, abs=0.05)


def test_the_thin_plate_is_strongly_nonlinear_over_its_range():
    plate = shipped("plate_thin")
    wrench = np.zeros(6)
    wrench[2] = plate.component.bundle.range.low[2]
    linear = plate.compliance[2, 2] * wrench[2]
    assert plate.solve(wrench).displacement[2] / linear < 0.8


def test_the_thin_plate_mesh_is_within_a_few_percent_of_a_finer_one():
    table = tomllib.loads((SHIPPED / "plate_thin" / "component.toml").read_text())
    table["mesh"] |= {"cells": 10, "rings": 5, "corner_cells": 2}
    fine = Solver(bundle_of(table, SHIPPED)).compliance
    assert shipped("plate_thin").compliance[2, 2] == pytest.approx(fine[2, 2], rel=0.03)
