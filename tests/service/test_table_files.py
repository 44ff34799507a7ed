"""Table files of all formats: dialects, what is refused, what is hostile."""

import datetime
import gzip
import io
import json
import math
import struct
import tomllib
import zipfile
from dataclasses import replace
from decimal import Decimal
from functools import partial
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as arrow
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow.parquet import write_table

from tests.refusals import assert_told, cases
from tests.service import table_files
from tests.service.table_files import (
    ZERO,
    read,
    read_json,
    write_csv,
    write_hdf5,
    write_json,
    written,
)
from wrenchbook.service.formats import csv as csv_table
from wrenchbook.service.formats import options as table_options
from wrenchbook.service.formats import xlsx as xlsx_table
from wrenchbook.service.formats.columnar import write_parquet
from wrenchbook.service.formats.columns import columns_of
from wrenchbook.service.formats.options import Options
from wrenchbook.service.formats.read import ContentError, unpack
from wrenchbook.service.formats.text import MAX_NAME
from wrenchbook.service.formats.units import (
    FORCE,
    MOMENT,
    ROTATION,
    TRANSLATION,
    UnitError,
    chosen_units,
    si_factor,
)
from wrenchbook.service.formats.xlsx import SheetFullError, entry_sizes, write_xlsx
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange
from wrenchbook.surrogate.table.space import Input, space_of

read_csv = partial(table_files.read_csv, missing_loads="zero")
HEADER = "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],uz [m]"
WARM = [Input("temperature", "degC", "scalar")]
KELVIN = space_of(scalars=[Input("temperature", "K", "scalar")])
HANGING = space_of([""], [Input(name, "m/s^2", "scalar") for name in ("ax", "ay", "az")])
RANGES = {
    "": None,
    "rig": LoadRange(np.array([-900, 0, -50, -90, 0, 0.0]), np.array([900, 0, 10, 90, 0, 0.0])),
    "none": LoadRange(np.zeros(6), np.zeros(6)),
    "kelvin": LoadRange(-np.ones(7), np.array([1.0] * 6 + [400.0]), KELVIN),
    "hanging": LoadRange(-20 * np.ones(9), 20 * np.ones(9), HANGING),
    "link": LoadRange(
        -10 * np.ones(13), np.array([10.0] * 12 + [80.0]), space_of(["left", "right"], WARM)
    ),
}
DIALECTS = tomllib.loads(Path(__file__).with_name("dialects.toml").read_text(encoding="utf-8"))


def options_of(case):
    chosen = {"missing_loads": "zero", **case.get("options", {})}
    chosen["missing_loads"] = chosen["missing_loads"] or None
    return Options(**chosen, load_range=RANGES[case.get("range", "")])


def column(table, name, space):
    """A column of a table by its name, SI."""
    if name in space.input_names:
        return table.wrench[:, space.input_names.index(name)]
    values = table.uncertainty if name.endswith("_err") else table.displacement
    return values[:, space.output_names.index(name.removesuffix("_err"))]


@pytest.mark.parametrize("case", DIALECTS.values(), ids=DIALECTS.keys())
def test_a_dialect_is_read_as_its_rows_and_mistakes(case):
    options = options_of(case)
    for encoding in case.get("encodings", ["utf-8"]):
        table, report = read(case["text"].encode(encoding), options)
        errors = report.mistakes.listed()
        if "says" in case:
            assert any(case["says"] in error.message for error in errors), errors
        else:
            expected = case.get("errors", [])
            assert [(error.row, error.field) for error in errors] == [
                (e[0], e[1]) for e in expected
            ]
            for error, (_, _, *texts) in zip(errors, expected, strict=True):
                assert all(word in error.message for word in texts), error.message
        for name, values in case.get("columns", {}).items():
            result = column(table, name, options.space)
            np.testing.assert_allclose(result, values, rtol=1e-15, atol=0, err_msg=name)
        assert case.get("titles", report.titles) == report.titles
        for name in ("source", "note", "seq"):
            if name in case:
                assert list(getattr(table, name)) == case[name]
        if "rows" in case:
            assert len(table) == case["rows"]


