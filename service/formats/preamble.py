"""Lines that a logger writes above the header of its file.

ATI's Net F/T demo logs counts below lines such as ``Counts per Unit Force``. A value is the counts
over the counts per unit; the elapsed time is the RDT sequence over the sample rate (ATI manual
9620-05-Ethernet Axia, 7.4, and 9620-05-Net FT, 5).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

_ENTRY = re.compile(
    r"(?P<key>start time|rdt sample rate|sample rate|force units?|torque units?"
    r"|counts per (?:unit )?force(?: unit)?|counts per (?:unit )?torque(?: unit)?)"
    r"\s*[:=]?\s*(?P<value>.*)",
    re.IGNORECASE,
)
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


@dataclass
class Preamble:
    """Lines of a logger above the header; false if there are none.

    `units` and `counts` (per unit) are those of ``force`` and ``torque``; `rate` is samples a
    second.
    """

    units: dict[str, str] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)
    rate: float | None = None
    _any: bool = False

    def __bool__(self) -> bool:
        return self._any

    def add(self, cells: list[str]) -> bool:
        """Read a line; return whether a preamble has it. Raises ValueError on a wrong number."""
        filled = [cell.strip() for cell in ",".join(cells).split(",") if cell.strip()]
        if filled and filled[0].lower().startswith("start time"):
            filled = [" ".join(filled)]  # a date may contain commas
        entries: list[str] = []
        for cell in filled:  # a key and the cell of its value belong together
            if entries and not _ENTRY.fullmatch(cell):
                entries[-1] += " " + cell
            else:
                entries.append(cell)
        matches = [_ENTRY.fullmatch(entry) for entry in entries]
        if not matches or None in matches:
            return False
        self._any = True
        for match in filter(None, matches):
            key = match["key"].lower()
            value = match["value"].strip().strip(":, ")
            quantity = "torque" if "torque" in key else "force"
            if key.startswith("counts"):
                self.counts[quantity] = _positive(match["key"], value)
            elif "unit" in key:
                self.units[quantity] = _UNITS.get(value.lower(), value)
            elif "rate" in key:
                self.rate = _positive(match["key"], value)
        return True

    def unit_of(self, name: str) -> tuple[str, float] | None:
        """Return the unit of a load column and its counts per unit; None if unknown."""
        name = name.rpartition(".")[2]  # without the interface
        quantity = {"f": "force", "m": "torque"}.get(name[:1], "") if len(name) == 2 else ""
        if quantity not in self.units:
            return None
        return self.units[quantity], self.counts.get(quantity, 1.0)


def _positive(key: str, value: str) -> float:
    """Return the number of a line of the preamble; raises ValueError unless it is above 0."""
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise ValueError(f"{key} is '{value[:40]}', but must be a number above 0; correct it")
    return number
