"""A component.toml edited under a running server is a new setup at once: jobs, rows and table."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from starlette.testclient import TestClient

from tests.until import until
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.routes.components import component_body
from wrenchbook.service.ops.doctor import examine
from wrenchbook.service.workspace import Settings

CALL = "/v1/components/mine"
WRENCH = {"force": [10.0, 0.0, -20.0], "moment": [0.0, 3.0, 0.0]}


@pytest.fixture
def toml(folder):
    path = folder / "components" / "mine" / "component.toml"
    path.parent.mkdir(parents=True)
    text = (SHIPPED / "plate_thin" / "component.toml").read_text()
    path.write_text(text.replace('name = "plate_thin"', 'name = "mine"'))
    return path


@pytest.fixture
def served(toml, folder, stand_in):
    with TestClient(create_app(Settings(folder, solvers=1))) as client:
        yield client


def edit(toml, **changes):
    text = toml.read_text()
    for before, after in changes.values():
        assert before in text
        text = text.replace(before, after)
    toml.write_text(text)


def solve(http):
    reply = http.post(f"{CALL}/solve", json={**WRENCH, "wait_s": 60}).json()
    assert reply["source"] == "fea", reply
    return reply["job"]["id"]


def rows(http):
    return [row["wrench"] for row in http.get(f"{CALL}/table").json()["rows"]]


def test_asking_again_after_an_edit_makes_a_job_of_the_new_setup(served, toml):
    """The remedy of `component_changed` did not hold: the server went by the old fingerprint."""
    before, job = served.get(CALL).json()["fingerprint"], solve(served)
    table = served.get(f"{CALL}/table").headers["etag"]
    assert solve(served) == job
    edit(toml, stiffer=("poisson_ratio = 0.3", "poisson_ratio = 0.2"))
    other = solve(served)
    assert other != job
    about = settled(served, lambda one: one["fingerprint"] != before and one["rows"] == 1)
    assert [row["fingerprint"] for row in served.get(f"{CALL}/table").json()["rows"]] == [
        about["fingerprint"]
    ]
    assert served.get(f"{CALL}/table", headers={"if-none-match": table}).status_code == 200
    edit(toml, back=("poisson_ratio = 0.2", "poisson_ratio = 0.3"))
    assert served.get(CALL).json()["fingerprint"] == before
    assert solve(served) == job


def test_an_edit_that_nobody_asks_for_changes_the_table_within_seconds(served, toml):
    solve(served)
    asked = {**WRENCH, "on_thin": "estimate"}

    def answered():
        return served.post(f"{CALL}/displacement", json=asked).json()["translation"] is not None

    until(answered)
    edit(toml, stiffer=("poisson_ratio = 0.3", "poisson_ratio = 0.2"))
    until(lambda: not answered())


def test_an_edit_with_a_mistake_is_told_and_mended_without_a_restart(served, toml):
    sound = toml.read_text()
    edit(toml, mistake=("poisson_ratio", "poisson_ration"))
    reported = served.post(f"{CALL}/solve", json=WRENCH)
    assert reported.status_code == 404
    assert "poisson_ration" in reported.json()["detail"]
    assert "mine" in served.get("/health/ready").json()["broken"]
    assert served.get("/v1/components").status_code == 200
    toml.write_text(sound)
    solve(served)
    assert served.get("/health/ready").json()["broken"] == {}


def settled(http, check):
    """Wait until the component says what is expected of it."""
    return until(lambda: check(about := http.get(CALL).json()) and about)


def solve_many(http, count):
    for step in range(count):
        body = {"force": [10.0 + step, 0.0, -20.0], "moment": [0.0, 3.0, 0.0], "wait_s": 60}
        assert http.post(f"{CALL}/solve", json=body).json()["source"] == "fea"


STIFFER = ("poisson_ratio = 0.3", "poisson_ratio = 0.2")


def test_solved_rows_do_not_leave_the_table_in_silence(served, toml, folder):
    """A changed fingerprint left rows: 0 and warnings: [], and nothing told of the solves."""
    solve_many(served, 3)
    assert served.get(CALL).json()["another_setup"] == {"rows": 0, "wrenches": 0}
    edit(toml, stiffer=STIFFER)
    about = settled(served, lambda one: one["another_setup"]["rows"])
    assert about["rows"] == 0
    assert about["another_setup"] == {"rows": 3, "wrenches": 3}
    (warning,) = [item for item in about["warnings"] if item["where"] == "rows"]
    assert "3 rows belong to another setup" in warning["message"]
    assert f"POST {CALL}/table/resolve" in warning["message"]
    (listed,) = [
        component
        for component in served.get("/v1/components").json()["components"]
        if component["name"] == "mine"
    ]
    assert listed["another_setup"] == about["another_setup"]
    for more in ({}, {"detail": True}):
        body = {**WRENCH, "on_thin": "estimate", **more}
        reply = served.post(f"{CALL}/displacement", json=body).json()
        assert "3 rows belong to another setup of 'mine'" in reply["reason"]
    refused = served.post(f"{CALL}/displacement", json={**WRENCH, "on_thin": "reject"})
    assert "wrenchbook resolve mine" in refused.json()["detail"]
    results = [item for item in examine(folder) if "another setup" in item.problem]
    assert [(result.kind, result.problem) for result in results] == [
        ("note", "3 rows of mine belong to another setup of it")
    ]
    assert "wrenchbook resolve mine" in results[0].remedy
    edit(toml, back=STIFFER[::-1])
    about = settled(served, lambda one: one["rows"] == 3)
    assert about["another_setup"] == {"rows": 0, "wrenches": 0}
    assert not [item for item in about["warnings"] if item["where"] == "rows"]
    assert not [item for item in examine(folder) if "another setup" in item.problem]


def test_a_component_is_told_from_one_table(served, toml, monkeypatch):
    """A table replaced between two reads gave rows of another setup without their warning."""
    solve_many(served, 3)
    workspace = served.app.state.workspace
    before = (tables := workspace.tables).surrogate("mine")
    edit(toml, stiffer=STIFFER)
    settled(served, lambda one: one["another_setup"]["rows"])
    after = tables.surrogate("mine")
    this, reads = threading.get_ident(), iter([before])
    monkeypatch.setattr(
        tables,
        "surrogate",
        lambda *_, **__: next(reads, after) if threading.get_ident() == this else after,
    )
    for rows in (0, 3):
        about = component_body(workspace, workspace.library["mine"])
        assert about["another_setup"]["rows"] == rows
        assert any(item["where"] == "rows" for item in about["warnings"]) == (rows == 3)


def test_one_call_solves_them_again_each_once(served, toml):
    solve_many(served, 3)
    edit(toml, stiffer=STIFFER)
    settled(served, lambda one: one["another_setup"]["rows"])
    solve_many(served, 1)  # one of the three
    first = served.post(f"{CALL}/table/resolve", json={"budget": 1})
    assert first.status_code == 202
    assert (first.json()["solved"], len(first.json()["jobs"])) == (1, 1)
    assert first.json()["left"] == 1
    with ThreadPoolExecutor(4) as pool:
        replies = pool.map(lambda _: served.post(f"{CALL}/table/resolve", json={}), range(8))
        assert {reply.status_code for reply in replies} <= {200, 202}
    about = settled(served, lambda one: one["rows"] == 3)
    assert about["another_setup"] == {"rows": 3, "wrenches": 0}
    assert not [warning for warning in about["warnings"] if warning["where"] == "rows"]
    assert sum(about["jobs"].values()) == 6  # three of either setup
    done = served.post(f"{CALL}/table/resolve", json={})
    assert (done.status_code, done.json()["jobs"], done.json()["solved"]) == (200, [], 3)


def test_resolving_keeps_to_the_load_range_and_needs_a_setup_and_rows(served, toml):
    reply = served.post(f"{CALL}/table/resolve", json={})
    assert (reply.status_code, reply.json()["jobs"]) == (200, [])
    assert "no row of 'mine' belongs to another setup" in reply.json()["reason"]
    solve_many(served, 1)
    edit(toml, narrower=("force = [1000, 1000, 2000]", "force = [1, 1, 1]"), stiffer=STIFFER)
    settled(served, lambda one: one["another_setup"]["rows"])
    reply = served.post(f"{CALL}/table/resolve", json={}).json()
    assert (reply["jobs"], reply["beyond_range"]) == ([], 1)
    assert "beyond_range" in reply["reason"]
    reply = served.post(f"{CALL}/table/resolve", json={"beyond_range": True})
    assert (reply.status_code, len(reply.json()["jobs"])) == (202, 1)
