"""Reading the mesh of an Abaqus or CalculiX input deck (.inp).

meshio reads these as well, but forgets the nodes of all ``*NODE`` blocks but the last, gives the
cells of ``*ELEMENT, ELSET=`` to the wrong block and knows no ``*SURFACE``; decks have all three.
Materials, boundary conditions and steps are not read: a bundle says those itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wrenchbook.fea.mesh.io.raw import NODES_PER_LINE, Block, MeshFileError, RawMesh
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, NODES_PER_FACET

Array = np.ndarray

_SOLIDS = {"4": "tet4", "6": "wedge6", "8": "hex8", "10": "tet10", "15": "wedge15", "20": "hex20"}
_SOLID = re.compile(r"C3D(\d+)[A-Z]*")
_SURFACES = {
    "tri3": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D|STRI|R3D)3R?S?"),
    "quad4": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D|R3D)4(R?S?W?5?)"),
    "tri6": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D)6M?|STRI65"),
    "quad8": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D)8R?5?"),
}
_LINES = {"line2": re.compile(r"(T3D|T2D|B3|B2)[12]H?"), "line3": re.compile(r"(T3D3|B32|B22)R?H?")}

# Corners of the faces S1, S2, ... of each solid, from 1 as the manuals have them.
_HEX_FACES = ("1234", "5876", "1562", "2673", "3784", "4851")
_TET_FACES = ("123", "142", "243", "341")
_WEDGE_FACES = ("123", "465", "1452", "2563", "3641")
_FACES = {"hex": _HEX_FACES, "tet": _TET_FACES, "wedge": _WEDGE_FACES}

_REFUSED = {
    "INCLUDE": "put the included file's lines into this one, so that the bundle is complete",
    "SYSTEM": "give the coordinates in the one global system",
    "NGEN": "write the nodes out",
    "NFILL": "write the nodes out",
    "NCOPY": "write the nodes out",
    "ELGEN": "write the elements out",
    "ELCOPY": "write the elements out",
}


# Of all sets together, counted with repetition: several for each node of the largest mesh solved.
_MOST_MEMBERS = 20_000_000


@dataclass
class _Deck:
    """What has been read so far; sets are keyed by their name in capitals, as solvers do."""

    nodes: dict[int, list[float]] = field(default_factory=dict)
    kinds: list[str] = field(default_factory=list)
    cells: list[list[list[int]]] = field(default_factory=list)
    where: dict[int, tuple[int, int]] = field(default_factory=dict)
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    element_sets: dict[str, list[int]] = field(default_factory=dict)
    surfaces: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    parts: int = 0
    entries: int = 0


def read_inp(path: Path) -> RawMesh:
    """Read the nodes, elements, sets and surfaces of a deck.

    Raises
    ------
    MeshFileError
        If a line cannot be understood, or nodes and elements come by a keyword that is not read.
    """
    deck = _Deck()
    text = path.read_text(encoding="utf-8", errors="replace")
    for number, keyword, options, rows in _keywords(text):
        try:
            _take(deck, keyword, options, rows)
        except MeshFileError as error:
            raise MeshFileError(f"line {number}: *{keyword} {error}") from None
        except (ValueError, KeyError, IndexError, OverflowError) as error:
            raise MeshFileError(f"line {number}: *{keyword} cannot be read ({error})") from None
    try:
        return _raw_mesh(deck)
    except OverflowError:
        raise MeshFileError("numbers a node or an element beyond 2^63; number them anew") from None


def _keywords(text: str) -> Iterator[tuple[int, str, dict[str, str], list[list[str]]]]:
    """Yield (line number, keyword, options, rows of fields) for each block of the deck."""
    head: tuple[int, str, dict[str, str]] | None = None
    rows: list[list[str]] = []
    open_head = ""
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*") or open_head:
            if head is not None and not open_head:
                yield (*head, rows)
            line = open_head + line
            rows = []
            head = (number, *_head(line))
            open_head = line if line.endswith(",") else ""
        else:
            rows.append([each.strip() for each in line.rstrip(",").split(",")])
    if head is not None:
        yield (*head, rows)


def _head(line: str) -> tuple[str, dict[str, str]]:
    keyword, *options = (part.strip() for part in line.lstrip("*").split(","))
    pairs = (option.partition("=") for option in options if option)
    return keyword.upper(), {key.strip().upper(): value.strip() for key, _, value in pairs}


def _take(deck: _Deck, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    if keyword in _REFUSED:
        raise MeshFileError(f"is not read; {_REFUSED[keyword]}")
    taker = _TAKERS.get(keyword)
    if taker is not None:
        taker(deck, options, rows)


def _take_nodes(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    if options.get("SYSTEM", "R").upper() != "R":
        raise MeshFileError("is in a system of its own; give global Cartesian coordinates")
    new = {int(row[0]): [float(x or 0.0) for x in (*row[1:4], "", "", "")[:3]] for row in rows}
    deck.nodes.update(new)
    if "NSET" in options:
        _add(deck, deck.node_sets, options["NSET"], list(new))


def _take_elements(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    kind = _kind(options["TYPE"].upper())
    if kind is None:  # masses, springs, gaps: nothing of the mesh
        return
    columns = 1 + {**NODES_PER_CELL, **NODES_PER_FACET, **NODES_PER_LINE}[kind]
    numbers = [int(each) for row in rows for each in row if each]
    if len(numbers) % columns:
        raise MeshFileError(f"has {len(numbers)} numbers; {kind} elements have {columns} each")
    table = [numbers[i : i + columns] for i in range(0, len(numbers), columns)]
    for i, row in enumerate(table):
        if row[0] in deck.where:
            raise MeshFileError(f"defines element {row[0]} again")
        deck.where[row[0]] = (len(deck.kinds), i)
    deck.kinds.append(kind)
    deck.cells.append([row[1:] for row in table])
    if "ELSET" in options:
        _add(deck, deck.element_sets, options["ELSET"], [row[0] for row in table])


def _kind(name: str) -> str | None:
    solid = _SOLID.fullmatch(name)
    if solid:
        return _known_solid(name, solid[1])
    for kind, pattern in {**_SURFACES, **_LINES}.items():
        if pattern.fullmatch(name):
            return kind
    return None


def _known_solid(name: str, nodes: str) -> str:
    if nodes not in _SOLIDS:
        raise MeshFileError(f"of type {name} is not read; it may be C3D{', C3D'.join(_SOLIDS)}")
    return _SOLIDS[nodes]


def _take_node_set(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    entries = _members(deck.node_sets, options, rows)
    if "ELSET" in options:
        for element in deck.element_sets[options["ELSET"].upper()]:
            block, row = deck.where[element]
            entries += deck.cells[block][row]
    _add(deck, deck.node_sets, options["NSET"], entries)


def _take_element_set(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    entries = _members(deck.element_sets, options, rows)
    _add(deck, deck.element_sets, options["ELSET"], entries)


def _members(
    sets: dict[str, list[int]], options: dict[str, str], rows: list[list[str]]
) -> list[int]:
    """Return the numbers a set names: one by one, as start-end-step, or by other sets."""
    found: list[int] = []
    for row in rows:
        fields = [each for each in row if each]
        if "GENERATE" in options:
            first, last, step = (*(int(each) for each in fields), 1)[:3]
            found += _few(range(first, last + 1, step))
        else:
            for each in fields:
                found += _named(sets, each)
                _few(found)
    return found


def _few(entries: Sequence[int]) -> Sequence[int]:
    """Return a set's members if a mesh can have so many: a line of text may name any number."""
    if len(entries) > _MOST_MEMBERS:
        raise MeshFileError(f"names {len(entries)} nodes or elements; no mesh has so many")
    return entries


