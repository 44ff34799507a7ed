"""Input and output of reading a table file: the sender's options, the report with all mistakes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from wrenchbook.service.formats.columns import Columns, columns_of
from wrenchbook.surrogate.findings.finding import RigFinding
from wrenchbook.surrogate.table.rows import LoadRange
from wrenchbook.surrogate.table.space import DEFAULT, Space

Format = Literal["csv", "xlsx", "parquet", "hdf5", "json", "mat"]
Role = Literal["table", "loads", "displacements"]

MOST_ROWS = 5_000_000  # of a file: 0.6 GB as arrays without tangents
MOST_ZERO_ROWS = 10_000  # all in the first piece of a file
MOST_LISTED = 1000
"""Mistakes listed at most; one more line then counts the others."""

MOST_MISTAKES = 100 * MOST_LISTED
"""Reading stops after so many: 8.8 KB of gzip can hold six million, 78 s of processor time."""

_MOST_FIELD = 200  # characters: a key of a row can have a million
_MOST_CAUSES = 100
_MOST_SHOWN = 10  # rows and columns of a cause
_VALUE = re.compile(r"'[^']*'|[-+\d][\w.+-]*")  # differs between two mistakes of one cause
_MOST_KEPT = 20 * MOST_LISTED  # until they are sorted at the end of a piece


@dataclass(frozen=True)
class Options:
    """Options of an import.

    Attributes
    ----------
    format : str or None
        The format of the file; found from its content if None.
    decimal : {".", ","} or None
        The decimal mark of numbers in text; found from them if None. Numbers that an XLSX or a
        JSON stores as such have a point.
    ignore : tuple of str
        Labels of columns to leave out.
    ignore_extra : bool
        Whether all unknown columns are left out.
    mapping : mapping of str to str
        From a label in the file to a column: ``fz [N]``, or ``-fz [N]`` to turn the sign.
    missing_loads : {"zero"} or None
        The value of loads without a column; None refuses such a file.
    zero_rows : int
        The mean of so many first rows, the zero offset, is subtracted from all others.
    sheet : str or None
        Of an XLSX; the first one if None.
    rig : str
        The TOML of the rig of the readings; empty if they are the interface's.
    time_offset_s : float or "auto"
        Added to the times of displacements to match the clock of the loads, s; "auto" is the lag
        that the logs show.
    max_gap_s : float or None
        Longest interval between two loads to interpolate in, s.
    load_range : LoadRange or None
        Of the component, N and N·m: loads far beyond it are mistakes. Its space is that of the
        rows; one interface without further inputs if None.
    fingerprint : str or None
        Of the component's setup: solves of any other are mistakes.
    solved : sequence of sequences of float, or None
        Compliance (outputs, inputs), SI, of the component's solves: findings compare rows with it.
    linear : bool
        Whether the component is.
    role : {"table", "loads", "displacements"}
        A table has loads and displacements; a log has one of them, and times.
    """

    format: Format | None = None
    decimal: Literal[".", ","] | None = None
    ignore: tuple[str, ...] = ()
    ignore_extra: bool = False
    mapping: Mapping[str, str] = field(default_factory=dict)
    missing_loads: Literal["zero"] | None = None
    zero_rows: int = 0
    sheet: str | None = None
    rig: str = ""
    time_offset_s: float | Literal["auto"] = 0.0
    max_gap_s: float | None = None
    load_range: LoadRange | None = None
    fingerprint: str | None = None
    solved: Sequence[Sequence[float]] | None = None
    linear: bool = True
    role: Role = "table"

    @property
    def space(self) -> Space:
        """The inputs and outputs of the rows."""
        return DEFAULT if self.load_range is None else self.load_range.space

    @property
    def columns(self) -> Columns:
        """The columns of the rows."""
        return columns_of(self.space)

    def as_json(self) -> dict[str, Any]:
        """Return the options as JSON values."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        span = self.load_range
        ends = [span.low.tolist(), span.high.tolist(), span.space.words()] if span else None
        values["load_range"] = ends
        return values | {"mapping": dict(self.mapping), "ignore": list(self.ignore)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Options:
        """Return options from the result of `as_json`."""
        low, high, words = values["load_range"] or ([], [], None)
        span = LoadRange(np.array(low), np.array(high), Space.read(words)) if words else None
        return cls(**{**values, "ignore": tuple(values["ignore"]), "load_range": span})


@dataclass(frozen=True, order=True)
class FileMistake:
    """One mistake in a table file.

    Parameters
    ----------
    row : int
        CSV: the line of the file, from 1. XLSX: the row of the sheet. JSON, HDF5, Parquet: the
        number of the row, from 1. 0: the whole file.
    field : str
        The label of the column, or the JSON key with its index.
    message : str
        What is wrong and what to write.
    """

    row: int
    field: str
    message: str

    def as_dict(self) -> dict[str, int | str]:
        """Return the mistake as in the HTTP reply."""
        return {"row": self.row, "field": self.field, "message": self.message}


class Mistakes:
    """The mistakes of a file: all are counted, the first by row are kept.

    Attributes
    ----------
    count : int
        Of all mistakes.
    whole : bool
        Whether one of them concerns the whole file; no row of it is loaded then.
    """

    def __init__(self) -> None:
        self._kept: list[FileMistake] = []
        self._causes: dict[str, MistakeCause] = {}
        self.count = 0
        self.whole = False

    def __bool__(self) -> bool:
        return self.count > 0

    def __iter__(self) -> Iterator[FileMistake]:
        return iter(self.listed())

    def add(self, row: int, field: str, message: str) -> None:
        """Add a mistake of a row."""
        self.count += 1
        mistake = FileMistake(row, field[:_MOST_FIELD], message)
        if len(self._kept) < _MOST_KEPT:
            self._kept.append(mistake)
        key = _VALUE.sub("", message)
        if key in self._causes or len(self._causes) < _MOST_CAUSES:
            self._causes.setdefault(key, MistakeCause(mistake)).add(mistake)

    def ruin(self, row: int, field: str, message: str) -> None:
        """Add a mistake of the whole file."""
        self.add(row, field, message)
        self.whole = True

    def settle(self) -> None:
        """Keep the first by row, at the end of a piece: later pieces have higher rows."""
        self._kept.sort(key=lambda mistake: mistake.row)
        del self._kept[MOST_LISTED + 1 :]

    def causes(self) -> list[dict[str, Any]]:
        """Return the mistakes by cause: the first of each, their count and the first rows."""
        causes = sorted(self._causes.values(), key=lambda cause: cause.first.row)
        return [cause.as_dict() for cause in causes]

    def listed(self) -> tuple[FileMistake, ...]:
        """Return the first by row; a last one counts those that are not listed."""
        self.settle()
        if self.count <= MOST_LISTED:
            return tuple(self._kept)
        message = f"{self.count - MOST_LISTED} more errors are not listed; correct these first"
        if self.count > MOST_MISTAKES:
            message += f"; reading stopped after more than {MOST_MISTAKES:,}"
        row = self._kept[MOST_LISTED].row if len(self._kept) > MOST_LISTED else 0
        return (*self._kept[:MOST_LISTED], FileMistake(row, "", message))


@dataclass
class MistakeCause:
    """Mistakes of one cause.

    Attributes
    ----------
    first : FileMistake
    count : int
    rows : dict of int to None
        The first of the rows, each once.
    fields : dict of str to None
        The first of the columns, each once.
    """

    first: FileMistake
    count: int = 0
    rows: dict[int, None] = field(default_factory=dict)
    fields: dict[str, None] = field(default_factory=dict)

    def add(self, mistake: FileMistake) -> None:
        """Count a mistake."""
        self.count += 1
        if len(self.rows) < _MOST_SHOWN:
            self.rows[mistake.row] = None
        if len(self.fields) < _MOST_SHOWN:
            self.fields[mistake.field] = None

    def as_dict(self) -> dict[str, Any]:
        """Return the cause as in the HTTP reply."""
        more = {"count": self.count, "rows": list(self.rows), "fields": list(self.fields)}
        return self.first.as_dict() | more


@dataclass(frozen=True)
class FoundColumn:
    """A column of the file that is read: its label, its name, its unit (empty for a text)."""

    label: str
    name: str
    unit: str


@dataclass
class ReadReport:
    """Report on reading a file; it is complete after the last piece.

    Attributes
    ----------
    columns : list of FoundColumn
    ignored : list of str
        Labels of columns that were left out.
    titles : list of str
        Lines above the header.
    clock : dict
        Of two logs: the seconds added to the displacements' times, and the lag that the logs show.
    findings : list of RigFinding
        Of the whole file.
    read, zeroed, unmatched : int
        Rows of the file; those in the mean of the zero offset; those with no load at their time.
    """

    mistakes: Mistakes = field(default_factory=Mistakes)
    format: str = ""
    gzip: bool = False
    columns: list[FoundColumn] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    titles: list[str] = field(default_factory=list)
    clock: dict[str, float | None] | None = None
    findings: list[RigFinding] = field(default_factory=list)
    read: int = 0
    zeroed: int = 0
    unmatched: int = 0

    def is_beyond_limits(self) -> bool:
        """Return whether reading ends here: with too many rows or mistakes, no row is loaded."""
        self.mistakes.settle()
        if self.read > MOST_ROWS:
            message = f"has more than {MOST_ROWS:,} rows; send it in parts"
            self.mistakes.ruin(0, "file", message)
        elif self.mistakes.count > MOST_MISTAKES:
            self.mistakes.whole = True
        return self.mistakes.whole

    def label(self, name: str, columns: Columns) -> str:
        """Return the label of a column in the file: ``Fz [kN]``; ``wrench[2]`` in JSON and HDF5."""
        if self.columns or self.format not in ("json", "hdf5"):
            return next((one.label for one in self.columns if one.name == name), name)
        keys = ("wrench", "displacement", "uncertainty")
        named = ((key, getattr(columns, key)) for key in keys)
        found = (f"{key}[{names.index(name)}]" for key, names in named if name in names)
        return next(found, name)

    def as_json(self, good: int, preview: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the report as in the HTTP reply, with the number of good rows and a preview."""
        rows = {
            "read": self.read,
            "good": good,
            "refused": self.read - good - self.zeroed - self.unmatched,
            "tare": self.zeroed,
            "unmatched": self.unmatched,
        }
        return {
            "format": self.format,
            "gzip": self.gzip,
            "rows": rows,
            "clock": self.clock,
            "columns": [
                {"column": one.label, "name": one.name, "unit": one.unit} for one in self.columns
            ],
            "ignored": self.ignored,
            "above": self.titles,
            "errors": [mistake.as_dict() for mistake in self.mistakes],
            "causes": self.mistakes.causes(),
            "whole": self.mistakes.whole,
            "preview": preview,
        }
