"""Every command prints JSON on stdout with --json, and all else on stderr."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from tests.service.client.joint_scenes import linear_table
from tests.service.stub_server import Answer, Stub
from tests.service.test_cli import EXTREMES, FILLED, QUEUED_NONE, RECORDED
from tests.service.test_client_calls import COVERED
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.cli.local import PROGRAMS
from wrenchbook.service.cli.main import app, main
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ledger import Ledger

Run = Callable[..., tuple[int, str]]
ROOT = Path(__file__).parents[2]

COVERAGE = {"method": "kriging", "method_reason": "", "axes": []}
COMPONENT = {"name": "plate", "rows": 7, "coverage": COVERAGE, "warnings": []}
IMPORTED = {"inserted": 1, "existing": 0, "errors": [], "dry_run": False}
REPORTED = {"state": "done", "fraction": 1.0, "message": ""}

SCENE = """<mujoco><worldbody><body name="base"><geom size="1"/><body name="tip"><geom size="1"/>
</body></body></worldbody></mujoco>"""
STIFF = linear_table().packed.content
COMMANDS = {
    "query": (["plate"], [COVERED]),
    "solve": (["plate"], [COVERED]),
    "deformed": (["plate", "FOLDER/part.glb"], [b"glTF"]),
    "fill": (["plate"], [FILLED, COMPONENT]),
    "report": (["plate"], [REPORTED, REPORTED, {"title": "plate"}]),
    "compliance": (["plate"], [{"matrix": []}]),
    "components": ([], [{"components": [COMPONENT]}]),
    "joint": (["plate", "FOLDER/scene.xml"], [COMPONENT]),
    "stiffness": (["plate"], [COMPONENT, STIFF]),
    "jobs": ([], [{"jobs": []}]),
    "audit": ([], [{"entries": []}]),
    "recording": (["plate"], [RECORDED]),
    "recording --start": (["plate"], [QUEUED_NONE]),
    "recording --clear": (["plate"], [{"cleared": 5}]),
    "envelope": (["plate"], [EXTREMES]),
    "envelope --start": (["plate"], [QUEUED_NONE]),
    "envelope --clear": (["plate"], [{"cleared": 5}]),
    "resolve": (["plate"], [QUEUED_NONE]),
    "import": (["plate", "FOLDER/table.csv"], [IMPORTED]),
    "export": (["plate", "FOLDER/out.csv"], [b"fx,fy\n"]),
    "withdraw": (["plate"], [COMPONENT]),
    "compare": (["plate"], [{"component": "plate", "compared": 0}]),
    "rig": (["list"], [{"rigs": []}]),
    "keys add": (["ann", "--data", "FOLDER"], []),
    "keys list": (["--data", "FOLDER"], []),
    "keys revoke": (["bob", "--data", "FOLDER"], []),
    "keys rotate": (["bob", "--data", "FOLDER"], []),
    "backup": (["FOLDER/kept.backup", "--data", "FOLDER/data"], []),
    "restore": (["FOLDER/whole.backup", "--data", "FOLDER/again"], []),
    "doctor": (["--data", "FOLDER/data"], []),
    "serve --show-settings": (["--data", "FOLDER/data"], []),
}
OTHERS = {
    "serve",
    "work",
    "demo",
    "plan",
    "check",
    "new",
    "condense",
    "converge",
}  # tests here, plan: test_cli


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield each command of a tree with its words."""
    children = getattr(command, "commands", None)
    if children is None:
        yield " ".join(path), command
    for word, child in (children or {}).items():
        yield from leaves(child, (*path, word))


@pytest.fixture
def run(
    stub: Stub, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    monkeypatch.setenv("WRENCHBOOK_SERVER", stub.url)

    def command(*texts: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["wrenchbook", *texts])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capfd.readouterr()
        return int(ended.value.code or 0), printed.out or printed.err

    return command


def test_every_command_has_the_option_json():
    tree = typer.main.get_command(app)
    names = [
        name
        for name, command in leaves(tree)
        if name not in PROGRAMS and not any("--json" in option.opts for option in command.params)
    ]
    assert names == []


def test_every_command_is_run_with_json_by_a_test():
    tree = {name for name, _ in leaves(typer.main.get_command(app))}
    run_here = {name.partition(" --")[0] for name in COMMANDS} | OTHERS
    assert tree - run_here == set()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "table.csv").write_text("fx,ux\n1,2\n")
    (tmp_path / "scene.xml").write_text(SCENE)
    Keyring(tmp_path).add("bob", "read")
    return tmp_path


@pytest.mark.parametrize("command", [name for name, (_, replies) in COMMANDS.items() if replies])
def test_a_command_of_a_server_prints_one_json_document(
    stub: Stub, run: Run, folder: Path, command: str
):
    texts, replies = COMMANDS[command]
    stub.answers(*(Answer(reply) for reply in replies or ()))
    given = [word.replace("FOLDER", str(folder)) for word in texts]
    status, out = run(*command.split(), *given, "--json")
    assert (status, type(json.loads(out))) in ((0, dict), (0, list))


