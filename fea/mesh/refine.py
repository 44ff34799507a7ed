"""The same component on a coarser or finer mesh, where its mesh can be made again."""

from __future__ import annotations

import math
from dataclasses import replace

from wrenchbook.fea.spec.schema import Bundle

# The counts of cells that a finer mesh multiplies, by generator.
_COUNTS = {
    "bar": ("cells_along", "cells_across"),
    "plate": ("cells", "rings", "corner_cells", "layers"),
    "spring": ("cells_per_turn", "core"),
}


def refined(bundle: Bundle, factor: float) -> Bundle | None:
    """Return `bundle` with cells `factor` times as small along each direction.

    factor: Above 1 finer, below 1 coarser.
    Result: None if the mesh is a file, which only its author can refine. The fingerprint is that of
    the original: what is solved with it must not become a row.
    """
    mesh = bundle.mesh
    if mesh is None:
        return None
    if mesh.geometry is not None:
        meshing = mesh.geometry
        circle = max(3, round(meshing.circle * factor))
        curvature = meshing.curvature and max(3, round(meshing.curvature * factor))
        geometry = replace(meshing, size=meshing.size / factor, circle=circle, curvature=curvature)
        return replace(bundle, mesh=replace(mesh, geometry=geometry))
    if mesh.generator is None or mesh.parameters is None:
        return None
    parameters = dict(mesh.parameters)
    for name in _COUNTS[mesh.generator]:
        parameters[name] = max(1, math.floor(parameters[name] * factor + 0.5))
    return replace(bundle, mesh=replace(mesh, parameters=parameters))
