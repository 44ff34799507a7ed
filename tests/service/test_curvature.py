"""Third derivatives of a solved row, `curvature`, everywhere the row is kept and sent."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.ledger_rows import NewRow, claim, insert, noted, stored
from tests.service.table_files import read_csv, read_json, write_hdf5, write_json
from tests.service.test_durable_tables import Site
from wrenchbook.service.formats.columns import columns_of, layout
from wrenchbook.service.formats.options import Options
from wrenchbook.service.formats.units import UnitError
from wrenchbook.service.jobs import solver
from wrenchbook.service.jobs.attempt import Attempt, Outcome, prepare, read_outcome, write_outcome
from wrenchbook.service.jobs.dispatcher import record
from wrenchbook.service.ledger import ImportOrigin, Ledger
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.exporting import ExportRequest, FileFormat, export_table
from wrenchbook.service.tables.importing import copy_rows, import_files
from wrenchbook.service.tables.rows import ExportRows
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import DEFAULT, Input, Space, space_of

LEDGER_0_2 = Path(__file__).parent / "earlier" / "ledger-0.2.sql"
THIRDS = tuple(np.random.default_rng(4).normal(size=56) * 1e-12)
ROW = NewRow((1.0, 0, 0, 0, 0, 2), (1e-6,) * 6, "measured", np.eye(6).tolist(), curvature=THIRDS)
RANGE = LoadRange(-10 * np.ones(6), 10 * np.ones(6))
WARM = space_of([""], [Input("temperature", "K", "scalar")])


def outcome_of(thirds):
    tangent = np.eye(6).tolist()
    return {"displacement": [1e-6] * 6, "compliance": tangent, "curvature": thirds}


def component(name, tmp_path, load_range):
    return Component(name, name, tmp_path, "", False, True, load_range, None, False)


def test_an_older_ledger_has_none_and_takes_some(tmp_path):
    path = tmp_path / "ledger.sqlite"
    with sqlite3.connect(path) as old:
        old.executescript(LEDGER_0_2.read_text())
    old.close()
    ledger = Ledger(path)
    insert(ledger, "rig", "", [replace(ROW, wrench=(3.0,) * 6)])
    assert [row.curvature for row in stored(ledger, "rig")] == [None] * 5 + [THIRDS]
    ledger.close()


def test_a_table_has_it_and_its_file_brings_it_into_a_new_ledger(tmp_path):
    site = Site(tmp_path)
    site.open("rig")
    insert(site.ledger, "rig", "", [ROW])
    assert site.tables.catch_up("rig", 600)
    assert site.tables.surrogate("rig").rows.curvature.tolist() == [list(THIRDS)]
    site.close()
    for path in tmp_path.glob("ledger.sqlite*"):
        path.unlink()
    site.open()
    assert site.tables.catch_up("rig", 600)
    (row,) = stored(site.ledger, "rig")
    assert row.curvature == THIRDS
    np.testing.assert_array_equal(row.compliance, ROW.compliance)
    site.close()


@pytest.mark.parametrize("wrong", [THIRDS[:-1], (*THIRDS[:-1], np.inf)])
def test_a_ledger_refuses_another_number_of_entries_and_infinite_ones(ledger, wrong):
    with pytest.raises(ValueError, match="curvature"):
        insert(ledger, "plate", "f1", [replace(ROW, curvature=wrong)])


def test_a_ledger_leaves_out_a_row_in_which_one_bit_of_it_has_flipped(ledger):
    insert(ledger, "plate", "f1", [ROW])
    with sqlite3.connect(ledger.path) as db:
        (raw,) = db.execute("SELECT curvature FROM rows").fetchone()
        db.execute("UPDATE rows SET curvature = ?", (raw[:-1] + bytes([raw[-1] ^ 1]),))
    db.close()
    assert stored(ledger, "plate") == []
    assert ledger.damaged == {1: "plate"}


@pytest.mark.parametrize(
    ("left", "expected"),
    [(np.array(THIRDS), list(THIRDS)), (None, None), (np.full(56, np.nan), None)],
)
def test_a_solver_leaves_it_with_its_outcome_or_null(ledger, tmp_path, left, expected):
    ledger.accept("bar", "f1", ROW.wrench)
    attempt = Attempt.of(claim(ledger, "me"), tmp_path / "a")
    prepare(attempt)
    solver.run_attempt(tmp_path / "a", lambda spec, report: outcome_of(left))
    outcome = read_outcome(attempt)
    assert outcome is not None
    assert outcome.curvature == expected


@pytest.mark.parametrize(("thirds", "status"), [(THIRDS, "done"), (THIRDS[1:], "failed")])
def test_the_outcome_of_a_job_becomes_a_row_with_it(ledger, tmp_path, thirds, status):
    ledger.accept("bar", "f1", ROW.wrench)
    job = claim(ledger, "me")
    attempt = Attempt.of(job, tmp_path / "a")
    prepare(attempt)
    write_outcome(attempt, Outcome("done", **outcome_of(list(thirds))))
    record(ledger, attempt)
    assert ledger.job(job.id).status == status
    assert [row.curvature for row in stored(ledger, "bar")] == [thirds] * (status == "done")


@pytest.mark.parametrize("space", [DEFAULT, WARM], ids=["default", "temperature"])
@pytest.mark.parametrize("form", ["csv", "json", "hdf5", "xlsx", "parquet"])
def test_an_exported_table_is_imported_with_it(ledger, tmp_path, form: FileFormat, space: Space):
    inputs = len(space.inputs)
    own = LoadRange(-10 * np.ones(inputs), 10 * np.ones(inputs), space)
    plate, copy = (component(name, tmp_path, own) for name in ("plate", "copy"))
    thirds = tuple(np.random.default_rng(5).normal(size=space.curvatures) * 1e-12)
    tangent = np.random.default_rng(6).normal(size=(6, inputs)) * 1e-6
    row = replace(ROW, wrench=(1.0,) * inputs, compliance=tangent, curvature=thirds)
    insert(
        ledger,
        "plate",
        "",
        [row, replace(row, wrench=(2.0,) * inputs, curvature=None)],
        space=space,
    )
    export_table(ledger, plate, ExportRequest(form, {}), tmp_path / "table")
    options = Options(load_range=own)
    reply = import_files(ledger, copy, [tmp_path / "table"], options, ImportOrigin())
    assert (reply["errors"], reply["inserted"]) == ([], 2)
    assert [item.curvature for item in stored(ledger, "copy", space=space)] == [thirds, None]


def test_rows_copied_to_another_component_keep_it(ledger, tmp_path):
    plate, copy = (component(name, tmp_path, RANGE) for name in ("plate", "copy"))
    insert(ledger, "plate", "", [ROW])
    copy_rows(ledger, plate, copy, ImportOrigin())
    assert [row.curvature for row in stored(ledger, "copy")] == [THIRDS]


def test_an_export_of_rows_without_it_has_no_place_for_it():
    rows = ExportRows(noted([replace(ROW, curvature=None)]))
    assert rows.curvature.shape == (1, 0)
    assert "curvature" not in write_json(rows)


def test_a_json_table_refuses_another_number_of_entries():
    row = {"wrench": [0] * 6, "displacement": [0] * 6, "curvature": [0.0] * 55}
    (error,) = read_json(json.dumps({"rows": [row]})).errors
    assert error.field == "curvature"
    assert "must be a list of 56 numbers" in error.message


def test_an_hdf5_table_that_holds_half_of_it_is_refused_by_row():
    rows = Rows.of(np.eye(6), np.eye(6), curvature=np.ones((6, 56)))
    rows.curvature[4, 3] = np.nan
    with pytest.raises(ValueError, match="row 5: curvature must be 56 finite numbers"):
        write_hdf5(rows, range(1, 7), TableMeta("plate", 9, RANGE))


def test_a_column_table_with_some_of_it_is_refused():
    header = "fx [N],ux [m],d3e/dfx/dfx/dfx [J/(N*N*N)]"
    (error,) = read_csv(f"{header}\n1,0,1\n", missing_loads="zero").errors
    assert error.field == "d3e/dfx/dfx/dfy"
    assert error.message == "is missing; write all 56 third derivatives or none"


def test_its_columns_are_in_si_whatever_units_an_export_has():
    labels = layout(False, False, (), {"force": "lbf"}, curvature=True).labels()
    assert labels[12] == "d3e/dfx/dfx/dfx [J/(N*N*N)]"
    assert labels[-1] == "d3e/dmz/dmz/dmz [J/(N*m*N*m*N*m)]"


def test_a_column_in_another_unit_says_which_it_is():
    name = "d3e/dfx/dfx/dmz"
    with pytest.raises(UnitError, match=r"write d3e/dfx/dfx/dmz \[J/\(N\*N\*N\*m\)\]"):
        columns_of().factor(name, "mm/(lbf*lbf)")
