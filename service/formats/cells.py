"""Cells and units: numbers with a decimal mark, times of logs, texts, and factors to SI.

Pint knows the units. This module decides which spellings reach pint, because it misreads three:
``Nm`` is a textile count (hgrecco/pint issue 817), ``N-m`` a subtraction, ``mil`` an angle. Only
products of letters pass, so that a header cannot contain arithmetic either.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Context, Decimal, localcontext
from functools import cache
from typing import Any

import numpy as np

MAX_TEXT = 131_072  # characters of one text: the limit of the csv module
_QUOTED = 40  # characters of a cell in a message: longer ones are cut
NO_VALUE = "#NO VALUE: "
"""Stands before the place of a formula that a program wrote without its value."""


class Digits(str):
    """A number that its file stores as a number: its decimal mark is a point in any file."""

    __slots__ = ()


# Formats of loggers in addition to ISO 8601. Day and month may be swapped: only differences count,
# and a log rarely includes midnight.
_CLOCK_FORMATS = (
    "%H:%M:%S.%f",
    "%H:%M:%S",
    "%I:%M:%S.%f %p",
    "%I:%M:%S %p",
    "%m/%d/%Y %I:%M:%S.%f %p",
    "%m/%d/%Y %I:%M:%S %p",
    "%m/%d/%Y %H:%M:%S.%f",
    "%m/%d/%Y %H:%M:%S",
    "%d.%m.%Y %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S",
    "%b %d, %Y %I:%M:%S.%f %p",
    "%b %d, %Y %I:%M:%S %p",
)
# A spreadsheet executes a text that begins with one of these signs as a formula (OWASP, CSV
# injection). The wide forms count too: spreadsheets with East Asian input convert them.
_FORMULA = re.compile(r"'*\s*[=+\-@\t\r\n|%＝＋－＠]")
_GUARDED = re.compile(r"''*\s*[=+\-@\t\r\n|%＝＋－＠]")
# 1.234 is 1.234 with a decimal point and 1234 with a point between thousands.
EITHER_MARK = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}")
# A number with a mark between thousands: 1,234.5 and 1 234 567.
_GROUPED = re.compile(
    r"[+-]?[1-9]\d{0,2}(?P<gap>[.,'\u2019 \u00a0\u2009\u202f])\d{3}(?P<more>(?P=gap)\d{3})*"
    r"(?:(?!(?P=gap))(?P<mark>[.,])\d*)?"
)
_DECIMAL_MARK = re.compile(r"[+-]?\d*([.,])\d*(?:[eE][+-]?\d+)?")
_ROUNDING = 3e-16  # part of a number: error of its 15 digits after three roundings


def number_text(cell: str, *, comma: bool, declared: bool = False) -> str | None:
    """Return a cell's number for `float`, None if it is no number with this decimal mark.

    `comma`: the decimal mark is a comma. `declared`: the sender has stated the mark, so that 1,234
    with a point is 1234.
    """
    grouped = _GROUPED.fullmatch(cell)
    mark = "," if comma else "."
    # 915.009 has the form of thousands, and the point is the decimal mark.
    if grouped and grouped["gap"] == mark and not (grouped["mark"] or grouped["more"]):
        grouped = None
    if grouped and (declared or grouped["gap"] not in ".," or grouped["mark"] or grouped["more"]):
        if grouped["gap"] == mark or grouped["mark"] not in (None, mark):
            return None
        cell = cell.replace(grouped["gap"], "")
    # Python alone accepts 1_000 and digits of other scripts. In a file with decimal commas, 1.234
    # may mean 1234.
    if "_" in cell or not cell.strip().isascii() or (comma and "." in cell):
        return None
    text = cell.replace(",", ".") if comma else cell
    try:
        float(text)
    except ValueError:
        return None
    return text


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with either decimal mark."""
    return any(number_text(cell, comma=comma, declared=True) is not None for comma in (False, True))


