"""The component on a second mesh, coarser or finer, to learn what the first one lacks."""

from __future__ import annotations

from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.mesh.split import halved
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError

_COARSER = (0.5, 2 / 3)
"""Cells along each direction of the second mesh, over those of the first; the next where one fails.

A linear solve of it takes a sixth of the first's (generators) to a half (STEP parts).
"""


def coarser(solver: Solver) -> Solver | None:
    """Return the component on a coarser mesh, solved; None if none can be made.

    Mesh files have none: only their author can mesh anew. A mesh of single cells has itself.
    """
    bundle = solver.component.bundle
    for factor in _COARSER:
        other = None if bundle is None else refined(bundle, factor)
        if other is None:
            return None
        try:
            second = Solver(build(other))
            _ = second.linear
        except (BundleError, SolveFailed):
            continue  # too coarse for the shape, or for reduced integration to hold it
        return second
    return None


FINER_UNKNOWNS = 30_000
"""Of a finer mesh that an estimate may solve unasked: about a second."""


def finer(solver: Solver, most: int | None = None, factor: float = 2.0) -> Solver | None:
    """Return the component with smaller cells; None if that has over `most` unknowns.

    Generators and geometries make the mesh anew with cells `factor` times as small; a mesh file's
    cells are halved, its edges kept as they are.

    Raises BundleError if the mesh fails.
    """
    component = solver.component
    bundle, limit = component.bundle, float("inf") if most is None else most
    if bundle is None or bundle.mesh is None:
        return None
    again = refined(bundle, factor)
    # In a plane alone, as thin parts have it, unknowns grow by the square.
    if (factor if again else 2.0) ** 2 * component.mesh.unknowns > limit:
        return None
    model = build(again) if again is not None else build(bundle, halved(component.mesh))
    return Solver(model) if model.mesh.unknowns <= limit else None
