"""The header of a table of columns: which column is which, and in which unit.

Columns, in the spellings of `spelling`: ``fx fy fz mx my mz`` (a missing one is a mistake unless
the sender says that it was zero), ``ux uy uz rx ry rz`` (at least one; a missing one, or an empty
field, was not measured), ``ux_err`` ... ``rz_err`` (95 % half width; ``ux_std`` is half of it),
``dux/dfx [m/N]`` ... ``drz/dmz [rad/(N*m)]`` (the 36 tangents of a solve, all or none) and
``source``, ``note``, ``fingerprint`` (text, no unit; the fingerprint names the setup that a solve
was made with). Every number column names its unit, in its label, in a row of units below, or in the
lines above the header (see `preamble`): a rotation without one may be radians or degrees, and a
guess would be loaded without a word. An unknown column is a mistake unless the sender leaves it
out, because a misspelt load would count as zero.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal

from service.formats.exact import product, quotient
from service.formats.mistakes import RowError
from service.formats.options import Options
from service.formats.preamble import Preamble
from service.formats.spelling import (
    CARRIED,
    COMPLIANCE,
    DISPLACEMENT,
    NUMBERS,
    TEXTS,
    TIME_COLUMN,
    UNCERTAINTY,
    WRENCH,
    examples,
    factor_of,
    over,
    quantity_of,
    readings,
    split,
    tangent_quantities,
)
from service.formats.units import UnitError

__all__ = [
    "COMPLIANCE",
    "DISPLACEMENT",
    "NUMBERS",
    "TEXTS",
    "UNCERTAINTY",
    "WRENCH",
    "Column",
    "Header",
    "over",
    "quantity_of",
    "read_header",
    "tangent_quantities",
]


@dataclass(frozen=True)
class Column:
    """One column: its place in a line, its name as written, its SI factor (1 for text)."""

    place: int
    label: str
    name: str
    factor: Decimal = Decimal(1)
    unit: str = ""


@dataclass
class Header:
    """The columns by name, how many fields a line has, and what is wrong with the header.

    `blank` are places without a name, whose cells must be empty; `above` the lines of title.
    """

    width: int
    columns: dict[str, Column] = field(default_factory=dict)
    errors: list[RowError] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    status: Column | None = None
    sequence: Column | None = None
    preamble: Preamble = field(default_factory=Preamble)
    blank: list[int] = field(default_factory=list)
    above: list[str] = field(default_factory=list)


def labels_of(cells: Sequence[str]) -> list[str]:
    """Return the labels of a header line; a spreadsheet's empty columns on the right are none."""
    labels = [" ".join(cell.split()) for cell in cells]
    while labels and not labels[-1]:
        labels.pop()
    return labels


def read_header(
    cells: Sequence[str],
    line: int,
    options: Options | None = None,
    units: Sequence[str] | None = None,
    preamble: Preamble | None = None,
) -> Header:
    """Read the header; all mistakes are collected in `Header.errors`.

    Parameters
    ----------
    cells : sequence of str
        The fields of the line.
    line : int
        Where it stands in the file, from 1.
    options : Options, optional
        What the sender says of columns.
    units : sequence of str, optional
        The fields of a second line that has the units.
    preamble : Preamble, optional
        What stands above the header.
    """
    options = options or Options()
    labels = labels_of(cells)
    header = Header(width=len(labels), preamble=preamble or Preamble())
    wanted = _Wanted(options, units or (), header.preamble)
    for place, label in enumerate(labels):
        try:
            _take(header, wanted, place, label, line)
        except UnitError as error:
            header.errors.append(RowError(line, label or f"column {place + 1}", str(error)))
    for name in wanted.not_found(labels) if options.role == "table" else ():
        message = "is named by ignore or mapping, and the file has no such column"
        header.errors.append(RowError(line, name, message))
    _complete(header, line, labels, options)
    return header


def _take(header: Header, wanted: _Wanted, place: int, label: str, line: int) -> None:
    """Add one column to the header, or to what is left out of it."""
    if not label:
        if not wanted.leaves_extra_out:
            header.blank.append(place)
        return
    if wanted.is_ignored(label) or label.lower() in CARRIED:
        header.ignored.append(label)
        return
    if header.preamble and header.preamble.is_bookkeeping(label):
        column = Column(place, label, label)
        if label.lower().startswith("status"):
            header.status = column
        elif label.lower().startswith("rdt"):
            header.sequence = column
        header.ignored.append(label)
        return
    column = wanted.column(place, label)
    if column is None:
        header.ignored.append(label)
        return
    if column.name in header.columns:
        header.errors.append(RowError(line, label, f"{column.name} stands twice; keep one"))
    header.columns[column.name] = column


