"""The three methods of the axes: `griddata`, `additive` and `tangent`."""

from __future__ import annotations

import numpy as np

from ..answer import COVERED, OUTSIDE, THIN
from ..composition.composition import OFF_HULL, Composition
from ..composition.reasons import why_not
from ..table.rows import Floats
from .method import Estimates, Method
from .reference import Reference


class StraightDirection(Method):
    """The composition's answer, with error bars from the reference.

    Parameters
    ----------
    composition : Composition
    reference : Reference
    name : {"griddata", "additive", "tangent"}
        Translations of their own axis alone; all six outputs composed; `griddata` with its bends.
    """

    def __init__(self, composition: Composition, reference: Reference, name: str) -> None:
        self.composition, self.reference, self.name = composition, reference, name

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        composed = self.composition.evaluate(wrenches)
        displacement = composed.of(self.name)
        best, error = self.reference.against(wrenches, composed)
        error = np.abs(displacement - best) + error
        off = (composed.state >= OFF_HULL)[:, None]
        # Off the hull an answer may be as wrong as the step from there is long.
        error = np.where(off, np.maximum(error, composed.rest), error)
        coverage = np.where(off[:, 0], OUTSIDE, np.where(composed.state > 0, THIN, COVERED))
        return Estimates(displacement, error, coverage.astype(np.uint8))

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m): the slopes of the simplices."""
        return self.composition.derivatives(wrenches, self.name)

    def reason(self, wrench: Floats) -> str:
        """Return which axis does not hold a wrench (6,), N and N·m, and why."""
        return why_not(self.composition, wrench)
