"""Imports name probable systematic errors of a measurement, with the rows of the file."""

from dataclasses import replace

import numpy as np
import pytest

from tests.service.ledger_rows import NewRow, insert
from tests.surrogate.findings.rigs import Rig
from tests.until import until
from wrenchbook.service.formats.options import Options, ParsedTable
from wrenchbook.service.formats.read import FindingsSample
from wrenchbook.service.http.imports import ImportQuery
from wrenchbook.service.tables.mapped import MappedTables
from wrenchbook.surrogate.findings.find import MAX_ROWS
from wrenchbook.surrogate.table.rows import Rows

CALL = "/v1/components/rig/table"
HEADER = (
    "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"
)


@pytest.fixture
def rig():
    """Return a rig of 90 rows, whose table a busy machine builds in seconds."""
    result = Rig(7, ("random",))
    result.wrench, result.displacement = result.wrench[:90], result.displacement[:90]
    return result


def csv_of(rows):
    numbers = np.hstack((rows.wrench, rows.displacement))
    return "\n".join([HEADER, *(",".join(map(repr, row)) for row in numbers.tolist())])


def add(http, rig):
    high = rig.high.tolist()
    body = {"name": "rig", "title": "Rig", "range": {"force": high[:3], "moment": high[3:]}}
    assert http.post("/v1/components", json=body).status_code == 201


def send(http, content, call=CALL, **query):
    return http.post(call, content=content, params=query, headers={"content-type": "text/csv"})


def load(http, rows, **query):
    return send(http, csv_of(rows), **query)


def test_outliers_are_named_by_their_rows_of_the_file(http, rig):
    add(http, rig)
    rows = rig.measured()
    rows.displacement[[11, 80], 2] += [2 * rig.size[2], -rig.size[2]]
    for query in ({"dry_run": True}, {}):
        (result,) = load(http, rows, **query).json()["findings"]
        assert (result["cause"], result["rows"], result["count"]) == ("outlier", [13, 82], 2)


def test_loads_of_the_wrong_sign_are_loaded_and_said(http, rig):
    add(http, rig)
    reply = load(http, rig.measured("all loads with the wrong sign")).json()
    assert [finding["cause"] for finding in reply["findings"]] == ["sign"]
    assert reply["inserted"] == len(rig.wrench)


def table_of(first, count):
    wrench = np.arange(first, first + count)[:, None] * np.ones(6)
    rows = ParsedTable.of(wrench, wrench, seq=np.arange(first, first + count))
    return replace(rows, note=[""] * count)


@pytest.mark.parametrize(
    "sizes",
    [[1] * 200, [7] * 3000, [40_001], [40_001, 3, 12_345], [2 * MAX_ROWS + 1] * 9],
)
def test_of_many_pieces_rows_of_one_distance_are_kept(sizes):
    sample, first = FindingsSample(), 1
    for size in sizes:
        sample.add(table_of(first, size))
        first += size
    rows = np.concatenate([part.seq for part in sample.parts])
    assert len(set(np.diff(rows).tolist())) == 1
    assert rows[0] == 1
    assert len(rows) <= 2 * MAX_ROWS
    assert len(rows) > MAX_ROWS / 2 or len(rows) == sum(sizes)
    assert sum(sizes) - rows[-1] < rows[1] - rows[0]
    assert sample.findings(Options()) == []  # without a load range


def findings_of(http):
    """Return what the component warns of its imports."""
    warnings = http.get("/v1/components/rig").json()["warnings"]
    return [warning for warning in warnings if "import" in warning]


def rows_of(http, count):
    """Wait until the table has so many rows."""
    return until(lambda: http.get("/v1/components/rig").json()["rows"] == count)


def with_outliers(rig):
    rows = rig.measured()
    rows.displacement[[11, 80], 2] += [2 * rig.size[2], -rig.size[2]]
    return rows


