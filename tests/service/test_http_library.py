"""The library: search, copies, names, notes, where rows come from, what was asked in vain."""

import json

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.following import wait_for_version
from tests.service.ledger_rows import NewRow, claim, insert
from wrenchbook.service.demand import MAX_CELLS, DemandMaps
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.table.rows import LoadRange
from wrenchbook.surrogate.table.space import DEFAULT, Input, Space

RIG = {
    "name": "rig",
    "title": "Bracket on rig 3",
    "range": {"force": [900] * 3, "moment": [90] * 3},
}
HEADER = "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],ux [m],uy [m],uz [m]"


@pytest.fixture
def http(tmp_path):
    with TestClient(create_app(Settings(tmp_path / "workspace", solvers=0))) as client:
        assert client.post("/v1/components", json=RIG).status_code == 201
        yield client


def load(http, rows, name="rig", **query):
    lines = [HEADER, *(",".join(map(repr, row)) for row in np.asarray(rows).tolist())]
    path = f"/v1/components/{name}/table"
    head = {"content-type": "text/csv"}
    reply = http.post(path, content="\n".join(lines), params=query, headers=head)
    assert reply.status_code == 200, reply.text
    wait_for_version(http, name, reply.json()["table_version"])
    return reply.json()


def rows(count, seed=1):
    loads = np.random.default_rng(seed).uniform(-1, 1, (count, 6)) * ([900] * 3 + [90] * 3)
    return np.hstack([loads, 1e-6 * loads[:, :3]])


def names(http, **query):
    listed = http.get("/v1/components", params=query).json()["components"]
    return [item["name"] for item in listed]


def test_a_search_looks_into_names_titles_and_notes(http):
    http.put("/v1/components/rig/notes", json={"text": "bolts at 12 Nm, see drawing K-77"})
    for asked in ("rig", "BRACKET", "k-77", "bolts rig"):
        assert "rig" in names(http, q=asked)
    assert names(http, q="no such thing") == []
    assert http.get("/v1/components/rig").json()["notes"].startswith("bolts")


def test_what_is_archived_is_out_of_the_list_and_answers_all_the_same(http):
    assert http.post("/v1/components/rig/archive").json()["archived"] is True
    assert "rig" not in names(http)
    assert "rig" in names(http, archived=True)
    assert http.get("/v1/components/rig").json()["archived"] is True
    http.post("/v1/components/rig/unarchive")
    assert "rig" in names(http)


def test_a_copy_has_the_setup_and_the_rows_and_goes_its_own_way(http):
    load(http, rows(20))
    reply = http.post("/v1/components/rig/copy", json={"name": "rig2", "title": 'The "second"'})
    assert reply.status_code == 201, reply.text
    created = reply.json()
    assert (created["rows"], created["title"], created["copied_from"]) == (
        20,
        'The "second"',
        "rig",
    )
    load(http, rows(5, 9), "rig2")
    assert http.get("/v1/components/rig?wait_s=60").json()["rows"] == 20
    bare = http.post("/v1/components/rig/copy", json={"name": "rig3", "rows": False})
    assert bare.json()["rows"] == 0


def test_a_copied_setup_keeps_its_fingerprint_so_that_its_solves_stay_solves(http):
    workspace = http.app.state.workspace
    fingerprint = workspace.library["plate_thin"].fingerprint
    solve = NewRow((1.0, 2, 3, 0, 0, 0), (1e-6,) * 6, "fea")
    insert(workspace.ledger, "plate_thin", fingerprint, [solve])
    created = http.post("/v1/components/plate_thin/copy", json={"name": "mine"}).json()
    assert (created["fingerprint"], created["solved"]) == (fingerprint, 1)


