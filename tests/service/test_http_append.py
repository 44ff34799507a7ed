"""Rows that are appended while a test runs: each once, checked as an import's, and in use."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.service.following import wait_for_version
from tests.service.test_http_library import http  # noqa: F401 (a fixture)
from wrenchbook.service.ledger import ImportOrigin, Ledger, NotedRows
from wrenchbook.surrogate.table.rows import Rows

ROOT = Path(__file__).parents[2]
CALL = "/v1/components/live/table"
SPANS = {"force": [100] * 3, "moment": [10] * 3}
LIVE = {"name": "live", "title": "A test that runs", "range": SPANS}


@pytest.fixture
def live(http):  # noqa: F811
    tolerance = {"translation": 2e-5, "rotation": 1e-3}
    assert http.post("/v1/components", json=LIVE | {"tolerance": tolerance}).status_code == 201
    return http


def block(seed, count=12):
    """Readings of a spring that stiffens, with a noise of 2 um, in units of the rig."""
    rng = np.random.default_rng(seed)
    force = rng.uniform(-100, 100, count)
    moved = 1e-2 * force + 1e-6 * force**3 + rng.normal(0, 1e-3, count)
    pairs = zip(force.tolist(), moved.tolist(), strict=True)
    return [{"fz [N]": one, "uz [mm]": other} for one, other in pairs]


def append(http, rows, name="run 17", **query):  # noqa: F811
    query = {"append": name, "missing_loads": "zero"} | query
    return http.post(CALL, json=rows, params=query)


def imports(http):  # noqa: F811
    return http.get("/v1/components/live/imports").json()["imports"]


def test_appended_rows_raise_the_version_cover_the_wrench_and_shrink_its_bar(live):
    reported = []
    for seed, count in enumerate((2, 12, 60, 400)):
        reply = append(live, block(seed, count)).json()
        wait_for_version(live, "live", reply["table_version"])
        body = {"force": [0, 0, 61.0], "on_thin": "estimate"}
        answer = live.post("/v1/components/live/displacement", json=body).json()
        reported.append((answer["coverage"], answer["table_version"], answer["error"]))
    coverages, versions, errors = zip(*reported, strict=True)
    assert coverages[0] != coverages[-1] == "covered"
    assert sorted(set(versions)) == list(versions)
    bars = [error["translation"][2] for error in errors[1:]]
    assert bars[-1] < 0.6 * bars[0]
    assert abs(answer["translation"][2] - (61e-5 + 61**3 * 1e-9)) <= bars[-1]


def test_a_test_that_was_appended_answers_as_an_import_of_its_rows(live):
    blocks = [block(seed, 40) for seed in range(6)]
    for some in blocks:
        append(live, some)
    live.post("/v1/components", json=LIVE | {"name": "file"})
    query = {"missing_loads": "zero", "wait_s": 60}
    live.post(
        "/v1/components/file/table", json=[row for some in blocks for row in some], params=query
    )
    table = live.get("/v1/components/live?wait_s=60").json()["table_version"]
    wait_for_version(live, "live", table)
    replies = [
        live.post(f"/v1/components/{name}/displacement", json={"force": [0, 0, 61.0]}).json()
        for name in ("live", "file")
    ]
    for key in ("translation", "error"):
        assert replies[0][key] == replies[1][key]


def test_a_block_that_is_sent_again_adds_nothing_and_all_are_one_import(live):
    first = append(live, block(1)).json()
    again = append(live, block(1)).json()
    longer = append(live, [*block(1), *block(2, 3)]).json()
    one = append(live, block(3, 1)[0]).json()
    counts = [(r["inserted"], r["existing"]) for r in (first, again, longer, one)]
    assert counts == [(12, 0), (0, 12), (3, 12), (1, 0)]
    assert {r["import"] for r in (first, again, longer, one)} == {first["import"]}
    (record,) = imports(live)
    assert (record["filename"], record["format"], record["rows"]) == ("run 17", "append", 16)
    assert append(live, block(4), "run 18").json()["import"] > first["import"]


def test_a_block_that_is_sent_again_waits_for_answers_from_its_rows(live):
    append(live, block(1))
    reply = append(live, block(1), wait_s=60).json()
    assert (reply["inserted"], reply["in_use"]) == (0, True)


def test_rows_of_arrays_and_a_single_one_are_taken_in_si(live):
    row = {"wrench": [0, 0, 5, 0, 0, 0], "displacement": [None, None, 5e-5, None, None, None]}
    other = row | {"wrench": [0, 0, 6, 0, 0, 0]}
    assert append(live, row).json()["inserted"] == 1
    assert append(live, {"rows": [row, other]}).json()["inserted"] == 1


def test_a_block_with_a_mistake_adds_nothing_by_the_laws_of_an_import(live):
    wrong = [*block(1), {"fz [N]": 1e6, "uz [mm]": 1.0}]
    refused = append(live, wrong)
    assert (refused.status_code, imports(live)) == (422, [])
    as_import = live.post(CALL, json=wrong, params={"missing_loads": "zero"}).json()
    assert refused.json()["errors"] == as_import["errors"]
    assert append(live, wrong, partial=True).json()["inserted"] == 12


@pytest.mark.parametrize(
    ("rows", "query", "status", "says"),
    [
        (block(1, 1001), {}, 422, "are 1,001; append at most 1,000"),
        ([], {}, 422, "must be a table"),
        (block(1), {"tare": 3}, 422, "append does not allow tare"),
        (block(1), {"rig": "tare = 3"}, 422, "append cannot go with tare of this rig"),
        (block(1), {"branch": "loading"}, 422, "append does not allow branch"),
        (block(1), {"lag": "auto"}, 422, "append does not allow time_offset_s (lag)"),
        (block(1), {"append": ""}, 422, "append"),
        ([{"fz [N]": 1.0, "uz [mm]": 1.0, "note": "x" * (1 << 20)}], {}, 413, "1 MiB"),
    ],
)
def test_a_block_beyond_its_limits_is_refused(live, rows, query, status, says):
    refused = append(live, rows, **query)
    assert (refused.status_code, says in refused.text) == (status, True)
    assert imports(live) == []


def test_a_withdrawn_test_and_another_rig_take_no_more_rows(live):
    number = append(live, block(1)).json()["import"]
    turned = append(live, block(2), frame="x=y,y=-x,z=z")
    assert (turned.status_code, "another rig" in turned.json()["detail"]) == (409, True)
    live.delete(f"/v1/components/live/imports/{number}")
    refused = append(live, block(2))
    assert (refused.status_code, "is withdrawn" in refused.json()["detail"]) == (409, True)
    live.post(f"/v1/components/live/imports/{number}/restore")
    assert append(live, block(2)).json()["import"] == number


def rows_of(seed):
    wrench = np.random.default_rng(seed).normal(size=(3, 6))
    return [NotedRows(Rows.of(wrench, 1e-5 * wrench, source=["rig"] * 3), ["note"] * 3)]


def run(path):
    """Append blocks and print the number of each that is acknowledged, until it is killed."""
    ledger, seed = Ledger(path), 0
    while True:
        ledger.append_rows("rig", rows_of(seed), ImportOrigin(filename="run 17"))
        os.write(1, f"{seed}\n".encode())
        seed += 1


@pytest.mark.exact("another process makes the same rows")
def test_a_kill_between_blocks_loses_none_that_was_acknowledged(tmp_path):
    path = tmp_path / "ledger.sqlite"
    command = [sys.executable, "-m", "tests.service.test_http_append", str(path)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    seen = [process.stdout.readline() for _ in range(20)]
    process.kill()
    seen += process.communicate()[0].splitlines()
    ledger = Ledger(path)
    (record,) = ledger.imports("rig")
    assert record.rows == ledger.count_rows("rig") >= 3 * len(seen)
    for seed in range(len(seen)):
        again = ledger.append_rows("rig", rows_of(seed), ImportOrigin(filename="run 17"))
        assert again == (0, 3, record.id)
    ledger.close()


if __name__ == "__main__":
    run(sys.argv[1])
