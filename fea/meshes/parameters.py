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
