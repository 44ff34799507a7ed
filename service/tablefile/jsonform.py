"""Tables as JSON: ``{"units": "SI", "rows": [{"wrench": [6], "displacement": [6], ...}]}``.

A displacement that was not measured is null, but not all six. A row may have ``uncertainty`` (six
numbers, null where unknown), ``compliance`` (the tangent, six lists of six numbers: a line for each
of ux uy uz rx ry rz, over fx fy fz mx my mz), ``source``, ``note`` and ``fingerprint``. Always SI.
An export also names its ``component`` and its ``table_version``, and each row's number in the
ledger, ``row``; they may stand in an import, which does not look at them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.tablefile.exact import vanished
from service.tablefile.header import DISPLACEMENT, TEXTS, UNCERTAINTY, WRENCH
from service.tablefile.limits import excesses
from service.tablefile.parsed import (
    Array,
    ParsedTable,
    RowError,
    TableRows,
    listed,
    refused,
    text_problem,
    texts_of,
)
from surrogate.table.rows import LoadRange

_AROUND = ("units", "rows", "component", "table_version")
_KEYS = ("wrench", "displacement", "uncertainty", "compliance", *TEXTS, "row")
_UNKNOWN = (math.nan,) * 6
_NO_TANGENT = (math.nan,) * 36
_WIDTH = 18 + 36  # wrench, displacement, uncertainty; compliance


@dataclass
class _Rows:
    """The rows read so far that have no mistake, and the mistakes."""

    place: list[int] = field(default_factory=list)
    numbers: list[tuple[float, ...]] = field(default_factory=list)  # 54 a row
    texts: list[tuple[str, ...]] = field(default_factory=list)
    errors: list[RowError] = field(default_factory=list)


class _Vanished(float):
    """A number of the file that became 0 though it is not."""


def place_of(name: str) -> str:
    """Return where a column of a CSV stands in a row: ``wrench[2]`` for fz."""
    columns = {"wrench": WRENCH, "displacement": DISPLACEMENT, "uncertainty": UNCERTAINTY}
    key = next(key for key, names in columns.items() if name in names)
    return f"{key}[{columns[key].index(name)}]"


def read_json(text: str | bytes, *, load_range: LoadRange | None = None) -> ParsedTable:
    """Read a JSON table into SI arrays.

    Parameters
    ----------
    text : str or bytes
        The whole file, UTF-8.
    load_range : LoadRange, optional
        The component's, N and N·m: loads far beyond it are mistakes (see `limits`).

    Returns
    -------
    ParsedTable
        The rows without a mistake, and all mistakes. `RowError.row` is the place in ``rows``,
        from 1, `RowError.field` the key, with the index of a number: ``wrench[2]``.
    """
    try:
        content = json.loads(text, parse_float=_parsed_float, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        return refused([RowError(0, "file", f"is not JSON: {error}")])
    problem = _envelope(content)
    if problem is not None:
        return refused([problem])
    rows = _Rows()
    for place, row in enumerate(content["rows"], start=1):
        _take(rows, place, row)
    return _table(rows, load_range)


def write_json(table: TableRows, about: Mapping[str, str | int] | None = None) -> str:
    """Write rows as JSON, in SI, with the digits that give back the same floats.

    Parameters
    ----------
    table : TableRows
        Rows in SI. What was not measured and an unknown uncertainty (NaN) become null; six unknown
        uncertainties, an unknown tangent and an empty text are left out. ``seq``, if it has that,
        is the number of each row.
    about : mapping, optional
        ``component`` and ``table_version``, to stand beside the rows.
    """
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
    for row, tangent in zip(rows, table.compliance.tolist(), strict=True):
        if not math.isnan(tangent[0][0]):
            row["compliance"] = tangent
    for name, texts in texts_of(table).items():
        for row, text in zip(rows, texts, strict=True):
            if text:
                row[name] = text
    return json.dumps({**(about or {}), "units": "SI", "rows": rows}, allow_nan=False)


def _nulls(values: list[float]) -> list[float | None]:
    """Return the numbers with None for each NaN."""
    return [None if math.isnan(value) else value for value in values]


def _envelope(content: Any) -> RowError | None:
    """Check what stands around the rows."""
    if not isinstance(content, dict) or not isinstance(content.get("rows"), list):
        message = 'is not a table; write {"rows": [{"wrench": [6 numbers], "displacement": [6]}]}'
        return RowError(0, "rows", message)
    if content.get("units", "SI") != "SI":
        return RowError(0, "units", "a JSON table is in SI; convert it, or send CSV with units")
    other = [key for key in content if key not in _AROUND]
    if other:
        message = f"is not a key of a table; there are {', '.join(_AROUND)}"
        return RowError(0, str(other[0]), message)
    if not content["rows"]:
        return RowError(0, "rows", "there is no row")
    return None


def _take(rows: _Rows, place: int, row: Any) -> None:
    """Add one row, or what is wrong with it."""
    if not isinstance(row, dict):
        message = 'is not a row; write {"wrench": [...], "displacement": [...]}'
        rows.errors.append(RowError(place, "row", message))
        return
    errors = [
        RowError(place, str(key), f"is not a key of a row; there are {', '.join(_KEYS)}")
        for key in row
        if key not in _KEYS
    ]
    numbers = _six(row, "wrench", WRENCH, place, errors)
    numbers += _six(row, "displacement", DISPLACEMENT, place, errors)
    numbers += _bounds(row, place, errors)
    numbers += _tangent(row, place, errors)
    texts = tuple(_text(row, name, place, errors) for name in TEXTS)
    if errors:
        rows.errors += errors
        return
    rows.place.append(place)
    rows.numbers.append(numbers)
    rows.texts.append(texts)


def _six(
    row: dict[str, Any], key: str, names: Sequence[str], place: int, errors: list[RowError]
) -> tuple[float, ...]:
    """Return six finite numbers, NaN for a displacement that is null, or zeros and the errors."""
    values = row.get(key)
    if not isinstance(values, list) or len(values) != 6:
        got = "is missing" if values is None else "is not a list of six numbers"
        errors.append(RowError(place, key, f"{got}; write [{', '.join(names)}] in SI"))
        return (0.0,) * 6
    partial = key == "displacement"
    if partial and all(value is None for value in values):
        errors.append(RowError(place, key, "is all null; a row needs at least one number"))
    return tuple(
        math.nan if partial and value is None else _number(value, place, f"{key}[{index}]", errors)
        for index, value in enumerate(values)
    )


def _number(value: Any, place: int, where: str, errors: list[RowError]) -> float:
    """Return a finite number, or zero and the error."""
    if isinstance(value, _Vanished):
        errors.append(RowError(place, where, "is too small a number and would become 0; write 0"))
        return 0.0
    # A bool is an int to Python, a number to nobody.
    if type(value) is float or type(value) is int:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
        errors.append(RowError(place, where, "is not finite; leave the row out"))
    else:
        errors.append(RowError(place, where, f"{json.dumps(value)[:40]} is not a number"))
    return 0.0


def _bounds(row: dict[str, Any], place: int, errors: list[RowError]) -> tuple[float, ...]:
    """Return the six uncertainties, NaN where unknown."""
    values = row.get("uncertainty")
    if values is None:
        return _UNKNOWN
    if not isinstance(values, list) or len(values) != 6:
        message = "is not a list of six numbers (null where unknown)"
        errors.append(RowError(place, "uncertainty", message))
        return _UNKNOWN
    bounds = []
    for index, value in enumerate(values):
        where = f"uncertainty[{index}]"
        bound = math.nan if value is None else _number(value, place, where, errors)
        if bound < 0.0:
            errors.append(RowError(place, where, f"{bound}: an uncertainty is not negative"))
        bounds.append(bound)
    return tuple(bounds)


def _tangent(row: dict[str, Any], place: int, errors: list[RowError]) -> tuple[float, ...]:
    """Return the 36 tangents by lines, NaN where the row has none."""
    lines = row.get("compliance")
    if lines is None:
        return _NO_TANGENT
    if not isinstance(lines, list) or [_length(line) for line in lines] != [6] * 6:
        message = "is not six lists of six numbers; a row has all 36 tangents or none"
        errors.append(RowError(place, "compliance", message))
        return _NO_TANGENT
    return tuple(
        _number(value, place, f"compliance[{output}][{load}]", errors)
        for output, line in enumerate(lines)
        for load, value in enumerate(line)
    )


def _length(value: Any) -> int | None:
    return len(value) if isinstance(value, list) else None


def _parsed_float(text: str) -> float:
    number = float(text)
    return _Vanished(number) if vanished(text, number) else number


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object whose keys each stand once: of two wrenches the last would win unseen."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice!r} stands twice in one object; keep one")
    return found


def _text(row: dict[str, Any], key: str, place: int, errors: list[RowError]) -> str:
    """Return a text, empty if there is none."""
    value = row.get(key)
    if value is None:
        return ""
    if not isinstance(value, str):
        errors.append(RowError(place, key, "is not a text"))
        return ""
    problem = text_problem(value)
    if problem:
        errors.append(RowError(place, key, problem))
    return value.strip()


def _table(rows: _Rows, load_range: LoadRange | None) -> ParsedTable:
    """Make the arrays and check what concerns a row as a whole."""
    block: Array = np.array(rows.numbers, dtype=float).reshape(-1, _WIDTH)
    good = np.ones(len(block), dtype=bool)
    for excess in excesses(block[:, :6], block[:, 6:12], load_range, block[:, 12:18]):
        good[excess.at] = False
        place = rows.place[excess.at]
        rows.errors.append(RowError(place, place_of(excess.name), excess.message))
    kept = [texts for texts, keep in zip(rows.texts, good, strict=True) if keep]
    return ParsedTable(
        wrench=block[good, :6],
        displacement=block[good, 6:12],
        uncertainty=block[good, 12:18],
        compliance=block[good, 18:].reshape(-1, 6, 6),
        source=tuple(texts[0] for texts in kept),
        note=tuple(texts[1] for texts in kept),
        fingerprint=tuple(texts[2] for texts in kept),
        row=np.array(rows.place, dtype=np.int64)[good],
        errors=listed(rows.errors),
    )
