"""What reading a table file gives: SI arrays of the good rows, and an error for each bad field."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain
from typing import Protocol

import numpy as np

from service.formats.mistakes import Mistakes, RowError
from surrogate.table.rows import unknown_column

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
        Sorted by row; empty in a piece of a file, whose mistakes are collected elsewhere.
    time : numpy.ndarray or None
        Shape (n,), s; of logs that are joined by it.
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
    time: Array | None = None

    def __len__(self) -> int:
        return len(self.wrench)

    def take(self, which: Array) -> ParsedTable:
        """Return the rows that a mask of shape (n,) picks."""
        if which.all():
            return self
        places = np.flatnonzero(which).tolist()
        return replace(
            self,
            wrench=self.wrench[which],
            displacement=self.displacement[which],
            uncertainty=_picked(self.uncertainty, which),
            compliance=_picked(self.compliance, which),
            source=tuple(self.source[place] for place in places),
            note=tuple(self.note[place] for place in places),
            fingerprint=tuple(self.fingerprint[place] for place in places),
            row=self.row[which],
            time=None if self.time is None else self.time[which],
        )


def nothing(errors: tuple[RowError, ...] = ()) -> ParsedTable:
    """Return a table without rows."""
    none, tangents = np.empty((0, 6)), np.empty((0, 6, 6))
    row = np.empty(0, dtype=np.int64)
    return ParsedTable(none, none, none, tangents, (), (), (), row, errors)


def joined(tables: list[ParsedTable], mistakes: Mistakes) -> ParsedTable:
    """Return the rows of the pieces of a file, in this order, and its errors."""
    if not tables or mistakes.whole:
        return nothing(mistakes.listed())
    return ParsedTable(
        wrench=np.concatenate([table.wrench for table in tables]),
        displacement=np.concatenate([table.displacement for table in tables]),
        uncertainty=_joined_known([table.uncertainty for table in tables]),
        compliance=_joined_known([table.compliance for table in tables]),
        source=tuple(chain.from_iterable(table.source for table in tables)),
        note=tuple(chain.from_iterable(table.note for table in tables)),
        fingerprint=tuple(chain.from_iterable(table.fingerprint for table in tables)),
        row=np.concatenate([table.row for table in tables]),
        errors=mistakes.listed(),
        time=_joined_times([table.time for table in tables]),
    )


def _picked(column: Array, which: Array) -> Array:
    """Pick rows of a column; of an unknown one another of no memory."""
    if any(column.strides):
        return column[which]
    return unknown_column(int(which.sum()), *column.shape[1:])


def _joined_times(times: list[Array | None]) -> Array | None:
    known = [time for time in times if time is not None]
    return np.concatenate(known) if known else None


def _joined_known(columns: list[Array]) -> Array:
    """Join columns; what is unknown in all of them takes no memory (`unknown_column`)."""
    if any(any(column.strides) for column in columns):
        return np.concatenate(columns)
    return unknown_column(sum(map(len, columns)), *columns[0].shape[1:])


def text_problem(text: str) -> str | None:
    """Say why a text could not be kept by the ledger and the table store, or return None."""
    if "\0" in text:
        return "holds a zero byte; remove it"
    try:
        text.encode()
    except UnicodeEncodeError:
        return "holds half a character (a lone surrogate); remove it"
    return None
