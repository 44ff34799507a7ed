"""Estimates where the table does not cover: never absurd, with every reason and who mends it."""

import numpy as np
import pytest

from tests.service.document import document
from tests.until import until

CALL = "/v1/components/bar/displacement"


def estimate(http, force, moment=(0, 0, 0), on_thin="estimate"):
    body = {"force": force, "moment": list(moment), "on_thin": on_thin}
    return http.post(CALL, json=body).json()


@pytest.fixture
def bar(http):
    """Serve the linear bar with its compliance known."""
    until(lambda: estimate(http, [1, 2, 3])["coverage"] == "covered")
    return http


def test_an_estimate_beyond_what_tables_may_hold_is_null_with_the_reason(bar):
    """fx = 1e5 turned a plate by 321 rad, fx = 1e99 moves it by 3e94 m."""
    for force, moment in [([1e99, 0, 0], [0] * 3), ([2e7, 0, 0], [0] * 3), ([0] * 3, [0, 5e5, 0])]:
        found = estimate(bar, force, moment)
        assert found["translation"] is None
        assert found["rotation"] is None
        assert found["error"] is None
        assert "20 degrees and 10 m" in found["reason"]
        assert found["coverage"] == "outside"
    near = estimate(bar, [5e6, 0, 0], [0, 3e5, 0])
    assert near["translation"][0] == pytest.approx(5.0)
    assert near["rotation"][1] == pytest.approx(0.3)


def test_a_batch_has_no_estimate_either_where_none_could_be_true(bar):
    wrenches = np.zeros((3, 6))
    wrenches[:, 0] = 10.0, 1e99, 5e6
    body = {"wrenches": wrenches.tolist(), "on_thin": "estimate"}
    found = bar.post("/v1/components/bar/displacements", json=body).json()
    assert found["displacements"][1] == found["errors"][1] == [None] * 6
    assert found["displacements"][2][0] == pytest.approx(5.0)


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
    told = estimate(http, [1, 2, 3])["reason"]
    job = http.get("/v1/jobs").json()["jobs"][-1]["id"]
    assert f"job {job} solves" in told
    assert f"job {job} solves" in estimate(http, [1, 2, 3], on_thin="reject")["detail"]


def test_the_schema_says_whose_version_a_solves_reply_carries(http):
    paths = document(http)["paths"]
    call = paths["/v1/components/{name}/displacement"]["post"]
    fields = call["responses"]["200"]["content"]["application/json"]["schema"]["properties"]
    assert "the version of the table that answers" in fields["table_version"]["description"]
