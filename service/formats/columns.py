"""The columns of a CSV table: from fields to SI arrays, with every bad field named."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np

from service.formats import header as head
from service.formats.clock import seconds
from service.formats.decimalmark import plain, shown, why
from service.formats.exact import to_si, vanished
from service.formats.header import Column, Header
from service.formats.limits import excesses
from service.formats.mistakes import Mistakes, RowError
from service.formats.options import Options
from service.formats.parsed import Array, ParsedTable, text_problem
from service.formats.sheettext import unguarded
from service.formats.spelling import TIME_COLUMN
from surrogate.table.rows import unknown_column


class Columns:
    """The lines of one file by column; collects errors and the rows they spoil.

    Parameters
    ----------
    header : Header
    line : list of int
        Where each row stands in the file.
    fields : list of list of str
        As many a row as the header has columns.
    mistakes : Mistakes
        What is wrong so far; grows.
    comma : bool
        Whether the decimal mark is a comma.
    escaped : bool
        Whether a text that a spreadsheet would take for a formula has a ``'`` before it.
    """

    def __init__(
        self,
        header: Header,
        line: list[int],
        fields: list[list[str]],
        mistakes: Mistakes,
        comma: bool = False,
        escaped: bool = False,
    ) -> None:
        self._header = header
        self._line = line
        self._mistakes = mistakes
        self._good = np.ones(len(line), dtype=bool)
        self._comma = comma
        self._escaped = escaped
        self._fields = fields
        cells = list(zip(*fields, strict=True)) or [()] * header.width
        self._cells: dict[str, tuple[str, ...]] = {
            name: cells[column.place] for name, column in header.columns.items()
        }

    def table(self, options: Options) -> ParsedTable:
        """Return the good rows; what is wrong with the others joins the mistakes."""
        wrench = self._block(head.WRENCH, missing=0.0)
        displacement = self._block(head.DISPLACEMENT, missing=np.nan)
        uncertainty = self._block(head.UNCERTAINTY, missing=np.nan)
        compliance = self._block(head.COMPLIANCE, missing=np.nan)
        time = self._time() if options.role != "table" else None
        self._check_status()
        if options.role != "loads":
            self._check_measured(displacement)
        self._check_tangents(compliance)
        # A reading without its tare may lie anywhere.
        if options.role == "table" and not options.tare:
            for excess in excesses(wrench, displacement, options.load_range, uncertainty):
                self._spoil(excess.at, self._header.columns[excess.name].label, excess.message)
        for name in head.TEXTS:
            self._check_texts(name)
        good = self._good
        return ParsedTable(
            wrench=wrench[good],
            displacement=displacement[good],
            uncertainty=self._known(uncertainty, head.UNCERTAINTY, 6),
            compliance=self._known(compliance, head.COMPLIANCE, 6, 6),
            source=self._texts("source"),
            note=self._texts("note"),
            fingerprint=self._texts("fingerprint"),
            row=np.array(self._line, dtype=np.int64)[good],
            errors=(),
            time=None if time is None else time[good],
        )

    def _block(self, names: tuple[str, ...], missing: float) -> Array:
        """Return shape (n, 6) or (n, 36), SI, of columns that belong together."""
        block = np.full((len(self._line), len(names)), missing)
        for index, name in enumerate(names):
            if name in self._header.columns:
                block[:, index] = self._numbers(self._header.columns[name])
        return block

    def _known(self, block: Array, names: tuple[str, ...], *shape: int) -> Array:
        """Return the good rows of a block; of one that the file has not, a column of no memory."""
        if not any(name in self._header.columns for name in names):
            return unknown_column(int(self._good.sum()), *shape)
        return block[self._good].reshape(-1, *shape)

    def _numbers(self, column: Column) -> Array:
        """Convert one column, fast when all of it is plain, field by field when not."""
        cells = self._cells[column.name]
        values = _all_at_once(cells, self._comma, column.factor)
        if values is None:
            values = np.array([self._number(column, at) for at in range(len(cells))])
        zeros = np.flatnonzero(values == 0.0).tolist()
        gone = {cell for cell in {cells[at] for at in zeros} if vanished(cell, 0.0)}
        for at in zeros if gone else ():
            if cells[at] in gone:
                message = f"{shown(cells[at])} is too small a number and would become 0; write 0"
                self._spoil(at, column.label, message)
        if column.name in head.UNCERTAINTY:
            for at in np.flatnonzero(values < 0.0).tolist():
                self._spoil(at, column.label, f"{shown(cells[at])}: an uncertainty is not negative")
        return values

    def _number(self, column: Column, at: int) -> float:
        """Convert one field; NaN and an error if it is not a finite number."""
        cell = self._cells[column.name][at].strip()
        if not cell and column.name not in head.WRENCH:
            return np.nan  # not measured, or not known
        text = plain(cell, self._comma)
        value = math.nan if text is None else to_si(text, column.factor)
        if not math.isfinite(value):
            self._spoil(at, column.label, why(cell, self._comma))
            return np.nan
        return value

    def _time(self) -> Array:
        """Return when each row was, s: a column of numbers or of clock times, or a sequence."""
        sequence, rate = self._header.sequence, self._header.preamble.rate
        column = self._header.columns.get(TIME_COLUMN)
        if sequence is not None and rate:
            cells, label = self._status_cells(sequence), sequence.label
            values = np.array([_plain_number(cell) for cell in cells]) / rate
        elif column is not None:
            cells, label = self._cells[TIME_COLUMN], column.label
            values = np.array(
                [
                    seconds(cell, self._comma, column.factor if column.unit else None)
                    for cell in cells
                ]
            )
        else:
            return np.full(len(self._line), np.nan)
        for at in np.flatnonzero(~np.isfinite(values)).tolist():
            self._spoil(at, label, f"{shown(cells[at])} is no time; write seconds with time [s]")
        return values

    def _status_cells(self, column: Column) -> list[str]:
        return [fields[column.place].strip() for fields in self._fields]

    def _check_status(self) -> None:
        """Refuse readings that the sensor itself says are not good."""
        column = self._header.status
        if column is None:
            return
        for at, cell in enumerate(self._status_cells(column)):
            if cell.lower().removeprefix("0x").strip("0"):
                message = f"the sensor's status is {shown(cell)}, not 0: leave the row out"
                self._spoil(at, column.label, message)

    def _check_measured(self, displacement: Array) -> None:
        for at in np.flatnonzero(np.isnan(displacement).all(axis=1)).tolist():
            if self._good[at]:
                label = next(
                    self._header.columns[name].label
                    for name in head.DISPLACEMENT
                    if name in self._header.columns
                )
                self._spoil(at, label, "no displacement is given; a row needs at least one")

    def _check_tangents(self, compliance: Array) -> None:
        missing = np.isnan(compliance)
        for at in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1)).tolist():
            if self._good[at]:
                name = head.COMPLIANCE[int(np.argmax(missing[at]))]
                message = "is missing; a row has all 36 tangents or none"
                self._spoil(at, name, message)

    def _check_texts(self, name: str) -> None:
        cells = self._cells.get(name, ())
        if text_problem("".join(cells)):
            for at, cell in enumerate(cells):
                problem = text_problem(cell)
                if problem:
                    self._spoil(at, self._header.columns[name].label, problem)

    def _texts(self, name: str) -> tuple[str, ...]:
        cells = self._cells.get(name) or ("",) * len(self._line)
        texts = [cell.strip() for cell, good in zip(cells, self._good, strict=True) if good]
        return tuple(map(unguarded, texts) if self._escaped and any(texts) else texts)

    def _spoil(self, at: int, label: str, message: str) -> None:
        self._good[at] = False
        self._mistakes.append(RowError(self._line[at], label, message))


def _all_at_once(cells: tuple[str, ...], comma: bool, factor: Decimal) -> Array | None:
    """Convert a column of plain finite numbers, or return None if a field is anything else."""
    joined = "".join(cells)
    if "_" in joined or not joined.isascii() or (comma and "." in joined):
        return None
    texts = [cell.replace(",", ".") for cell in cells] if comma else cells
    try:
        values = np.fromiter(map(float, texts), dtype=float, count=len(texts))
    except ValueError:
        return None
    if factor != 1:
        values = np.fromiter((to_si(text, factor) for text in texts), float, len(texts))
    return values if np.isfinite(values).all() else None


def _plain_number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
