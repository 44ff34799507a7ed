"""GET coverage and GET compliance."""

import io

import numpy as np
import pytest

from tests.service.following import wait_for_version
from tests.service.live import FULL, as_rows, full_wrenches, moved, tangents
from tests.service.test_http_displacement import add, load, load_plane_table

CALL = "/v1/components/plane"


def test_coverage_has_hull_gaps_and_conflicts(http):
    rows = load_plane_table(http)
    other = {"wrench": rows[1]["wrench"], "displacement": [1e-3, 0, 0, 0, 0, 0]}
    assert http.post(f"{CALL}/table?wait_s=600", json={"rows": [other]}).status_code == 200
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
    assert body["checks"]["linear"]["says"].startswith("one 6x6 compliance describes")
    assert body["checks"]["symmetric"]["asymmetry"] < 1e-9
    assert body["known_loads"] == ["fx", "fy", "fz", "mx", "my", "mz"]


def test_compliance_at_no_load_is_the_tangent_and_not_a_fit_over_the_range(http):
    """The page showed the fit, 2.17e-6, as "at no load"; the tangent is 3.00e-6."""
    wrenches = full_wrenches(40)
    load(http, "soft", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
    body = http.get("/v1/components/soft/compliance").json()
    tangent = tangents(np.zeros((1, 6)))[0]
    assert body["tangent_origin"] == "kriging"
    # Of what the largest load moves: 1e-4 m or rad.
    np.testing.assert_allclose(body["tangent"] * FULL, tangent * FULL, atol=3e-6)
    mean = np.diag(body["matrix"])
    assert (mean < 0.9 * np.diag(tangent)).all()
    assert body["origin"] == "fitted"
    rest = np.zeros((1, 6))
    add(http, "soft", as_rows(rest, moved(rest), tangent[None]))
    body = http.get("/v1/components/soft/compliance").json()
    assert body["tangent_origin"] == "row"
    assert body["tangent"] == tangent.tolist()


def test_the_tangent_at_no_load_is_null_where_no_row_tells_it(http):
    load(http, "rig", [])
    empty = http.get("/v1/components/rig/compliance").json()
    assert (empty["tangent"], empty["tangent_origin"]) == ([[None] * 6] * 6, "none")
    wrenches = np.zeros((9, 6))
    wrenches[:, 2] = np.linspace(-100, 100, 9)
    partial = moved(wrenches)
    partial[:, 4] = np.nan
    add(http, "rig", as_rows(wrenches, partial))
    reported = http.get("/v1/components/rig/compliance").json()["tangent"]
    assert [[value is not None for value in line] for line in reported] == [
        [load == 2 and output != 4 for load in range(6)] for output in range(6)
    ]
    assert reported[2][2] == pytest.approx(1e-6, rel=0.05)


@pytest.mark.parametrize("call", ["coverage", "compliance"])
def test_an_empty_table_answers(http, call):
    assert http.get(f"/v1/components/plate/{call}").status_code == 200


# -- a table of some outputs ---------------------------------------------------------------------


RANGE = {"force": [100] * 3, "moment": [10] * 3}
RIG = "/v1/components/rig"


@pytest.fixture
def rig(http):
    """Load a rig's table that measured only u_z under F_z and M_x."""
    body = {"name": "rig", "title": "Rig", "range": RANGE}
    assert http.post("/v1/components", json=body).status_code == 201
    text = io.StringIO()
    text.write("fz [N],mx [N*m],uz [mm]\n")
    for force in np.linspace(-100, 100, 6):
        for moment in np.linspace(-10, 10, 5):
            text.write(f"{force},{moment},{1e-2 * force + 1e-3 * moment}\n")
    reply = http.post(
        f"{RIG}/table?missing_loads=zero",
        content=text.getvalue(),
        headers={"content-type": "text/csv"},
    )
    assert reply.status_code == 200, reply.text
    assert reply.json()["inserted"] == 30
    wait_for_version(http, "rig", reply.json()["table_version"])
    return http


def test_what_was_not_measured_is_null_and_empty_in_answers_and_exports(rig):
    wrench = {"force": [0, 0, 33], "moment": [2, 0, 0], "on_thin": "estimate"}
    body = rig.post(f"{RIG}/displacement", json=wrench).json()
    assert body["translation"] == [None, None, pytest.approx(0.332e-3)]
    assert (body["rotation"], body["coverage"]) == ([None] * 3, "covered")
    assert "not measured in any row: ux, uy, rx, ry, rz" in body["reason"]
    rows = rig.get(f"{RIG}/table").json()["rows"]
    assert rows[0]["displacement"][0] is None
    assert rig.get(f"{RIG}/table?format=csv").text.splitlines()[1].count(",,") >= 2
    assert rig.post(f"{RIG}/table", json={"rows": rows}).json()["existing"] == 30


def test_the_mean_compliance_is_null_of_an_output_that_no_row_measured(rig):
    body = rig.get(f"{RIG}/compliance").json()
    assert body["matrix"][2] == pytest.approx([0, 0, 1e-5, 1e-6, 0, 0])
    assert (body["matrix"][0], body["error"][0]) == ([None] * 6, None)


def test_the_mean_compliance_has_outputs_that_fewer_rows_measured_too(rig):
    rows = as_rows(full_wrenches(20) / FULL, 1e-6 * full_wrenches(20) / FULL)
    add(rig, "rig", rows)
    matrix = np.array(rig.get(f"{RIG}/compliance").json()["matrix"], dtype=float)
    assert matrix[0, 0] == pytest.approx(1e-6)
    assert abs(matrix[2, 2]) > 5e-6


def test_the_component_says_what_no_row_holds(rig):
    summary = rig.get(RIG).json()["coverage"]
    assert summary["unmeasured"] == ["ux", "uy", "rx", "ry", "rz"]
    assert summary["rows_per_output"]["uz"] == 30


def test_a_component_says_which_method_answers_and_why_and_detail_says_how(http):
    wrenches = full_wrenches(30)
    load(http, "solved", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
    coverage = http.get("/v1/components/solved?wait_s=60").json()["coverage"]
    assert coverage["method"] == "kriging"
    assert "left-out rows" in coverage["method_reason"]
    assert "more rows help" not in coverage["method_reason"]
    assert 0.0 < coverage["errors_left_out"]["kriging"] < 0.01
    assert "one factor over 30 rows" in coverage["method_detail"]
    for more, said in (
        ({}, None),
        ({"detail": True}, coverage["method_detail"]),
        ({"detail": True, "method": "griddata"}, "asked for"),
    ):
        body = {"force": [10.0, 0.0, -20.0], "moment": [0.0, 3.0, 0.0], **more}
        body["on_thin"] = "estimate"
        reply = http.post("/v1/components/solved/displacement", json=body).json()
        assert reply.get("method_detail") == said


def test_the_detail_of_a_table_without_rows_says_so(http):
    """It said "asked for" although the query named no method."""
    wrench = {"force": [1, 0, 0], "moment": [0, 0, 0], "on_thin": "estimate", "detail": True}
    reply = http.post("/v1/components/plate_thin/displacement", json=wrench).json()
    assert reply["method_detail"].startswith("the table has no rows")
