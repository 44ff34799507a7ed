"""The mesh of a bundle's ``[mesh]``: of a generator, a geometry or a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from wrenchbook.fea.mesh.cad.meshing import mesh_geometry, surface_of_geometry
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.face_choice import choose
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.surface import Surface
from wrenchbook.fea.spec.mesh_source import Generator, GeometryFile, MeshFile, MeshSource


def mesh_of(source: MeshSource) -> Mesh:
    """Return the mesh of a bundle, each point used by a cell.

    Raises BundleError if the file cannot be read, or its geometry cannot be meshed.
    """
    if isinstance(source, Generator):
        return source.mesh()
    if isinstance(source, GeometryFile):
        return mesh_geometry(source.file, source)
    return read_grouped(source.file, source)


def read_grouped(file: Path, source: MeshSource) -> Mesh:
    """Return the mesh of a file with the unit, the order and the groups of `source`."""
    mesh = read_mesh(file, source.unit)
    mesh = mesh if source.order is None else second_order(mesh)
    grouped = isinstance(source, MeshFile) and source.groups
    return choose(Surface(mesh), grouped) if grouped else mesh


def surface_of(source: MeshSource) -> Surface:
    """Return the numbered faces of a bundle's mesh, without its groups by geometry."""
    if isinstance(source, GeometryFile):
        return surface_of_geometry(source.file, source)
    return Surface(mesh_of(replace(source, groups={}) if isinstance(source, MeshFile) else source))