def decimal_mark(cell: str) -> str | None:
    """Return the mark, ``.`` or ``,``, that can only be a number's decimal mark, or None."""
    if grouped := _GROUPED.fullmatch(cell):
        if grouped["mark"] or not grouped["more"]:
            return grouped["mark"]
        return {".": ",", ",": "."}.get(grouped["gap"])  # the gaps of 1.234.567 are points
    match = _DECIMAL_MARK.fullmatch(cell)
    return match[1] if match else None


def quoted(cell: str) -> str:
    """Return a cell in quotation marks, cut to 40 characters."""
    cell = cell.strip()
    return f"'{cell}'" if len(cell) <= _QUOTED else f"'{cell[:_QUOTED]}...'"


def number_problem(cell: str, *, comma: bool) -> str:
    """Return the reason for which a cell is no finite number, and the remedy."""
    if not cell:
        return "is empty; write 0 for no load, split merged cells, or leave the row out"
    if cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{quoted(cell)} is not a finite number; correct it or leave the row out"
    if cell.startswith(NO_VALUE):
        return (
            f"the formula in {cell.removeprefix(NO_VALUE)} has no stored value; open the file in a "
            "spreadsheet program and save it"
        )
    if cell.startswith("#"):
        return f"{quoted(cell)} is a spreadsheet error; correct the formula or leave the row out"
    if not cell.isascii() and any(map(str.isdecimal, cell)):
        return f"{quoted(cell)} is not a number; write it with the digits 0 to 9 and - for minus"
    if number_text(cell, comma=comma) is not None:
        return f"{quoted(cell)} is too large for a float; correct it or leave the row out"
    if "," in cell or (comma and "." in cell):
        name, mark = ("comma", ",") if comma else ("point", ".")
        text = number_text(cell, comma=comma, declared=True)
        if text is None:
            mark = "." if comma else ","
            text = number_text(cell, comma=not comma)
        meant = f", or set decimal={mark} (--decimal {mark}) for {text}" if text is not None else ""
        return f"{quoted(cell)} does not fit the decimal {name}; write no other mark{meant}"
    if number_text(cell.split()[0], comma=comma) is not None:
        return f"{quoted(cell)} has text after the number; write the unit in the header only"
    return f"{quoted(cell)} is not a number; correct it or leave the row out"


def time_seconds(cell: str, factor: float | None, *, comma: bool) -> float:
    """Return a time in seconds, NaN if the cell is none; without a factor it is a clock time."""
    text = cell.strip()
    if factor is not None:
        number = number_text(text, comma=comma)
        return math.nan if number is None else float(number) * factor
    text = text.replace(",", ".") if comma else text
    for form in (None, *_CLOCK_FORMATS):
        try:
            moment = datetime.fromisoformat(text) if form is None else datetime.strptime(text, form)
        except ValueError:
            continue
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return math.nan


def guard_formula(text: str) -> str:
    """Return the text, with a ``'`` before it if a spreadsheet or an import would change it."""
    return f"'{text}" if _FORMULA.match(text) else text


def unguard_formula(text: str) -> str:
    """Return the argument of `guard_formula` from its result."""
    return text[1:] if _GUARDED.match(text) else text


def text_problem(text: str) -> str | None:
    """Return the reason for which ledger and table store cannot keep a text; None if they can."""
    if "\0" in text:
        return "contains a zero byte; remove it"
    try:
        text.encode()
    except UnicodeEncodeError:
        return "contains an unpaired surrogate (invalid Unicode); remove it"
    return None


def cell_text(value: Any, label: str) -> str:
    """Return a stored value as the text of a cell, empty for none; raises ContentError."""
    if value is None or value != value:
        return ""
    if isinstance(value, Decimal):
        return Digits(value)
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    if len(text) > MAX_TEXT:
        problem = f"a text in the column {quoted(label)} has {len(text):,} characters"
        raise ContentError(f"{problem}, more than {MAX_TEXT:,}; shorten it")
    return text


