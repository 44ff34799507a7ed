"""Springs of an Abaqus or CalculiX deck between points of couplings, or from one to the ground."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from wrenchbook.fea.mesh.deck_content import CoupledGroup, DeckSpring
from wrenchbook.fea.mesh.io.abaqus import STRIDE, Deck, Keyword, add, named

Array = np.ndarray
Lack = Callable[[Keyword, str], None]

NODES = {"SPRING1": 1, "SPRING2": 2, "SPRINGA": 2}
"""Of an element of each type."""

_ALONG = 1e-6  # of coordinates, which decks write to 7 digits


@dataclass(frozen=True)
class Spring:
    """An element as read: the freedom from 0 at each node, and the axes that these count along."""

    keyword: Keyword
    kind: str
    nodes: list[int]
    freedoms: list[int]
    axes: Array  # shape (3, 3), in rows
    size: float


@dataclass
class Springs:
    """Elements of springs by label, each with its keyword, type and nodes, and their sections."""

    elements: dict[int, tuple[Keyword, str, list[int]]] = field(default_factory=dict)
    sections: list[Keyword] = field(default_factory=list)

    def take(self, deck: Deck, keyword: Keyword) -> None:
        """Take elements; raise ValueError if one is there twice or has too few or many nodes."""
        kind, labels = keyword.options["TYPE"].upper(), list[int]()
        for row in keyword.rows:
            label, *nodes = (keyword.frame.label(each) for each in row if each)
            if label in self.elements or label in deck.where:
                raise ValueError(f"element {label % STRIDE} is there twice; number one anew")
            if len(nodes) != NODES[kind]:
                raise ValueError(f"element {label % STRIDE} has {len(nodes)} nodes")
            self.elements[label] = keyword, kind, nodes
            labels.append(label)
        if "ELSET" in keyword.options:
            add(deck, deck.element_sets, keyword.frame, keyword.options["ELSET"], labels)

    def read(
        self,
        deck: Deck,
        orientations: Mapping[str, tuple[float, ...]],
        turned: Mapping[int, object],
        lack: Lack,
    ) -> list[Spring]:
        """Return the linear springs along axes that are known; `lack` gets the blocks of others."""
        springs, used = list[Spring](), set[int]()
        for keyword in self.sections:
            try:
                labels = {*named(deck, deck.element_sets, keyword.options["ELSET"], keyword.frame)}
                again = labels & used or [label for label in labels if label in deck.where]
                used |= labels
                if again:
                    raise ValueError("an element is there twice, or has two *SPRING")
                springs += [
                    self._spring(keyword, label, orientations, turned) for label in sorted(labels)
                ]
            except (ValueError, LookupError) as error:
                _refuse(lack, keyword, error)
        for label, (keyword, *_) in self.elements.items():
            if label not in used:
                _refuse(lack, keyword, "an element has no *SPRING")
        return springs

    def _spring(
        self,
        keyword: Keyword,
        label: int,
        orientations: Mapping[str, tuple[float, ...]],
        turned: Mapping[int, object],
    ) -> Spring:
        if label not in self.elements:
            raise ValueError(f"{label % STRIDE} is no element of type {', '.join(NODES)}")
        _, kind, nodes = self.elements[label]
        rows = [row for row in keyword.rows if any(row)]
        if keyword.options.keys() - {"ELSET", "ORIENTATION"} or len(rows) != 1 + (kind[-1] != "A"):
            raise ValueError("nonlinear, or not of one constant")
        if not (math.isfinite(size := float(rows[-1][0])) and size >= 0):
            raise ValueError(f"a stiffness of {size:g}, where 0 or above should be")
        name, axes = keyword.options.get("ORIENTATION", ""), np.eye(3)
        if kind == "SPRINGA":
            return Spring(keyword, kind, nodes, [0, 0], axes, size)
        freedoms = [int(each) - 1 for each in rows[0] if each]
        if len(freedoms) != len(nodes) or not {*freedoms} <= {*range(6)}:
            raise ValueError(f"freedoms {', '.join(rows[0])}: write one from 1 to 6 for each node")
        if name:
            values = orientations.get(keyword.frame.key(name), ())
            if len(values) != 9:
                raise ValueError(f'"{name}" is no rectangular *ORIENTATION')
            axes = np.reshape(values, (3, 3))
        elif keyword.frame.rotation or any(node in turned for node in nodes):
            raise ValueError("its nodes are turned; name an ORIENTATION")
        return Spring(keyword, kind, nodes, freedoms, axes, size)


@dataclass(frozen=True)
class Ends:
    """What the springs of a load case are on.

    `points` are the number of a coupling and the first freedom of each reference node, `held` the
    freedoms that each node is held in.
    """

    deck: Deck
    points: Mapping[int, tuple[int, int]]
    couplings: list[CoupledGroup]
    held: Mapping[int, set[int]]
    nonlinear: bool

    def joined(self, springs: list[Spring], lack: Lack) -> list[DeckSpring]:
        """Return springs that join the same couplings as one; `lack` gets what cannot be had."""
        together, wrong = dict[tuple[int, ...], DeckSpring](), dict[str, tuple[Keyword, object]]()
        keywords = dict[tuple[int, ...], Keyword]()
        for spring in springs:
            keyword = spring.keyword
            try:
                ends, along = self._moved(spring)
            except ValueError as error:
                wrong.setdefault(keyword.where, (keyword, error))  # the first of each block
                continue
            if ends and spring.size:
                keywords.setdefault(ends, keyword)
                coupled = tuple(self.couplings[i] for i in ends)
                default = DeckSpring(keyword.where, coupled, np.zeros((6, 6)))
                stiffness = together.setdefault(ends, default).stiffness
                stiffness += spring.size * np.outer(along, along)
        times = Counter(i for ends in together for i in ends)
        for ends in [ends for ends in together if any(times[i] > 1 for i in ends)]:
            why = "a point has springs to several others, or to the ground too"
            wrong.setdefault(keywords[ends].where, (keywords[ends], why))
            del together[ends]
        for keyword, why in wrong.values():
            _refuse(lack, keyword, why)
        return [*together.values()]

    def _moved(self, spring: Spring) -> tuple[tuple[int, ...], Array]:
        """Return the numbers of the couplings that a spring moves, none to two, and its direction.

        Shape (6,): its length grows by this times the motion of one from the other.
        """
        free, way = self._free(spring)
        start, *_, end = (np.array(self.deck.nodes[node]) for node in spring.nodes * 2)
        apart, direction = end - start, spring.axes[way % 3]
        if spring.kind == "SPRINGA":
            direction = apart / (np.linalg.norm(apart) or math.nan)
            if way > 2 or not np.isfinite(direction).all():
                raise ValueError("it has no length, or is on a node of rotations")
        if len(free) == 2:
            first, second = (self.couplings[i] for i in free)
            if first is second or (first.kind, first.weighted) != (second.kind, second.weighted):
                raise ValueError("it joins couplings of two kinds, or a point with itself")
            across = np.linalg.norm(np.cross(apart, direction))
            if way < 3 and across > _ALONG * np.abs([start, end]).max():
                raise ValueError("its two points are apart across it, so that it turns them")
        if self.nonlinear and (len(free) == 2 or (free and spring.kind == "SPRINGA")):
            raise ValueError("at large displacements its direction is another than that of ours")
        along = np.zeros((2, 3))
        along[way // 3] = direction
        return tuple(sorted(free)), along.ravel()

    def _free(self, spring: Spring) -> tuple[list[int], int]:
        """Return the numbers of the couplings whose points are free, and the freedom, 0 to 5."""
        free, ways = list[int](), set[int]()
        for node, freedom in zip(spring.nodes, spring.freedoms, strict=True):
            number, first = self.points.get(node, (None, 0))
            if node not in self.deck.nodes:
                raise ValueError(f"node {node % STRIDE} is not defined")
            if number is None:
                if not {freedom - freedom % 3 + i for i in range(3)} <= self.held[node]:
                    raise ValueError(f"node {node % STRIDE} is no coupling's point, nor held")
            elif len((coupled := self.couplings[number]).held) < 6:
                if coupled.held or any(coupled.loads) or coupled.directions != "xyz":
                    why = "is loaded or held in part, or its coupling is of some directions"
                    raise ValueError(f"the point {node % STRIDE} {why}")
                free.append(number)
                ways.add(freedom + first)
        if len(ways) > 1 or max(ways, default=0) > 5:
            raise ValueError("its freedoms are of two kinds, or above 6")
        return free, max(ways, default=0)


def _refuse(lack: Lack, keyword: Keyword, why: object) -> None:
    lack(
        keyword,
        f"is not solved ({why}): write [[supports.bushing]] for a spring to the ground, or "
        "[[spring]] for one between two groups",
    )
