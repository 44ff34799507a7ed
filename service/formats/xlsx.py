"""XLSX tables: a sheet of a workbook to records of text, and back.

openpyxl finds the sheet, and its parser gives the cells row by row: neither a sheet that claims a
billion cells nor a million rows are in memory. Formulas give the value that the spreadsheet saved.
Numbers are read and written as digits: openpyxl writes 16 of them, too few for every third float.
"""

from __future__ import annotations

import re
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from wrenchbook.service.formats.cells import NO_VALUE, Digits
from wrenchbook.service.formats.columns import Layout, WritableRows
from wrenchbook.service.formats.header import Header
from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.preamble import Record
from wrenchbook.service.formats.rows import ParsedTable
from wrenchbook.service.formats.text import read_records

MOST_UNPACKED = 1024 * 1024 * 1024  # a million rows of 12 numbers are 500 MB of XML
MOST_IN_MEMORY = 64 * 1024 * 1024  # of a member that is no sheet: texts, styles
MOST_MEMBERS = 1000
MOST_SHEET_ROWS = 1_048_575  # below the header (ECMA-376)
ABOUT_SHEET = "about"  # of an export; it has no rows
_BLOCK = 1 << 20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# ST_Xstring (ECMA-376, 22.9.2.19): characters that XML 1.0 lacks, and texts that look like escapes.
_UNFIT = re.compile("[\x00-\x08\x0b-\x0d\x0e-\x1f\ufffe\uffff]|_(?=x[0-9A-Fa-f]{4}_)")
_TOO_LARGE = "unpacks to more than {} MiB; send the table in parts"
_ESCAPE = re.compile(r"_x([0-9A-Fa-f]{4})_")


class NoSheetError(ValueError):
    """The workbook has no such sheet, or none at all."""


class SheetFullError(ValueError):
    """The table has more rows than a sheet."""


class ZipBoundsError(ValueError):
    """The archive is damaged, or unpacks to more than the limit; see the message."""


def read_xlsx(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a sheet piece by piece; `report` gets the mistakes."""
    try:
        # Opened here, because openpyxl checks the ending of a name.
        with path.open("rb") as file:
            records = _records(_sheet(path, file, options.sheet), options.columns.most)
            yield from read_records(records, options, report, _record_problem)
    except Exception as error:  # openpyxl raises many classes on damaged files
        report.mistakes.ruin(0, "file", f"is no readable XLSX workbook: {error}")


def write_xlsx(
    path: Path, pieces: Iterable[WritableRows], layout: Layout, about: Mapping[str, str]
) -> None:
    """Write pieces of a table to one sheet, and `about` to another.

    Raises
    ------
    SheetFullError
        If the table has more rows than a sheet can.
    """
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    sheet = book.create_sheet("table")
    sheet.append([_write_cell(sheet, label, "s") for label in layout.labels()])
    count = 0
    for piece in pieces:
        numbers = [column.digits(piece) for column in layout.numbers]
        texts = layout.words(piece)
        count += len(piece.wrench)
        if count > MOST_SHEET_ROWS:
            raise SheetFullError(
                f"the table has more than {MOST_SHEET_ROWS:,} rows, the most of a sheet; export it "
                "as CSV, Parquet or HDF5"
            )
        kinds = ["n"] * len(numbers) + ["s"] * len(texts)
        for cells in zip(*numbers, *texts, strict=True):
            sheet.append([_write_cell(sheet, *pair) for pair in zip(cells, kinds, strict=True)])
    notes = book.create_sheet(ABOUT_SHEET)
    for word, meaning in about.items():
        notes.append([_write_cell(notes, word, "s"), _write_cell(notes, meaning, "s")])
    book.save(path)


def _write_cell(sheet: Any, text: str, kind: str) -> Any:
    """Return a cell of a text, which is no formula, or of a number's digits; None if empty."""
    from openpyxl.cell import WriteOnlyCell

    if not text:
        return None
    cell = WriteOnlyCell(sheet)
    cell._value = text if kind == "n" else escape(text)
    cell.data_type = kind
    return cell


def _sheet(path: Path, file: BinaryIO, name: str | None) -> Any:
    """Return the sheet of a name, or the first one."""
    for entry, size in entry_sizes(path, MOST_UNPACKED).items():
        if size > MOST_IN_MEMORY and not entry.startswith("xl/worksheets/"):
            raise ZipBoundsError(f"holds more than {MOST_IN_MEMORY >> 20} MiB in {entry}")
    # Imported on first use: 0.2 s and 20 MB.
    import openpyxl

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions
        book = openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)
    found = [sheet for sheet in book.worksheets if name is None or sheet.title == name]
    if not found:
        known = ", ".join(sheet.title for sheet in book.worksheets)
        raise NoSheetError(f"there is no sheet {name!r}; it has {known or 'none'}: say sheet=NAME")
    if name is None and len(found) > 1 and found[0].title == ABOUT_SHEET:
        return found[1]
    return found[0]


