"""JSON tables: ``{"units": "SI", "rows": [{"wrench": [6], "displacement": [6], ...}]}``.

A displacement that was not measured is null, but not all six. A row may have ``uncertainty`` (six
numbers, null where unknown), ``compliance`` (the tangent, six lists of six numbers: a line for each
of ux uy uz rx ry rz, over fx fy fz mx my mz), ``curvature`` (third derivatives of the complementary
energy, in the order of `Rows.curvature`), ``source``, ``note`` and ``fingerprint``. Always SI.
Rows of several interfaces or further inputs have as many numbers as ``inputs`` and ``outputs``
name; without these two the order is the component's.
An export also has ``component``, ``table_version`` and the number of each row in the ledger,
``row``; an import ignores them.

Objects of named columns, a list of them as pandas writes or one a line, are records as of a CSV.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from wrenchbook.service.formats.cells import Digits, text_problem
from wrenchbook.service.formats.columns import ORIGIN, TEXTS, Columns, WritableRows
from wrenchbook.service.formats.header import Record
from wrenchbook.service.formats.options import MAX_LISTED, Options, ReadReport
from wrenchbook.service.formats.rows import (
    Array,
    ParsedTable,
    good_rows,
    number_word,
)
from wrenchbook.service.formats.text import PIECE, read_records
from wrenchbook.service.formats.units import vanished
from wrenchbook.surrogate.table.rows import curvature_column, unknown_column

MAX_BYTES = 112 * 1024 * 1024
"""Decoded rows take seven times their text: 450,000 rows are 800 MB."""

_MAX_FLOAT = sys.float_info.max
_SPACE_KEYS = ("inputs", "outputs")
_TABLE_KEYS = ("units", "contract", "provenance", "rows", "component", "table_version")
_NUMBERS = ("wrench", "displacement", "uncertainty", "compliance", "curvature")
_ROW_KEYS = (*_NUMBERS, *TEXTS, *ORIGIN)
_RECORDS = re.compile(rf'\s*(\[\s*\{{|\{{\s*"(?!({"|".join((*_TABLE_KEYS, *_SPACE_KEYS))})"))')
_BLANKS = re.compile(r"[ \t\n\r]*")


class JsonError(ValueError):
    """The text is no JSON, or no table; the message has the place."""


def read_json(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a JSON file piece by piece; `report` gets the mistakes."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise JsonError(
                f"is JSON of more than {MAX_BYTES >> 20} MiB; send it in parts, or as CSV, "
                "Parquet or HDF5"
            )
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise JsonError(f"is not JSON: {error.reason}; save it as UTF-8") from error
        if _RECORDS.match(text):
            # Numbers stay text, so that their digits and units are read as those of a CSV.
            values = _values(text, Digits, Digits)
            yield from read_records(_records(values), options, report)
            return
        values = list(islice(_values(text, _parsed_float, int), 2))
        if len(values) != 1:
            reason = "there is more behind its end" if values else "it is empty"
            raise JsonError(f"is not JSON: {reason}")
        yield from _pieces(values[0], options, report)
    except ValueError as error:
        report.mistakes.ruin(report.read + 1 if report.read else 0, "file", str(error))


def _values(text: str, parse_float: Any, parse_int: Any) -> Iterator[Any]:
    """Yield the values of a text, one behind the other; JsonError."""
    decoder = json.JSONDecoder(
        parse_float=parse_float, parse_int=parse_int, object_pairs_hook=_unique
    )
    at = 0
    while True:
        blanks = _BLANKS.match(text, at)
        at = blanks.end() if blanks else at
        if at == len(text):
            return
        try:
            value, at = decoder.raw_decode(text, at)
        except RecursionError as error:
            raise JsonError("is not JSON of a table: it is nested too deeply") from error
        except ValueError as error:
            broken = isinstance(error, json.JSONDecodeError)
            reason, place = (error.msg, error.pos) if broken else (str(error), at)
            raise JsonError(f"is not JSON: {reason} at character {place:,}") from error
        yield value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object; ValueError if a key stands twice."""
    members = dict(pairs)
    if len(members) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice!r} stands twice in one object; keep one")
    return members


def _records(values: Iterator[Any]) -> Iterator[Record]:
    """Yield the header as record 0, then the rows: those of a list, or each value."""
    names: list[str] = []
    rows = (row for value in values for row in (value if isinstance(value, list) else [value]))
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict) or any(isinstance(cell, dict) for cell in row.values()):
            raise JsonError(
                f"row {number} is no object of named columns; write pandas' frames with "
                "to_json(orient='records')"
            )
        if number == 1:
            names = list(row)
            yield 0, names
        if not row.keys() <= set(names):
            more = ", ".join(row.keys() - set(names))
            raise JsonError(
                f"row {number} has columns that row 1 has not: {more}; write them as null"
            )
        for name, cell in row.items():
            if not (cell is None or isinstance(cell, str)):
                raise JsonError(f"row {number}: {name!r} is neither a number nor a text")
        yield number, [row.get(name) or "" for name in names]


