"""Scenes of components of several interfaces and further inputs."""

from __future__ import annotations

import numpy as np
import orjson
import pytest
from starlette.testclient import TestClient

from tests.service.spaces import N, add_component, add_link
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.kernel.binding import PackedTable

SCENE = {
    "loads": {"left": {"force": [1, [0, 0], [0, 0]], "moment": [[0, 0.5], [0, 0], [0, 0]]}},
    "inputs": {"temperature": [-0.5, 0.5]},
    "outputs": ["left.ux", "left.rz"],
}


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("two_ends"), solvers=0))) as client:
        add_link(client)
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
    assert http.app.state.workspace.tables.catch_up("bare", 30.0)
    plan = planned(http, SCENE, "bare").json()["components"]["bare"]
    assert plan["decision"] == "table"
