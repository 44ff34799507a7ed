"""The component on a second mesh, coarser or finer, to learn what the first one lacks."""

from __future__ import annotations

from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.mesh.split import halved
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError

COARSER = 0.5
"""Cells along each direction of the second mesh, over those of the first.

A linear solve of it takes a sixth of the first's (generators) to two thirds (STEP parts whose own
edges keep cells small). Its error is two to four times the
first's (first- to second-order convergence of the displacements, by the corners where loads and
supports end), so that what the two differ by holds what the first still lacks.
"""

_SMALLER = 0.75
"""Of the first mesh's nodes: one that has more tells nothing, its cells are the geometry's own."""


def coarser(solver: Solver) -> Solver | None:
    """Return the component on a coarser mesh; None if none can be made, or it is no smaller.

    Mesh files have none: only their author can mesh anew. Nor has a mesh of single cells, or one
    whose cells the geometry's own edges keep small.
    """
    bundle = solver.component.bundle
    if bundle is None:
        return None
    other = refined(bundle, COARSER)
    if other is None:
        return None
    try:
        found = Solver(build(other))
        if len(found.component.mesh.points) > _SMALLER * len(solver.component.mesh.points):
            return None
        _ = found.linear
    except (BundleError, SolveFailed):
        return None  # too coarse for the shape, or for reduced integration to hold it
    return found


FINER_UNKNOWNS = 30_000
"""Of a finer mesh that an estimate may solve unasked: about a second."""


def finer(solver: Solver, most: int | None = None, factor: float = 2.0) -> Solver | None:
    """Return the component with smaller cells; None if that has over `most` unknowns.

    Generators and geometries make the mesh anew with cells `factor` times as small; a mesh file's
    cells are halved, its edges kept as they are.

    Raises
    ------
    BundleError
        If the mesh fails.
    """
    component = solver.component
    bundle, limit = component.bundle, float("inf") if most is None else most
    if bundle is None or bundle.mesh is None:
        return None
    again = refined(bundle, factor)
    # In a plane alone, as thin parts have it, unknowns grow by the square.
    if (factor if again else 2.0) ** 2 * component.mesh.unknowns > limit:
        return None
    found = build(again) if again is not None else build(bundle, halved(component.mesh))
    return Solver(found) if found.mesh.unknowns <= limit else None
