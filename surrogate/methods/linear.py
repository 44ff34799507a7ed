"""`linear`: the 6x6 compliance times the wrench."""

from __future__ import annotations

import numpy as np

from ..answer import COVERED, OUTSIDE
from ..table.axes import CLEAN
from ..table.compliance import ComplianceFit
from ..table.rows import LOADS, Floats, LoadRange
from .method import Estimates, Method, why_beyond
from .reference import Reference

ROUNDING = 1e-12  # of the answer's size: what the solver's own arithmetic leaves


class Linear(Method):
    """The compliance's answer.

    Parameters
    ----------
    fit : ComplianceFit
    reference : Reference or None
        None for a linear component, whose compliance is the whole truth.
    """

    name = "linear"

    def __init__(
        self, fit: ComplianceFit, load_range: LoadRange, reference: Reference | None
    ) -> None:
        self.fit, self.load_range, self.reference = fit, load_range, reference

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        displacement = wrenches @ self.fit.matrix.T
        # Rounding is that of the sum's parts, which may cancel.
        error = self.fit.bar + ROUNDING * np.abs(wrenches) @ np.abs(self.fit.matrix).T
        if self.reference is not None:
            best, bars = self.reference.estimate(wrenches)
            error = np.maximum(error, np.abs(displacement - best) + bars)
        unknown = self._unknown(wrenches).any(axis=1)
        error[unknown] = np.nan
        outside = unknown | ~self.load_range.holds(wrenches)
        return Estimates(displacement, error, np.where(outside, OUTSIDE, COVERED).astype(np.uint8))

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return the compliance for each wrench, (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m)."""
        return np.tile(self.fit.matrix, (len(wrenches), 1, 1))

    def reason(self, wrench: Floats) -> str:
        """Return which load of a wrench no row tells, or lies outside the load range.

        The wrench has shape (6,), N and N·m.
        """
        unknown = self._unknown(wrench[None])[0]
        if unknown.any():
            return f"no row tells the influence of {LOADS[int(np.argmax(unknown))]}"
        return why_beyond(self.load_range, wrench)

    def _unknown(self, wrenches: Floats) -> np.ndarray:
        return ~self.fit.known & (np.abs(wrenches) > CLEAN * self.load_range.scale)