# -- refusals, each with its place and words -----------------------------------------------------


@cases(__file__, "csv")
def test_a_mistake_says_where_it_is_and_what_to_write(case):
    table = read_csv(case["text"], **case.get("options", {}))
    (error,) = table.errors
    assert [error.row, error.field] == case["at"]
    assert len(table) == case.get("kept", 0)
    assert_told(case, [error.message])


@cases(__file__, "json_rows")
def test_each_kind_of_bad_json_row_is_named_by_its_place_and_key(case):
    good = json.dumps({"wrench": [1, 2, 3, 4, 5, 6], "displacement": [1e-3] * 6})
    table = read_json(f'{{"rows": [{good}, {case["row"]}, {good}]}}')
    assert (table.errors[0].row, table.errors[0].field) == (2, case["field"])
    assert {error.row for error in table.errors} == {2}
    assert_told(case, [table.errors[0].message])
    assert table.seq.tolist() == [1, 3]


@cases(__file__, "json_files")
def test_a_json_file_that_is_no_table_says_so(case):
    table = read_json(case["text"])
    assert [(error.row, error.field) for error in table.errors] == [(0, case["field"])]
    assert len(table) == 0
    assert_told(case, [table.errors[0].message])


def test_three_bad_rows_among_500_are_each_named_by_row_field_and_reason():
    lines = ["fz [lbf],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]"]
    lines += [f"{-n},0,0,{-n / 100},0,0,0" for n in range(500)]
    lines[100] = "-99,0,0,abc,0,0,0"
    lines[200] = "-199,0,0,nan,0,0,0"
    lines[300] = "-299,0,0,-2.99,0,30,0"
    table = read_csv("\n".join(lines))
    cure = "correct it or leave the row out"
    far = "the rotation is 30 degrees, but a table ends at 20; check the unit (rad or deg)"
    assert [error.as_dict() for error in table.errors] == [
        {"row": 101, "field": "uz [mm]", "message": f"'abc' is not a number; {cure}"},
        {"row": 201, "field": "uz [mm]", "message": f"'nan' is not a finite number; {cure}"},
        {"row": 301, "field": "ry [deg]", "message": far},
    ]
    assert len(table) == 497
    assert not {101, 201, 301} & set(table.seq.tolist())


def test_many_mistakes_of_one_cause_are_one_cause_with_its_count_and_a_list_that_ends():
    lines = "".join(f"{k},x{k}\n" for k in range(295))
    first, second = read(f"Fz [N],uz [mm]\n{lines}5,\n".encode())[1].mistakes.causes()
    assert (first["field"], first["count"]) == ("uz [mm]", 295)
    assert first["rows"] == list(range(2, 12))
    assert "'x0' is not a number; correct it or leave the row out" in first["message"]
    assert (second["count"], second["rows"]) == (1, [297])
    (cause,) = read(b"Sample,Fz [N],uz [mm],Temp (F)\n1,2,3,4\n")[1].mistakes.causes()
    assert (cause["fields"], cause["count"]) == (["Sample", "Temp (F)"], 2)
    table = read_csv(HEADER + "\n" + "a,b,c,d,e,f,g\n" * 1000)
    assert len(table.errors) == 1001
    assert table.errors[-1].message == "6000 more errors are not listed; correct these first"


def test_a_log_of_loads_alone_is_refused_with_the_way_to_send_its_displacements():
    log = (Path(__file__).parents[2] / "data/tables/ati_loads.csv").read_text()
    (error,) = read_csv(log).errors
    assert "no displacement column" in error.message
    assert "displacements=FILE" in error.message


