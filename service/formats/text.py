"""Records of text to SI arrays: the part that CSV, XLSX and Parquet have in common.

A format gives numbered records of cells: a header, an optional row of units, then rows. They are
converted in pieces, so that a million rows are never in memory as text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np

from wrenchbook.service.formats.cells import (
    EITHER_MARK,
    Digits,
    decimal_mark,
    number_problem,
    number_text,
    quoted,
    text_problem,
    time_seconds,
    unguard_formula,
)
from wrenchbook.service.formats.columns import TEXTS, TIME_COLUMN
from wrenchbook.service.formats.header import Header, HeaderColumn, read_head
from wrenchbook.service.formats.options import FoundColumn, Mistakes, Options, ReadReport
from wrenchbook.service.formats.preamble import Record
from wrenchbook.service.formats.rows import Array, ParsedTable, good_rows
from wrenchbook.service.formats.units import to_si, vanished
from wrenchbook.surrogate.table.rows import unknown_column

PIECE = 20_000  # rows as text at once: 30 MB of Python objects

RecordCheck = Callable[[list[str], Header], str]
"""Returns what is wrong with the cells of a record; an empty text if nothing is."""


class BrokenLineError(ValueError):
    """A record cannot be read, so what follows has no meaning; `line` is its beginning."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True)
class CellFormat:
    """How the cells of a file are written.

    Attributes
    ----------
    comma : bool
        Whether the decimal mark is a comma.
    ambiguous : tuple of (int, str, str), or None
        Line, column and text of a number if all numbers leave the mark open.
    declared : bool
        Whether the sender declared the decimal mark.
    guarded : bool
        Whether a text that looks like a formula has a ``'`` before it.
    """

    comma: bool = False
    ambiguous: tuple[int, str, str] | None = None
    declared: bool = False
    guarded: bool = False


@dataclass
class TextRows:
    """Rows of a piece: their lines, and their cells, one a column of the header."""

    line: list[int] = field(default_factory=list)
    cells: list[list[str]] = field(default_factory=list)


def read_records(
    records: Iterator[Record],
    options: Options,
    report: ReadReport,
    check: RecordCheck = lambda _cells, _header: "",
    cell_format: CellFormat | None = None,
) -> Iterator[ParsedTable]:
    """Yield the good rows of a table of columns, piece by piece.

    Parameters
    ----------
    records : iterator of Record
    options : Options
    report : ReadReport
        Gets the columns and the mistakes.
    check : callable
        Checks the cells of each record.
    cell_format : CellFormat or None
        None in a format that stores numbers as such: there the texts of the first piece that are
        numbers decide, and a point is a decimal one where none of them has a comma.
    """
    mistakes = report.mistakes
    if cell_format is None and options.decimal is not None:
        cell_format = CellFormat(options.decimal == ",", declared=True)
    elif cell_format is None:
        first = list(islice(until_broken(records, mistakes), PIECE))
        cell_format = format_in((item for item in first), options)
        cell_format = cell_format if cell_format.comma else CellFormat()
        records = chain(first, records)
    header, rest = read_head(until_broken(records, mistakes), options)
    report.columns += [FoundColumn(c.label, c.name, c.unit) for c in header.columns.values()]
    report.ignored += header.ignored
    report.titles += header.titles
    for mistake in header.mistakes:
        mistakes.ruin(mistake.row, mistake.field, mistake.message)
    if cell_format.ambiguous is not None and not header.mistakes:
        line, label, cell = cell_format.ambiguous
        mistakes.ruin(line, label, _ambiguity(cell))
    if mistakes.whole:
        return
    for rows, count in text_pieces(rest, header, mistakes, check):
        report.read += count
        if rows.line:
            yield _Conversion(header, rows, cell_format, options, mistakes).table(report)
        if report.is_beyond_limits():
            return
    if not report.read and not mistakes:
        mistakes.ruin(0, "file", "there is a header but no row below it")


def format_in(records: Iterator[Record], options: Options) -> CellFormat:
    """Return the decimal mark of the first piece with a number that leaves no doubt."""
    mistakes = Mistakes()
    header, rest = read_head(until_broken(records, mistakes), options)
    if header.mistakes:
        return CellFormat()
    ambiguous: tuple[int, str, str] | None = None
    for rows, _ in text_pieces(rest, header, mistakes, lambda _cells, _header: ""):
        sure, doubtful = _marks(rows, header)
        ambiguous = ambiguous or doubtful
        if sure:
            # One decimal comma makes the comma the file's mark; a point is then a mistake.
            return CellFormat("," in sure)
    return CellFormat("," in ambiguous[2], ambiguous) if ambiguous else CellFormat()


