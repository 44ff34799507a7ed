"""Surfaces that are tied: exact where the mathematics are, and CalculiX's answers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import FACES, require_ccx
from tests.fea.components import body_of
from tests.fea.pairs import LARGE, SMALL, TIE, merged, moved, pair, tied, together
from wrenchbook.fea.accuracy.estimate import accuracy_of
from wrenchbook.fea.accuracy.roundness import bows_of
from wrenchbook.fea.assembly.body import gather
from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.fea.check import as_text, report
from wrenchbook.fea.check.mechanisms import motion_problems
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.component import build
from wrenchbook.fea.export.calculix import PLACEHOLDERS, deck_of
from wrenchbook.fea.inspection import tie_warnings
from wrenchbook.fea.mesh.bodies import bodies_of, coincident_nodes
from wrenchbook.fea.mesh.dependents import CircularError, Dependents
from wrenchbook.fea.solve import Solver, solve
from wrenchbook.fea.spec.schema import Deck
from wrenchbook.fea.tensors import rotation

TURN = rotation(np.array([0.3, 0.5, -0.8]))
WRENCH = np.array([1e4, 2e4, 1e5, 1e4, 2e4, 1e4])
MATCHING = {"counts": ((3, 2, 2), (3, 2, 3)), "sizes": (LARGE, LARGE)}


def compliance(part):
    return Solver(part).compliance


def same(result, expected, tolerance):
    assert np.abs(result - expected).max() <= tolerance * np.abs(expected).max()


def rigid_energy(part):
    """The largest strain energy of a rigid motion of 1 m or rad, over the stiffness times 1 m²."""
    points = part.mesh.points
    turns = [np.cross(axis, points) for axis in np.eye(3)]
    shifts = [np.tile(axis, (len(points), 1)) for axis in np.eye(3)]
    fields = np.stack(shifts + turns, axis=-1)
    return np.abs(Solver(part).body.strain_energy_products(fields)).max() / 1e9


@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["straight", "turned"])
@pytest.mark.parametrize(
    "kinds", [("hex20", "hex20"), ("hex20", "tet10"), ("tet10", "hex27"), ("wedge15", "tet10")]
)
def test_a_uniform_stress_passes_a_tie_of_meshes_that_do_not_match(kinds, turn):
    mesh = pair(kinds, counts=((3, 4, 2), (5, 3, 2)), sizes=(LARGE, LARGE))
    height = mesh.points[:, 2]
    field = mesh.points @ np.diag([-0.3, -0.3, 1.0]) @ turn.T * 1e-3
    mesh = tied(replace(mesh, points=mesh.points @ turn.T), TIE).mesh
    free = (height > 1e-9) & (height < 4 - 1e-9)
    body = body_of(mesh, free, integration="full")
    tangent, ends = body.tangent(None), np.where(free[:, None], 0.0, field)
    residual = tangent.times(ends[:, :, None], np.arange(len(height)))
    result = body.expanded(ends - tangent.solve(residual)[:, :, 0])
    same(result, field, 1e-12)
    for part, nodes in zip(body.parts, body.cells, strict=True):
        stress = part.small_stresses(np.moveaxis(gather(result[:, :, None], nodes), -1, 0))
        turned = turn.T @ stress @ turn
        same(turned, np.broadcast_to(np.diag([0.0, 0.0, 1e6]), turned.shape), 1e-10)


def test_meshes_that_match_are_as_one_mesh():
    mesh = pair(**MATCHING)
    one, two = Solver(tied(merged(mesh))), Solver(tied(mesh, TIE))
    same(two.compliance, one.compliance, 1e-11)
    beams = [solver.craig_bampton(3) for solver in (two, one)]
    same(beams[0].stiffness, beams[1].stiffness, 1e-8)
    same(beams[0].mass, beams[1].mass, 1e-8)


@pytest.mark.parametrize(("fixed", "section"), [("a_z1", "b_z1"), ("b_z1", "a_z1")])
def test_main_nodes_may_be_fixed_or_follow_a_rigid_interface(fixed, section):
    mesh, groups = pair(**MATCHING), {"fixed": fixed, "section": section}
    same(compliance(tied(mesh, TIE, **groups)), compliance(tied(merged(mesh), **groups)), 1e-11)


def test_main_nodes_may_be_the_secondary_nodes_of_another_tie():
    blocks = [box("hex20", (2, 2, 2)) for _ in range(3)]
    mesh = together(blocks[0], moved(blocks[1], [0, 0, 1]), moved(blocks[2], [1, 0, 1]))
    chain = tied(mesh, TIE, {"secondary": "c_x0", "main": "b_x1"}, section="c_x1")
    same(compliance(chain), compliance(tied(merged(mesh), section="c_x1")), 1e-11)


def test_a_gap_is_closed_so_that_no_rigid_motion_strains_the_tie_in_any_frame():
    mesh = pair(("hex20", "tet10"), gap=0.02)
    part = tied(mesh, TIE)
    assert part.ties[0].max_gap == pytest.approx(0.02)
    assert rigid_energy(part) < 1e-15
    frame = {"interface": {"section": "b_z1", "coupling": "rigid", "axes": TURN.T.tolist()}}
    turned = tied(replace(mesh, points=mesh.points @ TURN.T), TIE, **frame)
    same(compliance(turned), compliance(part), 1e-10)


def tubes(straight):
    """Half a tube of 8 cells round in one of 6, which is straight between corners or round."""

    def tube(count, inner, outer):
        def bent(points):
            radius, angle = inner + (outer - inner) * points[:, 0], np.pi * points[:, 1]
            return np.stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 2]], axis=1)

        return box("hex20", count, warp=bent, corners_only=straight)

    return together(tube((2, 8, 3), 0.5, 1.0), tube((2, 6, 2), 1.0, 1.5))


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("straight", [False, True])
def test_round_surfaces_are_tied_without_strain_by_rigid_motions(straight, swapped):
    first, second = ("a_x1", "b_x0") if swapped else ("b_x0", "a_x1")
    part = tied(tubes(straight), {"secondary": first, "main": second}, fixed="a_x0", section="b_x1")
    assert part.ties[0].untied == 0
    assert rigid_energy(part) < 1e-15


def test_straight_edges_of_round_surfaces_are_in_the_error_bar_where_a_tie_closes_a_gap():
    part = tied(
        tubes(straight=True), {"secondary": "b_x0", "main": "a_x1"}, fixed="a_x0", section="b_x1"
    )
    outer = np.flatnonzero(np.isclose(np.hypot(*part.mesh.points.T[:2]), 1.5 * np.cos(np.pi / 12)))
    bows = np.linalg.norm(bows_of(part.mesh)[0], axis=1)
    np.testing.assert_allclose(bows[outer].max(), 1.5 * (1 - np.cos(np.pi / 12)), rtol=0.02)


def test_facets_beyond_the_distance_of_a_tie_are_named_with_their_distance():
    pair_of = {"secondary": "b_x0", "main": "a_x1"}
    near, far = (pair_of | {"distance": distance} for distance in (0.025, 0.005))
    part = tied(tubes(straight=True), near, fixed="a_x0", section="b_x1")
    text = next(tie_warnings(part)).message
    assert "facets up to 0.0338 m off are beyond the distance, 0.025 m: 6 secondary nodes" in text
    with pytest.raises(
        BundleError, match=r"are up to 0.0338 m off .* 0.005 m; write a larger distance"
    ):
        tied(tubes(straight=True), far, fixed="a_x0", section="b_x1")


def test_secondary_nodes_beyond_the_main_surface_stay_loose():
    part = tied(pair(counts=((8, 8, 2), (4, 4, 2))), {"secondary": "a_z1", "main": "b_z0"})
    off = np.abs(part.mesh.points[part.ties[0].nodes, :2] - 0.5)
    assert (off <= [0.3 + 1 / 12, 0.4 + 1 / 12]).all()  # two thirds of a facet
    assert part.ties[0].untied > 0


def block_on(counts, sizes=SMALL, swapped=False):
    """The compliances of a block in the middle of a larger one, which is the tie's secondary."""
    mesh, sides = pair(counts=counts, sizes=(LARGE, sizes)), ("b_z0", "a_z1")
    names = dict(zip(("main", "secondary"), reversed(sides) if swapped else sides, strict=True))
    part = tied(mesh, names)
    return part, np.diag(compliance(part))


