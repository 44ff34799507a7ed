import asyncio
import csv
import io
import threading

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.following import wait_for_version
from tests.service.ledger_rows import NewRow, insert, stored
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.routes import table
from wrenchbook.service.sandbox import SandboxBusyError
from wrenchbook.service.tables import build as builds
from wrenchbook.service.workspace import Settings

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
    # The rig has no moments: its files have no columns for them.
    query = {"missing_loads": "zero", "wait_s": 600, **query}
    return http.post(CALL, content=text, headers={"content-type": "text/csv"}, params=query)


def test_measured_rows_in_lbf_and_mm_are_si_answer_at_once_and_export_to_the_same_numbers(rig):
    """The table had no rows for 0.1 to 1 s after the reply to an import."""
    rows = measured()
    loaded = load(rig, as_csv(rows)).json()
    assert (loaded["inserted"], loaded["in_use"]) == (500, True)
    assert rig.app.state.workspace.tables.surrogate("rig").version == loaded["table_version"]
    units = {"format": "csv", "force": "lbf", "translation": "mm", "rotation": "deg"}
    exported = list(csv.DictReader(io.StringIO(rig.get(CALL, params=units).text)))
    names = [name for name in exported[0] if name.split()[0][:2] in ("fx", "fy", "fz")]
    back = np.array([[float(row[name]) for name in names] for row in exported])
    assert np.allclose(back, rows[:, :3], rtol=1e-12)
    moved = np.array([[float(row[f"{u} [mm]"]) for u in ("ux", "uy", "uz")] for row in exported])
    assert np.allclose(moved, rows[:, 3:6], rtol=1e-12)
    row = rig.get(CALL, params={"format": "json"}).json()["rows"][0]
    assert row["wrench"][0] == pytest.approx(rows[0, 0] * LBF, rel=1e-12)
    assert row["displacement"][0] == pytest.approx(rows[0, 3] * MM, rel=1e-12)
    assert row["source"] == "measured"
    body = {"force": (rows[3, :3] * LBF).tolist(), "moment": [0, 0, 0], "on_thin": "estimate"}
    reply = rig.post("/v1/components/rig/displacement", json=body).json()
    assert reply["translation"] is not None
    assert reply["table_version"] > 0


def test_a_dry_run_counts_and_lists_mistakes_and_loads_nothing(rig):
    load(rig, as_csv(measured(3)))
    lines = as_csv(measured(5)).splitlines()
    text = "\n".join([*lines, lines[-1], lines[1], ""])  # two rows stand twice
    body = load(rig, text, dry_run=True).json()
    assert (body["rows"]["read"], body["inserted"], body["existing"]) == (7, 2, 5)
    reply = load(rig, as_csv(measured(9), [(3, "1,2,3,x,0,0,0,0,0")]), dry_run=True)
    assert reply.status_code == 200
    assert [error["row"] for error in reply.json()["errors"]] == [3]
    assert rig.get("/v1/components/rig?wait_s=60").json()["rows"] == 3


PLATE = "/v1/components/plate_thin/table"
KINDS = {
    "csv": "text/csv",
    "json": "application/json",
    "hdf5": "application/x-hdf5",
    "xlsx": "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    "parquet": "application/octet-stream",
}


def solved(http, wrenches):
    """Put rows of solves, with tangents, where a solver would have put them."""
    workspace = http.app.state.workspace
    fingerprint = workspace.library["plate_thin"].fingerprint
    compliance = np.linspace(-1e-6, 1e-6, 36).reshape(6, 6) / 3 + 1e-6 * np.eye(6)
    rows = [
        NewRow(w.tolist(), (compliance @ w).tolist(), "fea", compliance.tolist()) for w in wrenches
    ]
    assert insert(workspace.ledger, "plate_thin", fingerprint, rows) == (len(rows), 0)
    assert workspace.tables.catch_up("plate_thin", 600)


def answers(http):
    """Return what 40 random wrenches are answered, with bars and coverage."""
    wrenches = np.random.default_rng(6).uniform(-40, 40, (40, 6)).tolist()
    body = {"wrenches": wrenches, "on_thin": "estimate"}
    reply = http.post("/v1/components/plate_thin/displacements", json=body).json()
    return [reply[name] for name in ("displacements", "errors", "coverage")]