def test_a_row_has_all_36_tangents_or_none():
    names = [
        f"{name} [{'m' if name[1] == 'u' else 'rad'}/{'N' if '/df' in name else '(N*m)'}]"
        for name in columns_of().compliance
    ]
    header = "fx [N],ux [m]," + ",".join(names)
    tangents = ",".join(str(number) for number in range(36))
    table = read_csv(f"{header}\n1,0,{tangents}\n1,0{',' * 36}\n")
    assert table.errors == ()
    assert table.compliance[0].ravel().tolist() == list(range(36))
    assert np.isnan(table.compliance[1]).all()
    (error,) = read_csv(f"{header}\n1,0,{tangents[:-2]}\n").errors
    assert (error.row, error.field) == (2, "drz/dmz")


# -- reading in blocks ---------------------------------------------------------------------------

WRITTEN = ["1", "-2.5", "+3", ".5", "2.", "1e3", "7E+2", "1e-400", "1e-99", "-0", "0", "", " 4 "]
WRITTEN += ["nan", "inf", "-Infinity", "1e999", "1_0", "0x1", "1.5.2", "12 N", "#N/A", " ", "1"]
LINES = st.lists(st.sampled_from(WRITTEN), min_size=3, max_size=3).map(",".join)
OTHERS = st.sampled_from(["", "# a", ",,", "1,2", "1,2,3,4", '1,2,"a b"', "1,2,a\r", "=1,2,x"])


@settings(max_examples=60)
@given(st.lists(st.one_of(LINES, OTHERS), min_size=1, max_size=6), st.sampled_from(["\n", "\r\n"]))
def test_rows_read_in_blocks_are_those_read_line_by_line(lines: list[str], end: str):
    text = end.join(["fx [N],ux [mm],note", "1,2,", *lines])
    table = read_csv(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_table._Body, "_by_arrow", lambda *_: None)
        line_by_line = read_csv(text)
    assert table.errors == line_by_line.errors
    for name in ("wrench", "displacement", "seq"):
        np.testing.assert_array_equal(getattr(table, name), getattr(line_by_line, name))
    assert table.note == line_by_line.note


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_quoted_fields_of_one_line_are_read_in_blocks_too(monkeypatch, delimiter: str):
    lines = ["fx [N]~ux [mm]~note", '1~"2"~"a, b; c|d"', '"3"~4~""', '5~6~"# c"', ""]
    content = "\n".join(lines).replace("~", delimiter)
    line_by_line = read_csv(content + '7~8~"a ""b"""\n'.replace("~", delimiter), decimal=".")
    assert line_by_line.note[3] == 'a "b"'
    monkeypatch.setattr(csv_table, "text_pieces", None)
    table = read_csv(content, decimal=".")
    assert table.errors == line_by_line.errors == ()
    assert table.wrench[:, 0].tolist() == line_by_line.wrench[:3, 0].tolist() == [1, 3, 5]
    assert table.note == line_by_line.note[:3] == ("a, b; c|d", "", "# c")


def test_a_file_of_plain_rows_is_read_in_blocks_alone(monkeypatch):
    monkeypatch.setattr(csv_table, "text_pieces", None)
    monkeypatch.setattr(csv_table, "_BLOCK", 40)
    text = "fx [N];ux [mm];note\n" + "".join(f"{k},5;-{k}e-1;row {k}\n" for k in range(20))
    table = read_csv(text, decimal=",")
    assert table.errors == ()
    assert table.wrench[:, 0].tolist() == [k + 0.5 for k in range(20)]
    assert table.seq.tolist() == list(range(2, 22))
    assert table.note[19] == "row 19"


# -- workbooks and data frames -------------------------------------------------------------------


def workbook(*sheets: list[list[object]], merged: tuple[str, ...] = (), title: str = "") -> bytes:
    book, content = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.worksheets[0])
    for rows in sheets:
        sheet = book.create_sheet(title or None)
        for row in rows:
            sheet.append(row)
        for cells in merged:
            sheet.merge_cells(cells)
    book.save(content)
    return content.getvalue()


def frame(table: arrow.Table | dict) -> bytes:
    content = io.BytesIO()
    write_table(arrow.table(table) if isinstance(table, dict) else table, content)
    return content.getvalue()