def test_the_nodes_on_the_edge_of_a_tie_are_tied_from_either_side():
    counts = ((10, 10, 4), (6, 8, 4))  # the block's edges are edges of facets of both
    part, one = block_on(counts)
    same(one, block_on(counts, swapped=True)[1], 1e-9)
    assert part.ties[0].cut == 0


def test_a_tie_that_ends_within_facets_is_named_and_in_the_error_bar():
    part, one = block_on(((4, 4, 2), (3, 3, 3)), (0.7, 0.65, 2.0))
    off = block_on(((20, 20, 6), (14, 13, 6)), (0.7, 0.65, 2.0))[1] - one
    cut, bar = Solver(part), {}
    for which, solver in (
        ("cut", cut),
        ("whole", Solver(replace(part, ties=(replace(part.ties[0], cut=0, within=0.0),)))),
    ):
        bar[which] = np.diag(accuracy_of(solver)["mesh"])
    assert (bar["cut"] > 1.2 * bar["whole"]).all()
    assert (bar["cut"] >= np.abs(off)).all()
    assert "ends within 12 facets, and the tie at their edges" in next(tie_warnings(part)).message


def test_a_tie_that_ends_within_main_facets_is_in_the_error_bar_too():
    sizes = (0.2, 0.2, 1.0)
    part, one = block_on(((4, 4, 2), (3, 3, 3)), sizes, swapped=True)
    off = block_on(((20, 20, 6), (4, 4, 4)), sizes, swapped=True)[1] - one
    assert part.ties[0].cut == 0
    assert part.ties[0].within == pytest.approx(np.sqrt(2) * 0.25 / 0.2)
    without = replace(part, ties=(replace(part.ties[0], within=0.0),))
    wide = replace(part, ties=(replace(part.ties[0], within=3.1),))
    assert [len(list(tie_warnings(each))) for each in (part, wide)] == [0, 1]
    bar, less = (np.diag(accuracy_of(Solver(each))["mesh"]) for each in (part, without))
    assert (bar >= np.abs(off)).all()
    assert (less < np.abs(off)).any()


