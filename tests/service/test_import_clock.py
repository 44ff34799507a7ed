"""Joins of two logs name a shift of their clocks, and apply a lag only where it is requested."""

import numpy as np
import pytest

from tests.service.test_import_findings import CALL, add
from tests.surrogate.findings.rigs import Rig
from wrenchbook.service.http.routes.table import ImportQuery

LAG = 0.35
LOADS = "time [s],Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm]"
MOVED = "time [s],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"


@pytest.fixture
def rig():
    return Rig(5206, ("motion",))


def csv_of(header, time, numbers):
    rows = np.column_stack((time, numbers)).tolist()
    return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]).encode()


def logs_of(rig, lag=LAG):
    time = np.arange(len(rig.wrench)) / 40
    rows = rig.measured()
    return {
        "loads": ("loads.csv", csv_of(LOADS, time, rows.wrench)),
        "displacements": ("moved.csv", csv_of(MOVED, time - lag, rows.displacement)),
    }


def load(http, logs, **query):
    reply = http.post(CALL, files=logs, params=query)
    assert reply.status_code == 200, reply.text
    return reply.json()


def causes(reply):
    return [one["cause"] for one in reply["findings"]]


def test_a_clock_shift_in_a_join_is_named_and_nothing_is_applied_silently(http, rig):
    add(http, rig)
    reply = load(http, logs_of(rig), dry_run=True)
    assert causes(reply) == ["clock"]
    assert reply["clock"]["applied_s"] == 0.0
    assert abs(reply["clock"]["lag_s"] - LAG) < 0.01
    assert f"lag={reply['clock']['lag_s']:.4g}" in reply["findings"][0]["message"]


@pytest.mark.parametrize("query", [{"lag": "auto"}, {"time_offset_s": "auto"}, {"lag": LAG}])
def test_a_requested_lag_joins_the_logs_as_they_were_measured(http, rig, query):
    add(http, rig)
    reply = load(http, logs_of(rig), **query)
    assert causes(reply) == []
    assert abs(reply["clock"]["applied_s"] - LAG) < 0.01
    assert reply["inserted"] > 0.9 * len(rig.wrench)


def test_logs_of_one_clock_have_no_finding(http, rig):
    add(http, rig)
    reply = load(http, logs_of(rig, 0.0), dry_run=True)
    assert causes(reply) == []
    assert abs(reply["clock"]["lag_s"]) < 0.01


def test_one_table_has_no_clocks(http, rig):
    add(http, rig)
    body = {"rows": [{"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-6, 0, 0, 0, 0, 0]}]}
    assert http.post(CALL, json=body).json()["clock"] is None


def test_auto_without_a_lag_in_the_logs_is_refused_with_a_remedy(http, rig):
    add(http, rig)
    logs = logs_of(rig)
    time, noise = np.arange(300) / 40, rig.rng.normal(size=(300, 6)) * 1e-3
    logs["displacements"] = ("moved.csv", csv_of(MOVED, time, noise))
    reply = http.post(CALL, files=logs, params={"lag": "auto"})
    assert reply.status_code == 422
    assert "lag=auto cannot be applied" in reply.json()["errors"][0]["message"]


@pytest.mark.parametrize("lag", ["soon", "inf"])
def test_a_lag_that_is_no_number_is_refused(http, rig, lag):
    add(http, rig)
    assert http.post(CALL, files=logs_of(rig), params={"lag": lag}).status_code == 422


def test_lag_and_offset_are_one_law():
    assert ImportQuery.model_validate({"lag": "0.5"}).options().time_offset_s == 0.5


def test_auto_for_loads_that_repeat_is_refused_with_the_lags_that_fit(http, rig):
    add(http, rig)
    time = np.arange(0, 20, 0.025)
    push = np.sin(0.44 * np.pi * time)[:, None] * np.eye(6)[2]
    logs = {
        "loads": ("loads.csv", csv_of(LOADS, time, 100 * push)),
        "displacements": ("moved.csv", csv_of(MOVED, time + 2.0, 1e-4 * push)),
    }
    reply = http.post(CALL, files=logs, params={"lag": "auto"})
    assert reply.status_code == 422
    (error,) = reply.json()["errors"]
    assert "the loads repeat" in error["message"]
    assert "-2" in error["message"]