def errors(content: bytes, options: Options = ZERO) -> list[tuple[int, str, str]]:
    _, report = read(content, options)
    return [(error.row, error.field, error.message) for error in report.mistakes.listed()]


def error_of(content: bytes, options: Options = ZERO) -> str:
    table, report = read(content, options)
    assert len(table) == 0
    (error,) = report.mistakes.listed()
    return error.message


def test_a_nested_column_of_parquet_is_named():
    file = io.BytesIO()
    columns = {"fz [N]": [1.0], "ux [mm]": [1.0], "samples": [[1.0, 2.0]]}
    write_table(arrow.table(columns), file)
    assert "the column 'samples' holds list<" in error_of(file.getvalue())


def test_a_spreadsheet_s_own_numbers_and_empty_cells_are_read_from_the_first_sheet_with_rows():
    rows = [["Fz", "uz", "note", None], ["N", "mm"], [100, 0.25, "a"], [], [200, None, "b"]]
    table, report = read(workbook([], [*rows, [300, 0.75]]))
    assert table.wrench[:, 2].tolist() == [100, 300]
    assert table.displacement[:, 2].tolist() == [0.00025, 0.00075]
    assert [(error.row, error.field) for error in report.mistakes.listed()] == [(5, "uz")]
    assert report.read == 3


def test_a_sheet_of_a_title_is_not_read_if_another_has_a_table():
    title, rows = [["Report 17"], ["Customer"]], [["fz [N]", "uz [mm]"], [100, 0.25]]
    table, report = read(workbook(title, rows))
    assert (table.wrench[:, 2].tolist(), report.sheet) == ([100], report.sheets[1])
    numbers = replace(ZERO, mapping={"1": "fz [N]", "2": "uz [mm]"})
    table, report = read(workbook(title, rows[1:]), numbers)
    assert (table.wrench[:, 2].tolist(), report.sheet) == ([100], report.sheets[1])


def test_an_example_of_a_meaning_has_the_direction_of_its_label():
    *_, last = errors(b"fx [N],ux [mm],Bogen y [mm]\n1,2,3\n")[0]
    assert "--column 'Bogen y=uy [mm]'" in last


def test_a_time_of_day_in_a_workbook_is_a_time_and_in_a_load_a_mistake_of_its_row():
    """The whole file was no readable workbook."""
    clock = datetime.time(1, 2, 3)
    rows = [["time", "fx [N]"], [clock, 1.0], [datetime.time(1, 2, 4), 2.0]]
    table, report = read(workbook(rows), Options(missing_loads="zero", role="loads"))
    assert not report.mistakes
    assert np.diff(table.time).tolist() == [1.0]
    (error,) = errors(workbook([["fx [N]", "ux [mm]"], [clock, 1.0], [1.0, 1.0]]))
    assert error == (2, "fx [N]", "'01:02:03' is not a number; correct it or leave the row out")


def test_a_merged_title_above_the_header_is_a_title_and_a_merged_value_is_empty():
    rows = [["Loads", None, "Displacements"], ["fx [N]", "fy [N]", "ux [mm]"]]
    content = workbook([*rows, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], merged=("A1:B1", "A3:A4"))
    table, report = read(content)
    assert report.titles == ["Loads Displacements"]
    assert table.seq.tolist() == [3]
    ((row, field, message),) = errors(content)
    assert (row, field) == (4, "fx [N]")
    assert "split merged cells" in message


def test_a_formula_without_a_stored_value_is_named_by_its_sheet_and_cell():
    rows = [["fz [N]", "uz [m]"], [1, 1e-6], [2, "=B2*2"]]
    ((row, field, message),) = errors(workbook(rows, title="Run 3"))
    assert (row, field) == (3, "uz [m]")
    assert "the formula in Run 3!B3 has no stored value" in message


def as_sheet(rows: list[dict[str, object]]) -> bytes:
    return workbook([[*rows[0]], *([*row.values()] for row in rows)])


