"""The log: one line an event, with the job's number, for people or for programs."""

import io
import json
import logging

import pytest

from wrenchbook.service.files.redact import redact, redact_values
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ops.logs import JsonLines, TextLines


@pytest.fixture
def lines(request):
    """What is logged from here on, by line."""
    stream = io.StringIO()
    shown = logging.StreamHandler(stream)
    shown.setFormatter(JsonLines())
    log = logging.getLogger("wrenchbook.service")
    before = log.level
    log.addHandler(shown)
    log.setLevel(logging.DEBUG)
    yield lambda: [json.loads(line) for line in stream.getvalue().splitlines()]
    log.removeHandler(shown)
    log.setLevel(before)


def test_the_end_of_each_job_is_a_line_with_its_number(lines, tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    done, _ = ledger.accept("rig", "f", [1.0] * 6)
    ledger.accept("rig", "f", [2.0] * 6)
    job = ledger.claim("me")
    row = ledger.commit(job.id, job.attempt, [0.0] * 6)
    job = ledger.claim("me")
    ledger.fail(job.id, job.attempt, {"kind": "died", "message": "a\nb", "remedy": ""})
    ledger.close()
    found = {(one["job"], one["level"]): one for one in lines() if "job" in one}
    ended = found[done.id, "info"]
    assert f"row {row.seq}" in ended["message"]
    assert (ended["component"], ended["attempt"]) == ("rig", 1)
    assert "died" in found[job.id, "warning"]["message"]


def record(message, *arguments, **extra):
    return logging.makeLogRecord(
        {"name": "a", "levelname": "INFO", "msg": message, "args": arguments, **extra}
    )


def test_no_message_makes_a_second_line():
    for form in (JsonLines(), TextLines()):
        assert len(form.format(record("%s", "a\nERROR root: forged\r\n")).splitlines()) == 1


def test_a_traceback_is_part_of_its_line_in_json():
    try:
        raise ValueError("why")
    except ValueError as error:
        told = record("failed", exc_info=(ValueError, error, error.__traceback__))
    line = json.loads(JsonLines().format(told))
    assert "ValueError: why" in line["exception"]


def test_a_line_ends_where_it_would_be_too_long_to_be_carried():
    assert len(JsonLines().format(record("x" * 10**6))) < 30_000


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "not written to /tmp/data/components: full",
            "not written to .../components: full",
        ),
        ("'/usr/lib/python3/json.py' line 3", "'.../json.py' line 3"),
        ("POST /v1/components/plate/table failed", "POST /v1/components/plate/table failed"),
        ("12 N/m and m/s, /health/ready", "12 N/m and m/s, /health/ready"),
        ("http://host/tmp/x", "http://host/tmp/x"),
        (
            'Traceback (most recent call last):\n  File "/usr/y.py"\n    f()\nValueError: bad',
            "ValueError: bad",
        ),
    ],
)
def test_paths_of_the_machine_lose_their_folders_and_nothing_else_does(text, told):
    assert redact(text) == told


def test_every_text_of_a_reply_is_looked_at():
    assert redact_values({"a": ["/tmp/x/y", 1, None, {"b": "/usr/lib/z"}]}) == {
        "a": [".../y", 1, None, {"b": ".../z"}]
    }
