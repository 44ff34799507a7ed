"""The most cells that a mesh may have."""

from __future__ import annotations

MOST_CELLS = 2_000_000
"""More cells than any machine that runs this solves; a slip of the keyboard, refused."""


def too_many(cells: float, key: str) -> list[tuple[str, str]]:
    """Return the mistake of too many cells, if so, at the `key` that makes most of them."""
    if cells <= MOST_CELLS:
        return []
    return [(key, f"makes {cells:.3g} cells; the most is {MOST_CELLS // 10**6} million")]
