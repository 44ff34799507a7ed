"""What is said of an answer that the table does not cover."""

from __future__ import annotations

import numpy as np

from service.answering.queries import BatchOutcome, Outcome
from service.tablefile.limits import ROTATION_LIMIT, TRANSLATION_LIMIT, beyond_limits
from surrogate.answer import COVERED

_LEAVES = (
    "the estimate leaves what tables may hold, "
    f"{np.degrees(ROTATION_LIMIT):g} degrees and {TRANSLATION_LIMIT:g} m, and is not given"
)


def also(reason: str, more: str) -> str:
    """Join two reasons, of which either may be empty."""
    return f"{reason}; {more}" if reason and more else reason or more


def drop_estimate(outcome: Outcome) -> None:
    """Take an estimate away that no table could hold, and say so."""
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
