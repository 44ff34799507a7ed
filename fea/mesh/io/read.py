"""Reading mesh files: gmsh, VTK and other formats of meshio, and Abaqus/CalculiX decks."""

from __future__ import annotations

import contextlib
import io
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import meshio
import numpy as np
from meshio import _mesh
from numpy.typing import ArrayLike

from wrenchbook.fea.mesh.io.abaqus_content import read_deck
from wrenchbook.fea.mesh.io.raw import Block, RawMesh, to_mesh
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, Mesh
from wrenchbook.fea.spec.mesh_source import UNITS
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, MeshFileError

Named = TypeVar("Named")

MESHIO_KINDS = {
    "hexahedron": "hex8",
    "hexahedron20": "hex20",
    "hexahedron27": "hex27",
    "tetra": "tet4",
    "tetra10": "tet10",
    "wedge": "wedge6",
    "wedge15": "wedge15",
    "pyramid": "pyramid5",
    "pyramid13": "pyramid13",
    "quad": "quad4",
    "quad8": "quad8",
    "quad9": "quad9",
    "triangle": "tri3",
    "triangle6": "tri6",
    "vertex": "point1",
    "line": "line2",
    "line3": "line3",
}

# meshio's table of dimensions lacks these kinds, and it fails on them.
_mesh.topological_dimension.update({"wedge15": 3, "pyramid13": 3})

# An integer array with more values than this is a numbering, not groups.
_MAX_GROUPS = 1000
_XDMF_ENDINGS = (".xdmf", ".xmf")
# meshio reads Nastran's files without their coordinate systems and large-field elements.
_DECK_ENDINGS = (".bdf", ".nas", ".fem", ".cdb")


def read_mesh(path: Path, unit: str) -> Mesh:
    """Read the mesh file of a bundle.

    Groups are gmsh's physical groups (by their number if they have no name), the sets and surfaces
    of a deck, the groups of a MED file, and the integer arrays of a VTK file: an array of 0 and 1
    is a group of its name, another array makes the group ``<array>_<value>`` for each of its
    values. Groups of surface cells become facet groups, groups of lines and points node groups.

    path: the file; its ending determines the format.
    unit: its length unit, a key of `fea.spec.mesh_source.UNITS`.

    Raises BundleError if the file cannot be read, has no solid cells, or cells that the solver does
    not support.
    """
    try:
        if path.suffix.lower() != ".inp":
            return to_mesh(_read_meshio(path), UNITS[unit])
        raw, content = read_deck(path)
        mesh = to_mesh(raw, UNITS[unit])
        cells = sum(len(nodes) for kind, nodes in raw.blocks if kind in NODES_PER_CELL)
        if n_doubled := cells - sum(mesh.cell_counts.values()):
            message = f"has {n_doubled} elements on the nodes of others, left out here; remove them"
            for line in content.taken["ELEMENT"]:
                content.missing.setdefault(f"line {line}: *ELEMENT", message)
        return replace(mesh, deck=content)
    except MeshFileError as error:
        raise BundleError([BundleProblem("mesh.file", f'"{path.name}" {error}')]) from None


def _read_meshio(path: Path) -> RawMesh:
    """Return the content of a file in a format of meshio.

    Raises MeshFileError if it cannot be read, refers to files elsewhere, or is flat.
    """
    if path.suffix.lower() in _DECK_ENDINGS:
        raise MeshFileError(
            "is a deck of Nastran or Ansys; convert it by `wrenchbook new DECK` (.bdf, .nas, .dat, "
            ".cdb), and name the .inp that this writes"
        )
    if path.suffix.lower() in _XDMF_ENDINGS:
        _refuse_outside(path)
    read = _read_silently(path)
    blocks: list[Block] = [
        (MESHIO_KINDS.get(str(block.type), str(block.type)), np.asarray(block.data, dtype=np.int64))
        for block in read.cells
    ]

    # gmsh's physical groups; the 2.2 format has them only as numbers of cells.
    tags = read.cell_data.get("gmsh:physical", [])
    names = {(int(tag), int(dim)): name for name, (tag, dim) in read.field_data.items()}
    groups: dict[str, list[np.ndarray]] = {}
    for i, (block, part) in enumerate(zip(read.cells, tags, strict=False)):
        numbers = _as_numbers(part)
        for tag in np.unique(numbers[numbers > 0]).tolist():
            name = names.get((tag, block.dim), str(tag))
            parts = groups.setdefault(name, [_as_numbers(None) for _ in read.cells])
            parts[i] = np.flatnonzero(numbers == tag)
    groups |= _families(read, "cell_tags", read.cell_data)
    for array, values in _without_tags(read.cell_data).items():
        parts = list(map(np.asarray, values))
        for name, value in _group_values(array, parts):
            groups[name] = [np.flatnonzero(part == value) for part in parts]
    sets = {**groups, **_without_tags(read.cell_sets)}
    element_sets = {name: [_as_numbers(part) for part in parts] for name, parts in sets.items()}

    of_points = {array: [values] for array, values in read.point_data.items()}
    node_groups = {name: ids for name, (ids,) in _families(read, "point_tags", of_points).items()}
    for array, (values,) in _without_tags(of_points).items():
        for name, value in _group_values(array, [np.asarray(values)]):
            node_groups[name] = np.flatnonzero(values == value)
    node_groups |= read.point_sets
    points = np.asarray(read.points, dtype=float)
    points = points.reshape(-1, points.shape[-1] or 3)  # no points have the shape (0,)
    if points.shape[1] != 3:
        raise MeshFileError("is flat; export a mesh of solid cells in three dimensions")
    nodes = {name: _as_numbers(ids) for name, ids in node_groups.items()}
    return RawMesh(points, blocks, element_sets, nodes)


