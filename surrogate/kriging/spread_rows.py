"""A choice of rows that stands for many: spread widely over the loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .equations import Equations

DECIMALS = 9  # to which two distances are a tie, settled by the rows' own order


def spread_rows(equations: Equations, most_rows: int, most_equations: int) -> NDArray[np.intp]:
    """Return rows within the limits, each the farthest from those before it, in their own order.

    Shape (k,): indices of the rows.
    """
    size = equations.known.sum(axis=1)
    chosen = [int(np.argmin(np.round((equations.x**2).sum(axis=1), DECIMALS)))]
    total = size[chosen[0]]
    distance = np.full(len(equations), np.inf)
    while len(chosen) < min(len(equations), most_rows):
        apart = ((equations.x - equations.x[chosen[-1]]) ** 2).sum(axis=1)
        distance = np.minimum(distance, apart)
        place = int(np.argmax(np.round(distance, DECIMALS)))
        total += size[place]
        if total > most_equations:
            break
        chosen.append(place)
    return np.sort(chosen)
