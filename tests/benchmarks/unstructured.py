"""Parts whose mesh follows no axis, and regular ones beside them, as components."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.fea.geometry import start
from tests.validation.boxes import box
from tests.validation.clamped import attached, clamped, shipped
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.facets import facets_within, outer_surface
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mesh import FacetGroup, Mesh

NAMES = ("flange", "cheese", "box", "plate", "block")


def part_of(name: str, folder: Path) -> ComponentModel:
    """Return a component with a rigid coupling, fixed below and loaded above; linear.

    "plate_thin" is nonlinear; "block15" is a block of 15 cells each way. `folder` keeps the meshes
    of a mesher, so that a solve does not load it.
    """
    if name == "plate":
        part = attached(shipped("plate", cells=10, rings=5), coupling="rigid")
        return replace(part, analysis=replace(part.analysis, nonlinear=False))
    if name == "plate_thin":
        return attached(shipped(name), coupling="rigid")
    if name.startswith("block"):
        count = int(name.removeprefix("block") or 11)
        mesh = box("hex20", (count, count, count), (0.1, 0.1, 0.1))
    else:
        path = folder / f"{name}.msh"
        if not path.exists():
            draw, size = {"flange": (_flange, 0.0082), "cheese": (_cheese, 0.0105)}.get(
                name, (_box, 0.006)
            )
            _write(path, draw, size)
        mesh = read_mesh(path, "m")
    return clamped(_ends(mesh), "z0", "z1", (70e9, 0.33))


def _box(occ) -> None:
    occ.addBox(0, 0, 0, 0.06, 0.04, 0.12)


def _flange(occ) -> None:
    disc = occ.addCylinder(0, 0, 0, 0, 0, 0.02, 0.1)
    neck = occ.addCylinder(0, 0, 0.02, 0, 0, 0.06, 0.05)
    (solid,), _ = occ.fuse([(3, disc)], [(3, neck)])
    holes = [
        (3, occ.addCylinder(0.078 * np.cos(a), 0.078 * np.sin(a), -0.01, 0, 0, 0.05, 0.008))
        for a in np.arange(8) * np.pi / 4
    ]
    occ.cut([solid], [(3, occ.addCylinder(0, 0, -0.01, 0, 0, 0.12, 0.04)), *holes])


def _cheese(occ) -> None:
    rng = np.random.default_rng(1)
    bubbles = [
        (3, occ.addSphere(*rng.uniform(0.0, 0.1, 3), rng.uniform(0.008, 0.018))) for _ in range(25)
    ]
    occ.cut([(3, occ.addBox(0, 0, 0, 0.1, 0.1, 0.1))], bubbles)


def _write(path: Path, draw, size: float) -> None:
    from tests.fea.geometry import require_gmsh  # pytest, 9 MB, is no part of a solve

    gmsh = require_gmsh()
    start(gmsh)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        draw(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeMin", 0.5 * size)
        gmsh.option.setNumber("Mesh.SecondOrderLinear", 1)  # where bubbles meet, curved cells fold
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def _ends(mesh: Mesh) -> Mesh:
    """Return the mesh with its lowest and highest faces as the groups z0 and z1."""
    surface, heights = outer_surface(mesh.blocks), mesh.points[:, 2]
    groups = {}
    for name, height in (("z0", heights.min()), ("z1", heights.max())):
        nodes = np.flatnonzero(np.abs(heights - height) < 1e-9)
        groups[name] = FacetGroup(facets_within(surface, nodes).blocks)
    return replace(mesh, facet_groups=groups)