def send(http, path, content, kind, **query):
    return http.post(path, content=content, headers={"content-type": KINDS[kind]}, params=query)


UNITS = {"force": "lbf", "moment": "in-lbf", "translation": "mm", "rotation": "deg"}


def units_of(kind):
    return UNITS if kind in ("csv", "xlsx") else {}


def test_an_export_in_lbf_and_mm_into_the_same_table_doubles_no_row(rig):
    rows = np.random.default_rng(3).uniform(-200, 200, (500, 9)) * [*[1] * 3, *[1e-2] * 6]
    load(rig, as_csv(rows))
    for kind in KINDS:
        text = rig.get(CALL, params={"format": kind, **units_of(kind)}).content
        body = send(rig, CALL, text, kind).json()
        assert (body["inserted"], body["existing"]) == (0, 500), body["errors"]


@pytest.mark.parametrize("kind", KINDS)
def test_57_solves_exported_and_imported_elsewhere_are_solves_with_their_tangents(
    http, tmp_path, kind
):
    solved(http, np.random.default_rng(5).uniform(-50, 50, (57, 6)))
    exported = http.get(PLATE, params={"format": kind}).content
    again = send(http, PLATE, exported, kind).json()
    assert (again["inserted"], again["existing"]) == (0, 57)
    with TestClient(create_app(Settings(tmp_path / "elsewhere", solvers=0))) as other:
        body = send(other, PLATE, exported, kind).json()
        assert body["inserted"] == 57
        wait_for_version(other, "plate_thin", body["table_version"])
        first = stored(http.app.state.workspace.ledger, "plate_thin")
        second = stored(other.app.state.workspace.ledger, "plate_thin")
        assert answers(other) == answers(http)
    for name in ("wrench", "displacement", "compliance", "uncertainty", "source", "fingerprint"):
        assert [getattr(row, name) for row in first] == [getattr(row, name) for row in second]
    assert {row.source for row in second} == {"fea"}


@pytest.mark.parametrize("kind", KINDS)
def test_solves_of_one_mesh_do_not_pass_for_solves_of_another(http, kind):
    solved(http, np.eye(6))
    exported = http.get(PLATE, params={"format": kind}).content
    reply = send(http, "/v1/components/bar/table", exported, kind)
    assert reply.status_code == 422
    assert [error["field"] for error in reply.json()["errors"]] == ["fingerprint"] * 6
    assert http.get("/v1/components/bar?wait_s=60").json()["rows"] == 0


def test_a_solve_that_does_not_know_all_outputs_is_refused_by_row(http):
    fingerprint = http.app.state.workspace.library["plate_thin"].fingerprint
    row = {"wrench": [1] * 6, "displacement": [0, 0, None, 0, 0, 0], "source": "fea"}
    reply = http.post(PLATE, json={"rows": [{**row, "fingerprint": fingerprint}]})
    assert reply.status_code == 422
    assert [(e["row"], e["field"]) for e in reply.json()["errors"]] == [(1, "source")]


def test_an_uncertainty_partly_null_does_not_come_back_as_zero(rig):
    row = {"wrench": [1] * 6, "displacement": [0] * 6, "uncertainty": [1e-6, None, 0, *[None] * 3]}
    assert rig.post(CALL, json={"rows": [row]}).json()["inserted"] == 1
    back = rig.get(CALL, params={"format": "json"}).json()["rows"][0]
    assert back["uncertainty"] == row["uncertainty"]
    assert rig.post(CALL, json={"rows": [row]}).json()["existing"] == 1


def test_a_json_export_numbers_its_rows_as_the_ledger_does_and_comes_back(rig):
    text = "fx [N],ux [mm]\n1,0.1\n2,0.2\n3,0.3\n"
    assert load(rig, text).status_code == 200
    assert rig.delete(f"{CALL}/2").is_success
    held = rig.get(CALL).json()
    assert [row["row"] for row in held["rows"]] == [1, 3]
    assert rig.delete(f"{CALL}/{held['rows'][1]['row']}").is_success
    assert rig.post(CALL, json=held).json()["existing"] == 2


