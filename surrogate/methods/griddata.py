"""`griddata`: piecewise linear between the rows; `tangent`: with the bends their slopes tell."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..answer import COVERED, OUTSIDE, THIN
from ..composition.axis_table import SOUND
from ..composition.composition import OFF_HULL, Composed, Composition
from ..composition.fast import UNKNOWN, compose
from ..composition.packed import Packed, pack
from ..composition.reasons import why_not
from ..jit import COMPILED
from ..table.rows import Floats
from .method import Estimates
from .reference import Reference


class Griddata:
    """The composition's answer, with bars from the reference.

    Parameters
    ----------
    composition : Composition
    reference : Reference
    bent : bool
        Whether the bends are added to the answer (`tangent`).
    """

    def __init__(self, composition: Composition, reference: Reference, *, bent: bool) -> None:
        self.composition, self.reference, self.bent = composition, reference, bent
        self.name = "tangent" if bent else "griddata"

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        composed = self._composed(wrenches)
        displacement = composed.displacement + (composed.bend if self.bent else 0.0)
        best, bars = self.reference.estimate(wrenches, composed)
        worst = composed.state
        state = np.where(worst >= OFF_HULL, OUTSIDE, np.where(worst > SOUND, THIN, COVERED))
        # Off the hull the answer may be as wrong as the step from there is long; on it by the rest.
        off = worst >= OFF_HULL
        error = np.abs(displacement - best) + bars
        error[off] = np.maximum(error[off], composed.rest[off])
        return Estimates(displacement, error, state.astype(np.uint8))

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m): the slopes of the simplices."""
        composed = self.composition.evaluate(wrenches)
        return composed.slopes + (composed.bend_slopes if self.bent else 0.0)

    def reason(self, wrench: Floats) -> str:
        """Return which axis does not hold a wrench (6,), and why."""
        return why_not(self.composition, wrench)

    def _composed(self, wrenches: Floats) -> Composed:
        """Compose by the compiled pass; by the array version what that does not know."""
        if not COMPILED:
            return self.composition.evaluate(wrenches)
        count = len(wrenches)
        moved, bend, squares = (np.empty((count, 6)) for _ in range(3))
        state = np.empty(count, dtype=np.int64)
        asked = np.ascontiguousarray(wrenches, dtype=float)
        compose(asked, *self._packed, moved, bend, squares, state)
        found = Composed(moved, bend, np.sqrt(squares), state)
        lost = np.flatnonzero(state == UNKNOWN)
        if len(lost):
            rest = self.composition.evaluate(wrenches[lost])
            found.displacement[lost], found.bend[lost] = rest.displacement, rest.bend
            found.rest[lost], found.state[lost] = rest.rest, rest.state
        return found

    @cached_property
    def _packed(self) -> Packed:
        return pack(self.composition)
