import asyncio
import json
import socket
from types import SimpleNamespace

import numpy as np
import pytest
from starlette.requests import ClientDisconnect
from starlette.testclient import TestClient

from tests.service.document import document
from tests.service.following import wait_for_version
from tests.service.live import FULL, as_rows, clean_wrenches, served
from tests.until import until
from wrenchbook.service.http import batch
from wrenchbook.service.http.app import create_app
from wrenchbook.service.query import SolveFailedError
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.kernel.binding import PackedTable

CALL = "/v1/components/plate_thin/displacement"
WRENCH = {"force": [10.0, 0.0, -20.0], "moment": [0.0, 3.0, 0.0]}


def load(http, name, rows):
    """Add a table-only component with rows; its table holds them on return."""
    body = {"name": name, "title": name, "range": {"force": [100] * 3, "moment": [10] * 3}}
    assert http.post("/v1/components", json=body).status_code == 201
    if rows:
        add(http, name, rows)


def add(http, name, rows):
    """Add rows of a JSON table to a component; its table holds them on return."""
    reply = http.post(f"/v1/components/{name}/table", json={"rows": rows})
    assert reply.status_code == 200, reply.text
    wait_for_version(http, name, reply.json()["table_version"])


def load_plane_table(http, name="plane"):
    """Load a table-only component with u = 1e-6 w, on the corners of every axis and 20 more rows.

    Those load all axes: without them nothing tells what loads of several axes do together.
    """
    mixed = np.random.default_rng(20).uniform(-1, 1, (20, 6)).round(3) * FULL
    wrenches = np.concatenate((clean_wrenches(), mixed))
    rows = as_rows(wrenches, 1e-6 * wrenches)
    load(http, name, rows)
    return rows


def ask(http, **fields):
    return http.post(CALL, json={**WRENCH, **fields})


def test_an_empty_table_queues_one_job_and_says_so(http):
    reply = ask(http)
    body = reply.json()
    assert reply.status_code == 202
    assert reply.headers["location"] == body["job"]["url"] == f"/v1/jobs/{body['job']['id']}"
    assert body["translation"] is None
    assert body["rotation"] is None
    assert body["coverage"] == "outside"
    assert body["reason"]


def test_the_same_wrench_is_the_same_job_however_often_it_is_asked(http, stand_in):
    stand_in("endless")
    jobs = {ask(http).json()["job"]["id"] for _ in range(5)}
    assert len(jobs) == 1
    assert len(http.get("/v1/jobs").json()["jobs"]) == 1


def test_wait_answers_with_the_solve_of_just_this_wrench(http):
    reply = ask(http, on_thin="wait", wait_s=60)
    body = reply.json()
    assert reply.status_code == 200
    assert body["source"] == "fea"
    assert body["translation"] == pytest.approx([1e-5, 0.0, -2e-5], rel=1e-12)
    assert body["rotation"] == pytest.approx([0.0, 3e-6, 0.0], rel=1e-12)
    again = ask(http)
    assert (again.status_code, again.json()["source"]) == (200, "fea")


def test_wait_that_is_too_short_answers_202(http, stand_in):
    stand_in("endless")
    reply = ask(http, on_thin="wait", wait_s=0.2)
    assert reply.status_code == 202
    assert reply.json()["job"]["status"] in ("waiting", "running")


def test_what_the_solver_says_of_its_answer_is_in_the_reply_and_in_the_job(http, stand_in):
    stand_in("doubtful")
    body = ask(http, on_thin="wait", wait_s=60).json()
    assert body["notes"] == ["mesh: 3 cells are strongly distorted"]
    assert http.get(body["job"]["url"]).json()["notes"] == body["notes"]


def test_estimate_queues_nothing(http):
    reply = ask(http, on_thin="estimate")
    assert reply.status_code == 200
    assert reply.json()["coverage"] == "outside"
    assert http.get("/v1/jobs").json()["jobs"] == []


