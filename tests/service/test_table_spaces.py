"""Files of rows of several interfaces and further inputs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.ledger_rows import NewRow, insert
from tests.service.table_files import write_hdf5
from wrenchbook.service.formats.columnar import write_parquet
from wrenchbook.service.formats.columns import layout
from wrenchbook.service.formats.csv import csv_text
from wrenchbook.service.formats.json import json_text
from wrenchbook.service.formats.options import Options, ParsedTable
from wrenchbook.service.formats.read import ReadResult, read_untrusted
from wrenchbook.service.formats.xlsx import write_xlsx
from wrenchbook.service.ledger import ImportOrigin, Ledger, NotedRows
from wrenchbook.service.ledger.rows import MAX_CHANGES
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables.exporting import ExportRequest, FileFormat, export_table
from wrenchbook.service.tables.importing import import_files
from wrenchbook.service.tables.rows import ExportRows
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import DEFAULT, Input, Space, space_of

WARM = Input("temperature", "degC", "scalar")
LINK = space_of(["left", "right"], [WARM])
LINK_RANGE = LoadRange(-10 * np.ones(13), np.array([10.0] * 12 + [80.0]), LINK)
DEFAULT_RANGE = LoadRange(-np.ones(6), np.ones(6))
COLUMNS = ("wrench", "displacement", "uncertainty", "compliance")
HANGING = space_of([""], [Input(name, "m/s^2", "scalar") for name in ("ax", "ay", "az")])
HANGING_RANGE = LoadRange(-20 * np.ones(9), 20 * np.ones(9), HANGING)


def table_of(space: Space) -> ParsedTable:
    """Rows with everything a file can have."""
    random = np.random.default_rng(5)
    n, m = len(space.inputs), len(space.outputs)
    moved, tangent = random.uniform(-0.1, 0.1, (3, m)), random.normal(size=(3, m, n))
    moved[1, 4] = moved[2, :3] = tangent[1:] = np.nan
    rows = ParsedTable.of(
        random.uniform(-9, 9, (3, n)),
        moved,
        space,
        uncertainty=np.where(np.isnan(moved), np.nan, 1e-6),
        compliance=tangent,
        source=["rig 1", "rig 1", "rig 2"],
        seq=np.arange(3),
    )
    return replace(rows, note=["", "=1", "cold"])


def read(path: Path, load_range: LoadRange, **options) -> ReadResult:
    return read_untrusted([path], Options(load_range=load_range, **options))


def write(path: Path, kind: str, table: ParsedTable, load_range: LoadRange) -> None:
    space = load_range.space
    columns = layout(True, True, ("source", "note"), space=space)
    names = {"inputs": space.input_names, "outputs": space.output_names}
    if kind == "csv":
        path.write_text("".join(csv_text([table], columns)), encoding="utf-8", newline="")
    elif kind == "json":
        path.write_text("".join(json_text([table], names)), encoding="utf-8")
    elif kind == "records":
        records = [
            {number.label: None if v != v else v for number in columns.numbers
             for v in [float(number.values(table)[at])]} | {"note": table.note[at]}
            for at in range(len(table))
        ]  # fmt: skip
        path.write_text(json.dumps(records), encoding="utf-8")
    elif kind == "hdf5":
        path.write_bytes(write_hdf5(table, range(3), TableMeta("link", 3, load_range)))
    else:
        {"xlsx": write_xlsx, "parquet": write_parquet}[kind](path, [table], columns, {})


@pytest.mark.parametrize("load_range", [LINK_RANGE, HANGING_RANGE], ids=["link", "hanging"])
@pytest.mark.parametrize("kind", ["csv", "json", "records", "hdf5", "xlsx", "parquet"])
def test_an_export_of_any_space_is_read_back_to_the_same_floats(
    tmp_path, kind: str, load_range: LoadRange
):
    table = table_of(load_range.space)
    write(tmp_path / "table", kind, table, load_range)
    result = read(tmp_path / "table", load_range)
    assert result.report["errors"] == []
    assert result.report["findings"] == []
    (again,) = result.pieces()
    for name in ("wrench", "displacement", "uncertainty", "compliance"):
        assert np.array_equal(getattr(again, name), getattr(table, name), equal_nan=True), name
    assert again.note == table.note


def test_two_logs_of_a_link_are_joined_by_their_time(tmp_path):
    for name, text in {
        "loads": "time [s],left.fx [N],temperature [K]\n0,1,293.15\n1,3,295.15\n",
        "moved": "time [s],right.ux [mm]\n0.5,1\n",
    }.items():
        (tmp_path / name).write_text(text)
    options = Options(load_range=LINK_RANGE, missing_loads="zero")
    result = read_untrusted([tmp_path / "loads", tmp_path / "moved"], options)
    assert result.report["errors"] == []
    (piece,) = result.pieces()
    assert piece.wrench[0, [0, 12]].tolist() == [2.0, 21.0]


@pytest.mark.parametrize("kind", ["json", "hdf5"])
def test_a_table_of_another_space_is_refused_with_both(tmp_path, kind: str):
    other = LoadRange(-np.ones(13), np.ones(13), space_of(["base", "tip"], [WARM]))
    write(tmp_path / "table", kind, table_of(other.space), other)
    result = read(tmp_path / "table", LINK_RANGE)
    assert result.report["is_ruined"]
    assert "left.fx" in result.report["errors"][0]["message"]


def test_the_columns_of_one_interface_are_those_of_before():
    labels = layout(True, True, (), space=DEFAULT).labels()
    assert labels == layout(True, True, ()).labels()
    assert labels[:2] + labels[-1:] == ["fx [N]", "fy [N]", "drz/dmz [rad/(N*m)]"]
    assert len(labels) == 54


FORMATS: list[FileFormat] = ["csv", "json", "hdf5", "xlsx", "parquet"]


@pytest.mark.parametrize("form", FORMATS)
def test_an_exported_table_of_a_link_is_imported_to_the_same_rows(tmp_path, form: FileFormat):
    link, copy = (
        Component(name, name, tmp_path, "", False, True, LINK_RANGE, None, False)
        for name in ("link", "copy")
    )
    ledger = Ledger(tmp_path / "ledger.sqlite")
    columns = [getattr(table_of(LINK), name) for name in COLUMNS]
    more = dict(zip(COLUMNS[2:], columns[2:], strict=True))
    rows = Rows.of(columns[0], columns[1], LINK, source=["rig"] * 3, **more)
    ledger.import_rows("link", [NotedRows(rows, ["", "a", ""])], ImportOrigin())
    export_table(ledger, link, ExportRequest(form, {}), tmp_path / "table")
    options = Options(load_range=DEFAULT_RANGE)
    reply = import_files(ledger, copy, [tmp_path / "table"], options, ImportOrigin())
    assert (reply["errors"], reply["inserted"]) == ([], 3)
    with ledger.table_at("copy", space=LINK) as table:
        (lot,) = table.lots
        again = ExportRows(lot)
    for name in COLUMNS:
        assert np.array_equal(getattr(again, name), getattr(rows, name), equal_nan=True), name
    ledger.close()


RANGE = [[-10.0, 10.0]] * 3


def test_an_export_holds_all_rows_of_a_table_larger_than_one_part_of_the_news(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    library = Library(tmp_path / "components", tmp_path / "none")
    library.add_table_only(name="rig", title="rig", range={"force": RANGE, "moment": RANGE})
    count = MAX_CHANGES + 2
    rows = (NewRow((load / count, 0, 0, 0, 0, 0), (load,) * 6) for load in range(count))
    insert(ledger, "rig", "", rows)
    path = tmp_path / "rig.csv"
    version = export_table(ledger, library["rig"], ExportRequest("csv", {}), path)
    assert len(path.read_text().splitlines()) == 1 + count
    assert version == ledger.last_seq("rig")
    ledger.close()
