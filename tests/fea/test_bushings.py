"""Groups on elastic springs to the ground."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.supports import PLANES, TABLE, largest, part
from tests.validation import calculix, second_opinion
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.check.mechanisms import motion_problems
from wrenchbook.fea.component import build
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.bodies import bodies_of, coincident_nodes
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.tensors import rotation, rotation_vector, skew, spin_per_vector

COUPLINGS = ["rigid", "distributed"]
TURN = rotation(np.array([0.4, -0.7, 0.3]))
POINT = np.array([0.05, 0.02, -0.3])
SPRING = [3e6, 2e6, 5e6, 2e4, 3e4, 1e4]
RNG = np.random.default_rng(3)
ROOT = RNG.standard_normal((6, 6)) * np.sqrt(SPRING)
FULL = (ROOT.T @ ROOT + np.diag(SPRING)).tolist()
WRENCH = np.array([300.0, -200.0, -900.0, 90.0, 150.0, 60.0])


def mesh():
    return box("hex20", (2, 2, 6), (0.1, 0.06, 1.0))


def bushing(stiffness=SPRING, **changes):
    return {"group": "z0", "coupling": "rigid", "stiffness": stiffness} | changes


def on_bushings(folder, *bushings, supports=(), **options):
    tables = {"bushing": list(bushings), **dict(supports)}
    return part(mesh(), folder, tables, **options)


def lever(at, point):
    """Return what a wrench at one point is at another, (6, 6)."""
    whole = np.eye(6)
    whole[3:, :3] = skew(point - at)
    return whole


@pytest.mark.parametrize("interface", COUPLINGS)
def test_a_part_on_one_distributed_bushing_moves_on_it_as_a_rigid_body(tmp_path, interface):
    """Its forces are those of the wrench, so the spring changes no deformation."""
    each = [
        Solver(
            on_bushings(
                tmp_path,
                bushing((factor * np.array(FULL)).tolist(), coupling="distributed"),
                coupling=interface,
            )
        )
        for factor in (1.0, 2.0)
    ]
    at_bushing = lever(
        each[0].component.bushings[0][0].point, each[0].component.interfaces[0].point
    )
    expected = at_bushing.T @ np.linalg.solve(FULL, at_bushing) / 2
    assert largest(each[0].compliance - each[1].compliance - expected, expected) < 1e-9
    assert each[0].linear.energy_gap < 1e-9


@pytest.mark.parametrize("interface", COUPLINGS)
def test_the_compliance_of_a_bar_on_a_bushing_is_the_sum_of_both(tmp_path, interface):
    askew = bushing(FULL, point=POINT.tolist(), axes=TURN.tolist())
    soft = Solver(on_bushings(tmp_path, askew, coupling=interface))
    clamped = Solver(part(mesh(), tmp_path, {"fixed": ["z0"]}, coupling=interface))
    at_bushing = np.kron(np.eye(2), TURN) @ lever(POINT, soft.component.interfaces[0].point)
    expected = clamped.compliance + at_bushing.T @ np.linalg.solve(FULL, at_bushing)
    assert largest(soft.compliance - expected, expected) < 1e-9


def test_a_bar_between_means_stretches_as_theory_has_it(tmp_path):
    own = on_bushings(tmp_path, bushing(coupling="distributed"), coupling="distributed")
    expected = 1.0 / (3e9 * 0.1 * 0.06) + 1.0 / SPRING[2]
    assert Solver(own).compliance[2, 2] == pytest.approx(expected, rel=1e-10)


def test_a_bar_on_a_bushing_is_the_clamped_bar_moved_by_the_spring_at_any_rotation(tmp_path):
    soft = Solver(on_bushings(tmp_path, bushing(FULL), nonlinear=True))
    result = soft.solve(WRENCH * 2)
    motion = result.state.frames
    assert np.degrees(np.linalg.norm(motion[3:])) > 0.5
    turned, point = rotation(motion[3:]), soft.component.bushings[0][0].point
    force, moment = np.split(WRENCH * 2, 2)
    clamped = Solver(part(mesh(), tmp_path, {"fixed": ["z0"]}, nonlinear=True))
    bar = clamped.solve(np.concatenate([turned.T @ force, turned.T @ moment]))
    own = soft.component.interfaces[0].point
    arm = turned @ (own + bar.displacement[:3] - point)
    place = point + motion[:3] + arm
    np.testing.assert_allclose(result.displacement[:3], place - own, atol=1e-7)
    spin = rotation_vector(turned @ rotation(bar.displacement[3:]))
    np.testing.assert_allclose(result.displacement[3:], spin, atol=1e-7)
    carried = np.concatenate(
        [force, spin_per_vector(motion[3:]).T @ (moment + np.cross(arm, force))]
    )
    np.testing.assert_allclose(np.array(FULL) @ motion, carried, rtol=1e-6)


@pytest.mark.parametrize("sliding", [False, True])
@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("interface", COUPLINGS)
def test_the_tangent_is_the_derivative_of_what_is_out_of_balance(
    tmp_path, coupling, interface, sliding
):
    """In units in which Young's modulus is one, far from equilibrium."""
    stiffness = (np.array(FULL) / 3e9).tolist()
    askew = bushing(stiffness, coupling=coupling, point=POINT.tolist(), axes=TURN.tolist())
    whole = box("hex20", (2, 2, 4), (1.0, 1.2, 2.0))
    whole = replace(whole, node_groups={"middle": np.flatnonzero(whole.points[:, 2] == 1.0)})
    planes = [PLANES[1] | {"group": "middle", "axes": TURN.tolist()}]
    tables = {"bushing": [askew]} | ({"sliding": planes} if sliding else {})
    options = {"young": 1.0, "coupling": interface, "locked": ["uy", "rz"], "nonlinear": True}
    system = Solver(part(whole, tmp_path, tables, **options))._system
    tie, wrench = system.coupling, 1e-3 * RNG.standard_normal(6)

    def change(size):
        nodes = system.body.movable.released(RNG.standard_normal((system.body.size, 3)))
        return size * nodes, size * RNG.standard_normal(tie.n_border)

    state, (nodes, border) = tie.moved(tie.start(), *change(0.03)), change(1.0)
    step = 1e-6
    ahead, behind = (
        system.balance(tie.moved(state, s * nodes, s * border), wrench) for s in (step, -step)
    )
    solved = system.linearise(system.balance(state, wrench)).solve(
        ((ahead.nodal - behind.nodal) / (2 * step))[:, :, None],
        ((ahead.border - behind.border) / (2 * step))[:, None],
    )
    np.testing.assert_allclose(solved[0][:, :, 0], nodes, atol=1e-5)
    np.testing.assert_allclose(solved[1][:, 0], border, atol=1e-5)


