"""CSV tables: encodings, delimiters, decimal marks, comments, and mistakes by line and column.

Fields are parted by ``,``, ``;``, tab or ``|``, with the latter three the decimal mark may be a
comma. Marks between thousands are left out (``1,234.5``, ``1 234``, ``1.234.567``). If all marks in
the numbers may part thousands (``1,234``), the file is refused: a guess would be wrong by a factor
of 1000. Lines that begin with ``#`` are comments. Blank lines count in
the numbers of lines.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

from wrenchbook.service.formats.cells import guard_formula, number_text
from wrenchbook.service.formats.columns import TEXTS, TIME_COLUMN, Layout, WritableRows
from wrenchbook.service.formats.header import Header
from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.preamble import Preamble, Record, delimiter_in
from wrenchbook.service.formats.rows import ParsedTable
from wrenchbook.service.formats.text import (
    BrokenLineError,
    CellFormat,
    format_in,
    read_records,
)

MOST_LINE = 1 << 20  # characters; 54 numbers and three texts are some thousands
MOST_RECORD = 4 * MOST_LINE  # a quoted text may have many lines
MOST_BLANK = 1 << 20  # consecutive lines: a spreadsheet has no more in all
_BLOCK = 1 << 20  # bytes
_MOST_HEAD = 200  # lines to find a header in

_SEPARATOR_LINE = re.compile(r'"?sep=(?P<mark>[,;\t|])"?[,;\t]*\s*', re.IGNORECASE)
# A line with a spreadsheet's error value is a row with a mistake, not a comment.
_SHEET_ERROR = re.compile(
    r"#(N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!|NV|WERT!|BEZUG!|ZAHL!)", re.IGNORECASE
)
_IN_BRACKETS = re.compile(r"\[[^\]]*\]|\([^)]*\)|\"[^\"]*\"")
_LINE_END = re.compile(r"\r\n|\r|\n")
_NO_CSV = (
    "cannot be read as CSV ({}); is a quotation mark left open? Within a quoted text a quotation "
    "mark is written twice"
)


class UnreadableFileError(ValueError):
    """The bytes are no CSV text; the message has the remedy."""


def read_csv(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a CSV file piece by piece; `report` gets the mistakes."""
    try:
        encoding = _encoding(path)
        delimiter = _delimiter(_lines(path, encoding), options)
    except UnreadableFileError as error:
        report.mistakes.ruin(0, "file", str(error))
        return
    except BrokenLineError as error:
        report.mistakes.ruin(error.line, "line", str(error))
        return

    def records() -> Iterator[Record]:
        found = _records(_lines(path, encoding), delimiter)
        for first in found:
            if not _is_separator_line(first[1], delimiter):
                yield first
            break
        yield from found

    def check(cells: list[str], header: Header) -> str:
        return _record_problem(cells, header, delimiter)

    if options.decimal is not None or delimiter == ",":
        cell_format = CellFormat(
            options.decimal == ",", declared=options.decimal is not None, guarded=True
        )
    else:
        cell_format = replace(format_in(records(), options), guarded=True)
    yield from read_records(records(), options, report, check, cell_format)


def csv_text(
    pieces: Iterable[WritableRows], layout: Layout, comments: Iterable[str] = ()
) -> Iterator[str]:
    """Yield the text of a CSV: comments, header, and the rows of each piece.

    A text that a spreadsheet would run as a formula has a ``'`` before it; an import removes it.
    """
    for comment in comments:
        yield "# " + " ".join(comment.split()) + "\n"
    out = _Lines()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(layout.labels())
    yield out.pop_text()
    for piece in pieces:
        numbers = [column.digits(piece) for column in layout.numbers]
        texts = [map(guard_formula, words) for words in layout.words(piece)]
        writer.writerows(zip(*numbers, *texts, strict=True))
        yield out.pop_text()


class _Lines(list[str]):
    r"""Collects lines that end in ``\n`` from a writer that ends them in ``\r\n``.

    Python's writer quotes a text with a carriage return only if the line end has one.
    """

    def write(self, line: str) -> None:
        self.append(line.removesuffix("\r\n") + "\n")

    def pop_text(self) -> str:
        """Return the lines as one text and remove them."""
        text = "".join(self)
        self.clear()
        return text


def _encoding(path: Path) -> str:
    """Return UTF-8 with or without mark, UTF-16 with mark, or Windows-1252.

    Raises
    ------
    UnreadableFileError
        If the file is a spreadsheet or in another encoding.
    """
    with path.open("rb") as content:
        head = content.read(4)
        if head.startswith(b"PK\x03\x04"):
            raise UnreadableFileError("this is a spreadsheet or zip file; save it as CSV first")
        utf16 = head.startswith((b"\xff\xfe", b"\xfe\xff"))
        for encoding in ("utf-16",) if utf16 else ("utf-8-sig", "cp1252"):
            content.seek(0)
            if _decodes(content, encoding):
                return encoding
    raise UnreadableFileError("the text encoding is not recognised; save the file as UTF-8")


