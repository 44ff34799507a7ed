"""Pyramids between hexahedra and tetrahedra: their readers, answers and refusals."""

import meshio
import numpy as np
import pytest

from tests.fea.boxes import box, volumes
from tests.fea.cae import cards
from tests.fea.components import component
from tests.fea.pyramids import mixed
from tests.fea.written_deck import deck_lines
from wrenchbook.fea.bundle.read import BundleError
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.io.read import MESHIO_KINDS, read_mesh
from wrenchbook.fea.mesh.mapping import cell_problems
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.mesh.refine import halved
from wrenchbook.fea.solve import Solver

DIVISIONS, LENGTHS = (12, 2, 2), (0.12, 0.02, 0.02)
NAMES = {kind: name for name, kind in MESHIO_KINDS.items()}


def volume(mesh):
    return sum(volumes(mesh.points, block).sum() for block in mesh.blocks)


@pytest.mark.parametrize("name", ["a.vtu", "a.msh", "a.inp"])
@pytest.mark.parametrize("order", [1, 2])
def test_files_with_pyramids_are_read_and_first_order_gets_midside_nodes(tmp_path, name, order):
    mesh = mixed(DIVISIONS, LENGTHS, order=order)
    cells = [(NAMES[block.kind], block.nodes) for block in mesh.blocks]
    (tmp_path / "a.inp").write_text("\n".join(deck_lines(mesh, 1e-3)))
    for file, kind in (("a.vtu", "vtu"), ("a.msh", "gmsh22")):
        meshio.Mesh(mesh.points * 1e3, cells).write(tmp_path / file, file_format=kind)
    result = second_order(read_mesh(tmp_path / name, "mm"))
    assert (result.cell_counts, cell_problems(result)) == (second_order(mesh).cell_counts, [])
    assert volume(result) == pytest.approx(np.prod(LENGTHS), rel=1e-12)


def test_a_bar_with_pyramids_bends_and_twists_as_one_of_hexahedra():
    bars = mixed(DIVISIONS, LENGTHS), box("hex20", DIVISIONS, LENGTHS)
    parts = (component(bar, fixed="x0", section="x1") for bar in bars)
    result, expected = (np.diag(Solver(part).linear.compliance) for part in parts)
    np.testing.assert_allclose(result, expected, rtol=1e-2)


def single(height=60.0):
    """Return one pyramid, straight above its base of 20 x 20 mm."""
    points = node_coordinates("pyramid13")
    points = (points + 0.5 * points[:, 2:] * [1, 1, 0]) * [20.0, 20.0, height]
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
    result = read_mesh(tmp_path / "new" / "a.inp", "mm")
    assert (result.cell_counts, cell_problems(result)) == ({"pyramid13": 1}, [])
    np.testing.assert_allclose(result.points[result.blocks[0].nodes[0]], mesh.points / 1e3)


def test_pyramids_numbered_as_in_a_mirror_are_turned(tmp_path):
    (tmp_path / "a.inp").write_text("\n".join(deck_lines(single(-60.0), 1.0)))
    result = read_mesh(tmp_path / "a.inp", "mm")
    assert (volume(result), cell_problems(result)) == (pytest.approx(8e-6, rel=1e-12), [])


def test_an_export_and_a_finer_mesh_refuse_pyramids_by_name():
    mesh = mixed()
    with pytest.raises(BundleError, match="CalculiX has no element for pyramid13"):
        deck_of(component(mesh, fixed="x0", section="x1"))
    with pytest.raises(BundleError, match="pyramids cannot be halved; give finer meshes"):
        halved(mesh)