def _marks(rows: TextRows, header: Header) -> tuple[set[str], tuple[int, str, str] | None]:
    """Return the marks that are decimal ones, and line, label and text of a number in doubt."""
    sure: set[str] = set()
    doubtful = None
    for name, column in header.columns.items():
        if name in TEXTS:
            continue
        for line, cells in zip(rows.line, rows.cells, strict=True):
            cell = cells[column.index] if len(cells) > column.index else ""
            text = "" if type(cell) is Digits else cell.strip()
            if EITHER_MARK.fullmatch(text):
                doubtful = doubtful or (line, column.label, text)
            elif mark := decimal_mark(text):
                sure.add(mark)
                if len(sure) == 2:
                    return sure, doubtful
    return sure, doubtful


def until_broken(records: Iterator[Record], mistakes: Mistakes) -> Iterator[Record]:
    """Yield the records before a broken one, which becomes a mistake of the file."""
    try:
        yield from records
    except BrokenLineError as error:
        mistakes.ruin(error.line, "line", str(error))


def text_pieces(
    records: Iterator[Record], header: Header, mistakes: Mistakes, check: RecordCheck
) -> Iterator[tuple[TextRows, int]]:
    """Yield the rows below a header in pieces, each with the number of its records."""
    rows, count = TextRows(), 0
    for line, cells in records:
        count += 1
        width = header.width
        if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
            cells = cells[:width]  # a spreadsheet's empty columns on the right
        if problem := check(cells, header) or _unnamed_problem(cells, header):
            mistakes.add(line, "line", problem)
        else:
            rows.line.append(line)
            rows.cells.append(cells)
        if count == PIECE:
            yield rows, count
            rows, count = TextRows(), 0
    if count:
        yield rows, count


def _ambiguity(cell: str) -> str:
    mark = "," if "," in cell else "."
    one, other = cell.replace(",", "."), cell.replace(mark, "")
    point = "." if mark == "," else ","
    return (
        f"'{cell}' is {one} or {other}, and no number in the file decides; say "
        f"decimal={mark} for {one}, decimal={point} for {other}"
    )


def _unnamed_problem(cells: list[str], header: Header) -> str:
    found = next(
        (index for index in header.unnamed if "".join(cells[index : index + 1]).strip()), None
    )
    if found is None:
        return ""
    return (
        f"has a value in column {found + 1}, which has no name in the header; name it, or "
        "leave it out with ignore_extra"
    )