def test_a_renamed_component_has_its_rows_and_the_old_name_says_so(http):
    load(http, rows(20))
    assert http.post("/v1/components/rig/rename", json={"name": "bracket"}).status_code == 201
    assert "bracket" in names(http)
    assert "rig" not in names(http)
    assert http.get("/v1/components/rig").json()["renamed_to"] == "bracket"
    assert http.get("/v1/components/bracket?wait_s=60").json()["rows"] == 20
    again = http.post("/v1/components/rig/rename", json={"name": "other"})
    assert again.status_code == 409
    assert "'bracket' now" in again.json()["detail"]
    assert "other" not in names(http, archived=True)
    refused = http.post("/v1/components/plate/rename", json={"name": "z"})
    assert refused.status_code == 409
    assert "Copy it" in refused.json()["detail"]


def test_notes_outlive_the_server(http, tmp_path):
    http.put("/v1/components/rig/notes", json={"text": "äöü"})
    folder = tmp_path / "workspace"
    with TestClient(create_app(Settings(folder, solvers=0))) as again:
        assert again.get("/v1/components/rig").json()["notes"] == "äöü"


def test_a_row_tells_where_it_comes_from(http):
    load(http, rows(3), note="run 7", filename="run7.csv")
    reported = http.get("/v1/components/rig/table/2").json()
    assert reported["source"] == "measured"
    assert reported["withdrawn"] is False
    brought = reported["provenance"]["import"]
    assert (brought["filename"], brought["note"], brought["format"]) == ("run7.csv", "run 7", "csv")
    assert len(brought["sha256"]) == 64
    (listed,) = http.get("/v1/components/rig/imports").json()["imports"]
    assert (listed["rows"], listed["filename"]) == (3, "run7.csv")
    assert http.get("/v1/components/plate/table/2").status_code == 404


def test_a_solve_tells_its_job_its_mesh_and_its_material(http):
    workspace = http.app.state.workspace
    fingerprint = workspace.library["plate_thin"].fingerprint
    job, _ = workspace.ledger.accept("plate_thin", fingerprint, (1.0, 0, 0, 0, 0, 0))
    claim(workspace.ledger, "me")
    row = workspace.ledger.commit(job.id, 1, (1e-6,) * 6)
    reported = http.get(f"/v1/components/plate_thin/table/{row.seq}").json()["provenance"]
    assert (reported["job"]["id"], reported["job"]["engine"], reported["import"]) == (
        job.id,
        "local",
        None,
    )
    setup = reported["setup"]
    assert (setup["present"], setup["solver"], setup["mesh"]["generator"]) == (
        *(True, "embedded", "plate"),
    )
    assert setup["materials"][0]["youngs_modulus"] > 1e9


def test_a_table_of_an_old_version_is_what_it_was(http):
    version = load(http, rows(10))["table_version"]
    path = "/v1/components/rig/table"
    before = http.get(path, params={"format": "csv"}).text
    http.delete(f"{path}/3")
    load(http, rows(10, 2))
    again = http.get(path, params={"format": "csv", "table_version": version})
    assert again.text == before
    assert again.headers["etag"].startswith(f'"{version}-')
    assert len(http.get(path, params={"format": "csv"}).text.splitlines()) == 20
    unknown = http.get(path, params={"table_version": 10**6})
    assert unknown.status_code == 404
    assert "use 0 to" in unknown.json()["detail"]