@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("interface", COUPLINGS)
def test_answers_agree_with_their_tangent_and_their_energy(tmp_path, coupling, interface):
    one = Solver(
        on_bushings(tmp_path, bushing(FULL, coupling=coupling), coupling=interface, nonlinear=True)
    )
    wrench = 1.5 * WRENCH
    result = one.solve(wrench)
    for load, step in ((0, 1.0), (2, 1.0), (4, 0.1)):
        ahead, behind = (one.solve(wrench + s * np.eye(6)[load]) for s in (step, -step))
        slope = (ahead.displacement - behind.displacement) / (2 * step)
        assert largest(slope - result.compliance[:, load], slope) < 1e-6
        if load < 3:  # work of a force on its displacement: the energy's slope
            rate = (ahead.strain_energy - behind.strain_energy) / (2 * step)
            spatial = np.concatenate(
                [wrench[:3], spin_per_vector(result.displacement[3:]).T @ wrench[3:]]
            )
            assert rate == pytest.approx(spatial @ slope, rel=1e-6)
    assert result.work == pytest.approx(result.strain_energy, rel=1e-4)
    small = one.solve(1e-6 * WRENCH)
    np.testing.assert_allclose(small.displacement, 1e-6 * one.compliance @ WRENCH, rtol=1e-5)
    assert small.strain_energy == pytest.approx(small.work, rel=1e-5)
    started = one.solve(wrench, start=one.solve(0.9 * wrench).state)
    np.testing.assert_allclose(started.displacement, result.displacement, rtol=1e-9)


@pytest.mark.parametrize("stiffness", [SPRING, FULL, [0, 0, 4e6, 0, 0, 0]])
@pytest.mark.parametrize("nonlinear", [False, True])
def test_calculix_finds_the_same_on_bushings(tmp_path, stiffness, nonlinear):
    require_ccx()
    low = np.flatnonzero((mesh().points[:, 0] == 0) & (mesh().points[:, 2] == 0.5))
    supports = {"bushing": [bushing(stiffness, point=POINT.tolist(), axes=TURN.tolist())]}
    supports |= (
        {} if stiffness[0] else {"fixed": ["low"], "sliding": [PLANES[1] | {"group": "low"}]}
    )
    whole = replace(mesh(), node_groups={"low": low})
    one = part(whole, tmp_path, supports, nonlinear=nonlinear, axes=TURN.T.tolist())
    wrench = WRENCH
    result = Solver(one).solve(wrench).displacement
    reply = calculix.solve_rigid(one, wrench, result[3:] if nonlinear else None)
    assert second_opinion.difference(result, reply.displacement) < (1e-4 if nonlinear else 1e-5)


