"""Patch tests and rates of convergence: what makes an element an element."""

import numpy as np
import pytest

from tests.fea import components
from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.pyramids import mixed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.tensors import rotation

KINDS = ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15", "pyramid5", "pyramid13"]
RNG = np.random.default_rng(2)
YOUNG, POISSON = 3.0e9, 0.3


def warp_inside(amount):
    """Move the points inside the unit cube, and those on its faces within them."""
    shifts = RNG.uniform(-1, 1, (3, 4, 4, 4))

    def warp(points):
        moved = points.copy()
        waves = [np.sin(np.pi * np.outer(points[:, i], np.arange(1, 5))) for i in range(3)]
        bubble = np.prod(np.sin(np.pi * points), axis=1)
        for axis in range(3):
            wave = np.einsum("abc,na,nb,nc->n", shifts[axis], *waves)
            moved[:, axis] += amount * bubble * wave
        return moved

    return warp


def body_of(mesh, held, integration="reduced"):
    return components.body_of(mesh, ~held, YOUNG, POISSON, integration)


def on_the_surface(mesh):
    return ((mesh.points < 1e-9) | (mesh.points > 1 - 1e-9)).any(axis=1)


def solve_with_boundary(body, boundary):
    """Solve for the free nodes with the others displaced as `boundary` says, shape (n, 3)."""
    held = np.where(body.free[:, None], 0.0, boundary)
    forces = body.small_strain_forces(held[:, :, None])
    return held - body.tangent(None).solve(forces)[:, :, 0]


def patch(kind):
    """Return a distorted cube: of one kind, or of hexahedra, pyramids and tetrahedra."""
    if kind == "mixed":
        return mixed(warp=warp_inside(0.02))
    return box(kind, (3, 3, 3), warp=warp_inside(0.02), corners_only=True)


@pytest.mark.parametrize("integration", ["reduced", "full"])
@pytest.mark.parametrize("kind", [*KINDS, "mixed"])
def test_a_distorted_patch_reproduces_every_constant_strain(kind, integration):
    mesh = patch(kind)
    body = body_of(mesh, on_the_surface(mesh), integration)
    affine = mesh.points @ RNG.standard_normal((3, 3)) + [1.0, 2.0, 3.0]
    result = solve_with_boundary(body, affine)
    np.testing.assert_allclose(result, affine, atol=1e-12)


@pytest.mark.parametrize("kind", ["hex20", "hex27"])
def test_full_integration_passes_the_patch_test_with_curved_edges_as_well(kind):
    mesh = box(kind, (3, 3, 3), warp=warp_inside(0.005))
    body = body_of(mesh, on_the_surface(mesh), "full")
    affine = mesh.points @ RNG.standard_normal((3, 3))
    np.testing.assert_allclose(solve_with_boundary(body, affine), affine, atol=1e-12)


@pytest.mark.parametrize("kind", [*KINDS, "mixed"])
def test_a_distorted_patch_is_in_balance_under_every_large_homogeneous_deformation(kind):
    mesh = patch(kind)
    body = body_of(mesh, on_the_surface(mesh))
    gradient = rotation(np.array([0.4, -0.7, 0.3])) @ (np.eye(3) + 0.1 * RNG.random((3, 3)))
    forces, _, least = body.forces(mesh.points @ (gradient - np.eye(3)).T)
    assert np.abs(forces[body.free]).max() < 1e-12 * np.abs(forces).max()
    assert least == pytest.approx(np.linalg.det(gradient), rel=1e-12)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_distorted_bar_of_no_poisson_effect_stretches_exactly(kind, coupling):
    mesh = box(kind, (2, 2, 3), warp=warp_inside(0.02), corners_only=True)
    part = component(mesh, young=YOUNG, poisson=0.0, coupling=coupling)
    assert Solver(part).compliance[2, 2] == pytest.approx(1 / YOUNG, rel=1e-10)


def harmonic_gradient(points):
    """Return grad exp(sqrt(2) x) sin(y) sin(z): harmonic, so in balance without body forces."""
    x, y, z = points.T
    growth, a = np.exp(np.sqrt(2) * x), np.sqrt(2)
    return np.stack(
        [
            a * growth * np.sin(y) * np.sin(z),
            growth * np.cos(y) * np.sin(z),
            growth * np.sin(y) * np.cos(z),
        ],
        axis=1,
    )


def energy_of(kind, divisions, integration):
    mesh = box(kind, (divisions,) * 3)
    body = body_of(mesh, on_the_surface(mesh), integration)
    result = solve_with_boundary(body, harmonic_gradient(mesh.points))
    return float(body.strain_energy_products(result[:, :, None])[0, 0])


@pytest.mark.parametrize(
    ("kind", "order", "sizes"),
    [
        ("hex8", 1, (4, 8)),
        ("tet4", 1, (4, 8)),
        ("wedge6", 1, (4, 8)),
        ("hex20", 2, (2, 4)),
        ("hex27", 2, (2, 4)),
        ("tet10", 2, (2, 4)),
        ("wedge15", 2, (2, 4)),
        ("pyramid5", 1, (4, 8)),
        ("pyramid13", 2, (2, 4)),
    ],
)
def test_the_energy_converges_at_twice_the_order_of_the_element(kind, order, sizes):
    exact = energy_of("hex27", 6, "full")
    errors = [abs(energy_of(kind, n, "full") / exact - 1) for n in sizes]
    assert np.log2(errors[0] / errors[1]) > 2 * order - 0.35
