"""Every failure has a name and a remedy, and none hides behind a number."""

import json
import pickle
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.export.failure_record import HISTORY, LAST_STATE, write_failure, write_state
from wrenchbook.fea.failure import REMEDIES, SolveFailed
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.solve import Solver, solve


def failure_of(part, wrench=(1, 1, 1, 1, 1, 1)):
    with pytest.raises(SolveFailed) as caught:
        Solver(part).solve(wrench)
    assert caught.value.remedy
    return caught.value


def arch(coupling="rigid", divisions=(20, 2, 2), **changes):
    """A shallow sine arch, clamped at both ends, loaded at its crown."""
    mesh = box(
        "hex20",
        divisions,
        (1.0, 0.05, 0.01),
        warp=lambda p: p + np.outer(0.04 * np.sin(np.pi * p[:, 0]), [0, 0, 1]),
    )
    top = mesh.facet_groups["z1"].blocks[0].nodes
    crown = top[np.abs(mesh.points[top][:, :, 0].mean(axis=1) - 0.5) < 0.06]
    ends = np.concatenate([mesh.facet_groups[name].blocks[0].nodes for name in ("x0", "x1")])
    groups = {
        name: FacetGroup((FacetBlock("quad8", f),)) for name, f in (("c", crown), ("e", ends))
    }
    mesh = replace(mesh, facet_groups=groups)
    options = {"fixed": "e", "section": "c", "young": 70e9, "nonlinear": True, **changes}
    return component(mesh, coupling=coupling, **options)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_part_that_touches_nothing_is_a_mechanism_and_is_located(coupling):
    one, other = box("hex20", (2, 2, 2)), box("hex20", (1, 1, 1))
    points = np.concatenate([one.points, other.points + np.array([5.0, 0, 0])])
    nodes = np.concatenate([one.blocks[0].nodes, other.blocks[0].nodes + len(one.points)])
    mesh = Mesh(points, (CellBlock("hex20", nodes),), facet_groups=one.facet_groups)
    failure = failure_of(component(mesh, coupling=coupling, point=[-9, 0, 0]))
    assert failure.kind == "mechanism"
    assert re.match(r"Near \((5|5\.5|6), ", failure.message)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_parts_whose_nodes_only_coincide_are_a_mechanism_with_their_number(nonlinear):
    one, other = box("hex20", (2, 2, 2)), box("hex20", (2, 2, 2))
    points = np.concatenate([one.points, other.points + np.array([1.0, 0, 0])])
    blocks = (*one.blocks, CellBlock("hex20", other.blocks[0].nodes + len(one.points)))
    mesh = Mesh(points, blocks, facet_groups=one.facet_groups)
    failure = failure_of(component(mesh, section="y1", nonlinear=nonlinear))
    assert failure.kind == "mechanism"
    words = "The mesh has 2 parts that share no face: 21 pairs of nodes of part 1 and part 2"
    assert failure.remedy.startswith(words)
    assert "merge them in the mesher" in failure.remedy
    assert failure.remedy.endswith("or join their faces by [[tie]].")


def test_one_reduced_hex20_across_a_section_is_a_mechanism_but_full_integration_holds():
    mesh = box("hex20", (1, 1, 6), (0.1, 0.1, 1.0))
    failure = failure_of(component(mesh, coupling="distributed"))
    assert failure.kind == "mechanism"
    assert "at least two" in failure.remedy
    held = component(mesh, poisson=0.0, integration="full")
    bending = 210e9 * 0.1**4 / 12
    assert Solver(held).compliance[4, 4] == pytest.approx(1 / bending, rel=2e-2)


def test_a_rotation_over_twenty_degrees_is_refused_in_both_analyses():
    for nonlinear in (False, True):
        part = component(box("hex20", (2, 2, 16), (0.01, 0.01, 1.0)), nonlinear=nonlinear)
        bending = 210e9 * 0.01**4 / 12
        assert failure_of(part, [0, 0, 0, bending * 0.5, 0, 0]).kind == "rotation_too_large"
        Solver(part).solve([0, 0, 0, bending * 0.3, 0, 0])


def test_an_arch_that_snaps_through_is_named_and_never_answered_from_the_other_side():
    built = Solver(arch("distributed"))
    below = built.solve([0, 0, -2000, 0, 0, 0])
    assert below.displacement[2] == pytest.approx(-4.47e-3, rel=1e-2)
    with pytest.raises(SolveFailed) as caught:
        built.solve([0, 0, -4000, 0, 0, 0])
    assert caught.value.kind == "snap_through"
    assert len(caught.value.history) > 20


def test_an_arch_that_would_tip_over_sideways_is_held_by_its_guide():
    with pytest.raises(SolveFailed, match="unstable"):
        Solver(arch()).solve([0, 0, -4000, 0, 0, 0])
    held = Solver(arch(locked=("ry",))).solve([0, 0, -4000, 0, 0, 0])
    assert held.displacement[2] == pytest.approx(-7.75e-3, rel=1e-2)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize(("guide", "times"), [((), 1), (("ux", "uy", "rx", "ry", "rz"), 16)])
