"""Error of a linear component: nonlinear solves at a corner of its range, and buckling.

The answers of a linear component are the first term of a series in the wrench; what is left out
begins with the square. So its size at the corner where the interface turns most, taken from a
nonlinear solve, gives it elsewhere: bar(w) = bar(corner) s(w)^2 with s the largest load over its
range. The wrench opposite is solved too, since what pulls stiffens and what pushes buckles.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from wrenchbook.fea.coupling.coupling import PER_INTERFACE
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.linear import LinearResponse
from wrenchbook.fea.spec.schema import DeclaredRange

Array = np.ndarray

_PARTS = (1.0, 0.5, 0.25)
"""Of the largest wrench to be tried, in turn: a smaller one shows as much where a larger fails."""

_STEEP = 1.25
"""Buckling factor below which the corner itself is not tried: half the buckling load is."""

_SAFETY = 1.5
"""On the largest of two corners, for the 62 others: measured on boxes, brackets and the bar."""


@dataclass(frozen=True, eq=False)
class BeyondLinear:
    """How far a linear component's answers are from nonlinear ones."""

    # Shape (6 i,), m and rad: at a load as large as its range, growing with the load's square; NaN
    # where no nonlinear solve gave an answer.
    deviation: Array
    # The part of a corner's wrench at which the component buckles or snaps through, at or below 10;
    # None beyond that. It is that of linear buckling (`fea.solver.buckling`), or where a nonlinear
    # solve ended if that is less.
    buckling: float | None
    why: str = ""  # what kept a nonlinear solve from an answer; often empty


_MOST_REPORTED = 10.0  # a factor beyond which its continuation shows nothing


def beyond_linear(solver: Solver, loads: DeclaredRange) -> BeyondLinear:
    """Solve a linear component nonlinearly at the corners of its range where it moves most.

    A range of too many loads has no corners: `DeclaredRange.corners` raises a ValueError.

    solver: of the component, on any mesh of it.
    loads: the range of its inputs, from where these have no effect.
    """
    compliance = solver.linear.compliance
    other = copy(solver)  # shares the equations and the factor of the undeformed part
    other.component = replace(
        solver.component, analysis=replace(solver.component.analysis, nonlinear=True)
    )
    deviation, why = np.full(len(compliance), np.nan), ""
    # The corner that turns, or else moves, the interface most, and its opposite.
    corners = loads.corners()
    moved = (corners @ compliance.T).reshape(len(corners), -1, PER_INTERFACE)
    size = np.linalg.norm(moved[:, :, 3:], axis=2).max(axis=1)
    if not size.max() > 0:
        size = np.linalg.norm(moved[:, :, :3], axis=2).max(axis=1)
    most = int(size.argmax())
    corners, zero = [corners[most], corners[len(corners) - 1 - most]], solver.component.at_rest
    factors = list(solver.buckling(corners[0] + zero))
    if not np.allclose(corners[1], -corners[0]):
        factors[1] = solver.buckling(corners[1] + zero)[0]
    for corner, factor in zip(corners, tuple(factors), strict=True):
        answer = _Corner(other, solver.linear, corner, factor)
        deviation = np.fmax(deviation, answer.deviation)
        factors += answer.factors
        why = why or answer.why
    lowest = min(factors, default=np.inf)
    return BeyondLinear(
        _SAFETY * deviation, float(lowest) if lowest <= _MOST_REPORTED else None, why
    )


class _Corner:
    """The nonlinear answer at one corner of the range, or at a part of it."""

    def __init__(
        self, solver: Solver, linear: LinearResponse, wrench: Array, buckling: float
    ) -> None:
        self.deviation = np.full(len(linear.compliance), np.nan)
        self.factors: list[float] = []
        self.why = ""
        most = 1.0
        if buckling < _STEEP:
            most, self.why = 0.5 * buckling, f"it buckles at {buckling:.3g} of one"
        for part in (most * part for part in _PARTS):
            try:
                solution = solver.solve(part * wrench + solver.component.at_rest)
            except SolveFailed as failure:
                self.why = self.why or failure.message
                if failure.load_factor is not None:
                    self.factors.append(part * failure.load_factor)
                continue
            expected = linear.compliance @ (part * wrench) + linear.sag_displacement
            missed = np.abs(solution.displacement - expected) / part**2
            self.deviation = np.repeat(missed.reshape(-1, 3).max(axis=1), 3)
            return
