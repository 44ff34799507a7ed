"""Components without a bundle's folder: a mesh clamped at one facet group, loaded at another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.component import AttachedInterface, ComponentModel, build
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.schema import Analysis, Bundle, DeclaredRange, Interface, Supports

Warp = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def clamped(
    mesh: Mesh,
    fixed: str,
    section: str,
    material: tuple[float, float],
    *,
    coupling: str = "rigid",
    nonlinear: bool = False,
    point: NDArray[np.float64] | None = None,
    axes: NDArray[np.float64] | None = None,
) -> ComponentModel:
    """Clamp one facet group of a mesh and attach the interface to another.

    Parameters
    ----------
    mesh
        In metres.
    fixed, section
        Names of facet groups.
    material
        Young's modulus (Pa) and Poisson's ratio.
    coupling, nonlinear
        As in a bundle.
    point
        Shape (3,), m; the section's area centre unless given.
    axes
        Shape (3, 3), row i the direction of the interface frame's axis i; the mesh's unless given.
    """
    part = section_of_facets(mesh.points, mesh.facet_groups[section])
    place = part.centre if point is None else np.asarray(point, dtype=float)
    frame = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    interface = Interface(section, coupling=coupling, point=place, axes=frame)
    bundle = _bundle(Material("all", *material), fixed, interface, nonlinear)
    return ComponentModel(
        bundle=bundle,
        mesh=mesh,
        materials=bundle.materials,
        material_of_cells=tuple(np.zeros(len(block), dtype=int) for block in mesh.blocks),
        fixed_nodes=mesh.facet_groups[fixed].node_ids,
        interfaces=(AttachedInterface("interface", "", part, place, frame, coupling, ()),),
        analysis=bundle.analysis,
    )


def attached(part: ComponentModel, **changes: Any) -> ComponentModel:
    """Return a component whose first interface has another coupling, locked freedoms or point."""
    first, *others = part.interfaces
    return replace(part, interfaces=(replace(first, **changes), *others))


def _bundle(material: Material, fixed: str, interface: Interface, nonlinear: bool) -> Bundle:
    """Return a bundle of no folder, for any load."""
    return Bundle(
        folder=Path(),
        name="validation",
        title="",
        mesh=None,
        materials=(material,),
        supports=Supports((fixed,)),
        interface=interface,
        analysis=Analysis(nonlinear=nonlinear),
        range=DeclaredRange(np.full(6, -np.inf), np.full(6, np.inf)),
        tolerance=None,
        deck=None,
        fingerprint="",
    )


def shipped(name: str, **parameters: float) -> ComponentModel:
    """Return a component of the shipped library, its generator's `parameters` changed."""
    bundle = read_bundle(SHIPPED / name)
    if parameters and bundle.mesh is not None:
        bundle = replace(bundle, mesh=replace(bundle.mesh, **parameters))
    return build(bundle)
