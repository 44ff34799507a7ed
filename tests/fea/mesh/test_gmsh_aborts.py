"""gmsh aborts on sound geometry at some sizes: that ends its own process, and nothing else."""

import os
import pickle
import signal
import subprocess

import pytest

from tests.fea.accuracy.test_accuracy import BRACKET
from tests.fea.geometry import abort_gmsh, draw_bracket
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check.reporting import report
from wrenchbook.fea.mesh.sources import mesh_of
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.service.files.program import child_command
from wrenchbook.service.library.bundles import check_mesh

SIZE = 8.0  # mm: its mesh is beside a coarser one


@pytest.fixture
def part(tmp_path):
    folder = tmp_path / "part"
    folder.mkdir()
    draw_bracket(folder / "bracket.step")
    (folder / "component.toml").write_text(BRACKET.replace("12e-3", f"{SIZE}e-3"))
    return folder


def mesh_source(folder):
    source = read_bundle(folder).mesh
    assert source is not None
    return source


def test_a_size_at_which_the_optimiser_aborts_is_meshed_without_it(part, tmp_path, monkeypatch):
    source = mesh_source(part)
    sound = mesh_of(source)
    abort_gmsh(monkeypatch, tmp_path / "fake", "optimised")
    assert mesh_of(source).cell_counts == sound.cell_counts


def test_a_size_at_which_gmsh_aborts_is_meshed_at_a_size_near_it(part, tmp_path, monkeypatch):
    source = mesh_source(part)
    sound = mesh_of(source)
    abort_gmsh(monkeypatch, tmp_path / "fake", f"abs(size - {SIZE}) < 1e-6")
    near = mesh_of(source)
    assert near.cell_counts["tet10"] == pytest.approx(sound.cell_counts["tet10"], rel=0.2)
    assert near.facet_groups.keys() == sound.facet_groups.keys()


def test_an_abort_at_each_size_is_a_problem_of_the_size_and_ends_the_check_with_1(
    part, tmp_path, monkeypatch
):
    abort_gmsh(monkeypatch, tmp_path / "fake", "True")
    command = child_command("wrenchbook.service.cli.main", "check", str(part))
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    said = " ".join((done.stdout + done.stderr).split())
    assert done.returncode == 1
    assert 'mesh.size: gmsh fails on "bracket.step" (what(): Failed to reach' in said
    assert "with cells of 0.008 m, also without optimisation" in said
    assert "Write a size" in said


def test_the_server_names_gmsh_and_not_a_damaged_file(part, tmp_path, monkeypatch):
    abort_gmsh(monkeypatch, tmp_path / "fake", "True")
    with pytest.raises(BundleError, match="gmsh fails on") as caught:
        check_mesh(part)
    assert "damaged" not in str(caught.value)
    assert [problem.where for problem in caught.value.problems] == ["mesh.size"]


def test_a_second_mesh_at_which_gmsh_aborts_leaves_the_bar_unknown_and_the_part_sound(
    part, tmp_path, monkeypatch
):
    abort_gmsh(monkeypatch, tmp_path / "fake", f"size > {1.1 * SIZE}")
    reported = report(part)
    assert reported["ok"]
    assert reported["solver_error"]["mesh"] is None
    assert "no second mesh can be made" in reported["solver_error"]["mesh_basis"]
    assert any(
        "discretisation error is unknown" in warning["message"] for warning in reported["warnings"]
    )


def test_memory_that_ends_in_gmsh_is_named(part, tmp_path, monkeypatch):
    condition = "os.write(2, b'std::bad_alloc\\n') and os._exit(1)"
    abort_gmsh(monkeypatch, tmp_path / "fake", condition)
    with pytest.raises(BundleError, match=r"limit of memory on .* m; write a larger size"):
        mesh_of(mesh_source(part))


def test_gmsh_ends_with_the_process_that_waits_for_it(part, tmp_path, monkeypatch):
    abort_gmsh(monkeypatch, tmp_path / "fake", "__import__('signal').pause()")
    command = child_command("wrenchbook.fea.mesh.cad.child")
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as gmsh:
        source = mesh_source(part)
        gmsh.communicate(pickle.dumps((source.file, source.geometry, True)), timeout=600)
    assert gmsh.returncode == 1


def test_a_check_that_is_terminated_leaves_no_gmsh(part, tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "alive")
    condition = f"(held := open({str(tmp_path / 'alive')!r}, 'w')) and held.write('meshing\\n')"
    condition += " and not held.flush() and __import__('signal').pause()"
    abort_gmsh(monkeypatch, tmp_path / "fake", condition)
    command = child_command("wrenchbook.service.cli.main", "check", str(part))
    with subprocess.Popen(command) as check, (tmp_path / "alive").open() as alive:
        assert alive.readline() == "meshing\n"
        check.terminate()
        assert alive.read() == ""  # at the end of all processes that hold it
    assert check.returncode == 128 + signal.SIGTERM
