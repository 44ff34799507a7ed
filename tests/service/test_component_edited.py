"""A component.toml edited under a running server is a new setup at once: jobs, rows and table."""

import time

import pytest
from starlette.testclient import TestClient

from fea.bundle.shipped import SHIPPED
from service.http.app import create_app
from service.workspace import Settings

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
    reply = http.post(f"{CALL}/solve", json={**WRENCH, "wait_s": 20}).json()
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
    about = served.get(CALL).json()
    assert about["fingerprint"] != before
    assert about["rows"] == 1
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
    while served.post(f"{CALL}/displacement", json=asked).json()["translation"] is None:
        time.sleep(0.01)
    edit(toml, stiffer=("poisson_ratio = 0.3", "poisson_ratio = 0.2"))
    deadline = time.monotonic() + 10
    while served.post(f"{CALL}/displacement", json=asked).json()["translation"] is not None:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_an_edit_with_a_mistake_is_told_and_mended_without_a_restart(served, toml):
    sound = toml.read_text()
    edit(toml, mistake=("poisson_ratio", "poisson_ration"))
    told = served.post(f"{CALL}/solve", json=WRENCH)
    assert told.status_code == 404
    assert "poisson_ration" in told.json()["detail"]
    assert "mine" in served.get("/health/ready").json()["broken"]
    assert served.get("/v1/components").status_code == 200
    toml.write_text(sound)
    solve(served)
    assert served.get("/health/ready").json()["broken"] == {}
