"""Held nodes of an Abaqus or CalculiX deck, and its usable couplings."""

from __future__ import annotations

import math
from collections import Counter, defaultdict

from wrenchbook.fea.mesh.deck_content import CoupledGroup, HeldGroup
from wrenchbook.fea.mesh.facets import FACES
from wrenchbook.fea.mesh.io.abaqus import SOLID_FACES, Deck
from wrenchbook.fea.mesh.io.abaqus_cases import HELD_IN
from wrenchbook.fea.mesh.io.abaqus_keywords import STRIDE
from wrenchbook.fea.mesh.io.reader import Coupling, Motions, Reader
from wrenchbook.fea.spec.problems import MeshFileError

GLOBAL: tuple[float, ...] = ()  # the global axes


def supports_of(
    reader: Reader, deck: Deck, motions: Motions, count: int
) -> tuple[list[HeldGroup], list[set[int]]]:
    """Return the groups that `motions` hold, by their keys, and each coupling's held freedoms."""
    freedoms_of_couplings = _held_freedoms_of_couplings(reader, motions, count)
    by_set: dict[tuple[str, tuple[float, ...]], tuple[str, set[int]]] = {}
    by_node: dict[int, tuple[str, set[int]]] = {}
    for where, key, labels, freedoms in motions.rows:
        plain = [label for label in labels if label not in reader.points]
        axes = list({reader.turned.get(label, GLOBAL) for label in plain})
        if key and len(axes) == 1:
            by_set.setdefault((key, axes[0]), (where, set()))[1].update(freedoms)
        elif not key or len(axes) > 1:
            for label in plain:
                by_node.setdefault(label, (where, set()))[1].update(freedoms)
    groups = [
        HeldGroup(where, key, directions_of(freedoms), axes)
        for (key, axes), (where, freedoms) in by_set.items()
    ]
    # Single nodes with the same held freedoms are one group.
    nodes: dict[tuple[str, tuple[float, ...]], list[int]] = defaultdict(list)
    for label, (_, freedoms) in by_node.items():
        directions = directions_of(freedoms)
        axes = GLOBAL if directions == "xyz" else reader.turned.get(label, GLOBAL)
        nodes[directions, axes].append(label)
    for (directions, axes), labels in nodes.items():
        key = set_of(reader, deck, labels, f"{HELD_IN}{directions}")
        groups.append(HeldGroup(by_node[labels[0]][0], key, directions, axes))
    return [group for group in groups if group.directions], freedoms_of_couplings


def _held_freedoms_of_couplings(reader: Reader, motions: Motions, count: int) -> list[set[int]]:
    """Return the freedoms 0 to 5 of each of `count` couplings' points that are held."""
    held: list[set[int]] = [set() for _ in range(count)]
    for where, _, labels, freedoms in motions.rows:
        for label in reader.points.keys() & labels:
            usable = freedoms
            if label in reader.turned:
                # Along rotated axes translations, or rotations, are used only if all three are
                # held: `locked` would hold one or two of them along other axes.
                of_all = [row.freedoms for row in motions.rows if label in row.labels]
                together = set[int]().union(*of_all)
                threes = [three for three in ({0, 1, 2}, {3, 4, 5}) if three <= together]
                usable = freedoms & set[int]().union(*threes)
            if usable != freedoms:
                reader.content.missing[where] = (
                    f"fixes the coupled node {label % STRIDE} along rotated axes; write axes and "
                    "locked under [interface]"
                )
            number, first = reader.points[label]
            held[number] |= {first + i for i in usable if first + i < 6}
    return held


def directions_of(freedoms: set[int]) -> str:
    """Return the translations among freedoms from 0, such as "xz"."""
    return "".join(direction for i, direction in enumerate("xyz") if i in freedoms)


def set_of(reader: Reader, deck: Deck, labels: list[int], name: str) -> str:
    """Return the key of the set of these nodes, a new key if the deck has no such set."""
    nodes = frozenset(labels)
    if nodes not in reader.sets:
        while name.upper() in deck.node_sets:
            name += "_"
        reader.sets[nodes] = name.upper()
        deck.names[name.upper()], deck.node_sets[name.upper()] = name, labels
    return reader.sets[nodes]


def couplings_of(reader: Reader, deck: Deck) -> list[CoupledGroup]:
    """Return the couplings with usable reference nodes, and store these nodes in the reader."""
    couplings: list[CoupledGroup] = []
    for coupled in reader.couplings:
        try:
            group = _coupled_group(reader, deck, coupled)
        except MeshFileError as error:
            reader.lack(coupled.keyword, str(error))
            continue
        first_freedoms = ((coupled.ref, 0), (coupled.rot, 3))
        number = len(couplings)
        reader.points |= {n: (number, first) for n, first in first_freedoms if n is not None}
        couplings.append(group)
    return couplings


def _coupled_group(reader: Reader, deck: Deck, coupled: Coupling) -> CoupledGroup:
    """Return a coupling with its nodes.

    Raises MeshFileError if its reference node cannot be used, or has no node within its radius.
    """
    label = (coupled.ref or 0) % STRIDE
    if coupled.ref is not None and coupled.ref not in deck.nodes:
        raise MeshFileError(f"has the reference node {label}, not defined; add it")
    if coupled.ref in reader.points:
        raise MeshFileError(f"has the reference node {label} of another coupling; merge the two")
    key = coupled.key
    point = () if coupled.ref is None else tuple(deck.nodes[coupled.ref])
    if point and math.isfinite(coupled.radius):
        labels = [n for n in _nodes_of(deck, key) if n in deck.nodes]
        near = [n for n in labels if math.dist(deck.nodes[n], point) <= coupled.radius]
        if not near:
            raise MeshFileError(
                f"has no node within INFLUENCE RADIUS={coupled.radius:g} of its reference node "
                f"{label}; write a larger radius"
            )
        weights = deck.weights.get(key, {})
        key = set_of(reader, deck, near, f"{deck.names[key]}_within_{coupled.radius:g}")
        if weights:
            deck.weights[key] = Counter({n: weights[n] for n in near if n in weights})

    group = CoupledGroup(coupled.keyword.where, key, coupled.kind, point)
    group.weighted = coupled.kind == "distributed" and key in deck.weights
    group.directions = coupled.directions
    if coupled.directions != "xyz":
        is_turned = not reader.turned.keys().isdisjoint(_nodes_of(deck, key))
        if is_turned or "ORIENTATION" in coupled.keyword.options:
            group.directions = ""  # along other axes than the mesh's
    return group


def _nodes_of(deck: Deck, key: str) -> list[int]:
    """Return the labels of a set's nodes, or of a surface's with those between corners."""
    labels = dict.fromkeys(deck.node_sets.get(key, ()))
    for element, face in deck.surfaces.get(key, ()):
        block, row = deck.where[element]
        kind = deck.kinds[block]
        cell = deck.cells[block][row]
        corners = {int(c) - 1 for c in SOLID_FACES[kind.rstrip("0123456789")][int(face[1]) - 1]}
        face_nodes = next(nodes for nodes in FACES[kind] if corners <= set(nodes))
        labels |= dict.fromkeys(cell[i] for i in face_nodes)
    return list(labels)
