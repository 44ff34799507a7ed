"""What a failed solve leaves behind for whoever has to find out why."""

import json
import pickle

import meshio
import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.test_failures import arch
from wrenchbook.fea.export.failure_record import HISTORY, LAST_STATE, write_state
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver, solve

KINDS = ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15"]


def read(folder):
    with (folder / HISTORY).open(encoding="utf-8") as file:
        record = json.load(file)
    return record, meshio.read(folder / LAST_STATE)


def failed(part, wrench, folder):
    with pytest.raises(SolveFailed) as caught:
        solve(part, wrench, folder=folder)
    return caught.value


@pytest.fixture(scope="module")
def snapped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attempt")
    part = arch(locked=("ry",))
    return part, folder, failed(part, [0, 0, -6000, 0, 0, 0], folder)


def test_a_snap_through_says_at_which_part_of_the_load(snapped):
    part, _, failure = snapped
    assert failure.kind == "snap_through"
    limit = failure.load_factor * 6000
    assert f"snaps through at {failure.load_factor:.3g} of this wrench" in failure.message
    built = Solver(part)
    assert built.solve([0, 0, -0.995 * limit, 0, 0, 0]).displacement[2] < -0.01
    with pytest.raises(SolveFailed, match=r"snaps through at 0\.99"):
        built.solve([0, 0, -1.005 * limit, 0, 0, 0])


def test_the_history_and_the_last_converged_state_are_kept(snapped):
    part, folder, failure = snapped
    record, mesh = read(folder)
    assert record["kind"] == "snap_through"
    assert record["remedy"] == failure.remedy
    assert record["critical_load_factor"] == pytest.approx(4385 / 6000, rel=1e-3)
    assert 0.9 < record["last_load_factor"] / record["critical_load_factor"] < 1
    assert len(record["iterations"]) == len(failure.history) > 20
    assert set(record["iterations"][0]) == {"load_factor", "iteration", "residual_norm"}
    np.testing.assert_allclose(mesh.points, part.mesh.points)
    crown = mesh.point_data["interface"] == 1
    assert -0.02 < mesh.point_data["displacement"][crown, 2].mean() < -0.01
    assert not mesh.point_data["displacement"][mesh.point_data["supported"] == 1].any()


def test_the_last_state_is_an_equilibrium_under_its_part_of_the_load(snapped):
    part, _, failure = snapped
    factor, nodes = failure.last
    found = Solver(part).solve([0, 0, -6000 * factor, 0, 0, 0])
    np.testing.assert_allclose(nodes, found.nodes, atol=1e-6 * np.abs(nodes).max())


def test_a_failure_before_any_state_keeps_the_mesh(tmp_path):
    part = component(box("hex20", (1, 1, 6), (0.1, 0.1, 1.0)), coupling="distributed")
    assert failed(part, [1, 0, 0, 0, 0, 0], tmp_path).kind == "mechanism"
    record, mesh = read(tmp_path)
    assert (record["last_load_factor"], record["critical_load_factor"]) == (0.0, None)
    assert record["iterations"] == []
    assert not mesh.point_data["displacement"].any()


def test_a_locking_material_keeps_the_mesh_as_well(tmp_path):
    part = component(box("tet10", (1, 1, 1)), poisson=0.499)
    assert failed(part, [1, 0, 0, 0, 0, 0], tmp_path).kind == "locking_material"
    assert read(tmp_path)[0]["kind"] == "locking_material"


def test_a_folder_that_is_not_there_does_not_hide_the_failure(tmp_path, capsys):
    part = component(box("tet10", (1, 1, 1)), poisson=0.499)
    assert failed(part, [1, 0, 0, 0, 0, 0], tmp_path / "gone").kind == "locking_material"
    assert "was not kept" in capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_cell_is_written_and_read_back(kind, tmp_path):
    part = component(box(kind, (2, 1, 1)))
    moved = np.random.default_rng(1).standard_normal(part.mesh.points.shape)
    write_state(tmp_path / "state.vtu", part, moved)
    mesh = meshio.read(tmp_path / "state.vtu")
    nodes = part.mesh.blocks[0].nodes[:, : 6 if kind == "wedge15" else None]
    np.testing.assert_array_equal(mesh.cells[0].data, nodes)
    np.testing.assert_allclose(mesh.point_data["displacement"], moved)


def test_the_load_factor_and_the_last_state_travel_between_processes(snapped):
    copy = pickle.loads(pickle.dumps(snapped[2]))
    assert copy.load_factor == snapped[2].load_factor
    np.testing.assert_array_equal(copy.last[1], snapped[2].last[1])
