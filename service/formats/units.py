"""Units of columns: factors to SI, and numbers in another unit.

Pint knows the units. This module decides which spellings reach pint, because it misreads three:
``Nm`` is a textile count (hgrecco/pint issue 817), ``N-m`` a subtraction, ``mil`` an angle. Only
products of letters pass, so that a header cannot contain arithmetic either.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import cache
from typing import Any

import numpy as np

_ROUNDING = 3e-16  # part of a number: error of its 15 digits after three roundings


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
    "mil": "mil can also be an angle; write thou or um",
    "mils": "mils can also be angles; write thou or um",
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
            converted = tuple(
                (scale, scale_factor / factor, (zero - unit_zero) / factor)
                for scale, scale_factor, zero in scales
            )
            examples = dict.fromkeys((unit, *(scale for scale, _, _ in scales[:: len(scales) - 1])))
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
        raise UnitError(f"{next(iter(others))} is no quantity with a unit; choose units of {names}")
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
