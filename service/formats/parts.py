"""Reading a table file behind the fence: what the child answers, and what is made of it here.

The child answers a part of arrays and texts for each piece of the file, and a last one that says
what there was to say. Nothing in it can make its reader do more than take numbers and texts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from service.fence import FenceError, Limits, Part, fenced
from service.formats.mistakes import RowError
from service.formats.options import Options, Told, options_from, options_told
from service.formats.parsed import ParsedTable
from service.formats.reading import read_table_file
from service.formats.timejoin import joined_logs
from service.formats.units import FORCE, si_factor
from surrogate.table.rows import unknown_column

MOST_PREVIEW = 100
LIMITS = Limits(memory=1024 << 20, seconds=60.0, output=1024 << 20)
"""A million rows of 17 digits take 20 s and 300 MB."""

_NUMBERS: dict[str, tuple[int, ...]] = {
    "wrench": (6,),
    "displacement": (6,),
    "uncertainty": (6,),
    "compliance": (6, 6),
}
_TEXTS = ("source", "note", "fingerprint")


@dataclass(frozen=True)
class Read:
    """A file that was read: what there is to say of it, and its good rows in pieces.

    Attributes
    ----------
    told : mapping
        As JSON has it: ``format``, ``gzip``, ``rows``, ``columns``, ``ignored``, ``errors``,
        ``whole`` (whether one of them is about the file as a whole), ``preview``.
    """

    told: Mapping[str, Any]
    parts: Sequence[Part]

    def pieces(self) -> Iterator[ParsedTable]:
        """Yield the rows some at a time."""
        return (_piece(part) for part in self.parts)


def read_fenced(files: Sequence[Path], options: Options, preview: int = 0) -> Read:
    """Read a table file, or two logs to be joined by time, in a child with limits.

    Raises
    ------
    FenceBusyError
        If as many files are read as may be, for a minute.
    OSError
        If the disk is full.
    """
    words = {
        "second": str(files[1]) if len(files) > 1 else None,
        "options": options_told(options),
        "preview": preview,
    }
    try:
        parts = fenced("service.formats.parts:table_parts", files[0], words, LIMITS)
    except FenceError as error:
        told = Told()
        told.mistakes.ruin(RowError(0, "file", str(error)))
        return Read(_summary(told, 0, []), [])
    return Read(parts[-1].fields, parts[:-1])


def warm_up() -> None:
    """Make what reading any file needs, before the first file comes."""
    si_factor("N", FORCE)


def table_parts(
    file: Path, second: str | None, options: Mapping[str, Any], preview: int
) -> Iterator[Part]:
    """Read a file, or two, and yield its pieces; the last part says what was found.

    Parameters
    ----------
    file : path
    second : str or None
        The log of the displacements, if `file` is that of the loads.
    options : mapping
        As `options_told` writes them.
    preview : int
        How many of the first good rows are told.
    """
    said, told, good = options_from(options), Told(), 0
    shown: list[dict[str, Any]] = []
    if second is None:
        pieces = read_table_file(file, said, told)
    else:
        pieces = joined_logs(file, Path(second), said, told)
    for piece in pieces:
        if told.mistakes.whole:
            break
        shown += _preview(piece, min(preview, MOST_PREVIEW) - len(shown))
        good += len(piece)
        if len(piece):
            yield _part(piece)
    yield Part(_summary(told, good, shown))


def _summary(told: Told, good: int, preview: list[dict[str, Any]]) -> dict[str, Any]:
    refused = told.read - good - told.tare - told.unmatched
    return {
        "format": told.format,
        "gzip": told.gzip,
        "rows": {
            "read": told.read,
            "good": good,
            "refused": refused,
            "tare": told.tare,
            "unmatched": told.unmatched,
        },
        "columns": [
            {"column": one.label, "name": one.name, "unit": one.unit} for one in told.columns
        ],
        "ignored": told.ignored,
        "above": told.above,
        "errors": [error.as_dict() for error in told.mistakes.listed()],
        "whole": told.mistakes.whole,
        "preview": preview,
    }


def _preview(piece: ParsedTable, count: int) -> list[dict[str, Any]]:
    return [
        {
            "row": int(piece.row[place]),
            "wrench": piece.wrench[place].tolist(),
            "displacement": [
                None if np.isnan(value) else float(value) for value in piece.displacement[place]
            ],
        }
        for place in range(min(count, len(piece)))
    ]


def _part(piece: ParsedTable) -> Part:
    """Return a piece as a part; columns that are unknown are not in it."""
    numbers = {name: getattr(piece, name) for name in _NUMBERS}
    arrays = {name: column for name, column in numbers.items() if any(column.strides)}
    texts = {name: _packed(getattr(piece, name)) for name in _TEXTS}
    return Part({"n": len(piece), **texts}, arrays | {"row": piece.row.astype(np.int64)})


def _packed(texts: Sequence[str]) -> list[str] | str:
    """Return a column of texts, as one where all are the same."""
    return texts[0] if len(set(texts)) == 1 else list(texts)


def _piece(part: Part) -> ParsedTable:
    count = int(part.fields["n"])
    found = {
        name: part.arrays[name].reshape(count, *shape)
        if name in part.arrays
        else unknown_column(count, *shape)
        for name, shape in _NUMBERS.items()
    }
    source, note, fingerprint = (_column(part.fields[name], count) for name in _TEXTS)
    wrench, displacement, uncertainty, compliance = (found[name] for name in _NUMBERS)
    numbers = wrench, displacement, uncertainty, compliance
    return ParsedTable(*numbers, source, note, fingerprint, part.arrays["row"], ())


def _column(told: list[str] | str, count: int) -> tuple[str, ...]:
    return (told,) * count if isinstance(told, str) else tuple(told)
