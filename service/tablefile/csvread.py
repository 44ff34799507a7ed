"""Read a CSV table: units in the header, every bad row named by line, field and reason.

A file may use ``,``, ``;`` or tab between fields, and with the last two a decimal comma. Lines that
begin with ``#`` are comments; blank lines count in the numbering but hold no row. See `header` for
the columns.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field

import numpy as np

from service.tablefile import header as head
from service.tablefile.csvlines import (
    UnreadableFileError,
    decoded,
    delimiter_of,
    is_separator_line,
    records,
)
from service.tablefile.header import Column, Header
from service.tablefile.parsed import (
    Array,
    ParsedTable,
    RowError,
    listed,
    refused,
    rotation_message,
    text_problem,
    turned_too_far,
)

_SHOWN = 40


@dataclass
class _Body:
    """The lines below the header that have the right number of fields."""

    line: list[int] = field(default_factory=list)
    fields: list[list[str]] = field(default_factory=list)
    errors: list[RowError] = field(default_factory=list)


def read_csv(text: str | bytes) -> ParsedTable:
    r"""Read a CSV table into SI arrays.

    Parameters
    ----------
    text : str or bytes
        The whole file.

    Returns
    -------
    ParsedTable
        The rows without a mistake, and all mistakes. `RowError.row` is the line of the file,
        from 1, `RowError.field` the column as the header writes it. A mistake in the header leaves
        no rows, because without it no number has a meaning.

    Examples
    --------
    >>> table = read_csv("fz [lbf],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]\n"
    ...                  "-100,0,0,-1.5,0,0,0\n")
    >>> table.displacement[0, 2]
    np.float64(-0.0015)
    """
    try:
        content = decoded(text)
    except UnreadableFileError as error:
        return refused([RowError(0, "file", str(error))])
    delimiter = delimiter_of(content)
    header, body = _split(content, delimiter)
    if header.errors:
        return refused(header.errors)
    if not body.line and not body.errors:
        body.errors.append(RowError(0, "file", "there is a header but no row below it"))
    return _Conversion(header, body, decimal_comma=delimiter != ",").table()


def _split(content: str, delimiter: str) -> tuple[Header, _Body]:
    """Part the text into its header and the rows below."""
    lines = records(content, delimiter)
    header, body = Header(0), _Body()
    try:
        for line, fields in lines:
            if not is_separator_line(fields, delimiter):
                header = _header(fields, line)
                break
        else:
            header.errors.append(RowError(0, "file", "the file is empty"))
        for line, fields in lines:
            _take(body, header.width, line, fields, delimiter)
    except csv.Error as error:
        message = f"cannot be read as CSV ({error}); is a quotation mark left open?"
        body.errors.append(RowError(body.line[-1] + 1 if body.line else 1, "line", message))
    return header, body


def _header(fields: list[str], line: int) -> Header:
    """Read the header, or say that there is none."""
    if all(_plain(cell.replace(",", "."), False) is not None for cell in fields if cell.strip()):
        message = (
            "there is no header; the first line must name the columns with units, such as "
            "fx [N], ux [mm] (a line that begins with # is a comment)"
        )
        return Header(0, errors=[RowError(line, "header", message)])
    return head.read_header(fields, line)


def _take(body: _Body, width: int, line: int, fields: list[str], delimiter: str) -> None:
    """Add a line to the body if it has as many fields as the header."""
    if len(fields) > width and not any(cell.strip() for cell in fields[width:]):
        fields = fields[:width]  # a spreadsheet's empty columns on the right
    if len(fields) == width:
        body.line.append(line)
        body.fields.append(fields)
        return
    message = f"has {len(fields)} fields, the header {width}"
    if any("\n" in cell for cell in fields):
        message += "; is a quotation mark left open?"
    elif len(fields) > width and delimiter == ",":
        message += "; decimal commas need ; between the fields, a comma in a note needs quotes"
    body.errors.append(RowError(line, "line", message))


class _Conversion:
    """From the fields of one file to arrays; collects errors and the rows they spoil."""

    def __init__(self, header: Header, body: _Body, decimal_comma: bool) -> None:
        self._header = header
        self._line = body.line
        self._errors = body.errors
        self._good = np.ones(len(body.line), dtype=bool)
        cells = list(zip(*body.fields, strict=True)) or [()] * header.width
        self._cells: dict[str, tuple[str, ...]] = {
            name: cells[column.place] for name, column in header.columns.items()
        }
        # Where the comma does not part fields, one in any number makes it the file's decimal mark.
        numbers = [name for name in self._cells if name in head.NUMBERS]
        self._comma = decimal_comma and any("," in "".join(self._cells[name]) for name in numbers)

    def table(self) -> ParsedTable:
        """Return the good rows and all errors."""
        wrench = self._block(head.WRENCH, missing=0.0)
        displacement = self._block(head.DISPLACEMENT, missing=np.nan)
        uncertainty = self._block(head.UNCERTAINTY, missing=np.nan)
        self._check_measured(displacement)
        self._check_rotation(displacement)
        for name in head.TEXTS:
            self._check_texts(name)
        good = self._good
        return ParsedTable(
            wrench=wrench[good],
            displacement=displacement[good],
            uncertainty=uncertainty[good],
            source=self._texts("source"),
            note=self._texts("note"),
            fingerprint=self._texts("fingerprint"),
            row=np.array(self._line, dtype=np.int64)[good],
            errors=listed(self._errors),
        )

    def _block(self, names: tuple[str, ...], missing: float) -> Array:
        """Return shape (n, 6), SI, of six columns that belong together."""
        block = np.full((len(self._line), len(names)), missing)
        for index, name in enumerate(names):
            if name in self._header.columns:
                block[:, index] = self._numbers(self._header.columns[name])
        return block

    def _numbers(self, column: Column) -> Array:
        """Convert one column, fast when all of it is plain, field by field when not."""
        cells = self._cells[column.name]
        values = _all_at_once(cells, self._comma)
        if values is None:
            values = np.array([self._number(column, at) for at in range(len(cells))])
        with np.errstate(over="ignore"):
            values = values * column.factor
        for at in np.flatnonzero(np.isinf(values)).tolist():
            self._spoil(at, column.label, f"{_shown(cells[at])} is too large a number")
        if column.name in head.UNCERTAINTY:
            for at in np.flatnonzero(values < 0.0).tolist():
                self._spoil(
                    at, column.label, f"{_shown(cells[at])}: an uncertainty is not negative"
                )
        return values

    def _number(self, column: Column, at: int) -> float:
        """Convert one field; NaN and an error if it is not a finite number."""
        cell = self._cells[column.name][at].strip()
        if not cell and column.name not in head.WRENCH:
            return np.nan  # not measured, or its uncertainty not known
        value = _plain(cell, self._comma)
        if value is None or not math.isfinite(value):
            self._spoil(at, column.label, _why(cell, column.name, self._comma))
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

    def _check_rotation(self, displacement: Array) -> None:
        for at in turned_too_far(displacement).tolist():
            rotation = displacement[at, 3:]
            name = head.DISPLACEMENT[3 + int(np.nanargmax(np.abs(rotation)))]
            self._spoil(at, self._header.columns[name].label, rotation_message(rotation))

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


def _all_at_once(cells: tuple[str, ...], comma: bool) -> Array | None:
    """Convert a column of plain finite numbers, or return None if a field is anything else."""
    joined = "".join(cells)
    if "_" in joined or (comma and "." in joined):
        return None
    plain = (cell.replace(",", ".") for cell in cells) if comma else cells
    try:
        values = np.fromiter(map(float, plain), dtype=float, count=len(cells))
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


def _plain(cell: str, comma: bool) -> float | None:
    """Return the number a field holds, or None."""
    # Python's 1_000 is nobody's number; 1.234 beside decimal commas may mean 1234.
    if "_" in cell or (comma and "." in cell):
        return None
    try:
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return None


def _shown(cell: str) -> str:
    cell = cell.strip()
    return f"'{cell}'" if len(cell) <= _SHOWN else f"'{cell[:_SHOWN]}...'"


def _why(cell: str, name: str, comma: bool) -> str:
    """Say why a field is not a number and what to write."""
    if not cell:
        return "is empty; write 0 for no load"
    if cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{_shown(cell)} is not finite; leave the row out"
    if cell.startswith("#"):
        return f"{_shown(cell)} is a spreadsheet's error; correct the formula or leave the row out"
    value = _plain(cell, comma)
    if value is not None:
        return f"{_shown(cell)} is too large a number"
    if "," in cell or (comma and "." in cell):
        mark = "comma" if comma else "point"
        return f"{_shown(cell)}: the file has a decimal {mark}; write no other mark, no thousands"
    if _plain(cell.split()[0], comma) is not None:
        return f"{_shown(cell)} is not a number alone; the unit stands in the header only"
    return f"{_shown(cell)} is not a number"
