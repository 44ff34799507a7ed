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

OUTPUTS = ("ux", "uy", "uz", "rx", "ry", "rz")
LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
PAPER = "SIMULTECH 2017"


@dataclass(frozen=True)
class Effort:
    """How much is computed.

    Attributes
    ----------
    spring_rows, spring_loads : tuple of float
        Axial loads, N, that are recorded and solved for the table, and that the loop is run at.
    tip_loads : tuple of float
        N.
    arm_seconds : float
        Of the arm's trajectory, s.
    plates : tuple of str
        What it stands on.
    arm_solves : int
        That a recording of it may have solved, a plate.
    arm_checks : int
        Moments of it that are solved directly, a plate.
    """

    spring_rows: tuple[float, ...]
    spring_loads: tuple[float, ...]
    tip_loads: tuple[float, ...]
    arm_seconds: float
    plates: tuple[str, ...]
    arm_solves: int
    arm_checks: int


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
    """One curve of a plot; its looks are ``line``, ``points`` or ``both``."""

    name: str
    x: list[float]
    y: list[float]
    style: str = "line"

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
    """One part of the reproduction.

    Attributes
    ----------
    title, note : str
        What it is, and how to read it.
    findings : list of Finding
        Those with a tolerance are bands that must hold.
    numbers : dict
        All that the plots and findings are made of; JSON-able.
    plots : list of Plot
    """

    title: str
    note: str
    findings: list[Finding] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
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


def apart(computed: Vector, expected: Vector) -> float:
    """Return the largest relative error of numbers, dimensionless; those expected to be 0 apart.

    Parameters
    ----------
    computed, expected : numpy.ndarray
        Shape (n,), of one unit such as m or rad.
    """
    known = expected != 0.0
    if not known.any():
        raise ValueError("nothing to compare with")
    return float(np.abs(computed[known] / expected[known] - 1.0).max())