def test_findings_stay_visible_after_the_import(http, rig):
    add(http, rig)
    reply = load(http, with_outliers(rig), filename="rig.csv").json()
    (result,) = findings_of(http)
    assert (result["cause"], result["import"], result["count"]) == ("outlier", reply["import"], 2)
    assert result["where"] == f"import {reply['import']}"
    assert result["filename"] == "rig.csv"
    assert result["message"] == reply["findings"][0]["message"]
    worst = http.get(f"{CALL}/{result['rows'][0]}").json()
    assert worst["provenance"]["import"]["id"] == reply["import"]
    (listed,) = http.get("/v1/components/rig/imports").json()["imports"]
    assert [finding["cause"] for finding in listed["findings"]] == ["outlier"]


def test_a_finding_is_visible_while_the_table_of_its_import_is_not_built(http, rig, monkeypatch):
    add(http, rig)
    monkeypatch.setattr(MappedTables, "_map", lambda *_: False)  # no table is ever ready
    load(http, with_outliers(rig), wait_s=0)
    assert [finding["cause"] for finding in findings_of(http)] == ["outlier"]


def test_a_finding_whose_rows_are_withdrawn_one_by_one_disappears(http, rig):
    add(http, rig)
    load(http, with_outliers(rig))
    first, second = findings_of(http)[0]["rows"]
    http.delete(f"{CALL}/{first}")
    assert [finding["rows"] for finding in findings_of(http)] == [[second]]
    http.delete(f"{CALL}/{second}")
    assert findings_of(http) == []
    http.post(f"{CALL}/{first}/restore")
    assert [finding["rows"] for finding in findings_of(http)] == [[first]]


def test_one_call_withdraws_the_rows_that_a_finding_names_and_loses_none(http, rig):
    add(http, rig)
    number = load(http, with_outliers(rig)).json()["import"]
    call, query = f"/v1/components/rig/imports/{number}", {"finding": "outlier"}
    rows = findings_of(http)[0]["rows"]
    reply = http.delete(call, params=query).json()
    assert (reply["rows"], reply["status"]) == (2, "withdrawn")
    assert http.delete(call, params=query).json()["rows"] == 0
    assert findings_of(http) == []
    assert rows_of(http, len(rig.wrench) - 2)
    assert all(http.get(f"{CALL}/{row}").json()["withdrawn"] for row in rows)
    assert http.post(f"{call}/restore", params=query).json()["rows"] == 2
    assert rows_of(http, len(rig.wrench))


def test_a_finding_of_all_rows_withdraws_the_import_and_no_other(http, rig):
    add(http, rig)
    wrong = load(http, rig.measured("all loads with the wrong sign")).json()["import"]
    load(http, rig.measured())
    campaign, result = findings_of(http)  # the second differs from the first
    assert (campaign["cause"], campaign["rows"]) == ("campaign", [])
    assert (result["cause"], result["import"], result["rows"]) == ("sign", wrong, [])
    reply = http.delete(f"/v1/components/rig/imports/{wrong}", params={"finding": "sign"}).json()
    assert reply["rows"] == len(rig.wrench)
    assert [finding["cause"] for finding in findings_of(http)] == ["campaign"]
    assert rows_of(http, len(rig.wrench))


def test_a_restored_import_leaves_a_row_withdrawn_that_was_withdrawn_by_itself(http, rig):
    add(http, rig)
    number = load(http, rig.measured()).json()["import"]
    call = f"/v1/components/rig/imports/{number}"
    single = http.get(CALL).json()["rows"][0]["row"]
    http.delete(f"{CALL}/{single}")
    assert http.delete(call).json()["rows"] == len(rig.wrench) - 1
    assert http.post(f"{call}/restore").json()["rows"] == len(rig.wrench) - 1
    assert http.get(f"{CALL}/{single}").json()["withdrawn"]


