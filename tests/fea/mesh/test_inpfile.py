"""Abaqus and CalculiX decks: what meshio gets wrong, and what is refused."""

import numpy as np
import pytest

from tests.refusals import GOOD
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mapping import volumes

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


TET = """*NODE
1,0,0,0
2,1,0,0
3,0,1,0
4,0,0,1
*ELEMENT,TYPE=C3D4
1,1,2,3,4
"""
WEDGE = """*NODE
1,0,0,0
2,1,0,0
3,0,1,0
4,0,0,1
5,1,0,1
6,0,1,1
*ELEMENT,TYPE=C3D6
1,1,2,3,4,5,6
"""
HEX = DECK[DECK.index("*Node") : DECK.index("*NODE\n")] + "*ELEMENT,TYPE=C3D8\n1,1,2,3,4,5,6,7,8\n"
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
PART = """*Part, name=Cube
*Node
{nodes}
*Element, type=C3D8
1, 1, 2, 3, 4, 5, 6, 7, 8
*Nset, nset=Foot
1, 2, 3, 4
*Elset, elset=All
1
*Solid Section, elset=All, material=Steel
*End Part
""".format(nodes=DECK[DECK.index(" 1, 0.") : DECK.index("\n*NODE\n 11")])
ASSEMBLED = (
    PART
    + """*Assembly, name=Assembly
*Instance, name=Cube-1, part=Cube
*End Instance
*Node
1, {at}
*Nset, nset=Ref
1
*Nset, nset=Head, instance=Cube-1
5, 6, 7, 8
*Nset, nset=Both
Cube-1.Foot, Cube-1.5
*Elset, elset=_Top, internal, instance=Cube-1
1
*Surface, type=ELEMENT, name=Top
_Top, S2
*End Assembly
"""
)
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
