from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from tests.refusals import assert_told, cases
from tests.service.table_files import read_json

ROW: dict[str, Any] = {"wrench": [1, 2, 3, 4, 5, 6], "displacement": [1e-3] * 6}


def read(*rows: Any, **around: Any):
    return read_json(json.dumps({"rows": list(rows), **around}))


def test_rows_become_si_arrays():
    table = read(
        ROW,
        {**ROW, "uncertainty": [1e-6, None, 0, 0, 0, 0.1], "source": "measured", "note": " rig 2 "},
        units="SI",
    )
    assert table.errors == ()
    assert table.wrench.tolist() == [[1, 2, 3, 4, 5, 6]] * 2
    assert table.displacement.tolist() == [[1e-3] * 6] * 2
    assert np.isnan(table.uncertainty[0]).all()
    assert table.uncertainty[1, 0] == 1e-6
    assert math.isnan(table.uncertainty[1, 1])
    assert (table.source.tolist(), table.note) == (["", "measured"], ("", "rig 2"))
    assert table.seq.tolist() == [1, 2]


@cases(__file__, "json_rows")
def test_each_kind_of_bad_row_is_named_by_its_place_and_key(case):
    good = json.dumps(ROW)
    table = read_json(f'{{"rows": [{good}, {case["row"]}, {good}]}}')
    assert (table.errors[0].row, table.errors[0].field) == (2, case["field"])
    assert {error.row for error in table.errors} == {2}
    assert_told(case, [table.errors[0].message])
    assert table.seq.tolist() == [1, 3]


def no_table(text: str | bytes, field: str) -> str:
    table = read_json(text)
    assert [(error.row, error.field) for error in table.errors] == [(0, field)]
    assert len(table) == 0
    return table.errors[0].message


@cases(__file__, "json_files")
def test_a_file_that_is_no_table_says_so(case):
    assert_told(case, [no_table(case["text"], case["field"])])


@pytest.mark.parametrize("text", [b"\xff\xfe\xff", "[" * 100_000])
def test_a_file_that_no_parser_reads_is_not_json(text: str | bytes):
    assert "is not JSON" in no_table(text, "file")


def test_1e_400_does_not_become_zero():
    text = json.dumps({"rows": [ROW]}).replace("[1, 2", "[1e-400, 0.0e-5")
    (error,) = read_json(text).errors
    assert (error.row, error.field) == (1, "wrench[0]")
    assert "too small a number and would become 0" in error.message


def test_what_an_export_says_about_itself_may_stand_in_an_import():
    assert read(ROW, component="plate", table_version=17, units="SI").errors == ()


def test_a_row_with_two_wrenches_is_refused_rather_than_loaded_with_the_last():
    doubled = '{"wrench": [9, 9, 9, 9, 9, 9], "wrench"'
    text = json.dumps({"rows": [ROW]}).replace('{"wrench"', doubled)
    (error,) = read_json(text).errors
    assert "the key 'wrench' stands twice in one object" in error.message


ROWS = [
    {"Fx [N]": 0, "Fy [N]": 0, "Fz [kN]": -0.5 * k, "Mx [Nm]": 0, "My [Nm]": 0, "Mz [Nm]": 0}
    | {"dx [mm]": 0, "dy [mm]": 0, "dz [mm]": -0.1 * k, "rx [deg]": 0, "ry [deg]": 0}
    | {"rz [deg]": None if k == 2 else 0}
    for k in (1, 2)
]


@pytest.mark.parametrize(
    "text",
    [json.dumps(ROWS), "\n".join(map(json.dumps, ROWS)), json.dumps(ROWS, indent=1) + "\n"],
    ids=["records", "lines", "indented"],
)
def test_records_of_named_columns_are_read_with_their_units(text: str):
    """A list of objects, and an object a line, were refused."""
    table = read_json(text)
    assert table.errors == ()
    np.testing.assert_allclose(table.wrench[:, 2], [-500, -1000])
    np.testing.assert_allclose(table.displacement[:, 2], [-1e-4, -2e-4])
    assert np.isnan(table.displacement[1, 5])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[{"Fx": 1}, {"Fx": 1, "Fq": 2}]', "Fq"),
        ('[{"Fx": {"0": 1}}]', "to_json(orient='records')"),
        ('{"Fx": 1}\n{"Fx": tr', "is not JSON"),
        ('[{"Fx": true}]', "neither a number nor a text"),
    ],
)
def test_records_that_are_no_table_say_why(text: str, says: str):
    table = read_json(text)
    assert not len(table.wrench)
    assert any(says in error.message for error in table.errors)
