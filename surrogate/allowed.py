"""How large an answer's error bars may be for it to be covered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .answer import allowed_by
from .table.rows import Floats, Rows, Tolerance

WITHOUT_TOLERANCE = 0.01  # of an output's range: what a kriging's bar may be where nobody says
_ANY = (np.inf,) * 6


@dataclass(frozen=True)
class Allowed:
    """The largest bars of covered answers, by what is asked for.

    Attributes
    ----------
    tolerance : Tolerance or None, m and rad
        The component's own.
    ranges : ndarray, shape (6,), m and rad
        What each output varies by over the rows and from zero.
    """

    tolerance: Tolerance | None
    ranges: Floats

    def of(self, method: str, tolerance: Tolerance | None) -> Sequence[float]:
        """Return the largest bar of each output, shape (6,), m and rad, for a covered answer."""
        limit = tolerance or self.tolerance
        if limit is not None:
            return allowed_by(limit)
        return self._hundredths if method == "kriging" else _ANY

    @cached_property
    def _hundredths(self) -> list[float]:
        """A hundredth of each output's range; what no row moves has none to take a share of."""
        return np.where(self.ranges > 0, WITHOUT_TOLERANCE * self.ranges, np.inf).tolist()


def allowed_of(rows: Rows, tolerance: Tolerance | None) -> Allowed:
    """Return what is allowed of a table whose answers are made of these rows."""
    moved = rows.displacement
    high = np.maximum(moved.max(axis=0, initial=0.0), 0.0)
    return Allowed(tolerance, high - np.minimum(moved.min(axis=0, initial=0.0), 0.0))
