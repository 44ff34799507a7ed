"""Tables as JSON: ``{"units": "SI", "rows": [{"wrench": [6], "displacement": [6], ...}]}``.

A displacement that was not measured is null, but not all six. A row may have ``uncertainty`` (six
numbers, null where unknown), ``source``, ``note`` and ``fingerprint``. Always SI.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from service.tablefile.header import DISPLACEMENT, TEXTS, WRENCH
from service.tablefile.parsed import (
    Array,
    ParsedTable,
    RowError,
    TableRows,
    listed,
    refused,
    rotation_message,
    text_problem,
    texts_of,
    turned_too_far,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

_KEYS = ("wrench", "displacement", "uncertainty", *TEXTS)
_UNKNOWN = (math.nan,) * 6


@dataclass
class _Rows:
    """The rows read so far that have no mistake, and the mistakes."""

    place: list[int] = field(default_factory=list)
    numbers: list[tuple[float, ...]] = field(default_factory=list)  # 18 a row
    texts: list[tuple[str, ...]] = field(default_factory=list)
    errors: list[RowError] = field(default_factory=list)


def read_json(text: str | bytes) -> ParsedTable:
    """Read a JSON table into SI arrays.

    Parameters
    ----------
    text : str or bytes
        The whole file, UTF-8.

    Returns
    -------
    ParsedTable
        The rows without a mistake, and all mistakes. `RowError.row` is the place in ``rows``,
        from 1, `RowError.field` the key, with the index of a number: ``wrench[2]``.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        return refused([RowError(0, "file", f"is not JSON: {error}")])
    problem = _envelope(content)
    if problem is not None:
        return refused([problem])
    rows = _Rows()
    for place, row in enumerate(content["rows"], start=1):
        _take(rows, place, row)
    return _table(rows)


def write_json(table: TableRows) -> str:
    """Write rows as JSON, in SI, with the digits that give back the same floats.

    Parameters
    ----------
    table : TableRows
        Rows in SI. What was not measured and an unknown uncertainty (NaN) become null; six unknown
        uncertainties and an empty text are left out.
    """
    loads, motions = table.wrench.tolist(), table.displacement.tolist()
    rows: list[dict[str, Any]] = [
        {"wrench": load, "displacement": _nulls(motion)}
        for load, motion in zip(loads, motions, strict=True)
    ]
    for row, bounds in zip(rows, table.uncertainty.tolist(), strict=True):
        if not all(map(math.isnan, bounds)):
            row["uncertainty"] = _nulls(bounds)
    for name, texts in texts_of(table).items():
        for row, text in zip(rows, texts, strict=True):
            if text:
                row[name] = text
    return json.dumps({"units": "SI", "rows": rows}, allow_nan=False)


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
    other = [key for key in content if key not in ("rows", "units")]
    if other:
        return RowError(0, str(other[0]), "is not a key of a table; there are rows and units")
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


def _table(rows: _Rows) -> ParsedTable:
    """Make the arrays and check what concerns a row as a whole."""
    block: Array = np.array(rows.numbers, dtype=float).reshape(-1, 18)
    good = np.ones(len(block), dtype=bool)
    for at in turned_too_far(block[:, 6:12]):
        good[at] = False
        message = rotation_message(block[at, 9:12])
        rows.errors.append(RowError(rows.place[at], "displacement", message))
    kept = [texts for texts, keep in zip(rows.texts, good, strict=True) if keep]
    return ParsedTable(
        wrench=block[good, :6],
        displacement=block[good, 6:12],
        uncertainty=block[good, 12:],
        source=tuple(texts[0] for texts in kept),
        note=tuple(texts[1] for texts in kept),
        fingerprint=tuple(texts[2] for texts in kept),
        row=np.array(rows.place, dtype=np.int64)[good],
        errors=listed(rows.errors),
    )
