"""What each part of the reproduction gives: findings, numbers, plots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.validation.finding import Finding

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]
ProgressCallback = Callable[[float, str], None]
"""Called with the fraction done of a part, 0 to 1, and what is being done."""

LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")  # as the paper writes them
PAPER = "SIMULTECH 2017"
LEVELS: tuple[str, ...] = ("closed form", "finite elements", "MuJoCo and service")


@dataclass(frozen=True)
class Effort:
    """How much is computed."""

    spring_rows: tuple[float, ...]  # axial loads, N, that are recorded and solved for the table
    spring_loads: tuple[float, ...]  # axial loads, N, at which the loop runs
    tip_loads: tuple[float, ...]  # N, on the bar
    arm_seconds: float  # s, of the arm's trajectory
    plates: tuple[str, ...]  # the components under the arm
    arm_solves: int  # of a recording, at most, a plate
    arm_checks: int  # moments that are solved directly, a plate


WHOLE = Effort(
    spring_rows=tuple(float(load) for load in range(11)),
    spring_loads=tuple(0.5 * step for step in range(21)),
    tip_loads=tuple(10.0 * step for step in range(11)),
    arm_seconds=4.0,
    plates=("plate", "plate_thin"),
    arm_solves=10,
    arm_checks=12,
)
QUICK = Effort(
    spring_rows=(0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0),
    spring_loads=(0.0, 0.5, 1.0, 1.5, 2.0, 4.0, 6.0, 8.0, 10.0),
    tip_loads=(0.0, 50.0, 100.0),
    arm_seconds=1.0,
    plates=("plate_thin",),
    arm_solves=4,
    arm_checks=4,
)


@dataclass(frozen=True)
class Curve:
    """One curve of a plot."""

    name: str
    x: list[float]
    y: list[float]
    style: str = "line"  # "line", "dash", "points" or "crosses"

    @classmethod
    def of(cls, name: str, x: Any, y: Any, style: str = "line") -> Curve:
        """Return a curve from two arrays."""
        return cls(name, np.asarray(x).tolist(), np.asarray(y).tolist(), style)


@dataclass(frozen=True)
class Plot:
    """A plot: what it shows, its axes with their units, its curves."""

    title: str
    x: str
    y: str
    curves: tuple[Curve, ...]


@dataclass
class PaperPart:
    """One part of the reproduction."""

    title: str
    note: str  # how the part is computed and read
    findings: list[Finding] = field(default_factory=list)  # those with a tolerance are bands
    numbers: dict[str, Any] = field(default_factory=dict)  # of plots and findings; JSON-able
    plots: list[Plot] = field(default_factory=list)

    def as_body(self) -> dict[str, Any]:
        """Return it as JSON-able values."""
        return {
            "title": self.title,
            "note": self.note,
            "findings": [
                asdict(finding) | {"error": finding.error, "verdict": finding.verdict}
                for finding in self.findings
            ],
            "numbers": self.numbers,
            "plots": [asdict(plot) for plot in self.plots],
        }


def worst_relative(computed: Vector, expected: Vector) -> float:
    """Return the largest relative error of numbers (n,); those expected to be 0 do not count."""
    known = expected != 0.0
    if not known.any():
        raise ValueError(
            f"all {len(expected)} expected numbers are 0: no relative error is defined"
        )
    return float(np.abs(computed[known] / expected[known] - 1.0).max())
