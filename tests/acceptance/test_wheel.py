"""The wheel in a fresh environment, beside a project with packages of the same names as ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.build import library_path
from wrenchbook.surrogate.kernel.format import write_file
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import LoadRange, Rows

ROOT = Path(__file__).parents[2]
ROOMS = ("fea", "surrogate", "service", "data")

SIMULATOR = """
import json, pickle, sys
import service, data, surrogate
from wrenchbook import Client, ServerUnreachable, conventions
import wrenchbook

with Client(sys.argv[1], timeout=600) as client:
    solved = client.displacement("bar", [0, 0, -5], on_thin="wait", wait_s=100)
    client.add_component({"name": "rig", "title": "rig",
                          "range": {"force": [9, 9, 9], "moment": [9, 9, 9]}})
    loaded = client.import_table("rig", "Fz [N],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]\\n"
                                 "0,0,0,0,0,0,0\\n2,0,0,2e-3,0,0,0\\n", missing_loads="zero")
    client.component("rig", wait_s=60)  # which waits for the rows
    measured = client.displacement("rig", [0, 0, 1], on_thin="estimate")
    table = client.download("rig")
    here = table.answer([0, 0, 1])
    batch = pickle.loads(pickle.dumps(table)).batch([[0, 0, 1, 0, 0, 0], [0, 0, 2, 0, 0, 0]])
    bar = client.download("bar").answer([0, 0, -4], derivatives=True)
    there = client.displacement("bar", [0, 0, -4], on_thin="estimate", derivatives=True)
