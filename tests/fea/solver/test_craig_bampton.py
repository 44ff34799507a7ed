"""A part as stiffness and mass of its frames and modes, against the whole equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.clamped import shipped
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Inertia, Riding
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.tensors import rotation, skew

DENSITY, SIZE = 2700.0, (0.05, 0.03, 0.4)
AXES = rotation(np.array([0.3, -0.5, 0.2]))


def bar(coupling="rigid", **options):
    mesh = box("hex20", (1, 1, 6), SIZE)
    one = component(mesh, coupling=coupling, axes=AXES, integration="full", **options)
    return Solver(replace(one, materials=(Material("all", 70e9, 0.3, density=DENSITY),)))


def frequencies(solver, held):
    """All natural frequencies, Hz, by the whole matrices."""
    system = solver._system
    inertia = Inertia(system, solver._mass, np.zeros((6, 6)))
    units = np.eye(inertia.size)
    flexible = np.stack([inertia.solved(unit) for unit in units], axis=1)
    mass = np.stack([inertia.times(unit) for unit in units], axis=1)
    stiffness = np.linalg.inv(0.5 * (flexible + flexible.T))
    kept = slice(inertia.first) if held else slice(None)
    squares = eigh(stiffness[kept, kept], 0.5 * (mass + mass.T)[kept, kept], eigvals_only=True)
    return np.sqrt(squares) / (2 * np.pi)


def test_the_frequencies_are_those_of_the_whole_part():
    solver = bar()
    found = solver.craig_bampton(20)
    np.testing.assert_allclose(found.held, frequencies(solver, held=True)[:20], rtol=1e-6)
    np.testing.assert_allclose(found.free[:10], frequencies(solver, held=False)[:10], rtol=1e-3)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_the_first_frequency_is_that_of_the_check(coupling):
    solver = bar(coupling)
    first = solver.craig_bampton(12).free[0]
    assert first == pytest.approx(solver.vibration(Riding.of()).frequency, rel=1e-4)


def test_the_stiffness_is_that_of_the_part():
    solver = bar()
    own = solver.craig_bampton(3).stiffness[6:12, 6:12]
    product = own @ solver.compliance
    np.testing.assert_allclose(product, np.eye(6), atol=1e-9 * np.abs(product).max())


def test_a_rigid_motion_costs_no_energy_and_moves_the_whole_mass():
    found = bar().craig_bampton(4)
    arm = found.origins[1] - found.origins[0]
    turn = found.rotations[1].T @ found.rotations[0]
    moved = np.hstack([turn, -turn @ skew(found.rotations[0].T @ arm)])
    rigid = np.vstack([np.eye(6), moved, np.hstack([np.zeros((3, 3)), turn]), np.zeros((4, 6))])
    scale = np.sqrt(np.abs(np.diag(found.stiffness)))
    forces = (found.stiffness @ rigid) / scale[:, None]
    assert np.abs(forces).max() < 1e-9 * scale.max()
    mass = rigid.T @ found.mass @ rigid
    whole, centre = DENSITY * np.prod(SIZE), np.array(SIZE) / 2
    np.testing.assert_allclose(mass[:3, :3], whole * np.eye(3), atol=1e-9 * whole)
    np.testing.assert_allclose(mass[3:, :3], whole * skew(centre), atol=1e-9 * whole)
    expected = whole * (SIZE[1] ** 2 + SIZE[2] ** 2) / 3
    assert mass[3, 3] == pytest.approx(expected, rel=1e-9)


def test_a_mode_has_unit_mass_and_its_frequency_as_stiffness():
    found = bar().craig_bampton(4)
    np.testing.assert_allclose(found.mass[12:, 12:], np.eye(4), atol=1e-6)
    square = (2 * np.pi * found.held) ** 2
    np.testing.assert_allclose(found.stiffness[12:, 12:], np.diag(square), rtol=1e-12)
    assert not found.stiffness[:12, 12:].any()


def test_a_link_has_a_frame_at_each_end():
    solver = Solver(shipped("link"))
    found = solver.craig_bampton(2)
    assert found.names == ("left", "right")
    assert found.stiffness.shape == found.mass.shape == (14, 14)
    way = np.array([0.0, 0.0, 1.0])  # both ends along it, each in its own axes
    both = [np.append(turn.T @ way, np.zeros(3)) for turn in found.rotations]
    translation = np.concatenate([*both, np.zeros(2)])
    whole = solver.vibration(Riding.of()).mass
    assert translation @ found.mass @ translation == pytest.approx(whole, rel=1e-6)


@pytest.mark.parametrize(
    ("density", "locked", "modes", "words"),
    [
        (DENSITY, ("ux",), 2, "six freedoms"),
        (None, (), 2, "density"),
        (DENSITY, (), 0, "modes"),
    ],
)
def test_a_part_without_a_frame_a_density_or_modes_is_refused(density, locked, modes, words):
    part = replace(
        bar(locked=locked).component, materials=(Material("all", 70e9, 0.3, density=density),)
    )
    with pytest.raises(ValueError, match=words):
        Solver(part).craig_bampton(modes)