def test_measured_rows_outside_of_the_solves_bars_are_named_with_their_offset(http):
    workspace = http.app.state.workspace
    component = workspace.library["bar"]
    rng = np.random.default_rng(4)
    wrenches = rng.uniform(-0.8, 0.8, (60, 6)) * component.load_range.scale
    compliance = np.diag([1e-7, 1e-7, 1e-8, 1e-6, 1e-6, 1e-6])
    solves = [
        NewRow(w.tolist(), (compliance @ w).tolist(), "fea", compliance.tolist()) for w in wrenches
    ]
    insert(workspace.ledger, "bar", component.fingerprint, solves)
    measured = []
    for at, wrench in enumerate(rng.uniform(-0.5, 0.5, (10, 6)) * component.load_range.scale):
        moved = compliance @ wrench
        moved[2] += 1e-4 if at < 3 else 0.0
        measured.append(NewRow(wrench.tolist(), moved.tolist(), uncertainty=(1e-7,) * 6))
    insert(workspace.ledger, "bar", "", measured)
    reported = http.get("/v1/components/bar/disagreement").json()
    assert (reported["measured"], reported["solved"], reported["compared"]) == (10, 60, 10)
    assert reported["outside"] == 3
    assert {row["row"] for row in reported["rows"] if row["output"] == "uz"} == {61, 62, 63}
    assert reported["outputs"]["uz"]["mean_difference"] == pytest.approx(3e-5, rel=0.1)
    empty = http.get("/v1/components/rig/disagreement").json()
    assert empty["compared"] == 0
    assert empty["reason"].startswith("'rig' has no finite-element setup, so it has no solves")


def asked(http, force, **more):
    body = {"force": force, "on_thin": "estimate", **more}
    return http.post("/v1/components/rig/displacement", json=body).json()


def test_the_demand_map_has_what_was_asked_in_vain_and_nothing_else(http):
    for _ in range(3):
        asked(http, [440, 0, 0])
    asked(http, [0, 0, 5000])
    http.post(
        "/v1/components/rig/displacements",
        json={"wrenches": [[441, 0, 0, 0, 0, 0], [0, -800, 0, 0, 0, 0]], "on_thin": "estimate"},
    )
    reported = http.get("/v1/components/rig/demand").json()
    assert reported["asked"] == 6
    assert (reported["cells"][0]["count"], reported["cells"][0]["coverage"]) == (4, "outside")
    assert reported["cells"][0]["wrench"][0] == pytest.approx(440, abs=90)
    assert reported["latest"][-1]["wrench"] == [440, 0, 0, 0, 0, 0]
    assert http.delete("/v1/components/rig/demand").json()["asked"] == 0
    assert http.get("/v1/components/rig/demand").json()["cells"] == []


def test_the_demand_map_outlives_the_server(http, tmp_path):
    asked(http, [440, 0, 0])
    http.app.state.workspace.demand_maps.save()
    with TestClient(create_app(Settings(tmp_path / "workspace", solvers=0))) as again:
        assert again.get("/v1/components/rig/demand").json()["asked"] == 1


def test_the_demand_map_does_not_grow_without_bound(ledger):
    demand, span = DemandMaps(ledger), LoadRange(-np.ones(6), np.ones(6))
    wrenches = np.random.default_rng(1).uniform(-3, 3, (20_000, 6))
    demand.note_batch("rig", span, wrenches, np.ones(20_000, dtype=int))
    reported = demand.map_of("rig", span)
    assert len(reported.cells) == MAX_CELLS
    assert reported.asked == 20_000
    demand.note("rig", span, (1e300,) * 6, "outside")
    assert demand.map_of("rig", span).asked == 20_001


def test_the_demand_map_of_two_processes_is_their_sum(ledger, tmp_path):
    """Each had counts of its own, and who stopped last wrote over those of the others."""
    span, other = LoadRange(-np.ones(6), np.ones(6)), Ledger(tmp_path / "ledger.sqlite")
    first, second = DemandMaps(ledger), DemandMaps(other)
    for demand in (first, second, second):
        demand.note("rig", span, (2.0, 0, 0, 0, 0, 0), "outside")
        demand.save()
    assert [item.map_of("rig", span).asked for item in (first, second)] == [3, 3]
    assert len(first.map_of("rig", span).latest) == 3
    first.stop()
    assert DemandMaps(other).map_of("rig", span).cells[0].outside == 3
    second.forget("rig")
    assert first.map_of("rig", span).asked == 0
    other.close()


