"""Measured rows beside the solves alone, or beside another import."""

import csv
import io
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from starlette.responses import Response
from starlette.testclient import TestClient

from tests.service.ledger_rows import NewRow, insert
from tests.service.test_http_library import http, load  # noqa: F401 (a fixture)
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.routes import library
from wrenchbook.service.tables import comparison
from wrenchbook.service.workspace import Settings

# Of a clamped bar, SI: tension, bending and twist in closed form.
L, EI, EA, GJ = 1.0, 2800.0, 8.4e7, 1820.0
COMPLIANCE = np.diag([L / EA, L**3 / (3 * EI), L**3 / (3 * EI), L / GJ, L / EI, L / EI])
COMPLIANCE[1, 5] = COMPLIANCE[5, 1] = L**2 / (2 * EI)
COMPLIANCE[2, 4] = COMPLIANCE[4, 2] = -(L**2) / (2 * EI)
CALL = "/v1/components/bar/comparison"


@pytest.fixture
def bar(http):  # noqa: F811
    """The bar with solves in closed form, by a solver with an error of a tenth of a percent."""
    workspace = http.app.state.workspace
    component = workspace.library["bar"]
    span = component.load_range
    error = {"mesh": (1e-3 * np.abs(COMPLIANCE)).tolist(), "loads": span.scale.tolist()}
    workspace.errors.record("bar", component.fingerprint, error | {"linearity": [0.0] * 6})
    wrenches = np.random.default_rng(0).uniform(-0.9, 0.9, (12, 6)) * span.scale
    solves = [
        NewRow(w.tolist(), (COMPLIANCE @ w).tolist(), "fea", COMPLIANCE.tolist()) for w in wrenches
    ]
    insert(workspace.ledger, "bar", component.fingerprint, solves)
    return http


def campaign(http, factor, seed, count=60, reach=0.9):  # noqa: F811
    """Import readings of a rig that is softer by a factor; return the number of the import."""
    rng = np.random.default_rng(seed)
    wrench = np.zeros((count, 6))
    wrench[:, 2] = rng.uniform(-reach, reach, count) * 100
    moved = factor * wrench @ COMPLIANCE.T + rng.normal(0, 2e-5, (count, 6))
    return load(http, np.hstack([wrench, moved[:, :3]]), "bar", load_cell="moving")["import"]


def test_a_row_stands_beside_the_solves_that_have_not_swallowed_it(bar):
    number = campaign(bar, 1.05, 1)
    reply = bar.get(CALL).json()
    expected = np.array(reply["wrench"]) @ COMPLIANCE.T
    assert np.allclose(reply["expected"], expected, rtol=1e-9, atol=1e-15)
    assert (reply["measured"], reply["compared"], reply["reference"]["rows"]) == (60, 60, 12)
    assert reply["campaign"] == [number] * 60
    uz = reply["outputs"]["uz"]
    assert abs(uz["factor"] - 1.05) <= uz["half_width"] < 0.01
    assert uz["of_reference"] == pytest.approx(1e-3, rel=0.05)
    residual = np.array(reply["residual"], float)[:, 2]
    bound = np.hypot(np.array(reply["bar"])[:, 2], reply["noise"][2])
    assert uz["beyond_bars"] == (np.abs(residual) > bound).sum() > 40
    assert reply["outputs"]["rx"]["factor"] is None


def test_each_import_has_its_factor_and_two_are_compared_by_a_table_of_one(bar):
    first, second = campaign(bar, 1.0, 2), campaign(bar, 1.05, 3)
    both = bar.get(CALL).json()
    factors = {part["import"]: part["outputs"]["uz"]["factor"] for part in both["campaigns"]}
    assert factors == pytest.approx({first: 1.0, second: 1.05}, abs=0.005)
    reported = bar.get(CALL, params={"import": second, "against": first}).json()
    assert reported["reference"] | {"bars_are_complete": None} == {
        "import": first, "rows": 60, "of": 60, "method": "kriging", "bars_are_complete": None
    }  # fmt: skip
    uz = reported["outputs"]["uz"]
    assert set(reported["campaign"]) == {second}
    assert abs(uz["factor"] - 1.05) <= uz["half_width"] < 0.01
    same = campaign(bar, 1.0, 4)
    uz = bar.get(CALL, params={"import": same, "against": first}).json()["outputs"]["uz"]
    assert abs(uz["factor"] - 1.0) <= uz["half_width"]
    assert uz["beyond_bars"] <= 8


def test_rows_that_the_reference_does_not_cover_are_counted_and_have_no_answer(bar):
    near, far = campaign(bar, 1.0, 5, reach=0.3), campaign(bar, 1.0, 6)
    reply = bar.get(CALL, params={"import": far, "against": near}).json()
    outside = np.abs(np.array(reply["wrench"])[:, 2]) > 45
    assert reply["coverages"]["covered"] < 60 - outside.sum()
    for column in ("expected", "residual", "bar"):
        assert np.isnan(np.array(reply[column], float)[outside, 2]).all()
    known = np.isfinite(np.array(reply["bar"], float)[:, 2])
    uz = reply["outputs"]["uz"]
    assert (uz["compared"], uz["unanswered"]) == (known.sum(), 60 - known.sum())
    beyond = campaign(bar, 1.0, 7, reach=1.5)
    reply = bar.get(CALL, params={"import": beyond}).json()
    assert reply["beyond_range"] == 60 - reply["compared"] > 10


def test_a_comparison_as_csv_has_the_numbers_of_the_json(bar):
    campaign(bar, 1.02, 8, count=10)
    reply = bar.get(CALL).json()
    lines = [*csv.DictReader(io.StringIO(bar.get(CALL, params={"format": "csv"}).text))]
    assert [int(line["row"]) for line in lines] == reply["row"]
    for name, label in (("displacement", "uz"), ("residual", "uz_residual"), ("bar", "uz_bar")):
        assert [float(line[f"{label} [m]"]) for line in lines] == [row[2] for row in reply[name]]
    assert {line["rx [rad]"] for line in lines} == {""}


def test_of_more_rows_than_the_most_some_are_compared_evenly(bar, monkeypatch):
    monkeypatch.setattr(comparison, "MAX_COMPARED", 30)
    campaign(bar, 1.0, 9, count=70)
    reply = bar.get(CALL).json()
    assert (reply["measured"], reply["compared"]) == (70, 24)
    assert np.diff(reply["row"]).tolist() == [3] * 23


def test_what_cannot_be_compared_says_what_can(bar):
    reason = bar.get("/v1/components/rig/comparison").json()["reason"]
    assert reason.startswith("'rig' has no finite-element setup, so it has no solves; compare two")
    number = campaign(bar, 1.0, 11)
    for query in ({"import": number + 7}, {"against": number + 7}):
        refused = bar.get(CALL, params=query)
        assert refused.status_code == 409
        assert refused.json()["detail"].endswith(f"import {number + 7}; its newest are {number}")
    own = bar.get(CALL, params={"import": number, "against": number})
    assert (own.status_code, "own reference" in own.json()["detail"]) == (409, True)


def test_comparisons_take_turns_in_each_server_of_a_process(tmp_path, monkeypatch):
    def slow(*_):
        time.sleep(0.2)
        return Response("{}")

    monkeypatch.setattr(library, "_compare", slow)
    for name in ("first", "second"):
        app = create_app(Settings(tmp_path / name, solvers=0))
        with TestClient(app) as client, ThreadPoolExecutor(2) as threads:
            assert [*threads.map(lambda _: client.get(CALL).status_code, range(2))] == [200, 200]
