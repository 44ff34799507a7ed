"""Units of columns: their exact factors to SI, and numbers converted with one rounding.

Pint knows the units. This module decides which spellings reach it, because pint misreads three:
``Nm`` is a textile count (hgrecco/pint issue 817), ``N-m`` a subtraction, ``mil`` an angle. Only
products of letters pass, so a header can hold no arithmetic either.

A factor is a decimal number, and a number of a file is one too. Their product is exact and becomes
a float64 in one correct rounding; `in_unit` finds digits that `to_si` converts to the same bits.
Float arithmetic rounds three times: of 500 rows exported in lbf and mm, 380 came back one bit apart
and were loaded a second time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import cache
from typing import Any


class UnitError(ValueError):
    """A unit is unknown or measures another quantity; the message has the remedy."""


@dataclass(frozen=True)
class Quantity:
    """A physical quantity: its name, the unit of arrays, units that messages offer.

    A further input of a component has its spellings as the name of a column, and the factor and
    the zero of each unit in that of arrays: 1 and 273.15 of degC in K.
    """

    name: str
    si: str
    examples: tuple[str, ...]
    spellings: tuple[str, ...] = ()
    scales: tuple[tuple[str, Decimal, Decimal], ...] = ()


FORCE = Quantity("force", "N", ("N", "kN", "lbf", "kgf"))
MOMENT = Quantity("moment", "N*m", ("N*m", "N*mm", "kN*m", "lbf*in", "lbf*ft"))
TRANSLATION = Quantity("translation", "m", ("m", "mm", "um", "in"))
ROTATION = Quantity("rotation", "rad", ("rad", "mrad", "deg"))
TIME = Quantity("time", "s", ("s", "ms", "us"))
QUANTITIES = (FORCE, MOMENT, TRANSLATION, ROTATION)  # an export has a unit for each

# Units of further inputs, which pint reads as others or not at all: factor and zero.
_NONE = Decimal(0)
_SCALES = {
    "temperature": (
        *((unit, Decimal(1), Decimal("273.15")) for unit in ("degC", "°C", "C", "celsius")),
        *((unit, Decimal(1), _NONE) for unit in ("kelvin", "K")),
    ),
    "acceleration": (
        *((unit, Decimal(1), _NONE) for unit in ("m/s^2", "m/s2", "m/s²", "m/s**2")),
        *((unit, Decimal("0.001"), _NONE) for unit in ("mm/s^2", "mm/s2", "mm/s²")),
        ("g", Decimal("9.80665"), _NONE),
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
# Pint divides with 28 digits (an inch is a yard over 36), the last ones rounded.
# 25 digits give every decimal factor exactly, such as lbf*in.
_DIGITS = Context(prec=25)
_PINT = Context(prec=50)  # pi as pint writes it


@cache
def si_factor(unit: str, quantity: Quantity) -> Decimal:
    """Return the factor from `unit` to the SI unit of `quantity`.

    Parameters
    ----------
    unit : str
        A unit, or units joined by ``*``, ``·``, ``-``, ``.`` or a space: ``lbf``, ``N*mm``,
        ``in-lbf``, ``Nm``, ``deg``. Upper and lower case differ.
    quantity : Quantity
        What the column measures.

    Returns
    -------
    Decimal
        Positive factor of at most 25 digits: SI value = factor times value.

    Raises
    ------
    UnitError
        If the unit is unknown or measures something else.
    """
    words = _words(unit)
    if quantity.scales:
        known = next((factor for name, factor, _ in quantity.scales if name == unit), None)
        if known is None:
            examples = ", ".join(quantity.examples)
            raise UnitError(f"[{unit[:_LONGEST]}] is not a unit of {quantity.name}: {examples}")
        return known
    if words is None or len(unit) > _LONGEST:
        raise UnitError(
            f"[{unit[:_LONGEST]}] is not a unit that can be read; {_offer(quantity, unit)}"
        )
    one, si = _parsed("*".join(words)), _parsed(quantity.si)
    if one is None:
        raise UnitError(f"the unit [{unit}] is not known; {_offer(quantity, unit)}")
    # Pint's root units keep the radian, so that a percent is not taken for an angle.
    if one.units != si.units:
        raise UnitError(f"[{unit}] is not a unit of {quantity.name}; {_offer(quantity, unit)}")
    return _DIGITS.divide(one.magnitude, si.magnitude).normalize(_DIGITS)


@cache
def further_quantity(name: str, unit: str) -> Quantity:
    """Return the quantity of an input that is no load, whose arrays are in `unit`."""
    for kind, scales in _SCALES.items():
        own = next((one for one in scales if one[0] == unit), None)
        if own is not None:
            _, factor, zero = own
            found = ((u, quotient(f, factor), quotient(z - zero, factor)) for u, f, z in scales)
            examples = dict.fromkeys((unit, *(one for one, _, _ in scales[:: len(scales) - 1])))
            return Quantity(name, unit, tuple(examples), _SPELLINGS.get(kind, ()), tuple(found))
    return Quantity(name, unit, (unit,), (), ((unit, Decimal(1), _NONE),))


def chosen_units(units: Mapping[str, str] | None) -> dict[Quantity, tuple[str, Decimal]]:
    """Return the units of an export, completed by SI units.

    Parameters
    ----------
    units : mapping or None
        Any of ``force``, ``moment``, ``translation``, ``rotation`` to a unit; the rest stay SI.

    Returns
    -------
    dict
        Per quantity the unit as written and its SI factor.

    Raises
    ------
    UnitError
        If a key is no quantity or a unit does not measure it.
    """
    others = dict(units or {})
    chosen: dict[Quantity, tuple[str, Decimal]] = {}
    for quantity in QUANTITIES:
        unit = others.pop(quantity.name, quantity.si)
        chosen[quantity] = (unit, si_factor(unit, quantity))
    if others:
        names = ", ".join(quantity.name for quantity in QUANTITIES)
        raise UnitError(f"no unit can be chosen for {', '.join(others)}; there are {names}")
    return chosen


def _words(unit: str) -> list[str] | None:
    """Split a unit into its factors, or return None if it holds more than letters."""
    words: list[str] = []
    for word in _PRODUCT.split(unit.strip()):
        if not _WORD.fullmatch(word):
            return None
        joined = _NEWTON_METRE.fullmatch(word)
        words += joined.groups() if joined else [word]
    return words


def _offer(quantity: Quantity, unit: str) -> str:
    """Return advice on what to write instead of `unit`."""
    for word in _words(unit) or []:
        if word.lower() in _HINTS:
            return _HINTS[word.lower()]
    squeezed = "".join(_words(unit) or []).lower()
    for example in quantity.examples:
        if squeezed == example.replace("*", "").lower():
            return f"upper and lower case differ: did you mean [{example}]?"
    return f"a {quantity.name} takes for example {', '.join(quantity.examples)}"


def _parsed(text: str) -> Any:
    """Return one unit in pint's root units, or None if pint does not know it."""
    registry = _registry()
    try:
        with localcontext(_PINT):
            return registry.Quantity(Decimal(1), registry.parse_units(text)).to_root_units()
    # Pint raises AssertionError, TypeError, TokenError and its own errors on unknown text.
    except Exception:
        return None