class _Conversion:
    """Converts one piece of rows by column; collects mistakes and the mask of good rows."""

    def __init__(
        self,
        header: Header,
        rows: TextRows,
        cell_format: CellFormat,
        options: Options,
        mistakes: Mistakes,
    ) -> None:
        self._options, self._names = options, options.columns
        self._header = header
        self._line = rows.line
        self._format = cell_format
        self._mistakes = mistakes
        self._good = np.ones(len(rows.line), dtype=bool)
        self._columns = list(zip(*rows.cells, strict=True))

    def table(self, report: ReadReport) -> ParsedTable:
        """Return the good rows."""
        options, names = self._options, self._names
        wrench = self._block(names.wrench, missing=0.0)
        displacement = self._block(names.displacement, missing=np.nan)
        uncertainty, compliance, curvature = map(
            self._known, (names.uncertainty, names.compliance, names.curvature)
        )
        time = self._times() if options.role != "table" else None
        self._check_status()
        if options.role != "loads":
            self._check_measured(displacement)
        self._check_whole(compliance, names.compliance, "tangents")
        self._check_whole(curvature, names.curvature, "third derivatives")
        texts = [self._texts(name) for name in TEXTS]
        piece = ParsedTable(
            wrench,
            displacement,
            uncertainty,
            compliance.reshape(len(self._line), len(names.displacement), len(names.wrench)),
            *texts,
            row=np.array(self._line, dtype=np.int64),
            time=time,
            curvature=curvature if any(curvature.strides) else None,
        )
        return good_rows(piece, self._good, options, report)

    def _block(self, names: tuple[str, ...], missing: float) -> Array:
        """Return columns that belong together, shape (n, k), SI."""
        block = np.full((len(self._line), len(names)), missing)
        for index, name in enumerate(names):
            if name in self._header.columns:
                block[:, index] = self._numbers(self._header.columns[name])
        return block

    def _known(self, names: tuple[str, ...]) -> Array:
        """Return a block, NaN where unknown; of no memory if the file has none of its columns."""
        if any(name in self._header.columns for name in names):
            return self._block(names, missing=np.nan)
        return unknown_column(len(self._line), len(names))

    def _numbers(self, column: HeaderColumn) -> Array:
        """Convert a column at once if all cells are finite numbers, else cell by cell."""
        cells = self._columns[column.index]
        values = _finite_column(cells, self._format.comma, column)
        if values is None:
            values = np.array([self._number(column, at) for at in range(len(cells))])
        zeros = np.flatnonzero(values == 0.0).tolist()
        gone = {cell for cell in {cells[at] for at in zeros} if vanished(cell, 0.0)}
        for at in zeros if gone and not column.zero else ():
            if cells[at] in gone:
                message = f"{quoted(cells[at])} is too small a number and would become 0; write 0"
                self._refuse(at, column.label, message)
        if column.name in self._names.uncertainty:
            for at in np.flatnonzero(values < 0.0).tolist():
                message = f"{quoted(cells[at])}: an uncertainty is not negative"
                self._refuse(at, column.label, message)
        return values

    def _number(self, column: HeaderColumn, at: int) -> float:
        """Convert a cell; NaN and a mistake if it is not a finite number."""
        cell = self._columns[column.index][at]
        comma, cell = self._format.comma and type(cell) is not Digits, cell.strip()
        if not cell and column.name not in self._names.wrench:
            return np.nan  # not measured, or unknown
        text = number_text(cell, comma, self._format.declared)
        value = math.nan if text is None else to_si(text, column.factor, column.zero)
        if not math.isfinite(value):
            self._refuse(at, column.label, number_problem(cell, comma))
            return np.nan
        return value

    def _times(self) -> Array:
        """Return the times of the rows, shape (n,), s, from a sequence or a column of times."""
        sequence, rate = self._header.sequence, self._header.preamble.rate
        column = self._header.columns.get(TIME_COLUMN)
        if sequence is not None and rate:
            column = sequence
            cells = [cell.strip() for cell in self._columns[sequence.index]]
            values = np.array([_float(cell) for cell in cells]) / rate
        elif column is not None:
            cells, factor = self._columns[column.index], column.factor if column.unit else None
            comma = self._format.comma
            values = np.array(
                [time_seconds(c, comma and type(c) is not Digits, factor) for c in cells]
            )
        else:
            return np.full(len(self._line), np.nan)
        for at in np.flatnonzero(~np.isfinite(values)).tolist():
            message = f"{quoted(cells[at])} is no time; write seconds with time [s]"
            self._refuse(at, column.label, message)
        return values

    def _check_status(self) -> None:
        """Refuse readings that the sensor itself marks as bad."""
        column = self._header.status
        for at, cell in enumerate(self._columns[column.index] if column else ()):
            if column and cell.strip().lower().removeprefix("0x").strip("0"):
                message = f"the sensor's status is {quoted(cell)}, not 0: leave the row out"
                self._refuse(at, column.label, message)

    def _check_measured(self, displacement: Array) -> None:
        columns = self._header.columns
        for at in np.flatnonzero(np.isnan(displacement).all(axis=1)).tolist():
            if self._good[at]:
                names = [name for name in self._names.displacement if name in columns]
                labels = [columns[name].label for name in names]
                message = "no displacement is given; a row needs at least one"
                self._refuse(at, labels[0] if labels else "displacement", message)

    def _check_whole(self, block: Array, names: tuple[str, ...], what: str) -> None:
        missing = np.isnan(block)
        for at in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1)).tolist():
            if self._good[at]:
                name = names[int(np.argmax(missing[at]))]
                self._refuse(at, name, f"is missing; a row has all {len(names)} {what} or none")

    def _texts(self, name: str) -> tuple[str, ...]:
        """Return a column of texts; empty ones if the file has none."""
        column = self._header.columns.get(name)
        if column is None:
            return ("",) * len(self._line)
        cells = self._columns[column.index]
        for at, cell in enumerate(cells if text_problem("".join(cells)) else ()):
            if problem := text_problem(cell):
                self._refuse(at, column.label, problem)
        texts = [cell.strip() for cell in cells]
        return tuple(map(unguard_formula, texts) if self._format.guarded else texts)

    def _refuse(self, at: int, label: str, message: str) -> None:
        self._good[at] = False
        self._mistakes.add(self._line[at], label, message)


def _finite_column(cells: tuple[str, ...], comma: bool, column: HeaderColumn) -> Array | None:
    """Convert a column of finite numbers, shape (n,), SI; None if a cell is anything else."""
    joined = "".join(cells)
    if "_" in joined or not joined.isascii() or (comma and "." in joined):
        return None
    texts = [cell.replace(",", ".") for cell in cells] if comma else cells
    try:
        values = np.fromiter(map(float, texts), dtype=float, count=len(texts))
    except ValueError:
        return None
    if column.factor != 1 or column.zero:
        converted = (to_si(text, column.factor, column.zero) for text in texts)
        values = np.fromiter(converted, float, len(texts))
    return values if np.isfinite(values).all() else None


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