@pytest.mark.parametrize("dry_run", ["true", "false"])
def test_a_repeated_import_leaves_a_row_withdrawn_that_was_withdrawn_by_itself(http, rig, dry_run):
    """The same bytes, sent again, brought back the outlier that the caller had removed."""
    add(http, rig)
    load(http, rig.measured())
    single = http.get(CALL).json()["rows"][0]["row"]
    http.delete(f"{CALL}/{single}")
    assert load(http, rig.measured(), dry_run=dry_run).json()["restored"] == 0
    assert http.get(f"{CALL}/{single}").json()["withdrawn"]


def test_an_import_restores_the_rows_that_it_shares_with_a_withdrawn_one(http, rig):
    """A file that was read with a wrong sign and then rightly lost the rows that both have."""
    add(http, rig)
    measured = rig.measured()
    wrong = load(http, measured).json()["import"]
    http.delete(f"/v1/components/rig/imports/{wrong}")
    assert rows_of(http, 0)
    assert load(http, measured, dry_run="true").json()["restored"] == len(rig.wrench)
    assert rows_of(http, 0)
    reply = load(http, measured).json()
    assert (reply["inserted"], reply["restored"]) == (0, len(rig.wrench))
    assert rows_of(http, len(rig.wrench))
    assert load(http, measured).json()["restored"] == 0


@pytest.mark.parametrize("query", [{"finding": "lever"}, {}])
def test_an_unknown_import_or_finding_is_refused_by_name(http, rig, query):
    add(http, rig)
    number = load(http, with_outliers(rig)).json()["import"]
    call = f"/v1/components/rig/imports/{number if query else number + 1}"
    reply = http.delete(call, params=query)
    assert reply.status_code == 404
    assert ("'lever'" if query else str(number + 1)) in reply.json()["detail"]


def test_a_second_import_of_the_same_rows_keeps_the_findings_of_the_first(http, rig):
    add(http, rig)
    rows = with_outliers(rig)
    first = load(http, rows).json()["import"]
    assert load(http, rows).json()["import"] is None
    assert [finding["import"] for finding in findings_of(http)] == [first]


def test_a_second_campaign_that_is_softer_is_said_and_one_that_agrees_is_not(http, rig):
    add(http, rig)
    load(http, rig.measured(), wait_s=60)
    again = rig.measured()
    assert load(http, again, dry_run=True).json()["findings"] == []
    again.displacement[:] *= 1.1
    (result,) = load(http, again, dry_run=True).json()["findings"]
    assert (result["cause"], result["rows"]) == ("campaign", [])
    assert all(abs(item["factor"] - 1.1) < 0.03 for item in result["differ"].values())


BAR_TABLE = "/v1/components/bar/table"
COMPLIANCE = np.diag([1e-7, 1e-7, 1e-8, 1e-6, 1e-6, 1e-6])
COMPLIANCE[1, 5] = COMPLIANCE[5, 1] = 2e-7


@pytest.fixture
def wrench(http):
    """Put one solve with its tangent into the table, and return wrenches of a measurement."""
    workspace = http.app.state.workspace
    component = workspace.library["bar"]
    assert component.linear
    load = 0.5 * component.load_range.scale
    solve = NewRow(load.tolist(), (COMPLIANCE @ load).tolist(), "fea", COMPLIANCE.tolist())
    insert(workspace.ledger, "bar", component.fingerprint, [solve])
    assert workspace.tables.catch_up("bar", 600)
    return np.random.default_rng(5).uniform(-0.8, 0.8, (60, 6)) * component.load_range.scale


def findings(http, wrench, moved, **query):
    content = csv_of(Rows.of(wrench, moved))
    return send(http, content, BAR_TABLE, dry_run=True, **query).json()["findings"]


def test_a_measurement_that_agrees_with_the_solves_has_no_finding(http, wrench):
    assert findings(http, wrench, wrench @ COMPLIANCE.T) == []


def test_millimetres_under_a_header_of_metres_are_named_against_the_solves(http, wrench):
    moved = wrench @ COMPLIANCE.T * np.repeat([1000.0, 1.0], 3)
    (result,) = findings(http, wrench, moved, load_cell="moving")
    assert (result["cause"], result["quantity"]) == ("unit", "translations")


