"""``component.toml`` as a model: the tables of `fea.spec.schema` and the generators."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from wrenchbook.fea.mesh.generators import GENERATORS, Bar, Plate, Spring
from wrenchbook.fea.spec.keys import Name, Text, key, table, union
from wrenchbook.fea.spec.material import AnyMaterial, Material, Orthotropic
from wrenchbook.fea.spec.mesh_source import GEOMETRY_ENDINGS, GeometryFile, MeshFile
from wrenchbook.fea.spec.schema import (
    Analysis,
    Bolt,
    Deck,
    DeclaredTolerance,
    Inputs,
    Interface,
    Joint,
    MeasuredInterface,
    NamedInterface,
    Range,
    Supports,
    Tie,
)


def _kind_of_mesh(mesh: Mapping[str, Any]) -> type:
    """Return the class of a parsed ``[mesh]``: by its generator, or by its file's ending."""
    if "generator" in mesh:
        name = mesh["generator"]
        return GENERATORS.get(name if isinstance(name, str) else "", Bar)  # Bar reports a wrong one
    file = mesh.get("file")
    is_geometry = isinstance(file, str) and Path(file).suffix.lower() in GEOMETRY_ENDINGS
    return GeometryFile if is_geometry else MeshFile


def _kind_of_material(material: Mapping[str, Any]) -> type:
    """Return the class of a parsed ``[[material]]`` by its law."""
    return Orthotropic if material.get("law") == "orthotropic" else Material


Mesh = Annotated[
    MeshFile | GeometryFile | Bar | Plate | Spring,
    union(_kind_of_mesh, MeshFile, GeometryFile, Bar, Plate, Spring),
]
MaterialTable = Annotated[AnyMaterial, union(_kind_of_material, Material, Orthotropic)]


@table
class ComponentFile:
    """The tables and keys of a ``component.toml``."""

    name: Name = key("", '"bracket"')
    """a folder's and URL's name: a-z, 0-9, _ and -, at most 64"""
    title: Text = key("", '"Gripper bracket, 6061-T6"')
    """a title for readers"""
    mesh: Mesh | None = key(
        "", '{generator = "bar", length = 1.0, width = 0.02, height = 0.02}', default=None
    )
    """the table `[mesh]`; without it (and `[deck]`) the component is a table only"""
    materials: Annotated[tuple[MaterialTable, ...], Field(min_length=1)] | None = key(
        "",
        '[{region = "all", youngs_modulus = 70e9, poisson_ratio = 0.33}]',
        default=None,
        name="material",
    )
    """one `[[material]]` a region; required with a mesh"""
    supports: Supports | None = key("", '{fixed = ["rim"]}', default=None)
    """the table `[supports]`; required with a mesh, unless an interface is `held`"""
    ties: Annotated[tuple[Tie, ...], Field(min_length=1)] = key(
        "", '[{secondary = "pin", main = "hole"}]', default=(), default_text="none", name="tie"
    )
    """surfaces that hold together, each pair `[[tie]]`"""
    interface: Interface | tuple[NamedInterface, ...] | tuple[MeasuredInterface, ...] | None = key(
        "", '{section = "tip", coupling = "rigid"}', default=None
    )
    """the table `[interface]`, or `[[interface]]` of each of several; required with a mesh; several
    of a measured part have `name` and `range` alone"""
    bolts: Annotated[tuple[Bolt, ...], Field(min_length=1)] = key(
        "", '[{region = "shank", axis = [0, 0, 1], force = 12e3}]', default=(), name="bolt"
    )
    """preloaded bolts, each `[[bolt]]`"""
    joints: Annotated[tuple[Joint, ...], Field(min_length=1)] = key(
        "",
        '[{groups = ["hub", "rim"], coupling = "rigid", rigid = true}]',
        default=(),
        name="spring",
    )
    """springs between two groups, and rigid joints, each `[[spring]]`"""
    inputs: Inputs | None = key(
        "", "{temperature = {range = [-20, 60], reference = 20}}", default=None
    )
    """the table `[inputs]`: inputs besides the loads"""
    analysis: Analysis | None = key("", "{nonlinear = true}", default=None)
    """the table `[analysis]`; required with a mesh"""
    range: Range | None = key(
        "", "{force = [100, 100, 500], moment = [5, 5, 5]}", default=None, default_text="-"
    )
    """the table `[range]`; of several interfaces each has its own"""
    tolerance: DeclaredTolerance | None = key(
        "", "{translation = 1e-5, rotation = 1e-4}", default=None
    )
    """the table `[tolerance]`"""
    deck: Deck | None = key(
        "",
        '{file = "a.inp", command = ["ccx", "{job}"], output = {reader = "numbers", file = "u"}}',
        default=None,
    )
    """the table `[deck]`: solves in place of the embedded solver"""
