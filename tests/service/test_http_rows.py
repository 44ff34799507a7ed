"""Withdrawing rows, filling on all rows, linear components, and a server on a bad disk."""

import io
import json
import os
import subprocess
import sys
import threading
import zipfile
from contextlib import contextmanager
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.ports import reserved_port
from tests.service.ledger_rows import NewRow, insert, stored
from tests.service.test_http_components import TABLE_ONLY, bar_text
from tests.until import until
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

ROOT = Path(__file__).parents[2]


@pytest.fixture
def unused():
    """A port of this machine that nobody listens on."""
    return reserved_port()


@pytest.fixture
def rig(http):
    assert http.post("/v1/components", json=TABLE_ONLY).status_code == 201
    workspace = http.app.state.workspace
    new = [NewRow((i / 10, 0, 0, 0, 0, 0), (i * 1e-7, 0, 0, 0, 0, 0)) for i in range(1, 6)]
    insert(workspace.ledger, "rig", "", new)
    workspace.tables.catch_up("rig", 600)
    return [row.seq for row in stored(workspace.ledger, "rig")]


def exported(http, name="rig"):
    return len(http.get(f"/v1/components/{name}/table", params={"format": "csv"}).text.splitlines())


def test_a_withdrawn_row_leaves_table_and_export_and_restore_brings_it_back(http, rig):
    before = exported(http)
    gone = http.delete(f"/v1/components/rig/table/{rig[2]}")
    assert gone.status_code == 200, gone.text
    assert gone.json()["status"] == "withdrawn"
    assert http.get("/v1/components/rig?wait_s=60").json()["rows"] == 4
    assert exported(http) == before - 1
    again = http.delete(f"/v1/components/rig/table/{rig[2]}")
    assert (again.status_code, "already withdrawn" in again.json()["detail"]) == (409, True)
    back = http.post(f"/v1/components/rig/table/{rig[2]}/restore")
    assert back.json()["table_version"] > gone.json()["table_version"]
    assert http.get("/v1/components/rig?wait_s=60").json()["rows"] == 5
    assert exported(http) == before


def wait_for_jobs(http, name):

    def ended():
        counts = http.get(f"/v1/components/{name}").json()["jobs"]
        return None if counts["waiting"] + counts["running"] else counts

    return until(ended)


def test_fill_never_pays_for_a_wrench_it_has_asked_for(http):
    """24 of 24 solves of a round were those of the round before; "100 solves" were 77 jobs."""
    asked = []
    for _ in range(25):
        order = http.post("/v1/components/plate_thin/fill", json={"budget": 3}).json()
        asked += [job["id"] for job in order["jobs"]]
        for job in order["jobs"][:1]:  # the others are open at the next round
            http.get(job["url"], params={"wait_s": 60})
    assert len(asked) == len(set(asked)) >= 15  # what the first design has at least
    assert wait_for_jobs(http, "plate_thin")["done"] == len(asked)


def test_fill_says_so_when_the_table_is_behind_rather_than_design_on_it(http, monkeypatch):
    workspace = http.app.state.workspace
    monkeypatch.setattr("wrenchbook.service.workspace.CATCH_UP_S", 0.1)
    monkeypatch.setattr(workspace.builder, "_build_newest", lambda name: None)
    body = {"force": [1, 2, 3], "moment": [0, 0, 0], "wait_s": 60}
    assert http.post("/v1/components/plate_thin/solve", json=body).status_code == 200
    reply = http.post("/v1/components/plate_thin/fill", json={"budget": 3})
    assert (reply.status_code, "older than the ledger" in reply.json()["detail"]) == (503, True)
    assert sum(workspace.ledger.counts("plate_thin").values()) == 1


ASKED = {"force": [0, 0, -50], "moment": [0, 0, 0], "on_thin": "estimate"}


@pytest.mark.parametrize("added", [False, True])
def test_a_linear_component_nobody_has_solved_solves_itself_when_first_asked(
    folder, monkeypatch, added
):
    """`estimate` was answered with null until somebody thought of asking for one solve."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("WRENCHBOOK_SOLVE", raising=False)
    name = "beam" if added else "bar"
    with TestClient(create_app(Settings(folder, solvers=2))) as http:
        if added:
            buffer = io.BytesIO()
            with zipfile.ZipFile(buffer, "w") as archive:
                archive.writestr("component.toml", bar_text())
            files = {"bundle": ("b.zip", buffer.getvalue(), "application/zip")}
            assert http.post("/v1/components", files=files).status_code == 201
        else:
            http.get("/v1/components")
            assert http.get("/v1/jobs").json()["jobs"] == []
            for _ in range(3):
                http.post(f"/v1/components/{name}/displacement", json=ASKED)
        assert sum(http.get(f"/v1/components/{name}").json()["jobs"].values()) == 1
        assert wait_for_jobs(http, name)["done"] == 1
        workspace = http.app.state.workspace
        assert workspace.tables.catch_up(name, 600)
        reply = http.post(f"/v1/components/{name}/displacement", json=ASKED).json()
        assert (reply["coverage"], reply["method"]) == ("covered", "linear")
        assert np.isfinite(reply["translation"]).all()
        assert len(http.get("/v1/jobs").json()["jobs"]) == 1


def test_a_fill_of_a_linear_component_joins_its_open_solve(http, stand_in):
    stand_in("endless")
    http.post("/v1/components/bar/displacement", json=ASKED)
    (job,) = http.get("/v1/jobs").json()["jobs"]
    (joined,) = http.post("/v1/components/bar/fill", json={}).json()["jobs"]
    assert joined["id"] == job["id"]


def test_a_linear_component_whose_solves_bring_no_compliance_asks_for_all_six(http):
    """As an expert's deck does: the first row does not tell the rest."""
    call = "/v1/components/bar"
    until(lambda: http.post(f"{call}/displacement", json=ASKED).json()["coverage"] == "covered")
    assert http.get(call).json()["jobs"]["done"] == 6


