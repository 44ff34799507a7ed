"""What a method's answer is compared with: the best estimate there is, and its own error bar.

A method m other than the reference R has the error bar |m - R| + error bar of R: where the two
agree the method is as good as the reference, where they do not the method is taken to be wrong by
the difference. R is the kriging where the kriging is the default method of the table, else the
additive composition of the axes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from ..composition.composition import Composed, Composition
from ..kriging import Kriging, SingularCovarianceError, TooFewRowsError
from ..table.axes import clean_rows
from ..table.rows import Floats, LoadRange, Rows
from .selection import ENOUGH_FULL

MOST_INTERACTION = 200  # full wrenches that tell what the axes miss: one quick factor


class Reference(Protocol):
    """The best estimate a table allows."""

    def estimate(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars, (n, 6) each, m and rad, at wrenches (n, 6)."""
        ...

    def against(self, wrenches: Floats, composed: Composed) -> tuple[Floats, Floats]:
        """Return what `estimate` does, (n, 6) each, m and rad, with the axes' answers at hand."""
        ...


class KrigingReference:
    """The kriging, where it is the default method."""

    def __init__(self, kriging: Kriging) -> None:
        self.kriging = kriging
        self.estimate = kriging.answer_many

    def against(self, wrenches: Floats, composed: Composed) -> tuple[Floats, Floats]:
        """See `Reference`; (n, 6) each, m and rad."""
        return self.estimate(wrenches)


class AxesReference:
    """The additive composition, and what full wrenches show of loads of several axes together.

    Parameters
    ----------
    composition : Composition
    interaction : Kriging or None
        Through what the additive composition misses the full wrenches by; None where there are too
        few, or where they are points of the axes themselves.
    """

    def __init__(self, composition: Composition, interaction: Kriging | None) -> None:
        self.composition, self.interaction = composition, interaction

    def estimate(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """See `Reference`; (n, 6) each, m and rad, at wrenches (n, 6), N and N·m."""
        return self.against(wrenches, self.composition.evaluate(wrenches))

    def against(self, wrenches: Floats, composed: Composed) -> tuple[Floats, Floats]:
        """See `Reference`; the error bars of axes and interaction add up in quadrature.

        Displacements and error bars are (n, 6) each, m and rad, at wrenches (n, 6), N and N·m.
        """
        if self.interaction is None:
            return composed.additive, composed.rest
        missed, own = self.interaction.answer_many(wrenches)
        return composed.additive + missed, np.sqrt(composed.rest**2 + own**2)


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
