"""What straight edges across round surfaces change, against tubes whose edges are round."""

import json
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from tests.fea.boxes import box
from tests.slow import slow_but
from wrenchbook.fea.accuracy import convergence, estimate
from wrenchbook.fea.accuracy.advice import over_tolerance
from wrenchbook.fea.accuracy.convergence import Study, convergence_study, finer, stored, write
from wrenchbook.fea.accuracy.estimate import accuracy_of, accuracy_or_why
from wrenchbook.fea.accuracy.roundness import bows_of, polygons_of, roundness
from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.facets import EDGES
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.solve import Solver

LENGTH, RADIUS = 4.0, 1.0

BUNDLE = Path(__file__).with_name("tube.toml").read_text("utf-8")


# Six tetrahedra of a hexahedron, by paths from its first corner to the opposite one (Kuhn), and two
# wedges whose triangles lie across the tube's surfaces. Corners are numbered as in `tube`.
TETRAHEDRA = [[0, 1, 2, 6], [0, 1, 5, 6], [0, 3, 2, 6], [0, 3, 7, 6], [0, 4, 5, 6], [0, 4, 7, 6]]
WEDGES = [[0, 4, 7, 1, 5, 6], [0, 7, 3, 1, 6, 2]]


def split(points, cells, pattern):
    """Cut hexahedra, and turn around those parts whose volume would be negative."""
    parts = cells[:, np.array(pattern)].reshape(-1, len(pattern[0]))
    corners = points[parts]
    legs = corners[:, [1, 2, 3]] - corners[:, :1]
    inverted = np.linalg.det(legs) < 0
    if len(pattern[0]) == 4:
        parts[inverted] = parts[inverted][:, [0, 2, 1, 3]]
    else:
        parts[inverted] = parts[inverted][:, [3, 4, 5, 0, 1, 2]]
    return parts


