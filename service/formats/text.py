"""Columns of numbers and texts to SI arrays: the part that all tables of columns share.

A format gives a header, an optional row of units, then rows in pieces: for each column an array of
float64, NaN where empty, or its cells as text. Only CSV, XLSX and JSON bring numbers as text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np

from wrenchbook.service.formats.cells import (
    EITHER_MARK,
    Digits,
    cell_text,
    decimal_mark,
    number_problem,
    number_text,
    quoted,
    text_problem,
    time_seconds,
    underflows,
    unguard_formula,
)
from wrenchbook.service.formats.columns import TEXTS, TIME_COLUMN
from wrenchbook.service.formats.header import (
    Header,
    HeaderColumn,
    Record,
    is_second_header,
    read_head,
)
from wrenchbook.service.formats.limits import check_limits
from wrenchbook.service.formats.options import (
    Array,
    Mistakes,
    Options,
    ParsedTable,
    ReadReport,
    is_corrected,
    picked,
)
from wrenchbook.service.formats.units import scaled
from wrenchbook.surrogate.table.rows import unknown_column

PIECE = 20_000  # rows as text at once: 30 MB of Python objects

MAX_NAME = 1000  # characters of a source or a fingerprint: for 20,000 rows 80 MB
_LONG_NAME = f"is longer than {MAX_NAME:,} characters; shorten it, or move the text to note"
_UNNAMED = (
    "has a value in column {}, which has no name in the header; name the column, or skip it with "
    "ignore_extra (--ignore-extra)"
)
_SECOND_HEADER = (
    "is a second header or row of units, so the rows below may have other units; remove the line "
    "if they are the same, else send these rows as a file of their own"
)
# Returns the mistake in the cells of a record; an empty text if there is none.
RecordCheck = Callable[[list[str], Header], str]
# A column of a piece: float64, NaN where empty, or the text of each cell.
Cells = Array | Sequence[str]


class BrokenLineError(ValueError):
    """A record cannot be read, so that the following text has no meaning; `line`: its beginning."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


class AmbiguousCell(NamedTuple):
    """A number that may have a decimal or a thousands mark, with its line and column."""

    line: int
    label: str
    text: str


@dataclass(frozen=True)
class CellFormat:
    """The form of a file's cells.

    `comma`: the decimal mark is a comma; `declared`: the sender has stated the mark. `ambiguous` is
    a number of the file if all its numbers leave the mark open. `guarded`: a text that looks like a
    formula has a ``'`` before it.
    """

    comma: bool = False
    ambiguous: AmbiguousCell | None = None
    declared: bool = False
    guarded: bool = False


@dataclass
class Piece:
    """Some rows: their positions in the file, their columns, and the number of their records."""

    row: Sequence[int] | Array
    columns: Sequence[Cells]
    read: int


def read_records(
    records: Iterator[Record],
    options: Options,
    report: ReadReport,
    cell_format: CellFormat | None = None,
) -> Iterator[ParsedTable]:
    """Yield the good rows of records of text, in which a `Digits` is a stored number."""
    header, rest = read_head(records, options)

    def check(cells: list[str], header: Header) -> str:
        cells += [""] * (header.width - len(cells))
        wide = len(cells) > header.width
        return f"has {len(cells)} cells, but the header {header.width}; remove some" if wide else ""

    pieces = text_pieces(rest, header, options, report.mistakes, check)
    yield from read_pieces(header, pieces, options, report, cell_format)


