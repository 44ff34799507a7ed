"""What a method's answer is held against: the best estimate there is, and its own error bar.

A method m other than the reference R gets the bar |m - R| + bar_R: where the two agree the method
is as good as the reference, where they do not the method is taken to be wrong by the difference.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from ..composition.composition import Composition
from ..kriging import Kriging, SingularCovarianceError, TooFewRowsError
from ..table.axes import clean_rows
from ..table.rows import Floats, LoadRange, Rows
from .selection import ENOUGH_FULL

MOST_INTERACTION = 200  # full wrenches that tell what the axes miss: one quick factor
BENDS, MISSED, ITSELF = 0, 1, 2  # see `Reference.mode`


class Reference(Protocol):
    """The best estimate a table allows.

    Attributes
    ----------
    mode : int
        What `told` tells: nothing beyond the axes' outputs with their bends (`BENDS`), what those
        miss (`MISSED`), or the estimate itself (`ITSELF`).
    """

    mode: int

    def told(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return, (n, 6) each, m and rad, what `mode` says and its 95 % error bars."""
        ...

    def estimate(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars, (n, 6) each, m and rad, at wrenches (n, 6)."""
        ...


class KrigingReference:
    """The kriging, where one factor over all rows answers."""

    mode = ITSELF

    def __init__(self, kriging: Kriging) -> None:
        self.kriging = kriging
        self.told = self.estimate = kriging.answer_many


class BentReference:
    """The axes with their bends, and what full wrenches show of loads of several axes together.

    Parameters
    ----------
    composition : Composition
    interaction : Kriging or None
        Through what the bent axes miss the full wrenches by; None where there are too few, or
        where they are points of the axes themselves.
    """

    def __init__(self, composition: Composition, interaction: Kriging | None) -> None:
        self.composition, self.interaction = composition, interaction
        self.mode = BENDS if interaction is None else MISSED
        self._none = np.empty((0, 6))

    def told(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """See `Reference`; (n, 6) each, m and rad; nothing, (0, 6), without an interaction."""
        if self.interaction is None:
            return self._none, self._none
        return self.interaction.answer_many(wrenches)

    def estimate(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """See `Reference`; the bars of axes and interaction add up in quadrature.

        Displacements and bars are (n, 6) each, m and rad, at wrenches (n, 6), N and N·m.
        """
        composed = self.composition.evaluate(wrenches)
        displacement, bars = composed.displacement + composed.bend, composed.rest
        if self.interaction is None:
            return displacement, bars
        missed, own = self.interaction.answer_many(wrenches)
        return displacement + missed, np.sqrt(bars**2 + own**2)


def interaction_of(rows: Rows, load_range: LoadRange, composition: Composition) -> Kriging | None:
    """Return the kriging of what the bent axes miss full wrenches by that are not their own.

    None where such wrenches are too few, or contradict each other.
    """
    full = np.flatnonzero(~clean_rows(rows, load_range).any(axis=1))
    tables = [table for table in composition.tables if table is not None]
    taken = [place for table in tables for group in table.rows.members for place in group]
    free = np.setdiff1d(full, taken)
    if len(free) < ENOUGH_FULL:
        return None
    some = rows.take(free[:MOST_INTERACTION])
    composed = composition.evaluate(some.wrench)
    missed = some.displacement - composed.displacement - composed.bend
    blank = np.full_like(some.compliance, np.nan)
    try:
        return Kriging.build(replace(some, displacement=missed, compliance=blank), load_range)
    except (TooFewRowsError, SingularCovarianceError):
        return None