def test_a_facet_too_large_for_a_tie_is_refused_with_the_other_way_round():
    with pytest.raises(BundleError, match=r"at most a third of each facet.*Swap"):
        block_on(((2, 2, 1), (4, 4, 3)), (0.45, 0.4, 1.0))


def test_secondary_nodes_on_a_plane_of_symmetry_follow_what_is_held_there_too():
    mesh = pair(counts=((3, 4, 3), (5, 3, 3)), sizes=(LARGE, LARGE))
    half = {"section": "b_z1", "coupling": "rigid", "locked": ["ux", "ry", "rz"]}

    def cut(*groups) -> dict[str, Any]:
        sliding = [{"group": group, "directions": ["x"]} for group in groups]
        return {"interface": half, "supports": {"fixed": ["a_z0"], "sliding": sliding}}

    part = tied(mesh, TIE, **cut("a_x0", "b_x0"))
    fine = pair(counts=((6, 6, 6), (6, 6, 6)), sizes=(LARGE, LARGE))
    whole = np.diag(compliance(tied(merged(fine), **cut("a_x0", "b_x0"))))[1:4]
    same(np.diag(compliance(part))[1:4], whole, 5e-3)
    assert part.ties[0].untied == 0
    assert tied(mesh, TIE, **cut("b_x0")).ties[0].untied > 0  # the main surface is free there