def read_columns(
    typed: Iterable[tuple[Sequence[str], Sequence[Any]]], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the good rows of columns with labels: arrays of numbers, all else as text."""
    pieces = ((labels, list(map(_cells, labels, columns))) for labels, columns in typed)
    labels, first = next(pieces, ((), ()))
    columns = [column for column in first if len(column)]
    row = [Digits(cells[0]) if isinstance(cells, np.ndarray) else cells[0] for cells in columns]
    records: list[Record] = [(0, list(labels)), (1, row)]
    header, rest = read_head(iter(records if row else records[:1]), options)
    skipped = int(bool(row) and next(rest, None) is None)  # a row of units

    def numbered() -> Iterator[Piece]:
        end = 0
        for _, columns in chain([(labels, first)], pieces):
            start = end
            end = end + len(next(iter(columns), ()))
            skip = max(skipped - start, 0)
            cells = [column[skip:] for column in columns]
            yield Piece(range(start + skip + 1, end + 1), cells, end - start)

    yield from read_pieces(header, numbered() if row else iter(()), options, report)


def _cells(label: str, column: Any) -> Cells:
    """Return a column as float64 (n,) if it is an array of numbers, else as texts."""
    if isinstance(column, np.ndarray) and column.dtype.kind in "iuf":
        return column.astype(np.float64)
    values = column.tolist() if isinstance(column, np.ndarray) else column
    return [cell_text(value, label) for value in values]


def read_pieces(
    header: Header,
    pieces: Iterator[Piece],
    options: Options,
    report: ReadReport,
    cell_format: CellFormat | None = None,
) -> Iterator[ParsedTable]:
    """Yield the good rows of pieces below a header; without `cell_format` the first decides."""
    mistakes = report.mistakes
    _report_header(header, report)
    if mistakes.is_ruined:
        return
    for piece in pieces:
        cell_format = cell_format or _stored_format(piece, header, options)
        if cell_format.ambiguous is not None:
            _refuse_ambiguous(cell_format.ambiguous, mistakes)
            return
        report.read += piece.read
        if len(piece.row):
            yield _Conversion(header, piece, cell_format, options, mistakes).table(report)
        if report.is_beyond_limits():
            return
    if report.read or mistakes:
        return
    if header.named:
        mistakes.ruin(0, "file", "there is no row below the header; add one")
    else:
        mistakes.ruin(0, "rows", "there is no row; add one")


def _report_header(header: Header, report: ReadReport) -> None:
    """Add a header's columns, titles and mistakes to the report of its file."""
    columns = header.columns.values()
    report.labels |= {column.name: column.label for column in columns}
    if header.named:
        report.columns += [(column.label, column.name, column.unit) for column in columns]
    report.converted |= any(column.factor != 1.0 or column.zero for column in columns)
    report.ignored += header.ignored
    report.titles += header.titles
    for mistake in header.mistakes:
        report.mistakes.ruin(mistake.row, mistake.field, mistake.message)


def _refuse_ambiguous(ambiguous: AmbiguousCell, mistakes: Mistakes) -> None:
    """Refuse a file whose decimal mark is unknown."""
    cell = ambiguous.text
    mark, point = (",", ".") if "," in cell else (".", ",")
    fraction = cell.replace(",", ".")
    thousands = cell.replace(mark, "")
    message = (
        f"'{cell}' may mean {fraction} or {thousands}, and no other number shows which; set "
        f"decimal={mark} (--decimal {mark}) for {fraction}, or decimal={point} for {thousands}"
    )
    mistakes.ruin(ambiguous.line, ambiguous.label, message)


def _stored_format(piece: Piece, header: Header, options: Options) -> CellFormat:
    """Return the format of texts beside stored numbers: a point is decimal if none has a comma."""
    if options.decimal is not None:
        return CellFormat(options.decimal == ",", declared=True)
    sure, ambiguous = _marks(piece, header)
    if sure or ambiguous is None or "," not in ambiguous.text:
        return CellFormat("," in sure)
    return CellFormat(comma=True, ambiguous=ambiguous)


def format_in(records: Iterator[Record], options: Options) -> CellFormat:
    """Return the decimal mark of the first piece with an unambiguous number."""
    mistakes = Mistakes()
    header, rest = read_head(until_broken(records, mistakes), options)
    if header.mistakes:
        return CellFormat()
    first: AmbiguousCell | None = None
    for piece in text_pieces(rest, header, options, mistakes):
        sure, ambiguous = _marks(piece, header)
        first = first or ambiguous
        if sure:
            # One decimal comma makes the comma the file's mark; a point is then a mistake.
            return CellFormat("," in sure)
    return CellFormat("," in first.text, first) if first else CellFormat()


def _marks(piece: Piece, header: Header) -> tuple[set[str], AmbiguousCell | None]:
    """Return the unambiguous decimal marks, and the first ambiguous number."""
    sure: set[str] = set()
    ambiguous = None
    for name, column in header.columns.items():
        cells = piece.columns[column.index] if len(piece.row) else ()
        if name in TEXTS or isinstance(cells, np.ndarray):
            continue
        for line, cell in zip(piece.row, cells, strict=False):
            text = "" if type(cell) is Digits else cell.strip()
            if EITHER_MARK.fullmatch(text):
                ambiguous = ambiguous or AmbiguousCell(int(line), column.label, text)
            elif mark := decimal_mark(text):
                sure.add(mark)
                if len(sure) == 2:
                    return sure, ambiguous
    return sure, ambiguous


def until_broken(records: Iterator[Record], mistakes: Mistakes) -> Iterator[Record]:
    """Yield the records before a broken one, which becomes a mistake of the file."""
    try:
        yield from records
    except BrokenLineError as error:
        mistakes.ruin(error.line, "line", str(error))


def text_pieces(
    records: Iterator[Record],
    header: Header,
    options: Options,
    mistakes: Mistakes,
    check: RecordCheck | None = None,
) -> Iterator[Piece]:
    """Yield the rows below a header in pieces; without `check` short ones are filled up."""
    width = header.width
    while block := list(islice(records, PIECE)):
        lines: list[int] = []
        rows: list[list[str]] = []
        for line, cells in block:
            if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
                cells = cells[:width]  # a spreadsheet's empty columns on the right
            if check is None:
                cells = [*cells, *[""] * (width - len(cells))]
                cells = cells[:width]
            elif problem := check(cells, header) or _unnamed_value(cells, header):
                if is_second_header(cells, header, options):
                    mistakes.ruin(line, "line", _SECOND_HEADER)
                else:
                    mistakes.add(line, "line", problem)
                continue
            lines.append(line)
            rows.append(cells)
        yield Piece(lines, list(zip(*rows, strict=True)), len(block))


def _unnamed_value(cells: Sequence[str], header: Header) -> str:
    """Return the mistake of a value without a label in the header, else an empty text."""
    for index in header.unnamed:
        if index < len(cells) and cells[index].strip():
            return _UNNAMED.format(index + 1)
    return ""


class _Conversion:
    """Converts one piece of rows by column; collects mistakes and the mask of good rows."""

    def __init__(
        self,
        header: Header,
        piece: Piece,
        cell_format: CellFormat,
        options: Options,
        mistakes: Mistakes,
    ) -> None:
        self._options = options
        self._names = options.columns
        self._header = header
        self._format = cell_format
        self._mistakes = mistakes
        self._row = np.asarray(piece.row, dtype=np.int64)
        self._columns = piece.columns
        self._good = np.ones(len(self._row), dtype=bool)
        self._headers: set[int] = set()

    def table(self, report: ReadReport) -> ParsedTable:
        """Return the good rows."""
        options, names = self._options, self._names
        wrench = self._block(names.wrench, missing=0.0)
        displacement = self._block(names.displacement, missing=np.nan)
        uncertainty = self._block(names.uncertainty, missing=np.nan)
        compliance = self._block(names.compliance, missing=np.nan)
        curvature = self._block(names.curvature, missing=np.nan)
        time = self._times() if options.role != "table" else None
        if options.role == "loads":
            displacement = np.zeros(displacement.shape)  # those of the other log count

        self._check_status()
        if options.role != "loads":
            self._check_measured(displacement)
        self._check_complete(compliance, names.compliance, "tangents")
        self._check_complete(curvature, names.curvature, "third derivatives")

        shape = len(self._row), len(names.displacement), len(names.wrench)
        piece = {
            "seq": self._row,
            "wrench": wrench,
            "displacement": displacement,
            "compliance": compliance.reshape(shape),
            "curvature": curvature if any(curvature.strides) else np.empty((len(self._row), 0)),
            "uncertainty": uncertainty,
            "source": self._texts("source"),
            "fingerprint": self._texts("fingerprint"),
            "space": options.space,
            "note": self._texts("note").tolist(),
            "time": time,
        }
        if not is_corrected(options):
            self._good &= check_limits(piece, options, report)
        report.mistakes.trim()
        return ParsedTable(**picked(piece, self._good))

    def _check_status(self) -> None:
        """Refuse rows in which a sensor reports an error."""
        status = self._header.status
        if status is None:
            return
        for at, cell in enumerate(self._columns[status.index]):
            if str(cell).strip().lower().removeprefix("0x").strip("0"):
                message = f"the sensor's status is {quoted(str(cell))}, not 0; leave the row out"
                self._refuse(at, status.label, message)

    def _check_measured(self, displacement: Array) -> None:
        """Refuse rows without any displacement, shape (n, outputs)."""
        columns = self._header.columns
        labels = [columns[name].label for name in self._names.displacement if name in columns]
        unmeasured = np.logical_and.reduce([np.isnan(column) for column in displacement.T])
        for at in np.flatnonzero(unmeasured & self._good).tolist():
            message = "the row has no displacement; write at least one, or leave the row out"
            self._refuse(at, labels[0] if labels else "displacement", message)

    def _block(self, names: tuple[str, ...], missing: float) -> Array:
        """Return columns that belong together, shape (n, k), SI; without memory if all are NaN."""
        shape = len(self._row), len(names)
        columns = [self._header.columns.get(name) for name in names]
        numbers = [column and self._numbers(column) for column in columns]
        if np.isnan(missing) and all(n is None or np.isnan(n).all() for n in numbers):
            return unknown_column(*shape)
        block = np.full(shape, missing)
        for index, values in enumerate(numbers):
            if values is not None:
                block[:, index] = values
        return block

    def _numbers(self, column: HeaderColumn) -> Array:
        """Return a column, shape (n,), SI; at once if all cells are numbers, else cell by cell."""
        cells = self._columns[column.index]
        values = cells if isinstance(cells, np.ndarray) else _floats(cells, self._format.comma)
        if values is None:
            values = np.array([self._number(column, at) for at in range(len(cells))])
        elif not np.isfinite(values).all():
            empty = np.isnan(values) if column.name in self._names.wrench else False
            infinite = np.isinf(values)
            for at in np.flatnonzero(infinite | empty).tolist():
                self._refuse(at, column.label, number_problem(self._cell(column, at), comma=False))
            values = np.where(infinite, np.nan, values)  # no other limit reports it again
        converted = values
        if column.factor != 1.0 or column.zero:
            with np.errstate(over="ignore"):
                converted = scaled(values, column.factor)
            if column.zero:  # 0.1 K is -273.05 degC
                converted = np.round(converted + column.zero, 10)
        if converted is not values or not isinstance(cells, np.ndarray):
            self._refuse_lost(column, values, converted)
        if column.name in self._names.uncertainty:
            for at in np.flatnonzero(converted < 0.0).tolist():
                message = f"{quoted(self._cell(column, at))} must not be negative; write 0 or more"
                self._refuse(at, column.label, message)
        return converted

    def _refuse_lost(self, column: HeaderColumn, values: Array, converted: Array) -> None:
        """Refuse numbers that are too large or too small for a float, shapes (n,)."""
        cells = self._columns[column.index]
        for at in np.flatnonzero(np.isinf(converted) & np.isfinite(values)).tolist():
            message = f"{quoted(self._cell(column, at))} is too large for a float; correct it"
            self._refuse(at, column.label, message)
        zero = np.flatnonzero(converted == 0.0) if not column.zero else np.empty(0, dtype=int)
        if isinstance(cells, np.ndarray):
            zero = zero[values[zero] != 0.0]
        elif not any(map(underflows, {cells[at] for at in zero.tolist()})):
            zero = zero[:0]  # a file has many zeros, in few spellings
        for at in zero.tolist():
            if underflows(cell := self._cell(column, at)):
                message = f"{quoted(cell)} is too small for a float and would become 0; write 0"
                self._refuse(at, column.label, message)

    def _cell(self, column: HeaderColumn, at: int) -> str:
        """Return a cell as the file writes it, empty for NaN in an array."""
        cell = self._columns[column.index][at]
        if isinstance(cell, str):
            return cell.strip()
        return "" if math.isnan(cell) else repr(float(cell))

    def _number(self, column: HeaderColumn, at: int) -> float:
        """Return a cell's number in its unit; NaN and a mistake if it is not a finite number."""
        cell = self._columns[column.index][at]
        comma = self._format.comma and type(cell) is not Digits
        text = str(cell).strip()
        if not text and column.name not in self._names.wrench:
            return np.nan  # not measured, or unknown
        number = number_text(text, comma=comma, declared=self._format.declared)
        value = math.nan if number is None else float(number)
        if not math.isfinite(value):
            self._refuse(at, column.label, number_problem(text, comma=comma))
            return np.nan
        return value

    def _times(self) -> Array:
        """Return the times of the rows, shape (n,), s, from a sequence or a column of times."""
        sequence, rate = self._header.sequence, self._header.preamble.rate
        column = self._header.columns.get(TIME_COLUMN)
        factor = None
        if sequence is not None and rate:
            column = sequence
            factor = 1.0
        elif column is None:
            return np.full(len(self._row), np.nan)
        elif column.unit:
            factor = column.factor

        cells = self._columns[column.index]
        if isinstance(cells, np.ndarray):
            values = cells * (column.factor if factor is None else factor)
        else:
            comma = self._format.comma and column is not sequence
            seconds = [
                time_seconds(cell, factor, comma=comma and type(cell) is not Digits)
                for cell in cells
            ]
            values = np.array(seconds)

        for at in np.flatnonzero(~np.isfinite(values)).tolist():
            needed = "is not a number; correct it or leave the row out"
            if factor is None:
                needed = (
                    "is not a date and time; if it is a number, write its unit in the header or "
                    f"with mapping (--column '{column.label}=time [s]')"
                )
            self._refuse(at, column.label, f"{quoted(self._cell(column, at))} {needed}")
        return values / rate if column is sequence and rate else values

    def _check_complete(self, block: Array, names: tuple[str, ...], kind: str) -> None:
        """Refuse rows of a block, shape (rows, names), with some but not all cells empty."""
        if not any(block.strides):
            return
        missing = np.isnan(block)
        for at in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1)).tolist():
            if self._good[at]:
                name = names[int(np.argmax(missing[at]))]
                label = name if self._header.named else self._header.columns[name].label
                self._refuse(at, label, f"is missing; write all {len(names)} {kind} or none")

    def _texts(self, name: str) -> Array:
        """Return a column of texts, shape (n,); empty ones if the file has none."""
        column = self._header.columns.get(name)
        if column is None:
            return np.full(len(self._row), "")
        cells = self._columns[column.index]
        if isinstance(cells, np.ndarray):
            cells = [self._cell(column, at) for at in range(len(cells))]
        texts: dict[str, str] = {}
        for cell in dict.fromkeys(cells):
            texts[cell] = unguard_formula(cell.strip()) if self._format.guarded else cell.strip()
        wrong = {text: text_problem(text) for text in texts}
        if name != "note":  # an array of texts takes the memory of the longest for each
            wrong |= {text: _LONG_NAME for text in texts if len(text) > MAX_NAME}
        if any(wrong.values()):
            for at, cell in enumerate(cells):
                if problem := wrong[cell]:
                    self._refuse(at, column.label, problem)
            texts = {cell: "" if wrong[cell] else text for cell, text in texts.items()}
        return np.array([*map(texts.__getitem__, cells)], dtype=object if name == "note" else str)

    def _refuse(self, at: int, label: str, message: str) -> None:
        if self._good[at]:
            self._good[at] = False
            cells = [str(column[at]) if len(column) else "" for column in self._columns]
            if is_second_header(cells, self._header, self._options):
                self._headers.add(at)
                self._mistakes.ruin(int(self._row[at]), "line", _SECOND_HEADER)
        if at in self._headers:
            return  # not each of its cells
        self._mistakes.add(int(self._row[at]), label, message)


def _floats(cells: Sequence[str], comma: bool) -> Array | None:
    """Return a column, (n,), NaN where a cell is empty; None if a cell is no finite number."""
    joined = "".join(cells)
    if "_" in joined or not joined.isascii() or (comma and "." in joined):
        return None
    texts = [cell.replace(",", ".") for cell in cells] if comma else cells
    try:
        values = np.fromiter((float(text or "nan") for text in texts), float, len(texts))
    except ValueError:
        return None
    finite = np.isfinite(values).sum()
    return values if finite + texts.count("") == len(texts) else None
