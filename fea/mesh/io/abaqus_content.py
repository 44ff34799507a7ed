"""Materials, sections, supports, couplings and loads of an Abaqus or CalculiX deck."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from wrenchbook.fea.mesh.deck_content import CoupledGroup, DeckContent, HeldGroup, SolidSection
from wrenchbook.fea.mesh.io.abaqus import (
    TAKERS,
    Deck,
    kind_of,
    named,
    parsed,
    raw_mesh,
    set_key,
    set_names,
)
from wrenchbook.fea.mesh.io.keywords import Frame, Keyword
from wrenchbook.fea.mesh.io.raw import MeshFileError, RawMesh

_WORDS = {
    "ENCASTRE": "012345",
    "PINNED": "012",
    "XSYMM": "045",
    "YSYMM": "135",
    "ZSYMM": "234",
    "XASYMM": "123",
    "YASYMM": "024",
    "ZASYMM": "015",
}

_MISSING = {
    "EQUATION": "ties nodes by equations: they move freely here; bond them in the mesh",
    "MPC": "ties nodes to each other: they move freely here; bond them in the mesh",
    "TIE": "ties surfaces: the parts are loose here; mesh them as one",
    "TRANSFORM": "turns the axes of nodes; *BOUNDARY and *CLOAD are compared in the global ones",
    "SPRING": "is not solved; write [[supports.bushing]] for a spring to the ground",
    "CONNECTOR SECTION": "is not solved; write [[supports.bushing]] for a spring to the ground",
    "CONTACT": "is not solved: surfaces do not meet; compare bonded and free as bounds",
    "CONTACT PAIR": "is not solved: surfaces do not meet; compare bonded and free as bounds",
    "EMBEDDED ELEMENT": "is not solved: the elements inside are left out",
    "PRE-TENSION SECTION": "is not solved: bolts are without preload",
    "SHELL TO SOLID COUPLING": "is not solved: only solid cells are",
    "SHELL SECTION": "is not solved: shells are groups of faces only",
    "MEMBRANE SECTION": "is not solved: membranes are groups of faces only",
    "BEAM SECTION": "is not solved: beams and trusses are groups of nodes only",
    "HYPERELASTIC": 'is not compared; write law = "neo-hookean" with small-strain constants',
    "ORIENTATION": 'is not compared; write law = "orthotropic" with axes or a cylinder',
    "DISTRIBUTING COUPLING": "is not compared; write [interface] with the section's group",
    "KINEMATIC COUPLING": "is not compared; write [interface] with the section's group",
    "HYPERFOAM": "is not solved: materials are elastic, or neo-Hookean",
    "USER MATERIAL": "is not solved: materials are elastic, or neo-Hookean",
    "VISCOELASTIC": "is not solved: an answer does not depend on time",
    "CREEP": "is not solved: an answer does not depend on time",
    "MASS": "is not solved: an interface is massless",
    "DLOAD": "is not taken over; own weight is gravity under [analysis], else none acts",
    "DSLOAD": "is not taken over: only wrenches at interfaces act",
    "TEMPERATURE": "is not taken over; write [inputs.temperature]",
}

_QUIET = {"", "HEADING", "PREPRINT", "ASSEMBLY", "END ASSEMBLY", "PART", "END PART", "END STEP"}

_PROPOSED = {"CLOAD", "STEP"}
"""What proposes a load range and an analysis for a new component, and is not compared with one."""


@dataclass
class _Coupling:
    """A coupling as read: the key of its surface or node set, and its nodes' labels."""

    keyword: Keyword
    key: str
    ref: int | None
    rot: int | None = None
    kind: str = "rigid"


@dataclass
class _Reader:
    """What has been read besides the mesh; groups are keys of the deck's sets until the end.

    Motions and forces are (where, key, labels, what): `what` are the freedoms held, from 0, or one
    freedom and its load.
    """

    content: DeckContent = field(default_factory=DeckContent)
    sections: list[tuple[str, str, str]] = field(default_factory=list)
    couplings: list[_Coupling] = field(default_factory=list)
    motions: list[tuple[str, str, list[int], set[int]]] = field(default_factory=list)
    forces: list[tuple[str, list[int], int, float]] = field(default_factory=list)
    material: str = ""

    def take(self, deck: Deck, one: Keyword) -> None:
        """Take one keyword, after the deck has taken what is of the mesh."""
        taker = _TAKERS.get(one.word)
        try:
            if taker is not None:
                taker(self, deck, one)
        except (MeshFileError, ValueError, LookupError) as error:
            self.lack(one, f"is not understood, so not taken over ({error})")
        if one.word in _MISSING:
            self.lack(one, _MISSING[one.word])
        if one.word not in _QUIET:
            known = one.word in TAKERS or (taker is not None and one.word not in _PROPOSED)
            lines = self.content.taken if known else self.content.ignored
            lines.setdefault(one.word, []).append(one.line)

    def lack(self, one: Keyword, message: str) -> None:
        """Note what counts and is not taken over."""
        self.content.missing[_where(one)] = message

    @property
    def constants(self) -> dict[str, float]:
        """The material that the keywords are of."""
        return self.content.materials.setdefault(self.material, {})


