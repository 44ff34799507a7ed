"""Profiles of test rigs: shipped ones, stored ones, and the options of an import that win."""

import pytest

from tests.service.test_import_findings import CALL
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.rigs import SHIPPED, rig_of, store_rig
from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.ops.restore import restore

SPANS = {"force": [2000] * 3, "moment": [90] * 3}
GAUGE = "time [s],uz [mm]\n0.5,0.25\n"
# Made-up files as the exporters of these rigs write them. Each has 0.25 mm at 1 kN.
SIX = [f"wrench.{what}.{axis}" for what in ("force", "torque") for axis in "xyz"]
LAYOUTS = {
    "zwick": '"Prüfzeit";"Standardkraft";"Standardweg"\n"s";"N";"mm"\n0,1;0;0\n0,2;1000,0;0,25\n',
    "zwick in brackets": "Kraft [kN];Traversenweg [mm];Zeit [s]\n0,5;0,125;1\n1,0;0,25;2\n",
    "instron": "Time,Extension,Load\n(s),(mm),(N)\n1,0.125,500\n2,0.25,1000\n",
    "instron in brackets": "Time (s),Compressive extension (mm),Compressive load (kN)\n1,-0.25,-1",
    "lvm": "X_Value\tForce [N]\tDisplacement [mm]\tComment\n0\t500\t0.125\t\n1\t1000\t0.25\t\n",
    "ati": "Start Time: 1/2/2026\nRDT Sample Rate: 1\nForce Units: N\nCounts per Unit Force: 1000\n"
    "Torque Units: N-m\nCounts per Unit Torque: 1000\nStatus (hex),RDT Sequence,F/T Sequence,"
    "Fx,Fy,Fz,Tx,Ty,Tz\n0,1,1,0,0,1000000,0,0,0\n0,2,2,0,0,1000000,0,0,0\n",
    "ur": f"timestamp,actual_q_0,{','.join(f'actual_TCP_force_{k}' for k in range(6))}\n"
    "0,9,0,0,1000,0,0,0\n1,9,0,0,1000,0,0,0\n",
    "ros": f"%time,field.header.seq,field.header.frame_id,field.{',field.'.join(SIX)}\n"
    "0,1,tool,0,0,1000,0,0,0\n1000000000,2,tool,0,0,1000,0,0,0\n",
    "ros by bagpy": f"Time,header.seq,header.stamp.secs,{','.join(SIX)}\n"
    "0,1,0,0,0,1000,0,0,0\n1,2,1,0,0,1000,0,0,0\n",
}


@pytest.fixture
def rig(http):
    http.post("/v1/components", json={"name": "rig", "title": "R", "range": SPANS})
    return http


def test_each_shipped_profile_has_a_layout_here():
    assert {file.stem for file in SHIPPED.glob("*.toml")} == {name.split()[0] for name in LAYOUTS}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_shipped_profile_reads_the_files_of_its_rig(rig, layout):
    name, text = layout.split()[0], LAYOUTS[layout]
    query = {"rig": name, "dry_run": "true", "preview": 9}
    if name in ("ati", "ur", "ros"):
        files = {"loads": ("a.csv", text), "displacements": ("b.csv", GAUGE)}
        lag = {"lag": 1.0} if name == "ati" else {}
        reply = rig.post(CALL, files=files, params=query | lag)
    else:
        reply = rig.post(CALL, content=text.encode(), params=query)
    body = reply.json()
    assert (reply.status_code, body["errors"], body["rig"]["name"]) == (200, [], name)
    row = body["preview"][-1]
    assert row["wrench"] == pytest.approx([0, 0, 1000, 0, 0, 0])
    assert row["displacement"][2] == pytest.approx(0.25e-3)


PROFILE = """# Hall 3
tare = 1
missing_loads = "zero"
load_cell = "fixed"
ignore = ["Temp", "Humidity"]
[columns]
Load = "-fz [kN]"
Force = "fz [N]"
"""
FILE = "Load,Temp,uz [mm]\n0,20,1\n1,21,2\n2,22,3\n"


def test_a_stored_profile_is_used_by_name_and_options_of_the_import_win(rig):
    call = {"url": "/v1/rigs/hall-3", "content": PROFILE}
    assert rig.put(**call).json() == {"stored": "hall-3"}
    assert rig.get("/v1/rigs").json()["rigs"][1] == {
        "name": "hall-3",
        "origin": "stored",
        "title": "Hall 3",
    }
    query = {"rig": "hall-3", "load_cell": "moving", "preview": 9}
    body = rig.post(CALL, content=FILE, params=query).json()
    assert (body["rows"]["tare"], body["ignored"]) == (1, ["Temp"])
    assert [row["wrench"][2] for row in body["preview"]] == [-1000, -2000]
    assert (body["rig"]["name"], body["rig"]["load_cell"]) == ("hall-3", "moving")
    query |= {"tare": 0, "mapping": '{"Load": "fz [N]"}', "dry_run": "true"}
    body = rig.post(CALL, content=FILE, params=query).json()
    assert [row["wrench"][2] for row in body["preview"]] == [0, 1, 2]
    (kept,) = rig.get("/v1/components/rig/imports").json()["imports"]
    assert PROFILE in kept["rig"]
    assert rig.delete("/v1/rigs/hall-3").status_code == 200
    assert rig.get("/v1/rigs/hall-3").status_code == 404


def test_a_sheet_and_a_lag_of_the_profile_do_not_refuse_a_single_csv(rig):
    profile = 'sheet = "Data"\nlag = 0.1\nmissing_loads = "zero"\nload_cell = "moving"\n'
    query = {"rig": profile, "dry_run": "true"}
    reply = rig.post(CALL, content="fx [N],ux [mm]\n1,0\n2,1\n", params=query)
    assert (reply.status_code, reply.json()["inserted"]) == (200, 2), reply.text


def test_a_load_of_the_profile_that_the_file_lacks_is_not_zero(rig):
    content = "fx [N],uz [mm]\n1,2\n"
    body = rig.post(CALL, content=content, params={"rig": PROFILE, "dry_run": "true"}).json()
    (error,) = body["errors"]
    assert error["message"].startswith("there is no column for fz, called Force or Load by the rig")


def test_no_more_rigs_are_stored_than_the_most_and_each_can_be_replaced(rig, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.library.rigs.MAX_RIGS", 1)
    assert rig.put("/v1/rigs/first", content="tare = 3").status_code == 200
    refused = rig.put("/v1/rigs/second", content="tare = 3")
    assert (refused.status_code, "remove one" in refused.json()["detail"]) == (422, True)
    assert rig.put("/v1/rigs/first", content="tare = 4").status_code == 200


def test_a_stored_profile_is_in_a_backup(tmp_path):
    ledger = Ledger(tmp_path / "data" / "ledger.sqlite")
    store_rig(ledger, "hall-3", PROFILE)
    ledger.close()
    back_up(tmp_path / "data", tmp_path / "all.backup")
    restore(tmp_path / "all.backup", tmp_path / "again")
    ledger = Ledger(tmp_path / "again" / "ledger.sqlite")
    assert rig_of(ledger, "hall-3") == f'name = "hall-3"\n{PROFILE}'
    ledger.close()
