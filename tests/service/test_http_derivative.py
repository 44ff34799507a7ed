"""Derivatives on the wire: what they are, where there are none, and the binary form."""

import numpy as np
import pytest

from tests.service.following import wait_for_version
from tests.service.live import FULL, as_rows, clean_wrenches, full_wrenches, moved, tangents

LOADS = {"force": [10.0, 0.0, -20.0], "moment": [0.0, 3.0, 0.0]}


@pytest.fixture
def solved(http):
    load(http, "solved", full_wrenches(30), tangents(full_wrenches(30)))
    return http


def load(http, name, wrenches, compliances=None):
    body = {"name": name, "title": name, "range": {"force": [100] * 3, "moment": [10] * 3}}
    assert http.post("/v1/components", json=body).status_code == 201
    rows = as_rows(wrenches, moved(wrenches), compliances)
    reply = http.post(f"/v1/components/{name}/table", json={"rows": rows})
    wait_for_version(http, name, reply.json()["table_version"])


def ask(http, name, **more):
    body = {**LOADS, "on_thin": "estimate", **more}
    return http.post(f"/v1/components/{name}/displacement", json=body).json()


def test_derivatives_are_there_only_if_they_are_asked_for(solved):
    assert "derivative" not in ask(solved, "solved")
    assert np.shape(ask(solved, "solved", derivatives=True)["derivative"]) == (6, 6)
    batch = solved.post("/v1/components/solved/displacements", json={"wrenches": [[1.0] * 6]})
    assert "derivatives" not in batch.json()


@pytest.mark.parametrize("method", ["griddata", "additive", "kriging", "linear"])
def test_a_derivative_is_what_answers_differ_by(http, method):
    wrenches = np.concatenate([clean_wrenches(), full_wrenches(24)])
    load(http, "mixed", wrenches, tangents(wrenches))
    here = np.array([10.0, 12.0, -20.0, 1.0, 3.0, -2.0])
    asked = {"force": here[:3].tolist(), "moment": here[3:].tolist(), "method": method}
    told = np.array(ask(http, "mixed", derivatives=True, **asked)["derivative"])
    for place, step in enumerate(1e-3 * FULL):
        ends = np.array([here, here])
        ends[:, place] += [-step, step]
        body = {"wrenches": ends.tolist(), "on_thin": "estimate", "method": method}
        reply = http.post("/v1/components/mixed/displacements", json=body).json()
        low, high = np.array(reply["displacements"])
        slope = (high - low) / (2 * step)
        np.testing.assert_allclose(told[:, place], slope, atol=1e-3 * np.abs(slope).max())


def test_a_row_that_answers_tells_its_own_tangent_and_null_if_it_has_none(http):
    wrenches = np.array([[30.0, 0, 0, 0, 0, 0], [0, 30.0, 0, 0, 0, 0], [0, 0, 5.0, 0, 0, 1.0]])
    load(http, "few", wrenches[:2], tangents(wrenches)[:2])
    load(http, "bare", wrenches)
    asked = {"force": [30.0, 0, 0], "moment": [0.0] * 3}
    for name in ("few", "bare"):
        body = ask(http, name, **asked, derivatives=True)
        batch = http.post(
            f"/v1/components/{name}/displacements",
            json={"wrenches": wrenches[:1].tolist(), "on_thin": "estimate", "derivatives": True},
        ).json()
        assert body["method"] == "row"
        expected = tangents(wrenches)[0].tolist() if name == "few" else None
        assert body["derivative"] == expected
        assert batch["derivatives"] == [expected]


def test_the_binary_form_has_derivatives_behind_the_answers(solved):
    wrenches = full_wrenches(7, 3)
    call = "/v1/components/solved/displacements"
    json_form = solved.post(
        call, json={"wrenches": wrenches.tolist(), "on_thin": "estimate", "derivatives": True}
    ).json()
    reply = solved.post(
        call,
        content=wrenches.astype("<f8").tobytes(),
        headers={"Content-Type": "application/octet-stream"},
        params={"on_thin": "estimate", "derivatives": "true"},
    )
    numbers = np.frombuffer(reply.content, dtype="<f8")
    assert len(numbers) == 7 * (13 + 36)
    told = numbers[7 * 13 :].reshape(7, 6, 6)
    np.testing.assert_array_equal(told, np.array(json_form["derivatives"]))
    assert reply.headers["wrenchbook-method"] == json_form["method"] == "kriging"


def test_an_empty_table_knows_no_derivative(http):
    assert ask(http, "plate", derivatives=True)["derivative"] is None


def test_a_component_says_which_method_answers_and_why_and_detail_says_how(solved):
    coverage = solved.get("/v1/components/solved").json()["coverage"]
    assert coverage["method"] == "kriging"
    assert "left-out rows" in coverage["method_reason"]
    assert 0.0 < coverage["errors_left_out"]["kriging"] < 0.01
    assert "one factor over 30 rows" in coverage["method_detail"]
    assert "method_detail" not in ask(solved, "solved")
    assert ask(solved, "solved", detail=True)["method_detail"] == coverage["method_detail"]
    asked = ask(solved, "solved", detail=True, method="griddata")
    assert asked["method_detail"] == "asked for"
