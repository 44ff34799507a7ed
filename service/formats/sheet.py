"""Tables of columns, whatever they came from: numbered records of text in, SI arrays out.

A CSV, a sheet of a spreadsheet and a Parquet file differ in how their cells are found. From there
on they are one: a header, maybe a row of units, and rows, taken in pieces so that a million of them
never stand in memory as text.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain

from service.formats import header as head
from service.formats.columns import Columns
from service.formats.csvlines import BrokenLineError
from service.formats.decimalmark import evidence, plain
from service.formats.header import Header, labels_of
from service.formats.mistakes import Mistakes, RowError
from service.formats.options import FoundColumn, Options, Told
from service.formats.parsed import ParsedTable
from service.formats.preamble import Preamble
from service.formats.spelling import TIME_COLUMN, readings
from service.formats.titles import MOST_COLUMNS, below_titles, is_number
from service.formats.units import UnitError

# Rows as text at once: 30 MB as Python holds their fields, a hundredth of what a million would be.
PIECE = 20_000
_LINE_END = re.compile(r"\r\n|\r|\n")

Record = tuple[int, list[str]]
Checked = Callable[[list[str], Header], str]


@dataclass
class _Body:
    """The records below the header that have the right number of fields."""

    line: list[int] = field(default_factory=list)
    fields: list[list[str]] = field(default_factory=list)


@dataclass(frozen=True)
class Mark:
    """How a file's cells are written.

    Attributes
    ----------
    comma : bool
        Whether the decimal mark is a comma.
    open : tuple of (int, str, str), or None
        The number that leaves that open: its line, its column, its text.
    escaped : bool
        Whether texts that begin like a formula have a ``'`` before them.
    """

    comma: bool = False
    open: tuple[int, str, str] | None = None
    escaped: bool = False


def no_more_to_check(_fields: list[str], _header: Header) -> str:
    """Find nothing wrong with a record that has as many fields as the header."""
    return ""


def tables(
    records: Iterator[Record],
    options: Options,
    told: Told,
    mark: Mark,
    check: Checked = no_more_to_check,
) -> Iterator[ParsedTable]:
    """Yield the good rows of a table of columns, piece by piece.

    Parameters
    ----------
    records : iterator of (int, list of str)
        Where each stands in the file, and its cells.
    options : Options
    told : Told
        Gets the columns and the mistakes as they are found.
    mark : Mark
        The decimal mark.
    check : callable
        Says what is wrong with a record of the right length; an empty text if nothing is.
    """
    rest = _told(records, told.mistakes)
    header, rest = read_head(rest, options)
    told.columns = [
        FoundColumn(one.label, one.name, one.unit, one.factor) for one in header.columns.values()
    ]
    told.ignored, told.above = header.ignored, header.above
    if header.errors:
        for error in header.errors:
            told.mistakes.ruin(error)
        return
    if mark.open is not None:
        told.mistakes.ruin(_question(*mark.open))
        return
    for body, count in _pieces(rest, header, told.mistakes, check):
        told.read += count
        if body.line:
            columns = Columns(
                header, body.line, body.fields, told.mistakes, mark.comma, mark.escaped
            )
            yield columns.table(options)
        if told.is_beyond_limits():
            return
    if not told.read and not told.mistakes:
        told.mistakes.ruin(RowError(0, "file", "there is a header but no row below it"))


def decimal_mark(records: Iterator[Record], options: Options) -> Mark:
    """Tell the decimal mark from the numbers: as soon as a piece of the file has one for sure."""
    ignored = Mistakes()
    header, rest = read_head(_told(records, ignored), options)
    if header.errors:
        return Mark()
    doubtful: tuple[int, str, str] | None = None
    for body, _ in _pieces(rest, header, ignored, no_more_to_check):
        sure, doubt = _evidence(body, header)
        doubtful = doubtful or doubt
        if sure:
            # One decimal comma makes the comma the file's mark; a point beside it is then an error.
            return Mark("," in sure)
    return Mark("," in doubtful[2], doubtful) if doubtful else Mark()


def read_head(records: Iterator[Record], options: Options) -> tuple[Header, Iterator[Record]]:
    """Read what stands above the rows; return it and the records that are left."""
    preamble = Preamble()
    for line, fields in records:
        try:
            if preamble.take(fields):
                continue
        except ValueError as error:
            return Header(0, errors=[RowError(line, "line", str(error))]), records
        break
    else:
        message = "the file is empty" if not preamble else "there is no header"
        return Header(0, errors=[RowError(0, "file", message)]), records
    above, (line, fields), records = below_titles((line, fields), records, options.mapping)
    if any(cell.strip() for cell in fields[MOST_COLUMNS:]):
        message = f"names {len(fields):,} columns; a table has at most {MOST_COLUMNS}"
        return Header(0, errors=[RowError(line, "header", message)]), records
    if all(is_number(cell) for cell in fields if cell.strip()):
        message = (
            "there is no header; the first line must name the columns with units, such as "
            "fx [N], ux [mm] (a line that begins with # is a comment)"
        )
        return Header(0, errors=[RowError(line, "header", message)]), records
    below = next(records, None)
    units = below[1] if below and _is_units_row(labels_of(fields), below[1]) else None
    rest = records if units is not None or below is None else chain([below], records)
    found = head.read_header(fields, line, options, units, preamble)
    found.above = above
    return found, rest


def _is_units_row(labels: list[str], cells: list[str]) -> bool:
    """Tell a row of units below a header that lacks some from the first row of numbers."""
    if any(is_number(cell) for cell in cells if cell.strip()):
        return False
    return any(
        cell.strip() and _lacks_unit(label) for label, cell in zip(labels, cells, strict=False)
    )


def _lacks_unit(label: str) -> bool:
    try:
        found = list(readings(label))
    except UnitError:
        return False
    return any(not unit and name not in head.TEXTS for name, unit, _ in found)


def _told(records: Iterator[Record], mistakes: Mistakes) -> Iterator[Record]:
    """Yield the records up to one that cannot be read, and note that."""
    try:
        yield from records
    except BrokenLineError as error:
        mistakes.ruin(RowError(error.line, "line", str(error)))


def _pieces(
    records: Iterator[Record], header: Header, mistakes: Mistakes, check: Checked
) -> Iterator[tuple[_Body, int]]:
    """Yield the rows below the header, so many at once, with how many the file has of them."""
    body, count = _Body(), 0
    for line, fields in records:
        count += 1
        _take(body, header, mistakes, line, fields, check)
        if count == PIECE:
            yield body, count
            body, count = _Body(), 0
    if count:
        yield body, count


def _take(
    body: _Body, header: Header, mistakes: Mistakes, line: int, fields: list[str], check: Checked
) -> None:
    """Add a record to the body if it has as many fields as the header, and is one line's."""
    width = header.width
    if len(fields) > width and not any(cell.strip() for cell in fields[width:]):
        fields = fields[:width]  # a spreadsheet's empty columns on the right
    message = check(fields, header) or _below_blank(fields, header)
    if message:
        mistakes.append(RowError(line, "line", message))
    else:
        body.line.append(line)
        body.fields.append(fields)


