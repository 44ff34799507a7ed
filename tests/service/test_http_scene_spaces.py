"""Scenes of components of several interfaces and further inputs."""

from __future__ import annotations

import numpy as np
import orjson
import pytest
from starlette.testclient import TestClient

from tests.service.spaces import SPACE, N, add_component, add_link
from wrenchbook.service.demand import QueryStatistics
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.table.rows import LoadRange

SCENE = {
    "loads": {"left": {"force": [1, [0, 0], [0, 0]], "moment": [[0, 0.5], [0, 0], [0, 0]]}},
    "inputs": {"temperature": [-0.5, 0.5]},
    "outputs": ["left.ux", "left.rz"],
}


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("two_ends"), solvers=0))) as client:
        add_link(client, has_fea=True)
        add_link(client, 1, "straight", linear=True)
        yield client


def planned(http, wanted, name="two_ends"):
    return http.post("/v1/scenes/plan", json={"components": {name: wanted}})


def test_a_nonlinear_component_is_looked_up_with_the_reason(http):
    plan = planned(http, SCENE).json()["components"]["two_ends"]
    assert plan["decision"] == "table"
    assert "one interface" in plan["reason"]
    assert plan["loads"] == ["left.fx", "left.mx", "temperature"]
    assert plan["outputs"] == ["left.ux", "left.rz"]
    assert plan["solves"] == {"whole": 2 * N + 3, "scene": 9}
    assert plan["axes"] == {}


def test_a_linear_component_has_the_matrix_of_the_loads_that_occur(http):
    plan = planned(http, SCENE, "straight").json()["components"]["straight"]
    matrix = http.app.state.workspace.surrogate("straight").fit.matrix
    assert plan["decision"] == "linear"
    occurring = [0, 3, N - 1]
    found = np.array(plan["compliance"])
    np.testing.assert_array_equal(found[:, occurring], matrix[:, occurring])
    assert not np.delete(found, occurring, axis=1).any()


def test_a_further_input_that_is_left_out_has_its_whole_range(http):
    plan = planned(http, {"loads": {"left": {"force": [1, 1, 1]}}}).json()["components"]["two_ends"]
    assert plan["loads"] == ["left.fx", "left.fy", "left.fz", "temperature"]


def test_a_scene_without_any_load_is_rigid(http):
    add_component(http, "solved", has_fea=True)
    wanted = {"inputs": {"temperature": [0, 0]}}
    plan = planned(http, wanted, "solved").json()["components"]["solved"]
    assert plan["decision"] == "rigid"


def test_the_cut_table_answers_as_the_whole_one(http):
    reply = http.get(
        "/v1/components/two_ends/scene", params={"wanted": orjson.dumps(SCENE).decode()}
    )
    assert reply.status_code == 200
    cut = PackedTable.from_bytes(reply.content)
    queries = np.zeros((50, N))
    queries[:, [0, 3, N - 1]] = np.random.default_rng(5).uniform(0, 0.5, (50, 3))
    whole = http.app.state.workspace.surrogate("two_ends").packed.batch(queries)
    found = cut.batch(queries)
    read = [0, 5]
    np.testing.assert_array_equal(found.outputs[:, read], whole.outputs[:, read])
    np.testing.assert_array_equal(found.errors[:, read], whole.errors[:, read])
    assert np.isnan(np.delete(found.outputs, read, axis=1)).all()
    assert cut.answer(np.eye(N)[6]).coverage == "outside"


def test_a_component_without_rows_is_planned(http):
    add_component(http, "bare")
    assert http.app.state.workspace.tables.catch_up("bare", 60)
    plan = planned(http, SCENE, "bare").json()["components"]["bare"]
    assert plan["decision"] == "table"


# -- fills and the demand map --------------------------------------------------------------------


def filled(http, **more):
    return http.post("/v1/components/two_ends/fill", json={"budget": 3, **more})


def test_solves_of_a_fill_lie_within_the_loads_of_its_interface(http):
    wanted = {"loads": {"left": {"force": [0.5, 0.5, 0.5]}}, "inputs": {"temperature": [0, 0.5]}}
    limit = {"translation": 1e-5, "rotation": 1e-5}
    reply = filled(http, range=wanted, outputs=["left.ux"], tolerance=limit)
    assert reply.status_code == 202, reply.text
    wrenches = http.app.state.workspace.submission.pending_wrenches("two_ends")
    assert len(wrenches) == 3
    assert (np.abs(wrenches[:, :3]) <= 0.5).all()
    assert not wrenches[:, 3 : N - 1].any()
    assert (wrenches[:, N - 1] >= 0).all()


def test_a_fill_that_cannot_reach_the_tolerance_says_the_solves_it_would_take(http):
    reason = filled(http, tolerance={"translation": 1e-4, "rotation": 1e-4}).json()["reason"]
    assert "further solves, an estimate by the rate so far" in reason


def test_the_compliance_has_the_names_of_the_space(http):
    reply = http.get("/v1/components/two_ends/compliance")
    assert reply.status_code == 200
    assert reply.json()["columns"][N - 1] == "temperature [degC]"


def test_coverage_is_answered(http):
    assert http.get("/v1/components/two_ends/coverage").status_code == 200


def test_the_demand_map_of_many_inputs_outlasts_a_restart(tmp_path):
    span = LoadRange(-np.ones(N), np.ones(N), SPACE)
    ledger = Ledger(tmp_path / "ledger.sqlite")
    counts = QueryStatistics(ledger)
    counts.note("two_ends", span, tuple([0.4] * N), "thin")
    counts.save()
    ledger.close()
    ledger = Ledger(tmp_path / "ledger.sqlite")
    found = QueryStatistics(ledger).map_of("two_ends", span)
    ledger.close()
    assert found["asked"] == 1
    assert len(found["cells"][0]["wrench"]) == N
