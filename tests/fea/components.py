"""Components made of boxes, for tests."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tests.validation.clamped import attached, clamped
from wrenchbook.fea.assembly.blocks import filled_cells
from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.schema import Analysis


def body_of(mesh, free, young=1e9, poisson=0.3, integration="reduced"):
    """Fill a mesh with materials by Young's modulus, one or for each block an array of a cell."""
    if np.isscalar(young):
        young = [np.full(len(block), young) for block in mesh.blocks]
    materials = [Material("all", float(item), poisson) for item in np.concatenate(young)]
    counts = np.cumsum([0, *(len(block) for block in mesh.blocks)])
    numbers = [np.arange(*ends) for ends in pairwise(counts)]
    return ElasticBody(mesh, filled_cells(mesh, materials, numbers, integration), free)


def component(
    mesh,
    *,
    fixed="z0",
    section="z1",
    young=210e9,
    poisson=0.3,
    coupling="rigid",
    point=None,
    axes=None,
    locked=(),
    nonlinear=False,
    integration="reduced",
):
    """Clamp one facet group of a mesh and attach the interface to another."""
    part = clamped(
        mesh, fixed, section, (young, poisson), coupling=coupling, point=point, axes=axes
    )
    analysis = Analysis(nonlinear=nonlinear, integration=integration)
    return replace(attached(part, locked=tuple(locked)), analysis=analysis)