# The process may write no byte more into any file; the log and the terminal are pipes.
NO_SPACE = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
"""


SERVE = """
import sys, uvicorn
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings
uvicorn.run(create_app(Settings(Path(sys.argv[1]), solvers=1)), port=int(sys.argv[2]))
"""


def call(port, path, body=None):
    """Send one request to a server on this machine; return its status and answer."""
    request = Request(
        f"http://127.0.0.1:{port}{path}",
        None if body is None else json.dumps(body).encode(),
        {"Content-Type": "application/json"},
    )
    try:
        with urlopen(request, timeout=600) as reply:
            return reply.status, json.load(reply)
    except HTTPError as error:
        with error:
            return error.code, json.load(error)


# Root, too, may not write where the mode of a file forbids it.
NO_RIGHT = """
import ctypes
ctypes.CDLL(None).prctl(24, 1, 0, 0, 0)  # PR_CAPBSET_DROP, CAP_DAC_OVERRIDE
"""

# Limits are set by a process that becomes the server: a hook of this one would fork it, threads
# and all.
BECOME = "\nimport os, sys; os.execv(sys.executable, [sys.executable, '-c', *sys.argv[1:]])"


@pytest.fixture
def full_disk(folder, http, rig, unused):
    """A server that could write no byte from its start on; its port."""
    http.app.state.workspace.close()
    with serving(folder, unused, NO_SPACE):
        yield unused


@pytest.fixture
def read_only(folder, http, rig, unused):
    """A server of a directory in which nothing may be written; its port."""
    http.app.state.workspace.close()
    places = [folder, *folder.rglob("*")]
    for path in places:
        path.chmod(0o500 if path.is_dir() else 0o400)
    try:
        with serving(folder, unused, NO_RIGHT):
            yield unused
    finally:
        for path in places:
            path.chmod(0o700 if path.is_dir() else 0o600)


@contextmanager
def serving(folder, unused, before):
    environment = dict(os.environ, PYTHONPATH=str(ROOT / "src"))
    command = [sys.executable, "-c", before + BECOME, SERVE, str(folder), str(unused)]
    server = subprocess.Popen(command, env=environment, stdout=-1, stderr=subprocess.STDOUT)
    log = []
    reader = threading.Thread(target=lambda: log.extend(server.stdout))
    reader.start()
    try:
        until(lambda: server.poll() is not None or any(b"Uvicorn running" in item for item in log))
        assert server.poll() is None, log
        yield
    finally:
        server.terminate()
        server.wait(600)
        reader.join()
        server.stdout.close()


def test_a_server_on_a_full_disk_starts_answers_and_refuses_to_accept(full_disk):
    """It did not start at all."""
    ask = {"force": [0.2, 0, 0], "moment": [0, 0, 0], "on_thin": "estimate"}
    status, answer = call(full_disk, "/v1/components/rig/displacement", ask)
    assert (status, answer["translation"][0]) == (200, pytest.approx(2e-7))
    status, about = call(full_disk, "/v1/components/rig")
    assert (status, about.get("rows")) == (200, 5), about
    body = {"force": [1, 2, 3], "moment": [0, 0, 0]}
    status, refused = call(full_disk, "/v1/components/plate_thin/solve", body)
    assert (status, refused["type"]) == (503, "urn:wrenchbook:problem:ledger")
    status, refused = call(full_disk, "/v1/components", {**TABLE_ONLY, "name": "more"})
    assert (status, refused["type"]) == (507, "urn:wrenchbook:problem:disk")
    status, ready = call(full_disk, "/health/ready")
    assert status == 503
    assert ready["faults"]


@pytest.mark.skipif(sys.platform != "linux", reason="root's right to write is taken by Linux alone")
def test_a_server_of_a_read_only_directory_answers_and_refuses_to_accept(read_only, folder):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    ask = {"force": [0.2, 0, 0], "moment": [0, 0, 0], "on_thin": "estimate"}
    status, answer = call(read_only, "/v1/components/rig/displacement", ask)
    assert (status, answer["translation"][0]) == (200, pytest.approx(2e-7))
    body = {"force": [1, 2, 3], "moment": [0, 0, 0]}
    status, refused = call(read_only, "/v1/components/plate_thin/solve", body)
    assert (status, refused["type"]) == (503, "urn:wrenchbook:problem:ledger")
    assert "readonly" in refused["detail"]
    status, ready = call(read_only, "/health/ready")
    assert status == 503
    assert "readonly" in ready["faults"][0]
    assert {path: path.read_bytes() for path in before} == before
