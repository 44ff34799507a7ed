"""Questions to an earlier version of a table: a study repeated digit for digit."""

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.following import wait_for_version
from tests.service.test_http_library import RIG, load, rows
from wrenchbook.service.http.app import create_app
from wrenchbook.service.tables import past
from wrenchbook.service.workspace import Settings

WRENCH = {"force": [100.0, -50.0, 300.0], "moment": [10.0, 5.0, -7.0]}
BEYOND = {"force": [0.0, 0.0, 1700.0], "moment": [0.0, 0.0, 0.0]}
SAME = ("translation", "rotation", "error", "coverage", "method", "source", "table_version")


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    settings = Settings(tmp_path_factory.mktemp("past") / "workspace", solvers=0)
    with TestClient(create_app(settings)) as client:
        yield client


@pytest.fixture(scope="module")
def rig(http):
    """Return a component's name, and two versions of it with what they answered then."""
    return made(http, "rig")


def made(http, name):
    assert http.post("/v1/components", json={**RIG, "name": name}).status_code == 201
    told = []
    for seed in (1, 2):
        bent = rows(12, seed) + np.pad(1e-9 * rows(12, seed)[:, :3] ** 2, ((0, 0), (6, 0)))
        version = load(http, bent, name)["table_version"]
        told.append((version, ask(http, name)))
    return name, told


def ask(http, name, version=None, status=200, **body):
    query = {} if version is None else {"table_version": version}
    asked = {**WRENCH, "on_thin": "estimate", **body}
    reply = http.post(f"/v1/components/{name}/displacement", json=asked, params=query)
    assert reply.status_code == status, reply.text
    return reply.json()


def same(one, other):
    return all(one.get(key) == other.get(key) for key in SAME)


def test_an_earlier_version_answers_with_the_digits_that_it_answered_with_then(http, rig):
    name, ((first, then), (second, now)) = rig
    assert not same(then, now)
    assert same(ask(http, name, first), then)
    assert same(ask(http, name, second), now)


def test_a_version_before_a_withdrawal_has_the_row_and_the_one_after_has_it_not(http):
    name, (_, (version, now)) = made(http, "withdrawn")
    for call, verb in (("", "DELETE"), ("/restore", "POST")):
        reply = http.request(verb, f"/v1/components/{name}/table/{version}{call}")
        assert reply.status_code == 200, reply.text
    wait_for_version(http, name, version + 2)
    withdrawn = ask(http, name, version + 1)
    assert withdrawn["translation"] != now["translation"]
    assert same(ask(http, name, version), now)
    assert same(ask(http, name, version + 2), ask(http, name))


def test_a_batch_of_either_form_is_answered_by_the_earlier_version(http, rig):
    name, ((first, then), _) = rig
    wrench = WRENCH["force"] + WRENCH["moment"]
    path, query = f"/v1/components/{name}/displacements", {"table_version": first}
    asked = {"wrenches": [wrench, wrench], "on_thin": "estimate"}
    reply = http.post(path, json=asked, params=query).json()
    expected = then["translation"]
    assert reply["displacements"][1][:3] == pytest.approx(expected, rel=1e-12)
    assert reply["table_version"] == first
    content = np.array([wrench]).astype("<f8").tobytes()
    head = {"content-type": "application/octet-stream"}
    query["on_thin"] = "estimate"
    reply = http.post(path, content=content, params=query, headers=head)
    assert reply.headers["Wrenchbook-Table-Version"] == str(first)
    assert np.frombuffer(reply.content)[:3] == pytest.approx(expected, rel=1e-12)


def test_an_earlier_version_queues_nothing_and_counts_nothing(http, rig):
    name, ((first, _), _) = rig
    asked = http.get(f"/v1/components/{name}/demand").json()["asked"]
    reply = ask(http, name, first, 202, on_thin="queue", **BEYOND)
    assert reply["job"] is None
    assert "earlier version" in reply["reason"]
    batch = {"wrenches": [BEYOND["force"] + BEYOND["moment"]]}
    path, query = f"/v1/components/{name}/displacements", {"table_version": first}
    reply = http.post(path, json=batch, params=query)
    assert reply.status_code == 202
    assert reply.json()["jobs"][0]["reason"] == "table-version"
    assert ask(http, name, first, 409, on_thin="reject", **BEYOND)["type"].endswith("not-covered")
    assert http.get(f"/v1/components/{name}/demand").json()["asked"] == asked


def test_waiting_for_a_solve_at_an_earlier_version_is_refused(http, rig):
    name, ((first, _), _) = rig
    told = ask(http, name, first, 422, on_thin="wait")
    assert "makes a new version" in told["detail"]


@pytest.mark.parametrize("version", ["-1", "x", "1.5", str(2**63), ""])
def test_what_is_no_version_is_named(http, rig, version):
    told = ask(http, rig[0], version, 422)
    assert told["errors"][0]["loc"] == "query.table_version"


def test_a_version_that_is_not_there_yet_is_a_404_that_says_which_are(http, rig):
    name, (_, (second, _)) = rig
    assert f"0 to {second}" in ask(http, name, second + 1, 404)["detail"]
    reply = http.post("/v1/components/nope/displacement?table_version=1", json=WRENCH)
    assert reply.status_code == 404
    assert ask(http, name, 0)["reason"] == "the table has no rows"


@pytest.mark.parametrize("query", ["tableversion=1", "table_version=1&on_thin=reject"])
@pytest.mark.parametrize("call", ["displacement", "displacements"])
def test_a_query_that_would_be_overlooked_is_refused(http, rig, call, query):
    body = WRENCH if call == "displacement" else {"wrenches": [[0, 0, 1, 0, 0, 0]]}
    reply = http.post(f"/v1/components/{rig[0]}/{call}?{query}", json=body)
    assert reply.status_code == 422, reply.text


def test_a_version_named_twice_is_refused(http, rig):
    path = f"/v1/components/{rig[0]}/displacement?table_version=1&table_version=2"
    assert http.post(path, json=WRENCH).status_code == 422


def test_a_version_too_large_to_build_is_refused_with_a_way_out(http, rig, monkeypatch):
    name, ((first, _), _) = rig
    monkeypatch.setattr(past, "MOST_ROWS", 5)
    told = ask(http, name, first - 2, 409)
    assert "Export it with table_version" in told["detail"]


def test_a_version_with_a_damaged_row_is_gone_and_says_so(http, rig):
    name, ((first, _), _) = rig
    ledger = http.app.state.workspace.ledger
    ledger.damaged[first - 1] = name
    try:
        told = ask(http, name, first - 1, 410)
    finally:
        del ledger.damaged[first - 1]
    assert "cannot be repeated" in told["detail"]


def test_few_earlier_versions_are_kept(http, rig):
    name, (_, (second, now)) = rig
    kept = http.app.state.workspace.past
    for version in range(second - 8, second + 1):
        ask(http, name, version)
    assert len(kept._kept) <= past.MOST_TABLES
    assert same(ask(http, name, second), now)


def test_each_import_says_which_version_first_has_its_rows(http, rig):
    name, ((first, _), (second, _)) = rig
    told = http.get(f"/v1/components/{name}/imports").json()["imports"]
    assert [one["table_version"] for one in told] == [second, first]
