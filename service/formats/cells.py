"""Cells of tables: numbers with a decimal mark, times of logs, and texts."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from decimal import Decimal
from typing import Any

MAX_TEXT = 131_072  # characters of one text: the limit of the csv module
_MAX_QUOTED = 40  # characters of a cell in a message: a longer one would hide the remedy
NO_VALUE = "#NO VALUE: "  # before the place of a formula that a program wrote without its value


class ContentError(ValueError):
    """The file is no readable table; the message is complete, with the remedy."""


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
_GUARDED = re.compile("'" + _FORMULA.pattern)
# 1.234 is 1.234 with a decimal point and 1234 with a point between thousands.
EITHER_MARK = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}")
# A number with a mark between thousands: 1,234.5 and 1 234 567.
_GROUPED = re.compile(
    r"[+-]?[1-9]\d{0,2}(?P<gap>[.,'\u2019 \u00a0\u2009\u202f])\d{3}(?P<more>(?P=gap)\d{3})*"
    r"(?:(?!(?P=gap))(?P<mark>[.,])\d*)?"
)
_DECIMAL_MARK = re.compile(r"[+-]?\d*([.,])\d*(?:[eE][+-]?\d+)?")


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
    return f"'{cell}'" if len(cell) <= _MAX_QUOTED else f"'{cell[:_MAX_QUOTED]}...'"


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
    text = re.sub(r"(?<=\d),(?=\d)", ".", text) if comma else text
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


def underflows(text: str) -> bool:
    """Return whether a text that `float` reads as zero is a smaller number, such as 1e-400."""
    return any(mark in "123456789" for mark in text.lower().partition("e")[0])
