"""Tables of a few lines that answer as `Table` does, and made-up servers."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

from wrenchbook.service.client import Displacement

TOLERANCE = {"translation": 1e-6, "rotation": 1e-6}
# A bar of steel, 20 x 20 mm, 1 m long, along x: u = F L^3 / (3 E I), and so on; m/N to rad/(N·m).
LENGTH, BENDING, AXIAL, TORSION = 1.0, 210e9 * 0.02**4 / 12, 210e9 * 0.02**2, 80e9 * 2.25e-8


def bar_compliance() -> np.ndarray:
    """du/dw of a clamped bar along x at its end, (6, 6)."""
    C = np.zeros((6, 6))
    C[0, 0], C[3, 3] = LENGTH / AXIAL, LENGTH / TORSION
    for out, turn, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        C[out, out] = LENGTH**3 / (3 * BENDING)
        C[turn, turn] = LENGTH / BENDING
        C[out, turn] = C[turn, out] = sign * LENGTH**2 / (2 * BENDING)
    return C


def answer(vector, wrench=None, coverage="covered", derivative=None, reason="") -> Displacement:
    """An answer with error bars of 1 µm and 1 µrad."""
    body = {
        "component": "plate",
        "translation": None if vector is None else list(vector[:3]),
        "rotation": None if vector is None else list(vector[3:]),
        "error": {"translation": [1e-6] * 3, "rotation": [1e-6] * 3},
        "coverage": coverage,
        "derivative": derivative,
        "reason": reason,
    }
    return Displacement.read(body, np.zeros(6) if wrench is None else wrench)


class LinearTable:
    """Answers the compliance times the wrench, and counts how often it was asked."""

    name = "plate"

    def __init__(self, compliance=None, tolerance=TOLERANCE) -> None:
        self.compliance = bar_compliance() if compliance is None else np.asarray(compliance)
        self.tolerance = tolerance
        self.asked: list[np.ndarray] = []

    def answer(self, wrench, *, tolerance=None, method=None, derivatives=False) -> Displacement:
        self.asked.append(np.array(wrench))
        return answer(
            self.compliance @ wrench, wrench, derivative=self.compliance if derivatives else None
        )


class ScriptedTable(LinearTable):
    """Answers what it is told to, in turn."""

    def __init__(self, *answers) -> None:
        super().__init__()
        self._answers = list(answers)

    def answer(self, wrench, **_) -> Displacement:
        reported = self._answers.pop(0)
        if isinstance(reported, Exception):
            raise reported
        return reported


def client_with(**calls: Callable) -> SimpleNamespace:
    """A server's client with these calls, and a component that has finite elements."""
    reported = {"has_fea": True, "tolerance": TOLERANCE}
    calls = {"component": lambda _: reported, "displacement": None, "solve": None} | calls
    return SimpleNamespace(**calls)
