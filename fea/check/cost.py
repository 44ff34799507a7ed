"""What a solve will take, from the order of elimination alone.

The factorisation's operations and the numbers it holds follow exactly from the tree of nested
substructures (`fea.linalg.nested_dissection`): a front that eliminates m of m + b unknowns takes
m^3/3 + m^2 b + m b^2 multiply-adds and holds m (m + b) numbers. Time and memory are fitted to
those on the shipped components and on cubes of up to 35,000 unknowns, one core of a server:

    one factorisation [s] = 0.1 + 1.5e-7 x (entries of the cell matrices) + operations / 5e9
    linear solve          = 1.2 factorisations
    nonlinear solve       = 5 factorisations (3 to 20 by load and part)
    memory [bytes]        = 150e6 + 30 x (numbers in the factor + entries of the cell matrices)

It is an estimate: expect it to be within a factor of two on a like machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fea.component import Component
from fea.linalg.nested_dissection import dissect

_MOST_CELLS = 100_000
"""Beyond this many cells the operations are guessed from the unknowns, as of a cube."""

NONLINEAR_FACTORS = 5.0


def estimate(component: Component) -> dict[str, Any]:
    """Return the estimated seconds and bytes of one solve.

    Returns
    -------
    dict
        ``unknowns`` (without fixed nodes), ``linear_seconds``, ``nonlinear_seconds``,
        ``memory_bytes`` and ``basis``, a sentence.
    """
    mesh = component.mesh
    free = np.ones(len(mesh.points), dtype=bool)
    free[component.fixed_nodes] = False
    unknowns = 3 * int(free.sum())
    entries = sum(len(block) * (3 * block.nodes.shape[1]) ** 2 for block in mesh.blocks)
    if sum(len(block) for block in mesh.blocks) <= _MOST_CELLS:
        operations, numbers = _counted(component, free)
    else:
        operations, numbers = 37e9 * (unknowns / 34611) ** 2, 32e6 * (unknowns / 34611) ** (4 / 3)
    factor = 0.1 + 1.5e-7 * entries + operations / 5e9
    return {
        "unknowns": unknowns,
        "linear_seconds": float(f"{1.2 * factor:.2g}"),
        "nonlinear_seconds": float(f"{NONLINEAR_FACTORS * factor:.2g}"),
        "memory_bytes": int(float(f"{150e6 + 30 * (numbers + entries):.2g}")),
        "basis": "an estimate from the order of elimination, good to a factor of two or so",
    }


def _counted(component: Component, free: np.ndarray) -> tuple[float, float]:
    mesh = component.mesh
    cells = [nodes for block in mesh.blocks for nodes in block.nodes]
    centres = np.concatenate([mesh.points[block.nodes].mean(axis=1) for block in mesh.blocks])
    operations = numbers = 0.0
    for part in dissect(cells, centres, free).substructures:
        m, b = float(part.eliminated), float(part.boundary.size)
        operations += m**3 / 3 + m * m * b + m * b * b
        numbers += m * (m + b)
    return operations, numbers
