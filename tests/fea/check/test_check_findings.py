"""What the check says of meshes that an FEA engineer would send back."""

import json
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.geometry import draw_two_bars
from tests.refusals import GOOD
from tests.validation.clamped import clamped
from tests.validation.laminate import strip
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check import as_text, report
from wrenchbook.fea.check.mechanisms import describe, free_motions
from wrenchbook.fea.check.strength import LargestStress, _replace_by_nonlinear, strength
from wrenchbook.fea.check.trial import largest
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.bodies import bodies_of, coincident_nodes
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.quality import (
    aspect_ratio,
    edge_curvature,
    jacobian_ratio,
    scaled_jacobian,
)
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import DeclaredRange
from wrenchbook.fea.tensors import von_mises


def joined(first, second, merged=()):
    """Two meshes in one; `merged` maps nodes of the second to nodes of the first."""
    shift = len(first.points)
    points = np.concatenate([first.points, second.points])
    number = shift + np.arange(len(second.points))
    for mine, other in dict(merged).items():
        number[mine] = other
    used, flat = np.unique(
        np.concatenate([first.blocks[0].nodes, number[second.blocks[0].nodes]]),
        return_inverse=True,
    )
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    cells = flat.reshape(-1, first.blocks[0].nodes.shape[1])
    groups = {f"first {n}": moved(g, renumber) for n, g in first.facet_groups.items()}
    groups |= {f"second {n}": moved(g, renumber[number]) for n, g in second.facet_groups.items()}
    return Mesh(points[used], (CellBlock(first.blocks[0].kind, cells),), {}, groups, {})


def moved(group, number):
    return FacetGroup(tuple(FacetBlock(kind, number[nodes]) for kind, nodes in group.blocks))


def cubes(offset=(1.0, 0.0, 0.0), merge=None):
    """Two unit cubes, the second moved; `merge` says which coincident nodes become one."""
    first, second = box("hex20", (2, 2, 2)), box("hex20", (2, 2, 2))
    second = Mesh(second.points + offset, second.blocks, {}, second.facet_groups, {})
    same = np.abs(second.points[:, None] - first.points[None]).max(axis=2) < 1e-9
    pairs = np.argwhere(same)
    kept = [(a, b) for a, b in pairs.tolist() if merge is not None and merge(second.points[a])]
    return joined(first, second, kept)


def motions(mesh, **options):
    built = component(mesh, **options)
    return free_motions(built, bodies_of(mesh))


def test_cells_joined_by_faces_are_one_body_and_by_an_edge_or_point_two():
    assert bodies_of(cubes(merge=lambda x: True)).count == 1
    assert bodies_of(cubes(merge=lambda x: x[2] == 0)).count == 2
    assert bodies_of(cubes(merge=None)).count == 2
    assert bodies_of(box("tet10", (2, 2, 2))).count == 1
    assert bodies_of(box("wedge15", (2, 2, 2))).count == 1


def test_a_second_body_without_supports_has_all_six_motions():
    held, loose = motions(cubes(), fixed="first x0", section="first x1")
    assert len(held) == 0
    assert len(loose) == 6


def test_bodies_joined_on_one_edge_are_a_hinge_about_it():
    mesh = cubes(merge=lambda x: x[2] == 0)
    held, loose = motions(mesh, fixed="first x0", section="second x1")
    assert (len(held), len(loose)) == (0, 1)
    size = np.linalg.norm([2, 1, 1])
    text = describe(loose[0], np.array([1, 0.5, 0.5]), size)
    assert text == "turn about the line through (1, 0.5, 0) m along (0, 1, 0)"


