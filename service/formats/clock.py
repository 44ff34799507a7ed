"""Times of a log: seconds, or what a clock showed."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from decimal import Decimal

from service.formats.decimalmark import plain

# What loggers write beside ISO 8601; the day is only counted from, so that its order with the month
# matters in no log of one day.
_FORMS = (
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


def seconds(cell: str, comma: bool, factor: Decimal | None) -> float:
    """Return a time in seconds, NaN if it is none.

    Parameters
    ----------
    cell : str
    comma : bool
        Whether the decimal mark is a comma.
    factor : Decimal or None
        What one unit of the column is in seconds; without one it holds clock times.
    """
    text = cell.strip()
    if factor is None:
        return _clock(text.replace(",", ".") if comma else text)
    number = plain(text, comma)
    return float(number) * float(factor) if number is not None else math.nan


def _clock(text: str) -> float:
    try:
        return _since_epoch(datetime.fromisoformat(text))
    except ValueError:
        pass
    for form in _FORMS:
        try:
            return _since_epoch(datetime.strptime(text, form).replace(tzinfo=UTC))
        except ValueError:
            continue
    return math.nan


def _since_epoch(moment: datetime) -> float:
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
