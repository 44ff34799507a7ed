"""What is said of an answer that the table does not cover."""

from __future__ import annotations

import numpy as np

from service.answering.load_range import why_beyond
from service.answering.queries import BatchOutcome, Outcome
from service.tablefile.limits import ROTATION_LIMIT, TRANSLATION_LIMIT, beyond_limits
from surrogate.answer import COVERED
from surrogate.build import AnyTable

_LEAVES = (
    "the estimate leaves what tables may hold, "
    f"{np.degrees(ROTATION_LIMIT):g} degrees and {TRANSLATION_LIMIT:g} m, and is not given"
)


def also(reason: str, more: str) -> str:
    """Join two reasons, of which either may be empty."""
    return f"{reason}; {more}" if reason and more else reason or more


def explain_estimate(surrogate: AnyTable, wrench: tuple[float, ...], outcome: Outcome) -> None:
    """Name all loads beyond the range, and take an estimate away that no table could hold.

    Parameters
    ----------
    wrench : tuple of 6 floats, N and N·m
    """
    asked = np.array(wrench)
    if not surrogate.load_range.holds(asked[None])[0]:
        # Where the compliance is known, the range is the one reason there is, told of one load.
        own = "" if surrogate.linear and surrogate.fit.complete else outcome.reason
        why = why_beyond(surrogate.load_range, asked)
        outcome.reason = also(f"outside the load range: {why}", own)
    if outcome.displacement is None:
        return
    estimate = np.array([outcome.displacement], dtype=float)  # NaN where nothing is known
    if beyond_limits(estimate)[0]:
        outcome.displacement = outcome.error = outcome.source = None
        outcome.reason = also(outcome.reason, _LEAVES)


def drop_estimates(outcome: BatchOutcome) -> None:
    """Take the estimates away that no table could hold; NaN stands in their place."""
    gone = (outcome.coverage != COVERED) & beyond_limits(outcome.displacements)
    outcome.displacements[gone] = outcome.errors[gone] = np.nan