def read_deck(path: Path) -> tuple[RawMesh, DeckContent]:
    """Read the mesh of a deck and what else is in it.

    Raises
    ------
    MeshFileError
        As `fea.mesh.io.abaqus.read_inp` does.
    """
    reader = _Reader()
    deck = parsed(path, reader.take)
    _finish(reader, deck)
    return raw_mesh(deck), reader.content


def _where(one: Keyword) -> str:
    return f"line {one.line}: *{one.word}"


def _take_elements(reader: _Reader, deck: Deck, one: Keyword) -> None:
    kind = one.options["TYPE"].upper()
    if kind_of(kind) is None:
        reader.lack(one, f"of type {kind} is not solved: only solid cells are")
    elif one.line in deck.element_lines[-1:]:
        counts = reader.content.elements
        counts[kind] = counts.get(kind, 0) + len(deck.cells[-1])


def _take_material(reader: _Reader, _: Deck, one: Keyword) -> None:
    reader.material = one.options["NAME"]


def _take_constants(reader: _Reader, _: Deck, one: Keyword) -> None:
    kind = one.options.get("TYPE", "ISO").upper()
    if kind not in ("ISO", "ISOTROPIC"):
        reader.lack(one, f"of type {kind} is not compared; write it into [[material]]")
        return
    values = zip(_CONSTANTS[one.word], one.rows[0], strict=False)
    reader.constants.update({key: float(value) for key, value in values})
    if one.word == "PLASTIC":
        reader.lack(one, "is not solved: its first stress is a yield_strength to compare with")
    elif len(one.rows) > 1:
        reader.lack(one, "has values at several temperatures; its first line is compared")


def _take_section(reader: _Reader, deck: Deck, one: Keyword) -> None:
    key = set_key(deck, deck.element_sets, one.options["ELSET"], one.frame)
    reader.sections.append((_where(one), key, one.options["MATERIAL"]))


def _take_boundary(reader: _Reader, deck: Deck, one: Keyword) -> None:
    for target, *rest in one.rows:
        word = rest[0].upper() if rest else ""
        if word in _WORDS:
            held = {int(each) for each in _WORDS[word]}
        else:
            first, last, value = (*rest, "", "", "")[:3]
            held = set(range(int(first) - 1, min(int(last or first), 6)))
            if held and float(value or 0.0):
                reader.lack(one, "moves nodes by what is not 0; they are fixed where they are")
        key, labels = _target(deck, target, one.frame)
        reader.motions.append((_where(one), key, labels, held))


def _target(deck: Deck, name: str, frame: Frame) -> tuple[str, list[int]]:
    """Return the key of a node set, empty for a single node, and the nodes."""
    labels = named(deck, deck.node_sets, name, frame)
    single = name.rpartition(".")[2].isdigit()
    return "" if single else set_key(deck, deck.node_sets, name, frame), labels


def _take_coupling(reader: _Reader, deck: Deck, one: Keyword) -> None:
    name = one.options["SURFACE"]
    sets = deck.surfaces if one.frame.key(name) in deck.surfaces else deck.node_sets
    key = set_key(deck, sets, name, one.frame)
    reader.couplings.append(_Coupling(one, key, _node(deck, one, "REF NODE")))


def _take_coupling_kind(reader: _Reader, _: Deck, one: Keyword) -> None:
    rows = [[int(each) for each in row if each] for row in one.rows]
    freedoms = {n for row in rows for n in range(row[0], row[-1] + 1)}
    if rows and not freedoms >= {1, 2, 3}:
        reader.lack(one, "couples some directions only; here all three are")
    reader.couplings[-1].kind = "rigid" if one.word == "KINEMATIC" else "distributed"


def _take_rigid(reader: _Reader, deck: Deck, one: Keyword) -> None:
    name = next((one.options[k] for k in ("NSET", "TIE NSET", "PIN NSET") if k in one.options), "")
    if not name:
        reader.lack(one, "of elements is not taken over; name its nodes as a rigid [interface]")
        return
    key = set_key(deck, deck.node_sets, name, one.frame)
    ref, rot = (_node(deck, one, option) for option in ("REF NODE", "ROT NODE"))
    reader.couplings.append(_Coupling(one, key, ref, rot))


def _node(deck: Deck, one: Keyword, option: str) -> int | None:
    if option not in one.options:
        return None
    return named(deck, deck.node_sets, one.options[option], one.frame)[0]


def _take_force(reader: _Reader, deck: Deck, one: Keyword) -> None:
    for target, freedom, value, *_ in one.rows:
        key, labels = _target(deck, target, one.frame)
        reader.forces.append((key, labels, int(freedom) - 1, float(value)))


def _take_step(reader: _Reader, _: Deck, one: Keyword) -> None:
    if "NLGEOM" in one.options:
        reader.content.nonlinear |= one.options["NLGEOM"].upper() != "NO"


