"""A test rig's table that holds only some outputs, through HTTP."""

import io

import numpy as np
import pytest

from tests.service.following import wait_for_version

RANGE = {"force": [100] * 3, "moment": [10] * 3}
CALL = "/v1/components/rig"


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
        f"{CALL}/table?missing_loads=zero",
        content=text.getvalue(),
        headers={"content-type": "text/csv"},
    )
    assert reply.status_code == 200, reply.text
    assert reply.json()["inserted"] == 30
    wait_for_version(http, "rig", reply.json()["table_version"])
    return http


def test_what_was_not_measured_is_null_and_what_was_is_a_number(rig):
    wrench = {"force": [0, 0, 33], "moment": [2, 0, 0], "on_thin": "estimate"}
    body = rig.post(f"{CALL}/displacement", json=wrench).json()
    assert body["translation"][:2] == [None, None]
    assert body["translation"][2] == pytest.approx(0.332e-3)
    assert body["rotation"] == [None] * 3
    assert body["error"]["translation"][0] is None
    assert body["coverage"] == "covered"
    assert "not measured in any row: ux, uy, rx, ry, rz" in body["reason"]


def test_a_batch_and_an_export_have_null_and_empty_fields(rig):
    body = {"wrenches": [[0, 0, 33, 2, 0, 0]], "on_thin": "estimate"}
    row = rig.post(f"{CALL}/displacements", json=body).json()["displacements"][0]
    assert row[:2] + row[3:] == [None] * 5
    exported = rig.get(f"{CALL}/table").json()["rows"][0]
    assert exported["displacement"][0] is None
    assert rig.get(f"{CALL}/table?format=csv").text.splitlines()[1].count(",,") >= 2
    again = rig.post(f"{CALL}/table", json={"rows": rig.get(f"{CALL}/table").json()["rows"]})
    assert again.json()["existing"] == 30


def test_the_component_says_what_no_row_holds(rig):
    summary = rig.get(CALL).json()["coverage"]
    assert summary["unmeasured"] == ["ux", "uy", "rx", "ry", "rz"]
    assert summary["rows_per_output"]["uz"] == 30
