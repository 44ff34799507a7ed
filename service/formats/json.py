"""JSON tables: ``{"units": "SI", "rows": [{"wrench": [6], "displacement": [6], ...}]}``.

Objects of columns, a list of them or one a line, are read by `json_records`.

A displacement that was not measured is null, but not all six. A row may have ``uncertainty`` (six
numbers, null where unknown), ``compliance`` (the tangent, six lists of six numbers: a line for each
of ux uy uz rx ry rz, over fx fy fz mx my mz), ``curvature`` (third derivatives of the complementary
energy, in the order of `Rows.curvature`), ``source``, ``note`` and ``fingerprint``. Always SI.
Rows of several interfaces or further inputs have as many numbers as ``inputs`` and ``outputs``
name; without these two the order is the component's.
An export also has ``component``, ``table_version`` and the number of each row in the ledger,
``row``; an import ignores them.

The text is decoded row by row: decoded at once, the rows of a text of 256 MB take seven times its
size, and orjson reports neither duplicate keys nor 1e-400 nor NaN.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.formats.columns import ORIGIN, TEXTS, Columns, WritableRows
from wrenchbook.service.formats.json_reader import JsonError, JsonReader
from wrenchbook.service.formats.json_records import is_records, read_json_records
from wrenchbook.service.formats.options import MOST_LISTED, Options, ReadReport
from wrenchbook.service.formats.rows import (
    Array,
    ParsedTable,
    good_rows,
    known_column,
    number_word,
)
from wrenchbook.service.formats.units import vanished
from wrenchbook.surrogate.table.rows import curvature_column

PIECE = 20_000  # rows at once
_SPACE_KEYS = ("inputs", "outputs")
_TABLE_KEYS = ("units", "contract", "provenance", "rows", "component", "table_version")
_NUMBERS = ("wrench", "displacement", "uncertainty", "compliance", "curvature")
_ROW_KEYS = (*_NUMBERS, *TEXTS, *ORIGIN)


def read_json(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a JSON file piece by piece; `report` gets the mistakes."""
    try:
        text = _text_of(path)
        if is_records(text):
            yield from read_json_records(text, options, report)
        else:
            yield from _pieces(JsonReader(text, _parsed_float), options, report)
    except ValueError as error:
        report.mistakes.ruin(report.read + 1 if report.read else 0, "file", str(error))


def _text_of(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JsonError(f"is not JSON: {error.reason}; save it as UTF-8") from error


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


def _pieces(reader: JsonReader, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    columns = options.columns
    piece, listed, no_table = _JsonRows(columns), False, _no_table(columns)
    if reader.peek() != "{":
        reader.value()
        reader.end()
        report.mistakes.ruin(0, "rows", no_table)
        return
    for key in reader.members():
        if key != "rows" or reader.peek() != "[":
            if problem := _key_problem(key, reader.value(), columns):
                report.mistakes.ruin(0, key, problem)
                return
            continue
        listed = True
        for value in reader.items():
            report.read += 1
            piece.add(report.read, value)
            if report.read % PIECE == 0 or len(piece.mistakes) > MOST_LISTED:
                yield piece.table(options, report)
                if report.is_beyond_limits():
                    return
                piece = _JsonRows(columns)
    reader.end()
    if not listed:
        report.mistakes.ruin(0, "rows", no_table)
    elif not report.read:
        report.mistakes.ruin(0, "rows", "there is no row")
    yield piece.table(options, report)
    report.is_beyond_limits()


def _no_table(columns: Columns) -> str:
    loads, moved = len(columns.wrench), len(columns.displacement)
    rows = f'[{{"wrench": [{loads} numbers], "displacement": [{moved}]}}]'
    return f'is not a table; write {{"rows": {rows}}}'


def _key_problem(key: str, value: Any, columns: Columns) -> str:
    """Return what is wrong with a member of the table that is no list of rows."""
    if key == "rows":
        return _no_table(columns)
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
        curvature = self._curvature(row.get("curvature"))
        texts = [self._text(row, key) for key in TEXTS]
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
        piece = ParsedTable(
            wrench=block[:, :n],
            displacement=block[:, n : n + m],
            uncertainty=known_column(block[:, n + m : n + 2 * m]),
            compliance=known_column(block[:, n + 2 * m :].reshape(-1, m, n)),
            source=source,
            note=note,
            fingerprint=fingerprint,
            row=np.array(self._row, dtype=np.int64),
            curvature=curvature_column(self._curvatures, self._columns.space),
        )
        return good_rows(piece, np.ones(len(piece), dtype=bool), options, report)

    def _refuse(self, key: str, message: str) -> None:
        self.mistakes.append((self._at, key, message))

    def _required(self, row: dict[str, Any], key: str, names: Sequence[str]) -> list[float]:
        """Return finite numbers, one a name, NaN for a displacement that is null."""
        values = row.get(key)
        if not _are(values, len(names)):
            count = number_word(len(names))
            problem = "is missing" if values is None else f"is not a list of {count} numbers"
            self._refuse(key, f"{problem}; write [{', '.join(names)}] in SI")
            return []
        partial = key == "displacement"
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

    def _curvature(self, values: Any) -> list[float] | None:
        count = len(self._columns.curvature)
        if values is None:
            return None
        if not _are(values, count):
            self._refuse("curvature", f"is not a list of {count} numbers; a row has all or none")
            return None
        return self._finite("curvature", values)

    def _finite(self, key: str, values: list[Any], nulls: bool = False) -> list[float]:
        """Return finite numbers, with NaN for null where that is allowed."""
        return [
            math.nan if nulls and value is None else self._number(f"{key}[{index}]", value)
            for index, value in enumerate(values)
        ]

    def _number(self, key: str, value: Any) -> float:
        """Return a finite number, or zero and a mistake."""
        if isinstance(value, _Vanished):
            self._refuse(key, "is too small a number and would become 0; write 0")
            return 0.0
        if type(value) is not float and type(value) is not int:  # a bool is an int to Python
            self._refuse(key, f"{json.dumps(value)[:40]} is not a number")
            return 0.0
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
        self._refuse(key, "is not finite; leave the row out")
        return 0.0

    def _text(self, row: dict[str, Any], key: str) -> str:
        value = row.get(key)
        if value is None:
            return ""
        if not isinstance(value, str):
            self._refuse(key, "is not a text")
            return ""
        if problem := text_problem(value):
            self._refuse(key, problem)
        return value.strip()


def _are(values: Any, count: int) -> TypeGuard[list[Any]]:
    return isinstance(values, list) and len(values) == count


class _Vanished(float):
    """A number of the file that is not zero and its float is."""


def _parsed_float(text: str) -> float:
    number = float(text)
    return _Vanished(number) if vanished(text, number) else number


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
        for at, numbers in _known_of(getattr(table, name, None)):
            rows[at][name] = numbers
    for name in (*TEXTS, "when", "who"):
        for row, text in zip(rows, getattr(table, name, ()), strict=False):
            if text:
                row[name] = str(text)
    return rows


def _known_of(column: Array | None) -> Iterator[tuple[int, list[Any]]]:
    """Yield place and numbers of those rows of a column, (n, ...), that have them all."""
    if column is not None and column.size:
        known = np.isfinite(column).all(axis=tuple(range(1, column.ndim)))
        yield from ((at, column[at].tolist()) for at in np.flatnonzero(known).tolist())


def _nulls(values: list[float]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]
