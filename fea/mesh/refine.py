"""The same component on a coarser or finer mesh, where its mesh can be made again."""

from __future__ import annotations

import math
from dataclasses import replace

from wrenchbook.fea.spec.schema import Bundle, Generator, GeometryFile

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
    if isinstance(mesh, GeometryFile):
        circle = max(3, round(mesh.circle * factor))
        curvature = mesh.curvature and max(3, round(mesh.curvature * factor))
        finer = replace(mesh, size=mesh.size / factor, curvature=curvature)
        object.__setattr__(finer, "circle", circle)  # no key, so no argument
        return replace(bundle, mesh=finer)
    if not isinstance(mesh, Generator):
        return None
    counts = {
        name: max(1, math.floor(mesh.parameters[name] * factor + 0.5))
        for name in _COUNTS[mesh.generator]
    }
    return replace(bundle, mesh=replace(mesh, **counts))
