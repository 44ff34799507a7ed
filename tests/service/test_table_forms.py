"""Table files of every form: what is written comes back, and what is hostile is named."""

import gzip
import io
import json
import struct
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as arrow
import pyarrow.parquet as parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.service.table_files import (
    ReadTable,
    layout_of,
    read_csv,
    read_table,
    write_csv,
    write_json,
)
from tests.service.test_table_roundtrip import (
    any_units,
    same,
    same_to_rounding,
    tables,
    texts,
)
from wrenchbook.service.formats import Options, options, write_hdf5
from wrenchbook.service.formats import csv as csv_table
from wrenchbook.service.formats import xlsx as xlsx_table
from wrenchbook.service.formats.cells import guard_formula, unguard_formula
from wrenchbook.service.formats.columnar import write_parquet
from wrenchbook.service.formats.options import ReadReport
from wrenchbook.service.formats.read import ContentError, read_table_file, unpack
from wrenchbook.service.formats.xlsx import (
    ZipBoundsError,
    entry_sizes,
    escape,
    unescape,
    write_xlsx,
)
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange

HEADER = "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],uz [m]"
ZERO = Options(missing_loads="zero")
SLOW = settings(
    max_examples=25, suppress_health_check=[HealthCheck.too_slow]
)  # each writes and reads a workbook


def read(content: bytes, options: Options = ZERO) -> tuple[ReadTable, ReadReport]:
    told = ReadReport()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "upload"
        path.write_bytes(content)
        pieces = list(read_table_file(path, options, told))
    return read_table(pieces, told), told


def written(write, table: ReadTable, units=None) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "export"
        write(path, [table], layout_of(table, units), {"contract": "SI", "component": "rig"})
        return path.read_bytes()


def error_of(content: bytes, options: Options = ZERO) -> str:
    table, told = read(content, options)
    assert len(table) == 0
    (error,) = told.mistakes.listed()
    return error.message


@SLOW
@given(tables())
def test_an_xlsx_export_is_read_back_to_the_same_floats_and_texts(table):
    same(table, read(written(write_xlsx, table))[0])


@SLOW
@given(tables(280), any_units)
def test_an_xlsx_export_in_any_unit_is_read_back_to_rounding(table, units):
    same_to_rounding(table, read(written(write_xlsx, table, units))[0])


@SLOW
@given(tables())
def test_a_parquet_export_is_read_back_to_the_same_floats_and_texts(table):
    same(table, read(written(write_parquet, table))[0])


@SLOW
@given(tables(280), any_units)
def test_a_gzipped_csv_export_is_read_back_to_rounding(table, units):
    found, told = read(gzip.compress(write_csv(table, units).encode()))
    same_to_rounding(table, found)
    assert (told.format, told.gzip) == ("csv", True)


@given(texts)
def test_texts_survive_the_guards_of_spreadsheets(text):
    assert unguard_formula(guard_formula(text)) == text
    assert unescape(escape(text)) == text


@pytest.mark.parametrize("note", ["=1+1", "+1", "-1", "@SUM(A1)", "'=1", "''=1", "＝1"])
def test_no_note_of_an_export_is_a_formula_and_all_come_back(note):
    table = replace(read_csv(f"{HEADER},note\n0,0,1,0,0,0,0,x\n"), note=(note,))
    text = write_csv(table)
    cell = text.splitlines()[1].rsplit(",", 1)[1].strip('"')
    assert cell.startswith("'")
    same(table, read_csv(text))
    content = written(write_xlsx, table)
    same(table, read(content)[0])
    sheet = zipfile.ZipFile(io.BytesIO(content)).read("xl/worksheets/sheet1.xml")
    assert b"<f>" not in sheet


