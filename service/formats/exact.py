"""One number between a file's unit and SI, rounded once, so that what is written reads back.

A unit's factor is a decimal number, and a file's number is one too. Their product is exact here
and becomes a float64 in one correct rounding. A float64 has at most 17 significant digits that
tell it from its neighbours, whatever the unit it is written in, so `in_unit` always finds digits
that `to_si` turns into the same bits. Multiplying and dividing floats instead rounds three times:
of 500 rows in lbf and mm, 380 came back one last bit apart, and stood in the table twice.
"""

from __future__ import annotations

from decimal import Context, Decimal

# A product of 25 digits of a factor and the digits people write; far exponents are no error here,
# the float they become is judged by the caller.
_WIDE = Context(prec=120, Emin=-(10**6), Emax=10**6, traps=[])
_SHORT = tuple(Context(prec=digits, traps=[]) for digits in (15, 16))
_FULL = Context(prec=17, traps=[])  # tells every float64 from its neighbours (IEEE 754)
_ONE = Decimal(1)


def to_si(text: str | Decimal, factor: Decimal) -> float:
    """Return the float64 nearest to `text` times `factor`; inf and 0 where it is out of reach.

    Parameters
    ----------
    text : str or Decimal
        A number as Python reads one.
    factor : Decimal
        What one unit is in SI.
    """
    if factor == _ONE:
        return float(text)
    return float(_WIDE.multiply(_WIDE.create_decimal(text), factor))


def in_unit(value: float, factor: Decimal) -> str:
    """Return the shortest digits, 15 to 17 or fewer, that `to_si` turns into `value` again."""
    if factor == _ONE:
        return repr(value)
    exact = _WIDE.divide(Decimal(value), factor)
    for context in _SHORT:
        short = exact.normalize(context)
        if to_si(short, factor) == value:
            return _plain(short)
    return _plain(exact.normalize(_FULL))


def quotient(upper: Decimal, lower: Decimal) -> Decimal:
    """Return the factor of a unit over a unit, or of one over a plain number."""
    return upper if lower == _ONE else _WIDE.divide(upper, lower)


def product(factor: Decimal, other: Decimal) -> Decimal:
    """Return the factor of a unit times a plain number."""
    return factor if other == _ONE else _WIDE.multiply(factor, other)


def vanished(text: str, value: float) -> bool:
    """Tell whether a number that is not zero became zero: 1e-400."""
    return value == 0.0 and any(mark in "123456789" for mark in text.lower().partition("e")[0])


def _plain(number: Decimal) -> str:
    """Write 1000 for 1E+3; Python's exponents otherwise."""
    return f"{number:f}" if 0 <= number.adjusted() <= 16 else str(number)
