"""Tables as JSON: ``{"units": "SI", "rows": [{"wrench": [6], "displacement": [6], ...}]}``.

A displacement that was not measured is null, but not all six. A row may have ``uncertainty`` (six
numbers, null where unknown), ``compliance`` (the tangent, six lists of six numbers: a line for each
of ux uy uz rx ry rz, over fx fy fz mx my mz), ``source``, ``note`` and ``fingerprint``. Always SI.
An export also names its ``component`` and its ``table_version``, and each row's number in the
ledger, ``row``; they may stand in an import, which does not look at them.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from service.formats.exact import vanished
from service.formats.jsonstream import JsonError, members
from service.formats.limits import excesses
from service.formats.mistakes import MOST_ERRORS, RowError
from service.formats.options import Options, Told
from service.formats.parsed import (
    Array,
    ParsedTable,
    joined,
    text_problem,
)
from service.formats.spelling import CARRIED, DISPLACEMENT, TEXTS, UNCERTAINTY, WRENCH
from surrogate.table.rows import LoadRange, unknown_column

_AROUND = ("units", "contract", "provenance", "rows", "component", "table_version")
_KEYS = ("wrench", "displacement", "uncertainty", "compliance", *TEXTS, *CARRIED)
_UNKNOWN = (math.nan,) * 6
_NO_TANGENT = (math.nan,) * 36
_WIDTH = 18 + 36  # wrench, displacement, uncertainty; compliance
PIECE = 20_000  # rows at once


@dataclass
class _Rows:
    """The rows read so far that have no mistake, and the mistakes."""

    place: list[int] = field(default_factory=list)
    numbers: list[tuple[float, ...]] = field(default_factory=list)  # 54 a row
    texts: list[tuple[str, ...]] = field(default_factory=list)
    errors: list[RowError] = field(default_factory=list)


@dataclass(frozen=True)
class _Item:
    """One entry of ``rows``."""

    value: Any


_NO_TABLE = RowError(
    0, "rows", 'is not a table; write {"rows": [{"wrench": [6 numbers], "displacement": [6]}]}'
)


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
    told = Told(format="json")
    content = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    pieces = list(_tables(io.BytesIO(content), Options(load_range=load_range), told))
    return joined(pieces, told.mistakes)


def json_file(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the good rows of a JSON file piece by piece; `told` gets what is wrong."""
    with path.open("rb") as file:
        yield from _tables(file, options, told)


def _tables(file: BinaryIO, options: Options, told: Told) -> Iterator[ParsedTable]:
    rows, listed = _Rows(), False
    try:
        for key, value in members(file, "rows", item=_Item, parse_float=_parsed_float, pairs=_once):
            if isinstance(value, _Item):
                told.read += 1
                _take(rows, told.read, value.value)
                if told.read % PIECE == 0 or len(rows.errors) > MOST_ERRORS:
                    yield _table(rows, options, told)
                    if told.is_beyond_limits():
                        return
                    rows = _Rows()
                continue
            problem = _problem(key, value)
            if problem is not None:
                told.mistakes.ruin(problem)
                return
            listed = listed or key == "rows"
    except (JsonError, ValueError) as error:
        place = told.read + 1 if told.read else 0
        told.mistakes.ruin(RowError(place, "file", str(error)))
        return
    if not listed:
        told.mistakes.ruin(_NO_TABLE)
    elif not told.read:
        told.mistakes.ruin(RowError(0, "rows", "there is no row"))
    if rows.place or rows.errors:
        yield _table(rows, options, told)
        told.is_beyond_limits()


def _problem(key: str, value: Any) -> RowError | None:
    """Check a member that stands around the rows, or is them and no list."""
    if key == "" or (key == "rows" and not isinstance(value, list)):
        return _NO_TABLE
    if key == "units" and value != "SI":
        return RowError(0, "units", "a JSON table is in SI; convert it, or send CSV with units")
    if key not in _AROUND:
        message = f"is not a key of a table; there are {', '.join(_AROUND)}"
        return RowError(0, str(key), message)
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


def _table(rows: _Rows, options: Options, told: Told) -> ParsedTable:
    """Make the arrays and check what concerns a row as a whole."""
    block: Array = np.array(rows.numbers, dtype=float).reshape(-1, _WIDTH)
    good = np.ones(len(block), dtype=bool)
    beyond = (
        ()
        if options.tare
        else excesses(block[:, :6], block[:, 6:12], options.load_range, block[:, 12:18])
    )
    for excess in beyond:
        good[excess.at] = False
        place = rows.place[excess.at]
        rows.errors.append(RowError(place, place_of(excess.name), excess.message))
    told.mistakes.extend(rows.errors)
    told.mistakes.settle()
    kept = [texts for texts, keep in zip(rows.texts, good, strict=True) if keep]
    return ParsedTable(
        wrench=block[good, :6],
        displacement=block[good, 6:12],
        uncertainty=_known(block[good, 12:18]),
        compliance=_known(block[good, 18:].reshape(-1, 6, 6)),
        source=tuple(texts[0] for texts in kept),
        note=tuple(texts[1] for texts in kept),
        fingerprint=tuple(texts[2] for texts in kept),
        row=np.array(rows.place, dtype=np.int64)[good],
        errors=(),
    )


def _known(column: Array) -> Array:
    """Return a column as it is, or one of no memory if all of it is unknown."""
    return unknown_column(*column.shape) if np.isnan(column).all() else column
