"""The mesh of an Abaqus or CalculiX input deck (.inp): nodes, elements, sets and surfaces.

meshio reads these as well, but forgets the nodes of all ``*NODE`` blocks but the last, gives the
cells of ``*ELEMENT, ELSET=`` to the wrong block and knows no ``*SURFACE``; decks have all three.
Keywords are those of `fea.mesh.io.abaqus_keywords`. Materials, supports and loads are read in
`fea.mesh.io.abaqus_content`.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wrenchbook.fea.mesh.io.abaqus_keywords import (
    STRIDE,
    UNREADABLE,
    Frame,
    Keyword,
    numbers,
    read_keywords,
    real,
    whole,
)
from wrenchbook.fea.mesh.io.raw import NODES_PER_LINE, Block, RawMesh
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, NODES_PER_FACET
from wrenchbook.fea.spec.deck_text import deck_text
from wrenchbook.fea.spec.problems import MeshFileError, point_text, suggest

# Part of the size of a cylinder or of the distance along it: roundoff of coordinates.
_ON_AXIS = 1e-9

_SOLIDS = {"4": "tet4", "6": "wedge6", "8": "hex8", "10": "tet10", "15": "wedge15", "20": "hex20"}
_SOLIDS |= {"5": "pyramid5", "13": "pyramid13"}
_SOLID = re.compile(r"C3D(\d+)[A-Z]*")
_FLAT = {
    "tri3": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D|STRI|R3D)3R?S?"),
    "quad4": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D|R3D)4(R?S?W?5?)"),
    "tri6": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D)6M?|STRI65"),
    "quad8": re.compile(r"(S|CPS|CPE|CAX|M3D|SFM3D)8R?5?"),
    "line2": re.compile(r"(T[23]D2|B[23][13])R?H?"),
    "line3": re.compile(r"(T[23]D3|B[23]2)R?H?"),
}

# Corners of the faces S1, S2, ... of each solid, from 1 as the manuals have them.
_HEX_FACES = ("1234", "5876", "1562", "2673", "3784", "4851")
_TET_FACES = ("123", "142", "243", "341")
_WEDGE_FACES = ("123", "465", "1452", "2563", "3641")
SOLID_FACES = {"hex": _HEX_FACES, "tet": _TET_FACES, "wedge": _WEDGE_FACES}
SOLID_FACES["pyramid"] = ("1234", "152", "253", "354", "451")

_SHELL_FACES = "SPOS|SNEG|E[1-4]|EDGE|END[12]"
_DERIVING = {"COMBINE", "CROP"}  # options of *SURFACE that make a surface of others

_REFUSED = {
    **dict.fromkeys(("NGEN", "NFILL", "NCOPY"), "*NODE"),
    **dict.fromkeys(("ELGEN", "ELCOPY"), "*ELEMENT"),
}
"""Keywords that generate nodes or elements, and the keyword that lists these instead."""

# Members of all sets together, with repetitions: several for each node of the largest solved mesh.
_MAX_MEMBERS = 20_000_000


@dataclass
class Deck:
    """The mesh read so far; sets are keyed by their name in capitals, as solvers do."""

    nodes: dict[int, list[float]] = field(default_factory=dict)  # points by label
    kinds: list[str] = field(default_factory=list)  # kind of cells of each *ELEMENT
    cells: list[list[list[int]]] = field(default_factory=list)  # labels of its elements' nodes
    # By element, the indices of its *ELEMENT and of its row there
    where: dict[int, tuple[int, int]] = field(default_factory=dict)
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    element_sets: dict[str, list[int]] = field(default_factory=dict)
    # Element and face, such as S1; empty until the end of the deck: its free faces
    surfaces: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)  # cause by surface that is not read
    names: dict[str, str] = field(default_factory=dict)  # names of sets, as the deck spells them
    frames: dict[str, Frame] = field(default_factory=dict)  # instances by their names in capitals
    # For each *NODE, the number of nodes before it and its line; for each *ELEMENT, its line
    node_lines: list[tuple[int, str]] = field(default_factory=list)
    element_lines: list[str] = field(default_factory=list)
    # By the number of a frame, the axes of its nodes in rows, and their origin
    systems: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    # Weights of couplings, by node set and label; repeated ones add up
    weights: dict[str, Counter[int]] = field(default_factory=lambda: defaultdict(Counter))
    n_members: int = 0  # of all sets together


def axes_through(origin: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return right-handed axes in rows: 1 from `origin` to `first`, 2 towards `second`.

    All shapes are (3,).

    Raises MeshFileError if the three points lie on one line.
    """
    x = first - origin
    z = np.cross(x, second - origin)
    lengths = np.linalg.norm(x), np.linalg.norm(z)
    if not min(lengths) > 0 or not np.isfinite(lengths).all():
        listed = ", ".join(map(point_text, (origin, first, second)))
        raise MeshFileError(f"has its three points on one line: {listed}; move one off the line")
    x, z = x / lengths[0], z / lengths[1]
    return np.array([x, np.cross(z, x), z])