def test_reject_is_a_problem_that_names_the_coverage(http):
    limits = {"translation": 3e-5, "rotation": 4e-5}
    reply = ask(http, on_thin="reject", tolerance=limits)
    assert reply.status_code == 409
    assert reply.json()["tolerance"] == limits
    assert reply.headers["content-type"] == "application/problem+json"
    assert reply.json()["coverage"] == "outside"
    assert reply.json()["detail"].startswith("the table has no rows. Ask with on_thin")
    assert http.get("/v1/jobs").json()["jobs"] == []


def test_a_reject_beyond_the_range_names_beyond_range_as_the_way_to_a_solve(http):
    body = ask(http, force=[0, 0, 1e5], on_thin="reject").json()
    assert "'queue' or 'wait' with beyond_range (--beyond-range) for a solve" in body["detail"]


def test_a_failed_solve_is_a_problem_with_kind_and_remedy(http, stand_in):
    stand_in("diverges")
    reply = ask(http, on_thin="wait", wait_s=60)
    body = reply.json()
    assert reply.status_code == 424
    assert body["error"]["kind"] == "not_converged"
    assert "smaller load steps" in body["detail"]
    assert f"/v1/jobs/{body['job']['id']}/retry" in body["detail"]
    solve = http.post("/v1/components/plate_thin/solve", json={**WRENCH, "wait_s": 60})
    assert (solve.status_code, solve.json()) == (424, body)
    stand_in("quick")
    assert http.post(f"{body['job']['url']}/retry").status_code == 200
    assert http.get(body["job"]["url"], params={"wait_s": 60}).json()["status"] == "done"


def test_a_failure_that_ends_in_its_remedy_says_it_once():
    error = {"kind": "snap_through", "message": "It snaps. Guide it.", "remedy": "Guide it."}
    job = SimpleNamespace(id=3, status="failed", error=error)
    assert (
        str(SolveFailedError(job))
        == "It snaps. Guide it. Once it is repaired, POST /v1/jobs/3/retry."
    )


def test_a_covered_wrench_is_answered_from_the_table_with_an_error_bar(http):
    load_plane_table(http)
    reply = http.post(
        "/v1/components/plane/displacement", json={"force": [30, -20, 10], "moment": [1, 2, -3]}
    )
    body = reply.json()
    assert reply.status_code == 200
    assert body["coverage"] == "covered"
    assert body["source"] == "table"
    assert body["method"] == "kriging"
    assert body["translation"] == pytest.approx([30e-6, -20e-6, 10e-6], rel=1e-9)
    assert body["rotation"] == pytest.approx([1e-6, 2e-6, -3e-6], rel=1e-9)
    assert all(bar >= 0 for bar in body["error"]["translation"] + body["error"]["rotation"])
    assert body["elapsed_us"] > 0


def test_detail_tells_per_axis_inputs_outputs_and_rows(http):
    load_plane_table(http)
    body = http.post(
        "/v1/components/plane/displacement",
        json={"force": [30, 0, 0], "moment": [0, 1, 0], "detail": True},
    ).json()
    x = body["axes"][0]
    assert x["axis"] == "x"
    assert x["inputs"] == {"fx": 30.0, "my": 1.0, "mz": 0.0}
    assert x["rows"]


@pytest.mark.parametrize("name", ["bar", "plate_thin"])
def test_the_detail_of_a_rows_answer_has_no_axes_that_did_not_answer(http, name):
    """They were three axes of zeros, `outside`, in a reply that was covered."""
    call, asked = f"/v1/components/{name}/displacement", {**WRENCH, "detail": True}
    solved = http.post(call, json={**asked, "on_thin": "wait", "wait_s": 60}).json()
    wait_for_version(http, name, solved["table_version"])
    later = http.post(call, json=asked).json()
    for reply in (solved, later):
        assert (reply["coverage"], reply["method"], reply["axes"]) == ("covered", "row", [])


