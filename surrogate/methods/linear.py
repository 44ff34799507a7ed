"""`linear`: the 6x6 compliance times the wrench."""

from __future__ import annotations

from math import nan

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
        # Of a loop's single answers, which took half their time to be made anew.
        self._turned, self._sizes = fit.matrix.T, np.abs(fit.matrix).T
        small = np.where(fit.known, np.inf, CLEAN * load_range.scale)
        self._limits = list(zip(*load_range.ends.tolist(), small.tolist(), strict=True))

    def single(self, wrench: tuple[float, ...]) -> tuple[float, ...] | None:
        """Return what `estimate` says of one wrench, to the same digits; None with a reference."""
        if self.reference is not None:
            return None
        asked = np.array((wrench,), dtype=float)
        displacement = asked @ self._turned
        error = self.fit.bar + ROUNDING * np.abs(asked) @ self._sizes
        state, told = COVERED, error[0].tolist()
        for load, (low, high, small) in zip(wrench, self._limits, strict=True):
            if abs(load) > small:
                told = [nan] * 6
                state = OUTSIDE
            elif not low <= load <= high:
                state = OUTSIDE
        return (*displacement[0].tolist(), *told, state)

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        displacement = wrenches @ self._turned
        # Rounding is that of the sum's parts, which may cancel.
        error = self.fit.bar + ROUNDING * np.abs(wrenches) @ self._sizes
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
