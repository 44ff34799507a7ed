"""What straight edges across round surfaces change, against tubes whose edges are round."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from tests.fea.boxes import box
from wrenchbook.fea.accuracy.estimate import accuracy_of
from wrenchbook.fea.accuracy.mesh_error import bows_of, roundness
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.facets import EDGES
from wrenchbook.fea.solve import Solver

LENGTH, RADIUS = 4.0, 1.0

BUNDLE = """name = "tube"
title = "A tube"
[mesh]
file = "tube.msh"
unit = "m"
order = 2
[[material]]
region = "all"
youngs_modulus = 70e9
poisson_ratio = 0.33
[supports]
fixed = ["base"]
[interface]
section = "tip"
coupling = "rigid"
[analysis]
nonlinear = true
[range]
force = [200, 200, 200]
moment = [5, 5, 5]
"""


def tube(folder, cells, wall, layers=1, along=8):
    """Write the first-order mesh of a tube and its bundle; return the bundle."""
    angles = np.arange(cells) * 2 * np.pi / cells
    radii = np.linspace(RADIUS - wall, RADIUS, layers + 1)
    heights = np.linspace(0, LENGTH, along + 1)
    points = [(r * np.cos(a), r * np.sin(a), z) for z in heights for r in radii for a in angles]

    def node(k, i, j):
        return (k * (layers + 1) + i) * cells + j % cells

    sides = ((0, 0), (1, 0), (1, 1), (0, 1))
    hexahedra = [
        [node(k + up, i + out, j + on) for up in (0, 1) for out, on in sides]
        for k in range(along)
        for i in range(layers)
        for j in range(cells)
    ]
    ends = [
        [
            [node(k, i + out, j + on) for out, on in sides]
            for i in range(layers)
            for j in range(cells)
        ]
        for k in (0, along)
    ]
    quads = np.concatenate(ends)
    tags = [np.ones(len(hexahedra), int), np.repeat([2, 3], len(ends[0]))]
    mesh = meshio.Mesh(
        np.array(points),
        [("hexahedron", np.array(hexahedra)), ("quad", np.array(quads))],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"all": np.array([1, 3]), "base": np.array([2, 2]), "tip": np.array([3, 2])},
    )
    meshio.write(folder / "tube.msh", mesh, file_format="gmsh22", binary=False)
    (folder / "component.toml").write_text(BUNDLE)
    return read_bundle(folder)


def rounded(solver):
    """The same component with its midside nodes on the cylinders."""
    mesh = solver.component.mesh
    points = mesh.points.copy()
    for block in mesh.blocks:
        for edge, ends in enumerate(EDGES[block.kind]):
            middle = block.nodes[:, 8 + edge]
            size = np.linalg.norm(mesh.points[block.nodes[:, ends], :2], axis=2).mean(axis=1)
            flat = mesh.points[middle, :2]
            points[middle, :2] = flat * (size / np.linalg.norm(flat, axis=1))[:, None]
    return Solver(replace(solver.component, mesh=replace(mesh, points=points)))


@pytest.mark.parametrize("wall", [0.05, 0.3])
@pytest.mark.parametrize("cells", [12, 16, 32])
def test_the_change_is_that_of_a_tube_with_round_edges(tmp_path, cells, wall):
    solver = Solver(tube(tmp_path, cells, wall))
    found = np.diag(roundness(solver).change)
    truth = np.diag(solver.linear.compliance - rounded(solver).linear.compliance)
    np.testing.assert_allclose(found, truth, rtol=0.05)


def test_cells_that_it_would_turn_inside_out_are_bent_less(tmp_path):
    solver = Solver(tube(tmp_path, 12, 0.04, layers=3))
    found = np.diag(roundness(solver).change)
    one = Solver(tube(tmp_path, 12, 0.04))
    truth = np.diag(one.linear.compliance - rounded(one).linear.compliance)
    np.testing.assert_allclose(found, truth, rtol=0.25)


@pytest.mark.parametrize("cells", [12, 16, 24])
def test_the_bar_of_the_mesh_holds_the_error_of_a_polygon_for_a_tube(tmp_path, cells):
    own = Solver(tube(tmp_path, cells, 0.05))
    bars = np.diag(accuracy_of(own)["mesh"])
    truth = np.diag(rounded(Solver(tube(tmp_path, 48, 0.05, along=16))).linear.compliance)
    errors = np.abs(np.diag(own.linear.compliance) - truth)
    assert (errors <= bars).all()
    assert (bars <= 3 * errors).all()


def test_the_check_warns_of_straight_edges_and_prints_their_own_part_of_the_bar(tmp_path):
    tube(tmp_path, 16, 0.05)
    report = check(tmp_path)
    (words,) = (one["message"] for one in report["warnings"])
    assert "turn by up to 22.5 degrees a cell, change it by 5 %" in words
    assert "with 36 cells round it is 1 %" in words
    found = report["solver_error"]
    np.testing.assert_array_less(found["rounded"]["mesh"], np.array(found["mesh"]) + 1e-300)
    assert "of that by straight edges: (3e-08, 3e-08, 1e-09) m" in as_text(report)
    tube(tmp_path, 64, 0.05)
    assert check(tmp_path)["warnings"] == []


def test_midside_nodes_on_the_geometry_have_no_such_error(tmp_path):
    assert not bows_of(rounded(Solver(tube(tmp_path, 16, 0.05))).component.mesh)[0].any()


@pytest.mark.parametrize("kind", ["hex8", "tet4", "wedge6"])
def test_a_box_has_none(kind):
    assert not bows_of(second_order(box(kind, (2, 2, 2), (1.0, 1.0, 1.0))))[0].any()
