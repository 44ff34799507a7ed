"""Parameters of a test of which `make test` runs a few, and `make test-slow` the others."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import pytest


def slow(value: object) -> object:
    """Mark a value slow, or a tuple of the values of several arguments."""
    if hasattr(value, "marks"):
        return pytest.param(*value.values, marks=[*value.marks, pytest.mark.slow], id=value.id)
    values = value if isinstance(value, tuple) else (value,)
    return pytest.param(*values, marks=pytest.mark.slow)


def slow_but(quick: Collection[object], values: Iterable[object]) -> list[object]:
    """Mark all values slow but the quick ones."""
    values = [*values]
    left = [value for value in quick if value not in map(_plain, values)]
    assert not left, f"no parameters: {left}"
    return [value if _plain(value) in quick else slow(value) for value in values]


def _plain(value: object) -> object:
    """Return the value of a parameter without its marks."""
    if not hasattr(value, "marks"):
        return value
    return value.values[0] if len(value.values) == 1 else tuple(value.values)