def tube(folder, cells, wall, layers=1, along=8, kind="hexahedron"):
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
    points, solids, faces = np.array(points), np.array(hexahedra), np.concatenate(ends)
    shape = "quad"
    if kind == "tetra":
        solids, shape = split(points, solids, TETRAHEDRA), "triangle"
        faces = faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    elif kind == "wedge":
        solids = split(points, solids, WEDGES)
    tags = [np.ones(len(solids), int), np.repeat([2, 3], len(faces) // 2)]
    mesh = meshio.Mesh(
        points,
        [(kind, solids), (shape, faces)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"all": np.array([1, 3]), "base": np.array([2, 2]), "tip": np.array([3, 2])},
    )
    meshio.write(folder / "tube.msh", mesh, file_format="gmsh22", binary=False)
    (folder / "component.toml").write_text(BUNDLE)
    return read_bundle(folder)


def rounded(solver):
    """The same component with the midside nodes of its edges on the cylinders there."""
    mesh = solver.component.mesh
    points = mesh.points.copy()
    for block in mesh.blocks:
        corners = 1 + max(max(ends) for ends in EDGES[block.kind])
        for edge, ends in enumerate(EDGES[block.kind]):
            middle = block.nodes[:, corners + edge]
            sizes = np.linalg.norm(mesh.points[block.nodes[:, ends], :2], axis=2)
            across = np.ptp(sizes, axis=1) > 1e-9  # a diagonal of a wall's tetrahedron
            middle, size = middle[~across], sizes[~across].mean(axis=1)
            flat = mesh.points[middle, :2]
            points[middle, :2] = flat * (size / np.linalg.norm(flat, axis=1))[:, None]
    return Solver(replace(solver.component, mesh=replace(mesh, points=points)))


OF_HEXAHEDRA = [("hexahedron", cells, wall) for cells in (12, 16, 32) for wall in (0.05, 0.3)]
OF_OTHERS = [("tetra", 24, 0.1), ("tetra", 16, 0.3), ("wedge", 16, 0.05), ("wedge", 16, 0.3)]


QUICK = {("hexahedron", 12, 0.05), ("tetra", 24, 0.1), ("wedge", 16, 0.3)}


@pytest.mark.parametrize(("kind", "cells", "wall"), slow_but(QUICK, OF_HEXAHEDRA + OF_OTHERS))
def test_the_change_is_that_of_a_tube_with_round_edges(tmp_path, kind, cells, wall):
    solver = Solver(tube(tmp_path, cells, wall, kind=kind))
    result = np.diag(roundness(solver).change)
    truth = np.diag(solver.linear.compliance - rounded(solver).linear.compliance)
    np.testing.assert_allclose(result, truth, rtol=0.05)


@pytest.mark.parametrize("kind", ["hexahedron", "wedge", "tetra"])
def test_cells_that_it_would_turn_inside_out_are_bent_less(tmp_path, kind):
    solver = Solver(tube(tmp_path, 12, 0.04, layers=3, kind=kind))
    result = np.diag(roundness(solver).change)
    one = Solver(tube(tmp_path, 12, 0.04))
    truth = np.diag(one.linear.compliance - rounded(one).linear.compliance)
    np.testing.assert_allclose(result, truth, rtol=0.25)


@pytest.fixture(scope="module")
def round_tube(tmp_path_factory):
    """The compliance of a round tube, by a fine mesh."""
    fine = tube(tmp_path_factory.mktemp("fine"), 48, 0.05, along=16)
    return rounded(Solver(fine)).linear.compliance


@pytest.mark.parametrize("cells", slow_but({12}, [9, 12, 16, 24]))
def test_the_bar_of_the_mesh_holds_the_error_of_a_polygon_for_a_tube(tmp_path, round_tube, cells):
    own = Solver(tube(tmp_path, cells, 0.05))
    bars = np.diag(accuracy_of(own)["mesh"])
    errors = np.abs(np.diag(own.linear.compliance) - np.diag(round_tube))
    assert (errors <= bars).all()
    assert (bars <= 3 * errors).all()


def test_the_check_warns_of_straight_edges_and_prints_their_own_part_of_the_bar(tmp_path):
    tube(tmp_path, 16, 0.05)
    report = check(tmp_path)
    (text,) = (warning["message"] for warning in report["warnings"])
    assert "turn by up to 22.5 degrees a cell, change it by 5 %" in text
    assert "with 36 cells round it is 1 %" in text
    result = report["solver_error"]
    np.testing.assert_array_less(result["rounded"]["mesh"], np.array(result["mesh"]) + 1e-300)
    assert "of that by straight edges: (3e-08, 3e-08, 1e-09) m" in as_text(report)
    tube(tmp_path, 64, 0.05)
    assert check(tmp_path)["warnings"] == []


def test_midside_nodes_on_the_geometry_have_no_such_error(tmp_path):
    assert not bows_of(rounded(Solver(tube(tmp_path, 16, 0.05))).component.mesh)[0].any()


def moved_at(mesh, offset):
    """Move the midside node of an edge along the tube, at its outside, by a part of its length."""
    points = mesh.points.copy()
    at = np.linalg.norm(points - [RADIUS, 0.0, LENGTH / 16], axis=1).argmin()
    points[at, 0] += offset * LENGTH / 8
    return replace(mesh, points=points)


def test_a_midside_node_that_is_moved_a_little_leaves_the_others_their_bows(tmp_path):
    mesh = Solver(tube(tmp_path, 12, 0.05)).component.mesh
    np.testing.assert_array_equal(bows_of(moved_at(mesh, 0.002))[0], bows_of(mesh)[0])


def test_a_body_with_curved_edges_leaves_another_body_its_bows(tmp_path):
    straight = Solver(tube(tmp_path, 12, 0.05))
    mesh, curved = straight.component.mesh, rounded(straight).component.mesh
    count = len(mesh.points)
    blocks = [CellBlock(block.kind, block.nodes + count) for block in mesh.blocks]
    points = np.concatenate([mesh.points, curved.points + 10 * RADIUS])
    bows = bows_of(replace(mesh, points=points, blocks=(*mesh.blocks, *blocks)))[0]
    np.testing.assert_array_equal(bows[:count], bows_of(mesh)[0])
    assert bows[:count].any()
    assert not bows[count:].any()


@pytest.mark.parametrize("kind", ["hexahedron", "tetra", "wedge"])
@pytest.mark.parametrize(("cells", "polygons"), [(6, 2), (7, 2), (8, 2), (9, 0)])
def test_six_to_eight_cells_round_are_a_polygon_inside_and_outside(tmp_path, kind, cells, polygons):
    mesh = Solver(tube(tmp_path, cells, 0.3, kind=kind)).component.mesh
    assert [polygon.faces for polygon in polygons_of(mesh)] == polygons * [cells]


def test_half_a_ring_of_eight_cells_is_a_polygon(tmp_path):
    mesh = Solver(tube(tmp_path, 8, 0.3)).component.mesh
    (block,) = mesh.blocks
    half = block.nodes[mesh.points[block.nodes].mean(axis=1)[:, 1] > 0]
    polygons = polygons_of(replace(mesh, blocks=(CellBlock(block.kind, half),)))
    assert [polygon.faces for polygon in polygons] == [4, 4]


def test_eight_cells_round_with_curved_edges_are_no_polygon(tmp_path):
    assert polygons_of(rounded(Solver(tube(tmp_path, 8, 0.3))).component.mesh) == []


@pytest.mark.parametrize("chamfers", [[0], [0, 1, 2, 3]])
def test_chamfers_of_a_square_bar_are_no_polygon(chamfers):
    corners = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    flat = []
    for i, corner in enumerate(corners):  # a regular octagon has 0.586
        cuts = [corners[i - 1], corners[(i + 1) % 4]] if i in chamfers else [corner]
        flat += [corner + 0.5 * 0.52 * (other - corner) for other in cuts]
    outline = np.array([(0.0, 0.0), *flat])
    points = [(*point, z) for z in (0.0, 1.0, 2.0) for point in outline]
    count = len(flat)
    sector = np.array([[0, 1 + i, 1 + (i + 1) % count] for i in range(count)])
    layers = [np.hstack([sector + k * (count + 1), sector + (k + 1) * (count + 1)]) for k in (0, 1)]
    mesh = Mesh(np.array(points), (CellBlock("wedge6", np.concatenate(layers)),))
    assert polygons_of(second_order(mesh)) == []


def test_the_check_warns_of_a_polygon_that_can_be_round(tmp_path):
    tube(tmp_path, 8, 0.3)
    (text,) = (warning["message"] for warning in check(tmp_path)["warnings"])
    assert text.startswith("has 8 equal flat faces in a row, 45 degrees a turn, near (")
    assert "a bar is 23 % too soft in bending" in text


@pytest.mark.parametrize("kind", ["hex8", "tet4", "wedge6"])
def test_a_box_has_none(kind):
    mesh = second_order(box(kind, (2, 2, 2), (1.0, 1.0, 1.0)))
    assert not bows_of(mesh)[0].any()
    assert polygons_of(mesh) == []


STUBBY = Path(__file__).with_name("block.toml").read_text("utf-8")


def block(folder, along=5, across=4, ratio=0.3):
    (folder / "component.toml").write_text(
        STUBBY.format(along=along, across=across, ratio=ratio), encoding="utf-8"
    )
    return read_bundle(folder)


def study_of(order, sizes=(4.0, 2.0, 1.0), limit=5.0):
    values = [limit - 0.1 * size**order for size in sizes]
    return Study([1, 2, 3], list(sizes), np.array([value * np.eye(6) for value in values]))


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("sizes", [(4.0, 2.0, 1.0), (2.3, 1.5, 1.1)])
def test_the_order_and_the_limit_of_a_known_law_are_found(order, sizes):
    study = study_of(order, sizes)
    np.testing.assert_allclose(study.order, order, rtol=1e-9)
    np.testing.assert_allclose(study.extrapolated, 5.0, rtol=1e-9)


def test_changes_of_two_signs_have_no_order():
    values = np.array([1.0, 1.2, 1.1])[:, None, None] * np.eye(6)
    study = Study([1, 2, 3], [4.0, 2.0, 1.0], values)
    assert np.isnan(study.order).all()
    assert np.isnan(study.extrapolated).all()


def test_what_is_lacking_at_first_order_is_the_distance_to_the_limit():
    study = study_of(1.0)
    np.testing.assert_allclose(np.diag(study.lacking), 0.4)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0, 4.0])
