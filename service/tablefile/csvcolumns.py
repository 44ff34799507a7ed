"""The columns of a CSV table: from fields to SI arrays, with every bad field named."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np

from service.tablefile import header as head
from service.tablefile.decimalmark import evidence, plain, shown, why
from service.tablefile.exact import to_si, vanished
from service.tablefile.header import Column, Header
from service.tablefile.limits import excesses
from service.tablefile.parsed import Array, ParsedTable, RowError, listed, text_problem
from surrogate.table.rows import LoadRange


class Columns:
    """The lines of one file by column; collects errors and the rows they spoil.

    Parameters
    ----------
    header : Header
    line : list of int
        Where each row stands in the file.
    fields : list of list of str
        As many a row as the header has columns.
    errors : list of RowError
        What is wrong so far; grows.
    """

    def __init__(
        self, header: Header, line: list[int], fields: list[list[str]], errors: list[RowError]
    ) -> None:
        self._header = header
        self._line = line
        self._errors = errors
        self._good = np.ones(len(line), dtype=bool)
        self._comma = False
        cells = list(zip(*fields, strict=True)) or [()] * header.width
        self._cells: dict[str, tuple[str, ...]] = {
            name: cells[column.place] for name, column in header.columns.items()
        }

    def take_decimal_mark(self, decimal: str | None, delimiter: str) -> None:
        """Take the decimal mark as told, or else from the numbers; if neither tells, ask."""
        if decimal is not None or delimiter == ",":
            self._comma = decimal == ","
            return
        numbers = [self._cells[name] for name in self._cells if name in head.NUMBERS]
        sure, doubtful = evidence(cell for cells in numbers for cell in cells if cell)
        # One decimal comma makes the comma the file's mark; a point beside it is then an error.
        self._comma = "," in sure or (not sure and "," in (doubtful or ""))
        if doubtful and not sure:
            self._ask(doubtful)

    def table(self, load_range: LoadRange | None) -> ParsedTable:
        """Return the good rows and all errors."""
        wrench = self._block(head.WRENCH, missing=0.0)
        displacement = self._block(head.DISPLACEMENT, missing=np.nan)
        uncertainty = self._block(head.UNCERTAINTY, missing=np.nan)
        compliance = self._block(head.COMPLIANCE, missing=np.nan)
        self._check_measured(displacement)
        self._check_tangents(compliance)
        for excess in excesses(wrench, displacement, load_range, uncertainty):
            self._spoil(excess.at, self._header.columns[excess.name].label, excess.message)
        for name in head.TEXTS:
            self._check_texts(name)
        good = self._good
        return ParsedTable(
            wrench=wrench[good],
            displacement=displacement[good],
            uncertainty=uncertainty[good],
            compliance=compliance[good].reshape(-1, 6, 6),
            source=self._texts("source"),
            note=self._texts("note"),
            fingerprint=self._texts("fingerprint"),
            row=np.array(self._line, dtype=np.int64)[good],
            errors=listed(self._errors),
        )

    def _ask(self, doubtful: str) -> None:
        """Name the first field whose mark is a decimal one or parts thousands."""
        at, label = next(
            (cells.index(cell), self._header.columns[name].label)
            for name, cells in self._cells.items()
            for cell in cells
            if name in head.NUMBERS and cell.strip() == doubtful
        )
        mark = "," if "," in doubtful else "."
        one, other = doubtful.replace(",", "."), doubtful.replace(mark, "")
        message = (
            f"'{doubtful}' is {one} or {other}, and no number in the file tells which; say "
            f"decimal={mark} for {one}, or write {other} without the mark"
        )
        self._spoil(at, label, message)

    def _block(self, names: tuple[str, ...], missing: float) -> Array:
        """Return shape (n, 6) or (n, 36), SI, of columns that belong together."""
        block = np.full((len(self._line), len(names)), missing)
        for index, name in enumerate(names):
            if name in self._header.columns:
                block[:, index] = self._numbers(self._header.columns[name])
        return block

    def _numbers(self, column: Column) -> Array:
        """Convert one column, fast when all of it is plain, field by field when not."""
        cells = self._cells[column.name]
        values = _all_at_once(cells, self._comma, column.factor)
        if values is None:
            values = np.array([self._number(column, at) for at in range(len(cells))])
        for at in np.flatnonzero(values == 0.0).tolist():
            if vanished(cells[at], 0.0):
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
        return tuple(cell.strip() for cell, good in zip(cells, self._good, strict=True) if good)

    def _spoil(self, at: int, label: str, message: str) -> None:
        self._good[at] = False
        self._errors.append(RowError(self._line[at], label, message))


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
