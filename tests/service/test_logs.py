"""The log: request ids in replies and lines, the access log, one line an event."""

import io
import json
import logging

import pytest
from starlette.testclient import TestClient

from tests.service.ledger_rows import claim
from wrenchbook.service.files.redact import redact, redact_values
from wrenchbook.service.http.app import create_app
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ops.logs import JsonLines, Repeats, TextLines, add_request_id
from wrenchbook.service.workspace import Settings

CALL = "/v1/components/spring/displacement"
QUERY = {"force": [0, 0, -5], "on_thin": "estimate"}


@pytest.fixture
def lines(caplog):
    """What is logged from here on, by line."""
    stream = io.StringIO()
    shown = logging.StreamHandler(stream)
    shown.addFilter(add_request_id)
    shown.setFormatter(JsonLines())
    caplog.set_level(logging.DEBUG, "wrenchbook.service")
    logging.getLogger().addHandler(shown)
    yield lambda: [json.loads(line) for line in stream.getvalue().splitlines()]
    logging.getLogger().removeHandler(shown)


@pytest.fixture
def crashing(folder, stand_in, monkeypatch):
    def crash(*_):
        logging.getLogger("wrenchbook.service").error("about to fail")
        raise ZeroDivisionError

    monkeypatch.setattr("wrenchbook.service.http.routes.jobs.job_body", crash)
    app = create_app(Settings(folder, solvers=0))
    with TestClient(app, raise_server_exceptions=False) as client:
        client.post("/v1/components/spring/solve", json={"force": [0, 0, -5]})
        yield client


def test_a_reply_names_the_id_of_its_request_as_given(http):
    given = {"X-Request-ID": "!a-7~" * 25}
    assert http.get("/v1/jobs", headers=given).headers["x-request-id"] == given["X-Request-ID"]
    assert http.get("/nothing", headers=given).headers["x-request-id"] == given["X-Request-ID"]
    assert http.post(CALL, json=QUERY, headers=given).headers["x-request-id"] == "!a-7~" * 25


@pytest.mark.parametrize("given", [None, "", "a b", "x" * 129, "\u00e4", "a\tb"])
def test_an_id_that_no_log_line_should_carry_is_replaced(http, given):
    headers = {} if given is None else {"X-Request-ID": given.encode("latin-1")}
    created = [http.get("/v1/jobs", headers=headers).headers["x-request-id"] for _ in range(2)]
    assert created[0] != created[1]
    assert all(len(item) == 16 and item.isalnum() for item in created)


def test_a_fault_that_lasts_is_logged_once_a_minute(monkeypatch):
    """A full disk was 14 lines a second."""
    now, repeats = [0.0], Repeats()
    monkeypatch.setattr("wrenchbook.service.ops.logs.time.monotonic", lambda: now[0])
    lines = [
        ("full", "WARNING", 0),
        ("full", "WARNING", 1),
        ("done", "INFO", 2),
        ("done", "INFO", 3),
    ]
    lines += [("full", "ERROR", 59), ("full", "WARNING", 60)]
    logged = []
    for text, level, now[0] in lines:
        record = logging.LogRecord("a", getattr(logging, level), "", 0, text, None, None)
        logged += [now[0]] * repeats.filter(record)
    assert logged == [0, 2, 3, 60]