def test_a_rigid_section_over_two_bodies_joins_them_and_a_mean_one_does_not():
    mesh = cubes()
    both = FacetGroup(mesh.facet_groups["first z1"].blocks + mesh.facet_groups["second z1"].blocks)
    groups = {**mesh.facet_groups, "both": both}
    mesh = Mesh(mesh.points, mesh.blocks, {}, groups, {})
    rigid = motions(mesh, fixed="first x0", section="both", coupling="rigid")
    mean = motions(mesh, fixed="first x0", section="both", coupling="distributed")
    assert [len(own) for own in rigid] == [0, 0]
    assert [len(own) for own in mean] == [0, 6]


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize(
    ("locked", "left"), [((), 6), (("ux",), 5), (("ux", "uy", "uz"), 3), (("rx", "rz", "uy"), 3)]
)
def test_a_guide_holds_the_body_of_its_section(coupling, locked, left):
    mesh = cubes()
    options = {"section": "second x1", "coupling": coupling, "locked": locked}
    held, guided = motions(mesh, fixed="first x0", **options)
    assert (len(held), len(guided)) == (0, left)


def test_what_the_check_calls_a_mechanism_the_solver_calls_one_too():
    for merge, count in ((None, 6), (lambda x: x[2] == 0, 1)):
        mesh = cubes(merge=merge)
        built = component(mesh, fixed="first x0", section="second x1")
        assert len(free_motions(built, bodies_of(mesh))[1]) == count
        with pytest.raises(SolveFailed, match="mechanism"):
            _ = Solver(built).compliance


def test_unmerged_nodes_are_found_and_near_ones_are_not_taken_for_them():
    pairs = coincident_nodes(cubes())
    assert len(pairs) == 21
    assert len(coincident_nodes(cubes(offset=(1.001, 0, 0)))) == 21  # 0.2 % of an edge
    assert len(coincident_nodes(cubes(offset=(1.01, 0, 0)))) == 0
    assert len(coincident_nodes(box("hex20", (2, 2, 2)))) == 0