def test_calculix_has_no_distributed_bushing(tmp_path):
    with pytest.raises(BundleError, match=r"supports.bushing\[0\].coupling"):
        deck_of(on_bushings(tmp_path, bushing(coupling="distributed")))
    require_ccx()
    solver = Solver(on_bushings(tmp_path, bushing(coupling="distributed")))
    assert (
        "a deck has no such spring" in second_opinion.second_opinion(solver, WRENCH.tolist()).failed
    )


@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("density", [None, 1000.0])
def test_a_part_on_a_soft_bushing_swings_as_a_mass_on_its_spring(tmp_path, coupling, density):
    spring = [1e9, 1e9, 1e3, 1e9, 1e9, 1e9]
    one = on_bushings(
        tmp_path, bushing(spring, coupling=coupling), locked=["ux", "uy", "rx", "ry", "rz"]
    )
    one = replace(one, materials=tuple(replace(m, density=density) for m in one.materials))
    result = Solver(one).vibration(Riding.of(2.0))
    mass = 2.0 + (density or 0.0) * 0.1 * 0.06
    assert result.frequency == pytest.approx(np.sqrt(1e3 / mass) / (2 * np.pi), rel=1e-4)
    if density is None:
        compliance = Solver(one).compliance[2, 2]
        expected = np.sqrt(1 / (compliance * mass)) / (2 * np.pi)
        assert result.frequency == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_a_motion_that_no_spring_resists_is_named_and_refused(tmp_path, coupling):
    one = on_bushings(tmp_path, bushing([1e6, 1e6, 0, 1e3, 1e3, 1e3], coupling=coupling))
    (problem,) = motion_problems(one, bodies_of(one.mesh), coincident_nodes(one.mesh))
    assert problem.where == "supports"
    assert "it can slide along (0, 0, 1)" in problem.message
    with pytest.raises(SolveFailed) as caught:
        Solver(one).solve(WRENCH)
    assert caught.value.kind in ("mechanism", "ill_conditioned")


def test_springs_and_planes_together_hold_a_part(tmp_path):
    planes = {"sliding": PLANES[:2]}
    own = bushing([0, 0, 1e6, 0, 0, 0], coupling="distributed")
    one = on_bushings(tmp_path, own, supports=planes, coupling="distributed")
    assert motion_problems(one, bodies_of(one.mesh), coincident_nodes(one.mesh)) == []
    expected = 1.0 / (3e9 * 0.1 * 0.06) + 1e-6
    assert Solver(one).compliance[2, 2] == pytest.approx(expected, rel=1e-9)


def test_several_interfaces_move_on_one_spring(tmp_path):
    """Each moves as the spring does under the other's force: the part is nearly rigid."""
    loads = {"range": {"force": [1, 1, 1], "moment": [1, 1, 1]}}
    both = [
        {"name": n, "section": s, "coupling": "rigid"} | loads
        for n, s in (("a", "z0"), ("b", "z1"))
    ]
    table = {key: value for key, value in TABLE.items() if key != "range"}
    spring = {"stiffness": [5.0, 4.0, 3.0, 9.0, 9.0, 9.0], "point": [0.05, 0.03, 0.0]}
    table |= {
        "supports": {"bushing": [bushing() | {"group": "belt"} | spring]},
        "material": [{"region": "all", "youngs_modulus": 3e9, "poisson_ratio": 0.3}],
        "interface": both,
    }
    belt = np.flatnonzero(mesh().points[:, 2] == 0.5)
    one = build(bundle_of(table, tmp_path), replace(mesh(), node_groups={"belt": belt}))
    compliance = Solver(one).compliance
    assert compliance.shape == (12, 12)
    assert compliance[8, 2] == pytest.approx(1 / 3.0, rel=1e-4)
    assert compliance[6, 6] == pytest.approx(1 / 5.0 + 1.0 / 9.0, rel=1e-4)
    np.testing.assert_allclose(compliance, compliance.T)
