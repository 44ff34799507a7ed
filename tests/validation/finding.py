"""What a validation case claims, and the registry of cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

Comparison = Literal["relative", "absolute", "at least"]
Check = Callable[[], "Iterator[Finding]"]

TOPICS = ("patch", "support", "bar", "plate", "curved_beam", "spring", "material", "vibration")
"""What can be validated, in the order it is."""


@dataclass(frozen=True)
class Finding:
    """One quantity against its reference.

    Attributes
    ----------
    quantity
        What is claimed, with its unit.
    source
        Where the reference comes from.
    reference, computed
        The two numbers, in the unit of `quantity`; NaN where a case did not run.
    tolerance
        The most that `error` may be; None if it is reported only.
    comparison
        How `error` is measured: relative to the reference, as it is, or only what is missing.
    missing
        Why the case did not run; empty if it did.
    """

    quantity: str
    source: str
    reference: float = float("nan")
    computed: float = float("nan")
    tolerance: float | None = None
    comparison: Comparison = "relative"
    missing: str = ""

    @property
    def error(self) -> float:
        """The distance from the reference, by `comparison`."""
        if self.comparison == "relative":
            return abs(self.computed / self.reference - 1.0)
        if self.comparison == "absolute":
            return abs(self.computed - self.reference)
        return max(0.0, self.reference - self.computed)

    @property
    def verdict(self) -> str:
        """``pass``, ``FAIL``, ``reported`` (no tolerance is claimed) or ``not run``."""
        if self.missing:
            return "not run"
        if self.tolerance is None:
            return "reported"
        return "pass" if self.error <= self.tolerance else "FAIL"


@dataclass(frozen=True)
class Case:
    """A function that yields findings, its topic, and its title (the docstring's first line)."""

    topic: str
    title: str
    check: Check


CASES: list[Case] = []
"""All cases, in the order of their definition."""


def case(topic: str) -> Callable[[Check], Check]:
    """Return the decorator that adds a function to `CASES` under one of `TOPICS`."""
    if topic not in TOPICS:
        raise ValueError(f"no topic {topic!r}; there are {', '.join(TOPICS)}")

    def add(check: Check) -> Check:
        title = (check.__doc__ or "").strip().splitlines()[0].rstrip(".")
        CASES.append(Case(topic, title, check))
        return check

    return add
