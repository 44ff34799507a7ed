"""Time and memory of a solve, from the order of elimination alone.

The factorisation's operations and the numbers it holds follow exactly from the tree of nested
substructures (`fea.linalg.nested_dissection`): a front that eliminates m of m + b unknowns takes
m^3/3 + m^2 b + m b^2 multiply-adds and holds m^2/2 + m b numbers. Cells at ties and at bolts' cuts
count with all nodes that move them. Time and memory of the solver's process are fitted to those, to
the cells that are ordered and to the entries of their matrices, on the shipped components, plates,
blocks (hex20, tet10) and tied slabs of 5,000 to 75,000 unknowns, one core of a server:

    work [s]           = 4.3e-8 x entries + 2.3e-6 x cells x log2(cells) + operations / 22e9
    linear solve       = 0.04 + work
    nonlinear solve    = 0.04 + 2.5 work (3 to 6 iterations; up to 20 by load and part),
                         5.0 work where cells project their volumetric strain
    memory             = 100e6 + 9 x numbers + 8 x entries, nonlinear solves too (one factor at a
                         time: 0.91 to 1.15 of the peaks of nine, 140 to 590 MB)

Of over 30 million numbers a linear solve's factor is in single precision, with 4.5 bytes each and
twice the operations a second.

`make bench NAME=check` prints these against time and memory of a solve: within 1.5 on a like
machine.
"""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from wrenchbook.fea.assembly.body import SINGLE_NUMBERS
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.pressure_projection import NEARLY_INCOMPRESSIBLE
from wrenchbook.fea.linalg.nested_dissection import dissect

_NONLINEAR = 2.5  # times the work of a linear solve
_PROJECTED = 2.0  # times that where pressure is a separate unknown: more, and larger, matrices


class Cost(TypedDict):
    """Time and memory of one solve."""

    unknowns: int  # without nodes that are fixed or follow others
    linear_seconds: float
    nonlinear_seconds: float
    memory_bytes: int
    basis: str  # a sentence


def estimate(component: ComponentModel) -> Cost:
    """Return the estimated cost of one solve."""
    mesh, dependents = component.mesh, component.mesh.dependents
    free = np.ones(len(mesh.points), dtype=bool)
    free[component.fixed_nodes] = False
    for attached in (*component.interfaces, *component.frames):
        if attached.coupling == "rigid":
            free[attached.section.node_ids] = False
    groups = [block.nodes for block in mesh.blocks]  # the nodes that move each cell, (m, s)
    if dependents is not None:
        free[dependents.nodes] = False
        tied = [dependents.among(nodes) for nodes in groups]
        pairs = list(zip(groups, tied, strict=True))
        moving = [dependents.outer(nodes[at])[0] for nodes, at in pairs if at.any()]
        groups = [nodes[~at] for nodes, at in pairs] + moving
    unknowns = 3 * int(free.sum())
    entries = sum(len(nodes) * (3 * nodes.shape[1]) ** 2 for nodes in groups)
    cells = [nodes for group in groups for nodes in group]
    centres = np.concatenate([mesh.points[group].mean(axis=1) for group in groups])
    operations = numbers = 0.0
    for part in dissect(cells, centres, free).substructures:
        m, b = float(part.eliminated), float(part.boundary.size)
        operations += m**3 / 3 + m * m * b + m * b * b
        numbers += m * m / 2 + m * b
    assembly = 4.3e-8 * entries + 2.3e-6 * len(cells) * np.log2(len(cells) + 1)
    precision = 0.5 if numbers > SINGLE_NUMBERS else 1.0  # of a linear solve, relative to double
    factors = 2 if component.bolts else 1  # one more while bolts are tightened
    linear, work = (factors * (assembly + p * operations / 22e9) for p in (precision, 1.0))
    # Some cells take the pressure as a separate unknown.
    kinds = {"hex20", "hex27"} & set(mesh.cell_counts)
    ratios = [
        material.poisson_ratio for material in component.materials if material.law != "orthotropic"
    ]
    projects = kinds and any(np.max(ratio) > NEARLY_INCOMPRESSIBLE for ratio in ratios)
    times = _NONLINEAR * (_PROJECTED if projects else 1.0)
    precision = 1.0 if component.analysis.nonlinear else precision
    memory = 100e6 + 9 * precision * numbers + 8 * entries
    return {
        "unknowns": unknowns,
        "linear_seconds": float(f"{0.04 + linear:.2g}"),
        "nonlinear_seconds": float(f"{0.04 + times * work:.2g}"),
        "memory_bytes": int(float(f"{memory:.3g}")),
        "basis": "an estimate from the order of elimination, within 1.5 on a like machine",
    }