def json_text(pieces: Iterable[WritableRows], about: Mapping[str, Any]) -> Iterator[str]:
    """Yield the text of a JSON table: the members `about`, then the rows of each piece.

    NaN becomes null. Unknown uncertainties, an unknown tangent and an empty text are left out.
    """
    head = json.dumps({**about, "units": "SI"}, allow_nan=False)
    yield head[:-1] + ', "rows": ['
    between = ""
    for piece in pieces:
        rows = [json.dumps(row, allow_nan=False) for row in _row_dicts(piece)]
        if rows:
            yield between + ", ".join(rows)
            between = ", "
    yield "]}"


def _pieces(table: Any, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    columns = options.columns
    if not isinstance(table, dict) or "rows" not in table:
        report.mistakes.ruin(0, "rows", _no_table(columns))
        return
    for key, value in table.items():
        if problem := _key_problem(key, value, columns):
            report.mistakes.ruin(0, key, problem)
            return
    if not table["rows"]:
        report.mistakes.ruin(0, "rows", "there is no row")
    piece = _JsonRows(columns)
    for value in table["rows"]:
        report.read += 1
        piece.add(report.read, value)
        if report.read % PIECE == 0 or len(piece.mistakes) > MAX_LISTED:
            yield piece.table(options, report)
            if report.is_beyond_limits():
                return
            piece = _JsonRows(columns)
    yield piece.table(options, report)
    report.is_beyond_limits()


def _no_table(columns: Columns) -> str:
    loads, moved = len(columns.wrench), len(columns.displacement)
    rows = f'[{{"wrench": [{loads} numbers], "displacement": [{moved}]}}]'
    return f'is not a table; write {{"rows": {rows}}}'


def _key_problem(key: str, value: Any, columns: Columns) -> str:
    """Say what is wrong with a member of the table."""
    if key == "rows":
        return "" if isinstance(value, list) else _no_table(columns)
    if key == "units" and value != "SI":
        return "a JSON table is in SI; convert it, or send CSV with units"
    if key in _SPACE_KEYS:
        own = columns.wrench if key == "inputs" else columns.displacement
        return "" if value == list(own) else f"are not the component's: {', '.join(own)}"
    if key not in _TABLE_KEYS:
        return f"is not a key of a table; there are {', '.join(_TABLE_KEYS)}"
    return ""


class _JsonRows:
    """Rows without mistakes, and the mistakes of the others (row, key, message)."""

    def __init__(self, columns: Columns) -> None:
        self.mistakes: list[tuple[int, str, str]] = []
        self._columns = columns
        self._row: list[int] = []
        self._numbers: list[list[float]] = []  # as many a row as `Columns.numbers`
        self._curvatures: list[list[float] | None] = []
        self._texts: list[list[str]] = []
        self._at = 0

    def add(self, at: int, row: Any) -> None:
        """Add the row of number `at`, or its mistakes."""
        self._at, before = at, len(self.mistakes)
        if not isinstance(row, dict):
            self._refuse("row", 'is not a row; write {"wrench": [...], "displacement": [...]}')
            return
        for key in row:
            if key not in _ROW_KEYS:
                self._refuse(key, f"is not a key of a row; there are {', '.join(_ROW_KEYS)}")
        numbers = self._required(row, "wrench", self._columns.wrench)
        numbers += self._required(row, "displacement", self._columns.displacement)
        numbers += self._uncertainty(row.get("uncertainty"))
        numbers += self._tangent(row.get("compliance"))
        curvature, count = row.get("curvature"), len(self._columns.curvature)
        if curvature is not None and not _are(curvature, count):
            self._refuse("curvature", f"is not a list of {count} numbers; a row has all or none")
        elif curvature is not None:
            curvature = self._finite("curvature", curvature)
        texts = [self._text(row.get(key), key) for key in TEXTS]
        if len(self.mistakes) == before:
            self._row.append(at)
            self._numbers.append(numbers)
            self._curvatures.append(curvature)
            self._texts.append(texts)

    def table(self, options: Options, report: ReadReport) -> ParsedTable:
        """Return the rows within all limits; `report` gets the mistakes."""
        for mistake in self.mistakes:
            report.mistakes.add(*mistake)
        n, m = len(self._columns.wrench), len(self._columns.displacement)
        block: Array = np.array(self._numbers, dtype=float).reshape(-1, n + 2 * m + m * n)
        source, note, fingerprint = zip(*self._texts, strict=True) if self._texts else ((), (), ())
        uncertainty, tangents = block[:, n + m : n + 2 * m], block[:, n + 2 * m :].reshape(-1, m, n)
        piece = {
            "seq": np.array(self._row, dtype=np.int64),
            "wrench": block[:, :n],
            "displacement": block[:, n : n + m],
            "compliance": _known_column(tangents),
            "curvature": curvature_column(self._curvatures, self._columns.space),
            "uncertainty": _known_column(uncertainty),
            "source": np.array(source, dtype=str),
            "fingerprint": np.array(fingerprint, dtype=str),
            "space": self._columns.space,
            "note": note,
        }
        return good_rows(piece, np.ones(len(block), dtype=bool), options, report)

    def _refuse(self, key: str, message: str) -> None:
        self.mistakes.append((self._at, key, message))

    def _required(self, row: dict[str, Any], key: str, names: Sequence[str]) -> list[float]:
        """Return finite numbers, one a name, NaN for a displacement that is null."""
        values, partial = row.get(key), key == "displacement"
        if not _are(values, len(names)):
            count = number_word(len(names))
            problem = "is missing" if values is None else f"is not a list of {count} numbers"
            self._refuse(key, f"{problem}; write [{', '.join(names)}] in SI")
            return []
        if partial and all(value is None for value in values):
            self._refuse(key, "is all null; a row needs at least one number")
        return self._finite(key, values, nulls=partial)

    def _uncertainty(self, values: Any) -> list[float]:
        count = len(self._columns.displacement)
        if values is None:
            return [math.nan] * count
        if not _are(values, count):
            message = f"is not a list of {number_word(count)} numbers (null where unknown)"
            self._refuse("uncertainty", message)
            return []
        bounds = self._finite("uncertainty", values, nulls=True)
        for index, bound in enumerate(bounds):
            if bound < 0.0:
                self._refuse(f"uncertainty[{index}]", f"{bound}: an uncertainty is not negative")
        return bounds

    def _tangent(self, lines: Any) -> list[float]:
        """Return the tangents by lines, NaN where the row has none."""
        n, m = len(self._columns.wrench), len(self._columns.displacement)
        if lines is None:
            return [math.nan] * (m * n)
        if not _are(lines, m) or not all(_are(line, n) for line in lines):
            message = (
                f"is not {number_word(m)} lists of {number_word(n)} numbers; a row has all "
                f"{m * n} tangents or none"
            )
            self._refuse("compliance", message)
            return []
        numbers = (self._finite(f"compliance[{at}]", line) for at, line in enumerate(lines))
        return [number for line in numbers for number in line]

    def _finite(self, key: str, values: list[Any], nulls: bool = False) -> list[float]:
        """Return finite numbers, NaN for null where that is allowed, zero and a mistake else."""
        numbers = []
        for index, value in enumerate(values):
            problem, number = "", 0.0
            if nulls and value is None:
                number = math.nan
            elif isinstance(value, _Vanished):
                problem = "is too small a number and would become 0; write 0"
            elif type(value) is not float and type(value) is not int:  # a bool is an int to Python
                problem = f"{json.dumps(value)[:40]} is not a number"
            elif not abs(value) <= _MAX_FLOAT:
                problem = "is not finite; leave the row out"
            else:
                number = float(value)
            if problem:
                self._refuse(f"{key}[{index}]", problem)
            numbers.append(number)
        return numbers

    def _text(self, value: Any, key: str) -> str:
        if value is None:
            return ""
        if not isinstance(value, str):
            self._refuse(key, "is not a text")
            return ""
        if problem := text_problem(value):
            self._refuse(key, problem)
        return value.strip()


def _known_column(column: Array) -> Array:
    """Return a column, (n, ...), m and rad; without memory if all of it is unknown."""
    return unknown_column(*column.shape) if np.isnan(column).all() else column


def _are(values: Any, count: int) -> TypeGuard[list[Any]]:
    return isinstance(values, list) and len(values) == count


class _Vanished(float):
    """A number of the file that is not zero and its float is."""


def _parsed_float(text: str) -> float:
    number = float(text)
    return _Vanished(number) if number == 0.0 and vanished(text) else number


def _row_dicts(table: WritableRows) -> list[dict[str, Any]]:
    """Return the rows as JSON objects, without unknown values."""
    loads, motions = table.wrench.tolist(), table.displacement.tolist()
    rows: list[dict[str, Any]] = [
        {"wrench": load, "displacement": _nulls(motion)}
        for load, motion in zip(loads, motions, strict=True)
    ]
    for row, seq in zip(rows, getattr(table, "seq", ()), strict=False):
        row["row"] = int(seq)
    for row, bounds in zip(rows, table.uncertainty.tolist(), strict=True):
        if not all(map(math.isnan, bounds)):
            row["uncertainty"] = _nulls(bounds)
    for name in ("compliance", "curvature"):
        column = getattr(table, name, None)
        if column is not None and column.size:  # rows that have them all
            known = np.isfinite(column).all(axis=tuple(range(1, column.ndim)))
            for at in np.flatnonzero(known).tolist():
                rows[at][name] = column[at].tolist()
    for name in (*TEXTS, "when", "who"):
        for row, text in zip(rows, getattr(table, name, ()), strict=False):
            if text:
                row[name] = str(text)
    return rows


def _nulls(values: list[float]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]
