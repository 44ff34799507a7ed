"""Numbers as text: which decimal mark a file has, and why a field is no number."""

from __future__ import annotations

import re
from collections.abc import Iterable

# 1,234 is 1.234 with a decimal comma and 1234 with a comma between thousands.
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}")
_MARKED = re.compile(r"[+-]?\d*([.,])\d*(?:[eE][+-]?\d+)?")
_SHOWN = 40


def plain(cell: str, comma: bool) -> str | None:
    """Return a number's text with a decimal point, or None if the field is no number.

    What it returns is what ``float`` reads: nan and inf as well, which are no number of a table.
    """
    # Python reads 1_000 and the digits of other scripts, nobody else does; 1.234 beside decimal
    # commas may mean 1234.
    if "_" in cell or not cell.strip().isascii() or (comma and "." in cell):
        return None
    text = cell.replace(",", ".") if comma else cell
    try:
        float(text)
    except ValueError:
        return None
    return text


def evidence(cells: Iterable[str]) -> tuple[set[str], str | None]:
    """Return the marks that are surely decimal ones, and a field whose mark may be either."""
    sure: set[str] = set()
    doubtful = None
    for cell in cells:
        text = cell.strip()
        either = _EITHER.fullmatch(text)
        if either:
            doubtful = doubtful or text
            continue
        marked = _MARKED.fullmatch(text)
        if marked:
            sure.add(marked[1])
            if len(sure) == 2:
                break
    return sure, doubtful


def shown(cell: str) -> str:
    """Quote a field for a message, cut to what a line holds."""
    cell = cell.strip()
    return f"'{cell}'" if len(cell) <= _SHOWN else f"'{cell[:_SHOWN]}...'"


def why(cell: str, comma: bool) -> str:
    """Say why a field is not a number and what to write."""
    if not cell:
        return "is empty; write 0 for no load"
    if cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{shown(cell)} is not finite; leave the row out"
    if cell.startswith("#"):
        return f"{shown(cell)} is a spreadsheet's error; correct the formula or leave the row out"
    if not cell.isascii() and any(map(str.isdecimal, cell)):
        return f"{shown(cell)} is not a number; write it with the digits 0 to 9, and - for minus"
    if plain(cell, comma) is not None:
        return f"{shown(cell)} is too large a number"
    if "," in cell or (comma and "." in cell):
        mark = "comma" if comma else "point"
        return f"{shown(cell)}: the file has a decimal {mark}; write no other mark, no thousands"
    if plain(cell.split()[0], comma) is not None:
        return f"{shown(cell)} is not a number alone; the unit stands in the header only"
    return f"{shown(cell)} is not a number"