def test_a_demand_map_that_cannot_be_written_goes_on_counting(ledger):
    demand, span = DemandMaps(ledger), LoadRange(-np.ones(6), np.ones(6))
    demand.note("rig", span, (2.0, 0, 0, 0, 0, 0), "outside")
    demand.save()
    ledger._writer.execute("PRAGMA query_only = ON")  # as on a disk that was remounted read-only
    for _ in range(2):
        demand.note("rig", span, (2.0, 0, 0, 0, 0, 0), "outside")
        demand.save()
    assert demand.map_of("rig", span).asked == 3
    ledger._writer.execute("PRAGMA query_only = OFF")
    demand.save()
    assert DemandMaps(ledger).map_of("rig", span).asked == 3


def test_the_demand_map_keeps_its_loads_when_the_range_is_widened(ledger):
    demand, span = DemandMaps(ledger), LoadRange(-np.ones(6), np.ones(6))
    demand.note("rig", span, (1.6, 0, 0, 0, 0, 0), "outside")
    demand.note("rig", span, (50.0, 0, 0, 0, 0, 0), "outside")
    demand.save()
    demand.note("rig", span, (1.6, 0, 0, 0, 0, 0), "outside")
    wide = LoadRange(-2 * np.ones(6), 2 * np.ones(6))
    for _ in range(2):
        reported = demand.map_of("rig", wide)
        assert [cell.wrench[0] for cell in reported.cells] == pytest.approx([1.6])
        assert (reported.asked, reported.elsewhere) == (3, 1)
        demand.note("other", wide, (1.6, 0, 0, 0, 0, 0), "outside")
    demand.note("rig", wide, (1.6, 0, 0, 0, 0, 0), "outside")
    assert demand.map_of("rig", wide).cells[0].count == 3


def test_the_demand_map_begins_anew_when_the_component_has_another_number_of_inputs(ledger):
    demand, span = DemandMaps(ledger), LoadRange(-np.ones(6), np.ones(6))
    demand.note("rig", span, (2.0, 0, 0, 0, 0, 0), "outside")
    demand.save()
    inputs = (*DEFAULT.inputs, Input("temperature", "K", "scalar"))
    warm = LoadRange(-np.ones(7), np.ones(7), Space(inputs, DEFAULT.outputs))
    assert demand.map_of("rig", warm).asked == 0
    demand.note("rig", warm, (2.0, 0, 0, 0, 0, 0, 0), "outside")
    assert len(demand.map_of("rig", warm).cells[0].wrench) == 7


def test_a_wrench_beyond_all_numbers_counts_in_the_outermost_cell(ledger):
    demand, span = DemandMaps(ledger), LoadRange(-1e-3 * np.ones(6), 1e-3 * np.ones(6))
    demand.note("rig", span, (1e308, 0, 0, 0, 0, 0), "outside")
    assert demand.map_of("rig", span).cells[0].count == 1


@pytest.mark.parametrize("damage", [{"latest": [{"x": 1}]}, {"cells": [[1, 2]]}, {"scale": "x"}])
def test_a_damaged_demand_map_begins_anew_and_loses_no_new_query(ledger, damage):
    demand, span = DemandMaps(ledger), LoadRange(-np.ones(6), np.ones(6))
    demand.note("rig", span, (2.0, 0, 0, 0, 0, 0), "outside")
    demand.save()
    with ledger.writing(durable=False) as db:
        (saved,) = db.execute("SELECT counts FROM demand").fetchone()
        db.execute("UPDATE demand SET counts = ?", (json.dumps(json.loads(saved) | damage),))
    demand.note("rig", span, (2.0, 0, 0, 0, 0, 0), "outside")
    assert demand.map_of("rig", span).asked == 1


def test_a_component_that_is_named_as_a_call_is_answered_as_any_other(http):
    spans = {"force": [100] * 3, "moment": [10] * 3}
    http.post("/v1/components", json={"name": "displacement", "title": "A name", "range": spans})
    headers = http.get("/v1/components/displacement").headers
    assert "x-request-id" in headers
    assert headers["cache-control"] == "no-store"
