"""Time and memory of a solve, from the order of elimination alone.

The factorisation's operations and the numbers it holds follow exactly from the tree of nested
substructures (`fea.linalg.nested_dissection`). Cells at ties and at bolts' cuts count with all
nodes that move them. Time and memory of the solver's process are fitted to those, to the cells that
are ordered and to the entries of their matrices, on the shipped components, plates, blocks (hex20,
tet10) and tied slabs of 5,000 to 75,000 unknowns, one core of a server. The memory of nonlinear
solves is the same, one factor at a time: 0.91 to 1.15 of the peaks of nine, 140 to 590 MB.

`make bench NAME=check` prints these against time and memory of a solve: within 1.5 on a like
machine.
"""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from wrenchbook.fea.assembly.body import SINGLE_NUMBERS
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.pressure_projection import projects
from wrenchbook.fea.linalg.nested_dissection import dissect

# Fitted to the solves of the module's docstring, on one core.
_START_SECONDS = 0.04  # s of any solve
_ENTRY_SECONDS = 4.3e-8  # s to assemble an entry of a cell's matrix
_ORDER_SECONDS = 2.3e-6  # s to order a cell in each of log2(cells) bisections
_OPERATIONS_PER_SECOND = 22e9  # multiply-adds of the factorisation, in double precision
_PROCESS_BYTES = 100e6  # memory of a process without a mesh
# Memory of a number in the factor, in double precision: the number itself takes 8.
_NUMBER_BYTES = 9
_ENTRY_BYTES = 8  # memory of an entry of a cell's matrix

_SINGLE_PRECISION = 0.5
"""Bytes and time of a linear solve with a factor above `SINGLE_NUMBERS`, over those in double
precision."""
_NONLINEAR = 2.5  # ratio to a linear solve's work: 3 to 6 iterations; up to 20 by load and part
_PROJECTED = 2.0  # further factor if pressure is a separate unknown: more, and larger, matrices


class Cost(TypedDict):
    """Time and memory of one solve."""

    unknowns: int  # without those of nodes that are fixed or dependent
    linear_seconds: float
    nonlinear_seconds: float
    memory_bytes: int
    basis: str  # a sentence on the basis of the estimate


def estimate(component: ComponentModel) -> Cost:
    """Return the estimated cost of one solve."""
    points, dependents = component.mesh.points, component.mesh.dependents
    free = np.ones(len(points), dtype=bool)  # nodes with unknowns
    free[component.fixed_nodes] = False
    for attached in (*component.interfaces, *component.frames):
        if attached.coupling == "rigid":
            free[attached.section.node_ids] = False
    if dependents is not None:
        free[dependents.nodes] = False
    groups = _nodes_of_cells(component)
    count = sum(len(nodes) for nodes in groups)
    entries = sum(len(nodes) * (3 * nodes.shape[1]) ** 2 for nodes in groups)

    # A front that eliminates m of m + b unknowns takes m^3/3 + m^2 b + m b^2 multiply-adds.
    cells = [nodes for group in groups for nodes in group]
    centres = np.concatenate([points[group].mean(axis=1) for group in groups])
    dissection = dissect(cells, centres, free)
    numbers, operations = dissection.numbers, 0.0
    for part in dissection.substructures:
        m, b = float(part.eliminated), float(part.boundary.size)
        operations += m**3 / 3 + m * m * b + m * b * b

    assembly = _ENTRY_SECONDS * entries + _ORDER_SECONDS * count * np.log2(count + 1)
    factorisation = operations / _OPERATIONS_PER_SECOND
    precision = _SINGLE_PRECISION if numbers > SINGLE_NUMBERS else 1.0
    factors = 2 if component.bolts else 1  # a second factor while bolts are tightened
    linear = factors * (assembly + precision * factorisation)
    poisson = np.array([material.poisson_ratio for material in component.materials])
    pairs = zip(component.mesh.blocks, component.material_of_cells, strict=True)
    is_projected = any(projects(block, poisson[materials]).any() for block, materials in pairs)
    times = _NONLINEAR * (_PROJECTED if is_projected else 1.0)
    nonlinear = times * (factors * (assembly + factorisation))
    if component.analysis.nonlinear:
        precision = 1.0
    memory = _PROCESS_BYTES + _NUMBER_BYTES * precision * numbers + _ENTRY_BYTES * entries
    return {
        "unknowns": 3 * int(free.sum()),
        "linear_seconds": float(f"{_START_SECONDS + linear:.2g}"),
        "nonlinear_seconds": float(f"{_START_SECONDS + nonlinear:.2g}"),
        "memory_bytes": int(float(f"{memory:.3g}")),
        "basis": "an estimate from the order of elimination, within 1.5 on a like machine",
    }


def _nodes_of_cells(component: ComponentModel) -> list[np.ndarray]:
    """Return the nodes that move each cell, in groups of equal number, each of shape (m, s)."""
    blocks = [block.nodes for block in component.mesh.blocks]
    dependents = component.mesh.dependents
    if dependents is None:
        return blocks
    plain, tied = [], []
    for nodes in blocks:
        has_dependents = dependents.among(nodes)
        plain.append(nodes[~has_dependents])
        if has_dependents.any():
            outer, _ = dependents.outer(nodes[has_dependents])
            tied.append(outer)
    return plain + tied
