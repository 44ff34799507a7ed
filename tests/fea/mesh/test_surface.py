"""Groups by geometry: one law for mesh files, decks and STEP; the faces that it numbers."""

import json
import tomllib

import meshio
import numpy as np
import pytest

from tests.fea.geometry import drawing, require_gmsh, start
from tests.validation.boxes import box
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.face_choice import choose
from wrenchbook.fea.mesh.facets import FaceFinder
from wrenchbook.fea.mesh.mesh import CellBlock
from wrenchbook.fea.mesh.surface import Surface
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.mesh_source import FaceSelector

COMPONENT = """
name = "beam"
title = "A beam"
[mesh]
file = "FILE"
unit = "mm"
GROUPS
[[material]]
region = "all"
youngs_modulus = 2e11
poisson_ratio = 0.3
[supports]
fixed = ["root"]
[interface]
section = "tip"
coupling = "distributed"
[analysis]
nonlinear = false
[range]
force = [1, 1, 1]
moment = [1, 1, 1]
"""
BY_GEOMETRY = """
[mesh.groups]
root = {plane = "x", at = 0}
tip = {near = [0.04, 0.0026, 0.0051]}
"""


def beam_file(path, named):
    """A beam of 40 x 10 x 10 mm as a mesh file in mm, its ends named or nothing."""
    mesh = box("hex20", (4, 2, 2), (0.04, 0.01, 0.01))
    points, cells = 1e3 * mesh.points, [("hexahedron20", mesh.blocks[0].nodes)]
    sets = {}
    if named:
        ends = {"root": 0.0, "tip": 40.0}
        sets = {name: np.flatnonzero(np.abs(points[:, 0] - x) < 1e-9) for name, x in ends.items()}
    if path.suffix == ".vtu":
        data = {n: np.isin(np.arange(len(points)), s).astype(np.int64) for n, s in sets.items()}
        meshio.write(path, meshio.Mesh(points, cells, point_data=data))
    else:
        meshio.write(path, meshio.Mesh(points, cells, point_sets=sets))
    return path


def beam(folder, ending, groups=""):
    folder.mkdir()
    file = beam_file(folder / f"beam{ending}", not groups)
    text = COMPONENT.replace("FILE", file.name).replace("GROUPS", groups)
    (folder / "component.toml").write_text(text)
    return read_bundle(folder)


@pytest.mark.parametrize("ending", [".vtu", ".inp"])
def test_groups_by_geometry_give_the_compliance_of_named_groups(tmp_path, ending):
    named = Solver(build(beam(tmp_path / "named", ending))).compliance
    chosen = Solver(build(beam(tmp_path / "chosen", ending, BY_GEOMETRY))).compliance
    np.testing.assert_allclose(chosen, named, rtol=1e-12, atol=1e-12 * np.abs(named).max())


def test_a_fingerprint_has_groups_by_geometry_and_each_of_their_keys(tmp_path):
    first = beam(tmp_path / "a", ".vtu", BY_GEOMETRY)
    table = tomllib.loads((tmp_path / "a" / "component.toml").read_text())
    prints = {first.fingerprint}
    for more in ("", "angle = 20, ", "inside = 'root', ", "box = [[0, 0, 0], [1, 1, 1]], "):
        root = f"root = {{plane = 'x', at = 0, {more}normal = [1, 0, 0]}}"
        table["mesh"]["groups"] |= tomllib.loads(root)
        prints.add(bundle_of(table, tmp_path / "a").fingerprint)
    assert len(prints) == 5


WAYS = {
    "a plane by its axis": ("plane = 'x', at = 0.4", lambda x: x[0] > 0.3999),
    "a plane by direction and point": (
        "plane = [0, 2, 0], at = [9, 0.1, 9]",
        lambda x: x[1] > 0.0999,
    ),
    "two planes by points": (
        "near = [[0, 0.03, 0.04], [0.4, 0.03, 0.04]]",
        lambda x: x[0] < 1e-9 or x[0] > 0.3999,
    ),
    "a box": ("box = [[0.3, 0, 0.1], [0.4, 0.1, 0.2]]", lambda x: x[2] > 0.0999 and x[0] > 0.3),
    "a normal": ("normal = [0, 0, -3]", lambda x: x[2] < 1e-9),
    "a normal within an angle": (
        "normal = [0, 1, -1], angle = 46",
        lambda x: x[2] < 1e-9 or x[1] > 0.0999,
    ),
    "a plane and a box": (
        "plane = 'z', at = 0, box = [[0, 0, 0], [0.1, 1, 1]]",
        lambda x: x[2] < 1e-9 and x[0] < 0.1,
    ),
    "inside another": (
        "box = [[0, 0, 0], [0.1, 1, 1]], inside = 'low'",
        lambda x: x[2] < 1e-9 and x[0] < 0.1,
    ),
    "a face by its number": ("faces = [1]", lambda x: x[0] < 1e-9),
}


@pytest.mark.parametrize("name", WAYS)
def test_a_key_selects_the_facets_that_its_geometry_says(name):
    keys, wanted = WAYS[name]
    surface = Surface(box("tet10", (4, 2, 2), (0.4, 0.1, 0.1)))
    low = FaceSelector(plane="z", at=0.0)
    choice = FaceSelector(**tomllib.loads(f"a = {{{keys}}}")["a"])
    mesh = choose(surface, {"a": choice, "low": low})
    chosen = {
        frozenset(row) for _, nodes in mesh.facet_groups["a"].blocks for row in nodes.tolist()
    }
    (nodes,) = (nodes.tolist() for _, nodes in surface.blocks)
    rows = {frozenset(row) for row, x in zip(nodes, surface.middles, strict=True) if wanted(x)}
    assert chosen == rows
    assert rows


