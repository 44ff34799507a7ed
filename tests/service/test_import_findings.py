"""Imports name probable systematic errors of a measurement, with the rows of the file."""

import numpy as np
import pytest

from tests.surrogate.findings.rigs import Rig
from wrenchbook.service.formats.findings import FindingsSample
from wrenchbook.service.formats.options import Options
from wrenchbook.service.formats.table_rows import ParsedTable
from wrenchbook.surrogate.findings.find import MOST
from wrenchbook.surrogate.table.rows import unknown_column

CALL = "/v1/components/rig/table"
HEADER = (
    "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"
)


@pytest.fixture
def rig():
    return Rig(7, ("random",))


def csv_of(rows):
    numbers = np.hstack((rows.wrench, rows.displacement))
    return "\n".join([HEADER, *(",".join(map(repr, row)) for row in numbers.tolist())])


def add(http, rig):
    high = rig.high.tolist()
    body = {"name": "rig", "title": "Rig", "range": {"force": high[:3], "moment": high[3:]}}
    assert http.post("/v1/components", json=body).status_code == 201


def load(http, rows, **query):
    return http.post(CALL, content=csv_of(rows), params=query, headers={"content-type": "text/csv"})


def test_a_clean_measurement_loads_without_a_finding(http, rig):
    add(http, rig)
    assert load(http, rig.measured()).json()["findings"] == []


def test_outliers_are_named_by_their_rows_of_the_file(http, rig):
    add(http, rig)
    rows = rig.measured()
    rows.displacement[[11, 80], 2] += [2 * rig.size[2], -rig.size[2]]
    for query in ({"dry_run": True}, {}):
        (found,) = load(http, rows, **query).json()["findings"]
        assert (found["cause"], found["rows"], found["count"]) == ("outlier", [13, 82], 2)


def test_loads_of_the_wrong_sign_are_loaded_and_said(http, rig):
    add(http, rig)
    reply = load(http, rig.measured("all loads with the wrong sign")).json()
    assert [one["cause"] for one in reply["findings"]] == ["sign"]
    assert reply["inserted"] == len(rig.wrench)


def table_of(first, count):
    wrench = np.arange(first, first + count)[:, None] * np.ones(6)
    blank = ("",) * count
    rows = np.arange(first, first + count)
    unknown = unknown_column(count, 6), unknown_column(count, 6, 6)
    return ParsedTable(wrench, wrench, *unknown, blank, blank, blank, rows)


@pytest.mark.parametrize("sizes", [[1] * 200, [7] * 3000, [40_001, 3, 12_345], [2 * MOST + 1] * 9])
def test_of_many_pieces_rows_of_one_distance_are_kept(sizes):
    sample, first = FindingsSample(), 1
    for size in sizes:
        sample.add(table_of(first, size))
        first += size
    rows = np.concatenate([part[2] for part in sample._parts])
    assert len(set(np.diff(rows).tolist())) == 1
    assert rows[0] == 1
    assert len(rows) <= 2 * MOST
    assert len(rows) > MOST / 2 or len(rows) == sum(sizes)
    assert sum(sizes) - rows[-1] < rows[1] - rows[0]


def test_without_a_load_range_there_are_no_findings():
    sample = FindingsSample()
    sample.add(table_of(1, 20))
    assert sample.findings(Options()) == []
