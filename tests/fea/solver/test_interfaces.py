"""Several interfaces on one part: reciprocity, statics, tangents, energy, frames and CalculiX."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.components import component
from tests.fea.two_interfaces import column, with_second
from tests.validation import calculix
from wrenchbook.fea import equations
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.load_steps import LoadPath
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.schema import FREEDOMS
from wrenchbook.fea.tensors import rotation, skew

COUPLINGS = ["rigid", "distributed"]
PAIRS = [(item, other) for item in COUPLINGS for other in COUPLINGS]
TURN = rotation(np.array([0.3, -0.8, 1.1]))
WRENCH = 1e-3 * np.array([2, -1, 1.5, 3, -2, 1, -1, 2, -2.5, 1, 2, -3])
LENGTH, SIDE, YOUNG = 1.0, 0.05, 70e9


def rod(coupling="rigid", *, side=(SIDE, SIDE), poisson=0.0, nonlinear=False):
    """Return a rod along z that is fixed in its middle plane, with an interface at each end."""
    mesh = box("hex20", (2, 2, 16), (*side, LENGTH))
    part = component(
        mesh, section="z0", coupling=coupling, young=YOUNG, poisson=poisson, nonlinear=nonlinear
    )
    middle = np.flatnonzero(np.abs(mesh.points[:, 2] - LENGTH / 2) < 1e-9)
    return with_second(replace(part, fixed_nodes=middle), "z1", coupling=coupling)


def link(*, first="rigid", coupling="rigid", nonlinear=False):
    """Return a rod without supports whose first interface is held."""
    mesh = box("hex20", (2, 2, 10), (SIDE, SIDE, LENGTH))
    part = component(
        mesh, section="z0", coupling=first, young=YOUNG, locked=FREEDOMS, nonlinear=nonlinear
    )
    part = replace(part, fixed_nodes=np.empty(0, dtype=int))
    return with_second(part, "z1", coupling=coupling)


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_compliance_of_two_interfaces_is_symmetric_and_equal_to_its_energies(first, second):
    result = Solver(column(first, second, axes=TURN, point=[0.4, 0.5, 4.3])).linear
    assert result.compliance.shape == (12, 12)
    assert max(result.asymmetry, result.energy_gap) < 1e-9
    assert np.abs(result.compliance[:6, 6:]).max() > 1e-3 * np.abs(result.compliance).max()


@pytest.mark.parametrize("first", COUPLINGS)
def test_a_free_second_interface_changes_nothing_of_the_first(first):
    both = column(first, "distributed", axes=TURN)
    alone = Solver(replace(both, interfaces=both.interfaces[:1]))
    result = Solver(both).compliance[:6, :6]
    scale = np.sqrt(np.outer(*(2 * [np.diagonal(result)])))
    assert (np.abs(result - alone.compliance) <= 1e-14 * scale).all()
    large = Solver(replace(both, analysis=replace(both.analysis, nonlinear=True)))
    only = Solver(replace(alone.component, analysis=large.component.analysis))
    wrench = np.concatenate([WRENCH[:6], np.zeros(6)])
    np.testing.assert_allclose(
        large.solve(wrench).displacement[:6], only.solve(WRENCH[:6]).displacement, rtol=1e-11
    )


def test_loads_at_both_ends_stretch_a_rod_as_statics_says():
    """Each half carries what pulls beyond the supports in its middle plane."""
    solver = Solver(rod("distributed"))
    result = solver.solve({"left": [0, 0, -300, 0, 0, 0], "right": [0, 0, 500, 0, 0, 0]})
    half = LENGTH / 2 / (YOUNG * SIDE**2)
    assert result.displacement[2] == pytest.approx(-300 * half, rel=1e-9)
    assert result.displacement[8] == pytest.approx(500 * half, rel=1e-9)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_link_held_rigidly_is_the_same_link_clamped_there(nonlinear):
    wrench = np.array([900.0, -500.0, 2e4, 40.0, 60.0, 50.0])
    held = Solver(link(nonlinear=nonlinear)).solve({"right": wrench})
    clamped = component(
        link().mesh, section="z1", coupling="rigid", young=YOUNG, nonlinear=nonlinear
    )
    right = Solver(clamped).solve(wrench)
    assert not held.displacement[:6].any()
    np.testing.assert_allclose(held.displacement[6:], right.displacement, rtol=1e-10)
    scale = np.sqrt(np.outer(*(2 * [np.diagonal(right.compliance)])))
    np.testing.assert_allclose(held.compliance[6:, 6:] / scale, right.compliance / scale, atol=1e-9)
    assert not held.compliance[:6].any()


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_holding_the_other_end_of_a_link_gives_the_same_relative_motion(coupling):
    left = link(first=coupling, coupling="distributed")
    first, second = left.interfaces
    if coupling == "rigid":
        second = replace(second, coupling="rigid")
        left = replace(left, interfaces=(first, second))
    held = replace(first, locked=()), replace(second, locked=FREEDOMS)
    right = replace(left, interfaces=held)
    arm = np.eye(6)
    arm[:3, 3:] = skew(second.point - first.point)
    relative = arm @ Solver(left).compliance[6:, 6:] @ arm.T
    result = Solver(right).compliance[:6, :6]
    np.testing.assert_allclose(result, relative, atol=1e-11 * np.abs(relative).max())


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_link_held_in_the_mean_stands_still_there_and_its_tangent_is_that_of_its_answers(
    nonlinear,
):
    solver = Solver(link(first="distributed", nonlinear=nonlinear))
    wrench = np.array([900.0, -500.0, 2e4, 40.0, 60.0, 50.0])
    result = solver.solve({"right": wrench})
    section = solver.component.interfaces[0].section
    mean = section.weights @ result.nodes[section.node_ids] / section.area
    assert not result.displacement[:6].any()
    np.testing.assert_allclose(mean, 0.0, atol=1e-15)
    assert np.abs(result.nodes[section.node_ids]).max() > 1e-7
    step = np.array([10.0, 20, 30, 1, 2, 3])
    ahead, behind = (
        solver.solve({"right": wrench + s * step}, start=result.state).displacement
        for s in (0.1, -0.1)
    )
    slope = (ahead - behind) / 0.2
    np.testing.assert_allclose(
        result.compliance[:, 6:] @ step, slope, atol=1e-7 * np.abs(slope).max()
    )
    assert result.work == pytest.approx(result.strain_energy, rel=1e-3)


def test_the_nodes_that_anchor_a_link_held_in_the_mean_change_no_answer(monkeypatch):
    part = link(first="distributed", nonlinear=True)
    wrench = {"right": [900.0, -500.0, 2e4, 40.0, 60.0, 50.0]}
    result = Solver(part).solve(wrench)
    nodes = part.interfaces[0].section.node_ids[[0, 1, -2]]
    assert set(nodes) != set(equations._anchors(part))
    monkeypatch.setattr(equations, "_anchors", lambda _: nodes)
    other = Solver(part).solve(wrench)
    np.testing.assert_allclose(other.displacement, result.displacement, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(other.nodes, result.nodes, atol=1e-13)


def test_a_link_held_in_the_mean_swings_and_buckles_about_as_one_held_rigidly():
    soft, stiff = link(first="distributed"), link()
    dense = (replace(soft.materials[0], density=2700.0),)
    swings = [Solver(replace(p, materials=dense)).vibration(Riding.of()) for p in (soft, stiff)]
    assert swings[0].frequency == pytest.approx(swings[1].frequency, rel=2e-2)
    loads = [Solver(p).buckling({"right": [0, 0, -1, 0, 0, 0]})[0] for p in (soft, stiff)]
    assert loads[0] == pytest.approx(loads[1], rel=2e-2)


def test_loads_on_a_held_interface_do_nothing():
    solver = Solver(link())
    wrench = np.array([9.0] * 6 + [1.0, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(
        solver.solve(wrench).displacement, solver.solve({"right": wrench[6:]}).displacement
    )


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_work_at_both_interfaces_is_the_strain_energy(first, second):
    result = Solver(column(first, second, nonlinear=True, axes=TURN)).solve(WRENCH)
    assert result.work == pytest.approx(result.strain_energy, rel=1e-3)


def test_supports_carry_the_wrenches_of_both_interfaces_in_the_deformed_state():
    solver = Solver(column("rigid", "distributed", nonlinear=True))
    result = solver.solve(WRENCH)
    part = solver.component
    forces = solver.body.forces(result.nodes)[0]
    places = part.mesh.points - part.interfaces[0].point
    moment, pull = np.zeros(3), np.zeros(3)
    for i, one in enumerate(part.interfaces):
        own, moved = WRENCH[6 * i : 6 * i + 6], result.displacement[6 * i : 6 * i + 6]
        pull += own[:3]
        moment += own[3:] + np.cross(one.point - part.interfaces[0].point + moved[:3], own[:3])
    fixed = part.fixed_nodes
    np.testing.assert_allclose(forces[fixed].sum(axis=0), -pull, atol=1e-12)
    np.testing.assert_allclose(np.cross(places, forces)[fixed].sum(axis=0), -moment, atol=1e-12)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_the_second_interface_answers_in_its_own_axes(nonlinear):
    plain = Solver(column("rigid", "distributed", nonlinear=nonlinear))
    turned = Solver(column("rigid", "distributed", nonlinear=nonlinear, axes=TURN))
    out = np.kron(np.diag([1, 1, 0, 0]), np.eye(3)) + np.kron(np.diag([0, 0, 1, 1]), TURN)
    one, other = plain.solve(WRENCH), turned.solve(out @ WRENCH)
    np.testing.assert_allclose(other.displacement, out @ one.displacement, rtol=1e-9)
    np.testing.assert_allclose(other.compliance, out @ one.compliance @ out.T, atol=1e-7)
    np.testing.assert_allclose(other.nodes, one.nodes, atol=1e-12)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_calculix_finds_the_same_on_the_same_mesh(nonlinear):
    require_ccx()
    solver = Solver(rod(side=(0.02, 0.02), poisson=0.33, nonlinear=nonlinear))
    wrench = 3 * np.array([300, -200, 900, 30, -40, 25, -250, 400, -700, 50, 20, -35.0])
    result = solver.solve(wrench)
    turns = result.displacement.reshape(2, 6)[:, 3:] if nonlinear else None
    reply = calculix.solve_rigid(solver.component, wrench, turns)
    limit = calculix.NONLINEAR if nonlinear else calculix.LINEAR
    assert calculix.worst_gap(result.displacement, reply.displacement) < limit


@pytest.mark.parametrize("nonlinear", [False, True])
def test_calculix_finds_the_same_of_a_link_that_is_held(nonlinear):
    require_ccx()
    solver = Solver(link(nonlinear=nonlinear))
    wrench = np.array([0.0] * 6 + [900.0, -500.0, 2e4, 40.0, 60.0, 50.0])
    result = solver.solve(wrench)
    turns = result.displacement.reshape(2, 6)[:, 3:] if nonlinear else None
    reply = calculix.solve_rigid(solver.component, wrench, turns)
    limit = calculix.NONLINEAR if nonlinear else calculix.LINEAR
    assert calculix.worst_gap(result.displacement, reply.displacement) < limit


@pytest.mark.parametrize(("first", "second"), PAIRS[1:2])
def test_the_length_of_the_path_leads_two_interfaces_to_the_same_answer(first, second, monkeypatch):
    solver = Solver(column(first, second, nonlinear=True, axes=TURN))
    expected = solver.solve(WRENCH)
    monkeypatch.setattr(LoadPath, "_explained", lambda path, result, target: False)
    result = solver.solve(WRENCH)
    assert len({step.load_factor for step in result.history}) > 5
    np.testing.assert_allclose(result.displacement, expected.displacement, rtol=1e-6, atol=1e-9)
    assert result.work == pytest.approx(result.strain_energy, rel=1e-4)


def test_a_column_between_two_pushing_interfaces_buckles_by_euler_s_load():
    """Free at both ends of a half height H / 2 from its clamped middle: pi^2 EI / (4 (H/2)^2)."""
    part = rod(side=(0.01, 0.012))
    stiffness = YOUNG * 0.012 * 0.01**3 / 12
    euler = np.pi**2 * stiffness / (4 * 0.5**2)
    wrench = np.array([0, 0, euler, 0, 0, 0, 0, 0, -euler, 0, 0, 0])
    push, pull = Solver(part).buckling(wrench)
    assert push == pytest.approx(1.0, rel=2e-2)
    assert pull > 10


def test_a_rod_squeezed_from_both_ends_gives_way_at_the_closed_form_of_its_material():
    """F = E A l (1 - l^2)/2 has its maximum, E A / sqrt(27), at l = 1/sqrt(3)."""
    mesh = box("hex20", (2, 2, 4), (1.0, 1.0, 1.0))
    guide = ("ux", "uy", "rx", "ry", "rz")
    part = component(mesh, section="z0", young=1e9, poisson=0.0, nonlinear=True, locked=guide)
    middle = np.flatnonzero(np.abs(mesh.points[:, 2] - 0.5) < 1e-9)
    solver = Solver(with_second(replace(part, fixed_nodes=middle), "z1", locked=guide))
    load = 1.2e9 / np.sqrt(27)
    with pytest.raises(SolveFailed) as caught:
        solver.solve({"left": [0, 0, load, 0, 0, 0], "right": [0, 0, -load, 0, 0, 0]})
    assert caught.value.kind == "snap_through"
    assert caught.value.load_factor == pytest.approx(1 / 1.2, rel=2e-3)


def test_two_free_interfaces_swing_with_the_part_and_a_mass_on_one_is_refused():
    part = column("rigid", "distributed")
    part = replace(part, materials=(replace(part.materials[0], density=1.0),))
    alone = column("distributed")
    alone = Solver(replace(alone, materials=part.materials, interfaces=alone.interfaces[:1]))
    result = Solver(part).vibration(Riding.of())
    assert result.interface.shape == (12,)
    assert np.linalg.norm(result.interface) == pytest.approx(1.0)
    assert 0.2 < result.frequency / alone.vibration(Riding.of()).frequency < 2
    with pytest.raises(ValueError, match="mass cannot be put on one of several interfaces"):
        Solver(part).vibration(Riding.of(1.0))


def test_a_nearby_solve_starts_from_the_state_of_both_interfaces():
    solver = Solver(column("rigid", "distributed", nonlinear=True))
    start = solver.solve(WRENCH).state
    warm, cold = solver.solve(1.01 * WRENCH, start=start), solver.solve(1.01 * WRENCH)
    assert len(warm.history) <= len(cold.history)
    np.testing.assert_allclose(warm.displacement, cold.displacement, rtol=1e-9)


def test_either_interface_is_refused_beyond_20_degrees():
    solver = Solver(column("rigid", "rigid", nonlinear=True))
    for first in (0, 6):
        wrench = np.zeros(12)
        wrench[first + 3] = 0.05
        with pytest.raises(SolveFailed) as caught:
            solver.solve(wrench)
        assert caught.value.kind == "rotation_too_large"


def test_an_unknown_interface_is_named_with_those_there_are():
    solver = Solver(link())
    with pytest.raises(ValueError, match=r'"rigth" is no input here; give .* did you mean "right"'):
        solver.solve({"rigth": np.zeros(6)})
    with pytest.raises(ValueError, match=r"12 finite numbers.* of left, then .* of right; not \[0"):
        solver.solve(np.zeros(6))
    with pytest.raises(ValueError, match="12 finite numbers"):
        solver.solve(np.append(np.zeros(11), np.nan))
    for loads in ([1.0] * 5, [1.0] * 7, "push"):
        with pytest.raises(ValueError, match='"left" must be six finite numbers'):
            solver.solve({"left": loads, "right": [1.0] * (12 - len(loads))})
    with pytest.raises(ValueError, match=r"12 finite numbers.*not .*'push'"):
        solver.solve({"left": ["push", 0, 0, 0, 0, 0]})


@pytest.mark.parametrize("loads", [np.full(12, 1j), [np.complex64(1j)] * 12])
def test_complex_loads_are_refused(loads):
    with pytest.raises(ValueError, match="12 finite numbers"):
        Solver(link()).solve(loads)