def test_a_batch_answers_in_order_and_queues_what_is_thin(http):
    wrenches = [[1.0, 0, 0, 0, 0, 0], [0, 2.0, 0, 0, 0, 0]]
    reply = http.post(f"{CALL}s", json={"wrenches": wrenches, "on_thin": "wait", "wait_s": 60})
    body = reply.json()
    assert reply.status_code == 200
    assert body["coverage"] == ["covered", "covered"]
    assert np.allclose(body["displacements"], 1e-6 * np.array(wrenches), rtol=1e-12)
    assert [job["index"] for job in body["jobs"]] == [0, 1]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_answers_a_linear_table_rightly(http, method):
    load_plane_table(http)
    body = http.post(
        "/v1/components/plane/displacement",
        json={
            "force": [30, -20, 10],
            "moment": [1, 2, -3],
            "method": method,
            "on_thin": "estimate",
            "derivatives": True,
        },
    ).json()
    assert body["translation"] == pytest.approx([30e-6, -20e-6, 10e-6], rel=1e-6)
    assert np.array(body["derivative"]) == pytest.approx(1e-6 * np.eye(6), abs=1e-11)
    assert body["method"] == method


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("singular"), ValueError("shapes differ")])
def test_a_mistake_of_the_server_is_500_and_not_blamed_on_the_method(
    folder, stand_in, monkeypatch, error
):
    def fail(self, *_):
        raise error

    with TestClient(create_app(Settings(folder, solvers=0)), raise_server_exceptions=False) as http:
        monkeypatch.setattr(PackedTable, "answer", fail)
        monkeypatch.setattr(PackedTable, "batch", fail)
        for call, body in (("displacement", WRENCH), ("displacements", {"wrenches": [[1.0] * 6]})):
            reply = http.post(f"/v1/components/plate/{call}", json={**body, "method": "griddata"})
            assert reply.status_code == 500
            assert reply.headers["content-type"] == "application/problem+json"
            assert reply.json()["type"].endswith("internal")


def test_a_table_that_cannot_be_read_by_mistake_delays_neither_the_start_nor_the_others(
    folder, stand_in, monkeypatch
):
    """A start waited 30 s for it, and no other table was read."""
    whole = PackedTable.answer

    def fail(self, *asked):
        if self.meta["provenance"]["component"] == "bar":
            raise np.linalg.LinAlgError("singular")
        return whole(self, *asked)

    monkeypatch.setattr(PackedTable, "answer", fail)
    with TestClient(create_app(Settings(folder, solvers=0))) as http:
        tables = http.app.state.workspace.tables
        assert "singular" in tables.faults()["bar"]
        names = http.app.state.workspace.library.names()
        assert set(names) - tables.present().keys() == {"bar"}


def test_a_row_that_answers_names_its_own_source(http):
    load_plane_table(http)
    row = {"wrench": [50, 0, 10, 0, 0, 3], "displacement": [1e-5] * 6, "source": "measured"}
    add(http, "plane", [row])
    body = http.post(
        "/v1/components/plane/displacement",
        json={
            "force": [50, 0, 10],
            "moment": [0, 0, 3],
            "tolerance": {"translation": 1e-30, "rotation": 1e-30},
        },
    ).json()
    assert body["method"] == "row"
    assert body["source"] == "measured"
    assert body["translation"] == [1e-5] * 3


# -- past the framework --------------------------------------------------------------------------


PLATE = "/v1/components/plate/displacement"


def test_a_body_that_is_too_large_is_413_before_all_of_it_has_come(tmp_path):
    with served(tmp_path) as client:
        host, port = client.url.removeprefix("http://").split(":")
        head = f"POST {PLATE} HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000000\r\n\r\n"
        with socket.create_connection((host, int(port)), timeout=600) as connection:
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


# -- estimates -----------------------------------------------------------------------------------


BAR = "/v1/components/bar/displacement"


def estimate(http, force, moment=(0, 0, 0), on_thin="estimate"):
    body = {"force": force, "moment": list(moment), "on_thin": on_thin}
    return http.post(BAR, json=body).json()


@pytest.fixture
def bar(http):
    """Serve the linear bar with its compliance known."""
    until(lambda: estimate(http, [1, 2, 3])["coverage"] == "covered")
    return http


