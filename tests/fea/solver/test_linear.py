"""Linear analysis: six unit loads and the 6x6 compliance."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.bar import beam_compliance
from wrenchbook.fea.assembly import body
from wrenchbook.fea.linalg.multifrontal import MultifrontalFactor
from wrenchbook.fea.solve import Solver

YOUNG, POISSON = 210e9, 0.3


def slender(kind="hex20", coupling="distributed", divisions=(3, 3, 24), **changes):
    return component(box(kind, divisions, (0.02, 0.03, 1.0)), coupling=coupling, **changes)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_slender_bar_is_timoshenkos_beam(coupling):
    # Free warping at the clamped end and locally at the tip is not in beam theory: 1 %.
    compliance = Solver(slender(coupling=coupling)).compliance
    turned = np.ix_(*2 * [[2, 0, 1, 5, 3, 4]])  # there along x, here along z
    for entry, expected in beam_compliance(1.0, 0.02, 0.03, YOUNG, POISSON).items():
        assert compliance[turned][entry] == pytest.approx(expected, rel=1e-2), entry


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


def test_work_is_the_strain_energy():
    built = Solver(slender())
    for wrench in np.random.default_rng(1).standard_normal((5, 6)):
        result = built.solve(wrench)
        assert result.work == pytest.approx(result.strain_energy, rel=1e-10)
        assert result.work == pytest.approx(0.5 * wrench @ result.displacement, rel=1e-14)


def test_the_work_of_a_small_load_is_the_same_by_a_linear_and_a_nonlinear_solve():
    wrench = 1e-6 * np.random.default_rng(1).standard_normal(6)
    linear, nonlinear = (Solver(slender(nonlinear=each)).solve(wrench) for each in (False, True))
    assert linear.work == pytest.approx(nonlinear.work, rel=1e-5)


def test_no_load_is_no_displacement_and_still_has_a_compliance():
    for nonlinear in (False, True):
        built = Solver(slender(nonlinear=nonlinear))
        result = built.solve(np.zeros(6))
        assert not result.displacement.any()
        assert not result.nodes.any()
        np.testing.assert_array_equal(result.compliance, built.compliance)


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


@pytest.mark.parametrize(
    ("length", "steps", "stays"),
    [(2.0, 6, True), (2.0, 1, False), (60.0, 6, False)],
    ids=["a block", "a block not refined enough", "a rod"],
)
def test_single_precision_gives_doubles_digits_or_way_to_it(length, steps, stays, monkeypatch):
    part = component(box("tet10", (3, 3, 8), (1.0, 1.0, length)), coupling="distributed")
    exact, single = Solver(part), Solver(part)
    scale = np.sqrt(np.diagonal(exact.compliance))
    monkeypatch.setattr(body, "SINGLE_NUMBERS", 0)
    monkeypatch.setattr(body, "_SINGLE_STEPS", steps)
    apart = (single.compliance - exact.compliance) / np.outer(scale, scale)
    assert np.abs(apart).max() < 1e-12
    tangents = [solver._system.undeformed.tangent for solver in (single, exact)]
    loads = np.random.default_rng(1).standard_normal((len(part.mesh.points), 3, 2))
    moved, expected = (tangent.solve(loads) for tangent in tangents)
    np.testing.assert_allclose(moved, expected, atol=1e-11 * np.abs(expected).max())
    assert [tangent.factor._single for tangent in tangents] == [stays, False]
