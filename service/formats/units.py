"""What a unit in a CSV header is worth in SI.

Pint knows the units; this file decides which spellings reach it, because three of its readings
would be wrong without a word: ``Nm`` is a textile count there (hgrecco/pint issue 817), ``N-m`` a
subtraction, ``mil`` an angle. Only letters joined into products pass, so a header can hold no
arithmetic either.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import cache
from typing import Any


class UnitError(ValueError):
    """A unit that is unknown or measures something else; the text says what to write."""


@dataclass(frozen=True)
class Quantity:
    """What one group of columns measures.

    Parameters
    ----------
    name : str
        The word used in messages and in the ``units`` of an export.
    si : str
        The SI unit all arrays are in.
    examples : tuple of str
        Spellings a message offers, the SI unit first.
    """

    name: str
    si: str
    examples: tuple[str, ...]


FORCE = Quantity("force", "N", ("N", "kN", "lbf", "kgf"))
MOMENT = Quantity("moment", "N*m", ("N*m", "N*mm", "kN*m", "lbf*in", "lbf*ft"))
TRANSLATION = Quantity("translation", "m", ("m", "mm", "um", "in"))
ROTATION = Quantity("rotation", "rad", ("rad", "mrad", "deg"))
TIME = Quantity("time", "s", ("s", "ms", "us"))
QUANTITIES = (FORCE, MOMENT, TRANSLATION, ROTATION)  # those that an export can choose a unit of

# Words that mean something else to a unit library than to a test engineer.
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
# Pint's definitions are divisions of 28 digits (an inch is a yard over 36), whose last digits are
# rounding. 25 digits give every factor that is a decimal number exactly, such as lbf*in, and pi
# far below what a float64 can tell.
_DIGITS = Context(prec=25)
_PINT = Context(prec=50)  # pi as pint writes it


@cache
def si_factor(unit: str, quantity: Quantity) -> Decimal:
    """Return what one `unit` is in the SI unit of `quantity`.

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


def chosen_units(units: Mapping[str, str] | None) -> dict[Quantity, tuple[str, Decimal]]:
    """Complete the units asked of an export.

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
    asked = dict(units or {})
    chosen: dict[Quantity, tuple[str, Decimal]] = {}
    for quantity in QUANTITIES:
        unit = asked.pop(quantity.name, quantity.si)
        chosen[quantity] = (unit, si_factor(unit, quantity))
    if asked:
        names = ", ".join(quantity.name for quantity in QUANTITIES)
        raise UnitError(f"no unit can be chosen for {', '.join(asked)}; there are {names}")
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
    """Say what to write instead of `unit`."""
    for word in _words(unit) or []:
        if word.lower() in _HINTS:
            return _HINTS[word.lower()]
    squeezed = "".join(_words(unit) or []).lower()
    for example in quantity.examples:
        if squeezed == example.replace("*", "").lower():
            return f"upper and lower case differ: did you mean [{example}]?"
    return f"a {quantity.name} takes for example {', '.join(quantity.examples)}"


def _parsed(text: str) -> Any:
    """Return one of the unit in pint's root units, or None if pint does not know it."""
    registry = _registry()
    try:
        with localcontext(_PINT):
            return registry.Quantity(Decimal(1), registry.parse_units(text)).to_root_units()
    # Pint lets through whatever its tokenizer or an offset unit meets (AssertionError, TypeError,
    # TokenError, its own errors): none of them says more than "unknown" to the sender.
    except Exception:
        return None


@cache
def _registry() -> Any:
    """Return pint's registry, made on first use."""
    # Imported late: it and its definitions take 0.3 s, which a server without CSV never spends.
    import pint

    with localcontext(_PINT):
        # Pint declares this as a kind of float; its documentation offers Decimal.
        return pint.UnitRegistry(non_int_type=Decimal)  # pyright: ignore[reportArgumentType]
