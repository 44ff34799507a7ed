"""A server that follows another: its copies answer the same, all else is handed on, or refused."""

from contextlib import contextmanager

import numpy as np
import orjson
import pytest
from starlette.testclient import TestClient

from service.client import Client
from service.following.app import FollowingApp
from service.following.copies import Copies
from service.following.forward import Forwarder
from service.following.serve import OwnDirectoryError, follow
from service.http.door import Door, Opening
from service.http.door.opening import opening_for
from service.keys import Keyring
from tests.service.live import (
    FULL,
    add_table,
    as_rows,
    clean_wrenches,
    full_wrenches,
    moved,
    served,
)
from tests.service.until import until

HERE = "http://127.0.0.1:8000"
COVERED = {"force": [50.0, 0.0, 0.0], "moment": [0.0, 2.0, 3.0]}
THIN = {"force": [50.0, 20.0, 10.0], "moment": [1.0, 2.0, 3.0]}
# Of corners alone no point can be left out inside the others: nothing would be covered.
LOADED = np.concatenate(
    (
        clean_wrenches(),
        *(
            full_wrenches(30, k) * np.isin(np.arange(6), loads)
            for k, loads in enumerate(((0, 4, 5), (1, 5, 3), (2, 3, 4)))
        ),
    )
)
TOLERANCE = {"translation": 1e-4, "rotation": 1e-4}
ESTIMATE = {"on_thin": "estimate"}
MAIN = "/v1/components/one/displacement"
MANY = "/v1/components/one/displacements"


