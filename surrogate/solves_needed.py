"""How many solves a table takes to meet its tolerance, estimated by its rows so far."""

from __future__ import annotations

from collections.abc import Callable
from math import log

import numpy as np

from .build import build
from .surrogate import Surrogate

MOST = 1e6  # solves; beyond that no number says more than that


def estimate_of_solves(
    surrogate: Surrogate, worst: float, worst_of: Callable[[Surrogate], float], budget: int
) -> str:
    """Return in words how many solves the tolerance takes, empty where the budget has as many.

    Errors over solves are taken as a straight line on logarithmic scales, through the error by the
    first half of the rows and that by all of them.

    Parameters
    ----------
    worst : float
        The error of the table over the tolerance; above 1.
    worst_of : callable
        Returns that of another table, NaN where its rows do not show it.
    budget : int
        Solves that may be made now.
    """
    rows = surrogate.rows
    count, some = len(rows), len(rows) // 2
    half = build(rows.take(np.arange(some)), surrogate.load_range).groups[0][1]
    before = worst_of(half) if half.kriging is not None else np.nan
    if not (np.isfinite(before) and before > worst > 1.0):
        return "; its rows do not show yet how many solves the tolerance takes"
    rate = log(before / worst) / log(count / some)
    more = count * (min(worst ** (1 / rate), MOST) - 1) if rate > 0.01 else np.inf
    if more <= budget:
        return ""
    number = "more than a million" if more > MOST else f"about {int(float(f'{more:.2g}')):,}"
    return (
        f"; the tolerance takes {number} further solves, an estimate by the rate so far: "
        f"{before:.3g} times the tolerance with {some} rows, {worst:.3g} with {count}"
    )