def test_an_export_says_its_contract_and_its_units():
    table = read_csv(f"{HEADER}\n0,0,1,0,0,0,0\n")
    book = openpyxl.load_workbook(io.BytesIO(written(write_xlsx, table)))
    assert book.sheetnames == ["table", "about"]
    assert [cell.value for cell in book["about"][1]] == ["contract", "SI"]
    file = parquet.ParquetFile(io.BytesIO(written(write_parquet, table)))
    assert file.schema_arrow.metadata[b"wrenchbook:contract"] == b"SI"
    assert file.schema_arrow.field("fz [N]").metadata[b"unit"] == b"N"


def test_a_spreadsheet_s_own_numbers_dates_and_empty_cells_are_read():
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Fz", "uz", "note", None])
    sheet.append(["N", "mm"])
    sheet.append([100, 0.25, "a"])
    sheet.append([])
    sheet.append([200, None, "b"])
    sheet.append([300, 0.75])
    content = io.BytesIO()
    book.save(content)
    table, told = read(content.getvalue())
    assert table.wrench[:, 2].tolist() == [100, 300]
    assert table.displacement[:, 2].tolist() == [0.00025, 0.00075]
    assert [(error.row, error.field) for error in told.mistakes.listed()] == [(5, "uz")]
    assert told.read == 3


def as_sheet(rows: list[dict[str, object]]) -> bytes:
    book, content = openpyxl.Workbook(), io.BytesIO()
    for row in ([*rows[0]], *([*one.values()] for one in rows)):
        book.active.append(row)
    book.save(content)
    return content.getvalue()


def as_frame(rows: list[dict[str, object]]) -> bytes:
    columns = {name: [str(one[name]) for one in rows] for name in ("Fz [N]", "note")}
    columns["uz [mm]"] = [one["uz [mm]"] for one in rows]
    parquet.write_table(arrow.table(columns), content := io.BytesIO())
    return content.getvalue()


def as_records(rows: list[dict[str, object]]) -> bytes:
    return json.dumps(rows).encode()


TYPED = pytest.mark.parametrize("form", [as_sheet, as_records, as_frame])


def loads_of(*texts: object) -> list[dict[str, object]]:
    return [{"Fz [N]": text, "uz [mm]": 1.25, "note": "1,5"} for text in texts]


@TYPED
@pytest.mark.parametrize(
    ("texts", "decimal", "loads"),
    [
        (["915,01", "15,009"], None, [915.01, 15.009]),
        (["915.01", "1,354.5", "15.009"], None, [915.01, 1354.5, 15.009]),
        (["15,009"], ",", [15.009]),
        (["15,009"], ".", [15009.0]),
    ],
)
def test_texts_of_numbers_follow_one_law_of_marks_in_every_format(form, texts, decimal, loads):
    table, told = read(form(loads_of(*texts)), replace(ZERO, decimal=decimal))
    assert not told.mistakes
    assert table.wrench[:, 2].tolist() == loads
    assert table.displacement[:, 2].tolist() == [0.00125] * len(loads)


@TYPED
def test_a_text_with_a_mark_that_may_part_thousands_is_asked_for_in_every_format(form):
    assert "say decimal=, (--decimal ,) for 15.009" in error_of(form(loads_of("15,009")))


@pytest.mark.parametrize("form", [as_sheet, as_records])
def test_stored_numbers_have_a_decimal_point_beside_texts_with_a_comma(form):
    table, told = read(form(loads_of(1354.5, "915,01", 15.009)))
    assert not told.mistakes
    assert table.wrench[:, 2].tolist() == [1354.5, 915.01, 15.009]


def test_a_data_frame_s_units_are_read_from_its_metadata():
    fields = [
        arrow.field("Fz", arrow.float32(), metadata={"unit": "kN"}),
        arrow.field("uz", arrow.float64(), metadata={"units": "um"}),
        arrow.field("__index_level_0__", arrow.int64()),
    ]
    content = io.BytesIO()
    columns = [arrow.array([1.5], arrow.float32()), arrow.array([2.5]), arrow.array([7])]
    parquet.write_table(arrow.Table.from_arrays(columns, schema=arrow.schema(fields)), content)
    table, told = read(content.getvalue())
    assert (table.wrench[0, 2], table.displacement[0, 2]) == (1500.0, 2.5e-6)
    assert told.ignored == ["__index_level_0__"]


