"""The solver's own share of a surface's bars: what the interface is off, followed by the body."""

import ctypes
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.service.surfaces import keep, sheet, solved, solver, wrenches, write_bundle
from wrenchbook.fea.accuracy.estimate import accuracy_of
from wrenchbook.fea.solve import Solver
from wrenchbook.service.fields.deformed import DeformedSurfaces
from wrenchbook.service.fields.shape import LOCAL, NO_MODES, error_parts, vertex_modes
from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.fields.surface_files import write_vtu
from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError
from wrenchbook.surrogate.table.rows import Rows, Tolerance

POINTS = np.array([[0.0, 0, 0], [0.2, -0.1, 0.3], [1.0, 0, 0]])
LOADS = [10.0] * 3 + [1.0] * 3
WRENCH = np.array([1.0, -2, 3, 0.1, 0.2, -0.3])


def rigid(points):
    """How points of a rigid body follow it, shape (v, 3, 6), m/m and m/rad."""
    result = np.zeros((len(points), 3, 6))
    result[:, :, :3] = np.eye(3)
    for axis, turn in enumerate(np.eye(3)):
        result[:, :, 3 + axis] = np.cross(turn, points)
    return result


def compliance():
    """A compliance of coupled freedoms of unlike units, (6, 6)."""
    size = np.diag([1e-6, 2e-6, 1e-4, 1e-3, 1e-3, 1e-5])
    mixed = np.random.default_rng(3).normal(size=(6, 6)) / 3 + np.eye(6)
    return np.sqrt(size) @ mixed @ mixed.T @ np.sqrt(size)


def told(**more):
    mesh = np.outer([1e-8] * 3 + [1e-7] * 3, np.ones(6))
    return SolverError({"mesh": mesh.tolist(), "mesh_basis": "words", "loads": LOADS, **more})


def parts(solver_error=None, points=POINTS, follows=None):
    follows = rigid(points) if follows is None else follows
    return error_parts(np.full(len(points), 1e-9), follows, solver_error, WRENCH)


def test_a_rigid_body_follows_its_interface_as_one():
    own = compliance()
    np.testing.assert_allclose(vertex_modes(rigid(POINTS) @ own, own), rigid(POINTS), atol=1e-9)


def test_a_locked_freedom_moves_nothing():
    own = compliance()
    own[2], own[:, 2] = 0.0, 0.0
    result = vertex_modes(rigid(POINTS) @ own, own)
    np.testing.assert_allclose(result[:, :, 2], 0.0, atol=1e-9)
    kept = [0, 1, 3, 4, 5]
    np.testing.assert_allclose(result[:, :, kept], rigid(POINTS)[:, :, kept], atol=1e-9)


def test_at_the_interface_the_meshs_share_is_at_least_the_interfaces_own():
    result, own = parts(told()), np.array(told().parts(WRENCH.tolist())["mesh"])
    assert result.by_cause["mesh"][0] >= np.linalg.norm(own[:3])
    turned = own[:3] + np.array([0.0, own[5], own[4]])  # t + r x (1, 0, 0), of whatever signs
    assert result.by_cause["mesh"][2] >= np.linalg.norm(turned)


def test_a_vertex_that_is_held_has_no_share():
    follows = rigid(POINTS)
    follows[1] = 0.0
    assert parts(told(), follows=follows).by_cause["mesh"][1] == 0.0


def test_a_vertex_that_moves_by_a_load_alone_has_the_local_share():
    follows = rigid(POINTS)
    follows[1] *= 1e-6
    share = parts(told(), follows=follows).by_cause["mesh"]
    assert share[1] == pytest.approx(LOCAL * share.max() / (1 + LOCAL), rel=1e-4)


def test_the_total_is_the_sum_of_the_parts_and_names_its_sources():
    result = parts(told(linearity=[1e-7] * 6, linearity_basis="bent"))
    assert list(result.by_cause) == ["table", "mesh", "linearity"]
    np.testing.assert_allclose(result.total, sum(result.by_cause.values()))
    assert result.bases == {"mesh_basis": "words", "linearity_basis": "bent"}
    assert result.largest()["mesh"] == result.by_cause["mesh"].max()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (None, UNKNOWN),
        (SolverError({"mesh": None, "mesh_basis": "why not", "loads": LOADS}), "why not"),
    ],
)
def test_a_mesh_that_nothing_tells_of_is_said_to_be_unknown(error, words):
    result = parts(error)
    assert result.largest() == {"table": 1e-9, "mesh": None, "mesh_basis": words}
    assert not result.are_complete
    np.testing.assert_array_equal(result.total, 1e-9)


def test_a_surface_that_nothing_ties_to_its_interface_says_so():
    assert vertex_modes(rigid(POINTS), np.full((6, 6), np.nan)) is None
    result = error_parts(np.ones(3), None, told(), WRENCH)
    assert result.largest() == {"table": 1.0, "mesh": None, "mesh_basis": NO_MODES}