def _families(
    read: meshio.Mesh, array: str, data: dict[str, list[ArrayLike]]
) -> dict[str, list[np.ndarray]]:
    """Return the groups of a MED file by name: the indices of their members in each part of `data`.

    Each member has the number of one family in `array`, which is removed from `data`. A family
    belongs to each group that the file names for it.
    """
    families: dict[int, list[str]] = getattr(read, array, {})
    names = dict.fromkeys(name for groups in families.values() for name in groups)
    if not names:
        return {}
    parts = data.pop(array, [])
    numbers = {name: [at for at, groups in families.items() if name in groups] for name in names}
    return {
        name: [np.flatnonzero(np.isin(part, numbers[name])) for part in parts] for name in names
    }


def _read_silently(path: Path) -> meshio.Mesh:
    """Read a file by meshio, without its output and its ending of the interpreter."""
    if not path.name.lower().endswith(tuple(meshio.extension_to_filetypes)):
        raise MeshFileError(
            f'has the ending "{path.suffix}", which no mesh format has; export it as .msh (gmsh), '
            ".vtu (VTK) or .inp (Abaqus, CalculiX)"
        )
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        # Other errors are Python's, without a cause.
        plain = isinstance(error, (meshio.ReadError, OSError))
        details = " ".join(f"{output.getvalue()} {error if plain else ''}".split())[:200]
        why = f" ({details})" if details else ": it is damaged, or of another format"
        raise MeshFileError(f"cannot be read as {path.suffix}{why}; export it again") from None


def _as_numbers(part: object) -> np.ndarray:
    return np.asarray([] if part is None else part, dtype=np.int64).ravel()


def _without_tags(named: Mapping[str, Named]) -> dict[str, Named]:
    """Return arrays or sets by name, but for gmsh's numbering of its geometry."""
    return {name: value for name, value in named.items() if not name.startswith("gmsh:")}


def _group_values(array: str, parts: Sequence[np.ndarray]) -> list[tuple[str, int]]:
    """Return name and value of each group in an array of integers, one value per node or cell.

    Its parts belong to the blocks of cells; a file without cells has none.
    """
    if any(part.ndim != 1 or part.dtype.kind not in "iu" for part in parts):
        return []
    distinct = sorted({value for part in parts for value in np.unique(part).tolist()})
    if distinct in ([0, 1], [1]):
        return [(array, 1)]
    if len(distinct) > _MAX_GROUPS:
        return []
    return [(f"{array}_{value}", value) for value in distinct]


def _refuse_outside(path: Path) -> None:
    """Refuse an XDMF file whose numbers lie in a file outside its folder.

    Otherwise an uploaded bundle could read any file of this machine as a mesh, and return it as a
    deformed shape.

    Raises MeshFileError if the file refers to a file elsewhere, to one of plain bytes (which is
    searched in the program's working folder), or is no XML.
    """
    try:
        items = list(ET.parse(path).iter())  # meshio takes an element of any name for a DataItem
    except (ET.ParseError, ValueError, LookupError) as error:
        raise MeshFileError(f"cannot be read as {path.suffix} ({error}); export it again") from None
    for item in items:
        kind = item.get("Format")
        text = (item.text or "").strip()
        if kind == "Binary":
            raise MeshFileError('has its numbers in a binary file; write it with Format="HDF"')
        folder = path.parent.resolve()
        name = text.partition(":")[0]
        beside = Path(name).name == name and (folder / name).resolve().parent == folder  # no link
        if kind == "HDF" and not beside:
            raise MeshFileError(
                f'has its numbers in "{text[:100]}", which is outside the bundle; put that file '
                "beside it and name it without a folder"
            )
