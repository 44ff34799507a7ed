"""The shipped components against beam, rod and published theory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.fea.solver.test_linear import beam_compliance
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver

SHIPPED = Path(__file__).parents[2] / "data" / "components"


@pytest.fixture(scope="module")
def spring():
    return Solver(read_bundle(SHIPPED / "spring"))


def rod(shortening):
    """Return force (N) and turn (rad) of the reference spring, its upper end free to turn.

    Love/Kirchhoff: a thin inextensible rod of length L, n turns, pitch angle g, and
    a = GJ/EI = 1/(1 + nu):
    turn = 2 pi n (1 - (cos g0 cos g + a sin g0 sin g) / (cos^2 g + a sin^2 g)),
    force = GJ (2 pi n sin g0 - (2 pi n - turn) sin g) / (L r cos g), r = L cos g / (2 pi n - turn).
    """
    diameter, mean, turns, height = 1.4e-3, 22.6e-3, 5.5, 88e-3
    shear, a = 78.125e9, 1 / 1.28
    angle = 2 * np.pi * turns
    length = np.hypot(angle * mean / 2, height)
    torsion = shear * np.pi * diameter**4 / 32
    sin0, sin1 = height / length, (height - shortening) / length
    cos0, cos1 = np.sqrt(1 - sin0**2), np.sqrt(1 - sin1**2)
    turn = angle * (1 - (cos0 * cos1 + a * sin0 * sin1) / (cos1**2 + a * sin1**2))
    left = angle - turn
    radius = length * cos1 / left
    return torsion * (angle * sin0 - left * sin1) / (length * radius * cos1), turn


def test_the_rod_theory_here_is_that_of_the_reference():
    force, turn = rod(10e-3)
    assert force == pytest.approx(5.756801, rel=1e-6)
    assert np.degrees(turn) == pytest.approx(2.777071, rel=1e-6)


def test_the_spring_is_as_stiff_as_rod_theory_says(spring):
    free = 1 / spring.compliance[2, 2]
    assert free == pytest.approx(582.617, rel=5e-3)
    guided = np.linalg.inv(spring.compliance[np.ix_([2, 5], [2, 5])])[0, 0]
    assert guided == pytest.approx(585, rel=5e-3)


@pytest.mark.parametrize("millimetres", [0.5, 1, 2, 4, 6, 8, 10, 12, 14, 16, 17])
def test_the_spring_shortens_and_turns_as_rod_theory_says(spring, millimetres):
    force, turn = rod(millimetres * 1e-3)
    found = spring.solve([0, 0, -force, 0, 0, 0])
    shortening = -found.displacement[2]
    assert shortening == pytest.approx(millimetres * 1e-3, rel=5e-3)
    _, expected = rod(shortening)
    assert -found.displacement[5] == pytest.approx(expected, rel=1e-2)
    assert found.displacement[5] < 0  # right-handed and pressed: it turns by -z
    assert turn > 0


def test_the_spring_at_ten_newtons_takes_a_few_iterations(spring):
    """How long they take is in the benchmarks."""
    found = spring.solve([0, 0, -10, 0, 0, 0])
    assert len(found.history) <= 10
    assert found.unknowns > 10_000
    assert (found.displacement[[0, 1, 3, 4]] == 0).all()


def test_the_bar_is_timoshenkos_beam_in_all_six_entries():
    bundle = read_bundle(SHIPPED / "bar")
    built = Solver(bundle)
    size = bundle.mesh.parameters
    theory = beam_compliance(size["length"], size["width"], size["height"])
    # The beam runs along the interface's own x axis or z axis: sort the entries by what they are.
    along = int(np.argmax(np.ptp(built.component.mesh.points, axis=0)))
    order = np.array([(along + 1) % 3, (along + 2) % 3, along])
    places = np.concatenate([order, order + 3])
    compliance = built.compliance[np.ix_(places, places)]
    for (i, j), expected in theory.items():
        assert compliance[i, j] == pytest.approx(expected, rel=5e-3), (i, j)


@pytest.mark.parametrize("name", ["bar", "plate", "plate_thin", "spring", "link", "hot_bracket"])
def test_every_shipped_compliance_is_symmetric_positive_and_energetic(name):
    built = Solver(read_bundle(SHIPPED / name))
    assert built.linear.asymmetry < 1e-9
    assert built.linear.energy_gap < 1e-9
    active = built._active
    compliance = built.compliance[np.ix_(active, active)]
    scale = 1 / np.sqrt(np.diagonal(compliance))
    assert np.linalg.eigvalsh(compliance * np.outer(scale, scale)).min() > 0


def test_the_plates_corners_of_the_load_range_converge_in_one_load_step():
    for name in ("plate", "plate_thin"):
        bundle = read_bundle(SHIPPED / name)
        built = Solver(bundle)
        for signs in ([1, 1, 1, 1, 1, 1], [1, -1, -1, 1, -1, 1], [-1, 1, -1, -1, -1, -1]):
            found = built.solve(np.array(signs) * bundle.range.high)
            assert {step.load_factor for step in found.history} == {1.0}, name
            assert len(found.history) <= 10


def test_the_thick_plate_is_nearly_twice_as_soft_distributed_as_rigid():
    bundle = read_bundle(SHIPPED / "plate")
    interface = replace(bundle.interface, coupling="rigid")
    soft = Solver(bundle).compliance[2, 2]
    stiff = Solver(replace(bundle, interface=interface)).compliance[2, 2]
    assert soft / stiff == pytest.approx(1.9, abs=0.1)
