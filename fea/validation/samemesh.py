"""What the cases of "same mesh as CalculiX" have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.validation import calculix
from wrenchbook.fea.validation.finding import Finding

Array = np.ndarray

LINEAR, NONLINEAR = 1e-5, 1e-4
"""Relative difference allowed in each of the six components."""

_SOURCE = "CalculiX ccx, tolerance 1e-7"


def same_mesh(
    name: str, part: ComponentModel, wrench: Sequence[float], *, nonlinear: bool
) -> Iterator[Finding]:
    """Compare one solve on one mesh: the largest relative difference of the six components."""
    part = replace(part, analysis=replace(part.analysis, nonlinear=nonlinear))
    kind = "nonlinear" if nonlinear else "linear"
    quantity = f"{name}, {part.coupling}, {kind}: worst of six components, relative"
    if not calculix.installed():
        yield Finding(quantity, _SOURCE, missing=calculix.ABSENT)
        return
    found = Solver(part).solve(wrench).displacement
    if part.coupling == "rigid":
        reply = calculix.solve_rigid(part, wrench, found[3:] if nonlinear else None)
    else:
        reply = calculix.solve_distributed(part, wrench)
    tolerance = NONLINEAR if nonlinear else LINEAR
    gap = worst_gap(found, reply.displacement)
    yield Finding(quantity, _SOURCE, 0.0, gap, tolerance, "absolute")


def worst_gap(found: Array, expected: Array) -> float:
    """Return the largest relative difference of two displacements, shape (6,), m and rad.

    Both are exactly zero in what a guide holds.
    """
    zero = (found == 0) & (expected == 0)
    scale = np.where(zero, 1.0, np.abs(expected))
    return float(np.abs((found - expected) / scale).max())
