"""Loads on locked freedoms change nothing: they make no job, no row and no answer of their own."""

import numpy as np
import pytest

from tests.until import until

NAME = "/v1/components/spring"  # ux, uy, rx and ry are locked


def jobs(http):
    return http.get("/v1/jobs").json()["jobs"]


def test_wrenches_that_differ_in_loads_on_locked_freedoms_are_one_job_with_one_row(http):
    """A loop of 8 s made 68 jobs: both of these were solved, with one answer."""
    full = {"force": [0.5, -0.5, -6], "moment": [0.001, 0.002, 0.003]}
    bare = {"force": [0, 0, -6], "moment": [0, 0, 0.003]}
    first = http.post(f"{NAME}/solve", json={**full, "wait_s": 60}).json()
    again = http.post(f"{NAME}/solve", json={**bare, "wait_s": 60}).json()
    assert len(jobs(http)) == 1
    assert (first["job"], first["row"]) == (again["job"], again["row"])
    assert first["translation"] == again["translation"]
    assert first["error"] == again["error"]
    rows = http.get(f"{NAME}/table").json()["rows"]
    assert [row["wrench"] for row in rows] == [[0, 0, -6, 0, 0, 0.003]]


def test_the_table_answers_a_full_wrench_by_the_row_without_the_idle_loads(http):
    bare = {"force": [0, 0, -6], "moment": [0, 0, 0.003]}
    solved = http.post(f"{NAME}/solve", json={**bare, "wait_s": 60}).json()
    full = {"force": [0.5, -0.5, -6], "moment": [0.001, 0.002, 0.003], "on_thin": "estimate"}
    until(lambda: http.post(f"{NAME}/displacement", json=full).json()["method"] == "row")
    result = http.post(f"{NAME}/displacement", json=full).json()
    assert result["translation"] == solved["translation"]
    assert result["coverage"] == "covered"


@pytest.mark.parametrize("on_thin", ["queue", "wait"])
def test_a_batch_of_idle_loads_is_one_job(http, stand_in, on_thin):
    stand_in("endless")
    wrenches = np.tile([0.0, 0, -6, 0, 0, 0.003], (20, 1))
    wrenches[:, [0, 1, 3, 4]] = np.random.default_rng(1).uniform(-0.01, 0.01, (20, 4))
    body = {"wrenches": wrenches.tolist(), "on_thin": on_thin, "wait_s": 0}
    reply = http.post(f"{NAME}/displacements", json=body).json()
    assert {job["id"] for job in reply["jobs"]} == {jobs(http)[0]["id"]}
    assert len(jobs(http)) == 1


def test_a_fill_asks_for_no_wrench_twice_and_for_none_that_is_known(http):
    seen = set()
    for _ in range(6):
        reply = http.post(f"{NAME}/fill", json={"budget": 30}).json()
        for job in reply["jobs"]:
            result = http.get(f"/v1/jobs/{job['id']}", params={"wait_s": 60}).json()
            assert result["status"] == "done"
            wrench = (*result["force"], *result["moment"])
            assert wrench not in seen
            assert not np.array(wrench)[[0, 1, 3, 4]].any()
            seen.add(wrench)
    assert seen


def test_a_fill_comes_to_its_end_though_most_loads_are_locked(http):
    """The first design counted four idle loads and always had "4 wrenches to go", and no job."""
    for _ in range(8):
        reply = http.post(f"{NAME}/fill", json={"budget": 30}).json()
        for job in reply["jobs"]:
            http.get(f"/v1/jobs/{job['id']}", params={"wait_s": 60})
        if not reply["jobs"]:
            break
        first = reply["stage"] == "first"
        assert not first or len(reply["jobs"]) <= 7  # two for each of two loads, and three
    assert (reply["stage"], reply["jobs"]) == ("met", [])
