"""Calls that are wrong, those of problems.toml: refused by place and words; nothing changes."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.fea.two_interfaces import LINK
from tests.service.ledger_rows import NewRow, insert
from tests.service.spaces import add_link
from tests.service.test_http_components import TABLE_ONLY, bundle_zip, upload
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

TABLE = tomllib.loads(Path(__file__).with_name("problems.toml").read_text("utf-8"))
CASES = {
    f"{sentence}: {case.get('is', number)}": {**group, **case}
    for sentence, group in TABLE.items()
    for number, case in enumerate(group["cases"], 1)
}
CHANGING = ("jobs", "rows", "edits", "imports", "recorded", "extremes", "blocks")


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    """Shipped components, a table `rig` of five rows, `empty`, and two of two interfaces."""
    folder = tmp_path_factory.mktemp("wrong")
    with TestClient(create_app(Settings(folder, solvers=0))) as client:
        for name in ("rig", "empty"):
            assert client.post("/v1/components", json={**TABLE_ONLY, "name": name}).is_success
        new = [NewRow((i / 10, 0, 0, 0, 0, 0), (i * 1e-7, 0, 0, 0, 0, 0)) for i in range(1, 6)]
        insert(client.app.state.workspace.ledger, "rig", "", new)
        client.app.state.workspace.tables.catch_up("rig", 600)
        assert upload(client, bundle_zip(LINK)).is_success
        add_link(client, name="ends", has_fea=True)
        yield client


@pytest.fixture(scope="module")
def document(http):
    return http.get("/openapi.json").json()


def changing(http):
    """What no wrong call may change."""
    workspace, settings = http.app.state.workspace, http.app.state.workspace.settings
    with workspace.ledger.reading() as db:
        counts = [db.execute(f"SELECT count(*) FROM {item}").fetchone() for item in CHANGING]
    return counts, workspace.library.names(), list((settings.data / "components").iterdir())


def request_of(case):
    """Return what the HTTP client is given besides method and address."""
    content = case["body"].encode("latin-1") if "body" in case else None
    headers = {"content-type": case["kind"]} if "kind" in case else {}
    if "floats" in case:
        content = np.array(case["floats"], "<f8").tobytes()
    if "zeros" in case:
        content = bytes(case["zeros"])
    if "floats" in case or "zeros" in case:
        headers["content-type"] = "application/octet-stream"
    given = {"headers": headers, "content": content, "params": case.get("query")}
    if "json" in case and content is None:
        given["json"] = case["json"] | case.get("with", {})
    return {name: value for name, value in given.items() if value is not None}


def operation(document, method, address):
    """Return the call of the document that an address belongs to, if there is one."""
    path = address.partition("?")[0]
    for name, of_path in sorted(document["paths"].items(), key=lambda one: one[0].count("{")):
        if method in of_path and re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", name), path):
            return name, of_path[method]
    return None, None


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_wrong_call_is_refused_as_documented_and_changes_nothing(http, document, case):
    method, address = case["call"].split(" ")
    before = changing(http)
    reply = http.request(method, address, **request_of(case))
    assert reply.status_code == case["status"], reply.text
    assert changing(http) == before
    reported, kind = reply.json(), reply.headers["content-type"]
    assert kind == "application/problem+json"
    assert reported["status"] == case["status"]
    assert set(document["components"]["schemas"]["Problem"]["required"]) <= reported.keys()
    assert reported["detail"]
    _, documented = operation(document, method.lower(), address)
    if documented is not None:
        assert kind in documented["responses"][str(case["status"])]["content"]
    places = [item.get("loc", item.get("field")) for item in reported.get("errors", ())]
    assert places == case.get("places", places)
    assert case.get("place", "") in ("", *places)
    assert all(item["msg"] for item in reported.get("errors", ()) if "loc" in item)
    assert [words for words in case.get("words", ()) if words not in reply.text] == []


LONG = "q" * 3000


@pytest.mark.parametrize(
    ("call", "sent"),
    [
        (f"GET /{LONG}", {}),
        (f"GET /v1/components/{LONG}", {}),
        ("POST /v1/components", {"headers": {"content-type": LONG}}),
        ("POST /v1/components/rig/table", {"headers": {"content-type": LONG}}),
        ("POST /v1/components/rig/table", {"content": f'[{{"{LONG}": 1, "{LONG}": 2}}]'}),
        ("POST /v1/components/rig/displacement", {"json": {LONG: 1}}),
        ("POST /v1/components/rig/displacement", {"json": {"force": [0, 0, 1], "method": LONG}}),
    ],
)
def test_a_refusal_quotes_at_most_200_characters(http, call, sent):
    reply = http.request(*call.split(" "), **sent)
    assert reply.is_client_error
    assert "q" * 201 not in reply.text


def test_no_call_ignores_a_parameter_that_it_has_not(http, document):
    before = changing(http)
    calls = [
        (method, path.format(name="plate_thin", row=1, number=1, job_id=1))
        for path, methods in document["paths"].items()
        for method in methods
        if path.startswith("/v1/")
    ]
    for method, path in calls:  # one by one: events would not end
        reply = http.request(method, path, params={"nosuch": 1})
        assert (reply.status_code, reply.json()["errors"][0]["loc"]) == (422, "nosuch"), path
    assert changing(http) == before


def test_a_sheet_that_is_not_there_is_no_sheet_none(http):
    workbook = (Path(__file__).parents[2] / "data/tables/workbook.xlsx").read_bytes()
    reply = http.post("/v1/components/rig/table?sheet=Run 9", content=workbook)
    assert "1 mistake, the first in file: there is no sheet 'Run 9'" in reply.json()["detail"]


def test_every_call_with_a_path_parameter_is_called_wrongly_here(document):
    calls = [case["call"].split(" ") for case in CASES.values()]
    called = {(verb, operation(document, verb.lower(), url)[0]) for verb, url in calls}
    there = {(verb.upper(), name) for name, of in document["paths"].items() for verb in of}
    assert {call for call in there if "{" in call[1]} <= called
