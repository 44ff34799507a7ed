"""What a method's answer is held against: the best estimate there is, and its own error bar.

A method m other than the reference R gets the bar |m - R| + bar_R: where the two agree the method
is as good as the reference, where they do not the method is taken to be wrong by the difference.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..composition.composition import Composed, Composition
from ..kriging import Kriging
from ..table.rows import Floats


class Reference(Protocol):
    """The best estimate a table allows."""

    def estimate(self, wrenches: Floats, composed: Composed | None) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars, (n, 6) each, m and rad, at wrenches (n, 6).

        `composed` is what the axes say of them, if that is known already.
        """
        ...


class KrigingReference:
    """The kriging, where one factor over all rows answers."""

    def __init__(self, kriging: Kriging) -> None:
        self.kriging = kriging

    def estimate(self, wrenches: Floats, composed: Composed | None) -> tuple[Floats, Floats]:
        """See `Reference`."""
        return self.kriging.answer_many(wrenches)


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

    def estimate(self, wrenches: Floats, composed: Composed | None) -> tuple[Floats, Floats]:
        """See `Reference`; the bars of axes and interaction add up in quadrature."""
        composed = composed or self.composition.evaluate(wrenches)
        displacement, bars = composed.displacement + composed.bend, composed.rest
        if self.interaction is None:
            return displacement, bars
        missed, own = self.interaction.answer_many(wrenches)
        return displacement + missed, np.sqrt(bars**2 + own**2)
