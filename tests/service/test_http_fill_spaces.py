"""Fills and the demand map of components of several interfaces and further inputs."""

from __future__ import annotations

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.spaces import SPACE, N, add_link
from wrenchbook.service.demand import QueryStatistics
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.table.rows import LoadRange


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("two_ends"), solvers=0))) as client:
        add_link(client, has_fea=True)
        yield client


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