class _Wanted:
    """What the sender and the file's other lines say about its columns."""

    def __init__(self, options: Options, units: Sequence[str], preamble: Preamble) -> None:
        self._options = options
        self._units = [_bare(unit) for unit in units]
        self._preamble = preamble
        self._ignore = {_plain(name) for name in options.ignore}
        self._mapping = {_plain(name): target for name, target in options.mapping.items()}

    @property
    def leaves_extra_out(self) -> bool:
        return self._options.ignore_extra

    def is_ignored(self, label: str) -> bool:
        return bool(label) and bool({_plain(label), _plain(_name(label))} & self._ignore)

    def not_found(self, labels: list[str]) -> list[str]:
        """Return what the sender names and the file has not."""
        there = {_plain(label) for label in labels} | {_plain(_name(label)) for label in labels}
        named = (*self._options.ignore, *self._options.mapping)
        return [name for name in named if _plain(name) not in there]

    def column(self, place: int, label: str) -> Column | None:
        """Return the column of a label, None if it is left out; raises UnitError."""
        told = self._mapping.get(_plain(label)) or self._mapping.get(_plain(_name(label)))
        text = (told or label).strip()
        sign = Decimal(-1) if told and text.startswith("-") else Decimal(1)
        below = self._units[place] if place < len(self._units) else ""
        try:
            name, unit, factor = self._read(text.removeprefix("-") if told else text, below)
        except _UnknownColumnError as error:
            if self._options.ignore_extra and not told:
                return None
            raise UnitError(str(error)) from None
        if sign < 0 and name not in (*WRENCH, *DISPLACEMENT):
            raise UnitError("only a load or a displacement has a sign that can be turned")
        return Column(place, label, name, factor * sign, unit)

    def _read(self, label: str, below: str) -> tuple[str, str, Decimal]:
        found = list(readings(label))
        problem: UnitError | None = None
        fits: dict[str, tuple[str, str, Decimal]] = {}
        for name, own, factor in found:
            counted = self._preamble.unit_of(name) if not (own or below) else None
            unit, count = counted or (own or below, Decimal(1))
            if name in TEXTS:
                return name, "", Decimal(1)
            if not unit and name != TIME_COLUMN:
                problem = problem or UnitError(f"has no unit; write for example {examples(name)}")
                continue
            try:
                si = factor_of(name, unit) if unit else Decimal(1)
            except UnitError as error:
                problem = problem or error
                continue
            fits.setdefault(name, (name, unit, product(quotient(si, count), factor)))
        if len(fits) == 1:
            return next(iter(fits.values()))
        if len(fits) > 1:
            raise UnitError(f"can be {' or '.join(sorted(fits))}; say which with mapping")
        bracketed = bool(split(label)[1]) or _is_bare_name(label)
        if problem is not None and bracketed:
            raise problem
        raise _UnknownColumnError(_unknown(_name(label).lower()))


class _UnknownColumnError(UnitError):
    """The label names no column of a table."""


def _is_bare_name(label: str) -> bool:
    """Tell whether a label is a column's name and nothing more: then its unit is what is wrong."""
    return any(not unit for _, unit, _ in readings(label))


def _name(label: str) -> str:
    try:
        return split(label)[0]
    except UnitError:
        return label


def _plain(label: str) -> str:
    return " ".join(label.split()).lower()


def _bare(unit: str) -> str:
    """Return a unit without the brackets that a row of units may have."""
    text = unit.strip()
    inside = text[1:-1] if text[:1] + text[-1:] in ("[]", "()") else text
    return inside.strip()


def _unknown(name: str) -> str:
    """Say that a column is not known, with the nearest one that is."""
    near = difflib.get_close_matches(name, (*NUMBERS, *TEXTS), n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]}? Units stand in brackets: fx [N]" if near else ""
    return (
        f"is not a column of a table{hint}. Rename it, name it in ignore, or say what it is with "
        f"mapping; there are {' '.join(WRENCH)} {' '.join(DISPLACEMENT)}, a displacement's with "
        f"_err, {COMPLIANCE[0]} ... {COMPLIANCE[-1]}, source, note, fingerprint"
    )


def _complete(header: Header, line: int, labels: list[str], options: Options) -> None:
    """Add what is missing from the whole: a load, a displacement, a time."""
    # A column with a faulty unit is there; saying that it is missing too would mislead.
    named = {name for label in labels for name in _named(label)} | set(header.columns)
    missing = []
    if options.role != "loads" and not named & set(DISPLACEMENT):
        missing.append(("displacement", DISPLACEMENT))
    if options.role != "displacements" and not named & set(WRENCH):
        missing.append(("load", WRENCH))
    for what, names in missing:
        message = f"no {what} column; name at least one of " + ", ".join(
            f"{name} [{quantity_of(name).examples[0]}]" for name in names
        )
        header.errors.append(RowError(line, "header", message))
    absent = [name for name in WRENCH if name not in named]
    told = options.missing_loads == "zero" or options.role == "displacements"
    if absent and len(absent) < 6 and not told:
        message = (
            f"there is no column for {', '.join(absent)}; if these loads were zero, say "
            "missing_loads=zero"
        )
        header.errors.append(RowError(line, "header", message))
    if options.role != "table" and TIME_COLUMN not in named and header.sequence is None:
        message = "two logs are joined by their time; there is no column time [s]"
        header.errors.append(RowError(line, "header", message))


def _named(label: str) -> set[str]:
    """Return the columns that a label may mean, whatever is wrong with its unit."""
    try:
        return {name for name, _, _ in readings(label)}
    except UnitError:
        return set()