# -- what is hostile -----------------------------------------------------------------------------


def test_a_gzip_bomb_is_unpacked_no_further_than_may_be(tmp_path):
    bomb, target = tmp_path / "bomb", tmp_path / "plain"
    bomb.write_bytes(gzip.compress(bytes(64 << 20)))
    with pytest.raises(ContentError, match="unpacks to more than 1 MiB"):
        unpack(bomb, target, most=1 << 20)
    assert target.stat().st_size <= 1 << 20


def test_gzip_in_gzip_a_cut_off_one_and_an_empty_one_are_named():
    packed = gzip.compress(f"{HEADER}\n".encode() * 2000)
    assert "gzipped twice" in error_of(gzip.compress(packed))
    assert "damaged gzip" in error_of(packed[:-9])
    assert "is empty" in error_of(b"")


def zipped(**members: bytes) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return content.getvalue()


def test_a_zip_bomb_is_measured_before_anybody_unpacks_it(tmp_path):
    path = tmp_path / "bomb.xlsx"
    path.write_bytes(zipped(a=bytes(32 << 20)))
    with pytest.raises(ZipBoundsError, match="unpacks to more than 1 MiB"):
        entry_sizes(path, 1 << 20)


def test_a_zip_that_lies_about_its_sizes_is_refused(tmp_path):
    content = bytearray(zipped(a=bytes(4 << 20)))
    directory = content.rindex(b"PK\x01\x02")
    content[directory + 24 : directory + 28] = struct.pack("<I", 100)
    path = tmp_path / "lying.xlsx"
    path.write_bytes(bytes(content))
    with pytest.raises(ZipBoundsError):
        entry_sizes(path, 1 << 20)


def sheet_xml(rows: str) -> bytes:
    """A workbook whose one sheet has these rows."""
    book, content = openpyxl.Workbook(), io.BytesIO()
    book.save(content)
    with zipfile.ZipFile(content) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    sheet = "xl/worksheets/sheet1.xml"
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    members[sheet] = (
        f'<worksheet xmlns="{space}"><sheetData>{rows}</sheetData></worksheet>'.encode()
    )
    return zipped(**members)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ('<row r="1"><c r="XFD1"><v>1</v></c></row>', "at most 256"),
        ('<row r="1048576"><c r="A1048576"><v>1</v></c></row>', "there is no header"),
        ('<row r="1"><c r="A1"><v>1e</v></c></row>', "no readable XLSX"),
        ('<row r="x"><c r="A1"><v>1</v></c></row>', "no readable XLSX"),
        ("<row><c", "no readable XLSX"),
        ("", "the file is empty"),
    ],
)
def test_a_sheet_that_claims_the_world_is_an_error_and_not_a_crash(rows, says):
    assert says in error_of(sheet_xml(rows))


def test_half_a_character_in_a_sheet_is_refused():
    cells = "".join(f'<c t="str"><v>{text}</v></c>' for text in ("fx [N]", "uz [m]", "note"))
    row = '<c><v>1</v></c><c><v>0</v></c><c t="str"><v>_xD800_</v></c>'
    table, told = read(sheet_xml(f"<row>{cells}</row><row>{row}</row>"))
    assert len(table) == 0
    assert [(error.row, error.field) for error in told.mistakes.listed()] == [(2, "note")]


def test_other_files_say_what_they_are_and_what_to_do():
    assert "a PDF" in error_of(b"%PDF-1.7 ...")
    assert "save it as .xlsx" in error_of(b"\xd0\xcf\x11\xe0" + bytes(100))
    assert "zip file and no XLSX" in error_of(zipped(a=b"x"))
    assert "zero bytes" in error_of(bytes(100))
    for encoding in ("utf-16-le", "utf-16-be", "utf-32", "utf-32-be"):
        assert "save it as UTF-8" in error_of("Fx (kN);Fy (kN);uz (µm)\n1;2;3\n".encode(encoding))
    assert "damaged zip" in error_of(b"PK\x03\x04" + b"x" * 50)
    assert "no readable Parquet" in error_of(b"PAR1" + b"x" * 50 + b"PAR1")


