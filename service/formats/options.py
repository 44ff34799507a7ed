"""What a sender says about a table file, and what reading it tells back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from decimal import Decimal
from typing import Any, Literal

import numpy as np

from service.formats.mistakes import MOST_MISTAKES, Mistakes, RowError
from surrogate.table.rows import LoadRange

Format = Literal["csv", "xlsx", "parquet", "hdf5", "json"]
FORMATS: tuple[Format, ...] = ("csv", "xlsx", "parquet", "hdf5", "json")
Role = Literal["table", "loads", "displacements"]
MOST_ROWS = 5_000_000  # of a file: 0.6 GB as arrays without tangents
MOST_TARE = 10_000  # rows a tare is the mean of: they are all in the first piece


@dataclass(frozen=True)
class Options:
    """What the sender of a file says about it; nothing of it is guessed.

    Attributes
    ----------
    format : str or None
        Which form the file has; told from its content if None.
    decimal : {".", ","} or None
        The decimal mark of a CSV; told from its numbers if None.
    ignore : tuple of str
        Columns to leave out, by their name in the file.
    ignore_extra : bool
        Whether all columns that are none of a table's are left out.
    mapping : mapping of str to str
        From a column's name in the file to what it is: ``fz [N]``, or ``-fz [N]`` to turn its sign.
    missing_loads : {"zero"} or None
        What the loads are that the file has no column for; None refuses such a file.
    tare : int
        The mean of so many first rows is taken off all others.
    sheet : str or None
        Of an XLSX; the first one if None.
    time_offset_s : float
        What is added to the time of displacements to be on the clock of the loads, s.
    max_gap_s : float or None
        Between two loads, at most, that a displacement lies between, s.
    load_range : LoadRange or None
        The component's, N and N·m: loads far beyond it are mistakes (see `limits`).
    fingerprint : str or None
        The component's own setup: solves of any other are mistakes (see `placement`).
    role : {"table", "loads", "displacements"}
        Whether a row has both, or only what one of two logs has, and a time.
    """

    format: Format | None = None
    decimal: Literal[".", ","] | None = None
    ignore: tuple[str, ...] = ()
    ignore_extra: bool = False
    mapping: Mapping[str, str] = field(default_factory=dict)
    missing_loads: Literal["zero"] | None = None
    tare: int = 0
    sheet: str | None = None
    time_offset_s: float = 0.0
    max_gap_s: float | None = None
    load_range: LoadRange | None = None
    fingerprint: str | None = None
    role: Role = "table"


def options_told(options: Options) -> dict[str, Any]:
    """Return options as JSON has them."""
    told = {field.name: getattr(options, field.name) for field in fields(options)}
    span = options.load_range
    told["load_range"] = [span.low.tolist(), span.high.tolist()] if span else None
    return told | {"mapping": dict(options.mapping), "ignore": list(options.ignore)}


def options_from(told: Mapping[str, Any]) -> Options:
    """Return the options that `options_told` was given."""
    span = told["load_range"]
    kept = {"load_range": LoadRange(*map(np.array, span)) if span else None}
    return Options(**{**told, "ignore": tuple(told["ignore"]), **kept})


@dataclass(frozen=True)
class FoundColumn:
    """A column of the file that is read: its name there, what it is, its unit (empty for text)."""

    label: str
    name: str
    unit: str
    factor: Decimal


@dataclass
class Told:
    """What reading a file has told so far.

    Attributes
    ----------
    mistakes : Mistakes
    format : str
    gzip : bool
    columns : list of FoundColumn
    ignored : list of str
        Columns that were left out.
    above : list of str
        Lines of title above the header, left out.
    read, tare, unmatched : int
        Rows of the file; of them those whose mean was taken off; those with no load at their time.
    """

    mistakes: Mistakes = field(default_factory=Mistakes)
    format: str = ""
    gzip: bool = False
    columns: list[FoundColumn] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    above: list[str] = field(default_factory=list)
    read: int = 0
    tare: int = 0
    unmatched: int = 0

    def is_beyond_limits(self) -> bool:
        """Return whether reading ends here: with too many rows or mistakes, no row is loaded."""
        self.mistakes.settle()
        if self.read > MOST_ROWS:
            message = f"has more than {MOST_ROWS:,} rows; send it in parts"
            self.mistakes.ruin(RowError(0, "file", message))
        elif self.mistakes.count > MOST_MISTAKES:
            self.mistakes.whole = True
        return self.mistakes.whole

    def label(self, name: str) -> str:
        """Return how the file calls a column, or the column's own name."""
        return next((one.label for one in self.columns if one.name == name), name)
