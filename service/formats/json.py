"""Reader and writer of JSON tables: ``{"rows": [{"wrench": [6], "displacement": [6], ...}]}``.

Rows have the arrays and texts of `Rows` (null where a displacement or an uncertainty is unknown)
in SI, in the order of ``inputs`` and ``outputs``, else of the component. Such rows may also come as
a list or one a line. Objects of named columns, a list of them as pandas writes or one a line, are
records as of a CSV.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats.cells import Digits, quoted, underflows
from wrenchbook.service.formats.columns import ARRAYS, ORIGIN, TEXTS, Columns, WritableRows
from wrenchbook.service.formats.header import Record, array_header
from wrenchbook.service.formats.options import (
    MAX_MISTAKES,
    Mistakes,
    Options,
    ParsedTable,
    ReadReport,
)
from wrenchbook.service.formats.text import PIECE, CellFormat, Piece, read_pieces, read_records
from wrenchbook.surrogate.table.rows import nulls
from wrenchbook.surrogate.table.space import PER_INTERFACE

MAX_BYTES = 112 * 1024 * 1024  # rows take seven times their text: 450,000 rows are 800 MB

_SPACE_KEYS = ("inputs", "outputs")
_TABLE_KEYS = ("units", "contract", "provenance", "rows", "component", "table_version")
_MAX_UNKNOWN = 10  # unknown keys of a row in its mistakes: more would hide the others
_REQUIRED = ("wrench", "displacement")
_ROW_KEYS = (*ARRAYS, *TEXTS, *ORIGIN)
# One of them makes an object a table; columns of records may have the names of the other keys.
_TABLE_ONLY_KEYS = {"rows", "units", "contract", "provenance", *_SPACE_KEYS}
_LIST_OF_OBJECTS = re.compile(r"[ \t\n\r]*\[(?=[ \t\n\r]*\{)")
_MAYBE_TOO_SMALL = re.compile(r"[eE]-\d{3}|0{290}")  # digits of a number below the least float
_MISSING = object()  # in place of a value that a text does not have; None is JSON's null
_BLANKS = re.compile(r"[ \t\n\r]*")


class JsonError(ValueError):
    """The text is not JSON, or not a table; the message has the place."""


def read_json(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a JSON file piece by piece; `report` gets the mistakes."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise JsonError(
                f"is JSON of {path.stat().st_size >> 20} MiB, more than {MAX_BYTES >> 20} MiB; "
                "send it in parts, or as CSV, Parquet or HDF5"
            )
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except UnicodeDecodeError as error:
            problem = f"is not JSON: its byte {error.start:,} is not UTF-8"
            raise JsonError(f"{problem}; save it as UTF-8") from error
        yield from _read_text(text, options, report)
    except ValueError as error:
        report.mistakes.ruin(report.read + 1 if report.read else 0, "file", str(error))


def _read_text(text: str, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a table, of rows of arrays, or of records, by the first object."""
    # A float takes a third of the memory of its digits, but hides that 1e-400 is not zero.
    number = Digits if _MAYBE_TOO_SMALL.search(text) else float
    list_start = _LIST_OF_OBJECTS.match(text)
    values = _values(text, number, list_start.end() if list_start else 0)
    first = next(values, _MISSING)
    keys = first.keys() if isinstance(first, dict) else set[str]()
    if not list_start and (not keys or keys & _TABLE_ONLY_KEYS):
        _require_alone(text, first, next(values, _MISSING))
        yield from _read_table(first, options, report)
    elif keys & {*_REQUIRED}:
        yield from _read_table({"rows": list(_rows(text, number))}, options, report)
    else:
        # Numbers stay text, so that their digits and units are read as those of a CSV.
        yield from read_records(_records(_rows(text, Digits)), options, report)


def _require_alone(text: str, first: Any, second: Any) -> None:
    """Raise JsonError unless a text has one value."""
    if first is _MISSING:
        raise JsonError("is not JSON: it is empty; send a table")
    if second is not _MISSING:
        end = json.JSONDecoder().raw_decode(text, len(text) - len(text.lstrip()))[1]
        line = text.count("\n", 0, len(text) - len(text[end:].lstrip())) + 1
        reason = f"a second value follows in line {line}; remove it, or send a list: [...]"
        raise JsonError(f"is not JSON: {reason}")


def _rows(text: str, number: Callable[[str], Any]) -> Iterator[Any]:
    """Yield the entries of a list, or each value of a text; JsonError."""
    for value in _values(text, number):
        if isinstance(value, list):
            yield from value
        else:
            yield value


