"""What every method offers."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..table.rows import LOAD_UNITS, LOADS, Floats, LoadRange


class Estimates(NamedTuple):
    """Answers to n wrenches, before they are held against a tolerance.

    Attributes
    ----------
    displacement, error : ndarray, shape (n, 6), m and rad
        Error bars are NaN where nothing tells them.
    state : ndarray of uint8, shape (n,)
        `COVERED`, `THIN` or `OUTSIDE`.
    """

    displacement: Floats
    error: Floats
    state: NDArray[np.uint8]


class Method(Protocol):
    """One way to answer; made for one version of a table."""

    name: str

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        ...

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m), exact of the method."""
        ...

    def reason(self, wrench: Floats) -> str:
        """Return why one wrench is not covered; empty if no reason is the method's own.

        The wrench has shape (6,), N and N·m.
        """
        ...


def why_beyond(load_range: LoadRange, wrench: Floats) -> str:
    """Return which loads of a wrench (6,), N and N·m, lie outside the load range, if any do."""
    found = []
    for load in np.flatnonzero(load_range.exceeded(wrench)).tolist():
        low, high, unit = load_range.low[load], load_range.high[load], LOAD_UNITS[load]
        amount = f"{LOADS[load]} = {wrench[load]:.10g} {unit}"
        found.append(f"{amount} is outside the load range, {low:.6g}..{high:.6g} {unit}")
    return "; ".join(found)