def as_frame(rows: list[dict[str, object]]) -> bytes:
    columns = {name: [str(row[name]) for row in rows] for name in ("Fz [N]", "note")}
    return frame({**columns, "uz [mm]": [row["uz [mm]"] for row in rows]})


def as_records(rows: list[dict[str, object]]) -> bytes:
    return json.dumps(rows).encode()


def loads_of(*texts: object) -> list[dict[str, object]]:
    return [{"Fz [N]": text, "uz [mm]": 1.25, "note": "1,5"} for text in texts]


@pytest.mark.parametrize("form", [as_sheet, as_records, as_frame])
def test_texts_of_numbers_follow_one_law_of_marks_in_every_format(form):
    for texts, decimal, loads in [
        (["915,01", "15,009"], None, [915.01, 15.009]),
        (["915.01", "1,354.5", "15.009"], None, [915.01, 1354.5, 15.009]),
        (["15,009"], ",", [15.009]),
        (["15,009"], ".", [15009.0]),
    ]:
        table, report = read(form(loads_of(*texts)), replace(ZERO, decimal=decimal))
        assert not report.mistakes
        assert table.wrench[:, 2].tolist() == loads
        assert table.displacement[:, 2].tolist() == [0.00125] * len(loads)
    assert "set decimal=, (--decimal ,) for 15.009" in error_of(form(loads_of("15,009")))
    if form is not as_frame:  # whose columns have one type
        table, _ = read(form(loads_of(1354.5, "915,01", 15.009)))
        assert table.wrench[:, 2].tolist() == [1354.5, 915.01, 15.009]


def test_a_data_frame_s_units_are_read_from_its_metadata():
    fields = [
        arrow.field("Fz", arrow.float32(), metadata={"unit": "kN"}),
        arrow.field("uz", arrow.float64(), metadata={"units": "um"}),
        arrow.field("__index_level_0__", arrow.int64()),
    ]
    columns = [arrow.array([1.5], arrow.float32()), arrow.array([2.5]), arrow.array([7])]
    table, report = read(frame(arrow.Table.from_arrays(columns, schema=arrow.schema(fields))))
    assert (table.wrench[0, 2], table.displacement[0, 2]) == (1500.0, 2.5e-6)
    assert report.ignored == ["__index_level_0__"]


def test_an_infinite_number_of_a_data_frame_has_one_mistake():
    options = replace(ZERO, load_range=LoadRange(np.full(6, -10.0), np.full(6, 10.0)))
    (error,) = errors(frame({"fx [N]": [np.inf, 1.0], "ux [mm]": [1.0, 1.0]}), options)
    assert error == (1, "fx [N]", "'inf' is not a finite number; correct it or leave the row out")


# -- what is hostile -----------------------------------------------------------------------------

_ROWS = read_csv(f"{HEADER},note\n0,0,1,0,0,0,0,a\n0,0,2,0,0,0,0,b\n")
BOOK, FRAME = written(write_xlsx, _ROWS), written(write_parquet, _ROWS)


def test_a_text_longer_than_a_cell_of_a_sheet_is_refused_not_written_for_excel_to_cut():
    rows = read_csv(f"{HEADER},note\n0,0,1,0,0,0,0,{'a' * 32_768}\n")
    with pytest.raises(SheetFullError, match="32,768 characters, more than 32,767"):
        written(write_xlsx, rows)


def zipped(**members: bytes) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return content.getvalue()


def sheet_xml(rows: str) -> bytes:
    """A workbook whose one sheet has these rows."""
    with zipfile.ZipFile(io.BytesIO(workbook([]))) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    sheet = f'<worksheet xmlns="{space}"><sheetData>{rows}</sheetData></worksheet>'
    return zipped(**{**members, "xl/worksheets/sheet1.xml": sheet.encode()})


