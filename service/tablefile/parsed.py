"""What reading a table file gives: SI arrays of the good rows, and an error for each bad field."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

MOST_ERRORS = 1000
"""Errors listed at most; one more line then says that there are more."""

Array = np.ndarray


class TableRows(Protocol):
    """Rows that can be written: a `ParsedTable`, a surrogate's rows, anything of this form.

    ``note`` and ``fingerprint``, one text a row, may be there as well.
    """

    @property
    def wrench(self) -> Array:
        """Shape (n, 6), N and N·m."""
        ...

    @property
    def displacement(self) -> Array:
        """Shape (n, 6), m and rad."""
        ...

    @property
    def uncertainty(self) -> Array:
        """Shape (n, 6), m and rad; NaN where unknown."""
        ...

    @property
    def compliance(self) -> Array:
        """Shape (n, 6, 6), m and rad over N and N·m; NaN where unknown."""
        ...

    @property
    def source(self) -> Iterable[str]:
        """Where each row came from."""
        ...


def texts_of(table: TableRows) -> dict[str, list[str]]:
    """Return source, note and fingerprint as lists of plain texts, those that say anything."""
    given = {
        "source": table.source,
        "note": getattr(table, "note", ()),
        "fingerprint": getattr(table, "fingerprint", ()),
    }
    texts = {name: [str(text) for text in column] for name, column in given.items()}
    return {name: column for name, column in texts.items() if any(column)}


@dataclass(frozen=True, order=True)
class RowError:
    """One mistake in a table file.

    Parameters
    ----------
    row : int
        CSV: the line of the file, from 1, as an editor counts. JSON, HDF5: the place in ``rows``,
        from 1.
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


@dataclass(frozen=True)
class ParsedTable:
    """The rows of a table file, in SI.

    Only rows without a mistake are in the arrays; whether to load them while `errors` is not
    empty is the caller's decision.

    Parameters
    ----------
    wrench : numpy.ndarray
        Shape (n, 6), N and N·m.
    displacement : numpy.ndarray
        Shape (n, 6), m and rad; NaN where not measured, but never all six.
    uncertainty : numpy.ndarray
        Shape (n, 6), m and rad; NaN where the file gives none.
    compliance : numpy.ndarray
        Shape (n, 6, 6), the tangent d(displacement)/d(wrench), m and rad over N and N·m; all of a
        row or NaN where the file gives none.
    source, note, fingerprint : tuple of str
        One a row; empty where the file gives none.
    row : numpy.ndarray
        Shape (n,), where each row stood: see `RowError.row`.
    errors : tuple of RowError
        Sorted by row.
    """

    wrench: Array
    displacement: Array
    uncertainty: Array
    compliance: Array
    source: tuple[str, ...]
    note: tuple[str, ...]
    fingerprint: tuple[str, ...]
    row: Array
    errors: tuple[RowError, ...]

    def __len__(self) -> int:
        return len(self.wrench)


def refused(errors: list[RowError]) -> ParsedTable:
    """Return a table without rows: the file as a whole could not be read."""
    none, tangents = np.empty((0, 6)), np.empty((0, 6, 6))
    row = np.empty(0, dtype=np.int64)
    return ParsedTable(none, none, none, tangents, (), (), (), row, listed(errors))


def listed(errors: list[RowError]) -> tuple[RowError, ...]:
    """Sort the errors by row and cut a list that nobody would read."""
    ordered = sorted(errors, key=lambda error: error.row)
    if len(ordered) > MOST_ERRORS:
        more = len(ordered) - MOST_ERRORS
        message = f"{more} more errors are not listed; correct these first"
        ordered[MOST_ERRORS:] = [RowError(ordered[MOST_ERRORS].row, "", message)]
    return tuple(ordered)


def text_problem(text: str) -> str | None:
    """Say why a text could not be kept by the ledger and the table store, or return None."""
    if "\0" in text:
        return "holds a zero byte; remove it"
    try:
        text.encode()
    except UnicodeEncodeError:
        return "holds half a character (a lone surrogate); remove it"
    return None