def test_the_bars_of_a_bent_block_hold_what_twice_the_cells_change():
    """Tetrahedra of first order, far too stiff: their error is no small part of the answer."""
    coarse, fine = (
        Solver(component(box("tet4", cells, (1, 1, 4)), nonlinear=True)) for cells in CELLS
    )
    mesh = SolverError(accuracy_of(coarse) | {"loads": LOADS})
    places = coarse.component.mesh.points
    same = np.linalg.norm(places[:, None] - fine.component.mesh.points, axis=2).argmin(axis=1)
    follows = vertex_modes(coarse.linear.fields, coarse.compliance)
    held, ratios = [], []
    for wrench in np.vstack([np.eye(6), np.random.default_rng(4).uniform(-1, 1, (10, 6))]):
        error = np.linalg.norm((fine.linear.fields[same] - coarse.linear.fields) @ wrench, axis=1)
        bars = error_parts(np.zeros(len(places)), follows, mesh, wrench).total
        free = error > 0
        held.append((bars >= error)[free])
        ratios.append((bars / np.where(free, error, 1.0))[free])
    assert np.mean(np.concatenate(held)) >= 0.9
    assert np.median(np.concatenate(ratios)) <= 5


CELLS = (2, 2, 8), (4, 4, 16)


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A nonlinear plate, its rows, what its own mesh is off, and answers from its fields."""
    folder = write_bundle(tmp_path_factory.mktemp("bundles"))
    own = sheet(folder)
    fields, rows = solved(folder, wrenches(own, 6))
    store = FieldStore(tmp_path_factory.mktemp("kept") / "fields")
    for wrench, one in zip(rows.wrench, fields, strict=True):
        keep(store, own, wrench, one)
    shapes = DeformedSurfaces(store)
    yield own, rows, SolverError(accuracy_of(solver(folder))), shapes
    shapes.close()


def asked_of(plate):
    """The wrench of a row, and one between rows."""
    own, rows, *_ = plate
    return {"row": rows.wrench[2], "rows": wrenches(own, 1, seed=9)[0]}


@pytest.mark.parametrize("source", ["row", "rows"])
def test_a_surface_has_the_meshs_share_at_a_row_and_between_rows(plate, source):
    own, rows, mesh, shapes = plate
    wrench = asked_of(plate)[source]
    without = shapes.answer(own, rows, wrench)
    result = shapes.answer(own, rows, wrench, solver=mesh)
    assert result.source == source
    np.testing.assert_array_equal(result.displacement, without.displacement)
    np.testing.assert_allclose(
        result.error - without.error, result.parts.by_cause["mesh"], atol=1e-18
    )
    # On the patch, which is the interface, at least the interface's own bar for that point.
    patch = np.linalg.norm(result.geometry.vertices[:, :2], axis=1) < 0.0599
    patch &= np.abs(result.geometry.vertices[:, 2]) < 1e-9
    bars = np.array(mesh.parts(wrench.tolist())["mesh"])
    rigidly = np.linalg.norm(np.abs(rigid(result.geometry.vertices[patch])) @ bars, axis=1)
    assert patch.sum() > 20
    assert (result.error[patch] >= rigidly).all()


def test_the_meshs_share_leaves_coverage_alone_and_is_held_against_the_tolerance(plate):
    own, rows, mesh, shapes = plate
    wrench = asked_of(plate)["row"]
    for limit, error, within in (
        (Tolerance(1e-9, 1e-9), mesh, False),
        (Tolerance(1.0, 1.0), mesh, True),
        (Tolerance(1.0, 1.0), None, None),
    ):
        result = shapes.answer(replace(own, tolerance=limit), rows, wrench, solver=error)
        assert (result.coverage, result.within_tolerance) == ("covered", within)


def test_without_a_bar_of_the_table_there_are_no_parts(plate):
    own, rows, mesh, shapes = plate
    few = rows.take([0, 1])
    result = shapes.answer(own, few, wrenches(own, 1, seed=9)[0], solver=mesh)
    assert (result.error, result.parts, result.within_tolerance) == (None, None, None)


def test_a_linear_surface_has_its_meshs_and_its_linearitys_share(tmp_path):
    folder = write_bundle(tmp_path, nonlinear=False)
    own = sheet(folder)
    asked = wrenches(own, 2)
    fields, rows = solved(folder, asked)
    store = FieldStore(tmp_path / "fields")
    keep(store, own, asked[0], fields[0])
    shapes = DeformedSurfaces(store)
    mesh = SolverError(accuracy_of(solver(folder)))
    result = shapes.answer(own, rows, asked[1], solver=mesh)
    assert list(result.parts.by_cause) == ["table", "mesh", "linearity"]
    assert (result.parts.by_cause["linearity"] > 0).any()
    np.testing.assert_allclose(result.error, result.parts.total)
    alone = shapes.answer(own, Rows.empty(), asked[1], solver=mesh)
    assert alone.parts.largest()["mesh_basis"] == NO_MODES
    assert b'Name="error_linearity"' in write_vtu(result)
    shapes.close()


# In a process of its own: how many heaps there may be is set once, for all of its threads.
PROGRAM = """
import resource, threading
from wrenchbook.service.files.program import keep_few_heaps
keep_few_heaps()
resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
end = threading.Event()
def hold():
    kept = [bytearray(1000) for _ in range(1000)]
    end.wait()
threads = [threading.Thread(target=hold) for _ in range(40)]
for thread in threads:
    thread.start()
end.set()
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc's heaps")
def test_forty_threads_start_in_a_gigabyte_of_addresses():
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
