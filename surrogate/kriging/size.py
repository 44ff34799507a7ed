"""How large a kriging would be, told without making it."""

from __future__ import annotations

import numpy as np

from ..table.rows import LoadRange, Rows
from .correlation import PLACES
from .equations import scaling_of, within
from .settings import DEFAULTS, KrigingSettings


def equation_count(rows: Rows, load_range: LoadRange, settings: KrigingSettings = DEFAULTS) -> int:
    """Return how many equations rows of distinct wrenches bring: values, and slopes by loads.

    Raises
    ------
    TooFewRowsError
        If too few rows lie in the load range.
    """
    sloped = np.isfinite(rows.compliance).all(axis=(1, 2))
    if len(rows) * PLACES <= settings.dense_equations or not sloped.any():
        return len(rows) + (PLACES - 1) * int(sloped.sum())
    inside = within(rows, load_range, settings)
    loads = int(scaling_of(inside, load_range, settings).active.sum())
    return len(inside) + loads * int(np.isfinite(inside.compliance).all(axis=(1, 2)).sum())


def fits_one_factor(equations: int, settings: KrigingSettings = DEFAULTS) -> bool:
    """Return whether one dense factor holds so many equations."""
    return equations <= settings.dense_equations


def too_large_in_words(rows: int, equations: int, settings: KrigingSettings = DEFAULTS) -> str:
    """Return why a table of so many rows and equations has no kriging."""
    return (
        f"no kriging: {rows} rows bring {equations} equations, one factor holds "
        f"{settings.dense_equations}"
    )