BUSHING = {"group": "b_x0", "coupling": "rigid", "stiffness": [1, 1, 1, 1, 1, 1]}
SPRING = {"groups": ["b_x0", "a_x1"], "coupling": "distributed", "stiffness": [1, 1, 1, 1, 1, 1]}


@pytest.mark.parametrize(
    ("changes", "tables", "words"),
    [
        ({"main": "a_z0"}, {}, "nearest nodes are 2 m apart. Correct the groups, or write"),
        ({"main": "a_z0", "distance": 9}, {}, r"mean edge, the most\); .* or move the surfaces"),
        ({"main": "a_z2"}, {}, r'tie\[0\].main: the mesh has no facet group "a_z2"'),
        ({"distance": -1}, {}, r"tie\[0\].distance: must be above 0"),
        (
            {},
            {"section": "b_x0"},
            "belong to interface.section, but a node can follow one only. Swap",
        ),
        (
            {},
            {"supports": {"bushing": [BUSHING]}},
            r"belong to supports.bushing\[0\].group, but a node",
        ),
        ({}, {"spring": [SPRING]}, r"belong to spring\[0\].groups, but a node"),
        (
            {},
            {"fixed": "b_z0"},
            'no node of "b_z0" is free to follow "a_z1": [0-9]+ are fixed. Leave',
        ),
    ],
)
def test_a_tie_that_cannot_be_is_refused(changes, tables, words):
    with pytest.raises(BundleError, match=words):
        tied(pair(), TIE | changes, **tables)


def by_ccx(part, text, wrench, folder):
    """The interface's displacement by CalculiX."""
    require_ccx()
    (folder / "written.inp").write_text(text)
    output = {"reader": "calculix-dat", "point": "REF", "rotation": "ROT"}
    deck = Deck(folder / "written.inp", ("ccx", "{job}"), output, moment="conjugate")
    return solve(replace(part.bundle, deck=deck), wrench).displacement


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
@pytest.mark.parametrize(("nonlinear", "tolerance"), [(False, 1e-5), (True, 1e-4)])
def test_ccx_answers_the_same_by_the_equations_of_the_deck(kind, nonlinear, tolerance, tmp_path):
    part = tied(pair(("hex20", kind), 0.01), TIE, analysis={"nonlinear": nonlinear})
    wrench = WRENCH * (20 if nonlinear else 1)  # turns by 4 degrees
    same(by_ccx(part, deck_of(part), wrench, tmp_path), solve(part, wrench).displacement, tolerance)


def proposed(text, folder):
    """The report of the component that is proposed of a deck under `WRENCH`, and its folder."""
    for name, load in zip(PLACEHOLDERS, WRENCH, strict=True):
        text = text.replace(name, str(load))
    (folder / "pair.inp").write_text(text)
    return propose(folder / "pair.inp", folder / "new", "m")["check"], folder / "new"


def test_a_deck_with_a_tie_is_proposed_with_it_and_answers_nearly_as_in_ccx(tmp_path):
    mesh = pair(gap=0.01)
    loose = tied(mesh)
    lines, cells = [], np.concatenate([block.nodes for block in mesh.blocks])
    for name in ("a_z1", "b_z0"):
        on = np.isin(cells, mesh.facet_groups[name].node_ids)
        sides = [np.flatnonzero(on[:, list(face)].all(axis=1)) + 1 for face in FACES]
        lines.append(f"*SURFACE, NAME={name}")
        lines += [f"{cell}, S{side}" for side, of in enumerate(sides, 1) for cell in of]
    lines += ["*TIE, NAME=T, POSITION TOLERANCE=0.05", "b_z0, a_z1", "*STEP"]
    text = deck_of(loose).replace("*STEP", "\n".join(lines))
    result, folder = proposed(text, tmp_path)
    assert result["ok"]
    line = "tie: 29 nodes of b_z0 follow a_z1, 0 are not tied; largest gap 10 mm"
    assert line in as_text(result).splitlines()
    assert "closes gaps of up to 0.01 m" in result["warnings"][0]["message"]
    assert result["solver_error"]["mesh"] is not None  # of a finer mesh, tied anew
    # CalculiX ties nodes to surfaces.
    here = solve(read_bundle(folder), WRENCH).displacement
    same(here, by_ccx(loose, text, WRENCH, tmp_path), 2e-3)
    written = (folder / "component.toml").read_text()
    table = written[written.index("[[tie]]") : written.index("[analysis]")]
    (folder / "component.toml").write_text(written.replace(table, ""))
    untied = report(folder)
    assert "part 2 of 2" in untied["problems"][0]["message"]
    assert any("write [[tie]]" in warning["message"] for warning in untied["warnings"])
    assert untied["fingerprint"] != result["fingerprint"]