def radial_axes(axis: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Return the radial, circumferential and axial directions at a point off an axis, in rows.

    axis: its direction, of any length; out: from a point of it to the point; both of shape (3,).

    Raises MeshFileError if the point lies on the axis.
    """
    around = np.cross(axis, out)
    size = np.linalg.norm(axis)
    if not np.linalg.norm(around) > _ON_AXIS * size * max(size, np.linalg.norm(out)):
        raise MeshFileError("has a node on the axis of its cylinder; use rectangular axes for it")
    return axes_through(np.zeros(3), np.cross(around, axis), around)


def cartesian(kind: str, point: np.ndarray) -> np.ndarray:
    """Return a point by its coordinates in a system R, C or S, angles in degrees, shape (3,)."""
    radius, (a, b) = point[0], np.radians(point[1:])
    if kind == "C":
        return np.array([radius * np.cos(a), radius * np.sin(a), point[2]])
    if kind == "S":
        return radius * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])
    return point


def parse_mesh(path: Path, take: Callable[[Deck, Keyword], None]) -> Deck:
    """Return the mesh of a deck; `take` is called with each keyword after the mesh has read it.

    Raises MeshFileError if a line cannot be understood, or unsupported keywords define nodes or
    elements.
    """
    deck = Deck()
    for keyword in read_keywords(deck_text(path)):
        try:
            if keyword.word in _REFUSED:
                instead = _REFUSED[keyword.word]
                raise MeshFileError(f"cannot be read; write what it generates under {instead}")
            if keyword.word in TAKERS:
                TAKERS[keyword.word](deck, keyword)
            take(deck, keyword)
        except MeshFileError as error:
            raise keyword.wrong(error) from None
        except (ValueError, LookupError, OverflowError):
            raise keyword.wrong(UNREADABLE) from None
    _complete_surfaces(deck)
    return deck


def _take_nodes(deck: Deck, keyword: Keyword) -> None:
    """Add the nodes of *NODE at their places in the assembly, m, and their set."""
    kind = keyword.options.get("SYSTEM", "R").upper()
    if kind not in ("R", "C"):
        raise MeshFileError(f"has SYSTEM={kind}; write R (Cartesian) or C (cylindrical)")
    axes, origin = deck.systems.get(keyword.frame.number, (np.eye(3), np.zeros(3)))
    moved = kind == "C" or keyword.frame.number in deck.systems
    deck.node_lines.append((len(deck.nodes), keyword.at))
    labels = []
    for row, line in zip(keyword.rows, keyword.row_lines, strict=True):
        label = keyword.frame.label(row[0])
        point = _coordinates(row, keyword, line)
        if moved:
            point = (cartesian(kind, np.array(point)) @ axes + origin).tolist()
        point = keyword.frame.transformed(point)
        if deck.nodes.setdefault(label, point) != point:
            here = ", ".join(f"{x:g}" for x in point)
            there = ", ".join(f"{x:g}" for x in deck.nodes[label])
            index = list(deck.nodes).index(label)
            earlier = [line for first, line in deck.node_lines if first <= index][-1]
            raise MeshFileError(
                f"has node {row[0]} at ({here}) in line {keyword.deck.place(line)}, but the *NODE "
                f"of line {earlier} has it at ({there}); give one of the two another number"
            )
        labels.append(label)
    if "NSET" in keyword.options:
        add(deck, deck.node_sets, keyword.frame, keyword.options["NSET"], labels)


def _coordinates(row: list[str], keyword: Keyword, line: int) -> list[float]:
    """Return the three coordinates of a row of *NODE, in the deck's unit; a missing one is 0."""
    texts = row[1:4]
    try:
        coordinates = [real(text or "0") for text in texts]
    except ValueError:
        at = ", ".join(texts)
        place = keyword.deck.place(line)
        message = f"has node {row[0]} at ({at}) in line {place}; write three numbers"
        raise MeshFileError(message) from None
    return coordinates + [0.0] * (3 - len(coordinates))


def _take_system(deck: Deck, keyword: Keyword) -> None:
    """Take the axes of the nodes that follow in the part; without rows, the global ones."""
    if not keyword.rows:
        deck.systems.pop(keyword.frame.number, None)
        return
    origin, first = numbers(keyword, 0, 6).reshape(2, 3)
    axes = np.eye(3)
    if any(keyword.rows[0][3:6]):
        second = numbers(keyword, 1, 3)
        if len(keyword.rows) == 1:  # z stays
            second = origin + np.cross([0.0, 0.0, 1.0], first - origin)
        axes = axes_through(origin, first, second)
    deck.systems[keyword.frame.number] = axes, origin


def _take_elements(deck: Deck, keyword: Keyword) -> None:
    """Add the elements of *ELEMENT, if they are solids, shells or beams, and their set."""
    kind = kind_of(keyword.option("TYPE").upper())
    if kind is None:  # masses, springs, gaps: no part of the mesh
        return
    table = _element_rows(keyword, kind)
    if not table:
        return
    for i, row in enumerate(table):
        if row[0] in deck.where:
            block, _ = deck.where[row[0]]
            line = deck.element_lines[block] if block < len(deck.element_lines) else keyword.at
            raise MeshFileError(
                f"defines element {row[0] % STRIDE}, as *ELEMENT in line {line} does; give one of "
                "the two another number"
            )
        deck.where[row[0]] = (len(deck.kinds), i)
    deck.kinds.append(kind)
    deck.element_lines.append(keyword.at)
    deck.cells.append([row[1:] for row in table])
    if "ELSET" in keyword.options:
        labels = [row[0] for row in table]
        add(deck, deck.element_sets, keyword.frame, keyword.options["ELSET"], labels)


_NODES_PER_ELEMENT = {**NODES_PER_CELL, **NODES_PER_FACET, **NODES_PER_LINE}


def _element_rows(keyword: Keyword, kind: str) -> list[list[int]]:
    """Return the labels of each element of *ELEMENT and of its nodes; rows may be continued."""
    n_nodes = _NODES_PER_ELEMENT[kind]
    labels: list[int] = []
    ends: set[int] = set()  # number of labels up to the end of each data line
    for row in keyword.rows:
        labels += [keyword.frame.label(text) for text in row if text]
        ends.add(len(labels))
    starts = range(0, len(labels), 1 + n_nodes)
    for start in starts:
        if start + 1 + n_nodes not in ends:
            name = keyword.option("TYPE")
            note = "" if kind in NODES_PER_CELL else f"; {name} is no solid and is not solved"
            raise MeshFileError(
                f"has element {labels[start] % STRIDE} without the {n_nodes} nodes of a {kind}; "
                f"write {n_nodes} nodes in each row, or another TYPE{note}"
            )
    return [labels[start : start + 1 + n_nodes] for start in starts]


def kind_of(name: str) -> str | None:
    """Return the kind of cell or facet of an element type; None for masses and springs."""
    if solid := _SOLID.fullmatch(name):
        if solid[1] not in _SOLIDS:
            raise MeshFileError(
                f"has type {name}, which is not supported; mesh with C3D{', C3D'.join(_SOLIDS)}"
            )
        return _SOLIDS[solid[1]]
    return next((kind for kind, pattern in _FLAT.items() if pattern.fullmatch(name)), None)


def _take_set(deck: Deck, keyword: Keyword) -> None:
    """Add the members of *NSET or *ELSET; ELSET in *NSET adds the nodes of an element set."""
    sets = deck.node_sets if keyword.word == "NSET" else deck.element_sets
    name = keyword.option(keyword.word)
    entries = _members(deck, sets, keyword)
    if keyword.word == "NSET" and "ELSET" in keyword.options:
        for element in labels_of(deck, deck.element_sets, keyword.option("ELSET"), keyword.frame):
            if element not in deck.where:
                raise MeshFileError(
                    f"needs the nodes of element {element % STRIDE}, which no *ELEMENT of solids, "
                    "shells or beams above defines; remove it from the set"
                )
            block, row = deck.where[element]
            entries += deck.cells[block][row]
    add(deck, sets, keyword.frame, name, entries)


def _members(deck: Deck, sets: dict[str, list[int]], keyword: Keyword) -> list[int]:
    """Return the numbers a set names: as a list, as start-end-step, or by other sets."""
    members: list[int] = []
    frame = keyword.frame
    instance = keyword.options.get("INSTANCE")
    if instance is not None:
        if instance.upper() not in deck.frames:
            known = ", ".join(placed.name for placed in deck.frames.values()) or "none"
            raise MeshFileError(
                f'names the instance "{instance}" (instances above: {known}); correct the name'
            )
        frame = deck.frames[instance.upper()]

    for row in keyword.rows:
        fields = [text for text in row if text]
        if "GENERATE" in keyword.options:
            generated = _range_of(fields, frame)
            _require_at_most(len(members) + len(generated))
            members += generated
        else:
            for name in fields:
                members += labels_of(deck, sets, name, frame)
                _require_at_most(len(members))
    return members


def _range_of(fields: list[str], frame: Frame) -> range:
    """Return the labels from first to last of a row of GENERATE; the step is 1 if missing."""
    ends = [frame.label(text) for text in fields[:2]]
    step = whole(fields[2]) if len(fields) > 2 else 1
    if len(ends) < 2 or ends[0] > ends[1] or step < 1:
        raise MeshFileError(
            f'has "{", ".join(fields)}" to generate from; write first, last (not below first) and '
            "a step above 0"
        )
    return range(ends[0], ends[1] + 1, step)


def _require_at_most(n_members: int) -> None:
    """Refuse a set of more members than a mesh can have: a line may define any range."""
    if n_members > _MAX_MEMBERS:
        raise MeshFileError(f"has {n_members} members; name at most {_MAX_MEMBERS}")


def labels_of(deck: Deck, sets: dict[str, list[int]], name: str, frame: Frame) -> list[int]:
    """Return the members of a field: a number or a set, also as INSTANCE.NAME."""
    instance, _, last = name.rpartition(".")
    frame = deck.frames.get(instance.upper(), frame)
    if last.lstrip("+-").isdigit() and (not instance or instance.upper() in deck.frames):
        return [frame.label(last)]
    return sets[set_key(deck, sets, name, frame)]


def set_key(deck: Deck, sets: Mapping[str, object], name: str, frame: Frame) -> str:
    """Return the key of a set named in a field, of the frame, else of the assembly.

    Raises MeshFileError if there is none.
    """
    instance, _, last = name.rpartition(".")
    in_frame = deck.frames.get(instance.upper())
    keys = (in_frame.key(last) if in_frame else "", frame.key(name), name.upper())
    for key in keys:
        if key in sets:
            return key
    if not deck.left_out.keys().isdisjoint(keys):
        raise MeshFileError(
            f'names the surface "{name}", which is left out above; correct it there'
        )
    names = [deck.names.get(key, key) for key in sets]
    raise MeshFileError(
        f'names the set "{name}", which is not defined above; move it up, or correct the name'
        f"{suggest(name, names)}"
    )


def _take_surface(deck: Deck, keyword: Keyword) -> None:
    """Add the faces, or by TYPE=NODE the nodes, of *SURFACE; leave out other surfaces."""
    surface = keyword.option("NAME")
    kind = keyword.options.get("TYPE", "ELEMENT").upper()
    cause = "" if kind in ("NODE", "ELEMENT") else f"has TYPE={kind}"
    if deriving := _DERIVING & keyword.options.keys():
        cause = f"is made of other surfaces ({min(deriving)})"
    faces: list[tuple[int, str]] = []
    for name, *fields in () if cause else keyword.rows:
        if kind == "NODE":
            add_weighted(deck, keyword.frame, surface, name, *fields[:1])
            continue
        face = "".join(fields[:1]).upper()
        labels = labels_of(deck, deck.element_sets, name, keyword.frame)
        if not re.fullmatch(f"|S[1-6]|{_SHELL_FACES}", face):
            raise MeshFileError(f'has "{face}" as face of {name}; write S1 to S6 of a solid')
        is_of_shells = re.fullmatch(_SHELL_FACES, face)
        if is_of_shells or not all(may_be_solid(deck, element) for element in labels):
            cause = f"has faces of shells or beams ({', '.join([name, *fields])})"
        faces += [(element, face) for element in labels]
        _require_at_most(deck.n_members + len(faces))
    if cause:
        cause = f"{cause}, so it is left out; write faces S1 to S6 of solids"
        deck.left_out[_new_key(deck, keyword.frame, surface)] = cause
    elif faces:
        deck.n_members += len(faces)
        deck.surfaces.setdefault(_new_key(deck, keyword.frame, surface), []).extend(faces)


def may_be_solid(deck: Deck, element: int) -> bool:
    """Return whether an element is a solid, or defined below."""
    return element not in deck.where or deck.kinds[deck.where[element][0]] in NODES_PER_CELL


def _complete_surfaces(deck: Deck) -> None:
    """Give elements without a face in surfaces their free faces: those of no other element.

    Raises MeshFileError if a surface has an element that is not defined, or lacks the face.
    """
    times: Counter[frozenset[int]] = Counter()
    if not all(face for faces in deck.surfaces.values() for _, face in faces):
        times.update(frozenset(face) for e in deck.where for face in _corners(deck, e))
    for key, faces in deck.surfaces.items():
        complete: list[tuple[int, str]] = []
        for element, face in faces:
            if element not in deck.where:
                raise MeshFileError(
                    f'has a surface on element {element % STRIDE} ("{deck.names[key]}"), which no '
                    "*ELEMENT defines; remove it from the surface, or add it"
                )
            table = _corners(deck, element)
            if int(face[1:] or "1") > len(table):
                kind = deck.kinds[deck.where[element][0]]
                there = f"has faces S1 to S{len(table)}" if table else "is no solid"
                raise MeshFileError(
                    f"has a surface on face {face or 'S1'} of element {element % STRIDE}, a "
                    f'{kind}, which {there}; correct the surface "{deck.names[key]}"'
                )
            free = (f"S{i}" for i, nodes in enumerate(table, 1) if times[frozenset(nodes)] == 1)
            complete += [(element, each) for each in ([face] if face else free)]
        deck.surfaces[key] = complete


def _corners(deck: Deck, element: int) -> list[list[int]]:
    """Return the labels of the corners of each face of an element; none if it is no solid."""
    block, row = deck.where[element]
    cell = deck.cells[block][row]
    table = SOLID_FACES.get(deck.kinds[block].rstrip("0123456789"), ())
    return [[cell[int(corner) - 1] for corner in face] for face in table]


def add_weighted(deck: Deck, frame: Frame, name: str, target: str, weight: str = "") -> None:
    """Add a node or the nodes of a set to another set, with their weight if given.

    In a set with weights, a node without one has 0, the default of Abaqus in a coupling (Keywords
    Reference Manual 6.6, *SURFACE).
    """
    labels = labels_of(deck, deck.node_sets, target, frame)
    add(deck, deck.node_sets, frame, name, list(labels))
    if weight and labels:
        weights = dict.fromkeys(labels, real(weight))
        deck.weights[frame.key(name)].update(weights)


def _take_instance(deck: Deck, keyword: Keyword) -> None:
    if keyword.frame.name.upper() in deck.frames:
        name = keyword.frame.name
        raise MeshFileError(f'defines the instance "{name}" again; rename one of the two')
    deck.frames[keyword.frame.name.upper()] = keyword.frame


TAKERS: dict[str, Callable[[Deck, Keyword], None]] = {
    "SYSTEM": _take_system,
    "NODE": _take_nodes,
    "ELEMENT": _take_elements,
    "NSET": _take_set,
    "ELSET": _take_set,
    "SURFACE": _take_surface,
    "INSTANCE": _take_instance,
}


def _new_key(deck: Deck, frame: Frame, name: str) -> str:
    """Return the key of a set that is defined; its name keeps the spelling of its first mention."""
    key = frame.key(name)
    deck.names.setdefault(key, f"{frame.name}.{name}" if frame.name else name)
    return key


def add(
    deck: Deck, sets: dict[str, list[int]], frame: Frame, name: str, entries: list[int]
) -> None:
    """Add members to a new or existing set."""
    deck.n_members += len(entries)
    if deck.n_members > _MAX_MEMBERS:
        raise MeshFileError(
            f'brings all sets to {deck.n_members} members with "{name}", more than {_MAX_MEMBERS}; '
            "remove sets that the component does not name"
        )
    sets.setdefault(_new_key(deck, frame, name), []).extend(entries)


def set_names(deck: Deck, sets: Iterable[str]) -> dict[str, str]:
    """Return each set's name by its key, without the instance if the name is unique."""
    short = {key: key for key in sets}
    for start in (f"{instance}." for instance in deck.frames):
        short |= {key: key.removeprefix(start) for key in short if key.startswith(start)}
    times = Counter(short.values())
    return {
        key: deck.names[key][-len(name) :] if times[name] == 1 else deck.names[key]
        for key, name in short.items()
    }


def raw_mesh(deck: Deck) -> RawMesh:
    """Return the mesh of a deck with its groups by name."""
    ids = np.array(list(deck.nodes), dtype=np.int64)
    points = np.array(list(deck.nodes.values()), dtype=float).reshape(-1, 3)
    row = {node: i for i, node in enumerate(ids.tolist())}
    try:
        blocks: list[Block] = [
            (kind, np.array([[row[node] for node in cell] for cell in cells], dtype=np.int64))
            for kind, cells in zip(deck.kinds, deck.cells, strict=True)
        ]
    except KeyError as error:
        label = error.args[0]
        element = next(e for e, (b, i) in deck.where.items() if label in deck.cells[b][i])
        raise MeshFileError(
            f"has element {element % STRIDE} on node {label % STRIDE}, which no *NODE defines; "
            "add this node, or correct the element"
        ) from None

    regions = set_names(deck, deck.element_sets)
    groups = set_names(deck, deck.node_sets)
    faces = set_names(deck, deck.surfaces)
    return RawMesh(
        points,
        blocks,
        {regions[key]: _by_block(deck, ids) for key, ids in deck.element_sets.items()},
        {
            groups[key]: np.array([row[node] for node in ids if node in row], dtype=np.int64)
            for key, ids in deck.node_sets.items()
        },
        {name: _faces(deck, row, deck.surfaces[key]) for key, name in faces.items()},
        node_weights={
            groups[key]: (np.array([row.get(node, -1) for node in of]), np.array([*of.values()]))
            for key, of in deck.weights.items()
        },
    )


def _by_block(deck: Deck, ids: list[int]) -> list[np.ndarray]:
    """Return for each block the rows of the elements `ids`; unknown ones are skipped."""
    chosen: list[list[int]] = [[] for _ in deck.kinds]
    for element in ids:
        if element in deck.where:
            block, row = deck.where[element]
            chosen[block].append(row)
    return [np.array(rows, dtype=np.int64) for rows in chosen]


def _faces(deck: Deck, row: dict[int, int], faces: list[tuple[int, str]]) -> list[Block]:
    """Return the facets of a surface, `row` the index of each node by its label."""
    by_kind: dict[str, list[list[int]]] = {}
    for element, face in faces:
        nodes = [row[label] for label in _corners(deck, element)[int(face[1]) - 1]]
        by_kind.setdefault("quad4" if len(nodes) == 4 else "tri3", []).append(nodes)
    return [(kind, np.array(nodes, dtype=np.int64)) for kind, nodes in by_kind.items()]
