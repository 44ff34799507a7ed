"""Nearly incompressible materials: projected volumetric strain, and cells that would lock."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea import components
from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.patch import on_the_surface, solve_with_boundary
from tests.validation.rates import harmonic_gradient
from wrenchbook.fea.element.pressure_projection import (
    LARGEST_RATIO,
    require_no_locking,
    volume_modes,
)
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mapping import cell_gradients
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material

RNG = np.random.default_rng(11)
RUBBER = 3e6


def warped(points):
    """Move the inner points of the unit cube only."""
    bubble = np.prod(np.sin(np.pi * points), axis=1)[:, None]
    return points + 0.08 * bubble * np.cos(3 * points + [0.2, 0.5, 0.9])


def body_of(mesh, poisson, held):
    return components.body_of(mesh, ~held, RUBBER, poisson, "full")


def displacement_error(kind, divisions, poisson, warp=None):
    mesh = box(kind, divisions, warp=warp)
    exact = harmonic_gradient(mesh.points)
    result = solve_with_boundary(body_of(mesh, poisson, on_the_surface(mesh)), exact)
    return np.abs(result - exact).max() / np.abs(exact).max()


@pytest.mark.parametrize("poisson", [0.49, 0.4999])
@pytest.mark.parametrize("kind", ["hex20", "hex27"])
def test_a_distorted_patch_of_rubber_reproduces_every_constant_strain(kind, poisson):
    if poisson > LARGEST_RATIO[kind]:
        return
    mesh = box(kind, (3, 3, 3), warp=warped, corners_only=True)
    body = body_of(mesh, poisson, on_the_surface(mesh))
    affine = mesh.points @ RNG.standard_normal((3, 3)) + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(solve_with_boundary(body, affine), affine, atol=1e-10)


def test_a_block_of_4x4x2_cells_is_right_to_a_tenth_of_a_percent_at_every_ratio():
    for poisson in (0.3, 0.49, 0.4999, 0.499999):
        assert displacement_error("hex27", (4, 4, 2), poisson) < 1e-3
    rough = displacement_error("hex27", (4, 4, 2), 0.4999, warped)
    assert rough < 2e-3


def test_the_displacement_converges_at_third_order_next_to_incompressible():
    errors = [displacement_error("hex27", (n, n, n), 0.4999, warped) for n in (2, 4)]
    assert np.log2(errors[0] / errors[1]) > 2.6


def bonded(kind, divisions, poisson, lengths=(0.1, 0.1, 0.05), **options):
    mesh = box(kind, divisions, lengths)
    return component(mesh, young=RUBBER, poisson=poisson, **options)


@pytest.mark.parametrize("lengths", [(0.1, 0.1, 0.05), (0.1, 0.1, 0.01)])
def test_a_bonded_rubber_block_does_not_lock(lengths):
    """Bonded corners are singular: the gap is that of the mesh, and the same at every ratio."""
    for poisson in (0.3, 0.49, 0.4999):
        coarse, fine = (
            np.diag(Solver(bonded("hex27", n, poisson, lengths)).compliance)
            for n in ((4, 4, 2), (8, 8, 4))
        )
        assert np.abs(coarse / fine - 1).max() < 0.03


def test_a_flat_rubber_strip_is_as_stiff_as_the_closed_form_of_a_layer():
    """A strip between plates: what the pressure leaves out is of the order height over width."""
    young, poisson, width, height = RUBBER, 0.4999, 0.4, 0.02
    mesh = box("hex27", (16, 1, 3), (width, 0.02, height))
    sides = np.union1d(mesh.facet_groups["y0"].node_ids, mesh.facet_groups["y1"].node_ids)
    body = body_of(mesh, poisson, np.zeros(len(mesh.points), dtype=bool))
    part = component(mesh, young=young, poisson=poisson, locked=("uy", "rx", "ry", "rz"))
    # Plane strain: the sides are held across, which the supports of a component cannot say.
    unknown = np.ones((len(mesh.points), 3), dtype=bool)
    unknown[part.fixed_nodes] = unknown[part.interfaces[0].section.node_ids] = False
    unknown[sides, 1] = False
    assert body.size == len(mesh.points)
    stiffness = dense(body)
    moved = np.zeros((len(mesh.points), 3))
    moved[part.interfaces[0].section.node_ids, 2] = 1.0
    free = np.flatnonzero(unknown)
    moved.ravel()[free] = -np.linalg.solve(
        stiffness[np.ix_(free, free)], (stiffness @ moved.ravel())[free]
    )
    result = moved.ravel() @ stiffness @ moved.ravel()
    assert result == pytest.approx(layer_stiffness(young, poisson, width, height) * 0.02, rel=0.01)


def layer_stiffness(young, poisson, width, height):
    """Pressure p'' = (12 G / (h^2 K)) p - 12 G / h^3 per unit travel, p = 0 at the edges (Gent)."""
    shear, bulk = young / (2 * (1 + poisson)), young / (3 * (1 - 2 * poisson))
    rate = np.sqrt(12 * shear / (bulk * height**2))
    half = rate * width / 2
    return bulk / height * width * (1 - np.tanh(half) / half) + 4 * shear * width / height


def dense(body):
    matrix = np.zeros((3 * body.size,) * 2)
    for cells, matrices in zip(body.cells, body.tangent(None).matrices, strict=True):
        for nodes, own in zip(cells, matrices, strict=True):
            unknowns = (3 * nodes[None, :] + np.arange(3)[:, None]).ravel()
            matrix[np.ix_(unknowns, unknowns)] += own
    return matrix


@pytest.mark.parametrize("kind", [kind for kind, limit in LARGEST_RATIO.items() if limit < 0.5])
def test_cells_that_would_lock_are_refused_by_name(kind):
    with pytest.raises(SolveFailed, match=r"0.4999; such cells lock") as caught:
        Solver(bonded(kind, (2, 2, 2), 0.4999))
    assert caught.value.kind == "locking_material"
    assert "hex27" in caught.value.remedy
    Solver(bonded(kind, (2, 2, 2), LARGEST_RATIO[kind])).solve([1, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("kind", ["tet4", "hex20"])
def test_a_ratio_that_rounding_puts_beyond_the_limit_is_taken(kind):
    limit = LARGEST_RATIO[kind]
    block = box(kind, (1, 1, 1)).blocks[0]
    require_no_locking(block, np.full(len(block), np.nextafter(limit, 1)))
    with pytest.raises(SolveFailed, match="lock"):
        require_no_locking(block, np.full(len(block), limit + 1e-6))


def test_only_the_cells_of_the_soft_material_are_projected():
    mesh = box("hex27", (2, 2, 2))
    part = replace(
        component(mesh),
        materials=(Material("all", 210e9, 0.3), Material("all", RUBBER, 0.4999)),
        material_of_cells=(np.array([0, 1] * 4),),
    )
    body = Solver(part)._system.body
    assert [(len(part), part.volume_modes is None) for part in body.parts] == [
        (4, True),
        (4, False),
    ]
    assert sorted(map(tuple, np.concatenate(body.cells))) == sorted(
        map(tuple, mesh.blocks[0].nodes)
    )


def test_the_modes_reproduce_every_linear_function_of_the_place():
    mesh = box("hex27", (2, 2, 1), warp=lambda p: p + 0.02 * RNG.standard_normal(p.shape))
    weights = cell_gradients(mesh.points, mesh.blocks[0], "full").weights
    modes = volume_modes(mesh.points, mesh.blocks[0], weights, "full")
    points = reference_element("hex27", "full").values @ mesh.points[mesh.blocks[0].nodes]
    linear = points @ [1.0, -2.0, 3.0] + 5.0
    projected = (modes @ (modes.swapaxes(1, 2) @ linear[..., None]))[..., 0] / weights
    np.testing.assert_allclose(projected, linear, rtol=1e-12)


def test_a_rubber_block_sheared_far_converges_and_keeps_its_energy():
    part = bonded("hex27", (4, 4, 2), 0.4999, nonlinear=True)
    result = Solver(part).solve([150.0, 0, -500.0, 0, 0, 0])
    assert result.displacement[0] > 0.5e-3
    assert result.work == pytest.approx(result.strain_energy, rel=1e-4)
    small = Solver(part).compliance @ result.wrench
    assert np.abs(result.displacement[[0, 2]] / small[[0, 2]] - 1).max() < 0.1


def test_a_mesh_of_several_kinds_names_the_one_that_locks():
    brick, tet = box("hex27", (1, 1, 1)), box("tet10", (1, 1, 1))
    points = np.concatenate([brick.points, tet.points + np.array([0, 0, 1.0])])
    blocks = (
        brick.blocks[0],
        CellBlock("tet10", tet.blocks[0].nodes + len(brick.points)),
    )
    mesh = Mesh(points, blocks, facet_groups=brick.facet_groups)
    with pytest.raises(SolveFailed, match="6 tet10 cells"):
        Solver(component(mesh, poisson=0.49))
