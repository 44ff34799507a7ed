"""What the additive composition of the axes leaves out, as full wrenches show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..composition.composition import Composition
from ..kriging import Kriging, SingularCovarianceError, TooFewRowsError
from ..table.axes import clean_rows
from ..table.rows import LoadRange, Rows
from .selection import ENOUGH_FULL

MOST_INTERACTION = 200  # full wrenches that tell what the axes miss: one quick factor


def interaction_of(rows: Rows, load_range: LoadRange, composition: Composition) -> Kriging | None:
    """Return the kriging of what `additive` misses the full wrenches by that no axis has.

    None where such wrenches are too few, or contradict each other.
    """
    full = np.flatnonzero(~clean_rows(rows, load_range).any(axis=1))
    tables = [table for table in composition.tables if table is not None]
    taken = [place for table in tables for group in table.rows.members for place in group]
    free = np.setdiff1d(full, taken)
    if len(free) < ENOUGH_FULL:
        return None
    some = rows.take(free[:MOST_INTERACTION])
    missed = some.displacement - composition.evaluate(some.wrench).additive
    blank = np.full_like(some.compliance, np.nan)
    try:
        return Kriging.build(replace(some, displacement=missed, compliance=blank), load_range)
    except (TooFewRowsError, SingularCovarianceError):
        return None