@pytest.mark.parametrize("on_thin", ["estimate", "queue"])
def test_the_reason_names_every_load_beyond_the_range(bar, on_thin):
    reason = estimate(bar, [2000, 1, 300], on_thin=on_thin)["reason"]
    assert "fx = 2000 N" in reason
    assert "fz = 300 N" in reason
    assert "fy" not in reason
    assert reason.count("fx") == 1


def test_a_linear_component_just_added_names_the_job_that_will_tell_it(http, stand_in):
    """The reason was that the table has no rows, while the unit solve ran."""
    stand_in("endless")
    reported = estimate(http, [1, 2, 3])["reason"]
    job = http.get("/v1/jobs").json()["jobs"][-1]["id"]
    assert f"job {job} solves" in reported
    assert f"job {job} solves" in estimate(http, [1, 2, 3], on_thin="reject")["detail"]


def test_the_schema_says_whose_version_a_solves_reply_carries(http):
    paths = document(http)["paths"]
    call = paths["/v1/components/{name}/displacement"]["post"]
    fields = call["responses"]["200"]["content"]["application/json"]["schema"]["properties"]
    assert "version of the table that answers" in fields["table_version"]["description"]


def test_an_empty_batch_of_either_form_is_answered_with_nothing(http):
    body = http.post(f"{CALL}s", json={"wrenches": []}).json()
    assert (body["displacements"], body["jobs"]) == ([], [])
    kind = {"content-type": "application/octet-stream"}
    assert http.post(f"{CALL}s", content=b"", headers=kind).content == b""


@pytest.mark.parametrize("value", [True, False])
def test_a_truth_value_in_a_batch_is_refused_as_in_a_single_wrench(http, value):
    """true was 1 N, and false 0 N."""
    wrenches = [[1.5] * 6, [2.5, 3, value, 0, 0, 0]]
    reply = http.post(f"{CALL}s", json={"wrenches": wrenches, "on_thin": "estimate"})
    assert reply.status_code == 422
    assert [error["loc"] for error in reply.json()["errors"]] == ["wrenches.1.2"]


def test_a_large_batch_keeps_its_slot_until_its_reply_is_sent(http, monkeypatch):
    """Replies of many large batches were laid out at once: the slot was free before."""
    slots, pieces, seen = asyncio.Semaphore(1), batch._pieces, []
    monkeypatch.setattr(http.app.state, "large_batches", slots)
    monkeypatch.setattr(batch, "LARGE", 1)
    monkeypatch.setattr(batch, "WRITTEN", 0)

    def watched(reply, count):
        monkeypatch.setattr(batch, "WRITTEN", 1)
        for piece in pieces(reply, count):
            seen.append(slots.locked())
            yield piece

    monkeypatch.setattr(batch, "_pieces", watched)
    body = {"wrenches": [[1.0] * 6], "on_thin": "estimate"}
    assert http.post(f"{CALL}s", json=body).status_code in (200, 202)
    assert seen
    assert all(seen)
    assert not slots.locked()


def test_a_large_batch_gives_its_slot_back_though_its_reply_cannot_be_sent(http, monkeypatch):
    slots = asyncio.Semaphore(1)
    monkeypatch.setattr(http.app.state, "large_batches", slots)
    monkeypatch.setattr(batch, "LARGE", 1)

    async def gone(*_):
        raise ClientDisconnect

    monkeypatch.setattr(batch.Response, "__call__", gone)
    body = {"wrenches": [[1.0] * 6], "on_thin": "estimate"}
    with pytest.raises(ClientDisconnect):
        http.post(f"{CALL}s", json=body)
    assert not slots.locked()


def test_what_is_not_covered_can_be_refused(http):
    load_plane_table(http)
    body = {"wrenches": [[1e6, 0, 0, 0, 0, 0]], "on_thin": "reject"}
    reply = http.post("/v1/components/plane/displacements", json=body)
    assert (reply.status_code, reply.json()["uncovered"]) == (409, [0])
