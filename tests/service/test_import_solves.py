"""Imports of a component with solves name units, signs and scales that differ from the solves."""

import numpy as np
import pytest

from tests.service.ledger_rows import NewRow, insert
from tests.service.test_import_findings import csv_of
from wrenchbook.surrogate.table.rows import Rows

CALL = "/v1/components/bar/table"
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
    assert workspace.tables.catch_up("bar", 60)
    return np.random.default_rng(5).uniform(-0.8, 0.8, (60, 6)) * component.load_range.scale


def findings(http, wrench, moved, **query):
    reply = http.post(
        CALL,
        content=csv_of(Rows.of(wrench, moved)),
        params={"dry_run": True, **query},
        headers={"content-type": "text/csv"},
    )
    return reply.json()["findings"]


def test_a_measurement_that_agrees_with_the_solves_has_no_finding(http, wrench):
    assert findings(http, wrench, wrench @ COMPLIANCE.T) == []


def test_forces_of_a_wrong_calibration_are_named_against_the_solves(http, wrench):
    moved = wrench @ COMPLIANCE.T
    wrong = wrench * np.repeat([0.6, 1.0], 3)
    (found,) = findings(http, wrong, moved)
    assert (found["cause"], found["quantity"]) == ("unit", "forces")
    assert found["factor"] == pytest.approx(0.6, rel=0.01)


def test_millimetres_under_a_header_of_metres_are_named_against_the_solves(http, wrench):
    moved = wrench @ COMPLIANCE.T * np.repeat([1000.0, 1.0], 3)
    (found,) = findings(http, wrench, moved, load_cell="moving")
    assert (found["cause"], found["quantity"]) == ("unit", "translations")


def test_a_load_with_the_opposite_sign_of_the_solves_is_named(http, wrench):
    (found,) = findings(http, wrench * [1, -1, 1, 1, 1, 1], wrench @ COMPLIANCE.T)
    assert (found["cause"], found["quantities"]) == ("sign", ["fy"])
