"""CSV tables: encodings, delimiters, decimal marks, comments, and mistakes by line and column.

Fields are separated by ``,``, ``;``, tab, ``|`` or runs of blanks; with the latter four the decimal
mark may be a comma. If all marks in the numbers could separate thousands (``1,234``), the file is
refused: a guess could be wrong by a factor of 1000. Blank lines and comments (``#``) count in the
line numbers.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from wrenchbook.service.contract import counted
from wrenchbook.service.formats.cells import MAX_TEXT, ContentError, guard_formula, number_text
from wrenchbook.service.formats.columns import TEXTS, TIME_COLUMN, Layout, WritableRows
from wrenchbook.service.formats.header import Header, Record, delimiter_in, is_row, read_head
from wrenchbook.service.formats.options import Mistakes, Options, ParsedTable, ReadReport
from wrenchbook.service.formats.preamble import Preamble
from wrenchbook.service.formats.text import (
    BrokenLineError,
    CellFormat,
    Cells,
    Piece,
    format_in,
    read_pieces,
    text_pieces,
    until_broken,
)

MAX_LINE = 1 << 20  # characters of a line; 54 numbers and three texts are some thousands
MAX_RECORD = 4 * MAX_LINE  # characters of a record: a quoted text may have many lines
MAX_BLANK = 1 << 20  # consecutive blank lines: a spreadsheet has no more lines at all
_BLOCK = 1 << 22  # bytes: 25,000 rows
_MAX_HEAD = 200  # lines in which the header must be
_LONG_ZERO = b"0" * 290  # a number with so many zeros may be too small for a float

_SEPARATOR_LINE = re.compile(r'"?sep=(?P<mark>[,;\t|])"?[,;\t]*\s*', re.IGNORECASE)
# A line with a spreadsheet's error value is a row with a mistake, not a comment.
_SHEET_ERROR = re.compile(
    r"#(N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!|NV|WERT!|BEZUG!|ZAHL!)", re.IGNORECASE
)
_IN_BRACKETS = re.compile(r"\[[^\]]*\]|\([^)]*\)|\"[^\"]*\"")
_MARKS = re.compile(r"[;,|\t]")
# A cell between blanks: Load [N], "Load cell".
_BLANK_CELL = re.compile(r'(?:"[^"]*"|[^\s"]+)(?:\s*[\[(][^\])]*[\])])?')
_LINE_END = re.compile(r"\r\n|\r|\n")
_NO_CSV = (
    "cannot be read as CSV ({}); close open quotation marks, and write a quotation mark within a "
    "quoted text twice"
)


def read_csv(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a CSV file in pieces; mistakes are added to `report`."""
    try:
        encoding = encoding_of(path)
        with path.open("rb") as content:
            delimiter = _delimiter(lines_of(content, encoding), options)
        with path.open("rb") as content:
            rows = filter(is_row, map(str.split, lines_of(content, encoding)))
            width = len(next(rows, ())) if delimiter == " " else 0  # cells between blanks
    except BrokenLineError as error:
        report.mistakes.ruin(error.line, "line", str(error))
        return
    except ValueError as error:
        report.mistakes.ruin(0, "file", str(error))
        return

    def records(content: BinaryIO) -> Iterator[Record]:
        all_records = records_of(lines_of(content, encoding), 1, delimiter, width)
        for line, cells in islice(all_records, 1):  # spreadsheets write a line sep=; first
            is_whole = _SEPARATOR_LINE.fullmatch(delimiter.join(cells))
            is_split = cells[0].lower() in ("sep=", '"sep=') and cells[1:] and not any(cells[1:])
            if not (is_whole or is_split):
                yield line, cells
        yield from all_records

    cell_format = CellFormat(options.decimal == ",", declared=options.decimal is not None)
    if options.decimal is None and delimiter != ",":
        with path.open("rb") as content:
            cell_format = format_in(records(content), options)
    cell_format = replace(cell_format, guarded=True)
    with path.open("rb") as content:
        header, rest = read_head(until_broken(records(content), report.mistakes), options)
        first = next(rest, None)
    with path.open("rb") as content:
        mark = "," if cell_format.comma else "."
        body = _Body(content, encoding, delimiter, header, mark, options, report.mistakes)
        pieces = body.pieces(first[0]) if first else iter(())
        yield from read_pieces(header, pieces, options, report, cell_format)


