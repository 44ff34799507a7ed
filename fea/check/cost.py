"""Time and memory of a solve, from the order of elimination alone.

The factorisation's operations and the numbers it holds follow exactly from the tree of nested
substructures (`fea.linalg.nested_dissection`): a front that eliminates m of m + b unknowns takes
m^3/3 + m^2 b + m b^2 multiply-adds and holds m^2/2 + m b numbers. Time and memory of the solver's
process are fitted to those, to the cells that are ordered and to the entries of their matrices, on
the shipped components, finer plates and STEP parts (tet10) of 3,400 to 111,000 unknowns, one core
of a server:

    work [s]           = 7.2e-8 x entries + 1e-5 x cells x log2(cells) + operations / 19e9
    linear solve       = 0.04 + work
    nonlinear solve    = 0.04 + 2.5 work (3 to 6 iterations; up to 20 by load and part),
                         5.0 work where cells project their volumetric strain
    memory             = 100e6 + 9 x numbers + 8 x entries, nonlinear solves too (one factor at a
                         time: 0.91 to 1.15 of the peaks of nine, 140 to 590 MB)

`make bench NAME=check` prints these against time and memory of a solve: within 1.5 on a like
machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.pressure_projection import NEARLY_INCOMPRESSIBLE
from wrenchbook.fea.linalg.nested_dissection import dissect

_MAX_CELLS = 100_000
"""Beyond this many cells the operations are guessed from the unknowns, as of a cube."""

_NONLINEAR = 2.5  # times the work of a linear solve
_PROJECTED = 2.0  # times that where pressure is a separate unknown: more, and larger, matrices


def estimate(component: ComponentModel) -> dict[str, Any]:
    """Return the estimated seconds and bytes of one solve.

    Result: ``unknowns`` (without fixed nodes), ``linear_seconds``, ``nonlinear_seconds``,
    ``memory_bytes`` and ``basis``, a sentence.
    """
    mesh = component.whole
    free = np.ones(len(mesh.points), dtype=bool)
    free[component.fixed_nodes] = False
    unknowns = 3 * int(free.sum())
    entries = sum(len(block) * (3 * block.nodes.shape[1]) ** 2 for block in mesh.blocks)
    if sum(len(block) for block in mesh.blocks) <= _MAX_CELLS:
        cells = [nodes for block in mesh.blocks for nodes in block.nodes]
        centres = np.concatenate([mesh.points[block.nodes].mean(axis=1) for block in mesh.blocks])
        operations = numbers = 0.0
        for part in dissect(cells, centres, free).substructures:
            m, b = float(part.eliminated), float(part.boundary.size)
            operations += m**3 / 3 + m * m * b + m * b * b
            numbers += m * m / 2 + m * b
    else:
        operations, numbers = 37e9 * (unknowns / 34611) ** 2, 28e6 * (unknowns / 34611) ** (4 / 3)
    count = sum(len(block) for block in mesh.blocks)
    work = 7.2e-8 * entries + 1e-5 * count * np.log2(count + 1) + operations / 19e9
    work *= 2 if component.bolts else 1  # they are tightened by a factor of its own
    # Some cells take the pressure as a separate unknown.
    kinds = {"hex20", "hex27"} & set(mesh.cell_counts)
    ratios = [
        material.poisson_ratio for material in component.materials if material.law != "orthotropic"
    ]
    projects = kinds and any(np.max(ratio) > NEARLY_INCOMPRESSIBLE for ratio in ratios)
    times = _NONLINEAR * (_PROJECTED if projects else 1.0)
    memory = 100e6 + 9 * numbers + 8 * entries
    return {
        "unknowns": unknowns,
        "linear_seconds": float(f"{0.04 + work:.2g}"),
        "nonlinear_seconds": float(f"{0.04 + times * work:.2g}"),
        "memory_bytes": int(float(f"{memory:.3g}")),
        "basis": "an estimate from the order of elimination, within 1.5 on a like machine",
    }
