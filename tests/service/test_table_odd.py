"""Table files as test rigs, spreadsheets and scripts really write them."""

from __future__ import annotations

import datetime
import io

import numpy as np
import openpyxl
import pyarrow as arrow
import pytest
from pyarrow.parquet import write_table
from scipy.io import savemat

from tests.service.test_table_forms import ZERO, error_of, read
from wrenchbook.service.formats.options import Options
from wrenchbook.service.formats.text import MAX_NAME
from wrenchbook.surrogate.table.rows import LoadRange

TEXT = "fx [N],ux [mm]\n1,2\n3,4\n"
RANGE = LoadRange(np.full(6, -10.0), np.full(6, 10.0))


def workbook(*sheets: list[list[object]]) -> bytes:
    book, content = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.worksheets[0])
    for rows in sheets:
        sheet = book.create_sheet()
        for row in rows:
            sheet.append(row)
    book.save(content)
    return content.getvalue()


def errors(content: bytes, options: Options = ZERO) -> list[tuple[int, str, str]]:
    _, report = read(content, options)
    return [(error.row, error.field, error.message) for error in report.mistakes.listed()]


def test_a_time_of_day_in_a_workbook_is_a_time_and_in_a_load_a_mistake_of_its_row():
    """The whole file was no readable workbook."""
    clock = datetime.time(1, 2, 3)
    rows = [["time", "fx [N]"], [clock, 1.0], [datetime.time(1, 2, 4), 2.0]]
    table, report = read(workbook(rows), Options(missing_loads="zero", role="loads"))
    assert not report.mistakes
    assert np.diff(table.time).tolist() == [1.0]
    (error,) = errors(workbook([["fx [N]", "ux [mm]"], [clock, 1.0], [1.0, 1.0]]))
    assert error == (2, "fx [N]", "'01:02:03' is not a number")


def test_the_first_sheet_with_rows_is_read():
    """An empty first sheet made the file an empty one."""
    table, report = read(workbook([], [["fx [N]", "ux [mm]"], [1.0, 2.0]]))
    assert not report.mistakes
    assert table.wrench[:, 0].tolist() == [1.0]


def test_a_merged_title_above_the_header_is_a_title_and_a_merged_value_is_empty():
    book, content = openpyxl.Workbook(), io.BytesIO()
    sheet = book.worksheets[0]
    for row in (["Loads", None, "Displacements"], ["fx [N]", "fy [N]", "ux [mm]"]):
        sheet.append(row)
    sheet.append([1.0, 2.0, 3.0])
    sheet.append([4.0, 5.0, 6.0])
    sheet.merge_cells("A1:B1")
    sheet.merge_cells("A3:A4")
    book.save(content)
    table, report = read(content.getvalue())
    assert report.titles == ["Loads Displacements"]
    assert table.seq.tolist() == [3]
    (error,) = report.mistakes.listed()
    assert (error.row, error.field) == (4, "fx [N]")
    assert "is empty; write 0 for no load" in error.message


def test_a_csv_named_xlsx_is_a_csv_unless_the_sender_says_otherwise():
    _, report = read(TEXT.encode())
    assert report.format == "csv"
    message = error_of(TEXT.encode(), Options(missing_loads="zero", format="xlsx"))
    assert message == "is csv by its content, not xlsx; leave the format out"


def test_a_matlab_file_of_one_row_is_read():
    """Its scalars were no columns."""
    content = io.BytesIO()
    savemat(content, {"fx_N": 1.5, "ux_mm": 2.0})
    table, report = read(content.getvalue())
    assert not report.mistakes
    assert (table.wrench[0, 0], table.displacement[0, 0]) == (1.5, 2e-3)


@pytest.mark.parametrize("text", ["<!DOCTYPE html><html>", '\n<?xml version="1.0"?><Workbook/>'])
def test_a_web_page_is_no_table_and_says_so(text: str):
    assert "is a web page or XML" in error_of(text.encode())


def test_a_mark_of_utf_8_before_a_label_is_no_part_of_its_name():
    table, report = read(b"\xef\xbb\xbf\xef\xbb\xbf" + TEXT.encode())
    assert not report.mistakes
    assert len(table) == 2


def test_nan_in_json_records_is_a_mistake_of_its_row():
    """The whole file was refused."""
    content = b'[{"fx [N]": 1, "ux [mm]": NaN}, {"fx [N]": 1, "ux [mm]": 1}]'
    assert errors(content) == [(1, "ux [mm]", "'NaN' is not finite; leave the row out")]


def test_one_long_source_does_not_take_the_memory_of_all_rows():
    """20,000 rows with one source of 100,000 characters took 8 GB, in the server too."""
    lines = ["fx [N],ux [mm],source", *["1,2,a"] * 20_000, f"1,2,{'s' * 100_000}", ""]
    table, report = read("\n".join(lines).encode())
    (error,) = report.mistakes.listed()
    assert (error.row, error.field) == (20_002, "source")
    assert f"is longer than {MAX_NAME:,} characters" in error.message
    assert len(table) == 20_000
    assert table.source.dtype.itemsize == 4


def test_decimal_commas_between_quoted_fields_have_the_option_in_their_message():
    text = 'fx [N],ux [mm]\n"1,5","0,25"\n'
    messages = [message for _, _, message in errors(text.encode())]
    assert all("say decimal=, (--decimal ,) for " in message for message in messages)
    table, report = read(text.encode(), Options(missing_loads="zero", decimal=","))
    assert not report.mistakes
    assert table.wrench[0, 0] == 1.5


def test_an_infinite_number_has_one_mistake():
    content = io.BytesIO()
    write_table(arrow.table({"fx [N]": [np.inf, 1.0], "ux [mm]": [1.0, 1.0]}), content)
    options = Options(missing_loads="zero", load_range=RANGE)
    (error,) = errors(content.getvalue(), options)
    assert error == (1, "fx [N]", "'inf' is not finite; leave the row out")


@pytest.mark.parametrize(
    ("cell", "says"),
    [
        ("NaN", "is not finite"),
        ("#N/A", "is a spreadsheet's error"),
        ("#DIV/0!", "is a spreadsheet's error"),
        ("1e400", "is too large a number"),
        ("-1e-400", "is too small a number and would become 0"),
        ("\uff11", "write it with the digits 0 to 9"),
        ("\u22121", "and - for minus"),
        ("1_000", "is not a number"),
        ("0x10", "is not a number"),
        ("2 N", "the unit stands in the header only"),
    ],
)
@pytest.mark.parametrize("column", [0, 1])
def test_a_cell_that_is_no_number_is_a_mistake_of_its_row_alone(cell: str, says: str, column: int):
    cells = ["5", "6"]
    cells[column] = cell
    ((row, field, message),) = errors(f"{TEXT}{','.join(cells)}\n7,8\n".encode())
    assert (row, field) == (4, ["fx [N]", "ux [mm]"][column])
    assert says in message


@pytest.mark.parametrize("blank", ["", "  ", ",", "\t", "# a comment"])
def test_blank_lines_and_comments_are_no_rows(blank: str):
    table, report = read(TEXT.replace("\n", f"\n{blank}\n").encode())
    assert not report.mistakes
    assert table.seq.tolist() == [3, 5]


@pytest.mark.parametrize("content", [b"", b"\n\n\n", b"   \t ", b"\xef\xbb\xbf"])
def test_a_file_without_a_cell_is_empty(content: bytes):
    assert error_of(content) == "the file is empty"
