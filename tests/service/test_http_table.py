import csv
import io

import numpy as np
import pytest

RIG = {"name": "rig", "title": "rig", "range": {"force": [900] * 3, "moment": [90] * 3}}
CALL = "/v1/components/rig/table"
LBF, MM = 4.4482216152605, 1e-3
HEADER = "Fx [lbf],Fy [lbf],Fz [lbf],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]"


def measured(count=500, seed=7):
    rng = np.random.default_rng(seed)
    forces = rng.uniform(-200, 200, (count, 3)).round(3)
    return np.hstack([forces, (0.01 * forces).round(6), (1e-3 * forces).round(6)])


def as_csv(rows, bad=()):
    lines = [HEADER, *(",".join(map(repr, row)) for row in rows.tolist())]
    for line, text in bad:
        lines[line - 1] = text
    return "\n".join(lines) + "\n"


@pytest.fixture
def rig(http):
    assert http.post("/v1/components", json=RIG).status_code == 201
    return http


def load(http, text, **query):
    return http.post(CALL, content=text, headers={"content-type": "text/csv"}, params=query)


def test_measured_rows_in_lbf_and_mm_load_and_export_to_the_same_numbers(rig):
    rows = measured()
    assert load(rig, as_csv(rows)).json()["inserted"] == 500
    units = {"format": "csv", "force": "lbf", "translation": "mm", "rotation": "deg"}
    exported = list(csv.DictReader(io.StringIO(rig.get(CALL, params=units).text)))
    names = [name for name in exported[0] if name.split()[0][:2] in ("fx", "fy", "fz")]
    back = np.array([[float(row[name]) for name in names] for row in exported])
    assert np.allclose(back, rows[:, :3], rtol=1e-12)
    moved = np.array([[float(row[f"{u} [mm]"]) for u in ("ux", "uy", "uz")] for row in exported])
    assert np.allclose(moved, rows[:, 3:6], rtol=1e-12)


def test_the_stored_rows_are_si(rig):
    load(rig, as_csv(measured(4)))
    row = rig.get(CALL, params={"format": "json"}).json()["rows"][0]
    assert row["wrench"][0] == pytest.approx(measured(4)[0, 0] * LBF, rel=1e-12)
    assert row["displacement"][0] == pytest.approx(measured(4)[0, 3] * MM, rel=1e-12)
    assert row["source"] == "measured"


def test_three_bad_rows_are_named_and_nothing_is_loaded(rig):
    bad = [
        (5, "1,2,3,0.1,0.1,many,0,0,0"),
        (17, "1,2,nan,0.1,0.1,0.1,0,0,0"),
        (400, "1,2,3,0.1,0.1,0.1,0,0"),
    ]
    reply = load(rig, as_csv(measured(), bad))
    errors = reply.json()["errors"]
    assert reply.status_code == 422
    assert [error["row"] for error in errors] == [5, 17, 400]
    assert [error["field"] for error in errors[:2]] == ["uz [mm]", "Fz [lbf]"]
    assert all(error["message"] for error in errors)
    assert rig.get("/v1/components/rig").json()["rows"] == 0


def test_a_dry_run_counts_and_loads_nothing(rig):
    body = load(rig, as_csv(measured(50)), dry_run=True).json()
    assert (body["inserted"], body["errors"]) == (50, [])
    assert rig.get("/v1/components/rig").json()["rows"] == 0


def test_a_dry_run_lists_the_mistakes_without_refusing(rig):
    reply = load(rig, as_csv(measured(9), [(3, "1,2,3,x,0,0,0,0,0")]), dry_run=True)
    assert reply.status_code == 200
    assert [error["row"] for error in reply.json()["errors"]] == [3]


def test_loading_twice_changes_nothing_the_second_time(rig):
    text = as_csv(measured(20))
    assert load(rig, text).json()["inserted"] == 20
    body = load(rig, text).json()
    assert (body["inserted"], body["existing"]) == (0, 20)


def test_an_imported_row_answers_at_once(rig):
    rows = measured()
    load(rig, as_csv(rows))
    force = (rows[3, :3] * LBF).tolist()
    body = {"force": force, "moment": [0, 0, 0], "on_thin": "estimate"}
    reply = rig.post("/v1/components/rig/displacement", json=body).json()
    assert reply["translation"] is not None
    assert reply["table_version"] > 0


def test_an_export_of_solves_comes_back_to_the_same_setup_as_known_rows(http):
    body = {"force": [1, 2, 3], "moment": [0, 0, 0], "wait_s": 20}
    http.post("/v1/components/plate_thin/solve", json=body)
    for kind in ("csv", "json"):
        text = http.get("/v1/components/plate_thin/table", params={"format": kind}).content
        reply = http.post(
            "/v1/components/plate_thin/table", content=text, params={"format": kind}
        ).json()
        assert (reply["inserted"], reply["existing"]) == (0, 1)


def test_solves_of_another_setup_are_refused_by_row(http):
    row = {"wrench": [1, 0, 0, 0, 0, 0], "displacement": [0] * 6, "source": "fea"}
    body = {"rows": [row, {**row, "fingerprint": "abc"}]}
    reply = http.post("/v1/components/plate_thin/table", json=body)
    assert reply.status_code == 422
    assert [(e["row"], e["field"]) for e in reply.json()["errors"]] == [
        (1, "fingerprint"),
        (2, "fingerprint"),
    ]
    assert "measured" in reply.json()["errors"][0]["message"]


def test_an_unknown_export_unit_is_422(rig):
    load(rig, as_csv(measured(3)))
    reply = rig.get(CALL, params={"format": "csv", "force": "mm"})
    assert reply.status_code == 422


def test_a_table_of_unknown_media_type_is_refused_with_what_to_do(rig):
    reply = rig.post(CALL, content=b"x", headers={"content-type": "application/pdf"})
    assert reply.status_code == 415
    assert "text/csv" in reply.json()["detail"]
