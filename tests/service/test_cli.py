"""The client commands: what they send, print, and say when something is wrong."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
import typer
from rich.console import Console
from rich.table import Table

import wrenchbook
from tests.refusals import assert_told, cases
from tests.service.live import served
from tests.service.stub_server import Answer, Stub
from tests.service.test_client_calls import COVERED, QUEUED
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.cli import demo
from wrenchbook.service.cli.jobs import event_line
from wrenchbook.service.cli.main import main
from wrenchbook.service.cli.progress import Pace, _bar, cancelled_on_interrupt
from wrenchbook.service.cli.render import Screen, answer_shown, matrix_table
from wrenchbook.service.cli.tables import rig_line
from wrenchbook.service.client import (
    Client,
    Displacement,
    Event,
    Job,
    ProblemError,
    ServerUnreachable,
)
from wrenchbook.service.contract import LOADS, OUTPUTS, counted
from wrenchbook.service.workers import private
from wrenchbook.service.workers.supervisor import in_use

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(stub: Stub, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.setenv("WRENCHBOOK_SERVER", stub.url)

    def command(*texts: str) -> tuple[int, str, str]:
        """Run ``wrenchbook`` in this process; return status, output and errors, unwrapped."""
        monkeypatch.setattr(sys, "argv", ["wrenchbook", *texts])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capfd.readouterr()
        return int(ended.value.code or 0), printed.out, " ".join(printed.err.split())

    return command


RECORDED = {
    "total": 5, "kept": 2, "merged": 2, "thinned": 1, "outside": 1, "within": 0.25,
    "reason": "1 wrenches were thinned out", "wrenches": [[1.0] * 6, [2.0] * 6],
}  # fmt: skip
EXTREMES = {
    "count": 5, "min": [-1.5] * 6, "max": [2.5] * 6, "at_min": [[-1.5] * 6] * 6,
    "at_max": [[2.5] * 6] * 6, "displacement_bound": [1e-5] * 6, "negligible": None,
    "bound": {"kind": "estimate", "formula": "f", "coverage": "thin"}, "reason": "no proof",
}  # fmt: skip
QUEUED_NONE = {
    "jobs": [], "solved": 3, "covered": 2, "failed": 0, "beyond_range": 0, "left": 0,
    "reason": "the table covers all of them",
}  # fmt: skip
FILLED = {
    "component": "plate", "jobs": [], "stage": "met", "reason": "thick enough", "rows": 7,
    "coverage": "covered",
}  # fmt: skip
REPLIES = {
    "COVERED": COVERED, "QUEUED": QUEUED, "RECORDED": RECORDED, "EXTREMES": EXTREMES,
    "QUEUED_NONE": QUEUED_NONE, "FILLED": FILLED, "": {},
}  # fmt: skip
COMMANDS = tomllib.loads(Path(__file__).with_name("commands.toml").read_text(encoding="utf-8"))


def reply_of(case: dict[str, Any]) -> Answer:
    body = {**REPLIES[case.get("as", "")], **case.get("with", {})}
    body |= dict.fromkeys(case.get("none", ()))
    return Answer(body, case.get("status", 200), case.get("kind", "application/json"))


@pytest.mark.parametrize("case", COMMANDS.values(), ids=COMMANDS.keys())
def test_a_command_sends_what_it_is_given_and_prints_the_reply(
    stub: Stub, run: Run, case: dict[str, Any]
):
    replies = [reply_of(reply) for reply in case["replies"]]
    stub.answers(*replies)
    status, out, err = run(*case["argv"].split())
    assert status == case.get("status", 0), err
    for seen, sent in zip(stub.seen, case.get("sent", ()), strict="sent" in case):
        body = seen.body if seen.content else {}
        assert seen.method == sent.get("method", seen.method)
        assert seen.path == sent.get("path", seen.path)
        assert body | sent.get("body", {}) == body
        assert not set(sent.get("without", ())) & body.keys()
    shown = " ".join(out.split())
    assert [words for words in case.get("out", ()) if words not in shown] == []
    assert [words for words in case.get("err", ()) if words not in err] == []
    assert [words for words in case.get("absent", ()) if words in shown] == []
    if "json" in case:
        assert json.loads(out) == replies[0].body


def test_an_import_names_the_rig_or_the_point_of_its_moments():
    unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    rig = {"name": "b83e6161", "left_handed": False, "frame": unit, "load_cell": "moving"}
    point = "Moments were taken about the moving interface point (--load-cell moving)."
    assert rig_line(rig) == point
    named = rig_line(rig | {"name": "press", "load_cell": None})
    assert named == "Readings were taken to the interface from rig press, right-handed."


@cases(__file__, "cli")
def test_a_slip_on_the_command_line_is_named_and_nothing_is_sent(
    stub: Stub, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: dict[str, Any]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "1000")
    files = case.get("files", {})
    for name, text in files.items():
        Path(name).write_text(text)
    for name, value in case.get("env", {}).items():
        monkeypatch.setenv(name, value)
    status, out, errors = run(*case["argv"].replace("SHIPPED", str(SHIPPED)).split())
    said, quiet = (" ".join(out.split()), errors) if "stdout" in case else (errors, out)
    assert (status, quiet) == (case["status"], "")
    assert_told(case, [said])
    assert "Traceback" not in said
    assert stub.seen == []
    assert {path.name for path in tmp_path.iterdir()} == set(files)


def test_help_names_the_command_and_not_the_file_that_was_run():
    run = subprocess.run(
        [sys.executable, "-P", "-m", "wrenchbook", "query", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Usage: wrenchbook query [OPTIONS]" in run.stdout


def test_plan_sends_the_scene_of_a_file_and_prints_what_is_left_out(
    stub: Stub, run: Run, tmp_path: Path
):
    one = {
        "decision": "table", "reason": "it bends", "loads": ["fz"], "outputs": ["uz"],
        "axes": {"z": {"inputs": ["fz"], "dimensions": 1}},
        "displacement_bound": [None, None, 2e-3, None, None, None],
        "solves": {"whole": 15, "scene": 5},
        "saves": {"build_s": 0.5, "memory_bytes": 2_000_000, "us_per_answer": -1.0},
        "saves_from": {"build_s": "measured", "memory_bytes": "counted"},
        "tolerance": {"translation": 1e-5, "rotation": 1e-5}, "table_version": 3,
    }  # fmt: skip
    file = tmp_path / "scene.toml"
    file.write_text("[components.plate]\nforce = [0, 0, 5]\nmoment = [0, 0, 0]\n")
    stub.answers(Answer({"components": {"plate": one}}))
    status, out, _ = run("plan", str(file))
    assert status == 0
    assert stub.seen[0].body["components"]["plate"]["force"] == [[0, 0], [0, 0], [-5, 5]]
    for reported in ("z: fz, 1-D", "uz 0.002 m", "5 of 15", "0.5 s", "2 MB", "plate: it bends."):
        assert reported in out
    assert "µs an answer" not in out  # a loss is no saving
    for heading in ("component", "decision", "axes: loads", "moves at most", "solves", "saves"):
        assert heading in out  # no heading is cut in a terminal of 80 columns
    stub.answers(Answer({"components": {"plate": one}}))
    status, out, _ = run("plan", str(file), "--json")
    assert json.loads(out) == {"components": {"plate": one}}
    file.write_text("[components.plate]\nforce = 5\n")
    status, _, err = run("plan", str(file))
    assert status == 1
    assert "but must have three loads" in err


def test_audit_in_a_narrow_terminal_breaks_no_time(stub: Stub, run: Run):
    entry = {
        "id": 7, "time": "2026-11-28T01:08:25+00:00", "actor": "user:somebody@example.org",
        "action": "component.replace", "component": "bracket_of_the_left_arm", "object": "serve",
    }  # fmt: skip
    stub.answers(Answer({"entries": [entry]}))
    _, out, _ = run("audit")
    assert str(entry["time"]) in out


def test_a_matrix_in_a_narrow_terminal_has_all_characters_of_its_numbers(capsys):
    lines = [[-1.2345e-11 * (k + 1)] * 6 for k in range(6)]
    names = ["ux", "uy", "uz", "rx", "ry", "rz"]
    Console(width=80).print(matrix_table("stiffness", names, names, lines))
    shown = capsys.readouterr().out
    assert shown.count("-1.23e-11") == 6
    assert "…" not in shown


def test_compliance_shows_the_tangent_at_zero_load_and_beside_it_the_mean(stub: Stub, run: Run):
    reported = {
        "tangent": [[3.0e-6, None, *[1e-9] * 4], *[[0.0] * 6] * 5], "tangent_origin": "kriging",
        "matrix": [[2.17e-6, 0.0, *[1e-9] * 4], *[[0.0] * 6] * 5], "origin": "fitted",
        "known_loads": ["fx", "fz", "mx", "my", "mz"],
        "columns": [f"{load} [N]" for load in LOADS], "rows": [f"{name} [m]" for name in OUTPUTS],
    }  # fmt: skip
    stub.answers(Answer(reported))
    status, out, _ = run("compliance", "plate")
    assert status == 0
    assert out.index("tangent at zero load (kriging)") < out.index("3.00e-06")
    assert out.index("mean over the load range (fitted)") < out.index("2.17e-06")
    assert len([line for line in out.splitlines() if " - " in line]) == 7
    stub.answers(Answer(reported))
    assert json.loads(run("compliance", "plate", "--json")[1]) == reported


def test_the_command_line_tells_its_version(run: Run):
    assert run("--version")[1] == f"wrenchbook {wrenchbook.__version__}\n"


def test_import_sends_a_lag_and_prints_what_the_logs_show(stub: Stub, run: Run, tmp_path: Path):
    for name in ("loads.csv", "moved.csv"):
        (tmp_path / name).write_text("time [s]")
    clock = {"applied_s": 0.351, "lag_s": 0.351, "uncertainty_s": 0.002}
    counts = {"read": 9, "loaded": 9, "refused": 0, "tare": 0, "unmatched": 0}
    empty = {key: [] for key in ("errors", "causes", "findings", "ignored", "above", "sheets")}
    reply = {"inserted": 9, "existing": 0, **empty, "rig": None, "dry_run": False, "format": "csv"}
    stub.answers(Answer({**reply, "in_use": True, "rows": counts, "clock": clock}))
    logs = (str(tmp_path / "loads.csv"), "--displacements", str(tmp_path / "moved.csv"))
    status, out, _ = run("import", "plate", *logs, "--lag", "auto")
    assert status == 0
    assert "time_offset_s=auto" in stub.seen[0].path
    assert "Lag of the displacements: 0.351 +- 0.002 s; 0.351 s is applied." in " ".join(
        out.split()
    )


def test_import_says_that_a_workbook_by_its_ending_is_text(stub: Stub, run: Run, tmp_path: Path):
    file = tmp_path / "rows.xlsx"
    file.write_text("fx [N],ux [mm]")
    counts = {"read": 9, "loaded": 9, "refused": 0, "tare": 0, "unmatched": 0}
    empty = {key: [] for key in ("errors", "causes", "findings", "ignored", "above", "sheets")}
    reply = {"inserted": 9, "existing": 0, **empty, "rig": None, "dry_run": False, "format": "csv"}
    stub.answers(Answer({**reply, "in_use": True, "rows": counts, "clock": None}))
    out = " ".join(run("import", "plate", str(file))[1].split())
    assert "rows.xlsx was read as CSV: its content is text, whatever its ending." in out


def test_a_lag_that_is_refused_has_the_name_of_its_option(stub: Stub, run: Run, tmp_path: Path):
    (tmp_path / "loads.csv").write_text("time [s]")
    detail = "time_offset_s: needs two logs"
    problem = {"type": "urn:x", "title": "Refused", "status": 422, "detail": detail}
    stub.answers(Answer(problem, 422, "application/problem+json"))
    _, _, err = run("import", "plate", str(tmp_path / "loads.csv"), "--lag", "auto")
    assert "--lag: needs two logs" in err


def test_a_refused_import_names_the_options_of_the_command_line(run: Run, tmp_path: Path):
    (tmp_path / "loads.csv").write_text("fz [N],ux [m]\n1,2\n")
    load_range = {"force": [9.0] * 3, "moment": [9.0] * 3}
    with served(tmp_path / "data") as client:
        client.add_component({"name": "rig", "title": "rig", "range": load_range})
        file = str(tmp_path / "loads.csv")
        status, _, err = run("import", "rig", file, "--server", client.url)
    assert status == 1
    assert "missing_loads=zero (--missing-loads-zero)" in " ".join(err.split())


def completions(monkeypatch: pytest.MonkeyPatch, text: str) -> list[str]:
    """Run a shell's completion of the last word in a process, and return the candidates."""
    monkeypatch.setenv("_WRENCHBOOK_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"wrenchbook {text}")
    monkeypatch.setenv("COMP_CWORD", str(len(text.split())))
    run = subprocess.run(
        [sys.executable, "-P", "-m", "wrenchbook"], capture_output=True, text=True, check=False
    )
    assert run.stderr == ""
    return run.stdout.split()


def test_a_shell_completes_the_components_of_the_server(stub: Stub, monkeypatch):
    stub.answers(Answer({"components": [{"name": "plate"}, {"name": "bar"}]}))
    assert completions(monkeypatch, f"query --server {stub.url} pl") == ["plate"]


def test_a_shell_completes_the_components_of_a_data_directory(monkeypatch, tmp_path: Path):
    assert "plate_thin" in completions(monkeypatch, f"export --data {tmp_path} plate_")


def test_a_completion_without_a_server_is_empty_and_quiet(monkeypatch):
    assert completions(monkeypatch, "query --server http://127.0.0.1:9 p") == []


@pytest.mark.parametrize(
    "text", ["\x1b]0;mine\x07", "\x1b[2J", "a\x00b", "\x9b2J", "\u202egpj.exe"]
)
def test_a_text_of_others_steers_no_terminal(text):
    screen = Screen(file=io.StringIO(), width=60, force_terminal=True)
    table = Table("title")
    table.add_row(text)
    screen.print(table)
    screen.print(text, markup=False, highlight=False, style="red")
    reported = screen.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert text not in reported
    assert reported.count("\N{REPLACEMENT CHARACTER}") >= 2


MARKED = "[bold]plate[/] :smile:"


def test_markup_in_a_text_is_printed_literally():
    screen = Screen(file=io.StringIO(), width=60)
    table = Table(MARKED, title=MARKED)
    table.add_row(MARKED)
    screen.print(MARKED, table)
    assert screen.file.getvalue().count(MARKED) == 4  # pyright: ignore[reportAttributeAccessIssue]


def test_markup_in_the_note_of_a_bar_is_printed_literally():
    screen = Screen(file=io.StringIO(), width=120)
    with _bar(screen) as progress:
        progress.add_task("solving", note=MARKED)
    assert MARKED in screen.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]