class ContentError(ValueError):
    """The file is no readable table; the message is complete, with the remedy."""


class UnitError(ValueError):
    """A unit is unknown or of another quantity; the message has the remedy."""


@dataclass(frozen=True)
class Quantity:
    """A physical quantity: its name, the unit of arrays, units that messages offer.

    A further input has its spellings as the name of a column, and the factor and the zero of each
    unit relative to the unit of arrays: 1 and 273.15 for degC in K.
    """

    name: str
    si: str
    examples: tuple[str, ...]
    spellings: tuple[str, ...] = ()
    scales: tuple[tuple[str, float, float], ...] = ()


FORCE = Quantity("force", "N", ("N", "kN", "lbf", "kgf"))
MOMENT = Quantity("moment", "N*m", ("N*m", "N*mm", "kN*m", "lbf*in", "lbf*ft"))
TRANSLATION = Quantity("translation", "m", ("m", "mm", "um", "in"))
ROTATION = Quantity("rotation", "rad", ("rad", "mrad", "deg"))
TIME = Quantity("time", "s", ("s", "ms", "us"))
QUANTITIES = (FORCE, MOMENT, TRANSLATION, ROTATION)  # an export has a unit for each

# Units of further inputs that pint misreads or does not know: factor and zero.
_SCALES = {
    "temperature": (
        *((unit, 1.0, 273.15) for unit in ("degC", "°C", "C", "celsius")),
        *((unit, 1.0, 0.0) for unit in ("kelvin", "K")),
    ),
    "acceleration": (
        *((unit, 1.0, 0.0) for unit in ("m/s^2", "m/s2", "m/s²", "m/s**2")),
        *((unit, 0.001, 0.0) for unit in ("mm/s^2", "mm/s2", "mm/s²")),
        ("g", 9.80665, 0.0),
    ),
}
_SPELLINGS = {"temperature": ("t", "temp", "temperature", "temperatur")}

# Units that pint reads differently from a test engineer.
_HINTS = {
    "lb": "lb is a mass; write lbf",
    "lbs": "lbs is a mass; write lbf",
    "kg": "kg is a mass; write kgf",
    "g": "g is a mass; write gf or N",
    "oz": "oz is a mass; write ozf",
    "mil": "mil is an angle to a unit library; write thou or um",
}
# Newton metres without a sign between them: Nm, kNm, Nmm, mNm, daNcm.
_NEWTON_METRE = re.compile(r"((?:k|m|M|d|da|c|u|µ|μ)?N)((?:m|c|d|k)?m)")
_PRODUCT = re.compile(r"\s*[*·⋅∙×.\-\s]\s*")
_WORD = re.compile(r"[A-Za-z_µμ°Å]+")
_LONGEST = 40
_PINT = Context(prec=50)  # pi as pint writes it


@cache
def si_factor(unit: str, quantity: Quantity) -> float:
    """Return the factor from a unit such as `lbf` or `N*mm` to that of arrays; raises UnitError."""
    parts = _parts(unit)
    if quantity.scales:
        factors = {name: factor for name, factor, _ in quantity.scales}
        if unit not in factors:
            examples = ", ".join(quantity.examples)
            raise UnitError(f"[{unit[:_LONGEST]}] is no unit of {quantity.name}; write {examples}")
        return factors[unit]
    if parts is None or len(unit) > _LONGEST:
        raise UnitError(f"the unit [{unit[:_LONGEST]}] cannot be read; {_offer(quantity, unit)}")
    parsed = _parsed("*".join(parts))
    si = _parsed(quantity.si)
    if parsed is None:
        raise UnitError(f"the unit [{unit}] is not known; {_offer(quantity, unit)}")
    # Pint's root units keep the radian, so that a percent does not count as an angle.
    if parsed.units != si.units:
        raise UnitError(f"[{unit}] is not a unit of {quantity.name}; {_offer(quantity, unit)}")
    return float(_PINT.divide(parsed.magnitude, si.magnitude))