class _ArrowColumns(NamedTuple):
    """Indices of the columns that Arrow reads: as numbers, loads first, and as texts."""

    numbers: list[int]
    texts: list[int]
    loads: int  # the first columns of `numbers`, which have no empty cells


@dataclass(frozen=True)
class _Body:
    """The rows of a CSV file in pieces: by Arrow, or line by line where Arrow cannot read them.

    Arrow reads blocks of plain rows of numbers with the file's decimal mark. Blocks with blank
    lines, comments, empty or wrong cells are read line by line, so that messages have the same line
    numbers, and so is the rest after the first quotation mark that is not around a field of one
    line: a quoted text may continue in the next block.
    """

    content: BinaryIO
    encoding: str
    delimiter: str
    header: Header
    mark: str  # the decimal mark
    options: Options
    mistakes: Mistakes

    def pieces(self, line: int) -> Iterator[Piece]:
        """Yield the rows from a line on."""
        head = b"".join(self.content.readline(MAX_LINE) for _ in range(line - 1))
        by_line = self.delimiter == " " or self.encoding == "utf-16"
        if by_line or head.count(b"\r") != head.count(b"\r\n"):
            self.content.seek(0)
            lines = islice(lines_of(self.content, self.encoding), line - 1, None)
            yield from self._by_line(lines, line)
            return
        mark = re.escape(self.delimiter.encode())
        quoted = rb'(?:^|[%b\n])"[^"\r\n]*"(?=[%b\r\n])' % (mark, mark)
        while block := self.content.read(_BLOCK):
            end = self.content.readline(MAX_LINE)
            block += end
            quotes = block.count(b'"')
            is_open = quotes and quotes != 2 * len(re.findall(quoted, block + b"\n"))
            if is_open or len(end) == MAX_LINE:
                self.content.seek(-len(block), io.SEEK_CUR)
                yield from self._by_line(lines_of(self.content, self.encoding, line), line)
                return
            block = block if block.endswith(b"\n") else block + b"\n"
            count = block.count(b"\n")
            piece = self._by_arrow(block, line, count)
            if piece is None:
                yield from self._by_line(lines_of(io.BytesIO(block), self.encoding, line), line)
            else:
                yield piece
            line += count

    def _by_line(self, lines: Iterator[str], line: int) -> Iterator[Piece]:
        records = records_of(lines, line, self.delimiter, self.header.width)
        records = until_broken(records, self.mistakes)
        check = partial(_record_problem, delimiter=self.delimiter)
        yield from text_pieces(records, self.header, self.options, self.mistakes, check)

    def _by_arrow(self, block: bytes, line: int, count: int) -> Piece | None:
        """Return a block of whole lines; None if it has more than plain rows of numbers."""
        columns = self._arrow_columns()
        table = self._arrow_table(block, columns)
        if table is None or table.num_rows != count:  # blank lines, carriage returns
            return None
        split = len(columns.numbers)
        numbers = np.stack([column.to_numpy() for column in table.columns[:split]])
        if not np.isfinite(numbers).all():
            missing = np.isnan(numbers)
            nulls = sum(column.null_count for column in table.columns[:split])
            wrong = np.isinf(numbers).any() or missing.sum() != nulls  # "nan" is no empty cell
            if wrong or missing[: columns.loads].any() or missing.all(axis=0).any():
                return None
        if (numbers == 0.0).any() and _may_vanish(block):
            return None
        cells: list[Cells] = [()] * self.header.width
        for index, values in zip(columns.numbers, numbers, strict=True):
            cells[index] = values
        for index, column in zip(columns.texts, table.columns[split:], strict=True):
            cells[index] = values = column.to_pylist()
            unnamed = index in self.header.unnamed and any(values)
            if unnamed or len(max(values, key=len)) > MAX_TEXT:
                return None
        return Piece(range(line, line + count), cells, count)

    def _arrow_columns(self) -> _ArrowColumns:
        """Return the columns of numbers and of texts; a time without a unit is a clock time."""
        columns = self.header.columns.values()
        texts = [column.index for column in columns if not column.unit]
        logged = (self.header.status, self.header.sequence)
        texts += [column.index for column in logged if column]
        texts += self.header.unnamed
        loads = [column.index for column in columns if column.name in self.options.columns.wrench]
        more = [column.index for column in columns if column.index not in (*texts, *loads)]
        return _ArrowColumns(loads + more, texts, len(loads))

    def _arrow_table(self, block: bytes, columns: _ArrowColumns) -> Any:
        """Return a block as an Arrow table, None if Arrow cannot read it as `_by_line` does."""
        # Imported on first use, as it takes 0.5 s and 60 MB.
        from pyarrow import csv as arrow_csv

        marked = b"\0" in block or (b"#" in block and b"\n#" in b"\n" + block)
        marked |= b"\r" in block and block.count(b"\r") != block.count(b"\r\n")
        is_known = self.encoding == "utf-8-sig" or block.isascii()
        if marked or not is_known or not columns.numbers:
            return None
        types = dict.fromkeys(map(str, columns.numbers), "double")
        types |= dict.fromkeys(map(str, columns.texts), "string")
        try:
            return arrow_csv.read_csv(
                io.BytesIO(block),
                arrow_csv.ReadOptions(
                    use_threads=False,
                    block_size=2 * len(block),
                    column_names=[str(index) for index in range(self.header.width)],
                ),
                arrow_csv.ParseOptions(delimiter=self.delimiter, double_quote=False),
                arrow_csv.ConvertOptions(
                    column_types=types,
                    include_columns=[str(index) for index in columns.numbers + columns.texts],
                    null_values=[""],
                    strings_can_be_null=False,
                    decimal_point=self.mark,
                ),
            )
        except (OSError, ValueError):  # Arrow's errors are ValueErrors
            return None