def test_an_export_names_its_version_and_a_holder_of_it_gets_304(rig):
    load(rig, as_csv(measured(5)))
    version = rig.get("/v1/components/rig?wait_s=60").json()["table_version"]
    for kind in KINDS:
        reply = rig.get(CALL, params={"format": kind})
        tag = reply.headers["etag"]
        assert tag.startswith(f'"{version}-')
        for held in (tag, f'"1", W/{tag}', "*"):
            again = rig.get(CALL, params={"format": kind}, headers={"if-none-match": held})
            assert (again.status_code, again.content) == (304, b"")
            assert again.headers["etag"] == tag
    exported = rig.get(CALL, params={"format": "hdf5"})
    assert f"rig-v{version}.h5" in exported.headers["content-disposition"]
    body = rig.get(CALL, params={"format": "json"}).json()
    assert (body["component"], body["table_version"]) == ("rig", version)
    load(rig, as_csv(measured(1, seed=8)))
    newer = rig.get(CALL, headers={"if-none-match": tag})
    assert newer.status_code == 200
    assert len(newer.json()["rows"]) == 6


def test_the_packed_table_that_answers_is_exported_of_the_newest_version_alone(rig):
    load(rig, as_csv(measured(5)))
    first = rig.get("/v1/components/rig?wait_s=60").json()["table_version"]
    before = rig.get(CALL, params={"format": "packed"})
    assert before.headers["content-type"] == "application/octet-stream"
    assert f'filename="rig-{first}.wbt"' in before.headers["content-disposition"]
    assert before.content == rig.app.state.workspace.surrogate("rig").packed.content
    held = {"if-none-match": before.headers["etag"]}
    again = rig.get(CALL, params={"format": "packed"}, headers=held)
    assert (again.status_code, again.content) == (304, b"")
    load(rig, as_csv(measured(9)))
    newest = rig.get(CALL, params={"format": "packed"}, headers=held)
    assert newest.status_code == 200
    assert newest.content != before.content
    earlier = {"format": "packed", "table_version": first}
    refused = rig.get(CALL, params=earlier)
    assert (refused.status_code, refused.json()["errors"][0]["loc"]) == (422, "table_version")


def test_an_hdf5_export_has_another_tag_after_a_new_estimate_of_the_solver_error(http):
    workspace, call = http.app.state.workspace, "/v1/components/plate_thin/table?format=hdf5"
    fingerprint = workspace.library["plate_thin"].fingerprint
    estimate = {"mesh": np.eye(6).tolist(), "loads": [1.0] * 6}
    workspace.errors.record("plate_thin", fingerprint, estimate)
    held = {"if-none-match": http.get(call).headers["etag"]}
    assert http.get(call, headers=held).status_code == 304
    workspace.errors.record("plate_thin", fingerprint, estimate | {"loads": [2.0] * 6})
    newer = http.get(call, headers=held)
    assert newer.status_code == 200
    assert newer.headers["etag"] != held["if-none-match"]


KEPT = {"inserted", "existing", "errors", "dry_run", "in_use", "table_version"}


def test_an_import_says_which_version_holds_its_rows_and_whether_it_answers_already(rig):
    text = as_csv(measured(5))
    tried = load(rig, text, dry_run=True).json()
    assert (tried["dry_run"], tried["in_use"], tried["table_version"]) == (True, False, 0)
    first = load(rig, text).json()
    wait_for_version(rig, "rig", first["table_version"])
    again = load(rig, text).json()
    rows = {"read": 5, "loaded": 5, "refused": 0, "tare": 0, "unmatched": 0}
    assert (again["rows"], again["import"], again["format"]) == (rows, None, "csv")
    assert {word: again[word] for word in tried.keys() & KEPT} == {
        "inserted": 0,
        "existing": 5,
        "errors": [],
        "dry_run": False,
        "in_use": True,
        "table_version": first["table_version"],
    }