def test_keys_are_printed_as_json(run: Run, folder: Path):
    where = "--data", str(folder), "--json"
    added = json.loads(run("keys", "add", "ann", *where)[1])
    assert (added["name"], added["scope"], bool(added["key"])) == ("ann", "write", True)
    assert [key["name"] for key in json.loads(run("keys", "list", *where)[1])] == ["ann", "bob"]
    assert json.loads(run("keys", "rotate", "ann", *where)[1])["key"] != added["key"]
    assert json.loads(run("keys", "revoke", "bob", *where)[1]) == {"name": "bob", "revoked": True}


def test_a_backup_and_its_restore_are_described_as_json(run: Run, tmp_path: Path):
    data, file, again = (str(tmp_path / name) for name in ("data", "whole.backup", "again"))
    assert json.loads(run("doctor", "--data", data, "--json")[1])["findings"] is not None
    Path(data).mkdir(exist_ok=True)
    Ledger(Path(data) / "ledger.sqlite").close()
    created = run("backup", file, "--data", data, "--json")
    assert json.loads(created[1])["file"] == file
    restored = json.loads(run("restore", file, "--data", again, "--json")[1])
    assert (restored["data"], restored["former"]) == (again, None)


def test_followed_jobs_are_a_json_document_a_line(stub: Stub, run: Run, monkeypatch):
    from wrenchbook.service.client import Client, Event

    happened = [Event("hello", {"boot": 1}, "1"), Event("job", {"id": 7, "status": "done"}, "2")]
    monkeypatch.setattr(Client, "events", lambda *_, **__: iter(happened))
    lines = run("jobs", "--follow", "--json")[1].splitlines()
    assert [json.loads(line)["event"] for line in lines] == ["hello", "job"]
    assert json.loads(lines[1])["id"] == 7
    assert stub.seen == []


def test_a_demo_prints_its_figures_as_json(run: Run, monkeypatch):
    figures = {"failed": None, "seconds": 1.5, "rows": 7}
    monkeypatch.setattr("wrenchbook.service.cli.demo.run", lambda *_: figures)
    assert (lambda status, out: (status, json.loads(out)))(*run("demo", "--json")) == (0, figures)


def test_a_check_of_a_bundle_is_printed_as_json(run: Run):
    bundle = ROOT / "data" / "components" / "plate_thin"
    status, out = run("check", str(bundle), "--json")
    assert (status, isinstance(json.loads(out), dict)) == (0, True)


def test_a_proposal_from_a_deck_is_printed_as_json(run: Run, tmp_path: Path):
    deck = ROOT / "tests" / "fea" / "cae" / "calculix.inp"
    status, out = run("new", str(deck), str(tmp_path / "new"), "--unit", "mm", "--json")
    assert (status, json.loads(out)["check"]["ok"]) == (0, True)


def test_settings_are_printed_as_json(run: Run, tmp_path: Path):
    shown = json.loads(run("serve", "--data", str(tmp_path), "--show-settings", "--json")[1])
    assert shown["data"] == {"value": str(tmp_path), "origin": "command line"}
    assert "as_json" not in shown


@pytest.mark.parametrize("command", [["serve", "--port", "0", "--solvers", "0"], ["work"]])
def test_a_server_prints_one_json_line_when_it_is_ready(tmp_path: Path, command: list[str]):
    words = [sys.executable, "-m", "wrenchbook", *command, "--data", str(tmp_path)]
    with subprocess.Popen([*words, "--json"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            ready = json.loads(process.stdout.readline())
            assert (ready["data"], ready["pid"]) == (str(tmp_path), process.pid)
            assert ("address" in ready) == (command[0] == "serve")
        finally:
            os.kill(process.pid, signal.SIGTERM)
        assert process.stdout.read() == ""


def test_a_condensed_part_tells_its_frames(run, tmp_path):
    out = tmp_path / "bar.npz"
    status, said = run("condense", str(SHIPPED / "bar"), str(out), "--modes", "3", "--json")
    assert status == 0
    result = json.loads(said)
    assert result["frames"] == ["base", "interface"]
    assert len(result["held"]) == 3
    with np.load(out) as arrays:
        assert arrays["stiffness"].shape == arrays["mass"].shape == (15, 15)
        assert result["free"][0] == pytest.approx(arrays["free"][0], rel=1e-5)


def test_a_study_of_finer_meshes_tells_order_and_limit(run, tmp_path):
    folder = tmp_path / "bar"
    shutil.copytree(SHIPPED / "bar", folder)
    page = tmp_path / "errors.html"
    status, said = run("converge", str(folder), "--plot", str(page), "--json")
    assert status == 0
    result = json.loads(said)
    assert result["outputs"][2] == "uz/Fz"
    assert len(result["values"]) == len(result["nodes"]) == 3
    assert result["order"][2] == pytest.approx(2, abs=0.5)
    assert result["extrapolated"][2] > result["values"][0][2]
    assert "cell size, mm" in page.read_text(encoding="utf-8")
