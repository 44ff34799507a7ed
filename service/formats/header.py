"""The header of a table of columns: which column is which, and in which unit.

Columns, in the spellings of `columns`: ``fx fy fz mx my mz`` (a missing one is a mistake
unless the sender declares it zero), ``ux uy uz rx ry rz`` (at least one; a missing one, or an empty
field, was not measured), ``ux_err`` ... ``rz_err`` (95 % half width; ``ux_std`` is half of it),
``dux/dfx [m/N]`` ... ``drz/dmz [rad/(N*m)]`` (the 36 tangents of a solve, all or none) and
``source``, ``note``, ``fingerprint`` (text, no unit; the fingerprint names the setup of a solve).
Every number column names its unit, in its label, in a row of units below, or in the preamble: a
rotation without one may be radians or degrees. An unknown column is a mistake unless the sender
leaves it out, because a misspelt load would count as zero.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import chain

from wrenchbook.service.formats.cells import is_number
from wrenchbook.service.formats.columns import ORIGIN, TEXTS, TIME_COLUMN, Columns, split
from wrenchbook.service.formats.options import FileMistake, Options
from wrenchbook.service.formats.preamble import Preamble, Record, split_titles
from wrenchbook.service.formats.units import UnitError, product, quotient


@dataclass(frozen=True)
class HeaderColumn:
    """One column: its index in a record, label, name, and the factor and zero of its unit in SI."""

    index: int
    label: str
    name: str
    factor: Decimal = Decimal(1)
    unit: str = ""
    zero: Decimal = Decimal(0)


@dataclass
class Header:
    """The columns by name, the cells of a record, and the mistakes of the header.

    `unnamed` are indices without a label, whose cells must be empty; `titles` the lines above.
    `status` and `sequence` are columns of a logger.
    """

    width: int
    columns: dict[str, HeaderColumn] = field(default_factory=dict)
    mistakes: list[FileMistake] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    status: HeaderColumn | None = None
    sequence: HeaderColumn | None = None
    preamble: Preamble = field(default_factory=Preamble)
    unnamed: list[int] = field(default_factory=list)
    titles: list[str] = field(default_factory=list)


def read_head(records: Iterator[Record], options: Options) -> tuple[Header, Iterator[Record]]:
    """Return the header below preamble and titles, and the records below the header.

    Mistakes of the header are in `Header.mistakes`.
    """
    preamble, columns = Preamble(), options.columns
    for line, cells in records:
        try:
            if preamble.add(cells):
                continue
        except ValueError as error:
            return _no_header(line, "line", str(error)), records
        break
    else:
        message = "there is no header" if preamble else "the file is empty"
        return _no_header(0, "file", message), records
    titles, (line, cells), records = split_titles((line, cells), records, options.mapping, columns)
    if any(cell.strip() for cell in cells[columns.most :]):
        message = f"names {len(cells):,} columns; a table has at most {columns.most}"
        return _no_header(line, "header", message), records
    if all(is_number(cell) for cell in cells if cell.strip()):
        message = (
            "there is no header; the first line must name the columns with units, such as "
            "fx [N], ux [mm] (a line that begins with # is a comment)"
        )
        return _no_header(line, "header", message), records
    labels = _labels(cells)
    below = next(records, None)
    units = below[1] if below and _is_units_row(labels, below[1], columns) else []
    if below and not units:
        records = chain([below], records)
    header = _read_header(labels, line, options, units, preamble)
    header.titles = titles
    return header, records


def _no_header(line: int, field: str, message: str) -> Header:
    return Header(0, mistakes=[FileMistake(line, field, message)])


def _is_units_row(labels: list[str], cells: list[str], columns: Columns) -> bool:
    """Return whether a record below labels without units holds units."""
    if any(is_number(cell) for cell in cells if cell.strip()):
        return False
    return any(
        cell.strip() and _lacks_unit(label, columns)
        for label, cell in zip(labels, cells, strict=False)
    )


def _lacks_unit(label: str, columns: Columns) -> bool:
    return any(not unit and name not in TEXTS for name, unit, _ in _readings(label, columns))


def _readings(label: str, columns: Columns) -> list[tuple[str, str, Decimal]]:
    """Return the meanings of a label; none if its brackets are broken."""
    try:
        return list(columns.readings(label))
    except UnitError:
        return []


def _labels(cells: Sequence[str]) -> list[str]:
    """Return the labels of a header, without a spreadsheet's empty columns on the right."""
    labels = [" ".join(cell.split()) for cell in cells]
    while labels and not labels[-1]:
        labels.pop()
    return labels


