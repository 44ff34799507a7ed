"""The client commands: what they send, print, and say when something is wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.cli.main import main
from tests.service.stub_server import Answer, Stub, running_stub
from tests.service.test_client_calls import COVERED, QUEUED

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def stub() -> Iterator[Stub]:
    with running_stub() as running:
        yield running


@pytest.fixture
def run(stub: Stub, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.setenv("WRENCHBOOK_SERVER", stub.url)

    def command(*words: str) -> tuple[int, str, str]:
        """Run ``wrenchbook`` in this process; return status, output and errors, unwrapped."""
        monkeypatch.setattr(sys, "argv", ["wrenchbook", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, " ".join(printed.err.split())

    return command


def test_query_sends_what_its_options_say_and_prints_the_reply_as_json(stub: Stub, run: Run):
    stub.answers(Answer(COVERED))
    options = ("--force", "1", "2", "3", "--on-thin", "estimate", "--beyond-range", "--json")
    status, out, _ = run("query", "plate", *options)
    assert status == 0
    assert json.loads(out) == COVERED
    assert stub.seen[0].body["force"] == [1.0, 2.0, 3.0]
    assert stub.seen[0].body["beyond_range"] is True


def test_query_prints_why_there_is_no_job(stub: Stub, run: Run):
    stub.answers(Answer({**QUEUED, "job": None, "reason": "the queue is full"}, status=202))
    status, out, _ = run("query", "plate", "--on-thin", "queue")
    assert status == 0
    assert "the queue is full" in out


def test_query_and_solve_print_what_the_solver_says_of_its_answer(stub: Stub, run: Run):
    for command in ("query", "solve"):
        stub.answers(Answer({**COVERED, "notes": ["mesh: 3 cells are [strongly] distorted"]}))
        status, out, _ = run(command, "plate")
        assert status == 0
        assert "3 cells are [strongly] distorted" in " ".join(out.split())


def test_a_refusal_is_one_message_with_each_mistake_and_status_1(stub: Stub, run: Run):
    problem = {
        "title": "The request is not of this call's form",
        "detail": "Nothing was changed.",
        "errors": [{"loc": "method", "msg": "unknown method 'nope'"}],
    }
    stub.answers(Answer(problem, status=422, kind="application/problem+json"))
    status, _, says = run("query", "plate", "--method", "nope")
    assert status == 1
    assert says == (
        "The request is not of this call's form Nothing was changed. method: unknown method 'nope'"
    )


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("query", "bar", "--server", "127.0.0.1:9"), 1, "start a server with: wrenchbook serve"),
        (("solve", "bar", "--server", "127.0.0.1:9"), 1, "start a server with: wrenchbook serve"),
        (("query", "bar", "--server", "ftp://x"), 1, "write http://127.0.0.1:8000"),
        (("query", "bar", "--force", "nan", "0", "0"), 1, "fx is nan, not finite"),
        (("query", "bar", "--on-thin", "maybe"), 1, "on_thin must be one of queue, wait"),
        (("query", "bar", "--force", "1", "2"), 2, "'--force' requires 3 arguments"),
        (("fill", "bar", "--translation", "1e-6"), 2, "--translation and --rotation together"),
        (("qeury", "bar"), 2, "No such command 'qeury'"),
    ],
)
def test_a_slip_on_the_command_line_is_named_and_nothing_is_sent(
    stub: Stub, run: Run, words: tuple[str, ...], code: int, says: str
):
    status, out, errors = run(*words)
    assert (status, out) == (code, "")
    assert says in errors
    assert "Traceback" not in errors
    assert stub.seen == []


def test_help_names_the_command_and_not_the_file_that_was_run():
    face = Path(__file__).parents[2] / "wrenchbook.py"
    run = subprocess.run(
        [sys.executable, "-P", str(face), "query", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Usage: wrenchbook query [OPTIONS]" in run.stdout


def test_a_unit_in_brackets_is_printed_and_not_taken_for_a_colour(stub: Stub, run: Run):
    problem = {
        "title": "The table has mistakes",
        "status": 422,
        "detail": "the first is in row 1, Fz [lbx]: the unit [lbx] is not known",
        "errors": [{"loc": "row 1.Fz [lbx]", "msg": "the unit [lbx] is not known"}],
    }
    stub.answers(Answer(problem, status=422))
    status, _, err = run("query", "plate", "--force", "1", "2", "3")
    assert status == 1
    assert err.count("Fz [lbx]: the unit [lbx] is not known") == 2


def test_fill_sends_the_range_and_the_outputs_that_are_wanted(stub: Stub, run: Run):
    stub.answers(
        Answer({"component": "plate", "jobs": [], "stage": "met", "reason": "thick enough"}),
        Answer({"name": "plate", "rows": 7}),
    )
    force = ("--force-range", "-1", "1", "0", "0", "-50", "-20")
    moment = ("--moment-range", "0", "0", "-3", "3", "0", "0")
    status, out, _ = run("fill", "plate", *force, *moment, "--output", "uz", "--output", "rx")
    assert status == 0
    sent = stub.seen[0].body
    assert sent["range"] == {
        "force": [[-1, 1], [0, 0], [-50, -20]],
        "moment": [[0, 0], [-3, 3], [0, 0]],
    }
    assert sent["outputs"] == ["uz", "rx"]
    assert "thick enough" in out


def test_fill_wants_both_ranges_or_none(stub: Stub, run: Run):
    status, _, says = run("fill", "plate", "--force-range", "-1", "1", "0", "0", "-50", "-20")
    assert status == 2
    assert "--force-range and --moment-range together" in says
    assert stub.seen == []


def test_query_with_derivatives_asks_for_them_and_prints_them(stub: Stub, run: Run):
    told = [[1e-9 * (6 * row + column) for column in range(6)] for row in range(6)]
    stub.answers(Answer({**COVERED, "derivative": told}))
    status, out, _ = run("query", "plate", "--force", "1", "2", "3", "--derivatives", "--json")
    assert status == 0
    assert stub.seen[0].body["derivatives"] is True
    assert json.loads(out)["derivative"] == told