def _may_vanish(block: bytes) -> bool:
    """Return whether a number of a block may be too small for a float: 1e-400."""
    codes = np.frombuffer(block + bytes(5), dtype=np.uint8)
    letters = b"eE" if b"E" in block else b"e"
    exponent = np.concatenate([np.flatnonzero(codes == letter) for letter in letters])
    exponent = exponent[codes[exponent + 1] == ord("-")]
    for step in (2, 3, 4):
        exponent = exponent[codes[exponent + step] - ord("0") < 10]
    return bool(len(exponent)) or _LONG_ZERO in block


def csv_text(
    pieces: Iterable[WritableRows], layout: Layout, comments: Iterable[str] = ()
) -> Iterator[str]:
    """Yield the text of a CSV: comments, header and rows; formulas get a ``'`` before them."""
    for comment in comments:
        yield "# " + " ".join(comment.split()) + "\n"
    out = _Lines()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(layout.labels())
    yield out.pop_text()
    for piece in pieces:
        numbers = [column.digits(piece) for column in layout.numbers]
        texts = [map(guard_formula, column) for column in layout.text_columns(piece)]
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


def encoding_of(path: Path) -> str:
    """Return a file's encoding: utf-8-sig, utf-16 (with a mark) or cp1252; raises ContentError."""
    with path.open("rb") as content:
        head = content.read(4)
        if head.startswith(b"PK\x03\x04"):
            raise ContentError("is a zip file, not an XLSX workbook; unpack it and send the table")
        utf16 = head.startswith((b"\xff\xfe", b"\xfe\xff"))
        encodings = ["utf-16"] if utf16 else ["utf-8-sig", "cp1252"]
        for encoding in encodings:
            content.seek(0)
            decoder = codecs.getincrementaldecoder(encoding)()
            try:
                while block := content.read(_BLOCK):
                    # Three times as fast as decoding; a character may continue in the next block.
                    if utf16 or decoder.getstate()[0] or not block.isascii():
                        decoder.decode(block)
                decoder.decode(b"", final=True)
            except UnicodeDecodeError:
                continue
            return encoding
    second = "UTF-16, as its mark says" if utf16 else "Windows-1252"
    raise ContentError(
        f"has an unknown text encoding: it is neither UTF-8 nor {second}; save the file as UTF-8"
    )


def lines_of(content: BinaryIO, encoding: str, number: int = 1) -> Iterator[str]:
    """Yield lines with their ends (LF, CR or both) from `number` on; raises BrokenLineError."""
    with io.TextIOWrapper(content, encoding=encoding, newline="") as text:
        while line := text.readline(MAX_LINE):
            if len(line) >= MAX_LINE:
                message = f"is longer than {MAX_LINE:,} characters; end each row with a line break"
                raise BrokenLineError(number, message)
            yield line
            number += 1