def _read_header(
    labels: list[str], line: int, options: Options, units: Sequence[str], preamble: Preamble
) -> Header:
    header = Header(width=len(labels), preamble=preamble)
    names = _ColumnNames(options, units, preamble)
    for index, label in enumerate(labels):
        try:
            _add_column(header, names, index, label, line)
        except UnitError as error:
            mistake = FileMistake(line, label or f"column {index + 1}", str(error))
            header.mistakes.append(mistake)
    for name in names.missing_from(labels) if options.role == "table" else ():
        message = "is named by ignore or mapping, and the file has no such column"
        header.mistakes.append(FileMistake(line, name, message))
    for message in _missing_columns(header, labels, options):
        header.mistakes.append(FileMistake(line, "header", message))
    return header


def _add_column(header: Header, names: _ColumnNames, index: int, label: str, line: int) -> None:
    if not label:
        if not names.ignores_extra:
            header.unnamed.append(index)
        return
    column = None
    if names.is_ignored(label):
        pass
    elif header.preamble and header.preamble.is_bookkeeping(label):
        if label.lower().startswith("status"):
            header.status = HeaderColumn(index, label, label)
        elif label.lower().startswith("rdt"):
            header.sequence = HeaderColumn(index, label, label)
    else:
        column = names.column(index, label)
    if column is None:
        header.ignored.append(label)
        return
    if column.name in header.columns:
        message = f"{column.name} stands twice; keep one"
        header.mistakes.append(FileMistake(line, label, message))
    header.columns[column.name] = column


class _ColumnNames:
    """Finds the column of a label from options, a row of units and a preamble."""

    def __init__(self, options: Options, units: Sequence[str], preamble: Preamble) -> None:
        self._options, self._columns = options, options.columns
        self._units = [_bare(unit) for unit in units]
        self._preamble = preamble
        self._ignore = {_key(name) for name in options.ignore}
        self._mapping = {_key(name): target for name, target in options.mapping.items()}
        self.ignores_extra = options.ignore_extra

    def is_ignored(self, label: str) -> bool:
        keys = {_key(label), _key(_name(label))}
        return bool(keys & self._ignore) or label.lower() in ORIGIN

    def missing_from(self, labels: list[str]) -> list[str]:
        """Return the names in `ignore` and `mapping` that the file has not."""
        there = {_key(label) for label in labels} | {_key(_name(label)) for label in labels}
        named = (*self._options.ignore, *self._options.mapping)
        return [name for name in named if _key(name) not in there]

    def column(self, index: int, label: str) -> HeaderColumn | None:
        """Return the column of a label, None if it is left out; raises UnitError."""
        mapped = self._mapping.get(_key(label)) or self._mapping.get(_key(_name(label)))
        text = (mapped or label).strip()
        sign = Decimal(-1) if mapped and text.startswith("-") else Decimal(1)
        below = self._units[index] if index < len(self._units) else ""
        try:
            name, unit, factor = self._read(text.removeprefix("-") if mapped else text, below)
        except _UnknownColumnError as error:
            if self.ignores_extra and not mapped:
                return None
            raise UnitError(str(error)) from None
        columns = self._columns
        if sign < 0 and name not in (*columns.loads, *columns.displacement):
            raise UnitError("a - before a name is for loads and displacements only; leave it out")
        return HeaderColumn(index, label, name, factor * sign, unit, columns.zero(name, unit))

    def _read(self, label: str, below: str) -> tuple[str, str, Decimal]:
        """Return name, unit and factor of a label with a unit below it; raises UnitError."""
        problem: UnitError | None = None
        fits: dict[str, tuple[str, str, Decimal]] = {}
        for name, own, factor in self._columns.readings(label):
            counted = self._preamble.unit_of(name) if not (own or below) else None
            unit, count = counted or (own or below, Decimal(1))
            if name in TEXTS:
                return name, "", Decimal(1)
            if not unit and name != TIME_COLUMN:
                example = self._columns.examples(name)
                problem = problem or UnitError(f"has no unit; write for example {example}")
                continue
            try:
                si = self._columns.factor(name, unit) if unit else Decimal(1)
            except UnitError as error:
                problem = problem or error
                continue
            fits.setdefault(name, (name, unit, product(quotient(si, count), factor)))
        if len(fits) == 1:
            return next(iter(fits.values()))
        if len(fits) > 1:
            raise UnitError(f"can be {' or '.join(sorted(fits))}; name one with mapping")
        # With brackets, or as a bare name, the label names a column and its unit is the mistake.
        meanings = self._columns.readings(label)
        if problem and (split(label)[1] or any(not unit for _, unit, _ in meanings)):
            raise problem
        name, columns = _name(label), self._columns
        raise _UnknownColumnError(
            columns.interface_problem(name) or _unknown(name.lower(), columns)
        )


