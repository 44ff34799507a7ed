"""Springs of an Abaqus or CalculiX deck between points of couplings, or from one to the ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from wrenchbook.fea.mesh.deck_content import CoupledGroup, DeckSpring, LoadCase
from wrenchbook.fea.mesh.io.abaqus import Deck, add, labels_of
from wrenchbook.fea.mesh.io.abaqus_keywords import STRIDE, Keyword, real, whole
from wrenchbook.fea.mesh.io.reader import Reader, Step
from wrenchbook.fea.spec.problems import MeshFileError
from wrenchbook.fea.spec.schema import FREEDOMS

NODES = {"SPRING1": 1, "SPRING2": 2}
"""Number of nodes of an element of each type."""

_UPRIGHT = tuple(np.eye(3).ravel().tolist())
ALONG = 1e-6
"""Part of a length by which a point may be off a spring's line: decks write 7 digits."""


def take_elements(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read elements of springs.

    Raises MeshFileError if one occurs twice or lacks a node.
    """
    labels = list[int]()
    kind = keyword.option("TYPE").upper()
    for row in keyword.rows:
        labels_of_row = [keyword.frame.label(text) for text in row if text]
        label = labels_of_row[0]
        nodes = labels_of_row[1:]
        if label in reader.springs or label in deck.where:
            raise MeshFileError(f"defines element {row[0]} again; renumber one of the two")
        if len(nodes) != NODES[kind]:
            raise MeshFileError(f"has {len(nodes)} nodes in element {row[0]}; write {NODES[kind]}")
        reader.springs[label] = keyword, nodes
        labels.append(label)
    if "ELSET" in keyword.options:
        add(deck, deck.element_sets, keyword.frame, keyword.options["ELSET"], labels)


def join_springs(reader: Reader, deck: Deck, step: Step, case: LoadCase) -> None:
    """Add springs, joined if they connect the same couplings; note unusable ones in the reader."""
    remaining = dict(reader.springs)
    joined: dict[tuple[int, ...], tuple[Keyword, np.ndarray]] = {}  # by the indices of couplings
    # Freedoms of each node of a spring that the step holds.
    held = {node: set[int]() for _, nodes in reader.springs.values() for node in nodes}
    for motion in step.motions.rows if held else ():
        for node in held.keys() & motion.labels:
            held[node] |= motion.freedoms
    for keyword in reader.spring_sections:
        try:
            labels = _labels(reader, deck, keyword, remaining)
            nodes_of_each = [remaining.pop(label)[1] for label in labels]
            springs = [_spring(reader, deck, case, held, keyword, nodes) for nodes in nodes_of_each]
        except MeshFileError as error:
            _refuse(reader, keyword, error)
            continue
        for ends, stiffness in springs:
            if ends:
                _, total = joined.setdefault(ends, (keyword, np.zeros((6, 6))))
                total += stiffness
    first = {keyword.where: label for label, (keyword, _) in reversed(remaining.items())}
    for label in first.values():
        _refuse(reader, remaining[label][0], f"element {label % STRIDE} has no *SPRING")

    used = Counter(number for ends in joined for number in ends)
    for ends, (keyword, stiffness) in joined.items():
        number = max(ends, key=lambda number: used[number])
        if used[number] > 1:
            group = case.couplings[number].group
            why = f"the point of {deck.names[group]} has springs to {used[number]} different ends"
            _refuse(reader, keyword, why)
        else:
            coupled = tuple(case.couplings[number] for number in ends)
            case.springs.append(DeckSpring(keyword.where, coupled, stiffness))


def _labels(
    reader: Reader, deck: Deck, keyword: Keyword, remaining: Mapping[int, object]
) -> list[int]:
    """Return the elements of a *SPRING; raise MeshFileError unless all are among `remaining`."""
    members = labels_of(deck, deck.element_sets, keyword.option("ELSET"), keyword.frame)
    labels = sorted({*members})
    for label in labels:
        if label not in reader.springs or label in deck.where:
            raise MeshFileError(f"element {label % STRIDE} is neither SPRING1 nor SPRING2")
        if label not in remaining:
            raise MeshFileError(f"a *SPRING above has element {label % STRIDE} already")
    return labels


def _spring(
    reader: Reader,
    deck: Deck,
    case: LoadCase,
    held: Mapping[int, set[int]],
    keyword: Keyword,
    nodes: list[int],
) -> tuple[tuple[int, ...], np.ndarray]:
    """Return the indices of the couplings that a spring connects, none to two, and its stiffness.

    Shape (6, 6): of the motion of one relative to the other, along the global axes.
    """
    freedoms, axes, stiffness = _constants(reader, keyword, nodes)
    free: list[int] = []  # indices of couplings
    ways: set[int] = set()  # the freedoms of their points
    for node, freedom in zip(nodes, freedoms, strict=True):
        number, first = reader.points.get(node, (None, 0))
        if number is None:
            three = {0, 1, 2} if freedom < 3 else {3, 4, 5}
            if node not in deck.nodes or not three <= held[node]:
                raise MeshFileError(
                    f"node {node % STRIDE} is neither the point of a coupling nor held"
                )
        elif len(case.couplings[number].held) < len(FREEDOMS):
            _require_free(case.couplings[number], node)
            if freedom + first >= len(FREEDOMS):
                raise MeshFileError(f"a rotation node has the freedoms 1 to 3, not {freedom + 1}")
            free.append(number)
            ways.add(freedom + first)

    if len(ways) > 1:
        listed = " and ".join(str(way + 1) for way in sorted(ways))
        raise MeshFileError(f"its ends have the freedoms {listed}, but need the same")
    way = max(ways, default=0)
    direction = axes[way % 3]
    is_rotation = way > 2
    if len(free) == 2:
        shift = np.zeros(3) if is_rotation else direction
        _check_between(case, [case.couplings[number] for number in free], shift)
    along = np.append(np.zeros(3), direction) if is_rotation else np.append(direction, np.zeros(3))
    return tuple(sorted(free)), stiffness * np.outer(along, along)


def _require_free(coupled: CoupledGroup, node: int) -> None:
    """Refuse a coupling's point that is loaded, held or coupled in part."""
    if any(coupled.loads):
        why = "loaded"
    elif coupled.held:
        why = "held in some freedoms only"
    elif coupled.directions != "xyz":
        why = "coupled in part only"
    else:
        return
    raise MeshFileError(f"the point {node % STRIDE} is {why}")


def _constants(
    reader: Reader, keyword: Keyword, nodes: list[int]
) -> tuple[list[int], np.ndarray, float]:
    """Return a *SPRING's freedom at each node, from 0, its axes in rows, (3, 3), and stiffness."""
    rows = [row for row in keyword.rows if any(row)]
    axes = np.eye(3)
    further = sorted(keyword.options.keys() - {"ELSET", "ORIENTATION"})
    if further:
        raise MeshFileError(f"it has {', '.join(further)}, but must have one constant stiffness")
    if len(rows) != 2:
        raise MeshFileError(f"it has {len(rows)} lines, but must have freedoms, then a stiffness")
    freedoms = [whole(text) - 1 for text in rows[0] if text]
    stiffness = real(rows[1][0])
    if stiffness <= 0:
        raise MeshFileError(f"its stiffness is {stiffness:g}, but must be above 0")
    if len(freedoms) != len(nodes) or not {*freedoms} <= {*range(len(FREEDOMS))}:
        raise MeshFileError(
            f"it has the freedoms {', '.join(rows[0])}, but needs one of 1 to 6 for each node"
        )
    name = keyword.options.get("ORIENTATION", "")
    if name:
        values = reader.orientations.get(keyword.frame.key(name), ())
        if len(values) != axes.size:
            why = "is cylindrical, but must be rectangular" if values else "is not defined above"
            raise MeshFileError(f'its *ORIENTATION "{name}" {why}')
        axes = np.reshape(values, (3, 3))
    elif keyword.frame.rotation not in ((), _UPRIGHT) or not reader.turned.keys().isdisjoint(nodes):
        turned = [node for node in nodes if node in reader.turned]
        node = turned[0] if turned else nodes[0]
        raise MeshFileError(f"node {node % STRIDE} has rotated axes, but it has no ORIENTATION")
    return freedoms, axes, stiffness


def _check_between(case: LoadCase, ends: list[CoupledGroup], shift: np.ndarray) -> None:
    """Refuse a spring between two points that ``[[spring]]`` cannot represent.

    shift: the direction that it resists, shape (3,); zero for a spring of rotations.
    """
    first, second = ends
    points = np.array([first.point, second.point])
    across = np.linalg.norm(np.cross(points[1] - points[0], shift))
    if first is second:
        raise MeshFileError("it joins a point with itself")
    if first.kind != second.kind:
        raise MeshFileError("it joins a rigid with a distributed coupling")
    if first.weighted != second.weighted:
        raise MeshFileError("it joins a coupling with weights and one without")
    if across > ALONG * np.abs(points).max():
        raise MeshFileError(
            f"its points are {across:.3g} of the deck's unit of length off the line of its "
            "direction"
        )
    if case.nonlinear:
        raise MeshFileError("with NLGEOM its direction stays, but that of [[spring]] rotates")


def _refuse(reader: Reader, keyword: Keyword, why: object) -> None:
    more = "write [[supports.bushing]] for a spring to the ground, or [[spring]] between groups"
    reader.lack(keyword, f"is not supported ({why}); {more}")
