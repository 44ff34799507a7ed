"""Cells that fold over at a node only: their quadrature points see nothing, their answers are off.

One of 40 with two corners swapped is 5 % off in u_z, all of them 31 %.
"""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.check.test_check_bundles import messages, write_inp
from tests.fea.components import component
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import report
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mapping import cell_problems, determinants
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.solve import Solver, solve
from wrenchbook.fea.spec.problems import BundleError

FOLDED = "turned inside out or flat"


def with_swapped_corners(mesh, count):
    """Swap the first two corners of the first `count` cells."""
    nodes = mesh.blocks[0].nodes.copy()
    nodes[:count, [0, 1]] = nodes[:count, [1, 0]]
    block = CellBlock(mesh.blocks[0].kind, nodes)
    return Mesh(mesh.points, (block,), mesh.regions, mesh.facet_groups, mesh.node_groups)


def bar():
    return box("hex20", (10, 2, 2), (1.0, 0.1, 0.1))


@pytest.mark.parametrize("count", [1, 40])
def test_swapped_corners_that_no_quadrature_point_sees_are_an_error_of_the_check(tmp_path, count):
    mesh = with_swapped_corners(bar(), count)
    assert (determinants(mesh.points, mesh.blocks[0]) > 0).all()
    told = report(write_inp(tmp_path, mesh))
    assert not told["ok"]
    assert any(f"{count} of 40 hex20 cells are {FOLDED}" in m for m in messages(told, "problems"))


def test_a_bundle_with_a_folded_cell_is_neither_built_nor_solved(tmp_path):
    bundle = read_bundle(write_inp(tmp_path, with_swapped_corners(bar(), 1)))
    for refuse in (build, lambda bundle: solve(bundle, [0, 0, 1, 0, 0, 0])):
        with pytest.raises(BundleError, match=FOLDED):
            refuse(bundle)


def test_a_component_made_without_a_bundle_is_not_solved_with_a_folded_cell():
    part = component(with_swapped_corners(bar(), 1), fixed="x0", section="x1")
    with pytest.raises(SolveFailed, match=FOLDED) as caught:
        Solver(part)
    assert caught.value.kind == "inverted_elements"


def test_a_cell_flat_but_for_roundoff_at_a_node_is_folded():
    mesh = box("hex20", (1, 1, 1))
    points = mesh.points.copy()
    nodes = mesh.blocks[0].nodes[0]
    points[nodes[8]] = 0.75 * points[nodes[0]] + 0.25 * points[nodes[1]]  # a quarter point
    points[nodes[8], 0] += 1e-15
    (problem,) = cell_problems(Mesh(points, mesh.blocks, {}, {}, {}))
    assert FOLDED in problem.message


@pytest.mark.exact("of cells that are alike, the worst is named: check and solve see the same bits")
@pytest.mark.parametrize("nonlinear", [False, True])
def test_what_the_check_warns_of_stands_in_the_notes_of_every_solution(tmp_path, nonlinear):
    folder = write_inp(tmp_path, box("hex20", (2, 2, 2), (1.0, 0.005, 0.005)), young="2e12")
    text = (folder / "component.toml").read_text()
    text = text.replace("nonlinear = false", f"nonlinear = {str(nonlinear).lower()}")
    (folder / "component.toml").write_text(text)
    warned = [f"{entry['where']}: {entry['message']}" for entry in report(folder)["warnings"]]
    assert any("long and thin" in words for words in warned)
    solution = solve(read_bundle(folder), np.array([0, 0, 1e-9, 0, 0, 0]))
    assert list(solution.notes[: len(warned)]) == warned
