"""A test engineer's table, through the simulator's client and a real server."""

import numpy as np
import pytest

from tests.service.table_files import read_csv
from wrenchbook.service.client import ProblemError

HEADER = "Fx [lbf],Fz [lbf],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]"
RIG = {"name": "rig", "title": "Rig", "range": {"force": [900, 900, 900], "moment": [9, 9, 9]}}
LBF, MM = 4.4482216152605, 1e-3


def lines_of(count=500):
    rng = np.random.default_rng(11)
    fx, fz = rng.uniform(-150, 150, (2, count)).round(2)
    columns = [fx, fz, 0.02 * fx, 0 * fx, 0.05 * fz, 0 * fx, 0.001 * fz, 0 * fx]
    rows = np.column_stack([column.round(6) for column in columns])
    return [HEADER, *(",".join(map(repr, row)) for row in rows.tolist())], rows


@pytest.fixture
def client(server):
    client = server.start(solvers=0)
    client.add_component(RIG)
    return client


def test_five_hundred_rows_load_answer_and_come_back(client):
    lines, rows = lines_of()
    assert client.import_table("rig", "\n".join(lines), missing_loads="zero")["inserted"] == 500
    assert client.component("rig")["rows"] == 500  # it waits for the rows that are durable
    middle = client.displacement("rig", [10 * LBF, 0, 20 * LBF], on_thin="estimate")
    assert middle.translation / MM == pytest.approx([0.2, 0.0, 1.0], abs=2e-3)
    units = {"force": "lbf", "translation": "mm", "rotation": "deg"}
    back = read_csv(client.export_table("rig", "csv", units))
    assert not back.errors
    assert np.allclose(back.wrench[:, [0, 2]], rows[:, :2] * LBF, rtol=1e-12)
    assert np.allclose(back.displacement[:, :3], rows[:, 2:5] * MM, rtol=1e-12)


def test_three_bad_rows_are_each_named_and_nothing_is_loaded(client):
    lines, _ = lines_of()
    lines[7] = "1,2,3,4,five,0,0,0"
    lines[100] = "1,inf,3,4,5,0,0,0"
    lines[500] = "1,2,3,4,5,0,45,0"
    with pytest.raises(ProblemError) as refused:
        client.import_table("rig", "\n".join(lines), missing_loads="zero")
    named = [(error["row"], error["field"]) for error in refused.value.errors]
    assert [row for row, _ in named] == [8, 101, 501]
    assert [field for _, field in named[:2]] == ["uz [mm]", "Fz [lbf]"]
    assert all(error["message"] for error in refused.value.errors)
    assert client.component("rig")["rows"] == 0