@cache
def further_quantity(name: str, unit: str) -> Quantity:
    """Return the quantity of a further input, whose arrays are in `unit`."""
    for kind, scales in _SCALES.items():
        of_unit = {scale: (factor, zero) for scale, factor, zero in scales}
        if unit in of_unit:
            factor, unit_zero = of_unit[unit]
            converted = tuple((u, f / factor, (z - unit_zero) / factor) for u, f, z in scales)
            examples = dict.fromkeys((unit, *(u for u, _, _ in scales[:: len(scales) - 1])))
            return Quantity(name, unit, tuple(examples), _SPELLINGS.get(kind, ()), converted)
    return Quantity(name, unit, (unit,), (), ((unit, 1.0, 0.0),))


def chosen_units(units: Mapping[str, str] | None) -> dict[Quantity, tuple[str, float]]:
    """Return the unit of each quantity in an export, else SI, and its factor; raises UnitError."""
    others = dict(units or {})
    chosen: dict[Quantity, tuple[str, float]] = {}
    for quantity in QUANTITIES:
        unit = others.pop(quantity.name, quantity.si)
        chosen[quantity] = (unit, si_factor(unit, quantity))
    if others:
        names = ", ".join(quantity.name for quantity in QUANTITIES)
        raise UnitError(f"{', '.join(others)} is no quantity with a unit; choose units of {names}")
    return chosen


def _parts(unit: str) -> list[str] | None:
    """Return the factors of a unit; None if it contains more than letters."""
    parts: list[str] = []
    for word in _PRODUCT.split(unit.strip()):
        if not _WORD.fullmatch(word):
            return None
        joined = _NEWTON_METRE.fullmatch(word)
        parts += joined.groups() if joined else [word]
    return parts


def _offer(quantity: Quantity, unit: str) -> str:
    """Return advice on a replacement of `unit`."""
    for word in _parts(unit) or []:
        if word.lower() in _HINTS:
            return _HINTS[word.lower()]
    squeezed = "".join(_parts(unit) or []).lower()
    for example in quantity.examples:
        if squeezed == example.replace("*", "").lower():
            return f"write it in the right upper and lower case: [{example}]"
    return f"for a {quantity.name} write for example {', '.join(quantity.examples)}"


def _parsed(text: str) -> Any:
    """Return a unit in pint's root units, or None if pint does not know it."""
    registry = _registry()
    try:
        with localcontext(_PINT):
            return registry.Quantity(Decimal(1), registry.parse_units(text)).to_root_units()
    # Pint raises AssertionError, TypeError, TokenError and its own errors for unknown texts.
    except Exception:
        return None


@cache
def _registry() -> Any:
    # Imported on first use, as it takes 0.3 s.
    import pint

    with localcontext(_PINT):
        # The annotation of pint is float; its documentation allows Decimal.
        return pint.UnitRegistry(non_int_type=Decimal)  # pyright: ignore[reportArgumentType]


def scaled(values: np.ndarray, factor: float) -> np.ndarray:
    """Return numbers (n,) times a factor; if it is 1/integer, divided, which rounds once."""
    inverse = float(round(1.0 / factor))
    return values / inverse if inverse and 1.0 / inverse == factor else values * factor


def in_unit(value: float, factor: float) -> str:
    """Return the digits of an SI value in a unit: 15 if they lose only rounding, else 17."""
    if factor == 1.0:
        return repr(value)
    inverse = float(round(1.0 / factor))
    number = value * inverse if inverse and 1.0 / inverse == factor else value / factor
    short = f"{number:.15g}"
    return short if abs(float(short) - number) <= _ROUNDING * abs(number) else repr(number)


def vanished(text: str) -> bool:
    """Return whether a text that `float` reads as zero is a smaller number, such as 1e-400."""
    return any(mark in "123456789" for mark in text.lower().partition("e")[0])
