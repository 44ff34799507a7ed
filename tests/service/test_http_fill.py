"""Filling a table only within a scene's range and for its outputs."""

import numpy as np

CALL = "/v1/components/plate_thin/fill"
NONE = [[0.0, 0.0]] * 3


def test_the_solves_of_a_fill_lie_within_its_range(http, stand_in):
    stand_in("endless")
    force = [[-10.0, 10.0], [0.0, 0.0], [-50.0, -20.0]]
    reply = http.post(CALL, json={"budget": 5, "range": {"force": force, "moment": NONE}})
    assert reply.status_code == 202
    jobs = [http.get(one["url"]).json() for one in reply.json()["jobs"]]
    wrenches = np.array([job["force"] + job["moment"] for job in jobs])
    assert len(wrenches) == 5
    low, high = np.array(force + NONE).T
    assert (wrenches >= low).all()
    assert (wrenches <= high).all()
    assert len(np.unique(wrenches, axis=0)) == 5


def test_a_fill_that_queues_less_than_its_budget_says_why(http, stand_in):
    stand_in("endless")
    reply = http.post(CALL, json={"budget": 30}).json()
    assert len(reply["jobs"]) == 9
    assert reply["reason"].startswith("9 of at most 30 solves: the first design needs 9")


def test_a_fill_of_some_outputs_is_taken(http, stand_in):
    stand_in("endless")
    reply = http.post(CALL, json={"budget": 2, "outputs": ["uz", "rx"]})
    assert reply.status_code == 202
    assert len(reply.json()["jobs"]) == 2


def test_a_fill_for_a_joint_is_taken(http, stand_in):
    stand_in("endless")
    reply = http.post(CALL, json={"budget": 2, "for_joint": True})
    assert reply.status_code == 202
    assert len(reply.json()["jobs"]) == 2
