"""Write a table as JSON, in the form that `jsonform` reads."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from service.formats.parsed import TableRows, texts_of


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
    return "".join(json_text([table], about or {}))


def json_text(pieces: Iterable[TableRows], about: Mapping[str, Any]) -> Iterator[str]:
    """Yield the text of a JSON table, with what stands around its rows, piece by piece."""
    head = json.dumps({**about, "units": "SI"}, allow_nan=False)
    yield head[:-1] + ', "rows": ['
    between = ""
    for piece in pieces:
        rows = [json.dumps(row, allow_nan=False) for row in _row_dicts(piece)]
        if rows:
            yield between + ", ".join(rows)
            between = ", "
    yield "]}"


def _row_dicts(table: TableRows) -> list[dict[str, Any]]:
    """Return rows with the keys that say something."""
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
    told = texts_of(table) | {name: getattr(table, name, ()) for name in ("when", "who")}
    for name, texts in told.items():
        for row, text in zip(rows, texts, strict=bool(texts)):
            if text:
                row[name] = text
    return rows


def _nulls(values: list[float]) -> list[float | None]:
    """Return the numbers with None for each NaN."""
    return [None if math.isnan(value) else value for value in values]