def test_a_box_with_both_sides_of_a_plate_in_it_is_refused_with_what_to_add():
    surface = Surface(box("hex20", (8, 8, 1), (0.4, 0.4, 0.01)))
    corner = ((0.0, 0.0, -1.0), (0.2, 0.2, 1.0))
    with pytest.raises(BundleError) as caught:
        choose(surface, {"a": FaceSelector(box=corner)})
    (problem,) = caught.value.problems
    assert problem.where == "mesh.groups.a.box"
    assert (
        "both sides of a wall 0.01 m thick: 16 facets of face 3 and 16 of face 4" in problem.message
    )
    assert "add normal = [0.0, 0.0, -1.0] for one side, or faces = [3, 4]" in problem.message
    for keys in ({"normal": (0.0, 0.0, 1.0)}, {"faces": (3, 4)}):
        choose(surface, {"a": FaceSelector(box=corner, **keys)})


def draw_pipe(occ):
    outer = occ.addCylinder(1, 2, 3, 60, 80, 0, 20)
    occ.cut([(3, outer)], [(3, occ.addCylinder(-5, -6, 3, 72, 96, 0, 16.5))])


def draw_rounded_bracket(occ):
    """An L of 8 mm plate with a fillet of 5 mm, and a hole of radius 8 mm at (55, 30)."""
    foot, wall = occ.addBox(0, 0, 0, 80, 60, 8), occ.addBox(0, 0, 8, 8, 60, 50)
    (solid,), _ = occ.fuse([(3, foot)], [(3, wall)])
    ((_, solid),), _ = occ.cut([solid], [(3, occ.addCylinder(55, 30, -1, 0, 0, 10, 8))])
    occ.synchronize()
    inner = [7.9, -1, 7.9, 8.1, 61, 8.1]
    (edge,) = (edge for _, edge in require_gmsh().model.getEntitiesInBoundingBox(*inner, 1))
    occ.fillet([solid], [edge], [5.0])


@pytest.mark.parametrize(
    ("draw", "planes", "radii"), [(draw_pipe, 2, [16.5, 20]), (draw_rounded_bracket, 8, [5, 8])]
)
@pytest.mark.parametrize("order", [1, 2])
def test_check_lists_planes_and_cylinders_of_a_mesh_without_groups(
    tmp_path, capsys, draw, planes, radii, order
):
    folder = tmp_path / "part"
    folder.mkdir()
    with drawing(tmp_path / "part.step") as occ:
        draw(occ)
    gmsh = require_gmsh()
    start(gmsh)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.merge(str(tmp_path / "part.step"))
        gmsh.option.setNumber("Mesh.MeshSizeMax", 6)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 24)
        gmsh.option.setNumber("Mesh.ElementOrder", order)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(folder / "part.msh"))
    finally:
        gmsh.finalize()
    (folder / "component.toml").write_text('[mesh]\nfile = "part.msh"\nunit = "mm"\n')
    page = tmp_path / "faces.html"
    capsys.readouterr()
    main(["check", str(folder), "--faces", "--plot", str(page), "--json"])
    faces = json.loads(capsys.readouterr().out)["faces"]
    assert [face["number"] for face in faces] == [*range(1, len(faces) + 1)]
    assert sum(face["kind"] == "Plane" for face in faces) == planes
    result = sorted(1e3 * face["radius"] for face in faces if face["kind"] == "Cylinder")
    assert result == pytest.approx(radii, rel=1e-3)
    assert len(faces) == planes + len(radii)
    assert all(json.dumps(face["toml"])[1:-1] in page.read_text("utf-8") for face in faces)


def test_a_step_file_lists_the_same_lines_that_its_groups_take(tmp_path, capsys):
    with drawing(tmp_path / "part.step") as occ:
        draw_pipe(occ)
    (tmp_path / "component.toml").write_text('[mesh]\nfile = "part.step"\nsize = 0.01\n')
    main(["check", str(tmp_path), "--faces"])
    text = capsys.readouterr().out
    assert "cylinder, radius 16.5 mm, axis (0.6, 0.8, 0)" in text
    assert "NAME = {radius = 0.0165}" in text


def test_facets_of_a_cylinder_about_an_axis_leave_out_another_of_that_radius():
    mesh = box("hex20", (12, 2, 1), (2 * np.pi, 1.0, 0.1))
    angle, along, out = mesh.points.T
    ring = np.stack([(1 + out) * np.cos(angle), (1 + out) * np.sin(angle), along], axis=1)
    surface = Surface(type(mesh)(ring, mesh.blocks))
    axis = {"point": [0, 0, 7], "axis": [0, 0, -2]}
    (group,) = choose(surface, {"a": FaceSelector(radius=1.1, cylinder=axis)}).facet_groups.values()
    np.testing.assert_allclose(np.hypot(*ring[group.node_ids].T[:2]), 1.1)
    with pytest.raises(BundleError, match="no facet lies on the cylinder"):
        choose(surface, {"a": FaceSelector(radius=1.1, cylinder=axis | {"point": [0.1, 0, 0]})})


def test_a_face_that_a_linear_and_a_quadratic_cell_share_does_not_hide_a_facet_off_the_solid():
    quadratic = box("hex20", (1, 1, 1)).blocks[0]
    linear = CellBlock("hex8", quadratic.nodes[:, :8])
    shared = quadratic.nodes[:, :4]
    off_the_solid = quadratic.nodes[:, [0, 1, 2, 6]]
    faces, missing = FaceFinder((linear, quadratic)).find(
        "quad4", np.concatenate([shared, off_the_solid])
    )
    assert (sum(len(block.nodes) for block in faces), missing) == (1, 1)
