"""Pyramids between hexahedra and tetrahedra: their readers, answers and refusals."""

import meshio
import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.cae import cards
from tests.fea.pyramids import mixed
from tests.fea.written_deck import deck_lines
from wrenchbook.fea.accuracy.convergence import studied
from wrenchbook.fea.bundle.read import BundleError, bundle_of
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.component import build
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.inspection import scaled_jacobian
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mapping import cell_problems, volumes
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.solve import Solver

LENGTHS, DIVISIONS = (0.12, 0.02, 0.02), (12, 2, 2)
NAMES = {"hex20": "hexahedron20", "pyramid13": "pyramid13", "tet10": "tetra10"}
NAMES |= {"hex8": "hexahedron", "pyramid5": "pyramid", "tet4": "tetra"}


def volume(mesh):
    return sum(volumes(mesh.points, block).sum() for block in mesh.blocks)


def bundle(folder, mesh):
    """Write a bar of a mesh as a deck, held at x0 and loaded at x1; return its bundle."""
    (folder / "bar.inp").write_text("\n".join(deck_lines(mesh, 1e-3)))
    table = {
        "name": "bar",
        "title": "Bar",
        "mesh": {"file": "bar.inp", "unit": "mm", "order": 2},
        "material": [{"region": "all", "youngs_modulus": 70e9, "poisson_ratio": 0.3}],
        "supports": {"fixed": ["x0"]},
        "interface": {"section": "x1", "coupling": "rigid", "point": [0.12, 0.01, 0.01]},
        "analysis": {"nonlinear": False},
        "range": {"force": [50, 50, 50], "moment": [1, 1, 1]},
    }
    return bundle_of(table, folder)


@pytest.mark.parametrize("name", ["a.vtu", "a.msh", "a.inp"])
@pytest.mark.parametrize("order", [1, 2])
def test_a_file_with_pyramids_is_read_and_those_of_first_order_get_midside_nodes(
    tmp_path, name, order
):
    mesh = mixed(DIVISIONS, LENGTHS, order=order)
    if name == "a.inp":
        (tmp_path / name).write_text("\n".join(deck_lines(mesh, 1e-3)))
    else:
        meshio._mesh.topological_dimension["pyramid13"] = 3
        cells = [(NAMES[block.kind], block.nodes) for block in mesh.blocks]
        kind = "gmsh22" if name == "a.msh" else None
        meshio.Mesh(mesh.points * 1e3, cells).write(tmp_path / name, file_format=kind)
    found = second_order(read_mesh(tmp_path / name, "mm"))
    assert found.cell_counts == second_order(mesh).cell_counts
    assert cell_problems(found) == []
    assert volume(found) == pytest.approx(np.prod(LENGTHS), rel=1e-12)


def test_a_bar_with_pyramids_bends_and_twists_as_one_of_hexahedra(tmp_path):
    (tmp_path / "hex").mkdir()
    expected = Solver(build(bundle(tmp_path / "hex", box("hex20", DIVISIONS, LENGTHS))))
    found = Solver(build(bundle(tmp_path, mixed(DIVISIONS, LENGTHS))))
    ratios = np.diag(found.linear.compliance) / np.diag(expected.linear.compliance)
    np.testing.assert_allclose(ratios, 1.0, rtol=1e-2)


def single(mirror=False):
    """Return one pyramid, straight above its base of 20 x 20 mm, 60 mm high, and its nodes."""
    points = node_coordinates("pyramid13")
    points = (points + 0.5 * points[:, 2:] * [1, 1, 0]) * [20.0, 20.0, 60.0 - 120.0 * mirror]
    return Mesh(points, (CellBlock("pyramid13", np.arange(13)[None]),))


@pytest.mark.parametrize("name", ["a.bdf", "a.cdb"])
def test_pyramids_of_nastran_and_collapsed_hexahedra_of_ansys_keep_their_nodes(tmp_path, name):
    mesh = single()
    lines = ["BEGIN BULK", "PSOLID,1,1", "MAT1,1,7.+4,,.3"]
    for i, point in enumerate(mesh.points.tolist(), 1):
        lines += cards.card("GRID", i, "", *point)
    lines += [*cards.card("CPYRAM", 1, 1, *range(1, 14)), "ENDDATA", ""]
    collapsed = [0, 1, 2, 3, 4, 4, 4, 4, 5, 6, 7, 8, 4, 4, 4, 4, 9, 10, 11, 12]
    text = "\n".join(lines) if name == "a.bdf" else cards.archive(mesh, "", collapsed)
    (tmp_path / name).write_text(text)
    propose(tmp_path / name, tmp_path / "new", "mm")
    found = read_mesh(tmp_path / "new" / "a.inp", "mm")
    assert (found.cell_counts, cell_problems(found)) == ({"pyramid13": 1}, [])
    np.testing.assert_allclose(found.points[found.blocks[0].nodes[0]], mesh.points / 1e3)
    assert scaled_jacobian(found.points, found.blocks[0])[0] > 0.1


def test_pyramids_numbered_as_in_a_mirror_are_turned(tmp_path):
    mesh = single(mirror=True)
    (tmp_path / "a.inp").write_text("\n".join(deck_lines(mesh, 1.0)))
    found = read_mesh(tmp_path / "a.inp", "mm")
    assert (volume(found), cell_problems(found)) == (pytest.approx(8e-6, rel=1e-12), [])


def test_what_cannot_be_done_with_pyramids_is_refused_by_name(tmp_path):
    own = bundle(tmp_path, mixed(DIVISIONS, LENGTHS))
    with pytest.raises(BundleError, match="CalculiX has no element for pyramid13"):
        deck_of(build(own))
    with pytest.raises(BundleError, match="pyramids are not halved; give finer meshes"):
        studied(own)
