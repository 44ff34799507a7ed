"""The public face: what it loads, and that the rooms beside it are the ones that run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import wrenchbook
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.files.program import child_command

ROOT = Path(__file__).parents[1]


def run_beside_strangers(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder whose own fea, surrogate and service are on PYTHONPATH."""
    for room in ("fea", "surrogate", "service"):
        (folder / room).mkdir()
        (folder / room / "__init__.py").write_text("raise RuntimeError('a stranger')\n")
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_a_name_is_loaded_when_it_is_first_used_and_not_before():
    code = (
        "import sys, wrenchbook\n"
        "print('numpy' in sys.modules, 'wrenchbook.service' in sys.modules)\n"
        "wrenchbook.conventions.to_ros([0] * 6), wrenchbook.Client\n"
        "print(sorted(name for name in sys.modules if name in ('fea', 'surrogate', 'service')))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert run.stdout.split("\n")[:2] == ["False False", "[]"]


def test_a_name_that_is_not_there_is_answered_with_those_that_are():
    with pytest.raises(AttributeError, match=r"has no 'client_'; it has AsyncClient, Client"):
        _ = wrenchbook.client_  # pyright: ignore[reportAttributeAccessIssue]


def test_a_child_process_runs_our_rooms_though_strangers_come_first_on_the_path(tmp_path: Path):
    run = run_beside_strangers(
        child_command("wrenchbook.fea.check", "--json", str(SHIPPED / "bar")), tmp_path
    )
    assert run.returncode == 0, run.stderr
    assert '"ok": true' in run.stdout


def test_the_installed_command_runs_from_any_folder(tmp_path: Path):
    """An editable install had a copy of the public face, which found no packages beside it."""
    command = [str(Path(sys.executable).with_name("wrenchbook")), "--version"]
    environment = {name: word for name, word in os.environ.items() if name != "PYTHONPATH"}
    run = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stdout) == (0, f"wrenchbook {wrenchbook.__version__}\n"), run.stderr


@pytest.mark.parametrize("package", ["fea", "surrogate", "service"])
def test_a_package_is_imported_below_wrenchbook_alone(package: str):
    """A second copy under its bare name had errors that no handler of the first one caught."""
    run = subprocess.run(
        [sys.executable, "-c", f"import {package}"], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 1
    assert f"import wrenchbook.{package}" in run.stderr


def test_every_child_process_is_started_by_its_modules_name():
    files = [
        path
        for package in ("fea", "surrogate", "service")
        for path in (ROOT / package).rglob("*.py")
        if path != ROOT / "surrogate/kernel/build.py"  # runs ziglang
    ]
    starters = {path.name for path in files if "sys.executable" in path.read_text(encoding="utf-8")}
    assert starters == {"meshing.py", "program.py", "sandbox.py"}
