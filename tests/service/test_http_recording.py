"""Recordings and envelopes over HTTP: LM_direct, LM_max and LM_start."""

from itertools import product

import numpy as np
import pytest

from tests.service.live import add_table, as_rows, clean_wrenches, full_wrenches, served

PLATE = "/v1/components/plate_thin"  # plus and minus 1000 1000 2000 N, 100 100 100 N·m
BAR = "/v1/components/bar"  # linear
BINARY = {"headers": {"content-type": "application/octet-stream"}}
SCALE = np.array([1000.0, 1000.0, 2000.0, 100.0, 100.0, 100.0])


def wrenches_of(count, seed=1):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6)) * SCALE


def post(http, call, wrenches, **more):
    return http.post(f"{PLATE}/{call}", json={"wrenches": np.asarray(wrenches).tolist(), **more})


def wait_until_done(http, jobs):
    for job in jobs:
        assert http.get(job["url"], params={"wait_s": 60}).json()["status"] == "done"


# -- recordings -------------------------------------------------------------------------------


def test_recorded_wrenches_are_listed_as_they_came_as_json_or_float64(http):
    wrenches = wrenches_of(7)
    content = wrenches[3:].astype("<f8").tobytes()
    for reply, count in (
        (post(http, "recording", wrenches[:3]), 3),
        (http.post(f"{PLATE}/recording", content=content, **BINARY), 4),
    ):
        assert (reply.status_code, reply.json()["recorded"]) == (201, count)
    assert http.get(f"{PLATE}/recording").json()["wrenches"] == wrenches.tolist()
    assert http.delete(f"{PLATE}/recording").json()["cleared"] == 7


@pytest.mark.parametrize("call", ["recording", "envelope"])
def test_a_block_sent_twice_counts_once(http, call):
    block = {"client": "loop", "sequence": 4}
    assert not post(http, call, wrenches_of(5), **block).json()["duplicate"]
    again = post(http, call, wrenches_of(5), **block)
    assert (again.status_code, again.json()["duplicate"]) == (200, True)
    result = http.get(f"{PLATE}/{call}").json()
    assert result.get("total", result.get("count")) == 5


def test_a_key_used_for_other_wrenches_is_refused_and_says_what_to_do(http):
    post(http, "recording", wrenches_of(5), client="a", sequence=1)
    reply = post(http, "recording", wrenches_of(5, 2), client="a", sequence=1)
    assert reply.status_code == 409
    assert "give each block its own number" in reply.json()["detail"]
    assert http.get(f"{PLATE}/recording").json()["total"] == 5


def test_more_than_ten_thousand_are_thinned_and_the_reply_says_so(http):
    for seed in (1, 2):
        post(http, "recording", wrenches_of(6000, seed))
    result = http.get(f"{PLATE}/recording").json()
    assert result["total"] == 12_000
    assert len(result["wrenches"]) == result["kept"] <= 10_000
    assert result["kept"] + result["merged"] + result["thinned"] == 12_000
    assert "thinned out" in result["reason"]
    assert result["within"] < 1


def test_a_flood_of_blows_takes_no_place_from_what_is_within_the_range(http):
    usual = wrenches_of(2000)
    post(http, "recording", usual)
    for seed in (2, 3):
        post(http, "recording", wrenches_of(9000, seed) * 1e6)
    result = http.get(f"{PLATE}/recording").json()
    assert result["wrenches"][:2000] == usual.tolist()
    assert result["within"] == 0.0
    assert result["kept"] <= 3000


def test_a_wrench_outside_the_range_is_kept_told_and_not_solved_by_itself(http, stand_in):
    stand_in("endless")
    reply = post(http, "recording", [[0, 0, -1e6, 0, 0, 0], [0, 0, -5, 0, 0, 0]]).json()
    assert reply["outside"] == 1
    assert "outside the load range" in reply["reason"]
    started = http.post(f"{PLATE}/recording/start", json={}).json()
    assert (len(started["jobs"]), started["beyond_range"]) == (1, 1)
    assert "beyond_range true" in started["reason"]
    both = http.post(f"{PLATE}/recording/start", json={"beyond_range": True}).json()
    assert len(both["jobs"]) == 2