def _values(text: str, number: Callable[[str], Any], at: int = 0) -> Iterator[Any]:
    """Yield the values of a text from a position on, one behind the other; JsonError."""
    numbers = {"parse_float": number, "parse_int": number, "parse_constant": Digits}
    decoder = json.JSONDecoder(**numbers, object_pairs_hook=_unique)
    while True:
        blanks = _BLANKS.match(text, at)
        at = blanks.end() if blanks else at
        if at == len(text):
            return
        try:
            value, at = decoder.raw_decode(text, at)
        except RecursionError as error:
            raise JsonError("is nested too deeply for a table; write one object a row") from error
        except json.JSONDecodeError as error:
            place = f"line {error.lineno}, column {error.colno}"
            raise JsonError(f"is not JSON at {place}: {error.msg}; correct it there") from error
        yield value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the members of an object; JsonError if a key is there twice."""
    members = dict(pairs)
    if len(members) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        values = " and ".join(quoted(str(value)) for key, value in pairs if key == twice)
        raise JsonError(f"has the key {quoted(twice)} twice in one object, as {values}; keep one")
    return members


def _records(rows: Iterator[Any]) -> Iterator[Record]:
    """Yield the header as record 0, then the rows."""
    names: list[str] = []
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict) or any(isinstance(cell, dict) for cell in row.values()):
            raise JsonError(
                f"row {number} must be an object of named columns, not {quoted(str(row))}; write "
                "pandas data frames with to_json(orient='records')"
            )
        if number == 1:
            names = list(row)
            yield 0, names
        if not row.keys() <= set(names):
            more = ", ".join(name for name in row if name not in names)
            raise JsonError(f"row {number} has columns that row 1 lacks: {more}; add them to row 1")
        for name, cell in row.items():
            if not (cell is None or isinstance(cell, str)):
                shown = json.dumps(cell, default=str)[:40]
                raise JsonError(f"row {number}: {name!r} is {shown}; write a number or a string")
        yield number, [row.get(name) or "" for name in names]


def json_text(pieces: Iterable[WritableRows], members: Mapping[str, Any]) -> Iterator[str]:
    """Yield the text of a JSON table: the `members`, then the rows without unknown values."""
    head = json.dumps({**members, "units": "SI"}, allow_nan=False)
    yield head[:-1] + ', "rows": ['
    separator = ""
    for piece in pieces:
        rows = [json.dumps(row, allow_nan=False) for row in _row_dicts(piece)]
        if rows:
            yield separator + ", ".join(rows)
            separator = ", "
    yield "]}"


def _read_table(table: Any, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a table: an object with rows of arrays in SI."""
    columns, mistakes = options.columns, report.mistakes
    if not isinstance(table, dict) or "rows" not in table:
        mistakes.ruin(0, "rows", _no_table(columns))
        return
    for key, value in table.items():
        if problem := _key_problem(key, value, columns):
            mistakes.ruin(0, key, problem)
            return

    rows = table["rows"]
    starts = range(0, len(rows), PIECE)
    pieces = (_piece(rows[start : start + PIECE], start, columns, mistakes) for start in starts)
    yield from read_pieces(array_header(columns), pieces, options, report, CellFormat())


def _piece(rows: list[Any], start: int, columns: Columns, mistakes: Mistakes) -> Piece:
    """Return the good ones of `rows`, which begin with row `start` + 1 of the file."""
    good: list[int] = []
    cells: list[list[Any]] = []
    number = start
    for number, row in enumerate(rows, start + 1):
        line, problems = _row_cells(row, columns)
        for key, message in problems:
            mistakes.add(number, key, message)
        if not problems:
            good.append(number)
            cells.append(line)
        if mistakes.count > MAX_MISTAKES:
            break
    lines = list(zip(*cells, strict=True))
    # None becomes NaN; for a column of None alone, as of missing tangents, numpy takes 20 times as
    # long as for one of NaN.
    numbers = [
        np.full(len(line), np.nan) if line.count(None) == len(line) else np.array(line, float)
        for line in lines[: -len(TEXTS)]
    ]
    return Piece(good, [*numbers, *lines[-len(TEXTS) :]], number - start)


def _no_table(columns: Columns) -> str:
    loads, moved = len(columns.wrench), len(columns.displacement)
    rows = f'[{{"wrench": [{loads} numbers], "displacement": [{moved}]}}]'
    return f'must be a table; write {{"rows": {rows}}}'


