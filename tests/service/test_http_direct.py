"""The main call past the framework: as every other call where it does not answer."""

import json
import socket

import pytest

from tests.service.document import document
from tests.service.live import served

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


def test_the_call_is_in_the_openapi_document_all_the_same(http):
    call = document(http)["paths"]["/v1/components/{name}/displacement"]["post"]
    schema = call["requestBody"]["content"]["application/json"]["schema"]
    assert "derivatives" in schema["properties"]
    assert {"200", "202", "404", "409", "413", "422", "424"} <= call["responses"].keys()
    reply = call["responses"]["200"]["content"]["application/json"]["schema"]
    assert "derivative" in json.dumps(reply)
