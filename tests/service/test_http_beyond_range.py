"""A wrench outside the load range is solved only when that is asked for."""

import numpy as np
import pytest

NAME = "/v1/components/plate_thin"


@pytest.fixture
def high(http, stand_in):
    stand_in("endless")
    return http.get(NAME).json()["range"]["force"][2][1]


def jobs(http):
    return http.get("/v1/jobs").json()["jobs"]


def test_queue_beyond_the_range_answers_202_with_job_null_and_the_reason(http, high):
    reply = http.post(f"{NAME}/displacement", json={"force": [0, 0, 25 * high]})
    body = reply.json()
    assert reply.status_code == 202
    assert "location" not in reply.headers
    assert body["job"] is None
    assert "load range" in body["reason"]
    assert "fz" in body["reason"]
    assert jobs(http) == []


@pytest.mark.parametrize(
    ("call", "fields"),
    [("displacement", {}), ("displacement", {"on_thin": "wait", "wait_s": 0}), ("solve", {})],
)
def test_beyond_range_true_has_it_solved(http, high, call, fields):
    body = {"force": [0, 0, 2 * high], "beyond_range": True, **fields}
    reply = http.post(f"{NAME}/{call}", json=body)
    assert reply.status_code == 202
    assert len(jobs(http)) == 1


def test_a_load_a_rounding_error_beyond_the_range_counts_as_on_it(http, high):
    assert http.post(f"{NAME}/solve", json={"force": [0, 0, high * (1 + 5e-10)]}).json()["job"]
    assert http.post(f"{NAME}/solve", json={"force": [0, 0, high * (1 + 5e-9)]}).status_code == 409


def test_a_batch_that_waits_beyond_the_range_is_409_and_queues_nothing(http, high):
    wrenches = np.zeros((3, 6))
    wrenches[:, 2] = [0.1 * high, 3 * high, 0.5 * high]
    body = {"wrenches": wrenches.tolist(), "on_thin": "wait", "wait_s": 0}
    reply = http.post(f"{NAME}/displacements", json=body)
    assert reply.status_code == 409
    assert reply.json()["beyond"] == [1]
    assert jobs(http) == []
    reply = http.post(f"{NAME}/displacements", json={**body, "beyond_range": True})
    assert reply.status_code == 202
    assert len(jobs(http)) == 3


def test_a_binary_batch_takes_beyond_range_as_a_query_parameter(http, high):
    content = np.array([[0, 0, 3 * high, 0, 0, 0]], dtype="<f8").tobytes()
    headers = {"content-type": "application/octet-stream"}
    call = f"{NAME}/displacements"
    assert http.post(call, content=content, headers=headers).headers["wrenchbook-jobs"] == "0"
    reply = http.post(call, content=content, headers=headers, params={"beyond_range": True})
    assert reply.headers["wrenchbook-jobs"] == "1"
