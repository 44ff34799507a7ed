"""Supports that hold single directions: sliding and symmetry planes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.supports import PLANES, largest, part, stress, turned
from tests.validation import calculix, second_opinion
from tests.validation.patch import distort
from wrenchbook.fea.check.mechanisms import motion_problems
from wrenchbook.fea.mesh.bodies import bodies_of, coincident_nodes
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.tensors import rotation

TURN = rotation(np.array([0.4, -0.7, 0.3]))
CORNER = {"coupling": "rigid", "point": [0, 0, 1], "locked": ["ux", "uy", "rx", "ry", "rz"]}


@pytest.mark.parametrize("kind", ["hex20", "hex27", "tet10", "wedge15"])
def test_a_block_on_three_sliding_planes_has_one_stress_throughout(tmp_path, kind):
    mesh = box(kind, (3, 3, 3), warp=distort(0.05), corners_only=True)
    options = {"coupling": "distributed", "nonlinear": True}
    result, _ = stress(part(mesh, tmp_path, {"sliding": PLANES}, **options), [0, 0, 1e8, 0, 0, 0])
    uniform = np.array([0, 0, result[0, 2], 0, 0, 0])
    assert largest(result - uniform, uniform) < 1e-9


def test_sliding_planes_may_lie_askew_to_the_interface_frame(tmp_path):
    mesh = box("hex20", (2, 2, 3), (1.0, 0.8, 2.0))
    planes = {"sliding": PLANES[1:], "fixed": ["x0"]}
    one = part(mesh, tmp_path, planes, section="x1", coupling="distributed", nonlinear=True)
    wrench = [3e7, 0, 2e7, 0, 4e6, 0]
    here, there = (Solver(each).solve(wrench) for each in (one, turned(one, TURN)))
    np.testing.assert_allclose(there.displacement, here.displacement, rtol=0, atol=1e-10)
    np.testing.assert_allclose(there.compliance, here.compliance, rtol=0, atol=1e-17)


def test_axes_of_a_sliding_support_turn_its_directions(tmp_path):
    mesh = box("hex20", (2, 2, 2), warp=lambda x: x @ TURN.T)
    planes = [item | {"axes": TURN.T.tolist()} for item in PLANES]
    one = part(mesh, tmp_path, {"sliding": planes}, coupling="distributed", axes=TURN.T.tolist())
    results, solution = stress(one, [0, 0, 1.0, 0, 0, 0])
    assert solution.displacement[2] == pytest.approx(1 / 3e9, rel=1e-10)
    np.testing.assert_allclose(results, np.tile(results[0], (len(results), 1)), atol=1e-10)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_quarter_on_symmetry_planes_is_the_whole(tmp_path, nonlinear):
    """The section is rigid and cut by both planes, so its freedoms across them are locked."""
    quarter = box("hex20", (2, 2, 4), (0.5, 0.4, 2.0))
    whole = box("hex20", (4, 4, 4), (1.0, 0.8, 2.0), warp=lambda x: x - [0.5, 0.4, 0.0])
    load, fixed = np.array([0, 0, -2e7 if nonlinear else -1, 0, 0, 0]), {"fixed": ["z0"]}
    options = {"nonlinear": nonlinear, "point": [0, 0, 2], "coupling": "rigid"}
    cut = fixed | {"sliding": PLANES[:2]}
    less = Solver(part(quarter, tmp_path, cut, locked=CORNER["locked"], **options)).solve(load / 4)
    more = Solver(part(whole, tmp_path, fixed, **options)).solve(load)
    assert less.displacement[2] == pytest.approx(more.displacement[2], rel=1e-9)
    assert 4 * less.strain_energy == pytest.approx(more.strain_energy, rel=1e-9)
    assert 4 * less.work == pytest.approx(more.work, rel=1e-9)
    assert less.compliance[2, 2] / 4 == pytest.approx(more.compliance[2, 2], rel=1e-8)


def test_a_half_bends_as_the_whole(tmp_path):
    half = box("hex20", (2, 2, 6), (0.1, 0.05, 2.0))
    whole = box("hex20", (2, 4, 6), (0.1, 0.1, 2.0), warp=lambda x: x - [0.0, 0.05, 0.0])
    load, fixed = np.array([2e3, 0, -1e3, 0, 1e3, 0]), {"fixed": ["z0"]}
    options = {"nonlinear": True, "point": [0, 0, 2]}
    cut = fixed | {"sliding": PLANES[1:2]}
    less = Solver(part(half, tmp_path, cut, locked=["uy", "rx", "rz"], **options)).solve(load / 2)
    more = Solver(part(whole, tmp_path, fixed, **options)).solve(load)
    assert np.degrees(more.displacement[4]) > 5
    np.testing.assert_allclose(less.displacement, more.displacement, rtol=0, atol=1e-9)


def test_a_symmetric_half_swings_as_the_whole(tmp_path):
    """Half the mass on half the part: the motion within the plane of symmetry."""
    half = box("hex20", (2, 2, 6), (0.1, 0.05, 2.0))
    whole = box("hex20", (2, 4, 6), (0.1, 0.1, 2.0), warp=lambda x: x - [0.0, 0.05, 0.0])
    fixed, options = {"fixed": ["z0"]}, {"point": [0, 0, 2]}
    cut = fixed | {"sliding": PLANES[1:2]}
    own = {"locked": ["uy", "rx", "rz"]} | options
    for density in (None, 1000.0):
        parts = part(half, tmp_path, cut, **own), part(whole, tmp_path, fixed, **own)
        less, more = (
            Solver(with_density(one, density)).vibration(Riding.of(mass))
            for one, mass in zip(parts, (0.5, 1.0), strict=True)
        )
        assert less.frequency == pytest.approx(more.frequency, rel=1e-9)


def with_density(one, density):
    return replace(one, materials=tuple(replace(m, density=density) for m in one.materials))


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("askew", [False, True])
def test_calculix_finds_the_same_on_sliding_supports(tmp_path, nonlinear, askew):
    """Askew to the axes of the deck each held direction is an equation of its own."""
    require_ccx()
    mesh = box("hex20", (2, 2, 6), (0.1, 0.05, 2.0))
    supports = {"fixed": ["z0"], "sliding": [PLANES[1]]}
    options = {"point": [0, 0, 2], "locked": ["uy", "rx", "rz"]}
    wrench = [300, 0, -1e3, 0, 200, 0]
    if askew:
        low = np.flatnonzero((mesh.points[:, 1] == 0) & (np.abs(mesh.points[:, 2] - 0.8) < 0.3))
        mesh = replace(mesh, node_groups={"low": low})
        supports["sliding"] = [{"group": "low", "directions": ["x", "z"], "axes": TURN.tolist()}]
        options = {"axes": rotation(np.array([0.1, 0.9, -0.4])).tolist()}
        wrench = [300, 100, -1e3, 50, 200, 30]
    one = part(mesh, tmp_path, supports, nonlinear=nonlinear, **options)
    result = Solver(one).solve(wrench).displacement
    reply = calculix.solve_rigid(one, wrench, result[3:] if nonlinear else None)
    assert second_opinion.difference(result, reply.displacement) < (1e-4 if nonlinear else 1e-5)


@pytest.mark.parametrize(
    ("sliding", "said"),
    [
        (PLANES[:1], "3 of its six rigid motions meet no resistance: turn about the line through"),
        (PLANES[:2], "it can slide along (0, 0, 1)"),
        ([{"group": "x0", "directions": ["x", "y", "z"]}], None),
    ],
)
def test_a_motion_that_sliding_supports_leave_free_is_named(tmp_path, sliding, said):
    mesh = box("hex20", (2, 2, 2))
    one = part(mesh, tmp_path, {"sliding": sliding}, section="x1", coupling="distributed")
    results = motion_problems(one, bodies_of(mesh), coincident_nodes(mesh))
    assert [problem.where for problem in results] == (["supports"] if said else [])
    assert all(said in problem.message for problem in results)
