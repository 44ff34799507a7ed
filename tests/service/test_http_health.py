"""`GET /health/ready`: which tables answer while others are built."""

import errno
import shutil
import threading

import pytest
from starlette.testclient import TestClient

from tests.until import until
from wrenchbook.service.http.app import create_app
from wrenchbook.service.tables import build, store
from wrenchbook.service.tables.store import TableStore
from wrenchbook.service.workspace import Settings

RANGE = {"force": [100.0] * 3, "moment": [10.0] * 3}
READY = "/health/ready"


@pytest.fixture
def building(tmp_path, monkeypatch):
    """A server that has started while the table `big` is built."""
    with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
        for name, count in (("big", 20), ("small", 3)):
            add(http, name, count)
    shutil.rmtree(tmp_path / "tables")
    may_build, make = threading.Event(), build.build_table

    def delayed(component, *rest):
        assert component.name != "big" or may_build.wait(600)
        return make(component, *rest)

    monkeypatch.setattr(build, "build_table", delayed)
    monkeypatch.setattr(store, "LARGE", 10)
    try:
        with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
            http.build_now = may_build.set
            yield http
            may_build.set()
    finally:
        may_build.set()


def test_a_server_whose_tables_are_still_built_is_not_all_ready_and_names_them(building):
    """It was ready while 19 of 25 tables were built."""
    body = building.get(READY).json()
    assert (body["status"], body["ready"], body["building"]) == ("building", False, ["big"])
    assert (body["tables"]["big"], body["tables"]["small"]) == ("building", "ready")


@pytest.mark.parametrize(("name", "status"), [("small", 200), ("big", 503), ("nope", 404)])
def test_the_readiness_of_one_component_has_its_own_status_code(building, name, status):
    assert building.get(READY, params={"component": name}).status_code == status


def test_a_ready_component_is_ready_while_another_table_is_built(building):
    body = building.get(READY, params={"component": "small"}).json()
    assert (body["status"], body["ready"], body["building"]) == ("ready", True, [])


def test_the_library_is_listed_while_a_table_is_built(building):
    """The list of all components was refused, for a minute, after a kill in an import."""
    reply = building.get("/v1/components")
    listed = {item["name"]: item for item in reply.json()["components"]}
    assert [listed[name]["rows"] for name in ("big", "small")] == [0, 3]
    assert listed["big"]["pending_rows"] == 20


def test_a_read_that_waits_gets_a_table_that_is_being_built(building):
    """It was refused at once, however long it was to wait."""
    later = threading.Timer(0.5, building.build_now)
    later.start()
    body = building.get("/v1/components/big", params={"wait_s": 60}).json()
    later.join()
    assert body["pending_rows"] == 0


@pytest.mark.parametrize("path", ["/health/live", READY, "/metrics"])
def test_head_of_a_health_call_has_the_status_of_get_and_no_body(building, path):
    status = building.get(path).status_code
    reply = building.head(path)
    assert (reply.status_code, reply.content) == (status, b"")


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def add(http, name, count=3):
    """Add a component, and rows to its table."""
    http.post("/v1/components", json={"name": name, "title": name, "range": RANGE})
    rows = [{"wrench": [n, 0, 0, 0, 0, 0], "displacement": [0.0] * 6} for n in range(count)]
    http.post(f"/v1/components/{name}/table?format=json", json={"rows": rows})


def test_a_table_whose_file_a_full_disk_does_not_take_is_not_ready_and_broken_at_once(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(build, "SAVE_AFTER_QUIET_S", 0.1)
    with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
        add(http, "fine")
        until((tmp_path / "tables" / "fine.h5").exists)
        monkeypatch.setattr(TableStore, "save", full)
        add(http, "rig")
        body = until(lambda: (result := http.get(READY).json())["broken"] and result)
        assert (body["status"], body["ready"]) == ("degraded", False)
        assert (body["tables"]["rig"], body["tables"]["fine"]) == ("degraded", "ready")
        # Its rows answer, so a proxy goes on sending it queries.
        assert http.get(READY, params={"component": "rig"}).status_code == 200


@pytest.mark.parametrize(("of_data", "said"), [(True, "the disk is full"), (False, "TMPDIR")])
def test_a_full_disk_is_not_ready_whatever_its_tables_are(tmp_path, monkeypatch, of_data, said):
    """With the disk of temporary files full it was ready, and refused all files."""
    with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
        add(http, "rig")
        full = "wrenchbook.service.workspace.is_full"
        monkeypatch.setattr(full, lambda folder: (folder == tmp_path) == of_data)
        reply = http.get(READY)
        assert (reply.status_code, reply.json()["status"]) == (503, "not ready")
        assert said in reply.json()["faults"][0]


def test_a_component_that_cannot_be_read_makes_no_server_ready(tmp_path):
    with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
        add(http, "rig")
    (tmp_path / "components" / "rig" / "component.toml").write_text("")
    with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
        reply = http.get(READY)
        body = reply.json()
        assert (reply.status_code, body["status"], body["ready"]) == (200, "degraded", False)
        assert body["tables"]["rig"] == "broken"
        assert list(body["broken"]) == ["rig"]
        (broken,) = http.get("/v1/components").json()["broken"]
        assert (broken["name"], "name" in broken["reason"]) == ("rig", True)
        assert "cannot be used" in http.get("/v1/components/rig").json()["detail"]
        assert http.get(READY, params={"component": "rig"}).status_code == 503
