"""Saying in words how a table's method answers."""

from __future__ import annotations

from surrogate.build import AnyTable
from surrogate.missing_outputs import MissingOutputs

_ROW = "the displacement that a row of the table has at this wrench"


def detail_of(surrogate: AnyTable | None, method: str) -> str:
    """Return how a method answers, or why it is the one that does.

    Of several surrogates, which hold different outputs, that of the fewest rows is described.
    """
    if method == "row" or surrogate is None:
        return _ROW
    one = surrogate.thinnest if isinstance(surrogate, MissingOutputs) else surrogate
    if method == "kriging" and one.kriging is not None:
        return one.kriging.detail
    return one.choice.reason if method == one.default else "asked for"
