"""Springs of an Abaqus or CalculiX deck between points of couplings, or from one to the ground."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping

import numpy as np

from wrenchbook.fea.mesh.deck_content import CoupledGroup, DeckSpring, LoadCase
from wrenchbook.fea.mesh.io.abaqus import STRIDE, Deck, Keyword, add, named
from wrenchbook.fea.mesh.io.reader import Reader, Step

Array = np.ndarray

NODES = {"SPRING1": 1, "SPRING2": 2}
"""Of an element of each type."""

_UPRIGHT = tuple(np.eye(3).ravel().tolist())
_ALONG = 1e-6  # of coordinates, which decks write to 7 digits


def take_elements(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Take elements of springs; raise ValueError if one is there twice, or of other nodes."""
    labels = list[int]()
    for row in keyword.rows:
        label, *nodes = (keyword.frame.label(each) for each in row if each)
        expected = NODES[keyword.options["TYPE"].upper()]
        if label in reader.springs or label in deck.where or len(nodes) != expected:
            raise ValueError(f"element {row[0]} is defined twice, or has {len(nodes)} nodes")
        reader.springs[label] = keyword, nodes
        labels.append(label)
    if "ELSET" in keyword.options:
        add(deck, deck.element_sets, keyword.frame, keyword.options["ELSET"], labels)


def join_springs(reader: Reader, deck: Deck, step: Step, case: LoadCase) -> None:
    """Add springs that join the same couplings as one; the reader notes those that cannot be."""
    remaining, joined = dict(reader.springs), dict[tuple[int, ...], tuple[Keyword, Array]]()
    held = {node: set[int]() for _, nodes in remaining.values() for node in nodes}
    for motion in step.motions.rows if held else ():
        for node in held.keys() & motion.labels:
            held[node] |= motion.freedoms
    for keyword in reader.spring_sections:
        try:
            name = keyword.options.get("ELSET", "")
            labels = {*named(deck, deck.element_sets, name, keyword.frame)}
            if not labels <= remaining.keys() or any(label in deck.where for label in labels):
                raise ValueError("an element of its set is not SPRING1 or SPRING2, or is repeated")
            springs = [remaining.pop(label)[1] for label in sorted(labels)]
            springs = [_spring(reader, deck, case, held, keyword, nodes) for nodes in springs]
        except (ValueError, LookupError) as error:
            _refuse(reader, keyword, error)
            continue
        for ends, stiffness in (spring for spring in springs if spring[0]):
            joined.setdefault(ends, (keyword, np.zeros((6, 6))))[1][:] += stiffness
    for keyword, _ in remaining.values():
        _refuse(reader, keyword, "an element has no *SPRING")
    used = Counter(i for ends in joined for i in ends)
    for ends, (keyword, stiffness) in joined.items():
        if max(used[i] for i in ends) > 1:
            _refuse(reader, keyword, "a point has springs to several others, or the ground too")
        else:
            coupled = tuple(case.couplings[i] for i in ends)
            case.springs.append(DeckSpring(keyword.where, coupled, stiffness))


def _spring(
    reader: Reader,
    deck: Deck,
    case: LoadCase,
    held: Mapping[int, set[int]],
    keyword: Keyword,
    nodes: list[int],
) -> tuple[tuple[int, ...], Array]:
    """Return the numbers of the couplings that a spring moves, none to two, and its stiffness.

    Shape (6, 6): of the motion of one from the other, along the global axes.
    """
    freedoms, axes, size = _constants(reader, keyword, nodes)
    free, ways = list[int](), set[int]()
    for node, freedom in zip(nodes, freedoms, strict=True):
        number, first = reader.points.get(node, (None, 0))
        if number is None:
            three = {freedom - freedom % 3 + i for i in range(3)}
            if node not in deck.nodes or not three <= held[node]:
                raise ValueError(
                    f"node {node % STRIDE} is neither the point of a coupling nor held"
                )
        elif len((coupled := case.couplings[number]).held) < 6:
            if coupled.held or any(coupled.loads) or coupled.directions != "xyz":
                why = "loaded, held in part, or of a coupling of some directions"
                raise ValueError(f"the point {node % STRIDE} is {why}")
            free.append(number)
            ways.add(freedom + first)
    if len(ways) > 1 or (way := max(ways, default=0)) > 5:
        raise ValueError("its ends have different freedoms, or freedoms above 6")
    if len(free) == 2:
        _check_between(case, [case.couplings[i] for i in free], axes[way % 3] * (way < 3))
    along = np.kron(np.eye(2)[way // 3], axes[way % 3])
    return tuple(sorted(free)), size * np.outer(along, along)


def _constants(
    reader: Reader, keyword: Keyword, nodes: list[int]
) -> tuple[list[int], Array, float]:
    """Return the freedom from 0 at each node, the axes in rows, and the stiffness along one."""
    rows, axes = [row for row in keyword.rows if any(row)], np.eye(3)
    if keyword.options.keys() - {"ELSET", "ORIENTATION"} or len(rows) != 2:
        raise ValueError("its stiffness is not one constant; write one number")
    freedoms = [int(each) - 1 for each in rows[0] if each]
    if not 0 < (size := float(rows[1][0])) < math.inf:
        raise ValueError(f"its stiffness is {size:g}, but must be above 0 and finite")
    if len(freedoms) != len(nodes) or not {*freedoms} <= {*range(6)}:
        raise ValueError(f"its freedoms {', '.join(rows[0])} are not one of 1 to 6 for each node")
    if name := keyword.options.get("ORIENTATION", ""):
        values = reader.orientations.get(keyword.frame.key(name), ())
        if len(values) != 9:
            raise ValueError(f'"{name}" is not a rectangular *ORIENTATION')
        axes = np.reshape(values, (3, 3))
    elif keyword.frame.rotation not in ((), _UPRIGHT) or not reader.turned.keys().isdisjoint(nodes):
        raise ValueError("its nodes have rotated axes; name an ORIENTATION")
    return freedoms, axes, size


def _check_between(case: LoadCase, ends: list[CoupledGroup], direction: Array) -> None:
    """Refuse a spring between two points that ``[[spring]]`` is not; zero direction: of turns."""
    first, second = ends
    points = np.array([first.point, second.point])
    across = np.linalg.norm(np.cross(points[1] - points[0], direction))
    if first is second or (first.kind, first.weighted) != (second.kind, second.weighted):
        raise ValueError("it joins couplings of two kinds, or a point with itself")
    if across > _ALONG * np.abs(points).max():
        raise ValueError("its points are apart across its direction, so it would rotate them")
    if case.nonlinear:
        raise ValueError("its direction is fixed in space, but that of [[spring]] rotates")


def _refuse(reader: Reader, keyword: Keyword, why: object) -> None:
    more = "write [[supports.bushing]] for a spring to the ground, or [[spring]] between groups"
    reader.lack(keyword, f"is not supported ({why}); {more}")
