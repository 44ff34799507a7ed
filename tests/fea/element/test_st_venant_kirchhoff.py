"""Internal forces and tangents of cells."""

import numpy as np
import pytest

from tests.fea.boxes import box
from wrenchbook.fea.element.st_venant_kirchhoff import Stiffness
from wrenchbook.fea.mesh.mapping import cell_gradients
from wrenchbook.fea.tensors import rotation

RNG = np.random.default_rng(5)


def cells(kind="hex20", integration="reduced", divisions=(2, 2, 1)):
    """Distorted cells, each of a material of its own."""
    mesh = box(kind, divisions, warp=lambda p: p + 0.02 * RNG.standard_normal(p.shape))
    block = mesh.blocks[0]
    count = len(block)
    lame = RNG.uniform(1, 2, count), RNG.uniform(1, 2, count)
    return Stiffness(cell_gradients(mesh.points, block, integration), *lame), (
        mesh.points[block.nodes].transpose(0, 2, 1)
    )


def times(stiffness, matrices, field):
    flat = matrices @ field.reshape(len(stiffness), -1, 1)
    return flat.reshape(field.shape)


def tangent(stiffness, displacement, step=None):
    return stiffness.tangent(displacement, step, np.arange(len(stiffness)))


@pytest.mark.parametrize("kind", ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15"])
def test_the_tangent_is_the_derivative_of_the_forces_and_they_of_the_energy(kind):
    stiffness, places = cells(kind)
    u, v = (0.1 * RNG.standard_normal(places.shape) for _ in range(2))
    step = 1e-6
    ahead, behind = (stiffness.forces(u + s * step * v) for s in (1, -1))
    forces = stiffness.forces(u)[0]
    slope = (ahead[0] - behind[0]) / (2 * step)
    np.testing.assert_allclose(
        times(stiffness, tangent(stiffness, u), v), slope, atol=2e-8 * np.abs(slope).max()
    )
    power = (ahead[1] - behind[1]) / (2 * step)
    assert np.vdot(forces, v) == pytest.approx(power, rel=1e-7)


def test_the_tangent_is_symmetric():
    stiffness, places = cells()
    K = tangent(stiffness, 0.1 * RNG.standard_normal(places.shape))
    np.testing.assert_allclose(K, K.swapaxes(1, 2), atol=1e-14 * np.abs(K).max())


def test_a_rigid_rotation_by_any_angle_gives_no_stress():
    stiffness, places = cells()
    turned = np.einsum("ij,cja->cia", rotation(np.array([0.5, -1.0, 0.8])), places)
    forces, energy, least = stiffness.forces(turned - places + 3.0)
    assert np.abs(forces).max() < 1e-14
    assert energy < 1e-28
    assert least == pytest.approx(1.0, rel=1e-12)


def test_small_displacements_keep_their_digits_down_to_1e_minus_20():
    stiffness, places = cells()
    u = RNG.standard_normal(places.shape)
    small = 1e-20 * u
    linear = stiffness.small_strain_forces(u[None])[0]
    np.testing.assert_allclose(
        stiffness.forces(small)[0] * 1e20, linear, atol=1e-13 * np.abs(linear).max()
    )


def test_the_undeformed_tangent_is_the_small_strain_stiffness():
    stiffness, places = cells()
    u = RNG.standard_normal(places.shape)
    linear = stiffness.small_strain_forces(u[None])[0]
    for K in (tangent(stiffness, None), tangent(stiffness, np.zeros_like(u))):
        np.testing.assert_allclose(
            times(stiffness, K, u), linear, atol=1e-13 * np.abs(linear).max()
        )
    products = stiffness.strain_energy_products(np.stack([u, 2 * u]))
    work = np.vdot(u, linear)
    np.testing.assert_allclose(products, work * np.array([[1, 2], [2, 4]]), rtol=1e-13)


def test_extrapolated_stress_agrees_with_the_stress_as_the_step_vanishes():
    stiffness, places = cells()
    u, change = (0.1 * RNG.standard_normal(places.shape) for _ in range(2))
    proper = tangent(stiffness, u)
    gaps = []
    for size in (1e-2, 1e-3):
        K = tangent(stiffness, u, np.stack([u, size * change]))
        gaps.append(np.abs(K - proper).max())
    assert gaps[1] == pytest.approx(1e-2 * gaps[0], rel=1e-6)  # quadratic in the step
