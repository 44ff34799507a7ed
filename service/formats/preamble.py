"""The lines above a header that a force/torque logger writes: units, and counts per unit.

ATI's Net F/T demo logs counts: a line each of ``Start Time``, ``RDT Sample Rate``, ``Force Units``,
``Counts per Unit Force``, ``Torque Units``, ``Counts per Unit Torque`` (two of them on one line in
some versions), then ``Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time``. A
value in the unit is the counts over the counts per unit; the elapsed time is the RDT sequence over
the sample rate (ATI manual 9620-05-Ethernet Axia, 7.4, and 9620-05-Net FT, 5).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

_ENTRY = re.compile(
    r"(?P<key>start time|rdt sample rate|sample rate|force units?|torque units?"
    r"|counts per (?:unit )?force(?: unit)?|counts per (?:unit )?torque(?: unit)?)"
    r"\s*[:=]?\s*(?P<value>.*)",
    re.IGNORECASE,
)
_BOOKKEEPING = re.compile(r"(status.*|rdt sequence|f/t sequence)", re.IGNORECASE)
# As ATI's configuration page writes its units, for those that a unit library reads otherwise.
_UNITS = {
    "pound": "lbf",
    "pounds": "lbf",
    "lb": "lbf",
    "newton": "N",
    "kilonewton": "kN",
    "kilogram": "kgf",
    "kg": "kgf",
    "gram": "gf",
    "g": "gf",
    "klb": "kip",
    "klbf": "kip",
    "pound-inch": "lbf*in",
    "lb-in": "lbf*in",
    "lbf-in": "lbf*in",
    "pound-foot": "lbf*ft",
    "lb-ft": "lbf*ft",
    "lbf-ft": "lbf*ft",
    "newton-meter": "N*m",
    "newton-millimeter": "N*mm",
    "kilogram-centimeter": "kgf*cm",
    "kg-cm": "kgf*cm",
    "kilonewton-meter": "kN*m",
}


@dataclass
class Preamble:
    """What a logger says above the header; nothing if `there` is false.

    Attributes
    ----------
    there : bool
    units : dict of str to str
        Of ``force`` and ``torque``.
    counts : dict of str to Decimal
        Per unit, of the same.
    rate : float or None
        Samples a second.
    """

    there: bool = False
    units: dict[str, str] | None = None
    counts: dict[str, Decimal] | None = None
    rate: float | None = None

    def __bool__(self) -> bool:
        return self.there

    def take(self, fields: list[str]) -> bool:
        """Take a line in if it is one of the preamble's; tell whether it was."""
        found = [_ENTRY.fullmatch(entry.strip()) for entry in _entries(fields)]
        if not found or None in found:
            return False
        self.there = True
        for match in found:
            assert match is not None
            self._note(match["key"].lower(), match["value"].strip().strip(":, "))
        return True

    def unit_of(self, name: str) -> tuple[str, Decimal] | None:
        """Return the unit of a load column and its counts per unit; None if not told."""
        what = {"f": "force", "m": "torque"}.get(name[:1]) if len(name) == 2 else None
        unit = (self.units or {}).get(what or "")
        if what is None or unit is None:
            return None
        return unit, (self.counts or {}).get(what, Decimal(1))

    def is_bookkeeping(self, label: str) -> bool:
        """Tell whether a column is the logger's own and none of a table's."""
        return bool(_BOOKKEEPING.fullmatch(label))

    def _note(self, key: str, value: str) -> None:
        what = "torque" if "torque" in key else "force"
        if key.startswith("counts"):
            self.counts = {**(self.counts or {}), what: _positive(value)}
        elif "unit" in key:
            self.units = {**(self.units or {}), what: _UNITS.get(value.lower(), value)}
        elif "rate" in key:
            self.rate = float(_positive(value))


def _entries(fields: list[str]) -> list[str]:
    """Return the entries of a line, a key beside its value counting as one."""
    cells = [cell.strip() for cell in ",".join(fields).split(",") if cell.strip()]
    if cells and cells[0].lower().startswith("start time"):
        return [" ".join(cells)]  # a date may hold commas
    entries: list[str] = []
    for cell in cells:
        if entries and not _ENTRY.fullmatch(cell):
            entries[-1] += " " + cell
        else:
            entries.append(cell)
    return entries


def _positive(value: str) -> Decimal:
    """Return a number above zero; a preamble with anything else means nothing.

    Raises
    ------
    ValueError
        If it is none.
    """
    try:
        number = Decimal(value)
    except InvalidOperation:
        number = Decimal("nan")
    if not (number.is_finite() and number > 0):
        raise ValueError(f"'{value[:40]}' in the lines above the header is no number above zero")
    return number