_CONSTANTS = {
    "ELASTIC": ("youngs_modulus", "poisson_ratio"),
    "DENSITY": ("density",),
    "EXPANSION": ("thermal_expansion",),
    "PLASTIC": ("yield_strength",),
}

_TAKERS: dict[str, Callable[[_Reader, Deck, Keyword], None]] = {
    "ELEMENT": _take_elements,
    "MATERIAL": _take_material,
    **dict.fromkeys(_CONSTANTS, _take_constants),
    "SOLID SECTION": _take_section,
    "BOUNDARY": _take_boundary,
    "COUPLING": _take_coupling,
    "KINEMATIC": _take_coupling_kind,
    "DISTRIBUTING": _take_coupling_kind,
    "RIGID BODY": _take_rigid,
    "CLOAD": _take_force,
    "STEP": _take_step,
}


def _finish(reader: _Reader, deck: Deck) -> None:
    """Give groups their final names, and motions and forces of reference nodes to couplings."""
    points = _reference_points(reader, deck)
    by_set: dict[str, tuple[str, set[int]]] = {}
    by_node: dict[int, tuple[str, set[int]]] = {}
    for where, key, labels, freedoms in reader.motions:
        for own, first in (points[label] for label in labels if label in points):
            own.held |= {first + i for i in freedoms if first + i < len(own.loads)}
        rest = [label for label in labels if label not in points]
        if key and rest:
            by_set.setdefault(key, (where, set()))[1].update(freedoms)
        for label in rest if not key else ():
            by_node.setdefault(label, (where, set()))[1].update(freedoms)
    together: dict[str, list[int]] = defaultdict(list)
    for label, (_, freedoms) in by_node.items():
        together[_directions(freedoms)].append(label)
    held = [(where, key, _directions(freedoms)) for key, (where, freedoms) in by_set.items()]
    for ways, labels in together.items():
        key = _set_of(deck, labels, f"nodes_held_in_{ways}")
        held.append((by_node[labels[0]][0], key, ways))
    _share_forces(reader, deck, points)
    _name_groups(reader, deck, [one for one in held if one[2]])


def _directions(freedoms: set[int]) -> str:
    return "".join(way for i, way in enumerate("xyz") if i in freedoms)


def _set_of(deck: Deck, labels: list[int], name: str) -> str:
    """Return the key of the set of these nodes, a new one if the deck has none."""
    for key, own in deck.node_sets.items():
        if set(own) == set(labels):
            return key
    while name.upper() in deck.node_sets:
        name += "_"
    deck.names[name.upper()], deck.node_sets[name.upper()] = name, labels
    return name.upper()


def _share_forces(reader: _Reader, deck: Deck, points: dict[int, tuple[CoupledGroup, int]]) -> None:
    """Add the forces to the loads of couplings, or of the sets of nodes they act on."""
    single = [label for key, labels, *_ in reader.forces for label in labels if not key]
    single = [label for label in dict.fromkeys(single) if label not in points]
    rest = _set_of(deck, single, "nodes_with_forces") if single else ""
    for key, labels, freedom, value in reader.forces:
        for label in labels:
            own, first = points.get(label, (None, 0))
            loads = own.loads if own else reader.content.loads.setdefault(key or rest, [0.0] * 6)
            loads[(freedom + first) % len(loads)] += value


def _reference_points(reader: _Reader, deck: Deck) -> dict[int, tuple[CoupledGroup, int]]:
    """Return the coupling of each reference node, and the number of the node's first freedom."""
    points: dict[int, tuple[CoupledGroup, int]] = {}
    for one in reader.couplings:
        if one.ref is not None and one.ref not in deck.nodes:
            reader.lack(one.keyword, "has a reference node that is not defined")
            continue
        place = () if one.ref is None else tuple(deck.nodes[one.ref])
        own = CoupledGroup(_where(one.keyword), one.key, one.kind, place)
        if one.ref in points:
            reader.lack(one.keyword, "has the reference node of another; unite the two groups")
            continue
        reader.content.couplings.append(own)
        points |= {
            label: (own, i) for label, i in ((one.ref, 0), (one.rot, 3)) if label is not None
        }
    return points


def _name_groups(reader: _Reader, deck: Deck, held: list[tuple[str, str, str]]) -> None:
    content = reader.content
    regions, groups = set_names(deck, deck.element_sets), set_names(deck, deck.node_sets)
    content.sections += [SolidSection(w, regions[key], name) for w, key, name in reader.sections]
    content.supports += [HeldGroup(where, groups[key], ways) for where, key, ways in held]
    content.loads = {groups[key]: loads for key, loads in content.loads.items()}
    faces = set_names(deck, deck.surfaces)
    for one in list(content.couplings):
        one.group = faces.get(one.group) or groups[one.group]
        if len(one.held) == len(one.loads):
            content.couplings.remove(one)
            content.supports.append(HeldGroup(one.where, one.group, "xyz"))