def _named(sets: dict[str, list[int]], name: str) -> list[int]:
    if name.lstrip("+-").isdigit():
        return [int(name)]
    if name.upper() not in sets:
        raise MeshFileError(f'names a set "{name}" that is not defined above it')
    return sets[name.upper()]


def _take_surface(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    by_node = options.get("TYPE", "ELEMENT").upper() == "NODE"
    for name, *rest in rows:
        if by_node:
            _add(deck, deck.node_sets, options["NAME"], _named(deck.node_sets, name))
            continue
        face = rest[0].upper() if rest else ""
        if not re.fullmatch(r"S\d", face):
            raise MeshFileError(f'has the face "{face}"; faces of solids are S1 to S6')
        entries = [(element, face) for element in _named(deck.element_sets, name)]
        deck.entries += len(entries)
        _few(range(deck.entries))
        deck.names.setdefault(options["NAME"].upper(), options["NAME"])
        deck.surfaces.setdefault(options["NAME"].upper(), []).extend(entries)


def _take_part(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    deck.parts += 1
    if deck.parts > 1:
        raise MeshFileError("comes twice; write a flat deck, without parts and assembly")


def _take_instance(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    if rows:
        raise MeshFileError("moves its part; write a flat deck, without parts and assembly")


_TAKERS: dict[str, Callable[[_Deck, dict[str, str], list[list[str]]], None]] = {
    "NODE": _take_nodes,
    "ELEMENT": _take_elements,
    "NSET": _take_node_set,
    "ELSET": _take_element_set,
    "SURFACE": _take_surface,
    "PART": _take_part,
    "INSTANCE": _take_instance,
}


def _add(deck: _Deck, sets: dict[str, list[int]], name: str, entries: list[int]) -> None:
    """Add to a set, which keeps the spelling of its first mention."""
    deck.entries += len(entries)
    if deck.entries > _MOST_MEMBERS:
        raise MeshFileError(f"names a set too many: they have {deck.entries} members in all")
    deck.names.setdefault(name.upper(), name)
    sets.setdefault(name.upper(), []).extend(entries)


def _raw_mesh(deck: _Deck) -> RawMesh:
    ids = np.array(list(deck.nodes), dtype=np.int64)
    points = np.array(list(deck.nodes.values()), dtype=float).reshape(-1, 3)
    row = {node: i for i, node in enumerate(ids.tolist())}
    try:
        blocks: list[Block] = [
            (kind, np.array([[row[node] for node in cell] for cell in cells], dtype=np.int64))
            for kind, cells in zip(deck.kinds, deck.cells, strict=True)
            if cells
        ]
    except KeyError as error:
        raise MeshFileError(f"has an element on node {error}, which is not defined") from None
    name = deck.names
    return RawMesh(
        points,
        blocks,
        {name[key]: _by_block(deck, ids) for key, ids in deck.element_sets.items()},
        {name[key]: _rows(row, ids) for key, ids in deck.node_sets.items()},
        {name[key]: _faces(deck, row, faces) for key, faces in deck.surfaces.items()},
    )


def _rows(row: dict[int, int], ids: list[int]) -> Array:
    return np.array([row[node] for node in ids if node in row], dtype=np.int64)


def _by_block(deck: _Deck, ids: list[int]) -> list[Array]:
    """Return for each block the rows of the elements `ids`; solvers skip those not there."""
    chosen: list[list[int]] = [[] for _ in deck.kinds]
    for element in ids:
        if element in deck.where:
            block, row = deck.where[element]
            chosen[block].append(row)
    return [np.array(rows, dtype=np.int64) for rows in chosen]


def _faces(deck: _Deck, row: dict[int, int], faces: list[tuple[int, str]]) -> list[Block]:
    found: dict[str, list[list[int]]] = {}
    for element, face in faces:
        if element not in deck.where:
            raise MeshFileError(f"has a surface on element {element}, which is not defined")
        block, cell = deck.where[element]
        shape = deck.kinds[block].rstrip("0123456789")
        table = _FACES.get(shape, ())
        if int(face[1]) > len(table):
            raise MeshFileError(f"has a surface on face {face} of element {element}, a {shape}")
        corners = [row[deck.cells[block][cell][int(c) - 1]] for c in table[int(face[1]) - 1]]
        found.setdefault("quad4" if len(corners) == 4 else "tri3", []).append(corners)
    return [(kind, np.array(nodes, dtype=np.int64)) for kind, nodes in found.items()]
