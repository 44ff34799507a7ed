"""`kriging`: the Gaussian process over all rows and their tangents."""

from __future__ import annotations

import numpy as np

from ..answer import COVERED, OUTSIDE
from ..kriging import Kriging
from ..table.rows import Floats, LoadRange
from .method import Estimates, Method, why_beyond
from .reference import Reference


class GaussianProcess(Method):
    """The kriging's answer; outside the load range it is an estimate.

    Parameters
    ----------
    kriging : Kriging
    load_range : LoadRange
    reference : Reference or None
        None where the kriging is the table's default method: then its own error bars hold.
    """

    name = "kriging"

    def __init__(
        self, kriging: Kriging, load_range: LoadRange, reference: Reference | None = None
    ) -> None:
        self.kriging, self.load_range, self.reference = kriging, load_range, reference

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        displacement, error = self.kriging.answer_many(wrenches)
        if self.reference is not None:
            best, own = self.reference.estimate(wrenches)
            error = np.abs(displacement - best) + own
        outside = ~self.load_range.holds(wrenches)
        state = np.where(outside, OUTSIDE, COVERED).astype(np.uint8)
        return Estimates(displacement, error, state)

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m)."""
        return self.kriging.derivatives(wrenches)

    def reason(self, wrench: Floats) -> str:
        """Return which load of a wrench (6,), N and N·m, lies outside the load range."""
        return why_beyond(self.load_range, wrench)
