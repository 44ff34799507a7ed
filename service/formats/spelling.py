"""How people write the name and the unit of a column: ``Fz [N]``, ``Force_z``, ``Fz/N``, ``uz_mm``.

One column has one name and one unit. A spelling that could be two quantities (``Tx`` is a torque to
a sensor and a translation to a tracker) is taken only with a unit that tells which.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal

from service.formats.exact import quotient
from service.formats.units import (
    FORCE,
    MOMENT,
    ROTATION,
    TIME,
    TRANSLATION,
    Quantity,
    UnitError,
    si_factor,
)

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
DISPLACEMENT = ("ux", "uy", "uz", "rx", "ry", "rz")
UNCERTAINTY = tuple(f"{name}_err" for name in DISPLACEMENT)
COMPLIANCE = tuple(f"d{output}/d{load}" for output in DISPLACEMENT for load in WRENCH)
TEXTS = ("source", "note", "fingerprint")
NUMBERS = (*WRENCH, *DISPLACEMENT, *UNCERTAINTY, *COMPLIANCE)
TIME_COLUMN = "time"
CARRIED = ("row", "when", "who")  # of an export: for people; an import does not look at them

COVERAGE_FACTOR = Decimal(2)
"""From a standard uncertainty to an interval of 95 %: k = 2 (JCGM 100:2008, G.6.6)."""

_QUANTITY: dict[str, Quantity] = {
    name: (FORCE, MOMENT, TRANSLATION, ROTATION, TRANSLATION, ROTATION)[index // 3]
    for index, name in enumerate((*WRENCH, *DISPLACEMENT, *UNCERTAINTY))
} | {TIME_COLUMN: TIME}
_WORDS = {
    "f": ("f", "force", "kraft"),
    "m": ("m", "moment", "torque", "t", "drehmoment"),
    "u": ("u", "disp", "displacement", "translation", "trans", "t", "deflection"),
    "r": ("r", "rot", "rotation", "theta", "phi"),
}
_NAMES: dict[str, set[str]] = {}
for _letter, _spellings in _WORDS.items():
    for _spelling in _spellings:
        for _direction in "xyz":
            _NAMES.setdefault(_spelling + _direction, set()).add(_letter + _direction)
for _spelling in ("time", "timestamp", "t", "zeit"):
    _NAMES[_spelling] = {TIME_COLUMN}
# After a displacement's name: its 95 % half width, or its standard uncertainty.
_HALF_WIDTH = ("err", "error", "unc", "uncertainty", "u95")
_STANDARD = ("std", "sd", "sigma")
_BRACKETED = re.compile(r"(?P<name>[^\[\](]*?)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()\[\]]*)\))?")
_GAP = re.compile(r"[\s_./-]+")


def quantity_of(name: str) -> Quantity:
    """Return what the load, displacement or uncertainty column `name` measures."""
    return _QUANTITY[name]


def tangent_quantities(name: str) -> tuple[Quantity, Quantity]:
    """Return what the tangent column `name`, such as ``dux/dfx``, measures over what."""
    output, load = name.split("/")
    return _QUANTITY[output[1:]], _QUANTITY[load[1:]]


def over(upper: str, lower: str) -> str:
    """Write a unit over a unit, as a tangent column's: ``mm/lbf``, ``mm/(lbf*in)``."""
    return f"{upper}/{lower}" if lower.isalpha() else f"{upper}/({lower})"


def split(label: str) -> tuple[str, str]:
    """Return the name of a label and the unit in its brackets, empty without.

    Raises
    ------
    UnitError
        If it has brackets that are not its end.
    """
    match = _BRACKETED.fullmatch(label)
    if match is None or not match["name"]:
        raise UnitError("is not of the form name [unit], such as fx [N]")
    return match["name"], (match["a"] or match["b"] or "").strip()


def readings(label: str) -> Iterator[tuple[str, str, Decimal]]:
    """Yield what a label can mean: a column's name, its unit as written, a factor beside the unit.

    The unit is empty where the label has none. Nothing is yielded for a label that begins with no
    column's name.
    """
    name, unit = split(label)
    if name.lower() in (*TEXTS, *COMPLIANCE):
        yield name.lower(), unit, Decimal(1)
        return
    for end in sorted({len(name), *(gap.start() for gap in _GAP.finditer(name))}, reverse=True):
        rest, last = _without_doubt(name[end:].lstrip(" _./-"))
        found = sorted(_columns(name[:end] + last))
        rest = rest.removeprefix("(").removesuffix(")").replace("_", "*")
        if not found or (unit and rest):
            continue
        yield from ((column, unit or rest, factor) for column, factor in found)


def _without_doubt(rest: str) -> tuple[str, str]:
    """Part ``mm_err`` into ``mm`` and ``_err``; the last is empty if the rest has none."""
    words = _GAP.split(rest)
    if len(words) < 2 or words[-1].lower() not in (*_HALF_WIDTH, *_STANDARD):
        return rest, ""
    return rest[: -len(words[-1]) - 1], f"_{words[-1]}"


def _columns(name: str) -> set[tuple[str, Decimal]]:
    """Return the columns that a name without a unit can be, each with its factor."""
    words = [word.lower() for word in _GAP.split(name) if word]
    joined = "".join(words)
    if joined in _NAMES:
        return {(column, Decimal(1)) for column in _NAMES[joined]}
    if len(words) < 2 or words[-1] not in (*_HALF_WIDTH, *_STANDARD):
        return set()
    factor = Decimal(1) if words[-1] in _HALF_WIDTH else COVERAGE_FACTOR
    of = _NAMES.get("".join(words[:-1]), set())
    return {(f"{column}_err", factor) for column in of if column in DISPLACEMENT}


def factor_of(name: str, unit: str) -> Decimal:
    """Return what one `unit` of the column `name` is in SI; raises UnitError."""
    if name in TEXTS:
        return Decimal(1)
    if name not in COMPLIANCE:
        return si_factor(unit, _QUANTITY[name])
    upper, _, lower = unit.partition("/")
    output, load = tangent_quantities(name)
    lower = lower.strip().removeprefix("(").removesuffix(")")
    if not lower:
        raise UnitError(f"[{unit}] is not a unit over a unit; write for example {examples(name)}")
    return quotient(si_factor(upper.strip(), output), si_factor(lower, load))


def examples(name: str) -> str:
    """Return a column's name with units it may have."""
    if name in COMPLIANCE:
        output, load = tangent_quantities(name)
        return f"{name} [{over(output.si, load.si)}]"
    return ", ".join(f"{name} [{unit}]" for unit in _QUANTITY[name].examples[:3])
