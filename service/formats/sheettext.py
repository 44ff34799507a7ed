"""Texts in spreadsheets: what would be a formula, and what XML cannot hold.

A spreadsheet runs a CSV's text that begins with ``=``, ``+``, ``-`` or ``@`` as a formula (OWASP,
CSV injection). An export writes a ``'`` before it, which an import takes off again; one that begins
with ``'`` and such a sign gets one more, so that both come back as they were.
"""

from __future__ import annotations

import re

# The wide forms as well: spreadsheets with East Asian input take them for the plain ones.
_FORMULA = re.compile(r"'*\s*[=+\-@\t\r\n|%＝＋－＠]")
_GUARDED = re.compile(r"''*\s*[=+\-@\t\r\n|%＝＋－＠]")
# ST_Xstring (ECMA-376, 22.9.2.19): what XML 1.0 cannot hold, and what looks like such an escape.
_UNFIT = re.compile("[\x00-\x08\x0b-\x0d\x0e-\x1f\ufffe\uffff]|_(?=x[0-9A-Fa-f]{4}_)")
_ESCAPE = re.compile(r"_x([0-9A-Fa-f]{4})_")


def guarded(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    return f"'{text}" if _FORMULA.match(text) else text


def unguarded(text: str) -> str:
    """Return the text that `guarded` was given."""
    return text[1:] if _GUARDED.match(text) else text


def escaped(text: str) -> str:
    """Return a text as the XML of a sheet can hold it."""
    return _UNFIT.sub(lambda found: f"_x{ord(found[0]):04X}_", text)


def unescaped(text: str) -> str:
    """Return the text that `escaped` was given."""
    return _ESCAPE.sub(lambda found: chr(int(found[1], 16)), text)