PACKED = gzip.compress(f"{HEADER}\n".encode() * 2000)
NAMES = ",".join(f"c{n}" for n in range(100_000))
HOSTILE = {
    "gzip in gzip": (gzip.compress(PACKED), "gzipped twice"),
    "a cut gzip": (PACKED[:-9], "damaged gzip"),
    "a zip of something": (zipped(a=b"x"), "zip file, not an XLSX"),
    "a line of a megabyte": (f"{HEADER}\n".encode() + b"1," * (1 << 20), "longer than"),
    "a record without end": (
        f"{HEADER},note\n".encode() + b'0,0,1,0,0,0,0,"' + b'a\n","' * (1 << 20),
        "a record longer than",
    ),
    "a field without end": (f'{HEADER},note\n0,0,1,0,0,0,0,"{"x" * 200_000}\n'.encode(), "as CSV"),
    "json nested deeply": (b'{"rows": [' + b"[" * 100_000, "nested too deeply"),
    "a list nested deeply": (b"[" * 100_000, "nested too deeply"),
    "a long value": (b'{"rows": [{"note": "' + b"x" * (3 << 20), "is not JSON"),
    "100,000 columns": (f"{HEADER},{NAMES}\n".encode(), "at most 256"),
    "100,000 columns by ;": (f"{HEADER},{NAMES}\n".replace(",", ";").encode(), "at most 256"),
    "a cell far right": (sheet_xml('<row r="1"><c r="XFD1"><v>1</v></c></row>'), "over 256"),
    "a cell far down": (
        sheet_xml('<row r="1048576"><c r="A1048576"><v>1</v></c></row>'),
        "there is no header",
    ),
    "half a number": (sheet_xml('<row r="1"><c r="A1"><v>1e</v></c></row>'), "no readable XLSX"),
    "a row x": (sheet_xml('<row r="x"><c r="A1"><v>1</v></c></row>'), "no readable XLSX"),
    "cut XML": (sheet_xml("<row><c"), "no readable XLSX"),
    "no row": (sheet_xml(""), "the file is empty"),
}


@pytest.mark.parametrize(("content", "says"), HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_file_is_an_error_and_not_a_crash(content, says):
    assert says in error_of(content)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_is_not_reported_as_a_damaged_gzip_file(tmp_path):
    """The remedy was to send the file again."""
    file = tmp_path / "table.csv.gz"
    file.write_bytes(PACKED)
    with pytest.raises(OSError, match="No space left on device"):
        unpack(file, Path("/dev/full"))


def test_a_gzip_bomb_is_unpacked_no_further_than_may_be(tmp_path):
    bomb, target = tmp_path / "bomb", tmp_path / "plain"
    bomb.write_bytes(gzip.compress(bytes(64 << 20)))
    with pytest.raises(ContentError, match="unpacks to more than 1 MiB"):
        unpack(bomb, target, max_bytes=1 << 20)
    assert target.stat().st_size <= 1 << 20


def test_a_zip_bomb_or_a_zip_that_lies_about_its_sizes_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.xlsx"
    path.write_bytes(zipped(a=bytes(32 << 20)))
    with pytest.raises(ContentError, match="unpacks to more than 1 MiB"):
        entry_sizes(path, 1 << 20)
    content = bytearray(zipped(a=bytes(4 << 20)))
    directory = content.rindex(b"PK\x01\x02")
    content[directory + 24 : directory + 28] = struct.pack("<I", 100)
    path.write_bytes(bytes(content))
    with pytest.raises(ContentError):
        entry_sizes(path, 1 << 20)


def test_half_a_character_in_a_sheet_is_refused():
    cells = "".join(f'<c t="str"><v>{text}</v></c>' for text in ("fx [N]", "uz [m]", "note"))
    row = '<c><v>1</v></c><c><v>0</v></c><c t="str"><v>_xD800_</v></c>'
    content = sheet_xml(f"<row>{cells}</row><row>{row}</row>")
    assert len(read(content)[0]) == 0
    assert [error[:2] for error in errors(content)] == [(2, "note")]


@settings(max_examples=100)
@given(st.binary(max_size=200), st.sampled_from(["", "xlsx", "parquet", "hdf5", "gzip", "json"]))
def test_no_bytes_make_reading_crash(content: bytes, like: str):
    magic = {
        "xlsx": b"PK\x03\x04",
        "parquet": b"PAR1",
        "hdf5": b"\x89HDF\r\n\x1a\n",
        "gzip": b"\x1f\x8b\x08",
        "json": b'{"rows":[',
    }
    table, report = read(magic.get(like, b"") + content)
    assert len(table) == 0
    assert report.mistakes


@settings(max_examples=40)
@given(st.data())
def test_no_flipped_byte_of_a_workbook_or_a_frame_makes_reading_crash(data):
    content = bytearray(data.draw(st.sampled_from([BOOK, FRAME])))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    table, _ = read(bytes(content))
    assert np.isfinite(table.wrench).all()


NOTED = "fx [N];ux [m];uy [m];uz [m];rx [rad];ry [rad];rz [rad];ux_err [m];note\n"
cells = st.one_of(st.text(max_size=4), st.sampled_from(["1,5", "-2", "1e400", "nan", '"', "#N/A"]))


@given(st.lists(st.lists(cells, max_size=10).map(";".join)).map("\n".join), st.booleans())
def test_no_text_below_a_header_makes_reading_crash(body: str, with_header: bool):
    table = read_csv(NOTED + body if with_header else body)
    assert len(table) or table.errors
    assert np.isfinite(table.wrench).all()
    assert np.isfinite(table.displacement).all()
    assert len(table.source) == len(table.note) == len(table.seq) == len(table)


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=6),
        st.dictionaries(st.sampled_from(["rows", "wrench", "displacement", "note"]), inner),
    ),
    max_leaves=20,
)