def test_recording_queues_nothing(http):
    post(http, "recording", wrenches_of(200))
    post(http, "envelope", wrenches_of(200))
    assert http.get("/v1/jobs").json()["jobs"] == []


@pytest.mark.parametrize("part", [PLATE, BAR])
def test_wrenches_of_any_size_are_taken_and_break_nothing(http, part):
    huge = {"wrenches": [[1e308] * 6, [-1e308] * 6, [5e-324] * 6]}
    for call in ("recording", "envelope"):
        assert http.post(f"{part}/{call}", json=huge).status_code in (200, 201)
        result = http.get(f"{part}/{call}")
        assert result.status_code == 200
        assert result.json()["outside"] == 2
    assert http.get(f"{part}/envelope").json()["negligible"] is None


# -- LM_start ---------------------------------------------------------------------------------


def test_a_start_solves_what_is_recorded_once_and_then_has_nothing_to_do(http):
    wrenches = wrenches_of(6)
    post(http, "recording", wrenches)
    reply = http.post(f"{PLATE}/recording/start", json={})
    assert reply.status_code == 202
    wait_until_done(http, reply.json()["jobs"])
    again = http.post(f"{PLATE}/recording/start", json={})
    assert again.status_code == 200
    assert (again.json()["solved"], again.json()["jobs"]) == (6, [])
    table = http.get(f"{PLATE}/table").json()["rows"]
    assert sorted(row["wrench"] for row in table) == sorted(wrenches.tolist())


def test_a_start_is_not_held_by_the_limit_of_queries_but_by_its_budget(http, stand_in):
    stand_in("endless")
    post(http, "recording", wrenches_of(100))
    some = http.post(f"{PLATE}/recording/start", json={"budget": 10}).json()
    assert (len(some["jobs"]), some["left"]) == (10, 90)
    assert "start again" in some["reason"]
    all_ = http.post(f"{PLATE}/recording/start").json()
    assert (len(all_["jobs"]), all_["left"]) == (100, 0)


def test_a_budget_is_spent_on_those_farthest_apart(http, stand_in):
    stand_in("endless")
    wrenches = wrenches_of(1).repeat(30, axis=0)
    wrenches[:, 0] += np.linspace(0, 1, 30)
    wrenches[13, 2] = -wrenches[13, 2]
    post(http, "recording", wrenches)
    jobs = http.post(f"{PLATE}/recording/start", json={"budget": 2}).json()["jobs"]
    solved = [http.get(job["url"]).json() for job in jobs]
    assert wrenches[13].tolist() in [job["force"] + job["moment"] for job in solved]


def test_a_failed_solve_is_told_and_not_tried_again_by_itself(http, stand_in):
    stand_in("diverges")
    post(http, "recording", wrenches_of(1))
    job = http.post(f"{PLATE}/recording/start").json()["jobs"][0]
    http.get(job["url"], params={"wait_s": 60})
    again = http.post(f"{PLATE}/recording/start").json()
    assert (again["failed"], again["jobs"]) == (1, [])
    assert "retry" in again["reason"]


def test_nothing_recorded_is_no_error_and_says_so(http):
    for call in ("recording", "envelope"):
        reply = http.post(f"{PLATE}/{call}/start")
        assert reply.status_code == 200
        assert reply.json()["reason"].startswith("nothing is recorded yet; run a simulation")


