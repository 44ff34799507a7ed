"""Lines above the header of a table: units and scales of a force/torque logger, titles.

ATI's Net F/T demo logs counts: a line each of ``Start Time``, ``RDT Sample Rate``, ``Force Units``,
``Counts per Unit Force``, ``Torque Units``, ``Counts per Unit Torque`` (two of them on one line in
some versions), then ``Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time``. A
value is the counts over the counts per unit; the elapsed time is the RDT sequence over the sample
rate (ATI manual 9620-05-Ethernet Axia, 7.4, and 9620-05-Net FT, 5).

Titles, dates and names of a rig may stand above the header too. The first of 31 lines that names
two columns is the header. If no line does, or a row of numbers comes first, the first line is read
as the header, and its mistakes are reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from itertools import chain, islice

from wrenchbook.service.formats.cells import is_number
from wrenchbook.service.formats.columns import MOST_LABEL, Columns
from wrenchbook.service.formats.units import UnitError

_MOST_TITLES = 30  # lines: a page of a report above its table
_SEVERAL = 2  # one word of a title may be the name of a column ("Fx test, 3 mm")
_SURE_DELIMITERS, _OTHER_DELIMITERS = ";\t", ",|"  # no label holds one of the former

_ENTRY = re.compile(
    r"(?P<key>start time|rdt sample rate|sample rate|force units?|torque units?"
    r"|counts per (?:unit )?force(?: unit)?|counts per (?:unit )?torque(?: unit)?)"
    r"\s*[:=]?\s*(?P<value>.*)",
    re.IGNORECASE,
)
_BOOKKEEPING = re.compile(r"(status.*|rdt sequence|f/t sequence)", re.IGNORECASE)
# Spellings of ATI's configuration page.
_ATI_UNITS = {
    "lbf": ("pound", "pounds", "lb"),
    "N": ("newton",),
    "kN": ("kilonewton",),
    "kgf": ("kilogram", "kg"),
    "gf": ("gram", "g"),
    "kip": ("klb", "klbf"),
    "lbf*in": ("pound-inch", "lb-in", "lbf-in"),
    "lbf*ft": ("pound-foot", "lb-ft", "lbf-ft"),
    "N*m": ("newton-meter",),
    "N*mm": ("newton-millimeter",),
    "kgf*cm": ("kilogram-centimeter", "kg-cm"),
    "kN*m": ("kilonewton-meter",),
}
_UNITS = {spelling: unit for unit, spellings in _ATI_UNITS.items() for spelling in spellings}

Record = tuple[int, list[str]]
"""The line of a record in its file, from 1, and its cells."""


@dataclass
class Preamble:
    """Lines of a logger above the header; false if there are none.

    Attributes
    ----------
    units : dict of str to str
        Of ``force`` and ``torque``.
    counts : dict of str to Decimal
        Counts per unit of ``force`` and ``torque``.
    rate : float or None
        Samples a second.
    """

    units: dict[str, str] = field(default_factory=dict)
    counts: dict[str, Decimal] = field(default_factory=dict)
    rate: float | None = None
    _found: bool = False

    def __bool__(self) -> bool:
        return self._found

    def add(self, cells: list[str]) -> bool:
        """Read a line if it belongs to a preamble; return whether it does.

        Raises
        ------
        ValueError
            If a number is not above zero.
        """
        found = [_ENTRY.fullmatch(entry.strip()) for entry in _entries(cells)]
        if not found or None in found:
            return False
        self._found = True
        for match in found:
            assert match is not None
            self._set(match["key"].lower(), match["value"].strip().strip(":, "))
        return True

    def unit_of(self, name: str) -> tuple[str, Decimal] | None:
        """Return the unit of a load column and its counts per unit; None if unknown."""
        name = name.rpartition(".")[2]  # without the interface
        quantity = {"f": "force", "m": "torque"}.get(name[:1], "") if len(name) == 2 else ""
        if quantity not in self.units:
            return None
        return self.units[quantity], self.counts.get(quantity, Decimal(1))

    def is_bookkeeping(self, label: str) -> bool:
        """Return whether a column is one of the logger's own: status or a sequence."""
        return bool(_BOOKKEEPING.fullmatch(label))

    def _set(self, key: str, value: str) -> None:
        quantity = "torque" if "torque" in key else "force"
        if key.startswith("counts"):
            self.counts[quantity] = _positive(value)
        elif "unit" in key:
            self.units[quantity] = _UNITS.get(value.lower(), value)
        elif "rate" in key:
            self.rate = float(_positive(value))