def test_what_is_lacking_covers_higher_orders_at_no_more_than_twice_the_error(order):
    own, fine = (limit_less(order, size) for size in (1.0, 0.5))
    result = Study([1, 2], [1.0, 0.5], np.array([own, fine])).lacking[0, 0]
    assert 0.1 - 1e-12 <= result <= 0.2


def limit_less(order, size):
    return (5.0 - 0.1 * size**order) * np.eye(6)


@pytest.mark.parametrize("ratio", slow_but({0.45}, [0.3, 0.45, 0.49]))
def test_bars_of_a_stubby_bonded_block_hold_its_errors_and_are_not_five_times_too_large(
    tmp_path, ratio
):
    """46 to 66 % were inside, of single loads 12 to 25 %."""
    bundle = block(tmp_path, ratio=ratio)
    own = Solver(bundle)
    bars = np.diag(accuracy_of(own)["mesh"])
    (tmp_path / "fine").mkdir()
    middle = Solver(block(tmp_path / "fine", 10, 8, ratio)).linear.compliance
    fine = Solver(block(tmp_path / "fine", 15, 12, ratio)).linear.compliance
    errors = np.abs(np.diag(fine + (fine - middle) / (1.5**1.5 - 1) - own.linear.compliance))
    assert (bars >= errors).all()
    assert np.median(bars / errors) < 5


def test_a_kept_study_replaces_the_estimate_in_the_bars(tmp_path):
    bundle = tube(tmp_path, 12, 0.3)
    study = convergence_study(bundle)
    write(bundle, study)
    report = accuracy_of(Solver(bundle))
    assert "finer meshes of" in report["mesh_basis"]
    assert "straight edges across round surfaces" in report["mesh_basis"]
    assert (np.array(report["mesh"]) >= np.abs(study.lacking)).all()