def holds_rows(fields: list[str], header: Header, delimiter: str) -> bool:
    """Tell whether two lines of a record are rows by themselves: its quote has swallowed some.

    A text of several lines leaves one such line at most, the one that its numbers stand on.
    """
    places = [column.place for name, column in header.columns.items() if name in head.NUMBERS]
    rows = 0
    for line in _LINE_END.split(delimiter.join(fields)):
        cells = [cell.strip().replace(",", ".") for cell in line.split(delimiter)]
        if len(cells) >= header.width:
            numbers = [cells[place] for place in places if cells[place]]
            rows += bool(numbers) and all(plain(number, False) is not None for number in numbers)
    return rows > 1


def _evidence(body: _Body, header: Header) -> tuple[set[str], tuple[int, str, str] | None]:
    """Return the marks that are surely decimal ones, and a number whose mark may be either."""
    sure: set[str] = set()
    doubtful = None
    for name, column in header.columns.items():
        if name not in head.NUMBERS and name != TIME_COLUMN:
            continue
        cells = [fields[column.place] for fields in body.fields if len(fields) > column.place]
        marks, doubt = evidence(cell for cell in cells if cell)
        sure |= marks
        if doubt and doubtful is None:
            at = next(at for at, cell in enumerate(cells) if cell.strip() == doubt)
            doubtful = body.line[at], column.label, doubt
    return sure, doubtful


def _question(line: int, label: str, doubtful: str) -> RowError:
    """Ask which number is meant where the mark is a decimal one or parts thousands."""
    mark = "," if "," in doubtful else "."
    one, other = doubtful.replace(",", "."), doubtful.replace(mark, "")
    message = (
        f"'{doubtful}' is {one} or {other}, and no number in the file tells which; say "
        f"decimal={mark} for {one}, or write {other} without the mark"
    )
    return RowError(line, label, message)


def _below_blank(fields: list[str], header: Header) -> str:
    """Say that a value stands below no name; an empty text if none does."""
    found = next((place for place in header.blank if fields[place].strip()), None)
    if found is None:
        return ""
    return (
        f"has a value in column {found + 1}, which has no name in the header; name it, or "
        "leave it out with ignore_extra"
    )
