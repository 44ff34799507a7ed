"""Rigid and distributed couplings: definitions, tangents, balance."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.coupling import CoupledState
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import FREEDOMS
from wrenchbook.fea.tensors import rotation

RNG = np.random.default_rng(7)
COUPLINGS = ["rigid", "distributed"]
POINT = [0.3, 0.2, 2.3]


def wobble(points):
    return points + 0.03 * np.sin(7 * points[:, [1, 2, 0]])


def solver(coupling, locked=(), nonlinear=True, **changes):
    mesh = box("hex20", (2, 2, 3), (1.0, 1.2, 2.0), warp=wobble)
    return Solver(
        component(
            mesh,
            young=1.0,
            coupling=coupling,
            point=POINT,
            locked=locked,
            nonlinear=nonlinear,
            **changes,
        )
    )


@pytest.mark.parametrize("locked", [(), ("ux", "uy", "rx", "ry"), ("rz",), ("uz", "ry")])
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_the_bordered_tangent_is_the_derivative_of_what_is_out_of_balance(coupling, locked):
    system = solver(coupling, locked)._system
    tie, free = system.coupling, system.body.free
    interface = np.array([0.1, -0.2, 0.15, 0.3, -0.2, 0.25])
    interface[[FREEDOMS.index(name) for name in locked]] = 0.0
    multipliers = RNG.standard_normal(6) if coupling == "distributed" else np.zeros(6)
    u = 0.05 * RNG.standard_normal((system.body.size, 3)) * free[:, None]
    still = np.zeros_like(u), np.zeros(tie.n_border)
    state = tie.moved(CoupledState(u, interface, multipliers), *still)
    wrench = RNG.standard_normal(6)
    nodes, border = RNG.standard_normal(u.shape) * free[:, None], RNG.standard_normal(tie.n_border)

    step = 1e-6
    ahead, behind = (
        system.balance(tie.moved(state, s * nodes, s * border), wrench) for s in (step, -step)
    )
    tangent = system.linearise(system.balance(state, wrench))
    solved = tangent.solve(
        ((ahead.nodal - behind.nodal) / (2 * step))[:, :, None],
        ((ahead.border - behind.border) / (2 * step))[:, None],
    )
    np.testing.assert_allclose(solved[0][:, :, 0], nodes, atol=1e-6)
    np.testing.assert_allclose(solved[1][:, 0], border, atol=1e-6)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_supports_carry_the_wrench_in_the_deformed_state(coupling):
    built = solver(coupling)
    wrench = np.array([2e-3, -1e-3, 5e-3, 1.5e-3, 2e-3, -3e-3])
    result = built.solve(wrench)
    assert np.degrees(np.linalg.norm(result.displacement[3:])) > 0.5
    mesh = built.component.mesh
    forces = built._system.body.forces(result.nodes)[0]
    fixed = built.component.fixed_nodes
    places = mesh.points[fixed]
    acting_at = np.array(POINT) + result.displacement[:3]
    np.testing.assert_allclose(forces[fixed].sum(axis=0), -wrench[:3], atol=1e-12)
    moment = np.cross(places, forces[fixed]).sum(axis=0) + np.cross(acting_at, wrench[:3])
    np.testing.assert_allclose(moment, -wrench[3:], atol=1e-12)


def test_a_rigid_section_moves_as_one_piece_through_a_finite_rotation():
    built = solver("rigid")
    result = built.solve([2e-3, -1e-3, 5e-3, 1.5e-3, 2e-3, -3e-3])
    section = built.component.interfaces[0].section.node_ids
    arms = built.component.mesh.points[section] - POINT
    turned = arms @ rotation(result.displacement[3:]).T
    np.testing.assert_allclose(
        result.nodes[section], result.displacement[:3] + turned - arms, atol=1e-15
    )


def test_a_distributed_interface_is_the_best_fitting_rigid_motion_of_its_section():
    built = solver("distributed")
    result = built.solve([2e-3, -1e-3, 5e-3, 1.5e-3, 2e-3, -3e-3])
    section = built.component.interfaces[0].section
    before = built.component.mesh.points[section.node_ids]
    after = before + result.nodes[section.node_ids]
    weights = section.weights / section.weights.sum()
    spread = (before - weights @ before).T @ (weights[:, None] * (after - weights @ after))
    left, _, right = np.linalg.svd(spread)  # Kabsch
    fit = right.T @ np.diag([1, 1, np.linalg.det(right.T @ left.T)]) @ left.T
    np.testing.assert_allclose(rotation(result.displacement[3:]), fit, atol=1e-13)
    centre = weights @ before
    moved = centre + result.displacement[:3] + (fit - np.eye(3)) @ (centre - POINT)
    np.testing.assert_allclose(weights @ after, moved, atol=1e-14)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_locked_freedoms_stay_put_and_loads_on_them_do_nothing(coupling, nonlinear):
    built = solver(coupling, ("ux", "rx", "rz"), nonlinear)
    wrench = np.array([0, 1e-3, 3e-3, 0, 2e-3, 0])
    result = built.solve(wrench)
    assert (result.displacement[[0, 3, 5]] == 0).all()
    assert (result.compliance[[0, 3, 5]] == 0).all()
    assert (result.compliance[:, [0, 3, 5]] == 0).all()
    loaded = built.solve(wrench + np.array([9, 0, 0, 9, 0, 9]))
    np.testing.assert_array_equal(loaded.displacement, result.displacement)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_an_interface_that_is_locked_throughout_does_not_move(coupling, nonlinear):
    built = solver(coupling, FREEDOMS, nonlinear)
    result = built.solve([1, 2, 3, 4, 5, 6])
    assert not result.displacement.any()
    assert not result.compliance.any()
    assert result.strain_energy == 0
