"""Requests that are refused: by a problem that names the place, and nothing is changed."""

import json

import pytest
from starlette.testclient import TestClient

from tests.refusals import assert_told, cases
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    """Start a server without solvers, of the shipped components and an empty table, "rig"."""
    span = {"force": [900] * 3, "moment": [90] * 3}
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("refused"), solvers=0))) as client:
        client.post("/v1/components", json={"name": "rig", "title": "rig", "range": span})
        yield client


def state(http):
    return http.get("/v1/components").json(), http.get("/v1/jobs").json()


@cases(__file__, "http")
def test_a_request_is_refused_with_its_place_and_changes_nothing(http, case):
    before = state(http)
    method, path = case["call"].split()
    body = case.get("body", "")
    headers = {"content-type": case.get("type", "application/json")}
    reply = http.request(
        method, path, content=body if isinstance(body, str) else json.dumps(body), headers=headers
    )
    assert reply.status_code == case["status"], reply.text
    assert reply.headers["content-type"] == "application/problem+json"
    problem = reply.json()
    places = [f"{one['loc']}: {one['msg']}" for one in problem.get("errors", ())]
    assert_told(case, [problem["detail"], *places])
    assert state(http) == before
