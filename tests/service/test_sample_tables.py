"""The sample files in data/tables, each sent to a server with its query: the reply that is told."""

import json
import math
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

FOLDER = Path(__file__).parents[2] / "data" / "tables"
REPLIES = json.loads((FOLDER / "replies.json").read_text(encoding="utf-8"))
RANGE = {"force": [900] * 3, "moment": [90] * 3}
ROWS = ("read", "loaded", "refused", "tare", "unmatched")


@pytest.fixture(scope="module")
def shared_http(tmp_path_factory):
    folder = tmp_path_factory.mktemp("samples") / "workspace"
    with TestClient(create_app(Settings(folder, solvers=0))) as client:
        yield client


@pytest.fixture(scope="module")
def sent(shared_http):
    """Send each file to a table of its own."""
    replies = {}
    for number, (name, reported) in enumerate(REPLIES.items()):
        rig = f"rig{number}"
        body = {"name": rig, "title": name, "range": RANGE}
        assert shared_http.post("/v1/components", json=body).status_code == 201
        path = f"/v1/components/{rig}/table"
        query = {**reported.get("query", {}), "preview": 3}
        content = (FOLDER / name).read_bytes()
        if "displacements" in reported:
            other = (FOLDER / reported["displacements"]).read_bytes()
            files = {"loads": (name, content), "displacements": (reported["displacements"], other)}
            replies[name] = shared_http.post(path, params=query, files=files)
        else:
            head = {"content-type": "application/octet-stream"}
            replies[name] = shared_http.post(path, params=query, content=content, headers=head)
    return replies


@pytest.mark.parametrize("name", REPLIES)
def test_a_sample_file_gets_the_reply_that_is_told(sent, name: str):
    reported, reply = REPLIES[name], sent[name]
    assert reply.status_code == reported["status"], reply.text
    body = reply.json()
    errors = reported.get("errors", [])
    result = [(error["row"], error["field"]) for error in body["errors"]]
    assert result == [(row, field) for row, field, _ in errors]
    for error, (_, _, says) in zip(body["errors"], errors, strict=True):
        assert says in error["message"]
    for word in ("inserted", "format", "gzip", "ignored", "above", "sheets", "sheet"):
        if word in reported:
            assert body[word] == reported[word], word
    for word in ROWS:
        if word in reported:
            assert body["rows"][word] == reported[word], word


@pytest.mark.parametrize(
    "name", [name for name, reported in REPLIES.items() if reported["status"] == 200]
)
def test_every_row_of_a_sample_file_is_accounted_for(sent, name: str):
    rows = sent[name].json()["rows"]
    assert rows["read"] == sum(rows[word] for word in ROWS[1:])


@pytest.mark.parametrize(
    "name", ["pounds_and_thou.csv", "spelled.csv", "units_row.txt", "tare.csv", "titled.csv"]
)
def test_units_spellings_and_tare_give_the_same_wrenches(sent, name: str):
    plain = sent["plain_si.csv"].json()["preview"][0]["wrench"]
    assert sent[name].json()["preview"][0]["wrench"] == pytest.approx(plain, rel=1e-5, abs=1e-4)


def test_loads_of_the_log_are_counts_over_counts_per_unit_at_the_displacement_s_time(sent):
    for row in sent["ati_loads.csv"].json()["preview"]:
        time = 0.005 + 0.05 * (row["row"] - 2)
        assert row["wrench"][2] == pytest.approx(400 * math.sin(math.pi * time), abs=0.06)


def test_the_samples_are_small():
    assert len(REPLIES) >= 20
    assert sum(file.stat().st_size for file in FOLDER.iterdir() if file.is_file()) < 1_000_000
