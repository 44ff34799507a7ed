"""Request ids in replies and log lines, the access log, and traces."""

import io
import json
import logging

import pytest
from starlette.testclient import TestClient

from wrenchbook.service.http.app import create_app
from wrenchbook.service.ops.logs import JsonLines, TextLines, add_request_id
from wrenchbook.service.workspace import Settings

CALL = "/v1/components/spring/displacement"
QUERY = {"force": [0, 0, -5], "on_thin": "estimate"}


@pytest.fixture
def lines():
    """All lines of the log from here on."""
    stream = io.StringIO()
    shown = logging.StreamHandler(stream)
    shown.addFilter(add_request_id)
    shown.setFormatter(JsonLines())
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
    made = [http.get("/v1/jobs", headers=headers).headers["x-request-id"] for _ in range(2)]
    assert made[0] != made[1]
    assert all(len(one) == 16 and one.isalnum() for one in made)


def test_a_500_and_the_lines_of_its_request_share_the_id(crashing, lines):
    reply = crashing.get("/v1/jobs/1", headers={"X-Request-ID": "req-7"})
    assert (reply.status_code, reply.json()["request_id"]) == (500, "req-7")
    assert reply.headers["x-request-id"] == "req-7"
    (line,) = [one for one in lines() if one["message"] == "about to fail"]
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


def test_the_access_log_has_a_line_of_every_request(folder, stand_in, lines):
    with TestClient(create_app(Settings(folder, solvers=0, access_log=True))) as client:
        assert client.app.fast_path is None  # queries of the fast path are no requests
        client.post(CALL, json=QUERY, headers={"X-Request-ID": "q"})
        client.get("/v1/jobs?limit=3")
    found = [one for one in lines() if one["logger"] == "wrenchbook.access"]
    assert [one["message"].rpartition(" ms")[0].rpartition(" ")[0] for one in found] == [
        f'testclient "POST {CALL}" 200',
        'testclient "GET /v1/jobs?limit=3" 200',
    ]
    assert found[0]["request_id"] == "q"


def test_a_line_end_in_a_path_makes_no_line_of_the_access_log(folder, stand_in, lines):
    with TestClient(create_app(Settings(folder, solvers=0, access_log=True))) as client:
        client.get("/v1/x%0AINFO%20forged")
    (found,) = [one for one in lines() if one["logger"] == "wrenchbook.access"]
    assert '"GET /v1/x%0AINFO%20forged" 404' in found["message"]


def test_a_server_without_the_option_logs_no_request(http, lines):
    http.get("/v1/jobs")
    assert [one for one in lines() if one["logger"] == "wrenchbook.access"] == []