def test_a_format_that_the_content_is_not_is_said():
    options = replace(ZERO, format="xlsx")
    assert "is csv by its content, not xlsx" in error_of(f"{HEADER}\n".encode(), options)


def test_a_line_of_a_megabyte_and_a_record_without_end_are_named():
    assert "longer than" in error_of(f"{HEADER}\n".encode() + b"1," * (1 << 20))
    endless = f"{HEADER},note\n".encode() + b'0,0,1,0,0,0,0,"' + b'a\n","' * (1 << 20)
    assert "a record longer than" in error_of(endless)


def test_a_json_nested_deeply_or_with_a_long_value_is_an_error_and_not_a_crash():
    assert "nested too deeply" in error_of(b'{"rows": [' + b"[" * 100_000)
    assert "is not JSON" in error_of(b'{"rows": [{"note": "' + b"x" * (3 << 20))


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
    table, told = read(magic.get(like, b"") + content)
    assert len(table) == 0
    assert told.mistakes


@settings(max_examples=40)
@given(st.data())
def test_no_flipped_byte_of_a_workbook_or_a_frame_makes_reading_crash(data):
    content = bytearray(data.draw(st.sampled_from([BOOK, FRAME])))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    table, _ = read(bytes(content))
    assert np.isfinite(table.wrench).all()


_ROWS = read_csv(f"{HEADER},note\n0,0,1,0,0,0,0,a\n0,0,2,0,0,0,0,b\n")
BOOK = written(write_xlsx, _ROWS)
FRAME = written(write_parquet, _ROWS)


TITLED = {
    "titles": "Rig 3, run of 5 May\nOperator: Ann\n\n{header}\n{row}\n",
    "a title that begins like a column": "Fx test of the plate\n{header}\n{row}\n",
    "groups": "Force,,,Moment,,,Disp\n{header}\n{row}\n",
    "a logger's lines": '"Start Time: 5/13/2015"\n{header}\n{row}\n',
}
SEVEN = "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],uz [mm]", "1,2,3,0.1,0.2,0.3,-1.5"


@pytest.mark.parametrize("mark", [",", ";", "\t", "|"])
@pytest.mark.parametrize("text", TITLED.values(), ids=TITLED.keys())
def test_a_header_below_titles_is_found_whatever_parts_its_fields(text, mark):
    header, row = (line.replace(",", mark) for line in SEVEN)
    table, told = read(text.format(header=header, row=row).encode())
    assert told.mistakes.listed() == ()
    assert table.wrench.tolist() == [[1, 2, 3, 0.1, 0.2, 0.3]]
    assert table.displacement[0, 2] == -1.5e-3


def test_8_kilobytes_of_gzipped_empty_rows_do_not_keep_a_reader_busy():
    content = gzip.compress(b'{"rows":[' + b"{}," * 3_000_000 + b"{}]}")
    assert len(content) < 9000
    table, told = read(content)
    assert len(table) == 0
    assert told.mistakes.whole  # nothing is loaded with partial=true either
    assert told.read < 60_000
    assert "reading stopped after more than 100,000" in told.mistakes.listed()[-1].message


@pytest.mark.parametrize("form", ["csv", "json", "hdf5"])
def test_a_file_of_more_rows_than_may_be_is_read_no_further(form, monkeypatch):
    monkeypatch.setattr(options, "MAX_ROWS", 1)
    content = {
        "csv": write_csv(_ROWS).encode(),
        "json": write_json(_ROWS).encode(),
        "hdf5": write_hdf5(_ROWS, [1, 2], TableMeta("rig", 2, LoadRange(-np.ones(6), np.ones(6)))),
    }[form]
    _, told = read(content)
    assert told.mistakes.whole
    assert "has more than 1 rows" in told.mistakes.listed()[0].message