def test_equations_and_pairs_of_nodes_of_a_deck_tie_its_mesh(tmp_path):
    part = tied(pair(), TIE)
    result, folder = proposed(deck_of(part), tmp_path)
    assert result["ok"]
    assert not result["warnings"]
    same(compliance(build(read_bundle(folder))), compliance(part), 1e-11)
    mesh = pair(**MATCHING)
    lines = [f"PIN, {second}, {first}" for first, second in coincident_nodes(mesh) + 1]
    text = deck_of(tied(mesh)).replace("*STEP", "\n".join(["*MPC", *lines, "*STEP"]))
    (tmp_path / "pairs").mkdir()
    result, folder = proposed(text, tmp_path / "pairs")
    same(compliance(build(read_bundle(folder))), compliance(tied(merged(mesh))), 1e-11)


def test_a_chain_of_many_nodes_that_follow_each_other_ends_at_its_first():
    """One of more than eight was refused as a circle."""
    size = 40
    follow = Dependents.of(size, (np.arange(1, size), np.arange(size - 1), np.full(size - 1, 0.5)))
    moved = follow.expanded(np.eye(size)[:, :1])
    np.testing.assert_array_equal(moved[:, 0], 0.5 ** np.arange(size))


@pytest.mark.parametrize("nodes", [[2], [2, 3], [*range(2, 30)]])
def test_a_circle_of_nodes_is_refused_with_a_node_on_it(nodes):
    """With powers of the weights alone a long circle of 0.5 would fade to 0."""
    chain = [*nodes, 30], [*np.roll(nodes, 1), 2], [0.5] * (len(nodes) + 1)
    with pytest.raises(CircularError) as caught:
        Dependents.of(31, tuple(map(np.array, chain)))
    assert caught.value.node in nodes


def test_ties_by_which_a_node_follows_itself_are_refused():
    with pytest.raises(BundleError, match="follows itself by several ties; swap"):
        tied(pair(sizes=(LARGE, LARGE)), TIE, {"secondary": "a_z1", "main": "b_z0"})


def test_a_tie_beside_a_bolt_counts_as_what_holds_the_part_and_may_not_hold_the_cut():
    mesh = pair()
    mesh = replace(mesh, regions={"b": (np.arange(0), np.arange(len(mesh.blocks[1])))})
    shank = {"region": "b", "axis": [0, 0, 1], "force": 1e4}
    part = tied(mesh, TIE, bolt=[shank])
    (problem,) = motion_problems(
        part, bodies_of(part.uncut_mesh), coincident_nodes(part.uncut_mesh)
    )
    assert "while they are tightened: it can slide along (0, 0, 1)" in problem.message
    for tie in (TIE, {"secondary": "a_z1", "main": "b_z0"}):
        with pytest.raises(BundleError, match=r"nodes of its cut.* also belong to tie\[0\]; move"):
            tied(mesh, tie, fixed="a_x1", section="a_x0", bolt=[shank | {"axis": [1, 0, 0]}])
