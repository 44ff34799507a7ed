"""How well the answers of a run were covered: counted all, warned about once."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..replies import Displacement
from .errors import MountWarning

Vector = NDArray[np.float64]

_MEANS = {
    "thin": "the table is too thin here: answers are estimates, with wider error bars",
    "outside": "the wrench is outside the table or the load range: answers are flagged estimates",
    "unknown": "the table cannot answer: the pose of before is kept",
}


@dataclass(frozen=True)
class First:
    """The first answer of a kind.

    Parameters
    ----------
    step : int
        Number of the answer, from 1.
    wrench : numpy.ndarray
        Shape (6,), N and N·m.
    reason : str
        Why it is not covered.
    """

    step: int
    wrench: Vector = field(repr=False)
    reason: str


@dataclass
class Coverage:
    """How many answers of a run were covered, thin, outside, or unknown.

    Attributes
    ----------
    covered, thin, outside, unknown : int
        ``unknown``: the table had nothing to say, and the pose of before was kept.
    first : dict of str to First
        The first answer of each kind but covered.
    widest : numpy.ndarray
        Shape (6,), m and rad: the widest error bar of each output so far.
    """

    covered: int = 0
    thin: int = 0
    outside: int = 0
    unknown: int = 0
    first: dict[str, First] = field(default_factory=dict)
    widest: Vector = field(default_factory=lambda: np.zeros(6))

    @property
    def answers(self) -> int:
        """How many answers there were."""
        return self.covered + self.thin + self.outside + self.unknown

    def add(self, answer: Displacement, *, known: bool) -> None:
        """Count an answer; warn at the first of its kind."""
        kind = answer.coverage if known else "unknown"
        setattr(self, kind, getattr(self, kind) + 1)
        bars = answer.error_vector
        if bars is not None:
            np.fmax(self.widest, bars, out=self.widest)  # NaN where a table does not measure
        if kind != "covered" and kind not in self.first:
            self.first[kind] = First(self.answers, answer.wrench, answer.reason)
            reason = f" ({answer.reason})" if answer.reason else ""
            warnings.warn(
                f"{answer.component}, answer {self.answers}: {_MEANS[kind]}{reason}. This is said "
                "once; the mount's coverage counts them",
                MountWarning,
                stacklevel=4,  # the caller of the mount's step
            )

    def __str__(self) -> str:
        lines = [
            f"{self.answers} answers: {self.covered} covered, {self.thin} thin, "
            f"{self.outside} outside, {self.unknown} unknown"
        ]
        lines += [
            f"  first {kind}: answer {first.step}, {first.reason}"
            for kind, first in self.first.items()
        ]
        return "\n".join(lines)
