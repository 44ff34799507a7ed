"""Readers of XLSX and XLS workbooks, and the writer of XLSX.

openpyxl yields a sheet row by row, so that neither a million rows nor a sheet that claims a billion
cells are in memory. A formula has the value that the spreadsheet program stored. Numbers are
written as digits: openpyxl writes 16 of them, too few for every third float.
"""

from __future__ import annotations

import errno
import os
import re
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO

from wrenchbook.service.formats.cells import NO_VALUE, ContentError, Digits
from wrenchbook.service.formats.columns import Layout, WritableRows
from wrenchbook.service.formats.header import (
    MAX_TITLES,
    POSITION,
    Record,
    is_row,
    named_columns,
)
from wrenchbook.service.formats.options import Options, ParsedTable, ReadReport
from wrenchbook.service.formats.text import read_records

MAX_UNPACKED = 1024 * 1024 * 1024  # bytes: a million rows of 12 numbers are 500 MB of XML
MAX_IN_MEMORY = 64 * 1024 * 1024  # bytes of a member that is no sheet: texts, styles
MAX_MEMBERS = 1000  # files in a workbook: sheets, styles and pictures are some dozens
MAX_CELL = 32_767  # characters of a cell (limit of Excel): it repairs a file with more
MAX_SHEET_ROWS = 1_048_575  # rows of a sheet below the header (ECMA-376)
ABOUT_SHEET = "about"  # sheet of an export's metadata; it has no rows
_BLOCK = 1 << 20  # bytes of a member that are in memory at once
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # the two of OPC (ECMA-376-2, annex C)
_SAVE_AGAIN = "save it again from a spreadsheet program"
_ENCRYPTED = 1  # the flag of an encrypted member (APPNOTE.TXT, 4.4.4)
_NUMBER, _TEXT = "n", "s"  # data types of a cell in openpyxl
# ST_Xstring (ECMA-376, 22.9.2.19): characters that XML 1.0 lacks, and texts that look like escapes.
_TO_ESCAPE = re.compile("[\x00-\x08\x0b-\x0d\x0e-\x1f\ufffe\uffff]|_(?=x[0-9A-Fa-f]{4}_)")
_ESCAPED = re.compile(r"_x([0-9A-Fa-f]{4})_")
_DAY_ZERO = datetime(1900, 1, 1)  # a clock time of 24 h or more is saved as days since this one


class SheetFullError(ValueError):
    """The table has more rows than a sheet allows, or a text longer than a cell allows."""