# Edges of the regular tetrahedron and of the right wedge on a regular triangle, from one corner.
HIGH = 0.75**0.5
REGULAR = {
    "hex": np.eye(3),
    "tet": np.array([[1, 0, 0], [0.5, HIGH, 0], [0.5, HIGH / 3, (2 / 3) ** 0.5]]),
    "wed": np.array([[1, 0, 0], [0.5, HIGH, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("kind", ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15"])
def test_ideal_cells_measure_one_however_they_lie(kind):
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    points = node_coordinates(kind) @ REGULAR[kind[:3]] @ turn
    block = CellBlock(kind, np.arange(len(points))[None])
    assert scaled_jacobian(points, block)[0] == pytest.approx(1.0, rel=1e-12)
    assert jacobian_ratio(points, block)[0] == pytest.approx(1.0, rel=1e-12)
    assert aspect_ratio(points, block)[0] == pytest.approx(1.0, rel=1e-12)
    assert edge_curvature(points, block)[0] == pytest.approx(0.0, abs=1e-12)


def test_flat_long_and_bent_cells_are_measured():
    block = CellBlock("hex20", np.arange(20)[None])
    places = node_coordinates("hex20")
    sheared = places + np.outer(places[:, 0], [0, 1.0, 0])  # corners of 45 degrees
    assert scaled_jacobian(sheared, block)[0] == pytest.approx(0.5**0.5, rel=1e-12)
    assert aspect_ratio(places * [5, 1, 1], block)[0] == pytest.approx(5.0)
    bent = places.copy()
    bent[8] += [0, 0.3, 0]
    assert edge_curvature(bent, block)[0] == pytest.approx(0.3)
    quarter = places.copy()
    quarter[8, 0] = 0.25
    assert jacobian_ratio(quarter, block)[0] == pytest.approx(0.0, abs=1e-12)


def write_inp(folder, mesh, *, supports='["root"]', section="tip", young="2e11", extra=""):
    """A bundle with the mesh as a deck: nodes of `root` at the least x, of `tip` at the most."""
    lines = ["*NODE"]
    lines += [f"{i + 1}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(mesh.points.tolist())]
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=solid")
    cells = (mesh.blocks[0].nodes + 1).tolist()  # the order of nodes is that of VTK
    lines += [f"{i + 1}, " + ", ".join(map(str, cell)) for i, cell in enumerate(cells)]
    for name, end in (("root", mesh.points[:, 0].min()), ("tip", mesh.points[:, 0].max())):
        ids = np.flatnonzero(np.abs(mesh.points[:, 0] - end) < 1e-12) + 1
        lines += [f"*NSET, NSET={name}", *map(str, ids)]
    (folder / "mesh.inp").write_text("\n".join(lines) + "\n" + extra)
    (folder / "component.toml").write_text(
        f"""
name = "part"
title = "P"
[mesh]
file = "mesh.inp"
unit = "m"
[[material]]
region = "all"
youngs_modulus = {young}
poisson_ratio = 0.3
[supports]
fixed = {supports}
[interface]
section = "{section}"
coupling = "distributed"
[analysis]
nonlinear = false
[range]
force = [1, 1, 1]
moment = [1, 1, 1]
"""
    )
    return folder


def messages(told, kind):
    return [entry["message"] for entry in told[kind]]


def test_a_good_bundle_has_no_warnings_and_an_estimate(tmp_path):
    reported = report(write_inp(tmp_path, box("hex20", (4, 2, 2), (4, 1, 1))))
    assert (reported["ok"], reported["problems"], reported["warnings"]) == (True, [], [])
    assert reported["cells"] == {"hex20": 16}
    assert reported["quality"]["scaled_jacobian"]["worst"] == pytest.approx(1.0)
    assert [part["size"] for part in reported["parts"]] == [pytest.approx([4, 1, 1])]
    assert reported["coincident_nodes"] == 0
    assert reported["section"]["area"] == pytest.approx(1.0)
    one = reported["estimate"]
    assert one["unknowns"] == reported["unknowns"] - 3 * reported["supports"]["nodes"]
    assert 0 < one["linear_seconds"] < one["nonlinear_seconds"] < 60
    assert 1e8 < one["memory_bytes"] < 1e9
    assert as_text(reported).endswith("ready to solve")


def test_two_parts_that_only_look_joined_are_an_error_that_says_merge(tmp_path):
    reported = report(write_inp(tmp_path, cubes()))
    (problem,) = messages(reported, "problems")
    assert problem.startswith("part 2 of 2 (8 cells, 1000 x 1000 x 1000 mm, middle at (1.5, 0.5")
    assert "it can move in all six directions" in problem
    assert "At 21 of its nodes there are also nodes of another part; merge these" in problem
    (warning,) = messages(reported, "warnings")
    assert warning.startswith("21 pairs of nodes of part 1 and part 2 (one near (1, 0")
    assert reported["coincident_nodes"] == 21
    assert "part 2: 8 cells, 1000 x 1000 x 1000 mm" in as_text(reported)


def test_a_part_beside_the_others_is_named_with_its_distance(tmp_path):
    reported = report(write_inp(tmp_path, cubes(offset=(1.25, 0, 0))))
    (problem,) = messages(reported, "problems")
    assert "nearest part is number 1, 250 mm away" in problem


def test_a_hinge_is_an_error_that_names_its_axis(tmp_path):
    reported = report(write_inp(tmp_path, cubes(merge=lambda x: x[2] == 0)))
    (problem,) = messages(reported, "problems")
    assert "turn about the line through (1, 0.5, 0) m along (0, 1, 0)" in problem
    assert "a hinge" in problem


def test_supports_that_hold_points_only_are_a_warning(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 1, 1))
    corner = [
        np.flatnonzero((mesh.points == p).all(axis=1))[0] + 1
        for p in ([0, 0, 0], [0, 1, 0], [0, 0, 1])
    ]
    pins = "*NSET, NSET=pins\n" + "\n".join(map(str, corner)) + "\n"
    reported = report(write_inp(tmp_path, mesh, supports='["pins"]', extra=pins))
    assert reported["ok"]
    (warning,) = messages(reported, "warnings")
    assert warning.startswith("has no complete face (nodes: 3); an elastic")


def test_steel_in_megapascals_and_a_point_in_millimetres_are_warnings(tmp_path):
    folder = write_inp(tmp_path, box("hex20", (4, 2, 2), (0.4, 0.1, 0.1)), young="2.1e5")
    setup = folder / "component.toml"
    text = setup.read_text()
    text = text.replace("poisson_ratio", "density = 7.85e-9\npoisson_ratio")
    setup.write_text(text.replace("[interface]", "[interface]\npoint = [400, 50, 50]"))
    reported = report(folder)
    assert reported["ok"]
    modulus, density, point, turned, buckles = messages(reported, "warnings")
    assert "the part buckles at" in buckles
    assert "convert it to kg/m^3" in density
    assert "degrees at the full range" in turned
    assert "convert it to Pa" in modulus
    assert "convert it to m" in point


def test_supports_that_touch_the_section_are_an_error(tmp_path):
    reported = report(write_inp(tmp_path, box("hex20", (4, 2, 2), (4, 1, 1)), section="root"))
    assert any("are fixed by [supports]" in text for text in messages(reported, "problems"))
    assert "quality" in reported  # the mesh is reported all the same


def test_one_layer_between_section_and_supports_is_a_warning(tmp_path):
    reported = report(write_inp(tmp_path, box("hex20", (1, 2, 2), (0.2, 1, 1))))
    assert reported["ok"]
    assert not reported["warnings"]  # midside nodes are free
    pinned = "*NSET, NSET=most\n" + "\n".join(
        str(i + 1) for i, x in enumerate(box("hex20", (2, 2, 2)).points[:, 0]) if x < 0.9
    )
    folder = tmp_path / "held"
    folder.mkdir()
    reported = report(write_inp(folder, box("hex20", (2, 2, 2)), supports='["most"]', extra=pinned))
    assert any("8 of the 8 cells cannot deform" in text for text in messages(reported, "warnings"))


def test_badly_shaped_cells_are_a_warning_with_their_place(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 0.01, 1))
    reported = report(write_inp(tmp_path, mesh))
    (warning,) = messages(reported, "warnings")
    assert "16 cells are long and thin (aspect ratio over 50; the worst, a hex20 near (" in warning


BRACKET = (GOOD / "bracket" / "component.toml").read_text("utf-8")
GROUPS = BRACKET[BRACKET.index("wall = ") : BRACKET.index("[[material]]")]


def two_bars(folder, groups, size="0.015", **drawn):
    draw_two_bars(folder / "bars.step", **drawn)
    text = BRACKET.replace("bracket.step", "bars.step").replace(GROUPS, groups)
    (folder / "component.toml").write_text(text.replace("size = 0.015", f"size = {size}"))
    return report(folder)


def test_a_geometry_lists_its_faces_even_where_the_bundle_has_mistakes(tmp_path):
    reported = two_bars(tmp_path, 'wall = {plane = "x", at = 7}\n')
    assert [entry["where"] for entry in reported["problems"]] == ["mesh.groups.wall.plane"]
    assert len(reported["faces"]) == 11
    assert len(reported["bodies"]) == 2
    (tmp_path / "component.toml").write_text('[mesh]\nfile = "bars.step"\n')
    reported = report(tmp_path)
    assert "mesh.size" in {entry["where"] for entry in reported["problems"]}
    text = as_text(reported)
    assert "plane, normal (-1, 0, 0)" in text
    assert text.endswith("errors")


def test_bodies_that_do_not_touch_are_told_by_the_check(tmp_path):
    groups = 'wall = {plane = "x", at = 0}\nhole = {plane = "x", at = 0.101}\n'
    (problem,) = messages(two_bars(tmp_path, groups, "0.01", space=1.0), "problems")
    assert "is free: it can move in all six directions" in problem
    assert "1 mm away" in problem


def test_the_text_is_printed_by_the_program(tmp_path):
    write_inp(tmp_path, box("hex20", (4, 2, 2), (4, 1, 1)), young="-1")
    command = [sys.executable, "-m", "wrenchbook.fea.check", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1] == "1 error"
    assert "error: material[0].youngs_modulus: must be above 0 (Pa), not -1" in done.stdout


def test_every_report_is_json(tmp_path):
    reported = report(write_inp(tmp_path, cubes()))
    assert json.loads(json.dumps(reported)) == reported


def test_a_cell_that_names_a_node_twice_is_refused(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 1, 1))
    mesh.blocks[0].nodes[5, 1] = mesh.blocks[0].nodes[5, 0]
    reported = report(write_inp(tmp_path, mesh))
    assert not reported["ok"]
    assert messages(reported, "problems")


def test_the_largest_displacement_over_a_range_is_that_of_its_worst_corner():
    chance = np.random.default_rng(3)
    matrix, low, high = chance.normal(size=(6, 6)), -chance.random(6), chance.random(6)
    ends = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(6, -1)
    np.testing.assert_allclose(largest(matrix, low, high), np.abs(matrix @ ends).max(axis=1))


def test_no_wrench_of_the_range_has_a_larger_stress():
    part = build(read_bundle(SHIPPED / "bar"))
    ((worst,), _) = strength(Solver(part), nonlinear=False)
    loads = part.bundle.range
    assert set(worst.wrench) <= {*loads.low, *loads.high}
    built = Solver(part)
    rng = np.random.default_rng(3)
    for wrench in rng.uniform(loads.low, loads.high, (20, 6)):
        assert von_mises(built.unit_stresses() @ wrench).max() <= worst.largest
    ends = von_mises(built.unit_stresses() @ np.array(worst.wrench))
    assert ends.max() == pytest.approx(worst.largest, rel=1e-12)


def rod(times=1.0, nonlinear=True):
    part = clamped(box("hex20", (2, 2, 4), (0.01, 0.01, 0.2)), "z0", "z1", (70e9, 0.3))
    high = times * np.array([20.0, 10.0, 100.0, 1.0, 1.0, 1.0])
    bundle = replace(part.bundle, range=DeclaredRange(-high, high))
    material = replace(part.materials[0], yield_strength=200e6)
    analysis = replace(part.analysis, nonlinear=nonlinear)
    return replace(part, bundle=bundle, materials=(material,), analysis=analysis)


def test_a_nonlinear_component_is_first_order_unless_it_is_solved():
    ((plain,), _) = strength(Solver(rod()), nonlinear=False)
    ((solved,), _) = strength(Solver(rod()), nonlinear=True)
    assert (plain.first_order, solved.first_order) == (True, False)
    assert solved.wrench == plain.wrench
    assert solved.largest != plain.largest
    assert solved.largest == pytest.approx(plain.largest, rel=0.1)
    built = Solver(rod())
    stress = built.fields(built.solve(solved.wrench)).largest
    assert solved.largest == pytest.approx(stress, rel=1e-9)


def test_a_range_that_cannot_be_solved_stays_first_order_and_says_why():
    ((stress,), warnings) = strength(Solver(rod(times=300.0)), nonlinear=True)
    assert stress.first_order
    assert any("fails" in warning.message for warning in warnings)


def test_von_mises_says_little_of_an_orthotropic_material():
    part = strip((0, 90), (4, 1))
    loads = DeclaredRange(-np.ones(6), np.ones(6))
    materials = tuple(replace(material, yield_strength=1e12) for material in part.materials)
    part = replace(part, bundle=replace(part.bundle, range=loads), materials=materials)
    results, warnings = strength(Solver(part), nonlinear=False)
    assert len(results) == 2
    assert "suits isotropic materials only" in warnings[0].message


def test_a_failed_solve_of_a_corner_leaves_all_stresses_linear(monkeypatch):
    """Those of the first material were nonlinear, beside a warning that all are linear."""
    placed = (np.zeros((2, 3)), np.array([0, 1]))
    name = "wrenchbook.fea.check.strength.integration_points"
    monkeypatch.setattr(name, lambda component, points: placed)
    materials = [SimpleNamespace(region="first"), SimpleNamespace(region="second")]
    component = SimpleNamespace(materials=materials, mesh=SimpleNamespace(points=None))
    outcomes = iter([1, SolveFailed("not_converged", "no convergence")])

    def solve(wrench):
        outcome = next(outcomes)
        if isinstance(outcome, SolveFailed):
            raise outcome
        return outcome

    solver = SimpleNamespace(component=component, solve=solve, stresses=lambda _: np.ones((2, 6)))
    stresses = [
        LargestStress(material.region, 5.0, [0, 0, 0], [1, 0, 0, 0, 0, 0], {}, 1e8, True)
        for material in materials
    ]
    (problem,) = _replace_by_nonlinear(solver, stresses)
    assert "are linear" in str(problem)
    assert [stress.first_order for stress in stresses] == [True, True]
