"""Cells of each law: energy, forces and tangent, and what they become."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from wrenchbook.fea.element.neo_hookean import NeoHookeanStiffness
from wrenchbook.fea.element.pressure_projection import volume_modes
from wrenchbook.fea.element.st_venant_kirchhoff import (
    IsotropicStiffness,
    OrthotropicStiffness,
    turned_elasticity,
)
from wrenchbook.fea.mesh.mapping import cell_gradients
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL
from wrenchbook.fea.spec.material import Orthotropic
from wrenchbook.fea.tensors import rotation

RNG = np.random.default_rng()
STRAIGHT = np.eye(3)
CARBON = Orthotropic("all", (135.0, 10.0, 9.0), (0.3, 0.32, 0.45), (5.0, 4.8, 3.2), STRAIGHT)
TURN = rotation(np.array([0.3, -0.8, 0.5]))


@pytest.fixture(autouse=True)
def numbers_of_each_test():
    """Draw the same numbers in each test, whichever run before it."""
    RNG.bit_generator.state = np.random.default_rng(17).bit_generator.state


def places(kind="hex20"):
    mesh = box(kind, (2, 2, 1), warp=lambda p: p + 0.02 * RNG.uniform(-1, 1, p.shape))
    return mesh, mesh.points[mesh.blocks[0].nodes].transpose(0, 2, 1)


def cells(law, kind="hex20"):
    """Distorted cells, each of a material of its own, and their nodes, (c, 3, a)."""
    mesh, nodes = places(kind)
    block = mesh.blocks[0]
    gradients = cell_gradients(mesh.points, block, "reduced" if law == "isotropic" else "full")
    if law == "orthotropic":
        moduli = turned_elasticity(CARBON.elasticity, TURN)
        return OrthotropicStiffness(gradients, np.array([[moduli]] * len(block))), nodes
    if law == "isotropic":
        return IsotropicStiffness(gradients, *RNG.uniform(1, 2, (2, len(block)))), nodes
    modes = None
    if law.endswith("projected"):
        modes = volume_modes(mesh.points, block, gradients.weights, "full")
    if law == "isotropic, projected":
        lame = RNG.uniform(100, 200, len(block)), RNG.uniform(1, 2, len(block))
        return IsotropicStiffness(gradients, *lame, modes), nodes
    lame = RNG.uniform(3, 9, len(block)), RNG.uniform(1, 2, len(block))
    return NeoHookeanStiffness(gradients, *lame, modes), nodes


def tangent(stiffness, displacement, step=None):
    return stiffness.tangent(displacement, step, np.arange(len(stiffness)))


def times(matrices, field):
    return (matrices @ field.reshape(len(field), -1, 1)).reshape(field.shape)


LAWS = ["orthotropic", "neo-hookean", "projected"]


@pytest.mark.parametrize(
    ("law", "kind", "size", "near"),
    [("isotropic", kind, 0.1, 2e-8) for kind in NODES_PER_CELL]
    + [("isotropic, projected", kind, 0.05, 1e-7) for kind in ("hex20", "hex27")]
    + [(law, "hex20", 0.04, 3e-7) for law in LAWS],
)
def test_the_tangent_is_the_derivative_of_the_forces_and_they_of_the_energy(law, kind, size, near):
    stiffness, nodes = cells(law, kind)
    u, v = (size * RNG.uniform(-1, 1, nodes.shape) for _ in range(2))
    step = 1e-6
    ahead, behind = (stiffness.forces(u + s * step * v) for s in (1, -1))
    slope = (ahead[0] - behind[0]) / (2 * step)
    K = tangent(stiffness, u)
    np.testing.assert_allclose(times(K, v), slope, atol=near * np.abs(slope).max())
    np.testing.assert_allclose(K, K.swapaxes(1, 2), atol=1e-14 * np.abs(K).max())
    power = (ahead[1] - behind[1]) / (2 * step)
    accuracy = 1e-7 if law == "isotropic" else 1e-6
    assert np.vdot(stiffness.forces(u)[0], v) == pytest.approx(power, rel=accuracy)


def test_small_displacements_keep_their_digits_down_to_1e_minus_20():
    stiffness, nodes = cells("isotropic")
    u = RNG.uniform(-1, 1, nodes.shape)
    linear = stiffness.small_strain_forces(u[None])[0]
    small = stiffness.forces(1e-20 * u)[0] * 1e20
    np.testing.assert_allclose(small, linear, atol=1e-13 * np.abs(linear).max())


def test_the_undeformed_tangent_is_the_small_strain_stiffness():
    stiffness, nodes = cells("isotropic")
    u = RNG.uniform(-1, 1, nodes.shape)
    linear = stiffness.small_strain_forces(u[None])[0]
    for K in (tangent(stiffness, None), tangent(stiffness, np.zeros_like(u))):
        np.testing.assert_allclose(times(K, u), linear, atol=1e-13 * np.abs(linear).max())
    products = stiffness.strain_energy_products(np.stack([u, 2 * u]))
    work = np.vdot(u, linear)
    np.testing.assert_allclose(products, work * np.array([[1, 2], [2, 4]]), rtol=1e-13)


def test_extrapolated_stress_agrees_with_the_stress_as_the_step_vanishes():
    stiffness, nodes = cells("isotropic")
    u, change = (0.1 * RNG.uniform(-1, 1, nodes.shape) for _ in range(2))
    proper = tangent(stiffness, u)
    gaps = [
        np.abs(tangent(stiffness, u, np.stack([u, size * change])) - proper).max()
        for size in (1e-2, 1e-3)
    ]
    assert gaps[1] == pytest.approx(1e-2 * gaps[0], rel=1e-6)  # quadratic in the step


@pytest.mark.parametrize("law", LAWS)
def test_stresses_change_as_their_slopes_say(law):
    stiffness, nodes = cells(law)
    u, v = (0.04 * RNG.uniform(-1, 1, nodes.shape) for _ in range(2))
    none = np.empty((0, *nodes.shape))
    ahead, behind = (stiffness.cauchy_stresses(u + s * 1e-6 * v, none)[0] for s in (1, -1))
    (slope,) = stiffness.cauchy_stresses(u, v[None])[1]
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, atol=3e-7 * np.abs(slope).max())


@pytest.mark.parametrize("law", ["isotropic", *LAWS])
def test_a_rigid_rotation_costs_nothing_and_turns_the_response(law):
    stiffness, nodes = cells(law)
    Q = rotation(np.array([0.5, -1.0, 0.8]))
    forces, energy, least = stiffness.forces(np.einsum("ij,cja->cia", Q, nodes) - nodes + 3.0)
    assert np.abs(forces).max() < (1e-14 if law == "isotropic" else 1e-12)
    assert energy < 1e-25
    assert least == pytest.approx(1.0)
    u = 0.03 * RNG.uniform(-1, 1, nodes.shape)
    turned = np.einsum("ij,cja->cia", Q, nodes + u) - nodes
    own = np.einsum("ij,cja->cia", Q, stiffness.forces(u)[0])
    np.testing.assert_allclose(stiffness.forces(turned)[0], own, atol=1e-12 * np.abs(own).max())


@pytest.mark.parametrize("law", LAWS)
def test_small_loads_keep_their_digits(law):
    """At a strain of 1e-9 forces and energy are the linear ones to 1e-8, not to roundoff / 1e-9."""
    stiffness, nodes = cells(law)
    u = 1e-9 * RNG.uniform(-1, 1, nodes.shape)
    linear = times(tangent(stiffness, None), u)
    forces, energy, _ = stiffness.forces(u)
    np.testing.assert_allclose(forces, linear, atol=1e-7 * np.abs(linear).max())
    assert energy == pytest.approx(0.5 * np.vdot(u, linear), rel=1e-7)
    small = stiffness.small_strain_forces(u[None])[0]
    np.testing.assert_allclose(small, linear, atol=1e-10 * np.abs(linear).max())


@pytest.mark.parametrize("law", LAWS)
def test_the_extrapolated_stress_begins_as_the_stress_of_the_state(law):
    stiffness, nodes = cells(law)
    u, v = (0.03 * RNG.uniform(-1, 1, nodes.shape) for _ in range(2))
    ends = []
    for size in (1e-6, -1e-6):
        state = stiffness.state(slice(None), u + size * v)
        proper = state.wS
        state.extrapolate(np.stack([u + size * v, size * v]))
        np.testing.assert_allclose(state.wS, proper, atol=1e-9 * np.abs(proper).max())
        ends.append(state.wS)
    assert np.abs(ends[0] - ends[1]).max() > 1e-7 * np.abs(ends[0]).max()


@pytest.mark.parametrize("law", ["neo-hookean", "projected"])
def test_the_extrapolated_pressure_is_linear_in_the_step(law):
    stiffness, nodes = cells(law)
    u, v = (0.03 * RNG.uniform(-1, 1, nodes.shape) for _ in range(2))

    def pressure(size):
        state = stiffness.state(slice(None), u + size * v)
        state.extrapolate(np.stack([u + size * v, size * v]))
        return state.pressure

    whole, half = (pressure(size) - pressure(0.0) for size in (1.0, 0.5))
    np.testing.assert_allclose(2 * half, whole, atol=1e-10 * np.abs(whole).max())


def test_equal_constants_in_all_directions_are_the_isotropic_material_in_any_axes():
    mesh, nodes = places()
    gradients = cell_gradients(mesh.points, mesh.blocks[0], "full")
    young, nu = 7.0, 0.3
    shear = young / (2 * (1 + nu))
    same = replace(
        CARBON, youngs_moduli=(young,) * 3, poisson_ratios=(nu,) * 3, shear_moduli=(shear,) * 3
    )
    ones = np.ones(len(nodes))
    ours = OrthotropicStiffness(
        gradients, np.array([[turned_elasticity(same.elasticity, TURN)]] * 4)
    )
    plain = IsotropicStiffness(gradients, ones * 2 * shear * nu / (1 - 2 * nu), ones * shear)
    u = 0.05 * RNG.uniform(-1, 1, nodes.shape)
    for one, other in zip(ours.forces(u), plain.forces(u), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    np.testing.assert_allclose(tangent(ours, u), tangent(plain, u), atol=1e-12)
    assert same.isotropic_ratio == pytest.approx(nu)


def test_a_neo_hookean_bar_follows_its_closed_form():
    """Pulled to a stretch a along and b across: Cauchy's stress along, and none across."""
    stiffness, nodes = cells("neo-hookean")
    mu, lam = stiffness.shear, stiffness.first_lame
    a, b = 1.4, 0.9
    stretch = np.diag([b, b, a]) - np.eye(3)
    stress = stiffness.cauchy_stresses(
        np.einsum("ij,cja->cia", stretch, nodes), np.empty((0, *nodes.shape))
    )[0]
    J, bulk = a * b * b, lam + 2 * mu / 3
    for axis, own in ((2, a), (0, b)):
        right = mu * J ** (-5 / 3) * (own**2 - (a * a + 2 * b * b) / 3) + bulk * (J - 1)
        np.testing.assert_allclose(stress[:, :, axis, axis], np.tile(right[:, None], 27), rtol=1e-9)


def test_a_cell_turned_inside_out_has_no_energy_that_is_a_number():
    stiffness, nodes = cells("neo-hookean")
    _, energy, least = stiffness.forces(np.einsum("ij,cja->cia", np.diag([0, 0, -2.5]), nodes))
    assert least < 0
    assert np.isnan(energy)