def test_a_study_of_another_setup_is_not_taken(tmp_path):
    write(block(tmp_path), convergence_study(block(tmp_path)))
    other = block(tmp_path, ratio=0.31)
    assert stored(other, (6, 6)) is None


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content | {"lacking": [[float("nan")] * 6] * 6},
        lambda content: content | {"lacking": [[1.0]]},
        lambda content: {"fingerprint": content["fingerprint"]},
    ],
)
def test_a_damaged_study_makes_the_bar_unknown_and_says_why(tmp_path, damage):
    bundle = block(tmp_path)
    write(bundle, convergence_study(bundle))
    file = tmp_path / convergence.FILE
    file.write_text(json.dumps(damage(json.loads(file.read_text()))))
    report = accuracy_or_why(Solver(bundle))
    assert report["mesh"] is None
    assert "run wrenchbook converge again" in report["mesh_basis"]


def test_a_study_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    def fill_the_disk(path, text, **_):
        path.write_bytes(text.encode()[:10])
        raise OSError("no space left")

    bundle = block(tmp_path)
    study = convergence_study(bundle)
    before = write(bundle, study).read_text()
    monkeypatch.setattr(Path, "write_text", fill_the_disk)
    with pytest.raises(OSError, match="no space left"):
        write(bundle, study)
    assert (tmp_path / convergence.FILE).read_text() == before


def test_a_mesh_file_is_compared_with_a_finer_one(tmp_path):
    bundle = tube(tmp_path, 12, 0.3, along=4)
    (tmp_path / "fine").mkdir()
    tube(tmp_path / "fine", 24, 0.3, layers=2, along=8)
    study = convergence_study(bundle, [tmp_path / "fine" / "tube.msh"])
    assert study.sizes[0] / study.sizes[1] == pytest.approx(2.0, rel=0.02)


def test_a_mesh_that_is_not_finer_is_refused(tmp_path):
    bundle = tube(tmp_path, 12, 0.3)
    with pytest.raises(ValueError, match=r"cells at most 0\.9 times as large"):
        convergence_study(bundle, [tmp_path / "tube.msh"])


def test_mistakes_of_a_finer_mesh_are_under_its_name(tmp_path):
    bundle = tube(tmp_path, 12, 0.3)
    with pytest.raises(BundleError, match=r"^link\.inp: \S+: the mesh has no facet or node group"):
        convergence_study(bundle, [SHIPPED / "link" / "link.inp"])


def test_a_finer_mesh_with_too_many_unknowns_is_not_made(tmp_path):
    own = Solver(block(tmp_path))
    assert finer(own, 5000) is None
    created = finer(own, 20000)
    assert created is not None
    assert created.component.mesh.unknowns < 20000


def test_where_the_finer_mesh_cannot_be_solved_the_coarser_one_counts(tmp_path, monkeypatch):
    def fails(*_arguments):
        raise SolveFailed("mechanism", "this mesh moves freely")

    own = Solver(block(tmp_path))
    monkeypatch.setattr(estimate, "finer", fails)
    assert "coarser mesh" in accuracy_of(own)["mesh_basis"]


MESH = np.diag([0.0, 0.0, 4e-6, 0.0, 1e-5, 0.0]).tolist()
TOLD = {"mesh": MESH, "loads": [1.0, 1.0, 100.0, 1.0, 1.0, 1.0], "cell_size": 0.008}


@pytest.mark.parametrize(
    ("told", "translation", "rotation", "words"),
    [
        (TOLD, 4.1e-4, 1.1e-5, None),
        (None, 1e-9, 1e-9, None),
        ({"mesh": None, "loads": [1.0] * 6}, 1e-9, 1e-9, None),
        (TOLD, 1e-4, 1.0, "0.0004 m in uz, 4 times the tolerance"),
        (TOLD, 1e-4, 1.0, "cells about 2 times smaller, about 4 mm each"),
        (TOLD, 3.7e-4, 1.0, "cells about 1.1 times smaller"),
        (TOLD, 1e-9, 1.0, "much smaller"),
        (TOLD | {"linearity": [0.1] * 6}, 1e-3, 1.0, "nonlinear = true"),
        (TOLD | {"buckling": None}, 1.0, 1.0, None),
        (TOLD | {"buckling": 1.5}, 1.0, 1.0, None),
        (TOLD | {"buckling": 0.00108}, 1.0, 1.0, "buckles at 0.00108"),
        (TOLD | {"buckling": 0.1}, 1.0, 1.0, "Narrow [range], or"),
        (
            TOLD | {"loads": [1.0] * 12, "mesh": None, "buckling": 0.1},
            1.0,
            1.0,
            "Narrow the range of its [[interface]], or",
        ),
    ],
)
def test_what_is_over_the_tolerance_is_told_with_what_mends_it(told, translation, rotation, words):
    results = [item.message for item in over_tolerance(told, translation, rotation)]
    assert len(results) == (words is not None)
    assert all(words in message for message in results)