_ALONE = "; a log of loads alone: send the log of its displacements too, as displacements=FILE"


class _UnknownColumnError(UnitError):
    """The label names no column of a table."""


def _name(label: str) -> str:
    try:
        return split(label)[0]
    except UnitError:
        return label


def _key(label: str) -> str:
    return " ".join(label.split()).lower()


def _bare(unit: str) -> str:
    """Return a unit without the brackets that a row of units may have."""
    text = unit.strip()
    inside = text[1:-1] if text[:1] + text[-1:] in ("[]", "()") else text
    return inside.strip()


def _unknown(name: str, columns: Columns) -> str:
    """Return a message on an unknown column with the nearest known one."""
    near = difflib.get_close_matches(name, (*columns.numbers, *TEXTS), n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]}? Units stand in brackets: fx [N]" if near else ""
    return (
        f"is not a column of a table{hint}. Rename it, name it in ignore, or say what it is with "
        f"mapping; there are {' '.join(columns.wrench)} {' '.join(columns.displacement)}, a "
        f"displacement's with _err, {columns.compliance[0]} ... {columns.compliance[-1]}, source, "
        "note, fingerprint"
    )


def _missing_columns(header: Header, labels: list[str], options: Options) -> Iterator[str]:
    """Yield messages on missing columns: a load, a displacement, a time."""
    columns = options.columns
    # A column with a mistake in its unit is not missing.
    known = {*header.ignored, *(column.label for column in header.columns.values())}
    mistaken = {
        name for label in labels if label not in known for name, _, _ in _readings(label, columns)
    }
    named = mistaken | set(header.columns)
    needed = []
    if options.role != "loads":
        needed.append(("displacement", columns.displacement))
    if options.role != "displacements":
        needed.append(("load", columns.loads))
    for what, names in needed:
        if not named & set(names):
            units = (columns.quantity(name).examples[0] for name in names)
            named_so = ", ".join(map("{} [{}]".format, names, units))
            alone = _ALONE if what == "displacement" and options.role == "table" else ""
            yield f"no {what} column; name at least one of {named_so}{alone}"
    absent = [name for name in columns.loads if name not in named]
    may_miss = options.missing_loads == "zero" or options.role == "displacements"
    if absent and len(absent) < len(columns.loads) and not may_miss:
        out = f" (left out: {', '.join(header.ignored)})" if header.ignored else ""
        yield (
            f"there is no column for {', '.join(absent)}{out}; if these loads were zero, say "
            "missing_loads=zero"
        )
    for name in columns.further if options.role != "displacements" else ():
        if name not in named:
            example = f"{name} [{columns.quantity(name).si}]"
            yield f"there is no column for {name}; every row needs it: name it {example}"
    if options.role != "table" and TIME_COLUMN not in named and header.sequence is None:
        yield "two logs are joined by their time; there is no column time [s]"
