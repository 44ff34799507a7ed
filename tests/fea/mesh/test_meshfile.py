"""Mesh files: groups found, units scaled, node order right, faults told."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from tests.fea.boxes import volumes
from tests.refusals import GOOD
from wrenchbook.fea.bundle.read import BundleError
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.mesh.facets import FACES, outer_surface
from wrenchbook.fea.mesh.generators import Bar
from wrenchbook.fea.mesh.io import abaqus
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mapping import cell_problems

FILES = Path(__file__).parent / "meshfiles"
# Two glued blocks of 10 x 10 x 10 mm side by side along x, written by gmsh 4.15.
BLOCKS = {
    "hex20_22.msh": "hex20",
    "hex20_41.msh": "hex20",
    "hex27_41.msh": "hex27",
    "tet10_22.msh": "tet10",
    "tet10_41.msh": "tet10",
    "tet10_41_binary.msh": "tet10",
    "tet10.inp": "tet10",
}


def total(mesh):
    return sum(volumes(mesh.points, block).sum() for block in mesh.blocks)


def section(mesh, group):
    return section_of_facets(mesh.points, mesh.facet_groups[group])


@pytest.mark.parametrize("name", BLOCKS)
def test_gmsh_files_give_volumes_regions_and_groups_in_metres(name):
    mesh = read_mesh(FILES / name, "mm")
    assert set(mesh.cell_counts) == {BLOCKS[name]}
    assert cell_problems(mesh) == []
    assert total(mesh) == pytest.approx(2e-6, rel=1e-12)
    for region, side in (("soft", slice(0, 1)), ("stiff", slice(1, 2))):
        (cells,) = mesh.regions[region]
        assert volumes(mesh.points, mesh.blocks[0])[cells].sum() == pytest.approx(1e-6, rel=1e-12)
        middle = mesh.points[mesh.blocks[0].nodes[cells]].mean(axis=1)[:, 0]
        low, high = [(0.0, 0.01), (0.01, 0.02)][side][0]
        assert ((middle > low) & (middle < high)).all()
    for group, x in (("root", 0.0), ("tip", 0.02)):
        assert section(mesh, group).area == pytest.approx(1e-4, rel=1e-12)
        np.testing.assert_allclose(section(mesh, group).centre, [x, 0.005, 0.005], atol=1e-15)
    edge = mesh.node_groups.get("low edge", mesh.node_groups.get("low_edge"))
    np.testing.assert_allclose(mesh.points[edge][:, [0, 2]], [[0.02, 0.0]] * len(edge), atol=1e-15)


def test_a_wedge15_file_is_read():
    mesh = read_mesh(FILES / "wedge15_41.msh", "mm")
    assert mesh.cell_counts == {"wedge15": 8}
    assert cell_problems(mesh) == []
    assert total(mesh) == pytest.approx(2e-6, rel=1e-12)
    assert [kind for kind, _ in mesh.facet_groups["side"].blocks] == ["quad8"]
    assert [kind for kind, _ in mesh.facet_groups["tip"].blocks] == ["tri6"]


@pytest.mark.parametrize("name", [*BLOCKS, "wedge15_41.msh"])
def test_midside_nodes_lie_in_the_middle_of_their_edge(name):
    # A file order taken for VTK's would put them on another edge; these cells are straight.
    mesh = read_mesh(FILES / name, "mm")
    for block in mesh.blocks:
        for face in FACES[block.kind]:
            corners = 3 if len(face) in (3, 6) else 4
            ring = mesh.points[block.nodes[:, face[:corners]]]
            middles = mesh.points[block.nodes[:, face[corners : 2 * corners]]]
            np.testing.assert_allclose((ring + np.roll(ring, -1, axis=1)) / 2, middles, atol=1e-12)
            if len(face) == 9:
                centre = mesh.points[block.nodes[:, face[8]]]
                np.testing.assert_allclose(ring.mean(axis=1), centre, atol=1e-12)


@pytest.mark.parametrize("name", [*BLOCKS, "wedge15_41.msh"])
def test_faces_look_outwards(name):
    mesh = read_mesh(FILES / name, "mm")
    flux = 0.0
    for _, nodes in outer_surface(mesh.blocks).blocks:
        corners = mesh.points[nodes[:, : 3 if nodes.shape[1] in (3, 6) else 4]]
        if corners.shape[1] == 3:
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        else:
            normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
        flux += (normal * corners.mean(axis=1)).sum()
    assert flux / 3 == pytest.approx(2e-6, rel=1e-12)  # Gauss: a third of the flux of x


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1e-3), ("in", 0.0254)])
def test_the_unit_scales_the_mesh(unit, scale):
    mesh = read_mesh(FILES / "hex20_41.msh", unit)
    assert np.ptp(mesh.points, axis=0) == pytest.approx([20 * scale, 10 * scale, 10 * scale])


def bar_file(path, cells=None, **more):
    """A bar of four layers along x as meshio writes it, in mm, with more points than cells use."""
    bar = Bar(1.0, 0.02, 0.02, cells_along=4).mesh()
    points = np.vstack([[[5.0, 5.0, 5.0]], bar.points * 1e3])
    nodes = bar.blocks[0].nodes + 1
    tip = bar.facet_groups["end"].blocks[0].nodes + 1
    default = [("hexahedron20", nodes), ("quad8", tip)]
    meshio.Mesh(points, default if cells is None else cells(nodes, tip), **more).write(path)
    return path


@pytest.mark.parametrize("ending", ["vtu", "vtk"])
def test_integer_arrays_of_vtk_files_are_groups(tmp_path, ending):
    cell_data = {
        "part": [np.repeat([7, 9], 8), np.zeros(4, dtype=int)],
        "tip": [np.zeros(16, dtype=int), np.ones(4, dtype=int)],
        "density": [np.ones(16), np.ones(4)],
    }
    point_data = {"grip": (np.arange(142) < 5).astype(int)}
    path = bar_file(tmp_path / f"a.{ending}", cell_data=cell_data, point_data=point_data)
    mesh = read_mesh(path, "mm")
    assert set(mesh.regions) == {"part_7", "part_9"}
    assert len(mesh.regions["part_9"][0]) == 8
    assert set(mesh.facet_groups) == {"tip", "part_0"}
    assert mesh.node_groups["grip"].tolist() == [0, 1, 2, 3]  # the first point is on no cell
    assert len(mesh.points) == 141


def test_points_that_no_cell_uses_are_left_out(tmp_path):
    mesh = read_mesh(bar_file(tmp_path / "a.vtu"), "mm")
    assert mesh.unknowns == 3 * len(mesh.points)
    assert total(mesh) == pytest.approx(4e-4, rel=1e-12)


def test_a_cell_that_a_file_has_twice_counts_once(tmp_path):
    def cells(nodes, tip):
        return [("hexahedron20", nodes), ("hexahedron20", nodes[8:])]

    part = {"part": [np.repeat([1, 2], 8), np.full(8, 3)]}
    mesh = read_mesh(bar_file(tmp_path / "a.vtu", cells, cell_data=part), "mm")
    assert mesh.cell_counts == {"hex20": 16}
    np.testing.assert_array_equal(mesh.regions["part_2"][0], np.arange(8, 16))
    np.testing.assert_array_equal(mesh.regions["part_3"][0], np.arange(8, 16))


def test_facets_without_midside_nodes_get_those_of_the_cells_they_lie_on(tmp_path):
    def cells(nodes, tip):
        return [("hexahedron20", nodes), ("quad", tip[:, [2, 1, 0, 3]])]

    tip = {"tip": [np.zeros(16, dtype=int), np.ones(4, dtype=int)]}
    mesh = read_mesh(bar_file(tmp_path / "a.vtu", cells, cell_data=tip), "mm")
    ((kind, nodes),) = mesh.facet_groups["tip"].blocks
    assert (kind, nodes.shape) == ("quad8", (4, 8))
    assert section(mesh, "tip").area == pytest.approx(4e-4, rel=1e-12)


MIRRORED = [4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11, 16, 17, 18, 19]


def test_cells_all_numbered_in_a_mirror_are_turned_round(tmp_path):
    def cells(nodes, tip):
        return [("hexahedron20", nodes[:, MIRRORED])]

    mesh = read_mesh(bar_file(tmp_path / "a.vtu", cells), "mm")
    assert cell_problems(mesh) == []
    assert total(mesh) == pytest.approx(4e-4, rel=1e-12)


def test_a_few_cells_inside_out_are_a_problem_with_their_place(tmp_path):
    def cells(nodes, tip):
        nodes = nodes.copy()
        nodes[0] = nodes[0, MIRRORED]
        return [("hexahedron20", nodes)]

    (problem,) = cell_problems(read_mesh(bar_file(tmp_path / "a.vtu", cells), "mm"))
    assert "1 of 16 hex20 cells" in problem.message
    assert "near (0.125, -0.005, -0.005) m" in problem.message


def refusal(path):
    with pytest.raises(BundleError) as caught:
        read_mesh(path, "mm")
    (problem,) = caught.value.problems
    assert problem.where == "mesh.file"
    return problem.message


def test_a_file_that_meshio_cannot_read_is_a_mistake_and_prints_nothing(tmp_path, capsys):
    (tmp_path / "a.msh").write_text("$MeshFormat\n4.1 0 8\n")
    assert "cannot be read as .msh" in refusal(tmp_path / "a.msh")
    (tmp_path / "c.vtu").write_text("hello")
    assert "cannot be read as .vtu" in refusal(tmp_path / "c.vtu")
    (tmp_path / "b.xyz").write_text("hello")
    assert 'has the ending ".xyz", which no mesh format has; export' in refusal(tmp_path / "b.xyz")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("ending", ["bdf", "nas", "fem", "cdb"])
def test_a_deck_of_nastran_or_ansys_is_no_mesh_file(tmp_path, ending):
    """meshio read the coordinates of its nodes as Cartesian ones, whatever their system."""
    path = tmp_path / f"a.{ending}"
    path.write_text(
        "CORD2C,8,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nGRID,1,8,1.,0.,0.\nGRID,2,8,1.,90.,0.\n"
        "GRID,3,8,0.,0.,0.\nGRID,4,8,0.,0.,1.\nCTETRA,1,1,3,1,2,4\nENDDATA\n"
    )
    assert "`wrenchbook new DECK`" in refusal(path)


def test_groups_of_a_med_file_have_their_names(tmp_path):
    """Groups were the numbers of families, such as cell_tags_-2, without the names of the file."""
    bar = Bar(1.0, 0.02, 0.02, cells_along=4).mesh()
    ends = [bar.facet_groups[name].blocks[0].nodes for name in ("start", "end")]
    cells = {"hexahedron20": bar.blocks[0].nodes, "quad8": np.vstack(ends)}
    of_faces = np.repeat([-7, -8], [len(nodes) for nodes in ends])
    of_cells = np.full(len(bar.blocks[0].nodes), -9)
    middle = np.isclose(bar.points[:, 0], 0.5)
    file = meshio.Mesh(
        bar.points * 1e3,
        cells,
        cell_data={"cell_tags": [of_cells, of_faces]},
        point_data={"point_tags": np.where(middle, 3, 0)},
    )
    families = {"cell_tags": {-7: ["root", "ends"], -8: ["tip", "ends"], -9: ["body"]}}
    vars(file).update(families, point_tags={3: ["ring"]})
    file.write(tmp_path / "a.med")
    mesh = read_mesh(tmp_path / "a.med", "mm")
    assert set(mesh.facet_groups) == {"root", "tip", "ends"}
    assert set(mesh.regions) == {"body"}
    assert section(mesh, "tip").centre == pytest.approx([1.0, 0.0, 0.0])
    assert section(mesh, "ends").centre == pytest.approx([0.5, 0.0, 0.0])
    assert mesh.points[mesh.node_groups["ring"]][:, 0] == pytest.approx(0.5)
    assert set(mesh.node_groups) == {"ring"}


def test_a_file_of_points_alone_is_refused(tmp_path):
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(BundleError, match="has no solid cells"):
        read_mesh(tmp_path / "points.obj", "m")


def test_a_group_of_facets_off_the_solid_is_named(tmp_path):
    def cells(nodes, tip):
        return [("hexahedron20", nodes), ("quad", np.array([[0, 1, 2, 3]]))]

    loose = {"loose": [np.zeros(16, dtype=int), np.ones(1, dtype=int)]}
    message = refusal(bar_file(tmp_path / "a.vtu", cells, cell_data=loose))
    assert 'facets in the group "loose" that are not faces of a solid cell (1 of them)' in message


@pytest.mark.parametrize("wrong", [-1, 4, 2**40])
def test_a_cell_with_a_point_that_there_is_not_is_refused_and_not_given_another(tmp_path, wrong):
    points = np.vstack([np.zeros(3), np.eye(3)])
    cells = np.array([[0, 1, 2, wrong]])
    meshio.Mesh(points, [("tetra", cells)]).write(tmp_path / "a.vtk")
    with pytest.raises(
        BundleError, match=f"tet4 cells on point {wrong}, but its points are 0 to 3"
    ):
        read_mesh(tmp_path / "a.vtk", "m")


DECK = (GOOD / "two_cubes" / "cubes.inp").read_text("utf-8")


def read(tmp_path, text=DECK):
    path = tmp_path / "deck.inp"
    path.write_text(text)
    return read_mesh(path, "m")


def test_all_node_blocks_and_elements_over_several_lines_are_read(tmp_path):
    mesh = read(tmp_path)
    assert len(mesh.points) == 12
    assert mesh.cell_counts == {"hex8": 2}
    np.testing.assert_allclose(volumes(mesh.points, mesh.blocks[0]), [1.0, 1.0], rtol=1e-12)


def test_a_set_of_several_ranges_is_refused_before_the_range_that_makes_it_too_long_is_listed(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(abaqus, "_MAX_MEMBERS", 100)
    with pytest.raises(BundleError, match="has 120 members; name at most 100"):
        read(tmp_path, f"{DECK}*NSET, NSET=LONG, GENERATE\n1, 60\n1, 60\n")


@pytest.mark.parametrize(
    ("name", "row"),
    [("B31", "91, 1, 2"), ("B33", "91, 1, 2"), ("B32", "91, 1, 2, 3"), ("B32R", "91, 1, 2, 3")],
)
def test_beams_in_a_deck_of_solids_are_no_cells(tmp_path, name, row):
    mesh = read(tmp_path, f"{DECK}*ELEMENT, TYPE={name}\n{row}\n")
    assert mesh.cell_counts == {"hex8": 2}


def test_element_sets_have_the_cells_the_deck_gives_them(tmp_path):
    regions = {name: cells.tolist() for name, (cells,) in read(tmp_path).regions.items()}
    assert regions == {"Left": [0], "RIGHT": [1], "both": [0, 1], "range": [0, 1]}


def test_node_sets_may_be_listed_generated_named_or_made_of_elements(tmp_path):
    mesh = read(tmp_path)
    groups = mesh.node_groups
    assert set(groups) == {"Nall", "Grip", "more", "tail", "corner"}  # REF is on no cell
    assert (mesh.points[groups["Grip"]][:, 0] == 0.0).all()
    assert len(groups["Grip"]) == 4
    assert len(groups["more"]) == len(groups["corner"]) == 5
    assert (mesh.points[groups["tail"]][:, 0] >= 1.0).all()
    assert len(groups["tail"]) == 8


@pytest.mark.parametrize(
    ("name", "area", "centre"), [("Tip", 1.0, [2.0, 0.5, 0.5]), ("top", 2.0, [1.0, 0.5, 1.0])]
)
def test_surfaces_are_facet_groups(tmp_path, name, area, centre):
    mesh = read(tmp_path)
    section = section_of_facets(mesh.points, mesh.facet_groups[name])
    assert section.area == pytest.approx(area, rel=1e-12)
    np.testing.assert_allclose(section.centre, centre, atol=1e-12)


def test_a_surface_of_elements_without_faces_has_their_free_faces(tmp_path):
    mesh = read(tmp_path, DECK.replace(" Right, S4", " Right,"))
    ((kind, nodes),) = mesh.facet_groups["Tip"].blocks
    assert (kind, len(nodes)) == ("quad4", 5)
    assert (mesh.points[nodes][:, :, 0] > 1.0).any(axis=1).all()


def test_a_surface_of_shells_that_nothing_names_is_left_out_with_a_note(tmp_path):
    mesh = read(tmp_path, DECK.replace(" 7, S2", " 50, SPOS"))
    assert set(mesh.facet_groups) == {"Tip"}
    (note,) = [note for note in mesh.deck.notes if "SURFACE" in note]
    assert note.startswith("line 42: *SURFACE has faces of shells or beams (50, SPOS), so it is")


def test_a_face_that_a_tetrahedron_has_not_is_refused(tmp_path):
    with pytest.raises(BundleError, match="face S5 of element 1, a tet4, which has faces S1 to S4"):
        read(tmp_path, f"{cell_deck('C3D4', '000 100 010 001')}*SURFACE, NAME=F\n1, S5\n")


def cell_deck(kind, points):
    """Return the deck of one cell, by the places of its corners."""
    nodes = [f"{i},{','.join(point)}" for i, point in enumerate(points.split(), 1)]
    numbers = ",".join(str(i) for i in range(1, len(nodes) + 1))
    return "\n".join(["*NODE", *nodes, f"*ELEMENT,TYPE={kind}", f"1,{numbers}", ""])


TET = cell_deck("C3D4", "000 100 010 001")
WEDGE = cell_deck("C3D6", "000 100 010 001 101 011")
HEX = cell_deck("C3D8", "000 100 110 010 001 101 111 011")
OF_FACES = [
    (TET, [(0, 0, -0.5), (0, -0.5, 0), (0.5, 0.5, 0.5), (-0.5, 0, 0)]),
    (WEDGE, [(0, 0, -0.5), (0, 0, 0.5), (0, -1, 0), (1, 1, 0), (-1, 0, 0)]),
    (HEX, [(0, 0, -1), (0, 0, 1), (0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0)]),
]


@pytest.mark.parametrize(("cell", "areas"), OF_FACES, ids=["tet", "wedge", "hex"])
def test_faces_are_numbered_as_the_manuals_of_both_solvers_number_them(tmp_path, cell, areas):
    for number, expected in enumerate(areas, start=1):
        mesh = read(tmp_path, f"{cell}*SURFACE, NAME=F\n1, S{number}\n")
        ((_, nodes),) = mesh.facet_groups["F"].blocks
        corners = mesh.points[nodes[0]]
        last = corners[-1]
        sides = np.diff(corners - last, axis=0)
        normal = np.cross(corners[:-1] - last, sides, axis=1).sum(axis=0) / 2
        np.testing.assert_allclose(np.abs(normal), np.abs(expected), atol=1e-12)
        inside = mesh.points.mean(axis=0)
        np.testing.assert_allclose(
            np.sign((corners.mean(axis=0) - inside) @ expected), 1.0, atol=1e-12
        )


# One cube, whose assembly has a reference point that is node 1 of its own, as Abaqus/CAE writes it.
PART = Path(__file__).with_name("cube_part.inp").read_text("utf-8")
ASSEMBLED = PART + Path(__file__).with_name("cube_assembly.inp").read_text("utf-8")
TWICE = ASSEMBLED.replace("{at}", "0, 0, 9").replace(
    "*End Instance\n",
    "*End Instance\n*Instance, name=Cube-2, part=Cube\n1., 0., 0.\n"
    "2., 0., 0., 2., 0., 1., 90.\n*End Instance\n",
    1,
)


@pytest.mark.parametrize("at", ["0., 0., 1.5", "500., 0., 900."])
def test_a_node_of_the_assembly_is_not_the_node_of_that_number_of_a_part(tmp_path, at):
    mesh = read(tmp_path, ASSEMBLED.replace("{at}", at))
    np.testing.assert_allclose(volumes(mesh.points, mesh.blocks[0]), [1.0], rtol=1e-12)
    assert sorted(mesh.node_groups) == ["Both", "Foot", "Head"]
    assert (mesh.points[mesh.node_groups["Head"]][:, 2] == 1.0).all()
    assert len(mesh.node_groups["Both"]) == 5
    section = section_of_facets(mesh.points, mesh.facet_groups["Top"])
    np.testing.assert_allclose(section.centre, [0.5, 0.5, 1.0], atol=1e-12)


def test_each_instance_of_a_part_has_its_own_nodes_where_it_is_moved_and_turned_to(tmp_path):
    mesh = read(tmp_path, TWICE)
    assert len(mesh.points) == 16
    np.testing.assert_allclose(volumes(mesh.points, mesh.blocks[0]), [1.0, 1.0], rtol=1e-12)
    foot = mesh.points[mesh.node_groups["Cube-2.Foot"]]
    np.testing.assert_allclose(foot.mean(axis=0), [1.5, -0.5, 0.0], atol=1e-12)


def test_sets_of_two_instances_of_one_name_are_told_apart_by_the_instance(tmp_path):
    mesh = read(tmp_path, TWICE)
    assert sorted(mesh.node_groups) == ["Both", "Cube-1.Foot", "Cube-2.Foot", "Head"]
    assert sorted(mesh.regions) == ["Cube-1.All", "Cube-2.All", "_Top"]


def test_a_node_given_twice_in_one_place_is_one_node(tmp_path):
    assert len(read(tmp_path, DECK + "*NODE\n5, 0., 0., 1.\n").points) == 12


def test_a_part_without_instances_is_read_as_a_flat_deck(tmp_path):
    assert len(read(tmp_path, PART).points) == 8


def test_a_mesh_file_without_points_is_refused(tmp_path):
    (tmp_path / "part.obj").write_text("# nothing\n")
    with pytest.raises(BundleError, match="no solid cells"):
        read_mesh(tmp_path / "part.obj", "mm")