@pytest.mark.parametrize("call", ["recording", "envelope"])
def test_a_component_without_finite_elements_keeps_wrenches_and_says_what_to_do(http, call):
    body = {"name": "rig", "title": "r", "range": {"force": [9, 9, 9], "moment": [1, 1, 1]}}
    http.post("/v1/components", json=body)
    path = f"/v1/components/rig/{call}"
    assert http.post(path, json={"wrenches": [[1] * 6]}).status_code < 300
    reply = http.post(f"{path}/start")
    assert reply.status_code == 409
    assert "load the rows with: wrenchbook import rig FILE" in reply.json()["detail"]


def test_a_linear_component_is_solved_once_however_many_wrenches_were_recorded(http, stand_in):
    stand_in("endless")
    wrenches = np.random.default_rng(1).uniform(-1, 1, (50, 6)).tolist()
    http.post(f"{BAR}/recording", json={"wrenches": wrenches})
    started = http.post(f"{BAR}/recording/start").json()
    assert 1 <= len(started["jobs"]) <= 6
    assert "linear" in started["reason"]


# -- envelopes --------------------------------------------------------------------------------


def test_an_envelope_has_the_extremes_of_each_load_and_the_whole_wrenches_there(http):
    wrenches = wrenches_of(500)
    for start in range(0, 500, 100):
        post(http, "envelope", wrenches[start : start + 100])
    result = http.get(f"{PLATE}/envelope").json()
    assert result["count"] == 500
    assert result["min"] == wrenches.min(axis=0).tolist()
    assert result["max"] == wrenches.max(axis=0).tolist()
    assert result["at_min"] == wrenches[wrenches.argmin(axis=0)].tolist()
    assert result["at_max"] == wrenches[wrenches.argmax(axis=0)].tolist()


def test_the_extremes_are_solved_each_once(http):
    wrenches = np.array([[1, 2, 3, 4, 5, 6], [-1, -2, -3, -4, -5, -6], [0, 0, 1, 0, 0, 0]], float)
    post(http, "envelope", wrenches)
    jobs = http.post(f"{PLATE}/envelope/start").json()["jobs"]
    assert len(jobs) == 2
    wait_until_done(http, jobs)
    assert http.post(f"{PLATE}/envelope/start").json()["solved"] == 2


def test_nothing_is_called_negligible_while_nothing_is_known(http):
    post(http, "envelope", np.zeros((1, 6)) + 1e-9)
    result = http.get(f"{PLATE}/envelope").json()
    assert result["negligible"] is None
    assert result["displacement_bound"] == [None] * 6
    assert "start" in result["reason"]


def linear_rows():
    """Rows of a linear response, u = C w, and its C."""
    matrix = np.random.default_rng(3).normal(size=(6, 6)) * 1e-7
    wrenches = np.concatenate([clean_wrenches(), full_wrenches(40)])
    tangents = np.broadcast_to(matrix, (len(wrenches), 6, 6))
    return as_rows(wrenches, wrenches @ matrix.T, tangents), matrix


def test_the_bound_of_an_envelope_is_the_largest_answer_in_its_box(tmp_path):
    """Of a linear response the largest is at a corner: it is found, and not exceeded by much."""
    rows, matrix = linear_rows()
    tolerance = {"translation": 1e-3, "rotation": 1e-3}
    with served(tmp_path) as client:
        add_table(client, "part", rows, tolerance=tolerance)
        wrenches = 0.5 * full_wrenches(30, 7)
        client.widen_envelope("part", wrenches)
        result = client.envelope("part")
        low, high = wrenches.min(axis=0), wrenches.max(axis=0)
        corners = np.array(list(product(*zip(low, high, strict=True))))
        largest = np.abs(corners @ matrix.T).max(axis=0)
        assert (result.displacement_bound >= largest * (1 - 1e-9)).all()
        assert (result.displacement_bound <= largest * 1.5 + 1e-9).all()
        assert (result.bound, result.negligible) == ("estimate", True)
        tight = {"translation": largest[:3].max() / 2, "rotation": 1.0}
        assert client.envelope("part", tolerance=tight).negligible is False