@cache
def _registry() -> Any:
    """Return pint's registry."""
    # Imported on first use: 0.3 s.
    import pint

    with localcontext(_PINT):
        # The annotation of pint is float; its documentation allows Decimal.
        return pint.UnitRegistry(non_int_type=Decimal)  # pyright: ignore[reportArgumentType]


# 25 digits of a factor times the digits of a number. Exponents out of range are no error here:
# the caller checks the float.
_WIDE = Context(prec=120, Emin=-(10**6), Emax=10**6, traps=[])
_SHORT = tuple(Context(prec=digits, traps=[]) for digits in (15, 16))
_FULL = Context(prec=17, traps=[])  # separates neighbouring float64 (IEEE 754)
_ONE = Decimal(1)


def to_si(text: str | Decimal, factor: Decimal, zero: Decimal = _NONE) -> float:
    """Return the float64 nearest to `text` times `factor` plus `zero`; inf or 0 beyond its range.

    Parameters
    ----------
    text : str or Decimal
    factor, zero : Decimal
        From the unit to SI: of a temperature in degC 1 and 273.15.
    """
    if factor == _ONE and not zero:
        return float(text)
    product = _WIDE.multiply(_WIDE.create_decimal(text), factor)
    return float(_WIDE.add(product, zero) if zero else product)


def in_unit(value: float, factor: Decimal) -> str:
    """Return the shortest digits, at most 17, that `to_si` converts back to `value`."""
    if factor == _ONE:
        return repr(value)
    exact = _WIDE.divide(Decimal(value), factor)
    for context in _SHORT:
        short = exact.normalize(context)
        if to_si(short, factor) == value:
            return _plain(short)
    return _plain(exact.normalize(_FULL))


def quotient(upper: Decimal, lower: Decimal) -> Decimal:
    """Return a factor over a factor."""
    return upper if lower == _ONE else _WIDE.divide(upper, lower)


def product(factor: Decimal, other: Decimal) -> Decimal:
    """Return a factor times a factor."""
    return factor if other == _ONE else _WIDE.multiply(factor, other)


def vanished(text: str, value: float) -> bool:
    """Return whether the text is not zero and its float is: 1e-400."""
    return value == 0.0 and any(mark in "123456789" for mark in text.lower().partition("e")[0])


def _plain(number: Decimal) -> str:
    """Write 1000 for 1E+3; Python's exponents otherwise."""
    return f"{number:f}" if 0 <= number.adjusted() <= 16 else str(number)
