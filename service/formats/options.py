"""Arguments and results of a reader: options, and the report with all mistakes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from wrenchbook.service.contract import ImportFormat
from wrenchbook.service.formats.columns import Columns, columns_of
from wrenchbook.surrogate.findings.response import RigFinding
from wrenchbook.surrogate.table.rows import LoadRange, Rows, is_unknown, unknown_column
from wrenchbook.surrogate.table.space import DEFAULT, Space

Array = np.ndarray
Problem = tuple[int, str, str]  # the index of a row in the arrays, its column, and the remedy

FEA = "fea"  # the source of solves
MEASURED = "measured"  # the source of rows without a source
Role = Literal["table", "loads", "displacements"]

MAX_ROWS = 5_000_000  # rows of a file: 0.6 GB as arrays without tangents
MAX_ZERO_ROWS = 10_000  # rows of the zero offset, all in the first piece of a file
MAX_LISTED = 1000  # listed mistakes; a further line then counts the others
# Mistakes after which reading stops: 8.8 KB of gzip may have six million, 78 s of processor time.
MAX_MISTAKES = 100 * MAX_LISTED
_MAX_FIELD = 200  # characters of a field in a message: a key of a row can have a million
_MAX_CAUSES = 100  # causes in a report: more would hide the frequent ones
_MAX_SHOWN = 10  # rows and columns of a cause in a message
_VALUE = re.compile(r"'[^']*'|[-+\d][\w.+-]*")  # what differs in mistakes of one cause
_MAX_FIRST = 20 * MAX_LISTED  # mistakes before they are sorted at the end of a piece


@dataclass(frozen=True)
class Options:
    """Options of an import.

    `format` and `decimal` (the mark of numbers in text) are found from the content if None.
    `ignore` has labels of columns to leave out, `mapping` labels and what they are: ``fz [N]``, or
    ``-fz [N]`` to turn the sign, or ``fz`` in the file's own unit; a number is a position, from 1.
    `missing_loads` is the value of loads without a column; None refuses such a file. The mean of
    the first `zero_rows` is subtracted from all others. `sheet` is of a workbook, or a TDMS group.
    `rig` is the TOML of the readings' rig. `time_offset_s` is added to the times of displacements,
    "auto" is the lag that the logs show; `max_gap_s` is the longest interval between loads, s.

    `optional` are labels of `ignore` and `mapping` that a file may lack: those of a rig's profile.
    So may a file of another format lack its `sheet`, with `optional_sheet`.
    Of cycles of the main load: `skip_cycles` first ones are left out, `branch` is the one to load,
    rows of a pass within `thin` of the load range are averaged, and with `mean_cycles` the cycles.

    Of the component: the `load_range`, whose space is that of the rows; the `fingerprint` of its
    setup, since solves of any other are mistakes; the compliance (outputs, inputs), SI, of its
    solves in `solved`, with which findings compare rows; whether it is `linear`.
    """

    format: ImportFormat | None = None
    decimal: Literal[".", ","] | None = None
    ignore: tuple[str, ...] = ()
    ignore_extra: bool = False
    mapping: Mapping[str, str] = field(default_factory=dict)
    missing_loads: Literal["zero"] | None = None
    zero_rows: int = 0
    sheet: str | None = None
    optional_sheet: bool = False
    rig: str = ""
    time_offset_s: float | Literal["auto"] = 0.0
    max_gap_s: float | None = None
    optional: Sequence[str] = ()
    skip_cycles: int = 0
    branch: Literal["loading", "unloading"] | None = None
    thin: float | None = None
    mean_cycles: bool = False
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
        ends = [span.low.tolist(), span.high.tolist(), span.space.as_json()] if span else None
        values["load_range"] = ends
        return values | {"mapping": dict(self.mapping), "ignore": list(self.ignore)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Options:
        """Return options from the result of `as_json`."""
        low, high, space = values["load_range"] or ([], [], None)
        span = LoadRange(np.array(low), np.array(high), Space.read(space)) if space else None
        return cls(**{**values, "ignore": tuple(values["ignore"]), "load_range": span})


@dataclass(frozen=True, order=True)
class FileMistake:
    """A mistake in a table file: its place, and its remedy.

    `row` is the line of a CSV, the row of a sheet, else the number of the row, from 1; 0 is the
    whole file. `field` is the label of the column, or the JSON key with its index.
    """

    row: int
    field: str
    message: str

    def as_dict(self) -> dict[str, int | str]:
        """Return the mistake as in the HTTP reply."""
        return {"row": self.row, "field": self.field, "message": self.message}


class Mistakes:
    """The mistakes of a file.

    `is_ruined`: a mistake concerns the whole file, so that no row is loaded.
    """

    def __init__(self) -> None:
        self._first: list[FileMistake] = []
        self._causes: dict[str, MistakeCause] = {}
        self.count = 0
        self.is_ruined = False

    def __bool__(self) -> bool:
        return self.count > 0

    def add(self, row: int, field: str, message: str) -> None:
        """Add a mistake of a row."""
        self.count += 1
        mistake = FileMistake(row, field[:_MAX_FIELD], message)
        if len(self._first) < _MAX_FIRST:
            self._first.append(mistake)
        key = _VALUE.sub("", message)
        if key in self._causes or len(self._causes) < _MAX_CAUSES:
            self._causes.setdefault(key, MistakeCause(mistake)).add(mistake)

    def ruin(self, row: int, field: str, message: str) -> None:
        """Add a mistake of the whole file."""
        self.add(row, field, message)
        self.is_ruined = True

    def trim(self) -> None:
        """Keep the first mistakes by row, at the end of a piece: later pieces have higher rows."""
        self._first.sort(key=lambda mistake: mistake.row)
        del self._first[MAX_LISTED + 1 :]

    def causes(self) -> list[dict[str, Any]]:
        """Return the mistakes by cause: the first of each, their count and the first rows."""
        causes = sorted(self._causes.values(), key=lambda cause: cause.first.row)
        return [cause.as_dict() for cause in causes]

    def listed(self) -> tuple[FileMistake, ...]:
        """Return the first mistakes by row; a last one counts those that are not listed."""
        self.trim()
        if self.count <= MAX_LISTED:
            return tuple(self._first)
        message = f"{self.count - MAX_LISTED} more errors are not listed; correct these first"
        if self.count > MAX_MISTAKES:
            message += f"; reading stopped after more than {MAX_MISTAKES:,}"
        row = self._first[MAX_LISTED].row if len(self._first) > MAX_LISTED else 0
        return (*self._first[:MAX_LISTED], FileMistake(row, "", message))


@dataclass
class MistakeCause:
    """Mistakes of one cause: the first, their count, the first distinct rows and columns."""

    first: FileMistake
    count: int = 0
    rows: dict[int, None] = field(default_factory=dict)
    fields: dict[str, None] = field(default_factory=dict)

    def add(self, mistake: FileMistake) -> None:
        """Count a mistake."""
        self.count += 1
        if len(self.rows) < _MAX_SHOWN:
            self.rows[mistake.row] = None
        if len(self.fields) < _MAX_SHOWN:
            self.fields[mistake.field] = None

    def as_dict(self) -> dict[str, Any]:
        """Return the cause as in the HTTP reply."""
        more = {"count": self.count, "rows": list(self.rows), "fields": list(self.fields)}
        return self.first.as_dict() | more


@dataclass
class ReadReport:
    """Report on reading a file; it is complete after the last piece.

    `columns` are label, name and unit of those that are read, `labels` how messages call each name,
    `ignored` the labels of the others, `titles` lines above the header. `converted`: some numbers
    are not in the units of arrays. `clock`, of two logs: the seconds added to the displacements'
    times, and the lag that the logs show. `sheets` are those of a workbook, or the groups of a
    TDMS file, and `sheet` is the one that was read. `read`, `zeroed` and `unmatched` count the rows
    of the file, those in the mean of the zero offset, and those with no load at their time;
    `omitted` those of cycles by cause.
    """

    mistakes: Mistakes = field(default_factory=Mistakes)
    format: str = ""
    gzip: bool = False
    columns: list[tuple[str, str, str]] = field(default_factory=list)
    labels: dict[str, str] = field(default_factory=dict)
    converted: bool = False
    ignored: list[str] = field(default_factory=list)
    titles: list[str] = field(default_factory=list)
    sheets: list[str] = field(default_factory=list)
    sheet: str | None = None
    clock: dict[str, float | None] | None = None
    findings: list[RigFinding] = field(default_factory=list)
    read: int = 0
    zeroed: int = 0
    unmatched: int = 0
    omitted: dict[str, int] = field(default_factory=dict)

    def is_beyond_limits(self) -> bool:
        """Return whether reading ends here: with too many rows or mistakes no row is loaded."""
        self.mistakes.trim()
        if self.read > MAX_ROWS:
            message = f"has more than {MAX_ROWS:,} rows; send it in parts"
            self.mistakes.ruin(0, "file", message)
        elif self.mistakes.count > MAX_MISTAKES:
            self.mistakes.is_ruined = True
        return self.mistakes.is_ruined

    def as_json(self, good: int, preview: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the report as in the HTTP reply, with the number of good rows and a preview."""
        names = ("column", "name", "unit")
        omitted = sum(self.omitted.values())
        return {
            "format": self.format,
            "gzip": self.gzip,
            "rows": {
                "read": self.read,
                "good": good,
                "refused": self.read - good - self.zeroed - self.unmatched - omitted,
                "tare": self.zeroed,
                "unmatched": self.unmatched,
                **self.omitted,
            },
            "clock": self.clock,
            "columns": [dict(zip(names, column, strict=True)) for column in self.columns],
            "ignored": self.ignored,
            "above": self.titles,
            "sheets": self.sheets,
            "sheet": self.sheet,
            "errors": [mistake.as_dict() for mistake in self.mistakes.listed()],
            "causes": self.mistakes.causes(),
            "is_ruined": self.mistakes.is_ruined,
            "converted": self.converted,
            "preview": preview,
        }


@dataclass(frozen=True, eq=False)
class ParsedTable(Rows):
    """Rows of a table file; `seq` are positions in the file, see `FileMistake.row`."""

    note: Sequence[str] = ()
    time: Array | None = None  # (n,), s; for logs that are joined by it

    def take(self, which: ArrayLike) -> ParsedTable:
        """Return the rows that an index array or a mask of shape (n,) picks."""
        return type(self)(**picked(vars(self), np.asarray(which)))


def picked(columns: Mapping[str, Any], which: Array) -> dict[str, Any]:
    """Return the columns of a `ParsedTable` for the rows of a mask, (n,), or of indices."""
    columns = dict(columns)
    if which.dtype != bool or not which.all():
        index = np.flatnonzero(which) if which.dtype == bool else which
        for name, column in columns.items():
            if isinstance(column, np.ndarray):
                shape = len(index), *column.shape[1:]
                columns[name] = unknown_column(*shape) if is_unknown(column) else column[index]
        columns["note"] = [columns["note"][at] for at in index.tolist()]
    return columns


def is_corrected(options: Options) -> bool:
    """Return whether readings are joined or corrected: then limits are for the interface's rows."""
    return bool(options.zero_rows or options.rig or options.role != "table")
