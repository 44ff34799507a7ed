"""A finding: one probable systematic error of measured rows, with the rows that show it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

Cause = Literal[
    "sentinel", "outlier", "sign", "unit", "lever", "asymmetry", "drift", "hysteresis", "clock"
]
MOST_ROWS = 500  # of a finding: a page's list; `count` has their number


@dataclass(frozen=True)
class RigFinding:
    """One probable systematic error.

    Attributes
    ----------
    cause : str
        "sentinel", "outlier", "sign", "unit", "lever", "asymmetry", "drift", "hysteresis" or
        "clock".
    message : str
        What is wrong, by how much, and what to do.
    rows : tuple of int
        Numbers (`seq`) of the rows to withdraw, worst first; empty where all rows are concerned.
    numbers : dict
        The figures of the message, SI.
    """

    cause: Cause
    message: str
    rows: tuple[int, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)

    def body(self) -> dict[str, Any]:
        """Return the finding as JSON-able values."""
        return {
            "cause": self.cause,
            "message": self.message,
            "rows": list(self.rows[:MOST_ROWS]),
            "count": len(self.rows),
            **self.numbers,
        }