@given(json_values, st.booleans())
def test_no_json_makes_reading_crash(value, as_rows: bool):
    table = read_json(json.dumps({"rows": [value]} if as_rows else value))
    assert len(table) or table.errors


def test_8_kilobytes_of_gzipped_empty_rows_do_not_keep_a_reader_busy():
    content = gzip.compress(b'{"rows":[' + b"{}," * 3_000_000 + b"{}]}")
    assert len(content) < 9000
    table, report = read(content)
    assert len(table) == 0
    assert report.mistakes.is_ruined  # nothing is loaded with partial=true either
    assert report.read < 60_000
    assert "reading stopped after more than 100,000" in report.mistakes.listed()[-1].message


@pytest.mark.parametrize("form", ["csv", "json", "hdf5"])
def test_a_file_of_more_rows_than_may_be_is_read_no_further(form, monkeypatch):
    monkeypatch.setattr(table_options, "MAX_ROWS", 1)
    content = {
        "csv": write_csv(_ROWS).encode(),
        "json": write_json(_ROWS).encode(),
        "hdf5": write_hdf5(_ROWS, [1, 2], TableMeta("rig", 2, LoadRange(-np.ones(6), np.ones(6)))),
    }[form]
    _, report = read(content)
    assert report.mistakes.is_ruined
    assert "has more than 1 rows" in report.mistakes.listed()[0].message