@pytest.fixture
def slow_build(monkeypatch):
    """Hold builds of tables up until the event is set."""
    may_build, build = threading.Event(), builds.build_table

    def slow(*given):
        assert may_build.wait(600)
        return build(*given)

    monkeypatch.setattr(builds, "build_table", slow)
    yield may_build
    may_build.set()


def test_a_file_that_is_no_table_is_not_said_to_have_good_rows(rig):
    detail = load(rig, b"\0\0").json()["detail"]
    assert "the first in file: " in detail
    assert "--partial" not in detail


@pytest.mark.parametrize("text", ["fz [lbs],uz [mm]\n1,2\n", "fz [N],uz [mm]\n1,x\n"])
def test_a_table_without_a_good_row_offers_no_partial_import(rig, text):
    """The remedy ended in an error of the server where the table had rows to compare with."""
    load(rig, "fx [N],fy [N],fz [N],uz [mm]\n1,2,3,4\n")
    assert "--partial" not in load(rig, text, missing_loads="zero").json()["detail"]
    reply = load(rig, "fz [N],uz [mm]\n1,x\n", missing_loads="zero", partial="true")
    assert (reply.status_code, reply.json()["inserted"]) == (200, 0)


@pytest.mark.parametrize("wait_s", [0, 0.05])
def test_an_import_is_answered_before_its_table_is_built_once_it_may_wait_no_longer(
    rig, slow_build, wait_s
):
    reply = load(rig, as_csv(measured(5)), wait_s=wait_s).json()
    assert (reply["inserted"], reply["in_use"]) == (5, False)
    assert rig.app.state.workspace.tables.surrogate("rig").version < reply["table_version"]
    slow_build.set()
    wait_for_version(rig, "rig", reply["table_version"])


@pytest.mark.parametrize("call", ["displacement", "displacements"])
def test_rows_that_are_being_built_are_never_no_rows(rig, slow_build, call):
    """Queries right after an import said that the table had no rows, and to load some."""
    load(rig, as_csv(measured(40)), wait_s=0)
    force, moment = [0, 0, -5], [1, 2, 0]
    asked = (
        {"force": force, "moment": moment}
        if call == "displacement"
        else {"wrenches": [force + moment]}
    )
    for on_thin in ("queue", "wait", "estimate", "reject"):
        reply = rig.post(f"/v1/components/rig/{call}", json={**asked, "on_thin": on_thin})
        assert reply.status_code == 503
        assert "40 new rows are being built" in reply.json()["detail"]
        assert int(reply.headers["Retry-After"]) > 0
    slow_build.set()
    wait_for_version(rig, "rig", rig.app.state.workspace.ledger.last_seq("rig"))
    after = rig.post(f"/v1/components/rig/{call}", json={**asked, "on_thin": "estimate"})
    assert after.status_code == 200


def test_um_bridge_waits_for_rows_that_are_being_built(rig, slow_build, monkeypatch):
    """A sampler ended with a status of 500 right after an import, for all its wait_s of 600 s."""
    load(rig, as_csv(measured(40)), wait_s=0)
    tables = rig.app.state.workspace.tables
    progress = tables.progress

    def begin_to_wait(*given):
        slow_build.set()
        return progress(*given)

    monkeypatch.setattr(tables, "progress", begin_to_wait)
    asked = {"name": "rig", "input": [[0, 0, -5, 1, 2, 0]], "config": {"on_thin": "estimate"}}
    reply = rig.post("/umbridge/Evaluate", json=asked)
    assert (reply.status_code, len(reply.json()["output"][0])) == (200, 6)


@pytest.mark.parametrize("before", [0, 40])
def test_a_component_and_its_readiness_have_the_rows_that_are_being_built(rig, slow_build, before):
    """The component was read after the build alone, or 25 s: here no build ends meanwhile."""
    if before:
        slow_build.set()
        load(rig, as_csv(measured(before)))
        slow_build.clear()
    load(rig, as_csv(measured(30, seed=8)), wait_s=0)
    listed = {
        component["name"]: component for component in rig.get("/v1/components").json()["components"]
    }
    for card in (listed["rig"], rig.get("/v1/components/rig").json()):
        assert (card["rows"], card["pending_rows"]) == (before, 30)
    ready = rig.get("/health/ready", params={"component": "rig"})
    assert ready.status_code == (200 if before else 503)
    assert ready.json()["tables"] == {"rig": "ready" if before else "building"}
    assert ready.json()["pending_rows"] == {"rig": 30}
    slow_build.set()