# -- clocks of two logs: a lag is named, and applied only where it is requested ------------------

LAG = 0.35
LOADS = "time [s],Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm]"
MOVED = "time [s],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"


@pytest.fixture
def motion():
    return Rig(5206, ("motion",))


def log_of(header, time, numbers):
    rows = np.column_stack((time, numbers)).tolist()
    return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]).encode()


def logs_of(motion, lag=LAG):
    time = np.arange(len(motion.wrench)) / 40
    rows = motion.measured()
    return {
        "loads": ("loads.csv", log_of(LOADS, time, rows.wrench)),
        "displacements": ("moved.csv", log_of(MOVED, time - lag, rows.displacement)),
    }


def join(http, logs, **query):
    reply = http.post(CALL, files=logs, params=query)
    assert reply.status_code == 200, reply.text
    return reply.json()


def causes(reply):
    return [finding["cause"] for finding in reply["findings"]]


def test_a_clock_shift_in_a_join_is_named_and_nothing_is_applied_silently(http, motion):
    add(http, motion)
    reply = join(http, logs_of(motion), dry_run=True)
    assert causes(reply) == ["clock"]
    assert reply["clock"]["applied_s"] == 0.0
    assert abs(reply["clock"]["lag_s"] - LAG) < 0.01
    assert f"lag={reply['clock']['lag_s']:.4g}" in reply["findings"][0]["message"]


@pytest.mark.parametrize("query", [{"lag": "auto"}, {"time_offset_s": "auto"}, {"lag": LAG}])
def test_a_requested_lag_joins_the_logs_as_they_were_measured(http, motion, query):
    add(http, motion)
    reply = join(http, logs_of(motion), **query)
    assert causes(reply) == []
    assert abs(reply["clock"]["applied_s"] - LAG) < 0.01
    assert reply["inserted"] > 0.9 * len(motion.wrench)


def test_logs_of_one_clock_have_no_finding(http, motion):
    add(http, motion)
    reply = join(http, logs_of(motion, 0.0), dry_run=True)
    assert causes(reply) == []
    assert abs(reply["clock"]["lag_s"]) < 0.01


def test_one_table_has_no_clocks(http, motion):
    add(http, motion)
    body = {"rows": [{"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-6, 0, 0, 0, 0, 0]}]}
    assert http.post(CALL, json=body).json()["clock"] is None


def test_auto_without_a_lag_in_the_logs_is_refused_with_a_remedy(http, motion):
    add(http, motion)
    logs = logs_of(motion)
    time, noise = np.arange(300) / 40, motion.rng.normal(size=(300, 6)) * 1e-3
    logs["displacements"] = ("moved.csv", log_of(MOVED, time, noise))
    reply = http.post(CALL, files=logs, params={"lag": "auto"})
    assert reply.status_code == 422
    assert "lag=auto cannot find the difference" in reply.json()["errors"][0]["message"]


def test_lag_and_offset_are_one_law():
    assert ImportQuery.model_validate({"lag": "0.5"}).options("").time_offset_s == 0.5


def test_a_file_that_is_read_twice_in_two_ways_is_named_with_its_earlier_import(http, rig):
    add(http, rig)
    content, other = csv_of(rig.measured()), {"load_cell": "fixed"}
    first = send(http, content, load_cell="moving").json()["import"]
    assert send(http, content, load_cell="moving").json()["findings"] == []  # the same rows
    for query in ({"dry_run": True}, {}):
        (result,) = send(http, content, **other, **query).json()["findings"]
        assert result["cause"] == "twice"
        assert f"withdraw rig {first}" in result["message"]
    last = http.get("/v1/components/rig/imports").json()["imports"][0]["id"]
    for number in (first, last):
        http.delete(f"/v1/components/rig/imports/{number}")
    assert send(http, content, frame="x=-y,y=x,z=z").json()["findings"] == []