def test_many_different_faults_are_all_logged_and_few_are_remembered(monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ops.logs._MAX_REPEATS", 10)
    repeats = Repeats()
    faults = [logging.LogRecord("a", logging.ERROR, "", 0, f"{k}", (), None) for k in range(100)]
    assert all(map(repeats.filter, faults))
    assert not any(map(repeats.filter, faults[-10:]))
    assert repeats.filter(faults[0])


def test_a_500_and_the_lines_of_its_request_share_the_id(crashing, lines):
    reply = crashing.get("/v1/jobs/1", headers={"X-Request-ID": "req-7"})
    assert (reply.status_code, reply.json()["request_id"]) == (500, "req-7")
    assert reply.headers["x-request-id"] == "req-7"
    assert "failed because of a bug in the server (request req-7)" in reply.json()["detail"]
    (line,) = [item for item in lines() if item["message"] == "about to fail"]
    assert line["request_id"] == "req-7"


def test_a_503_names_its_request_and_a_404_does_not(http, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.events.MAX_LISTENERS", 0)
    refused = http.get("/v1/events")
    assert refused.status_code == 503
    assert refused.json()["request_id"] == refused.headers["x-request-id"]
    assert "request_id" not in http.get("/v1/jobs/7").json()


def test_a_text_line_ends_in_the_id_of_its_request():
    record = logging.makeLogRecord(
        {"name": "a", "levelname": "INFO", "msg": "m", "request_id": "7"}
    )
    assert TextLines().format(record).endswith("a: m [request 7]")


def test_the_access_log_has_no_key_that_a_caller_has_put_into_the_url(folder, lines):
    secret = Keyring(folder).add("ann", "read")
    with TestClient(create_app(Settings(folder, solvers=0, access_log=True))) as client:
        assert client.get(f"/v1/components?key={secret}&a=1").status_code == 401
    (line,) = (line["message"] for line in lines() if line["logger"] == "wrenchbook.access")
    assert '"GET /v1/components?key=wb_...&a=1" 401' in line


def test_the_access_log_has_a_line_of_every_request(folder, stand_in, lines):
    with TestClient(create_app(Settings(folder, solvers=0, access_log=True))) as client:
        assert client.app.fast_path is None  # queries of the fast path are no requests
        client.post(CALL, json=QUERY, headers={"X-Request-ID": "q"})
        client.get("/v1/jobs?limit=3")
        client.get("/v1/x%0AINFO%20forged")  # which makes no line of its own
    results = [line for line in lines() if line["logger"] == "wrenchbook.access"]
    assert [result["message"].rpartition(" ms")[0].rpartition(" ")[0] for result in results] == [
        f'testclient (anonymous) "POST {CALL}" 200',
        'testclient (anonymous) "GET /v1/jobs?limit=3" 200',
        'testclient (anonymous) "GET /v1/x%0AINFO%20forged" 404',
    ]
    assert results[0]["request_id"] == "q"


def test_a_server_without_the_option_logs_no_request(http, lines):
    http.get("/v1/jobs")
    assert [line for line in lines() if line["logger"] == "wrenchbook.access"] == []


# -- a line an event, for people or for programs -------------------------------------------------


def test_the_end_of_each_job_is_a_line_with_its_number(lines, ledger):
    done, _ = ledger.accept("rig", "f", [1.0] * 6)
    ledger.accept("rig", "f", [2.0] * 6)
    job = claim(ledger, "me")
    row = ledger.commit(job.id, job.attempt, [0.0] * 6)
    job = claim(ledger, "me")
    ledger.fail(job.id, job.attempt, {"kind": "died", "message": "a\nb", "remedy": ""})
    result = {(line["job"], line["level"]): line for line in lines() if "job" in line}
    ended = result[done.id, "info"]
    assert f"row {row.seq}" in ended["message"]
    assert (ended["component"], ended["attempt"]) == ("rig", 1)
    assert "died" in result[job.id, "warning"]["message"]


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
        reported = record("failed", exc_info=(ValueError, error, error.__traceback__))
    line = json.loads(JsonLines().format(reported))
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
        ("not read: '/tmp/a b/c d': not open", "not read: '.../c d': not open"),
        (
            "/tmp/a b/c (1).h5 and N/m in /usr/d.csv are bad",
            ".../c (1).h5 and N/m in .../d.csv are bad",
        ),
        ("/tmp/x y/u.v w/c.h5: full", ".../c.h5: full"),
        ("POST /v1/components/plate/table failed", "POST /v1/components/plate/table failed"),
        ("12 N/m and m/s, /health/ready", "12 N/m and m/s, /health/ready"),
        ("http://host/tmp/x", "http://host/tmp/x"),
        (
            'Traceback (most recent call last):\n  File "/usr/y.py"\n    f()\nValueError: bad',
            "ValueError: bad",
        ),
        (
            'Traceback (most recent call last):\n  File "<string>", line 1\nValueError: bad',
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
