"""Loads and outputs are spelt fx .. mz and ux .. rz in every reply."""

import re

import pytest

from tests.service.test_http_displacement import load_plane_table

OTHER = re.compile(r"(?<![A-Za-z0-9])(?:[FM]_[xyz]|[ur]_[xyz]|[FMU][xyz])(?![A-Za-z0-9_])")
FORCE = {"force": [30, -20, 10], "moment": [1, 2, -3]}
BEYOND = {"force": [300, -20, 10], "moment": [1, 2, -3]}
CALLS = [
    ("get", "/v1/components/{name}", {}),
    ("get", "/v1/components/{name}/coverage", {}),
    ("get", "/v1/components/{name}/compliance", {}),
    ("post", "/v1/components/{name}/displacement", {"json": {**FORCE, "detail": True}}),
    (
        "post",
        "/v1/components/{name}/displacement",
        {"json": {**FORCE, "detail": True, "method": "linear", "on_thin": "estimate"}},
    ),
    (
        "post",
        "/v1/components/{name}/displacement",
        {"json": {**BEYOND, "detail": True, "on_thin": "estimate"}},
    ),
    ("post", "/v1/components/{name}/displacement", {"json": {**BEYOND, "on_thin": "reject"}}),
    ("post", "/v1/components/{name}/displacement", {"json": BEYOND}),
    ("post", "/v1/components/{name}/solve", {"json": BEYOND}),
    ("post", "/v1/components/{name}/fill", {"json": {}}),
]


def texts(body):
    """Yield every key and every text of a reply."""
    if isinstance(body, dict):
        for key, value in body.items():
            yield key
            yield from texts(value)
    elif isinstance(body, list):
        for one in body:
            yield from texts(one)
    elif isinstance(body, str):
        yield body


@pytest.fixture
def tables(http):
    load_plane_table(http)
    body = {"name": "rig", "title": "Rig", "range": {"force": [100] * 3, "moment": [10] * 3}}
    assert http.post("/v1/components", json=body).status_code == 201
    text = "fz [N],mx [N*m],uz [mm]\n" + "".join(
        f"{force},{moment},{1e-2 * force}\n" for force in (-90, 0, 90) for moment in (-9, 0, 9)
    )
    headers = {"content-type": "text/csv"}
    path = "/v1/components/rig/table?missing_loads=zero"
    assert http.post(path, content=text, headers=headers).status_code == 200
    return http


@pytest.mark.parametrize("name", ["plane", "rig", "plate_thin"])
@pytest.mark.parametrize(("method", "path", "request_"), CALLS)
def test_no_reply_spells_a_load_or_an_output_otherwise(
    tables, stand_in, name, method, path, request_
):
    stand_in("endless")
    reply = tables.request(method.upper(), path.format(name=name), **request_)
    assert reply.status_code < 500, reply.text
    found = [text for text in texts(reply.json()) if OTHER.search(text)]
    assert found == []


def test_the_walk_sees_another_spelling():
    assert [one for one in texts({"a": [{"F_x": "r_z of M_y"}]}) if OTHER.search(one)] == [
        "F_x",
        "r_z of M_y",
    ]