def test_the_lines_above_a_header_are_told():
    _, told = read("Rig 3;;\n\n{};\n{};\n".format(*(s.replace(",", ";") for s in SEVEN)).encode())
    assert told.titles == ["Rig 3"]


def test_a_header_below_rows_is_none_and_units_above_it_are_not_guessed():
    header, row = SEVEN
    assert "there is no header" in error_of(f"{row}\n{header}\n{row}\n".encode())
    bare = "fx,fy,fz,mx,my,mz,uz"
    table, told = read(f"Force [N],,,Moment [Nm],,,Disp [mm]\n{bare}\n{row}\n".encode())
    assert len(table) == 0
    assert {error.field for error in told.mistakes.listed()} == set(bare.split(","))


def test_columns_without_a_name_may_be_empty_and_nothing_else():
    header, row = SEVEN
    table, told = read(f",,{header},,\n,,{row},,\n".encode())
    assert told.mistakes.listed() == ()
    assert table.displacement[0, 2] == -1.5e-3
    assert "column 2, which has no name" in error_of(f",,{header}\n,7,{row}\n".encode())


def test_a_label_with_bars_does_not_part_a_header_of_commas():
    header, row = SEVEN
    assert "'|F|'" not in error_of(f"{header},|F|\n{row},4\n".encode())
    table, _ = read(f"{header},|F|\n{row},4\n".encode(), Options(ignore=("|F|",)))
    assert table.wrench[0, 0] == 1.0


@pytest.mark.parametrize("sep", [",", ";"])
def test_a_header_of_more_columns_than_a_table_has_is_refused_before_each_is_looked_at(sep):
    names = sep.join(f"c{n}" for n in range(100_000))
    assert "at most 256" in error_of(f"{HEADER}{sep}{names}\n".encode())


@pytest.mark.parametrize("between", ["_a", "_", "x"])
def test_a_label_of_100_000_letters_neither_keeps_a_reader_busy_nor_comes_back_whole(between):
    label = "fx" + between * (100_000 // len(between))
    table, told = read(f"{label},{HEADER}\n{'a,' * 7}a\n".encode())
    assert len(table) == 0
    assert all(len(mistake.field) <= 200 for mistake in told.mistakes.listed())


def test_a_sheet_of_more_rows_than_a_sheet_can_have_is_refused(monkeypatch):
    monkeypatch.setattr(xlsx_table, "MAX_SHEET_ROWS", 10)
    assert "more than 11 rows" in error_of(sheet_xml("<row/>" * 12))


@pytest.mark.parametrize("begin", ["", f"{HEADER}\n"])
@pytest.mark.parametrize("line", ["\n", "#\n", ",,\n"])
def test_a_file_of_empty_lines_is_refused_as_soon_as_there_are_too_many(begin, line, monkeypatch):
    monkeypatch.setattr(csv_table, "MAX_BLANK", 1000)
    _, told = read((begin + 2000 * line).encode(), ZERO)
    assert any("1,000 lines without a row" in one.message for one in told.mistakes.listed())


def test_a_formula_without_a_stored_value_is_named_by_its_sheet_and_cell():
    book = openpyxl.Workbook()
    book.active.title = "Run 3"
    for row in (["fz [N]", "uz [m]"], [1, 1e-6], [2, "=B2*2"]):
        book.active.append(row)
    content = io.BytesIO()
    book.save(content)
    (error,) = read(content.getvalue())[1].mistakes.listed()
    assert (error.row, error.field) == (3, "uz [m]")
    assert "the formula in Run 3!B3 has no stored value" in error.message


def test_a_sheet_that_is_not_there_is_answered_with_the_names_of_the_others():
    message = error_of(BOOK, replace(ZERO, sheet="Run 9"))
    assert "there is no sheet 'Run 9'; it has table" in message


@pytest.mark.parametrize("write", [write_xlsx, write_parquet, None])
def test_a_table_without_rows_is_written(write):
    none = _ROWS.take(np.zeros(2, dtype=bool))
    content = write_csv(none).encode() if write is None else written(write, none)
    assert len(read(content)[0]) == 0
