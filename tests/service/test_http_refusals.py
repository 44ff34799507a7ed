"""Requests that are refused: by a problem that names the place, and nothing is changed."""

import json
import socket

import pytest
from starlette.testclient import TestClient

from tests.refusals import assert_told, cases
from tests.service.document import document
from tests.service.live import served
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


CALL = "/v1/components/plate/displacement"


def test_a_body_that_is_too_large_is_413_before_all_of_it_has_come(tmp_path):
    with served(tmp_path) as client:
        host, port = client.url.removeprefix("http://").split(":")
        head = f"POST {CALL} HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000000\r\n\r\n"
        with socket.create_connection((host, int(port)), timeout=20) as connection:
            connection.sendall(head.encode() + b" " * 100_000)
            reply = connection.recv(65536)
    assert reply.startswith(b"HTTP/1.1 413")
    assert b"application/problem+json" in reply
    assert client.url


@pytest.mark.parametrize("call", ["displacement", "solve", "fill"])
def test_so_it_is_in_pieces_and_on_every_call_of_small_bodies(http, call):
    pieces = (b" " * 1000 for _ in range(100))
    reply = http.post(f"/v1/components/plate/{call}", content=pieces)
    assert reply.status_code == 413
    body = reply.json()
    assert body["type"] == "urn:wrenchbook:problem:too-large"
    assert "65,536 bytes" in body["detail"]


def test_an_unknown_component_a_wrong_body_and_a_wrong_method_are_problems(http):
    body = {"force": [0, 0, 1], "moment": [0, 0, 0]}
    unknown = http.post("/v1/components/nobody/displacement", json=body)
    wrong = http.post(CALL, json={**body, "forse": 1})
    listed = http.get(CALL)
    nested = http.post("/v1/components/a/b/displacement", json=body)
    found = [reply.status_code for reply in (unknown, wrong, listed, nested)]
    assert found == [404, 422, 405, 404]
    for reply in (unknown, wrong, listed, nested):
        assert reply.headers["content-type"] == "application/problem+json"
        assert reply.json()["status"] == reply.status_code


def test_the_call_is_in_the_openapi_document_all_the_same(http):
    call = document(http)["paths"]["/v1/components/{name}/displacement"]["post"]
    schema = call["requestBody"]["content"]["application/json"]["schema"]
    assert "derivatives" in schema["properties"]
    assert {"200", "202", "404", "409", "413", "422", "424"} <= call["responses"].keys()
    reply = call["responses"]["200"]["content"]["application/json"]["schema"]
    assert "derivative" in json.dumps(reply)