def _decodes(content: BinaryIO, encoding: str) -> bool:
    decoder = codecs.getincrementaldecoder(encoding)()
    try:
        while block := content.read(_BLOCK):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True


def _lines(path: Path, encoding: str) -> Iterator[str]:
    """Yield the lines with their ends (LF, CR or both); raises BrokenLineError."""
    with path.open("rb") as content:
        text = io.TextIOWrapper(content, encoding=encoding, newline="")
        number = 0
        while line := text.readline(MOST_LINE):
            number += 1
            if len(line) >= MOST_LINE:
                message = f"is longer than {MOST_LINE:,} characters; is it a table at all?"
                raise BrokenLineError(number, message)
            yield line


def _delimiter(lines: Iterator[str], options: Options) -> str:
    """Return the delimiter from a ``sep=`` line, else from the header (see `delimiter_in`)."""
    for number, line in enumerate(lines, 1):
        _refuse_blank(number, number)
        separator = _SEPARATOR_LINE.fullmatch(line)
        if separator:
            return separator["mark"]
        if _may_be_header(line):
            rest = (below for below in islice(lines, _MOST_HEAD) if _may_be_header(below))
            lines = chain([line], rest)
            return delimiter_in(lines, lambda text: _IN_BRACKETS.sub("", text), options.columns)
    return ","


def _may_be_header(line: str) -> bool:
    if not line.strip() or _is_comment(line):
        return False
    try:
        return not Preamble().add([line.strip().strip('"')])
    except ValueError:
        return False


def _refuse_blank(count: int, line: int) -> None:
    """Refuse a file of line ends: half a megabyte of gzip would take minutes to read."""
    if count > MOST_BLANK:
        raise BrokenLineError(
            line, f"comes after {MOST_BLANK:,} lines without a row; is it a table at all?"
        )


def _is_comment(line: str) -> bool:
    return line.startswith("#") and not _SHEET_ERROR.match(line)


def _records(lines: Iterator[str], delimiter: str) -> Iterator[Record]:
    """Yield the line number and the cells of each record with text.

    Raises
    ------
    BrokenLineError
        If a quotation mark stays open or stands within a quoted field, or a field is longer than
        131,072 characters.
    """
    fresh, length = True, 0

    def uncommented() -> Iterator[str]:
        # A comment begins where a record does, not inside a quoted text.
        nonlocal fresh, length
        for line in lines:
            begins, fresh = fresh, False
            length = len(line) if begins else length + len(line)
            if length > MOST_RECORD:
                raise csv.Error(f"a record longer than {MOST_RECORD:,} characters")
            yield "\n" if begins and _is_comment(line) else line

    # Not strict, an open quotation mark would silently take the lines below into its field.
    reader = csv.reader(uncommented(), delimiter=delimiter, skipinitialspace=True, strict=True)
    before = row = 0
    try:
        for cells in reader:
            fresh = True
            line, before = before + 1, reader.line_num
            if any(cell.strip() for cell in cells):
                row = before
                yield line, cells
            else:
                _refuse_blank(before - row, line)
    except csv.Error as error:
        raise BrokenLineError(before + 1, _NO_CSV.format(error)) from error


def _is_separator_line(cells: list[str], delimiter: str) -> bool:
    """Return whether a record is the ``sep=;`` line that spreadsheets put first."""
    return bool(_SEPARATOR_LINE.fullmatch(delimiter.join(cells))) or (
        len(cells) > 1 and cells[0].lower() in ("sep=", '"sep=') and not any(cells[1:])
    )


def _record_problem(cells: list[str], header: Header, delimiter: str) -> str:
    """Return what is wrong with a record; an empty text if nothing is."""
    width, text = header.width, "".join(cells)
    broken = "\n" in text or "\r" in text
    if len(cells) != width:
        message = f"has {len(cells)} fields, the header {width}"
        if broken:
            message += "; is a quotation mark left open?"
        elif len(cells) > width and delimiter == ",":
            message += "; decimal commas need ; between the fields, a comma in a note needs quotes"
        return message
    if broken and _holds_rows(cells, header, delimiter):
        return "a quoted text holds a whole row of the table; is a quotation mark left open?"
    return ""


def _holds_rows(cells: list[str], header: Header, delimiter: str) -> bool:
    """Return whether two lines of a record are rows: then an open quotation mark joined them.

    A text of several lines leaves at most one such line, which holds the numbers of the row.
    """
    numeric = (name for name in header.columns if name not in (*TEXTS, TIME_COLUMN))
    places = [header.columns[name].index for name in numeric]
    rows = 0
    for line in _LINE_END.split(delimiter.join(cells)):
        parts = [part.strip().replace(",", ".") for part in line.split(delimiter)]
        if len(parts) >= header.width:
            numbers = [parts[place] for place in places if parts[place]]
            rows += bool(numbers) and all(number_text(one, False) is not None for one in numbers)
    return rows > 1