def test_a_demonstration_has_styles_and_no_markup(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(private, "private_server", lambda *_: nullcontext(MagicMock()))
    monkeypatch.setattr(demo, "_ask_an_empty_table", lambda *_: MARKED)
    screen = Screen(file=io.StringIO(), width=120)
    demo.run(screen)
    reported = screen.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert reported.replace(MARKED, "").count("[") == 0
    assert f"The demonstration failed: {MARKED}" in reported


def test_the_reason_of_an_answer_steers_no_terminal():
    answer = Displacement.read(COVERED | {"reason": "\x1b]0;mine\x07", "method": "\x1b[2J"})
    screen = Screen(file=io.StringIO(), width=60, force_terminal=True)
    screen.print(answer_shown(answer))
    reported = screen.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert "\N{REPLACEMENT CHARACTER}]0;mine" in reported
    assert "\N{REPLACEMENT CHARACTER}[2J" in reported


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_a_pace_says_solves_a_minute_and_the_time_left():
    clock = Clock()
    pace = Pace(100, clock)
    assert pace.note() == ""
    clock.now, pace.ended = 30.0, 20
    assert pace.note() == "40 solves/min, at most 2 min left"
    assert pace.note(in_round=5) == "50 solves/min, at most 2 min left"
    clock.now, pace.ended = 60.0, 60
    assert pace.note() == "60 solves/min, at most 40 s left"


def test_events_are_told_in_words():
    job = {"id": 3, "component": "plate", "status": "running"}
    running = Event("job", job | {"progress": {"fraction": 0.5, "message": "step 2"}})
    failed = Event("job", job | {"status": "failed", "error": {"kind": "k", "message": "m"}})
    done = Event("job", job | {"status": "done", "row": 9, "error": None})
    assert event_line(running) == "job 3 of plate: running, 50% step 2"
    assert event_line(failed) == "job 3 of plate: failed, k: m"
    assert event_line(done) == "job 3 of plate: done, row 9"
    table = {"component": "plate", "table_version": 4, "rows": 4}
    assert event_line(Event("table", table)) == "plate: table version 4, 4 rows"
    assert event_line(Event("hello", {"tables": {}})) == ""


def test_followed_jobs_are_listed_and_then_told_a_line_an_event(stub: Stub, run: Run, monkeypatch):
    job = {"id": 7, "component": "plate", "status": "done", "row": 9, "error": None}
    happened = [Event("hello", {"tables": {}}), Event("job", job)]
    monkeypatch.setattr(Client, "events", lambda *_, **__: iter(happened))
    waiting = {"id": 8, "component": "plate", "status": "waiting", "attempt": 1}
    loads = {"force": [1, 2, 3], "moment": [0, 0, 0]}
    stub.answers(Answer({"jobs": [waiting | loads]}), Answer({"jobs": []}))
    status, out, _ = run("jobs", "--follow")
    assert (status, "waiting" in out) == (0, True)
    assert "job 7 of plate: done, row 9" in out


def test_a_job_that_starts_between_the_two_lists_of_followed_jobs_is_listed_once(
    stub: Stub, run: Run, monkeypatch
):
    """It was in neither list."""
    monkeypatch.setattr(Client, "events", lambda *_, **__: iter([Event("hello", {"tables": {}})]))
    job = {"id": 8, "component": "plate", "attempt": 1, "force": [1, 2, 3], "moment": [0, 0, 0]}

    def respond(seen) -> Answer:
        status = "waiting" if len(stub.seen) == 1 else "running"
        return Answer({"jobs": [job | {"status": status}] if status in seen.path else []})

    stub.respond = respond
    _, out, _ = run("jobs", "--follow")
    assert (out.count("plate"), "running" in out) == (1, True)


def test_the_file_of_a_comparison_is_of_the_table_that_is_shown(
    stub: Stub, run: Run, tmp_path: Path
):
    first, second = ({"component": "plate", "table_version": number} for number in (1, 2))
    csv = [Answer(text, kind="text/csv") for text in (b"of version 2", b"again")]
    stub.answers(Answer(first), csv[0], Answer(second), csv[1], Answer(second))
    file = tmp_path / "rows.csv"
    _, out, _ = run("compare", "plate", "--csv", str(file), "--json")
    assert json.loads(out)["table_version"] == 2
    assert file.read_text() == "again"


# -- Ctrl-C --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_cancel_the_solves_of_a_fill_and_no_others(
    tmp_path: Path, ending: signal.Signals
):
    """A fill that was interrupted left its solves in the queue."""
    with served(tmp_path) as client:
        other = client.solve("plate", [1, 2, -3], [0, 0, 0]).job
        assert other is not None
        # A shell starts its background commands with SIGINT ignored, and children inherit it.
        words = ["env", "--default-signal=INT", sys.executable, "-P", "-m", "wrenchbook"]
        words += ["fill", "plate", "--budget", "3"]
        words += ["--server", client.url]
        with subprocess.Popen(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as command:
            assert command.stdout is not None
            assert command.stdout.readline() == "choosing wrenches for plate\n"
            assert command.stdout.readline()  # the round: its solves are queued
            command.send_signal(ending)
            _, errors = command.communicate(timeout=600)
        states = {job.id: job.status for job in client.jobs("plate")}
        assert states.pop(other.id) == "waiting"
        assert set(states.values()) == {"cancelled"}
        assert command.returncode == 130
        assert " ".join(errors.split()) == (
            f"Interrupted: {counted(len(states), 'solve')} of this command cancelled."
        )


def test_sigterm_ends_the_temporary_server_of_a_command_too(tmp_path: Path):
    words = [sys.executable, "-P", "-m", "wrenchbook", "fill", "plate", "--data", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as command:
        assert command.stdout is not None
        assert command.stdout.readline() == b"choosing wrenches for plate\n"
        assert in_use(tmp_path)
        command.terminate()
        command.communicate(timeout=600)
    assert not in_use(tmp_path)


def test_ctrl_c_while_the_server_stops_says_that_solves_were_not_cancelled(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    job = Job.read({"id": 8, "component": "plate", "status": "waiting", "attempt": 1, "new": True})
    calls = []

    def cancel(_: Client, cancelled: Job) -> Job:
        calls.append(cancelled)
        if len(calls) == 1:
            return replace(cancelled, status="cancelled")
        raise ServerUnreachable("nothing answers at http://127.0.0.1:1")

    monkeypatch.setattr(Client, "cancel", cancel)
    with (
        pytest.raises(typer.Exit) as ended,
        cancelled_on_interrupt(Client("http://127.0.0.1:1"), [job] * 3),
    ):
        raise KeyboardInterrupt
    assert (ended.value.exit_code, len(calls)) == (130, 2)
    assert " ".join(capfd.readouterr().err.split()) == (
        "Interrupted: 1 solve of this command cancelled; the others were not cancelled: the "
        "server does not answer: nothing answers at http://127.0.0.1:1."
    )


def test_ctrl_c_says_why_the_server_refuses_to_cancel_a_job_that_has_not_ended(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    job = Job.read({"id": 8, "component": "plate", "status": "waiting", "attempt": 1, "new": True})
    refusals = [ProblemError(409, "Job has ended"), ProblemError(403, "Read only", "Ask ann.")]

    def cancel(*_: object) -> Job:
        raise refusals.pop(0)

    monkeypatch.setattr(Client, "cancel", cancel)
    with (
        pytest.raises(typer.Exit) as ended,
        cancelled_on_interrupt(Client("http://127.0.0.1:1"), [job] * 3),
    ):
        raise KeyboardInterrupt
    assert (ended.value.exit_code, refusals) == (130, [])
    said = " ".join(capfd.readouterr().err.split())
    assert said.startswith("Interrupted: 0 solves of this command cancelled; the others were not")
    assert "Ask ann." in said


def test_a_package_that_is_missing_is_named_with_its_installation(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for module in (
        *("joint.mujoco_model", "joint.mujoco_joint", "joint.mujoco_scene"),
        "mujoco",
    ):  # another test may have imported them
        monkeypatch.delitem(sys.modules, f"wrenchbook.service.client.{module}", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    status, _, error = run("joint", "bar", str(tmp_path / "arm.xml"))
    assert status == 1
    assert "pip install 'wrenchbook[mujoco]'" in error


def test_an_envelope_without_wrenches_shows_a_dash_for_each_unknown_number(
    run: Run, stub: Stub
) -> None:
    """It showed nan, and no other command does."""
    unknown = [None] * 6
    empty = {"count": 0, "min": unknown, "max": unknown, "displacement_bound": unknown}
    empty |= {"negligible": None, "reason": "no wrench has come yet", "bound": {"kind": "unknown"}}
    empty |= {"inputs": [*LOADS], "outputs": [*OUTPUTS]}
    stub.answers(Answer(empty))
    _, out, _ = run("envelope", "plate")
    assert "nan" not in out
    assert out.count("- ") >= 18