def read_xlsx(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a sheet in pieces; mistakes are added to `report`."""
    for entry, size in entry_sizes(path, MAX_UNPACKED).items():
        if size > MAX_IN_MEMORY and not entry.startswith("xl/worksheets/"):
            raise ContentError(
                f"has {size >> 20} MiB in {entry}, over the limit of {MAX_IN_MEMORY >> 20} "
                "MiB; send it in parts"
            )
    # Opened here, because openpyxl checks the ending of a name.
    with path.open("rb") as values, path.open("rb") as formulas, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings about styles and extensions
        sheets = _sheets(values, values=True)

        def head(name: str) -> list[list[str]]:
            rows = sheets[name].iter_rows(values_only=True, max_row=MAX_TITLES + 1)
            return [[*map(_text, row)] for row in rows]

        fits = _fits(head, options)
        name = chosen_sheet(list(sheets), options.sheet, fits, report)
        records = _records(
            sheets[name],
            lambda: _sheets(formulas, values=False)[name],
            options.columns.max_count,
        )
        yield from read_records(records, options, report)


def write_xlsx(
    path: Path, pieces: Iterable[WritableRows], layout: Layout, metadata: Mapping[str, str]
) -> None:
    """Write pieces of a table to a sheet, `metadata` to another; raises SheetFullError."""
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    try:
        sheet = book.create_sheet("table")
        sheet.append([_cell(sheet, label, _TEXT) for label in layout.labels()])
        count = 0
        for piece in pieces:
            numbers = [column.digits(piece) for column in layout.numbers]
            texts = layout.text_columns(piece)
            count += len(piece.wrench)
            if count > MAX_SHEET_ROWS:
                raise SheetFullError(
                    f"the table has more than {MAX_SHEET_ROWS:,} rows, the limit of a sheet; "
                    "export it as CSV, Parquet or HDF5"
                )
            types = [_NUMBER] * len(numbers) + [_TEXT] * len(texts)
            for cells in zip(*numbers, *texts, strict=True):
                sheet.append([_cell(sheet, *typed) for typed in zip(cells, types, strict=True)])
        about = book.create_sheet(ABOUT_SHEET)
        for entry in metadata.items():
            about.append([_cell(about, text, _TEXT) for text in entry])
        book.save(path)
    except Exception as error:
        # openpyxl removes the temporary file of a sheet only after a complete save.
        for written in book.worksheets:
            writer = getattr(written, "_writer", None)
            if writer is not None:
                for close in (written.close, writer.xf.close):
                    with suppress(Exception):  # the disk that is full stays full
                        close()
                writer.cleanup()
        # Error names of lxml: IO_ENOSPC.
        number = getattr(errno, str(error).removeprefix("IO_"), None)
        if number is None:
            raise
        raise OSError(number, os.strerror(number)) from error


def _cell(sheet: Any, text: str, data_type: str) -> Any:
    """Return a cell of a text, or of a number's digits; None if it is empty."""
    from openpyxl.cell import WriteOnlyCell

    if not text:
        return None
    value = text if data_type == _NUMBER else escape(text)
    if len(value) > MAX_CELL:  # openpyxl would cut it
        raise SheetFullError(
            f"the table has a text of {len(value):,} characters, more than {MAX_CELL:,}, the limit "
            "of a cell; shorten it, or export the table as CSV, Parquet or HDF5"
        )
    cell = WriteOnlyCell(sheet, value)
    cell.data_type = data_type  # openpyxl takes "=1" for a formula and "#N/A" for an error
    return cell


def read_xls(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a sheet of an old workbook; mistakes are added to `report`.

    calamine keeps a sheet in memory: 65,536 rows of 256 columns at most.
    """
    # Imported on use, as the extra `rig` has it.
    from python_calamine import CalamineWorkbook

    with path.open("rb") as content:
        book = CalamineWorkbook.from_filelike(content)

    def head(name: str) -> list[list[str]]:
        rows = book.get_sheet_by_name(name).to_python(nrows=MAX_TITLES + 1)
        return [[*map(_text, row)] for row in rows]

    fits = _fits(head, options)
    name = chosen_sheet(book.sheet_names, options.sheet, fits, report)
    sheet = book.get_sheet_by_name(name)
    empty = [""] * (sheet.start or (0, 0))[1]  # columns on the left
    cells = enumerate(([*empty, *map(_text, row)] for row in sheet.iter_rows()), start=1)
    yield from read_records(filter(lambda row: any(row[1]), cells), options, report)


def _fits(
    head: Callable[[str], list[list[str]]], options: Options
) -> tuple[Callable[[str], bool], ...]:
    """Return whether a sheet's first rows, `head`, are a table, and whether they have text."""
    has_positions = any(map(POSITION.fullmatch, options.mapping))

    def is_table(name: str) -> bool:
        return any(
            named_columns(row, options.columns, options.mapping) > 1
            or (has_positions and is_row(row))
            for row in head(name)
        )

    return is_table, lambda name: any(map(any, head(name)))


def chosen_sheet(
    names: Sequence[str],
    wanted: str | None,
    fits: Sequence[Callable[[str], bool]],
    report: ReadReport,
) -> str:
    """Return `wanted`, or the first sheet that fits, and report it; raises ContentError.

    `fits`: conditions on a sheet's name. A later one counts if no sheet meets an earlier one.
    """
    report.sheets = list(names)
    if not names:
        raise ContentError("there is no sheet with data; export the file again")
    if wanted is not None and wanted not in names:
        known = ", ".join(names)
        raise ContentError(
            f"there is no sheet {wanted!r}; choose {known} with sheet=NAME (--sheet NAME)"
        )
    tables = [name for name in names if name != ABOUT_SHEET]
    fitting = (name for is_fit in fits for name in tables if is_fit(name))
    report.sheet = wanted if wanted is not None else next(fitting, names[0])
    return report.sheet


def _sheets(file: BinaryIO, *, values: bool) -> dict[str, Any]:
    """Return the sheets of a workbook by name, with stored values or with formulas."""
    # Imported on first use, as it takes 0.2 s and 20 MB.
    import openpyxl

    book = openpyxl.load_workbook(file, read_only=True, data_only=values, keep_links=False)
    for sheet in book.worksheets:
        sheet.reset_dimensions()  # the dimensions that a file states may be wrong
    return {sheet.title: sheet for sheet in book.worksheets}


def _records(sheet: Any, formulas: Callable[[], Any], max_count: int) -> Iterator[Record]:
    """Yield number and cells of each row with text; a formula without a value as `NO_VALUE`.

    `formulas` opens the same sheet with formulas in place of values, when the first is needed.
    """
    formula_rows = None
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > MAX_SHEET_ROWS + 1:
            raise ContentError(
                f"the sheet {sheet.title} has over {MAX_SHEET_ROWS + 1:,} rows; send it in parts"
            )

        width = max((at for at, value in enumerate(row, start=1) if value is not None), default=0)
        if width > max_count:
            place = f"row {number} of the sheet {sheet.title}"
            raise ContentError(f"{place} has {width} columns, over {max_count}; remove some")
        cells = [_text(value) for value in row[:max_count]]
        if not any(cells):
            continue

        if None in row[:max_count]:
            formula_rows = formula_rows or enumerate(formulas().iter_rows(), start=1)
            _, formula_row = next(pair for pair in formula_rows if pair[0] == number)
            for at, cell in enumerate(formula_row[: len(cells)]):
                if not cells[at] and cell.value is not None:
                    cells[at] = f"{NO_VALUE}{sheet.title}!{cell.coordinate}"
        yield number, cells


def _text(value: Any) -> str:
    """Return a cell's value as text, as CSV has it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, int | float):
        return Digits(value)
    if isinstance(value, str):
        return unescape(value)
    if isinstance(value, timedelta) and value.days:  # a shorter one is a clock time already
        with suppress(OverflowError):
            value = _DAY_ZERO + value
    return str(value)  # dates and times as ISO 8601, with a space between them


def escape(text: str) -> str:
    """Return a text without characters that the XML of a sheet cannot have."""
    return _TO_ESCAPE.sub(lambda match: f"_x{ord(match[0]):04X}_", text)


def unescape(text: str) -> str:
    """Return the text whose `escape` is given; it may have a lone surrogate."""
    units = _ESCAPED.sub(lambda match: chr(int(match[1], 16)), text)
    # An escape is a unit of UTF-16, and two may be one character.
    return units.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "surrogatepass")


def _check_entries(entries: Sequence[zipfile.ZipInfo]) -> None:
    """Raise ContentError unless a zip file is a workbook of a spreadsheet program."""
    if len(entries) > MAX_MEMBERS:
        raise ContentError(
            f"holds {len(entries):,} files, more than the {MAX_MEMBERS:,} of a workbook; "
            f"{_SAVE_AGAIN}"
        )
    names: set[str] = set()
    for entry in entries:
        name, method = entry.filename, entry.compress_type
        if name in names:
            raise ContentError(f"holds two files {name}, so it is damaged; {_SAVE_AGAIN}")
        names.add(name)
        if entry.flag_bits & _ENCRYPTED:
            raise ContentError(f"is encrypted ({name}); save it without a password")
        if method not in _COMPRESSIONS:
            raise ContentError(f"packs {name} by the unknown method {method}; {_SAVE_AGAIN}")


def entry_sizes(path: Path, max_bytes: int) -> dict[str, int]:
    """Return the unpacked bytes of each member, by unpacking, as a directory may be wrong.

    Raises ContentError if the members have more than `max_bytes`, or for a damaged file.
    """
    too_large = f"unpacks to more than {max_bytes >> 20} MiB; send the table in parts"
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _check_entries(entries)
            if sum(entry.file_size for entry in entries) > max_bytes:
                raise ContentError(too_large)
            sizes: dict[str, int] = {}
            for entry in entries:
                size = 0
                remaining = max_bytes - sum(sizes.values())
                with archive.open(entry) as content:
                    while size <= remaining and (block := content.read(_BLOCK)):
                        size += len(block)
                if size > remaining:
                    raise ContentError(too_large)
                sizes[entry.filename] = size
            return sizes
    except ContentError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError) as error:
        raise ContentError(f"is a damaged zip file ({error}); save it again") from error
