"""GET coverage and GET compliance."""

import numpy as np
import pytest

from tests.service.test_http_displacement import load_plane_table

CALL = "/v1/components/plane"


def test_coverage_has_hull_gaps_and_conflicts(http):
    rows = load_plane_table(http)
    other = {"wrench": rows[1]["wrench"], "displacement": [1e-3, 0, 0, 0, 0, 0]}
    assert http.post(f"{CALL}/table", json={"rows": [other]}).status_code == 200
    body = http.get(f"{CALL}/coverage").json()
    assert body["component"] == "plane"
    assert body["rows"] == 46
    assert [axis["axis"] for axis in body["gaps"]] == ["x", "y", "z"]
    assert len(body["gaps"][0]["hull"]) == 8
    assert body["gaps"][0]["outside"] == []
    assert [conflict["rows"] for conflict in body["conflicts"]] == [[2, 46]]


def test_compliance_is_the_6x6_with_its_checks(http):
    load_plane_table(http)
    body = http.get(f"{CALL}/compliance").json()
    assert np.allclose(body["matrix"], 1e-6 * np.eye(6))
    assert body["ok"] is True
    assert body["checks"]["linear"]["says"].startswith("a 6x6 suffices")
    assert body["checks"]["symmetric"]["asymmetry"] < 1e-9
    assert body["known_loads"] == ["fx", "fy", "fz", "mx", "my", "mz"]


@pytest.mark.parametrize("call", ["coverage", "compliance"])
def test_an_empty_table_answers_and_an_unknown_component_is_404(http, call):
    body = {"name": "none", "title": "No rows", "range": {"force": [1] * 3, "moment": [1] * 3}}
    assert http.post("/v1/components", json=body).status_code == 201
    assert http.get(f"/v1/components/none/{call}").status_code == 200
    assert http.get(f"/v1/components/nope/{call}").status_code == 404