again = pickle.loads(pickle.dumps(solved))
print(json.dumps({
    "face": wrenchbook.__file__,
    "client": type(solved).__module__,
    "owners": [service.OWNER, data.OWNER, surrogate.OWNER],
    "same": [here.vector.tolist() == measured.vector.tolist(), here.coverage == measured.coverage,
             (bar.vector == there.vector).all().item(), bar.method == there.method,
             (bar.derivative == there.derivative).all().item()],
    "table": [type(table).__module__, type(table.packed).__module__],
    "batch_uz": batch.displacements[:, 2].tolist(),
    "server_stack": sorted({"fastapi", "starlette", "pydantic", "uvicorn", "sqlite3"}
                           & set(sys.modules)),
    "source": solved.source,
    "uz": again.translation[2],
    "inserted": loaded["inserted"],
    "measured_uz": measured.translation[2],
    "ros": conventions.to_ros([1, 2, 3, 4, 5, 6])["torque"],
}))
"""


@dataclass
class Environment:
    """A fresh environment, and the project that a user runs it in."""

    folder: Path
    project: Path

    @property
    def packages(self) -> Path:
        return next(self.folder.glob("lib/python*/site-packages"))

    def run(self, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(self.folder / "bin" / program), *arguments],
            cwd=self.project,
            env=self.variables,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )

    @property
    def variables(self) -> dict[str, str]:
        kept = {name: word for name, word in os.environ.items() if not name.startswith("PYTHON")}
        return {**kept, "PYTHONPATH": str(self.project), "PYTHONDONTWRITEBYTECODE": "1"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    return next(folder.glob("*.whl"))


def fresh(wheel: Path, folder: Path) -> Environment:
    """Install the wheel, and nothing else, beside a project with rooms of the same names."""
    for room in ROOMS:
        package = folder / "project" / room
        package.mkdir(parents=True)
        (package / "__init__.py").write_text("OWNER = 'the project'\n")
        # Whatever of ours would be looked for here.
        for name in ("client", "cli", "jobs", "bundle", "table", "components"):
            (package / f"{name}.py").write_text("raise RuntimeError('a stranger: ' + __name__)\n")
    env = Environment(folder / "env", folder / "project")
    make = [sys.executable, "-m", "venv", "--without-pip", str(env.folder)]
    subprocess.run(make, capture_output=True, check=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    install = ["--python", str(env.folder), "install", "--no-index", "--no-deps", str(wheel)]
    subprocess.run([*pip, *install], capture_output=True, check=True)
    return env


@pytest.fixture(scope="module")
def with_server(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """With the third-party packages of the environment that runs the tests."""
    env = fresh(wheel, tmp_path_factory.mktemp("server"))
    # A path line adds that folder behind this environment's own and reads none of its .pth files,
    # so an editable wrenchbook there stays out.
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (env.packages / "third_party.pth").write_text("\n".join(sorted(paths)) + "\n")
    return env


@pytest.fixture(scope="module")
def with_numpy(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """With numpy and no other package."""
    env = fresh(wheel, tmp_path_factory.mktemp("numpy"))
    for part in Path(np.__file__).parents[1].glob("numpy*"):
        (env.packages / part.name).symlink_to(part)
    return env


@pytest.fixture(scope="module")
def address(with_server: Environment, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of `wrenchbook serve`, run from the project's folder."""
    folder = tmp_path_factory.mktemp("workspace")
    command = [str(with_server.folder / "bin/wrenchbook"), "serve", "--data", str(folder)]
    with (folder / "server.log").open("w") as log:
        server = subprocess.Popen(
            [*command, "--port", "0", "--solvers", "1"],
            cwd=with_server.project,
            env=with_server.variables,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
    assert server.stdout is not None
    try:
        words = server.stdout.readline().split()
        assert words, (folder / "server.log").read_text()
        yield words[-1]
    finally:
        server.terminate()
        server.wait(600)
        server.stdout.close()


def test_the_wheel_puts_nothing_but_wrenchbook_among_other_packages(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.partition("/")[0] for name in names if ".dist-info/" not in name}
    assert tops == {"wrenchbook"}
    assert "wrenchbook/components/plate_ccx/plate.inp" in names


def test_the_wheel_of_a_source_distribution_has_the_same_files(wheel: Path, tmp_path: Path):
    """A source distribution has no links: by their names alone its wheel had nine files."""
    build = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path)]
    subprocess.run([*build, "-t", "sdist"], cwd=ROOT, capture_output=True, check=True)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as archive:
        archive.extractall(tmp_path, filter="data")
    source = next(path for path in tmp_path.iterdir() if path.is_dir())
    subprocess.run([*build, "-t", "wheel"], cwd=source, capture_output=True, check=True)
    listings = []
    for path in (wheel, next(tmp_path.glob("*.whl"))):
        with zipfile.ZipFile(path) as archive:
            listings.append(sorted(archive.namelist()))
    assert listings[0] == listings[1]


