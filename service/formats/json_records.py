"""JSON with an object of named columns a row: a list of them, as pandas writes, or one a line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from wrenchbook.service.formats.cells import Digits
from wrenchbook.service.formats.json_reader import JsonError, JsonReader
from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.preamble import Record
from wrenchbook.service.formats.rows import ParsedTable
from wrenchbook.service.formats.text import read_records

_KEYS = (  # of a table in one object
    "units|contract|provenance|rows|component|table_version|inputs|outputs"
)
_RECORDS = re.compile(rf'\s*(\[\s*\{{|\{{\s*"(?!({_KEYS})"))')
_COLUMNS = "write pandas' frames with to_json(orient='records')"


def is_records(text: str) -> bool:
    """Return whether a JSON text is rows of named columns; else it is a table with ``rows``."""
    return _RECORDS.match(text) is not None


def read_json_records(text: str, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows piece by piece; `report` gets the mistakes.

    Raises
    ------
    JsonError
        If the text is no JSON, or rows are not objects of the same columns.
    """
    # Numbers stay text, so that their digits and units are read as those of all other formats.
    reader = JsonReader(text, parse_float=Digits, parse_int=Digits)
    records = _records(reader)
    yield from read_records(records, options, report)


def _records(reader: JsonReader) -> Iterator[Record]:
    """Yield the header as record 0, then the rows."""
    names: list[str] = []
    for row, found in enumerate(_objects(reader), start=1):
        if not isinstance(found, dict) or any(isinstance(one, dict) for one in found.values()):
            raise JsonError(f"row {row} is no object of named columns; {_COLUMNS}")
        if row == 1:
            names = list(found)
            yield 0, names
        if len(found) > len(names) or not found.keys() <= set(names):
            more = ", ".join(found.keys() - set(names))
            raise JsonError(f"row {row} has columns that row 1 has not: {more}; write them as null")
        yield row, [_cell(row, name, found.get(name)) for name in names]


def _objects(reader: JsonReader) -> Iterator[Any]:
    if reader.peek() == "[":
        yield from reader.items()
        reader.end()
        return
    while reader.peek():
        yield reader.value()


def _cell(row: int, name: str, value: Any) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        raise JsonError(f"row {row}: {name!r} is neither a number nor a text")
    return value