def test_a_column_is_answered_below_eulers_load_and_named_with_it_above(coupling, guide, times):
    mesh = box("hex20", (2, 2, 16), (0.01, 0.01, 1.0))
    euler = times * np.pi**2 * 210e9 * 0.01**4 / 12 / 4
    built = Solver(component(mesh, coupling=coupling, nonlinear=True, locked=guide))
    result = built.solve([0, 0, -0.95 * euler, 0, 0, 0])
    assert np.abs(result.displacement[[0, 1, 3, 4]]).max() < 1e-9
    with pytest.raises(SolveFailed, match=r"buckles at 0\.9") as caught:
        built.solve([0, 0, -1.05 * euler, 0, 0, 0])
    assert caught.value.kind == "snap_through"
    assert caught.value.load_factor == pytest.approx(1 / 1.05, rel=0.01)


def test_a_guide_holds_a_section_that_only_follows_its_mean():
    """The body alone, its section free, would be unstable at a 25th of this load."""
    mesh = box("hex20", (2, 2, 16), (0.01, 0.01, 1.0))
    load = 12 * np.pi**2 * 210e9 * 0.01**4 / 12 / 4
    guide = ("ux", "uy", "rx", "ry")
    sunk = [
        Solver(component(mesh, coupling=coupling, nonlinear=True, locked=guide))
        .solve([0, 0, -load, 0, 0, 0])
        .displacement[2]
        for coupling in ("rigid", "distributed")
    ]
    assert sunk[1] == pytest.approx(sunk[0], rel=2e-3)


def test_loads_beyond_all_reason_fail_by_name():
    part = component(box("hex20", (2, 2, 4), (0.1, 0.1, 0.4)), nonlinear=True)
    for size in (1e9, 1e12, 1e200):
        failure = failure_of(part, [size, 0, -size, 0, 0, 0])
        assert failure.kind in {
            "not_converged",
            "snap_through",
            "rotation_too_large",
            "inverted_elements",
        }


@pytest.mark.parametrize("kind", REMEDIES)
def test_a_remedy_begins_with_what_to_do(kind):
    first = REMEDIES[kind].split()[0]
    assert first in {"Check", "Fix", "Reduce", "If", "Keep", "Mesh", "Or"}


def test_a_failure_travels_between_processes():
    failure = SolveFailed("not_converged", "It stopped.")
    failure.history = ((1.0, 1, 2.0),)
    copy = pickle.loads(pickle.dumps(failure))
    assert (copy.kind, copy.message, copy.remedy) == (
        failure.kind,
        failure.message,
        failure.remedy,
    )
    assert copy.history == failure.history


KINDS = ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15", "pyramid5", "pyramid13"]


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
    result = Solver(part).solve([0, 0, -6000 * factor, 0, 0, 0])
    np.testing.assert_allclose(nodes, result.nodes, atol=1e-6 * np.abs(nodes).max())


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


def test_numbers_of_the_history_that_are_not_finite_are_null(tmp_path):
    failure = SolveFailed("not_converged", "It stopped.")
    failure.history = ((1.0, 1, float("nan")), (1.0, 2, float("inf")))
    write_failure(tmp_path, failure, component(box("tet10", (1, 1, 1))))
    norms = [step["residual_norm"] for step in read(tmp_path)[0]["iterations"]]
    assert norms == [None, None]


@pytest.mark.parametrize("error", [ValueError, OSError, meshio.WriteError])
def test_a_state_that_cannot_be_written_is_named_and_does_not_hide_the_failure(
    tmp_path, monkeypatch, capsys, error
):
    def write(*_, **__):
        raise error("no such kind")

    monkeypatch.setattr(meshio.Mesh, "write", write)
    part = component(box("tet10", (1, 1, 1)), poisson=0.499)
    assert failed(part, [1, 0, 0, 0, 0, 0], tmp_path).kind == "locking_material"
    assert f'last_state.vtu" was not kept: {error("no such kind")}' in capsys.readouterr().err


def test_a_history_that_cannot_be_written_does_not_keep_back_the_state(tmp_path, capsys):
    (tmp_path / HISTORY).mkdir()
    write_failure(
        tmp_path, SolveFailed("not_converged", "It stopped."), component(box("tet10", (1, 1, 1)))
    )
    assert (tmp_path / LAST_STATE).is_file()
    assert f'{HISTORY}" was not kept' in capsys.readouterr().err


def test_a_full_disk_of_record_and_log_does_not_hide_the_failure(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys, "stderr", SimpleNamespace(write=full))
    part = component(box("tet10", (1, 1, 1)), poisson=0.499)
    assert failed(part, [1, 0, 0, 0, 0, 0], tmp_path / "gone").kind == "locking_material"


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_cell_is_written_and_read_back(kind, tmp_path):
    part = component(box(kind, (2, 1, 1)))
    moved = np.random.default_rng(1).standard_normal(part.mesh.points.shape)
    write_state(tmp_path / "state.vtu", part, moved)
    mesh = meshio.read(tmp_path / "state.vtu")
    np.testing.assert_array_equal(mesh.cells[0].data, part.mesh.blocks[0].nodes)
    np.testing.assert_allclose(mesh.point_data["displacement"], moved)


def test_the_load_factor_and_the_last_state_travel_between_processes(snapped):
    copy = pickle.loads(pickle.dumps(snapped[2]))
    assert copy.load_factor == snapped[2].load_factor
    np.testing.assert_array_equal(copy.last[1], snapped[2].last[1])
