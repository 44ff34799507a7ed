"""How each method of a table is made, once it is asked for."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

from .gaussian import GaussianProcess
from .linear import Linear
from .method import Method
from .nearest import Nearest
from .straight_direction import StraightDirection


def makers(whole: Any) -> dict[str, Callable[[], Method]]:
    """Return how to make each of `METHODS` for a `Surrogate`.

    They do not hold it: in a circle a version would stay, with all its memory, after nobody asks
    it any more.
    """
    table = weakref.proxy(whole)
    return {
        "griddata": lambda: _straight(table, "griddata"),
        "additive": lambda: _straight(table, "additive"),
        "tangent": lambda: _straight(table, "tangent"),
        "kriging": lambda: _gaussian(table),
        "linear": lambda: _linear(table),
        "nearest": lambda: Nearest(table.used, table.load_range, table.reference),
    }


def _straight(table: Any, name: str) -> Method:
    return StraightDirection(table.composition, table.reference, name)


def _gaussian(table: Any) -> Method:
    if table.kriging is None:  # too few rows, or rows that contradict each other
        return _straight(table, "tangent")
    own = table.default == "kriging"
    return GaussianProcess(table.kriging, table.load_range, None if own else table.reference)


def _linear(table: Any) -> Method:
    exact = table.linear and table.fit.complete
    return Linear(table.fit, table.load_range, None if exact else table.reference)