def test_a_component_is_read_with_its_rows_once_the_caller_waits_for_them(rig, slow_build):
    load(rig, as_csv(measured(30)), wait_s=0)
    call = "/v1/components/rig"
    assert rig.get(call, params={"wait_s": 0.05}).json()["pending_rows"] == 30
    slow_build.set()
    card = rig.get(call, params={"wait_s": 60}).json()
    assert (card["rows"], card["pending_rows"]) == (30, 0)


@pytest.mark.parametrize("call", ["displacement", "displacements"])
def test_an_older_table_answers_by_its_own_version_while_rows_are_added(rig, slow_build, call):
    """While a table grew, a refusal said to load more rows."""
    slow_build.set()
    version = load(rig, as_csv(measured(40))).json()["table_version"]
    slow_build.clear()
    load(rig, as_csv(measured(30, seed=8)), wait_s=0)
    wrench = {"force": [0, 0, -5], "moment": [1, 2, 0]}
    body = wrench if call == "displacement" else {"wrenches": [[0, 0, -5, 1, 2, 0]]}
    limit = {"tolerance": {"translation": 1e-12, "rotation": 1e-12}}
    path = f"/v1/components/rig/{call}"
    estimate = rig.post(path, json={**body, **limit, "on_thin": "estimate"})
    assert (estimate.status_code, estimate.json()["table_version"]) == (200, version)
    if call == "displacement":
        assert "30 new rows are being built" in estimate.json()["reason"]
    for on_thin in ("queue", "wait", "reject"):  # as without new rows: a stream of them never ends
        reply = rig.post(path, json={**body, **limit, "on_thin": on_thin})
        assert reply.status_code == 409
        assert "30 new rows are being built" in reply.json()["detail"]
        assert "oad more rows" not in reply.json()["detail"]
    slow_build.set()


@pytest.mark.parametrize("call", ["displacement", "displacements"])
def test_a_rejection_has_its_reason_and_the_tolerance_that_was_applied(rig, call):
    """A 409 said neither why the table does not cover a wrench nor by which tolerance."""
    load(rig, as_csv(measured(40)))
    wrench = {"force": [0, 0, -5], "moment": [1, 2, 0]}
    body = wrench if call == "displacement" else {"wrenches": [[0, 0, -5, 1, 2, 0]]}
    limit = {"translation": 1e-12, "rotation": 2e-12}
    reply = rig.post(
        f"/v1/components/rig/{call}", json={**body, "on_thin": "reject", "tolerance": limit}
    )
    problem = reply.json()
    assert reply.status_code == 409
    assert problem["tolerance"] == limit
    assert problem["reason"]
    assert problem["reason"] in problem["detail"]
    assert "Tolerance: 1e-12 m, 2e-12 rad." in problem["detail"]


def test_two_slow_tables_of_one_key_do_not_block_the_imports_of_others(monkeypatch):
    monkeypatch.setattr(table, "_READER_WAIT_S", 0.0)

    async def read(caller):
        async with table.reader_slot(caller):
            pass

    async def read_slowly():
        async with table.reader_slot("ann"):
            await read("bob")
            with pytest.raises(
                SandboxBusyError, match="Another table of this key or address is being read"
            ):
                await read("ann")
        await read("ann")

    asyncio.run(read_slowly())


def test_a_table_that_is_too_large_is_413_without_a_declared_length(rig, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.http.routes.table.MAX_TABLE_BYTES", 1 << 20)
    pieces = (b"#" * 65536 for _ in range(17))
    reply = rig.post(CALL, content=pieces, headers={"content-type": "text/csv"})
    assert reply.status_code == 413
    assert "more than 1 MiB, the limit of this call" in reply.json()["detail"]
    assert reply.headers["content-type"] == "application/problem+json"