@contextmanager
def following(url, folder):
    client = Client(url, timeout=10)
    door = Door(Keyring(folder.parent), opening_for("127.0.0.1", None, None))
    app = FollowingApp(Copies(client, folder), Forwarder(client.url), client.url, door)
    with TestClient(app, HERE, raise_server_exceptions=False) as http:  # pyright: ignore[reportArgumentType]
        yield http, app
    client.close()


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A server with a table, and one that follows it."""
    folder = tmp_path_factory.mktemp("followed")
    with served(folder / "there") as client:
        add_table(client, "one", as_rows(LOADED, moved(LOADED)), tolerance=TOLERANCE)
        with following(client.url, folder / "here") as (http, app):
            yield client, http, app


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """A server that follows one that has gone, with a copy of an earlier start."""
    folder = tmp_path_factory.mktemp("left")
    with served(folder / "there") as client:
        add_table(client, "one", as_rows(LOADED, moved(LOADED)), tolerance=TOLERANCE)
        answer = client.displacement("one", COVERED["force"], COVERED["moment"])
        with following(client.url, folder / "here"):
            pass
    with following(client.url, folder / "here") as (http, _):
        yield http, answer


def without_times(reply):
    body = reply if isinstance(reply, dict) else reply.json()
    return {key: body[key] for key in body.keys() - {"elapsed_us", "copy_age_s"}}


@pytest.mark.parametrize(
    "more",
    [{}, {"derivatives": True}, {"detail": True}, {"method": "nearest"}, {"on_thin": "reject"}],
    ids=str,
)
def test_a_copy_answers_what_the_followed_server_does(pair, more):
    client, http, _ = pair
    there = client.call_json("POST", MAIN, COVERED | more)
    here = http.post(MAIN, json=COVERED | more)
    assert without_times(here) == without_times(there)
    assert 0 <= here.json()["copy_age_s"] < 30


def test_the_straight_way_says_the_same(pair):
    client, _, app = pair
    head = [(b"host", b"127.0.0.1:8000")]
    content = app.answer_at_once("one", head, orjson.dumps(COVERED))
    assert without_times(orjson.loads(content)) == without_times(
        client.call_json("POST", MAIN, COVERED)
    )
    assert app.answer_at_once("one", head, orjson.dumps(THIN)) is None
    assert app.answer_at_once("none", head, orjson.dumps(COVERED)) is None


def test_a_batch_is_answered_by_the_copy_in_both_forms(pair):
    client, http, _ = pair
    wrenches = np.random.default_rng(2).uniform(-1, 1, (50, 6)) * FULL
    body = {"wrenches": wrenches.tolist(), "on_thin": "estimate"}
    there = client.call_json("POST", MANY, body)
    assert without_times(http.post(MANY, json=body)) == without_times(there)
    headers = {"content-type": "application/octet-stream"}
    raw = http.post(f"{MANY}?on_thin=estimate", content=wrenches.tobytes(), headers=headers)
    block = np.frombuffer(raw.content).reshape(-1, 13)
    told = np.array([[np.nan if u is None else u for u in row] for row in there["displacements"]])
    assert np.array_equal(block[:, :6], told, equal_nan=True)
    assert float(raw.headers["wrenchbook-copy-age-s"]) >= 0


def test_what_a_copy_does_not_cover_is_handed_on(pair):
    client, http, _ = pair
    reply = http.post(MAIN, json=THIN)
    assert reply.status_code == 409
    assert "no finite-element setup" in reply.json()["detail"]
    job = http.post("/v1/components/bar/solve", json={"force": [0, 0, -10], "moment": [0, 0, 0]})
    assert job.status_code == 202
    assert client.job(job.json()["job"]["id"]).component == "bar"
    assert job.headers["location"] == f"/v1/jobs/{job.json()['job']['id']}"


def test_rows_that_are_imported_here_are_there_and_come_back_as_a_newer_copy(pair):
    client, http, _ = pair
    before = http.post(MAIN, json=COVERED).json()["table_version"]
    row = {"wrench": [40.0, 0, 0, 0, 2.0, 2.0], "displacement": [1e-5] * 6}
    reply = http.post("/v1/components/one/table?format=json", json={"rows": [row]})
    assert reply.json()["inserted"] == 1
    version = reply.json()["table_version"]
    until(lambda: http.post(MAIN, json=COVERED).json()["table_version"] == version)
    assert version > before
    here, there = http.post(MAIN, json=COVERED), client.call_json("POST", MAIN, COVERED)
    assert without_times(here) == without_times(there)


def test_an_earlier_version_is_asked_of_the_followed_server(pair):
    _, http, app = pair
    handed = app._handed_on
    for path, body in ((MAIN, COVERED), (MANY, {"wrenches": [[0.0] * 6], **ESTIMATE})):
        assert (
            http.post(f"{path}?table_version=0", json=body | ESTIMATE).json()["table_version"] == 0
        )
    assert http.post(f"{MAIN}?tableversion=0", json=COVERED).status_code == 422
    assert app._handed_on == handed + 3


def test_other_calls_are_those_of_the_followed_server(pair):
    client, http, _ = pair
    assert http.get("/v1/components").json() == client.call_json("GET", "/v1/components")
    export = http.get("/v1/components/one/table?format=hdf5")
    tag = export.headers["etag"]
    again = http.get("/v1/components/one/table?format=hdf5", headers={"if-none-match": tag})
    assert (export.status_code, again.status_code) == (200, 304)
    assert "wrenchbook" in http.get("/openapi.json").json()["info"]["title"]


def test_a_component_added_there_is_answered_here(pair):
    client, http, _ = pair
    add_table(client, "two", as_rows(clean_wrenches(), moved(clean_wrenches())))
    path = "/v1/components/two/displacement"
    until(lambda: "copy_age_s" in http.post(path, json=COVERED | ESTIMATE).json())


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b'{"force": [1, 2], "moment": [0, 0, 0]}'])
def test_bad_input_is_refused_here(pair, body):
    _, http, _ = pair
    assert http.post(MAIN, content=body).status_code == 422


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"sec-fetch-site": "cross-site"},
    ],
    ids=str,
)
def test_a_page_of_another_site_gets_nothing_of_a_copy_nor_of_what_is_handed_on(pair, headers):
    _, http, app = pair
    assert http.post(MAIN, json=COVERED, headers=headers).status_code == 403
    assert http.post(MANY, json={"wrenches": []}, headers=headers).status_code == 403
    assert http.get("/v1/jobs", headers=headers).status_code == 403
    head = [(b"host", b"127.0.0.1:8000")]
    head = [(name.encode(), value.encode()) for name, value in headers.items()] or head
    assert app.answer_at_once("one", head, orjson.dumps(COVERED)) is None


def test_the_page_of_a_server_that_follows_may_have_what_is_handed_on(pair):
    _, http, _ = pair
    headers = {"origin": HERE, "sec-fetch-site": "same-origin"}
    reply = http.put("/v1/components/one/notes", json={"text": "seen"}, headers=headers)
    assert (reply.status_code, reply.json()["notes"]) == (200, "seen")


def test_a_copy_takes_a_question_only_as_json_and_of_a_questions_size(pair):
    _, http, _ = pair
    text = {"content-type": "text/plain"}
    assert http.post(MAIN, content=orjson.dumps(COVERED), headers=text).status_code == 415
    body = b" " * (64 << 10) + orjson.dumps(COVERED)
    json = {"content-type": "application/json"}
    assert http.post(MAIN, content=body, headers=json).status_code == 413


def test_events_are_refused_with_where_they_are(pair):
    client, http, _ = pair
    reply = http.get("/v1/events")
    assert reply.status_code == 501
    assert f"{client.url}/v1/events" in reply.json()["detail"]


def test_health_and_metrics_are_of_this_server(pair):
    client, http, _ = pair
    told = http.get("/health/ready").json()
    assert told["status"] == "ready"
    assert told["follows"] == client.url
    assert told["copies"]["one"]["table_version"] > 0
    text = http.get("/metrics").text
    assert "wrenchbook_followed_away 0" in text
    assert 'wrenchbook_table_version{component="one"}' in text


def test_what_is_covered_is_answered_while_the_followed_server_is_away(left):
    http, answer = left
    reply = http.post(MAIN, json=COVERED)
    assert reply.status_code == 200
    assert reply.json()["translation"] == answer.translation.tolist()
    assert reply.json()["table_version"] == answer.table_version
    assert reply.json()["copy_age_s"] is None  # nobody has said since the start that it is newest


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", MAIN, THIN),
        ("POST", MANY, {"wrenches": [[50, 20, 10, 1, 2, 3]], "on_thin": "queue"}),
        ("POST", "/v1/components/bar/solve", COVERED),
        ("POST", "/v1/components/one/table?format=json", {"rows": []}),
        ("GET", "/v1/jobs", None),
        ("POST", "/v1/components/none/displacement", COVERED),
    ],
)
def test_what_needs_the_followed_server_says_that_it_is_away_and_what_to_do(
    left, method, path, body
):
    http, _ = left
    reply = http.request(method, path, json=body)
    assert reply.status_code == 503
    assert reply.headers["content-type"] == "application/problem+json"
    assert "does not answer" in reply.json()["detail"]
    assert "estimate" in reply.json()["detail"]


def test_an_estimate_needs_no_followed_server(left):
    http, _ = left
    reply = http.post(MAIN, json=THIN | {"on_thin": "estimate"})
    assert (reply.status_code, reply.json()["coverage"]) == (200, "thin")


def test_health_says_that_the_followed_server_is_away_and_goes_on(left):
    http, _ = left
    reply = http.get("/health/ready")
    assert reply.status_code == 200
    assert "is away" in reply.json()["faults"][0]


def test_a_tolerance_edited_there_holds_here(pair, tmp_path_factory):
    client, http, _ = pair
    assert http.post(MAIN, json=COVERED).json()["coverage"] == "covered"
    (file,) = tmp_path_factory.getbasetemp().glob("followed0/there/components/one/component.toml")
    file.write_text(file.read_text().replace("= 0.0001", "= 1e-30"))
    until(lambda: client.call_json("POST", MAIN, COVERED | ESTIMATE)["coverage"] == "thin")
    until(lambda: http.post(MAIN, json=COVERED | ESTIMATE).json()["coverage"] == "thin")


def test_a_damaged_copy_on_the_disk_is_fetched_anew(tmp_path):
    with served(tmp_path / "there") as client:
        add_table(client, "one", as_rows(LOADED, moved(LOADED)), tolerance=TOLERANCE)
        with following(client.url, tmp_path / "here"):
            pass
        file = tmp_path / "here" / "one.h5"
        file.write_bytes(file.read_bytes()[:1000])
        with following(client.url, tmp_path / "here") as (http, _):
            assert "copy_age_s" in http.post(MAIN, json=COVERED).json()
        assert len(file.read_bytes()) > 1000


def test_a_directory_with_a_ledger_is_refused(tmp_path):
    (tmp_path / "ledger.sqlite").touch()
    with pytest.raises(OwnDirectoryError, match="another directory"):
        follow("http://127.0.0.1:1", tmp_path, "127.0.0.1", 0, "error", "text", Opening())
