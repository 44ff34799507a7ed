"""What a generator's parameters are: dataclass fields that carry their unit and bounds."""

from __future__ import annotations

from dataclasses import MISSING, field
from typing import Any


def metres(default: Any = MISSING) -> Any:
    """Return the field of a length above zero, m."""
    return positive("m", default)


def positive(unit: str, default: Any = MISSING) -> Any:
    """Return the field of a number above zero."""
    return field(default=default, metadata={"unit": unit})


def count(default: Any = MISSING, least: int = 1) -> Any:
    """Return the field of a whole number of at least `least`."""
    return field(default=default, metadata={"least": least})


MOST_CELLS = 2_000_000
"""More cells than any machine that runs this solves; a slip of the keyboard, refused."""


def too_many(cells: float, key: str) -> list[tuple[str, str]]:
    """Return the mistake of too many cells, if so, at the `key` that makes most of them."""
    if cells <= MOST_CELLS:
        return []
    return [(key, f"makes {cells:.3g} cells; the most is {MOST_CELLS // 10**6} million")]