def _records(sheet: Any, most: int) -> Iterator[Record]:
    """Yield the number and the cells of each row with text, numbers as their digits."""
    book = sheet.parent
    with warnings.catch_warnings(), sheet._get_source() as source:
        warnings.simplefilter("ignore")
        parser = _digits_parser(
            sheet.title,
            source,
            sheet._shared_strings,
            data_only=True,
            epoch=book.epoch,
            date_formats=book._date_formats,
            timedelta_formats=book._timedelta_formats,
        )
        for count, (number, cells) in enumerate(parser.parse()):
            if count > MOST_SHEET_ROWS:
                raise ValueError(f"a sheet has more than {MOST_SHEET_ROWS + 1:,} rows")
            texts = _texts([cell for cell in cells if cell["value"] is not None], most)
            if any(texts):
                yield number, texts


def _texts(cells: list[dict[str, Any]], most: int) -> list[str]:
    width = max((cell["column"] for cell in cells), default=0)
    if width > most:
        raise ValueError(f"a row has {width} columns; a table has at most {most}")
    texts = [""] * width
    for cell in cells:
        texts[cell["column"] - 1] = _text(cell["value"])
    return texts


def _text(value: Any) -> str:
    if type(value) is Digits:
        return value
    if isinstance(value, str):
        return unescape(value)
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    return value.isoformat(sep=" ") if hasattr(value, "hour") else str(value)


def _record_problem(cells: list[str], header: Header) -> str:
    """Return what is wrong with a row, which is filled up with empty cells."""
    if len(cells) > header.width:
        return f"has {len(cells)} cells, the header {header.width}"
    cells.extend([""] * (header.width - len(cells)))
    return ""


def _digits_parser(title: str, *args: Any, **options: Any) -> Any:
    """Return openpyxl's parser of a sheet; the value of a number is its digits in the file.

    A formula without a value gets its place in `title` after `NO_VALUE`.
    """
    from openpyxl.worksheet._reader import FORMULA_TAG, VALUE_TAG, WorkSheetParser

    class _DigitsParser(WorkSheetParser):
        def parse_row(self, row: Any) -> tuple[int, list[dict[str, Any]]]:
            self.row_dimensions.clear()  # the heights of a million rows
            return super().parse_row(row)

        def parse_cell(self, element: Any) -> dict[str, Any]:
            has_formula = element.find(FORMULA_TAG) is not None  # the parser clears the element
            cell = super().parse_cell(element)
            if cell["data_type"] == "n" and cell["value"] is not None:
                cell["value"] = Digits(element.findtext(VALUE_TAG))
            elif cell["value"] is None and cell["data_type"] == "n" and has_formula:
                cell["value"] = f"{NO_VALUE}{title}!{element.get('r')}"
            return cell

    return _DigitsParser(*args, **options)


def escape(text: str) -> str:
    """Return a text as the XML of a sheet can hold it."""
    return _UNFIT.sub(lambda found: f"_x{ord(found[0]):04X}_", text)


def unescape(text: str) -> str:
    """Return the argument of `escape` from its result."""
    return _ESCAPE.sub(lambda found: chr(int(found[1], 16)), text)


def entry_sizes(path: Path, most: int) -> dict[str, int]:
    """Return the bytes of each member of a zip file that unpacks to at most `most`.

    Every member is unpacked and dropped: the sizes in the directory may be wrong.

    Raises
    ------
    ZipBoundsError
        If the archive is damaged or larger.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if problem := _directory_problem(entries, most):
                raise ZipBoundsError(problem)
            sizes: dict[str, int] = {}
            for entry in entries:
                left = most - sum(sizes.values())
                sizes[entry.filename] = _size(archive, entry, left)
                if sizes[entry.filename] > left:
                    raise ZipBoundsError(_TOO_LARGE.format(most >> 20))
            return sizes
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError) as error:
        if isinstance(error, ZipBoundsError):
            raise
        raise ZipBoundsError(f"is a damaged zip file ({error})") from error


def _directory_problem(entries: list[zipfile.ZipInfo], most: int) -> str:
    if len(entries) > MOST_MEMBERS:
        return f"has {len(entries)} members; at most {MOST_MEMBERS} are read"
    if len({entry.filename for entry in entries}) < len(entries):
        return "has two members of one name"
    if any(entry.compress_type not in _METHODS or entry.flag_bits & 1 for entry in entries):
        return "is encrypted or packed in a way no spreadsheet is; save it plainly"
    if sum(entry.file_size for entry in entries) > most:
        return _TOO_LARGE.format(most >> 20)
    return ""


def _size(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, most: int) -> int:
    """Return what a member unpacks to, measured until it is more than `most`."""
    size = 0
    with archive.open(entry) as content:
        while size <= most and (block := content.read(_BLOCK)):
            size += len(block)
    return size