def split_titles(
    first: Record, rest: Iterator[Record], mapping: Mapping[str, str], columns: Columns
) -> tuple[list[str], Record, Iterator[Record]]:
    """Return the titles, the header and the records below it.

    Parameters
    ----------
    first : Record
        The first record of the file with text.
    rest : iterator of Record
    mapping : mapping of str to str
        From labels of the file to columns; its keys count as names of columns.
    columns : Columns
        Of the table.
    """
    if _named_columns(first[1], columns, mapping) >= _SEVERAL or _is_row(first[1]):
        return [], first, rest
    titles = [first]
    for record in islice(rest, _MOST_TITLES):
        if _is_row(record[1]):
            rest = chain([record], rest)
            break
        if _named_columns(record[1], columns, mapping) >= _SEVERAL:
            return [_title(cells) for _, cells in titles], record, rest
        titles.append(record)
    return [], first, chain(titles[1:], rest)


def delimiter_in(lines: Iterator[str], bare: Callable[[str], str], columns: Columns) -> str:
    """Return the delimiter of the header; of the first line if none names columns.

    It is ``;`` or tab if the line has one, else ``,`` or ``|``, whichever splits off more names.

    Parameters
    ----------
    lines : iterator of str
        From the first that may be a header.
    bare : callable
        Removes brackets from a line: units may hold delimiters.
    columns : Columns
        Of the table.
    """
    found = [bare(line) for line in islice(lines, _MOST_TITLES + 1)]
    header = next((line for line in found if _names_several(line, columns)), found[0])
    sure = next((mark for mark in _SURE_DELIMITERS if mark in header), "")
    return sure or max(
        _OTHER_DELIMITERS, key=lambda mark: _named_columns(header.split(mark), columns)
    )


def _entries(cells: list[str]) -> list[str]:
    """Return the entries of a line; a key and the cell of its value are one."""
    filled = [cell.strip() for cell in ",".join(cells).split(",") if cell.strip()]
    if filled and filled[0].lower().startswith("start time"):
        return [" ".join(filled)]  # a date may hold commas
    entries: list[str] = []
    for cell in filled:
        if entries and not _ENTRY.fullmatch(cell):
            entries[-1] += " " + cell
        else:
            entries.append(cell)
    return entries


def _positive(value: str) -> Decimal:
    try:
        number = Decimal(value)
    except InvalidOperation:
        number = Decimal("nan")
    if not (number.is_finite() and number > 0):
        raise ValueError(f"'{value[:40]}' in the lines above the header is no number above zero")
    return number


def _named_columns(
    cells: Sequence[str], columns: Columns, mapping: Mapping[str, str] | None = None
) -> int:
    """Return how many cells name a column of a table or a key of the mapping."""
    mapped = {" ".join(name.split()).lower() for name in mapping or ()}
    labels = (" ".join(cell.split()) for cell in cells[: columns.most])
    return sum(_is_name(label, columns, mapped) for label in labels)


def _is_name(label: str, columns: Columns, mapped: set[str]) -> bool:
    if label and label.lower() in mapped:
        return True
    try:
        return next(columns.readings(label), None) is not None
    except UnitError:
        return False


def _names_several(line: str, columns: Columns) -> bool:
    delimiters = _SURE_DELIMITERS + _OTHER_DELIMITERS
    return any(
        _named_columns(line.split(mark, columns.most), columns) >= _SEVERAL for mark in delimiters
    )


def _is_row(cells: list[str]) -> bool:
    """Return whether a record has several cells with text, and all of them are numbers."""
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) >= _SEVERAL and all(is_number(cell) for cell in filled)


def _title(cells: list[str]) -> str:
    return " ".join(cell.strip() for cell in cells if cell.strip())[:MOST_LABEL]
