"""How fast solves go, when they will be over, and what they have brought."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from wrenchbook.service.contract import OUTPUTS


class Pace:
    """Solves that end, over all rounds of a fill.

    Parameters
    ----------
    budget : int
        Solves that may be spent in all.
    clock : callable
        Seconds from somewhere, never going back.
    """

    def __init__(self, budget: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._budget, self._clock = budget, clock
        self._started = clock()
        self.ended = 0

    def note(self, in_round: float = 0.0) -> str:
        """Say solves a minute and the time that is left, with those of the round that runs."""
        solves, seconds = self.ended + in_round, self._clock() - self._started
        if solves < 1 or seconds <= 0:
            return ""
        left = max(0.0, self._budget - solves) * seconds / solves
        return f"{60 * solves / seconds:.0f} solves/min, at most {_words(left)} left"


def error_bars(coverage: Mapping[str, Any]) -> str:
    """Return the mean error bar of griddata over the range, m or rad, and the method that answers.

    Of each output's worst axis; empty where none has one. They do not decide when a fill ends.
    """
    largest: dict[str, float] = {}
    for axis in coverage.get("axes", ()):
        for output, mean in (axis["error"] or {}).items():
            if mean == mean:  # one that is not known is NaN, or null on the wire
                largest[output] = max(mean, largest.get(output, 0.0))
    named = [
        f"{name} {largest[name]:.1e} {'m' if name[0] == 'u' else 'rad'}"
        for name in OUTPUTS
        if name in largest
    ]
    if not named:
        return ""
    return (
        "mean error bar of linear interpolation between the rows (griddata): "
        f"{', '.join(named)}; the table answers by {coverage['method']}"
    )


def _words(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
