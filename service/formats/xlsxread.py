"""Sheets of XLSX workbooks as records of text.

The workbook is found with openpyxl; its cells come from openpyxl's own parser, row by row, so that
neither a sheet that claims a billion cells nor a million real rows stand in memory, and numbers
keep all the digits that the file has. Formulas give the value that the spreadsheet has saved.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from service.formats.header import Header
from service.formats.mistakes import RowError
from service.formats.options import Options, Told
from service.formats.parsed import ParsedTable
from service.formats.sheet import MOST_COLUMNS, Mark, Record, tables
from service.formats.sheettext import unescaped
from service.formats.zipbounds import ZipBoundsError, members_of

MOST_UNPACKED = 1024 * 1024 * 1024  # a million rows of 12 numbers are 500 MB of XML
MOST_WORDS = 64 * 1024 * 1024  # of texts, styles and the like, which are in memory as a whole
SHEET_NOTES = "about"  # a sheet that exports have, with no rows


class NoSheetError(ValueError):
    """The workbook has no such sheet, or none at all."""


def xlsx_file(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the good rows of a sheet piece by piece; `told` gets what is wrong."""
    try:
        # Opened here, because openpyxl believes the ending of a name.
        with path.open("rb") as file:
            sheet = _opened(path, file, options.sheet)
            yield from tables(_records(sheet), options, told, Mark(), _problem)
    except Exception as error:  # openpyxl lets through what any of its parsers meets
        told.mistakes.ruin(RowError(0, "file", f"is no readable XLSX workbook: {error}"))


def _opened(path: Path, file: BinaryIO, name: str | None) -> Any:
    for member, size in members_of(path, MOST_UNPACKED).items():
        if size > MOST_WORDS and not member.startswith("xl/worksheets/"):
            raise ZipBoundsError(f"holds more than {MOST_WORDS >> 20} MiB in {member}")
    # Imported when it is needed: 0.2 s and 20 MB that a server without spreadsheets never spends.
    import openpyxl

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions, which hold no rows
        book = openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)
    found = [sheet for sheet in book.worksheets if name is None or sheet.title == name]
    if not found:
        known = ", ".join(sheet.title for sheet in book.worksheets)
        raise NoSheetError(f"there is no sheet {name!r}; it has {known or 'none'}")
    if name is None and len(found) > 1 and found[0].title == SHEET_NOTES:
        return found[1]
    return found[0]


def _records(sheet: Any) -> Iterator[Record]:
    """Yield the number and the cells of each row that has any, numbers as their digits."""
    book = sheet.parent
    with warnings.catch_warnings(), sheet._get_source() as source:
        warnings.simplefilter("ignore")
        parser = _parser(
            source,
            sheet._shared_strings,
            data_only=True,
            epoch=book.epoch,
            date_formats=book._date_formats,
            timedelta_formats=book._timedelta_formats,
        )
        for number, cells in parser.parse():
            fields = _fields(cells)
            if any(fields):
                yield number, fields


def _fields(cells: list[dict[str, Any]]) -> list[str]:
    places = [cell["column"] for cell in cells if cell["value"] is not None]
    width = max(places, default=0)
    if width > MOST_COLUMNS:
        raise ValueError(f"a row has {width} columns; a table has at most {MOST_COLUMNS}")
    fields = [""] * width
    for cell in cells:
        if cell["value"] is not None:
            fields[cell["column"] - 1] = _text(cell["value"])
    return fields


def _text(value: Any) -> str:
    if isinstance(value, str):
        return unescaped(value)
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    return value.isoformat(sep=" ") if hasattr(value, "hour") else str(value)


def _problem(fields: list[str], header: Header) -> str:
    """Say what is wrong with a row; cells that end early are empty ones."""
    if len(fields) > header.width:
        return f"has {len(fields)} cells, the header {header.width}"
    fields.extend([""] * (header.width - len(fields)))
    return ""


def _parser(*args: Any, **words: Any) -> Any:
    """Return openpyxl's parser of a sheet, with numbers left as the digits that the file has."""
    from openpyxl.worksheet._reader import VALUE_TAG, WorkSheetParser

    class _DigitsParser(WorkSheetParser):
        def parse_row(self, row: Any) -> tuple[int, list[dict[str, Any]]]:
            self.row_dimensions.clear()  # the heights of a million rows
            return super().parse_row(row)

        def parse_cell(self, element: Any) -> dict[str, Any]:
            cell = super().parse_cell(element)
            if cell["data_type"] == "n" and cell["value"] is not None:
                cell["value"] = element.findtext(VALUE_TAG)
            return cell

    return _DigitsParser(*args, **words)
