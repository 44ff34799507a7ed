"""The first natural frequency against closed forms and CalculiX."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.sparse.linalg import ArpackNoConvergence

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.clamped import attached, shipped
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.facets import faces_of
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Inertia, Riding, consistent_mass
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.schema import FREEDOMS
from wrenchbook.fea.tensors import rotation, skew

YOUNG, DENSITY, LENGTH, WIDTH, HEIGHT = 210e9, 7800.0, 1.0, 0.02, 0.03
AREA, BENDING = WIDTH * HEIGHT, HEIGHT * WIDTH**3 / 12
SLENDER = 1.0 / (2 * np.pi) * np.sqrt(YOUNG * BENDING / (DENSITY * AREA * LENGTH**4))
FORMS = [("hex20", (2, 2, 24)), ("tet10", (2, 2, 24)), ("wedge15", (2, 2, 24))]


def beam(kind="hex20", divisions=(2, 2, 24), density=DENSITY, **changes):
    built = component(box(kind, divisions, (WIDTH, HEIGHT, LENGTH)), poisson=0.0, **changes)
    return replace(built, materials=(replace(built.materials[0], density=density),))


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize(("kind", "divisions"), FORMS)
def test_a_clamped_beam_swings_as_euler_and_bernoulli_say(kind, divisions, coupling):
    result = Solver(beam(kind, divisions, coupling=coupling)).vibration(Riding.of())
    # Shear and the section's turning, left out by the theory, lower it by 2e-4 at 1:50.
    assert result.frequency == pytest.approx(1.8751040687**2 * SLENDER, rel=5e-4)
    assert result.mass == pytest.approx(DENSITY * AREA * LENGTH, rel=1e-12)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("times", [0.1, 1.0, 10.0])
def test_a_beam_with_a_mass_at_its_tip_meets_the_transcendental_equation(times, coupling):
    def zero(b):
        swing = np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)
        return 1 + np.cos(b) * np.cosh(b) + times * b * swing

    expected = brentq(zero, 0.1, 1.87) ** 2 * SLENDER
    mass = times * DENSITY * AREA * LENGTH
    result = Solver(beam(coupling=coupling)).vibration(Riding.of(mass))
    assert result.frequency == pytest.approx(expected, rel=5e-4)


def test_rayleighs_quotient_bounds_it_from_above():
    # The static shape under a tip force is a guess: 33/140 of the beam's own mass takes part.
    own = DENSITY * AREA * LENGTH
    built = Solver(beam())
    result = built.vibration(Riding.of(own)).frequency
    guess = np.sqrt(1 / (built.compliance[0, 0] * own * (1 + 33 / 140))) / (2 * np.pi)
    assert guess * (1 - 5e-3) < result < guess


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_massless_component_is_a_spring_under_its_mass(coupling):
    built = Solver(beam(density=None, coupling=coupling))
    result = built.vibration(Riding.of(5.0))
    assert result.mass == 0.0
    expected = np.sqrt(1 / (5.0 * built.compliance[0, 0])) / (2 * np.pi)
    assert result.frequency == pytest.approx(expected, rel=1e-9)


def test_a_component_that_weighs_next_to_nothing_is_no_other_than_a_massless_one():
    riding = Riding.of(80.0, [1.0, 1.2, 0.5, 0.1, -0.2, 0.05], [0.05, 0.02, 0.4])
    light = Solver(beam(density=1e-6)).vibration(riding)
    none = Solver(beam(density=None)).vibration(riding)
    assert light.frequency == pytest.approx(none.frequency, rel=1e-7)


def test_the_centre_of_mass_takes_its_distance_to_the_inertia():
    # A mass out on an arm is the same as one at the interface with its matrix moved there.
    arm = np.array([0.1, -0.2, 0.3])
    square = 4.0 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(Riding.of(4.0, None, arm).matrix[3:, 3:], square, atol=1e-15)
    built = Solver(beam(density=None))
    energies = Riding.of(4.0, None, arm).matrix
    values = np.linalg.eigvals(built.compliance @ energies).real
    result = built.vibration(Riding.of(4.0, None, arm)).frequency
    assert result == pytest.approx(1 / (2 * np.pi * np.sqrt(values.max())), rel=1e-9)


def test_a_locked_freedom_carries_no_inertia():
    free, held = beam(), beam(locked=("ux",))
    riding = Riding.of(5.0)
    assert Solver(held).vibration(riding).frequency > 1.4 * Solver(free).vibration(riding).frequency
    assert Solver(held).vibration(riding).interface[0] == 0.0


def test_a_beam_whose_interface_is_locked_swings_between_two_clamps():
    held = Solver(beam(locked=FREEDOMS)).vibration(Riding.of(5.0))
    # Shear and the section's turning, left out by the theory, lower it by 2e-3 at 1:50.
    assert held.frequency == pytest.approx(4.7300407449**2 * SLENDER, rel=3e-3)
    assert not held.interface.any()
    assert not held.condensed.any()


def test_a_mass_on_a_locked_interface_alone_is_named():
    with pytest.raises(ValueError, match="nothing that can move has a mass"):
        Solver(beam(density=None, locked=FREEDOMS)).vibration(Riding.of(5.0))


def test_nothing_with_a_mass_is_named():
    with pytest.raises(ValueError, match="has a mass; give"):
        Solver(beam(density=None)).vibration(Riding.of())


def test_a_mass_of_supported_cells_alone_is_named():
    mesh = box("hex8", (2, 2, 4), (WIDTH, HEIGHT, LENGTH))
    nodes = mesh.blocks[0].nodes
    below = (mesh.points[nodes][:, :, 2] < 0.3 * LENGTH).all(axis=1)
    (faces,) = faces_of((CellBlock("hex8", nodes[below]),)).values()
    groups = {**mesh.facet_groups, "base": FacetGroup((FacetBlock("quad4", faces),))}
    built = component(replace(mesh, facet_groups=groups), fixed="base", poisson=0.0)
    heavy = replace(built.materials[0], density=DENSITY)
    materials, numbers = (*built.materials, heavy), (below.astype(np.int64),)
    with pytest.raises(ValueError, match="nothing that can move has a mass; give"):
        Solver(replace(built, materials=materials, material_of_cells=numbers)).vibration(
            Riding.of()
        )


def test_a_compliance_that_is_not_positive_definite_is_ill_conditioned(monkeypatch):
    built = Solver(beam(divisions=(2, 2, 4), density=None))
    monkeypatch.setattr(Inertia, "solve", lambda self, loads: -loads)
    with pytest.raises(SolveFailed, match="not positive definite: its diagonal is") as caught:
        built.vibration(Riding.of(1.0))
    assert caught.value.kind == "ill_conditioned"


@pytest.mark.parametrize(
    ("riding", "words"),
    [
        ((-1.0,), "not -1 kg"),
        ((float("nan"),), "finite"),
        ((1.0, [1.0, 2.0]), "the inertia must be xx, yy, zz"),
        ((1.0, [-1.0, 2.0, 2.0]), "none may be negative; in --inertia give positive xx,yy,zz"),
        ((5.0, [1.0, 1.0, 5.0]), "is above the sum of the others, 1 and 1 kg"),
        ((1.0, None, [1.0]), "centre of mass must be 3"),
    ],
)
def test_a_mass_that_no_body_has_is_refused(riding, words):
    with pytest.raises(ValueError, match=words):
        Riding.of(*riding)


@pytest.mark.parametrize("kind", ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15"])
def test_the_consistent_mass_of_a_rigid_motion_is_that_of_the_body(kind):
    mesh = box(kind, (2, 3, 2), (0.2, 0.3, 0.4))
    mass = consistent_mass(mesh, [np.full(len(block), 10.0) for block in mesh.blocks])
    assert mass.sum() == pytest.approx(10.0 * 0.2 * 0.3 * 0.4, rel=1e-12)
    x, y = mesh.points[:, 0], mesh.points[:, 1]
    assert x @ (mass @ y) - x @ (mass @ x) == pytest.approx(
        10.0 * 0.4 * (0.2**2 * 0.3**2 / 4 - 0.2**3 * 0.3 / 3), rel=1e-10
    )
    assert np.linalg.eigvalsh(mass.toarray()).min() > 0


@pytest.mark.ccx
@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_calculix_finds_the_same_frequency_on_the_same_mesh(kind, tmp_path):
    calculix.require_ccx()
    mesh = box(kind, (2, 2, 6), (0.1, 0.15, 0.4))
    part = replace(component(mesh, poisson=0.3))
    part = replace(part, materials=(replace(part.materials[0], density=DENSITY),))
    lines = calculix.deck_lines(part, np.zeros(6))
    lines = [line for line in lines[: lines.index("*STEP")] if "RIGID BODY" not in line]
    place = lines.index("*SOLID SECTION, ELSET=EALL, MATERIAL=M")
    lines.insert(place, f"*DENSITY\n{DENSITY}")
    lines += ["*STEP", "*FREQUENCY", "3", "*NODE FILE", "U", "*END STEP"]
    rows = calculix.printed(lines, tmp_path)
    (mode, *_) = [row for row in rows if len(row) == 5 and row[0] == "1"]
    # Free tip: a distributed coupling without a mass holds nothing.
    ours = Solver(attached(part, coupling="distributed")).vibration(Riding.of()).frequency
    assert ours == pytest.approx(float(mode[3]), rel=1e-5)


def test_a_beams_condensed_mass_is_that_of_its_static_shapes():
    """Cubic shapes of bending: 13/35, 11/210 and 1/105; a linear one along the axis: 1/3."""
    mass = DENSITY * AREA * LENGTH
    result = Solver(beam(coupling="rigid")).vibration(Riding.of()).condensed
    np.testing.assert_allclose(result, result.T, atol=1e-12 * mass)
    along, across = result[2, 2], result[0, 0]
    assert along == pytest.approx(mass / 3, rel=1e-3)
    assert across == pytest.approx(13 / 35 * mass, rel=2e-3)
    assert abs(result[0, 4]) == pytest.approx(11 / 210 * mass * LENGTH, rel=3e-3)
    assert result[4, 4] == pytest.approx(mass * LENGTH**2 / 105, rel=5e-3)


LIGHT, SIZE = 2700.0, (0.05, 0.03, 0.4)
AXES = rotation(np.array([0.3, -0.5, 0.2]))


def bar(coupling="rigid", **options):
    mesh = box("hex20", (1, 1, 6), SIZE)
    one = component(mesh, coupling=coupling, axes=AXES, integration="full", **options)
    return Solver(replace(one, materials=(Material("all", 70e9, 0.3, density=LIGHT),)))


def frequencies(solver, held):
    """All natural frequencies, Hz, by the whole matrices."""
    system = solver._system
    inertia = Inertia(system, solver._mass, np.zeros((6, 6)))
    units = np.eye(inertia.size)
    flexible = np.stack([inertia.solve(unit) for unit in units], axis=1)
    mass = np.stack([inertia.times(unit) for unit in units], axis=1)
    stiffness = np.linalg.inv(0.5 * (flexible + flexible.T))
    kept = slice(inertia.first) if held else slice(None)
    squares = eigh(stiffness[kept, kept], 0.5 * (mass + mass.T)[kept, kept], eigvals_only=True)
    return np.sqrt(squares) / (2 * np.pi)


def test_the_frequencies_are_those_of_the_whole_part():
    solver = bar()
    result = solver.craig_bampton(20)
    np.testing.assert_allclose(result.held, frequencies(solver, held=True)[:20], rtol=1e-6)
    np.testing.assert_allclose(result.free[:10], frequencies(solver, held=False)[:10], rtol=1e-3)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_the_first_frequency_is_that_of_the_check(coupling):
    solver = bar(coupling)
    first = solver.craig_bampton(12).free[0]
    assert first == pytest.approx(solver.vibration(Riding.of()).frequency, rel=1e-4)


def test_the_stiffness_is_that_of_the_part():
    solver = bar()
    turn = np.kron(np.eye(2), AXES)
    own = turn @ solver.craig_bampton(3).stiffness[6:12, 6:12] @ turn.T
    product = own @ solver.compliance
    np.testing.assert_allclose(product, np.eye(6), atol=1e-9 * np.abs(product).max())


def test_a_rigid_motion_costs_no_energy_and_moves_the_whole_mass():
    result = bar().craig_bampton(4)
    arm = result.origins[1] - result.origins[0]
    moved = np.hstack([np.eye(3), -skew(arm)])
    rigid = np.vstack([np.eye(6), moved, np.eye(6)[3:], np.zeros((4, 6))])
    scale = np.sqrt(np.abs(np.diag(result.stiffness)))
    forces = (result.stiffness @ rigid) / scale[:, None]
    assert np.abs(forces).max() < 1e-9 * scale.max()
    mass = rigid.T @ result.mass @ rigid
    whole, centre = LIGHT * np.prod(SIZE), np.array(SIZE) / 2
    np.testing.assert_allclose(mass[:3, :3], whole * np.eye(3), atol=1e-9 * whole)
    np.testing.assert_allclose(mass[3:, :3], whole * skew(centre), atol=1e-9 * whole)
    expected = whole * (SIZE[1] ** 2 + SIZE[2] ** 2) / 3
    assert mass[3, 3] == pytest.approx(expected, rel=1e-9)


def test_a_mode_has_unit_mass_and_its_frequency_as_stiffness():
    result = bar().craig_bampton(4)
    np.testing.assert_allclose(result.mass[12:, 12:], np.eye(4), atol=1e-6)
    square = (2 * np.pi * result.held) ** 2
    np.testing.assert_allclose(result.stiffness[12:, 12:], np.diag(square), rtol=1e-12)
    assert not result.stiffness[:12, 12:].any()


def test_a_link_has_a_frame_at_each_end():
    solver = Solver(shipped("link"))
    result = solver.craig_bampton(2)
    assert result.names == ("left", "right")
    assert result.stiffness.shape == result.mass.shape == (14, 14)
    translation = np.concatenate([*[np.eye(6)[2]] * 2, np.zeros(2)])  # of both ends
    whole = solver.vibration(Riding.of()).mass
    assert translation @ result.mass @ translation == pytest.approx(whole, rel=1e-6)


@pytest.mark.parametrize(
    ("density", "locked", "modes", "words"),
    [
        (LIGHT, ("ux",), 2, "1 freedoms are locked"),
        (LIGHT, FREEDOMS, 2, "6 freedoms are locked"),
        (None, (), 2, "density"),
        (LIGHT, (), 0, "modes"),
    ],
)
def test_a_part_without_a_frame_a_density_or_modes_is_refused(density, locked, modes, words):
    part = replace(
        bar(locked=locked).component, materials=(Material("all", 70e9, 0.3, density=density),)
    )
    with pytest.raises(ValueError, match=words):
        Solver(part).craig_bampton(modes)


def test_modes_that_lanczos_does_not_find_are_a_failed_solve_with_their_number(monkeypatch):
    def stalls(*_, **__):
        raise ArpackNoConvergence("No convergence", np.empty(0), np.empty((0, 0)))

    monkeypatch.setattr("wrenchbook.fea.solver.vibration.eigsh", stalls)
    built = Solver(beam(divisions=(2, 2, 4)))
    with pytest.raises(SolveFailed, match="not find the 1 lowest vibration mode of") as failure:
        built.vibration(Riding.of(1.0))
    assert failure.value.kind == "ill_conditioned"
