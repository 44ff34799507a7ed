"""Linear analysis: six unit loads and the 6x6 compliance."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.assembly import body
from wrenchbook.fea.linalg.multifrontal import MultifrontalFactor
from wrenchbook.fea.solve import Solver

YOUNG, POISSON = 210e9, 0.3


def slender(kind="hex20", coupling="distributed", divisions=(3, 3, 24), **changes):
    return component(box(kind, divisions, (0.02, 0.03, 1.0)), coupling=coupling, **changes)


def beam_compliance(length, width, height):
    """Return the compliance of a cantilever along z by entry (Timoshenko, Saint-Venant)."""
    area, shear = width * height, YOUNG / (2 * (1 + POISSON))
    I_y, I_x = height * width**3 / 12, width * height**3 / 12
    cowper = 10 * (1 + POISSON) / (12 + 11 * POISSON)
    terms = [np.tanh(n * np.pi * height / (2 * width)) / n**5 for n in (1, 3, 5, 7)]
    torsion = height * width**3 / 3 * (1 - 192 * width / (np.pi**5 * height) * sum(terms))
    return {
        (0, 0): length**3 / (3 * YOUNG * I_y) + length / (cowper * shear * area),
        (1, 1): length**3 / (3 * YOUNG * I_x) + length / (cowper * shear * area),
        (2, 2): length / (YOUNG * area),
        (3, 3): length / (YOUNG * I_x),
        (4, 4): length / (YOUNG * I_y),
        (5, 5): length / (shear * torsion),
        (0, 4): length**2 / (2 * YOUNG * I_y),
        (1, 3): -(length**2) / (2 * YOUNG * I_x),
    }


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_slender_bar_is_timoshenkos_beam(coupling):
    # Free warping at the clamped end and locally at the tip is not in beam theory: 1 %.
    compliance = Solver(slender(coupling=coupling)).compliance
    for (i, j), expected in beam_compliance(1.0, 0.02, 0.03).items():
        assert compliance[i, j] == pytest.approx(expected, rel=1e-2), (i, j)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_an_offset_interface_point_moves_rigidly_with_the_section(coupling):
    offset = np.array([0.1, -0.2, 0.05])
    at_centre = Solver(slender(coupling=coupling))
    centre = at_centre.component.interfaces[0].point
    offset_point = Solver(slender(coupling=coupling, point=centre + offset))
    x, y, z = offset
    carry = np.eye(6)
    carry[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # rotation x offset
    expected = carry @ at_centre.compliance @ carry.T
    np.testing.assert_allclose(
        offset_point.compliance, expected, atol=1e-10 * np.abs(expected).max()
    )


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("kind", ["hex8", "hex20", "hex27", "tet10", "wedge15"])
def test_the_compliance_is_symmetric_positive_and_equal_to_its_strain_energies(kind, coupling):
    built = Solver(slender(kind, coupling, (2, 2, 12)))
    linear = built.linear
    assert linear.asymmetry < 1e-10
    assert linear.energy_gap < 1e-10
    assert (linear.compliance == linear.compliance.T).all()
    scale = 1 / np.sqrt(np.diagonal(linear.compliance))
    assert np.linalg.eigvalsh(linear.compliance * np.outer(scale, scale)).min() > 0.01


def test_work_is_twice_the_strain_energy():
    built = Solver(slender())
    for wrench in np.random.default_rng(1).standard_normal((5, 6)):
        found = built.solve(wrench)
        assert found.work == pytest.approx(2 * found.strain_energy, rel=1e-10)
        assert found.work == pytest.approx(wrench @ found.displacement, rel=1e-14)


def test_betti_what_one_wrench_works_on_another_is_mutual():
    built = Solver(slender(coupling="rigid"))
    first, second = np.random.default_rng(3).standard_normal((2, 6))
    there = first @ built.solve(second).displacement
    back = second @ built.solve(first).displacement
    assert there == pytest.approx(back, rel=1e-12)


def test_no_load_is_no_displacement_and_still_has_a_compliance():
    for nonlinear in (False, True):
        built = Solver(slender(nonlinear=nonlinear))
        found = built.solve(np.zeros(6))
        assert not found.displacement.any()
        assert not found.nodes.any()
        np.testing.assert_array_equal(found.compliance, built.compliance)


@pytest.mark.parametrize("bad", [[1, 2, 3, 4, 5], [0, 0, np.nan, 0, 0, 0], [np.inf] * 6])
def test_a_wrench_that_is_not_six_finite_numbers_is_refused(bad):
    with pytest.raises(ValueError, match="six finite numbers"):
        Solver(slender(divisions=(1, 1, 2), integration="full")).solve(bad)


def test_six_loads_and_every_later_solve_take_one_factorisation(monkeypatch):
    """How long they take is in the benchmarks."""
    factors = []
    monkeypatch.setattr(
        body,
        "MultifrontalFactor",
        lambda *parts: factors.append(MultifrontalFactor(*parts)) or factors[-1],
    )
    built = Solver(slender())
    for wrench in np.random.default_rng(5).standard_normal((20, 6)):
        built.solve(wrench)
    assert len(factors) == 1
    assert factors[0].unknowns == built.unknowns - 6


def test_materials_are_taken_cell_by_cell():
    mesh = box("hex20", (2, 2, 4), (0.02, 0.02, 0.4))
    centres = mesh.points[mesh.blocks[0].nodes].mean(axis=1)
    part = component(mesh, poisson=0.0)
    soft, stiff = part.materials[0], part.materials[0].__class__("stiff", 2 * 210e9, 0.0)
    object.__setattr__(part, "materials", (soft, stiff))
    object.__setattr__(part, "material_of_cells", ((centres[:, 2] > 0.2).astype(int),))
    each = 0.2 / (210e9 * 0.02**2)
    assert Solver(part).compliance[2, 2] == pytest.approx(1.5 * each, rel=1e-10)