def test_the_wheel_brings_the_compiled_kernel_its_header_and_its_platform(wheel: Path):
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert wheel.name.endswith(f"-py3-none-{platform}.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    folder = "wrenchbook/surrogate/kernel"
    assert {f"{folder}/{library_path().name}", f"{folder}/wrenchbook.h"} <= names
    assert f"{folder}/wb_answer.c" in names
    assert "wrenchbook/py.typed" in names


def test_a_packed_table_answers_with_numpy_alone_and_is_not_compiled(
    with_numpy: Environment, tmp_path: Path
):
    rows = Rows.of(np.eye(6), 1e-3 * np.eye(6))
    table = build(rows, LoadRange(-np.ones(6), np.ones(6)), linear=True)
    write_file(tmp_path / "rig.wbt", pack(table))
    code = (
        "import os, sys\n"
        "os.environ['PATH'] = ''\n"  # no compiler
        "import wrenchbook\n"
        "from wrenchbook.surrogate.kernel.binding import PackedTable\n"
        "table = PackedTable.open(sys.argv[1])\n"
        "print(table.answer([0, 0, 0.5, 0, 0, 0]).outputs)\n"
        "print('scipy' in sys.modules)\n"
    )
    run = with_numpy.run("python", "-c", code, str(tmp_path / "rig.wbt"))
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == ["(0.0, 0.0, 0.0005, 0.0, 0.0, 0.0)", "False"]


def test_client_and_server_work_beside_a_project_with_a_package_named_service(
    with_server: Environment, address: str
):
    (with_server.project / "simulator.py").write_text(SIMULATOR)
    run = with_server.run("python", "simulator.py", address)
    assert run.returncode == 0, run.stderr
    reported = json.loads(run.stdout)
    assert Path(reported["face"]) == with_server.packages / "wrenchbook" / "__init__.py"
    assert reported["client"] == "wrenchbook.service.client.replies"
    assert reported["owners"] == ["the project"] * 3
    assert reported["same"] == [True] * 5
    assert reported["table"] == [
        "wrenchbook.service.client.table",
        "wrenchbook.surrogate.kernel.binding",
    ]
    assert reported["batch_uz"] == pytest.approx([1e-3, 2e-3], rel=1e-9)
    assert reported["server_stack"] == []
    assert reported["source"] == "fea"
    assert reported["uz"] < 0.0
    assert reported["inserted"] == 2
    assert reported["measured_uz"] == pytest.approx(1e-3, rel=1e-9)
    assert reported["ros"] == {"x": 4.0, "y": 5.0, "z": 6.0}


def test_commands_and_their_child_processes_run_the_installed_rooms(
    with_server: Environment, tmp_path: Path
):
    # A private server and a mesh check: each a process that the command starts.
    listed = with_server.run("wrenchbook", "components", "--json", "--data", str(tmp_path))
    assert listed.returncode == 0, listed.stderr
    assert {"bar", "spring"} <= {load["name"] for load in json.loads(listed.stdout)}
    bundle = with_server.packages / "wrenchbook/components/bar"
    for command in (["wrenchbook"], ["python", "-m", "wrenchbook"]):
        checked = with_server.run(*command, "check", str(bundle))
        assert checked.returncode == 0, checked.stderr
        assert "ready to solve" in checked.stdout


def test_with_numpy_alone_the_client_a_download_and_the_conventions_work(
    with_numpy: Environment, address: str
):
    code = (
        "import sys, wrenchbook\n"
        "assert 'numpy' not in sys.modules, 'loaded before it was used'\n"
        "from wrenchbook import Client, ServerUnreachable, conventions\n"
        "print(conventions.to_drake([1, 2, 3, 4, 5, 6]).tolist())\n"
        "try:\n"
        "    Client('http://127.0.0.1:9').components()\n"
        "except ServerUnreachable as error:\n"
        "    print(error)\n"
        "scene = wrenchbook.Scene({'bar': {'force': [0, 0, 5], 'moment': [0, 0, 0]}})\n"
        "import pickle\n"
        "with Client(sys.argv[1]) as client:\n"
        "    table = client.download('bar')\n"
        "    cut = client.download('bar', scene=scene)\n"
        "    there = client.displacement('bar', [0, 0, -5], on_thin='estimate')\n"
        "here = pickle.loads(pickle.dumps(table)).answer([0, 0, -5])\n"
        "table.save('bar.wbt')\n"
        "opened = wrenchbook.Table.open('bar.wbt').answer([0, 0, -5])\n"
        "print(here.coverage == opened.coverage == there.coverage)\n"
        "print(cut.answer([0, 0, 5]).coverage == table.answer([0, 0, 5]).coverage)\n"
    )
    run = with_numpy.run("python", "-c", code, address)
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    assert lines[0] == "[4.0, 5.0, 6.0, 1.0, 2.0, 3.0]"
    assert "start a server with: wrenchbook serve" in lines[1]
    assert lines[2:] == ["True", "True"]


def test_the_command_without_the_servers_packages_says_what_to_install(with_numpy: Environment):
    run = with_numpy.run("wrenchbook", "serve")
    assert run.returncode == 1
    assert "pip install 'wrenchbook[server]'" in run.stderr
    assert "Traceback" not in run.stderr