def test_a_label_of_100_000_letters_neither_keeps_a_reader_busy_nor_comes_back_whole():
    for between in ("_a", "_", "x"):
        label = "fx" + between * (100_000 // len(between))
        table, report = read(f"{label},{HEADER}\n{'a,' * 7}a\n".encode())
        assert len(table) == 0
        assert all(len(mistake.field) <= 200 for mistake in report.mistakes.listed())


def test_a_sheet_of_more_rows_than_a_sheet_can_have_is_refused(monkeypatch):
    monkeypatch.setattr(xlsx_table, "MAX_SHEET_ROWS", 10)
    assert "the sheet Sheet has over 11 rows" in error_of(sheet_xml("<row/>" * 12))


@pytest.mark.parametrize("begin", ["", f"{HEADER}\n"])
def test_a_file_of_empty_lines_is_refused_as_soon_as_there_are_too_many(begin, monkeypatch):
    monkeypatch.setattr(csv_table, "MAX_BLANK", 1000)
    for line in ("\n", "#\n", ",,\n"):
        results = errors((begin + 2000 * line).encode())
        assert any("1,000 lines without a row" in message for *_, message in results)


def test_one_long_source_does_not_take_the_memory_of_all_rows():
    """20,000 rows with one source of 100,000 characters took 8 GB, in the server too."""
    lines = ["fx [N],ux [mm],source", *["1,2,a"] * 20_000, f"1,2,{'s' * 100_000}", ""]
    table, report = read("\n".join(lines).encode())
    (error,) = report.mistakes.listed()
    assert (error.row, error.field) == (20_002, "source")
    assert f"is longer than {MAX_NAME:,} characters" in error.message
    assert len(table) == 20_000
    assert table.source.dtype.itemsize == 4


def test_a_sheet_that_is_not_there_is_answered_with_the_names_of_the_others():
    message = error_of(BOOK, replace(ZERO, sheet="Run 9"))
    assert message.startswith("there is no sheet 'Run 9'; choose table")


# -- units ---------------------------------------------------------------------------------------

POUND = 0.45359237 * 9.80665  # N, exact by definition
PRODUCTS = ["Nm", "N m", "N*m", "N·m", "N⋅m", "N-m", "N.m", "N × m", "m·N", "m N"]
UNITS = {
    FORCE: {
        "N": 1.0,
        "newton": 1.0,
        "kN": 1e3,
        "daN": 10.0,
        "kgf": 9.80665,
        "lbf": POUND,
        "kip": 1000 * POUND,
    },
    # Micro sign and Greek mu.
    TRANSLATION: {"mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "in": 0.0254, "thou": 0.0254e-3},
    ROTATION: {"rad": 1.0, "mrad": 1e-3, "arcmin": math.pi / 180 / 60}
    | dict.fromkeys(("deg", "°"), math.pi / 180),
    # Pint alone takes Nm for a textile count and N-m for a subtraction.
    MOMENT: dict.fromkeys(PRODUCTS, 1.0)
    | {"kNm": 1e3, "Nmm": 1e-3, "mNm": 1e-3, "N-mm": 1e-3, "kN·mm": 1.0, "Ncm": 1e-2}
    | dict.fromkeys(("lbf*in", "in-lbf"), POUND * 0.0254)
    | dict.fromkeys(("ft lbf", "lbf·ft"), POUND * 0.3048),
}


@pytest.mark.parametrize(
    ("quantity", "unit"), [(quantity, unit) for quantity in UNITS for unit in UNITS[quantity]]
)
def test_units_of_test_benches_have_their_value(quantity, unit):
    factor = float(si_factor(unit, quantity))
    assert factor == pytest.approx(UNITS[quantity][unit], rel=1e-15)


@cases(__file__, "units")
def test_a_unit_that_does_not_fit_says_what_to_write(case):
    quantity = {quantity.name: quantity for quantity in UNITS}[case["quantity"]]
    with pytest.raises(UnitError) as caught:
        si_factor(case["unit"], quantity)
    assert_told(case, [str(caught.value)])
    assert len(str(caught.value)) < 200


def test_a_unit_of_5000_letters_is_told_in_a_line():
    with pytest.raises(UnitError, match="cannot be read") as caught:
        si_factor("N" * 5000, FORCE)
    assert len(str(caught.value)) < 200


def test_units_of_an_export_are_si_unless_chosen():
    assert chosen_units({"force": "lbf"})[FORCE] == ("lbf", 4.4482216152605)
    assert chosen_units(None)[TRANSLATION] == ("m", 1.0)
    with pytest.raises(UnitError, match="torque is no quantity with a unit"):
        chosen_units({"torque": "N*m"})


def test_a_factor_is_the_float_nearest_to_the_decimal_number_that_defines_it():
    exact = Decimal("0.45359237") * Decimal("9.80665") * Decimal("0.0254")
    assert si_factor("lbf*in", MOMENT) == float(exact)
    assert si_factor("thou", TRANSLATION) == 0.0000254
    assert si_factor("deg", ROTATION) == math.pi / 180