def _delimiter(lines: Iterator[str], options: Options) -> str:
    """Return the delimiter from a ``sep=`` line, else from the header (see `delimiter_in`)."""
    for number, line in enumerate(lines, 1):
        _refuse_blank(number, number)
        separator = _SEPARATOR_LINE.fullmatch(line)
        if separator:
            return separator["mark"]
        if _may_be_header(line):
            rest = (below for below in islice(lines, _MAX_HEAD) if _may_be_header(below))
            return delimiter_in(chain([line], rest), _bare, options)
    return ","


def _bare(line: str) -> str:
    """Return a line without brackets, and quoted texts without delimiters."""
    return _IN_BRACKETS.sub(lambda m: _MARKS.sub(" ", m[0][1:-1]) if m[0][0] == '"' else "", line)


def _may_be_header(line: str) -> bool:
    if not line.strip() or _is_comment(line):
        return False
    try:
        return not Preamble().add([line.strip().strip('"')])
    except ValueError:
        return False


def _refuse_blank(count: int, line: int) -> None:
    """Refuse a file of blank lines: half a megabyte of gzip would take minutes to read."""
    if count > MAX_BLANK:
        raise BrokenLineError(
            line, f"comes after {MAX_BLANK:,} lines without a row; remove these lines"
        )


def _is_comment(line: str) -> bool:
    return line.startswith("#") and not _SHEET_ERROR.match(line)


def records_of(
    lines: Iterator[str], first: int, delimiter: str, width: int = 0
) -> Iterator[Record]:
    """Yield the line number, beginning at `first`, and the cells of each record with text.

    Between blanks records have `width` cells, or else single blanks in a text, or quotation marks.

    Raises BrokenLineError if a record cannot be read.
    """
    if delimiter == " ":
        yield from _blank_records(lines, first, width)
        return
    fresh = True
    length = 0

    def uncommented() -> Iterator[str]:
        # A comment begins at the start of a record, not inside a quoted text.
        nonlocal fresh, length
        for line in lines:
            begins = fresh
            fresh = False
            length = len(line) if begins else length + len(line)
            if length > MAX_RECORD:
                raise csv.Error(f"a record longer than {MAX_RECORD:,} characters")
            yield "\n" if begins and _is_comment(line) else line

    # If not strict, an open quotation mark would take the lines below into its field without an
    # error.
    reader = csv.reader(uncommented(), delimiter=delimiter, skipinitialspace=True, strict=True)
    before = row = first - 1
    try:
        for cells in reader:
            fresh = True
            line = before + 1
            before = first - 1 + reader.line_num
            if any(cell.strip() for cell in cells):
                row = before
                yield line, cells
            else:
                _refuse_blank(before - row, line)
    except csv.Error as error:
        raise BrokenLineError(before + 1, _NO_CSV.format(error)) from error


def _blank_records(lines: Iterator[str], first: int, width: int) -> Iterator[Record]:
    """Yield the records of lines whose `width` cells are separated by blanks, with line numbers."""
    before = first - 1
    for number, line in enumerate(lines, first):
        cells = line.split()
        if not cells or _is_comment(line):
            _refuse_blank(number - before, number)
            continue
        if len(cells) != width:
            apart = re.split(r"\s{2,}", line.strip())
            quoted = [cell.replace('"', "") for cell in _BLANK_CELL.findall(line)]
            cells = apart if len(apart) == width else quoted
        before = number
        yield number, cells


def _record_problem(cells: list[str], header: Header, delimiter: str) -> str:
    """Return the mistake of a record; an empty text if it has none."""
    width = header.width
    text = "".join(cells)
    broken = "\n" in text or "\r" in text
    if len(cells) != width:
        message = f"has {counted(len(cells), 'field')}, but the header has {width}; make both equal"
        if broken:
            message += ", and close open quotation marks"
        elif len(cells) > width and delimiter == ",":
            message += "; with decimal commas separate fields by ;, and quote notes with commas"
        return message
    if not broken:
        return ""
    # A text of several lines has the numbers of the row in at most one of them.
    columns = header.columns.values()
    numeric = [column.index for column in columns if column.name not in (*TEXTS, TIME_COLUMN)]
    rows = 0
    for line in _LINE_END.split(delimiter.join(cells)):
        parts = [part.strip().replace(",", ".") for part in line.split(delimiter)]
        numbers = [parts[at] for at in numeric if parts[at]] if len(parts) >= width else []
        if numbers and all(number_text(text, comma=False) is not None for text in numbers):
            rows += 1
    if rows > 1:
        return "a quoted text holds a whole row of the table; close the quotation mark"
    return ""