def _key_problem(key: str, value: Any, columns: Columns) -> str:
    """Return the mistake of a member of the table; empty if there is none."""
    if key == "rows":
        return "" if isinstance(value, list) else _no_table(columns)
    if key == "units" and value != "SI":
        sent = quoted(str(value))
        return f'must be "SI", not {sent}; convert the numbers, or send a CSV with units'
    if key in _SPACE_KEYS:
        names = columns.wrench if key == "inputs" else columns.displacement
        return "" if value == list(names) else f"must be those of the component: {', '.join(names)}"
    if key not in _TABLE_KEYS:
        return f"is an unknown key; write one of {', '.join(_TABLE_KEYS)}"
    return ""


def _row_cells(row: Any, columns: Columns) -> tuple[list[Any], list[tuple[str, str]]]:
    """Return a row's cells in the order of `array_header`, and key and message of each mistake."""
    if not isinstance(row, dict):
        return [], [("row", 'must be a row; write {"wrench": [...], "displacement": [...]}')]
    unknown = islice((key for key in row if key not in _ROW_KEYS), _MAX_UNKNOWN)
    message = f"is an unknown key; write one of {', '.join(_ROW_KEYS)}"
    cells: list[Any] = []
    problems = [(key, message) for key in unknown]

    for key in ARRAYS:
        names = getattr(columns, key)
        values = row.get(key)
        if values is None and key not in _REQUIRED:
            cells += [None] * len(names)
            continue
        width = len(columns.wrench) if key == "compliance" else len(names)
        lines: Any = values if key == "compliance" else [values]
        are_lists = isinstance(lines, list) and all(isinstance(line, list) for line in lines)
        if not are_lists or [*map(len, lines)] != [width] * (len(names) // width):
            problems.append((key, _form(key, names, width, values)))
            continue
        for at, line in enumerate(lines):
            cells += line
            if {*map(type, line)} != {float}:
                label = f"{key}[{at}]" if key == "compliance" else key
                cells[-width:] = _number_cells(label, line, problems)

    for key in TEXTS:
        text = row.get(key)
        if not (text is None or type(text) is str):
            problems.append((key, "must be a string; put it in quotation marks"))
        cells.append(text or "")
    return cells, problems


def _form(key: str, names: Sequence[str], width: int, values: Any) -> str:
    """Return the mistake of a key's values, None if they are missing, and the correction."""
    lines, numbers = (
        "six" if count == PER_INTERFACE else str(count) for count in (len(names) // width, width)
    )
    if key == "compliance":
        rule = f"write all {len(names)} tangents or none"
        return f"must be {lines} lists of {numbers} numbers, not {quoted(str(values))}; {rule}"
    remedy = {"uncertainty": "; null if unknown", "curvature": "; write all or none"}.get(
        key, f"; write [{', '.join(names)}] in SI"
    )
    if values is None:
        return f"is missing{remedy}"
    sent = f"{len(values)}" if isinstance(values, list) else quoted(str(values))
    return f"must be a list of {numbers} numbers, not {sent}{remedy}"


def _number_cells(key: str, line: list[Any], problems: list[tuple[str, str]]) -> list[Any]:
    """Return numbers as floats, and None for null; what is not allowed is added to `problems`."""
    cells: list[float | None] = []
    for index, value in enumerate(line):
        problem = ""
        is_null = value is None and key in ("displacement", "uncertainty")
        if type(value) is Digits and not math.isfinite(float(value)):
            problem = f"{quoted(value)} is not finite; correct it or leave the row out"
        elif type(value) is Digits and float(value) == 0.0 and underflows(value):
            problem = f"{quoted(value)} is too small for a float and would become 0; write 0"
        elif not (is_null or type(value) in (Digits, float)):
            problem = f"{json.dumps(value)[:40]} must be a number"
        if problem:
            problems.append((f"{key}[{index}]", problem))
        cells.append(None if value is None or problem else float(value))
    return cells


def _row_dicts(table: WritableRows) -> list[dict[str, Any]]:
    """Return the rows as JSON objects, without unknown values."""
    loads, motions = table.wrench.tolist(), table.displacement.tolist()
    rows: list[dict[str, Any]] = [
        {"wrench": load, "displacement": nulls(motion)}
        for load, motion in zip(loads, motions, strict=True)
    ]
    for row, seq in zip(rows, getattr(table, "seq", ()), strict=False):
        row["row"] = int(seq)
    for row, bounds in zip(rows, table.uncertainty.tolist(), strict=True):
        if not all(map(math.isnan, bounds)):
            row["uncertainty"] = nulls(bounds)
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
