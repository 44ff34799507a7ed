"""The mistakes of one file: the first thousand are kept, all are counted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

MOST_ERRORS = 1000
"""Errors listed at most; one more line then says that there are more."""

MOST_MISTAKES = 100 * MOST_ERRORS
"""Reading stops after so many: 8.8 KB of gzip can hold six million, 78 s of processor time."""

_MOST_AT_ONCE = 20 * MOST_ERRORS  # kept until a piece of a file is done and they can be sorted


@dataclass(frozen=True, order=True)
class RowError:
    """One mistake in a table file.

    Parameters
    ----------
    row : int
        CSV: the line of the file, from 1, as an editor counts; XLSX: the row of the sheet. JSON,
        HDF5, Parquet: the place in the file's rows, from 1.
        0: the file as a whole.
    field : str
        The column as the header writes it, or the JSON key with its index.
    message : str
        What is wrong and what to write.
    """

    row: int
    field: str
    message: str

    def as_dict(self) -> dict[str, int | str]:
        """Return the error as the HTTP reply carries it."""
        return {"row": self.row, "field": self.field, "message": self.message}


class Mistakes:
    """What is wrong with a file; grows no longer than can be read.

    Attributes
    ----------
    count : int
        All there are, also those that are not kept.
    whole : bool
        Whether one of them is about the file as a whole: then what was read means nothing.
    """

    def __init__(self) -> None:
        self._kept: list[RowError] = []
        self.count = 0
        self.whole = False

    def __bool__(self) -> bool:
        return self.count > 0

    def __iter__(self) -> Iterator[RowError]:
        return iter(self.listed())

    def append(self, error: RowError) -> None:
        """Add a mistake."""
        self.count += 1
        if len(self._kept) < _MOST_AT_ONCE:
            self._kept.append(error)

    def extend(self, errors: Iterable[RowError]) -> None:
        """Add mistakes."""
        for error in errors:
            self.append(error)

    def ruin(self, error: RowError) -> None:
        """Add a mistake that leaves no meaning to the whole file, or to all that follows it."""
        self.append(error)
        self.whole = True

    def settle(self) -> None:
        """Keep the first by row: a piece of the file is done, and the next one has higher rows."""
        self._kept.sort(key=lambda error: error.row)
        del self._kept[MOST_ERRORS + 1 :]

    def listed(self) -> tuple[RowError, ...]:
        """Return the first by row, with a last one that says how many there are more."""
        self.settle()
        if self.count <= MOST_ERRORS:
            return tuple(self._kept)
        message = f"{self.count - MOST_ERRORS} more errors are not listed; correct these first"
        if self.count > MOST_MISTAKES:
            message += f"; reading stopped after more than {MOST_MISTAKES:,}"
        row = self._kept[MOST_ERRORS].row if len(self._kept) > MOST_ERRORS else 0
        return (*self._kept[:MOST_ERRORS], RowError(row, "", message))
