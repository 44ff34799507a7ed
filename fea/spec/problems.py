"""The mistakes of a component bundle, gathered so that all are reported at once."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

# Control characters, line ends, and marks that change the writing direction: a terminal obeys the
# first, and a page with the last shows another word than the text contains. Surrogates, which stand
# for bytes of a file name that are no UTF-8, cannot be written at all.
STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


@dataclass(frozen=True)
class BundleProblem:
    """One mistake; control characters are written as Python escapes."""

    # The key (``material[0].youngs_modulus``), the line (``line 4``) or the file
    where: str
    message: str  # the mistake and its correction

    def __post_init__(self) -> None:
        for name in ("where", "message"):
            text = STEERING.sub(lambda match: repr(match[0])[1:-1], getattr(self, name))
            object.__setattr__(self, name, text)

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"


class BundleError(ValueError):
    """A component bundle cannot be used; `problems` has every mistake."""

    def __init__(self, problems: Iterable[BundleProblem]) -> None:
        self.problems: list[BundleProblem] = list(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type[BundleError], tuple[list[BundleProblem]]]:
        # The default would make it from the joined text and lose the list.
        return BundleError, (self.problems,)


class MeshFileError(ValueError):
    """A mesh file cannot be used; the message has the cause and the remedy."""


def suggest(word: str, known: Iterable[str]) -> str:
    """Return ``'; did you mean "..."?'`` for the nearest of `known`, or an empty string."""
    # Upper and lower case count as equal, such as RIM and rim.
    lower = {name.lower(): name for name in known}
    near = get_close_matches(word.lower(), list(lower), n=1, cutoff=0.6)
    return f'; did you mean "{lower[near[0]]}"?' if near else ""


def point_text(point: Iterable[float]) -> str:
    """Write a point or a direction with four digits; numbers below 1e-9 are roundoff."""
    return "(" + ", ".join(f"{x if abs(x) >= 1e-9 else 0.0:.4g}" for x in point) + ")"
