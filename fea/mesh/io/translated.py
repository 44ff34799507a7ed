"""An Abaqus deck under construction, from a file of another program."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.mesh.facets import EDGES, corners_of_cell
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL
from wrenchbook.fea.spec.problems import MeshFileError


@dataclass
class Case:
    """A load case: rows of ``*BOUNDARY`` and of ``*CLOAD``."""

    name: str = ""
    held: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)


@dataclass
class Translated:
    """A deck under construction; all entries are text of the deck."""

    nodes: list[str] = field(default_factory=list)  # rows of *NODE
    # By type and region, numbers of element and nodes; a midside node may be "0".
    elements: dict[tuple[str, str], list[list[str]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    # Row of each keyword, by material
    constants: dict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))
    sections: dict[str, str] = field(default_factory=dict)  # material by region
    # Groups of nodes.
    groups: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    # Nodes by the row of their *TRANSFORM
    transforms: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    couplings: list[str] = field(default_factory=list)  # lines of couplings and springs
    cases: list[Case] = field(default_factory=list)  # each a step
    skipped: Counter[str] = field(default_factory=Counter)  # contents that are not in the deck
    decide: list[str] = field(default_factory=list)  # values that the file leaves undecided
    nonlinear: bool = False

    def _set_middles(self) -> None:
        """Replace each midside node "0" by another cell's, or by a new one in its edge's middle.

        A new node is grouped, rotated and held as both ends of its edge are.
        """
        rows = [row for rows in self.elements.values() for row in rows]
        points = dict(row.split(", ", 1) for row in self.nodes)
        known = {*points, "0"}
        for number, *nodes in rows:
            if not known.issuperset(nodes):
                node = next(node for node in nodes if node not in known)
                raise MeshFileError(
                    f"has element {number} on the undefined node {node}; add this node"
                )
        if not any("0" in row for row in rows):
            return
        middles, blanks = _midside_nodes(rows)
        lacking = dict.fromkeys(blank.ends for blank in blanks if blank.ends not in middles)
        numbers = itertools.count(max(map(int, points)) + 1)
        new = {str(next(numbers)): ends for ends in lacking}
        middles |= {ends: node for node, ends in new.items()}
        for blank in blanks:
            blank.row[blank.column] = middles[blank.ends]
        for node, ends in new.items():
            at = np.mean([[float(x) for x in points[end].split(",")] for end in ends], axis=0)
            self.nodes.append(f"{node}, {', '.join(f'{x:.12g}' for x in at.tolist())}")
        self._extend_to(new)
        self.decide.append(
            f"{len(blanks)} midside nodes that cells lack are on straight edges: {len(new)} new, "
            "in their middle, held as both ends are if these have the same axes"
        )

    def _extend_to(self, new: Mapping[str, frozenset[str]]) -> None:
        """Group, rotate and hold new nodes as both ends of their edges are, by the new node."""
        for nodes in (*self.groups.values(), *self.transforms.values()):
            members = {*nodes}
            nodes += [node for node, ends in new.items() if ends <= members]
        turned = {node: row for row, nodes in self.transforms.items() for node in nodes}
        alike = {node: ends for node, ends in new.items() if len({*map(turned.get, ends)}) == 1}
        for case in self.cases:
            held = {*case.held}
            case.held = case.held + [
                f"{node}, {freedom}"
                for node, ends in alike.items()
                for freedom in "123456"
                if held.issuperset(f"{end}, {freedom}" for end in ends)
            ]

    def lines(self) -> list[str]:
        """Return the lines of the deck."""
        self._set_middles()
        lines = ["*NODE", *self.nodes]
        for (kind, region), rows in self.elements.items():
            lines.append(f"*ELEMENT, TYPE={kind}, ELSET={region}")
            lines += [",\n".join(rows_of(row)) for row in rows]
        for name, nodes in self.groups.items():
            lines += [f"*NSET, NSET={name}", *rows_of(nodes)]
        for name, constants in self.constants.items():
            lines.append(f"*MATERIAL, NAME={name}")
            lines += [f"*{word}\n{row}" for word, row in constants.items()]
        known = {region for _, region in self.elements}
        pairs = ((region, name) for region, name in self.sections.items() if region in known)
        lines += [f"*SOLID SECTION, ELSET={region}, MATERIAL={name}" for region, name in pairs]
        for number, (row, nodes) in enumerate(self.transforms.items(), 1):
            lines += [f"*NSET, NSET=TURNED_{number}", *rows_of(nodes)]
            lines += [f"*TRANSFORM, NSET=TURNED_{number}", row]

        lines += self.couplings
        before = Case()
        for case in self.cases or [before]:
            lines.append(f"*STEP, NAME={case.name}{', NLGEOM' if self.nonlinear else ''}")
            if case.held != before.held:  # a step keeps earlier supports that it does not change
                lines += ["*BOUNDARY, OP=NEW", *case.held]
            if case.loads != before.loads:
                lines += ["*CLOAD, OP=NEW", *case.loads]
            lines.append("*END STEP")
            before = case
        return [*lines, ""]

    def tie(
        self, name: str, nodes: list[str], reference: str, kind: str, weights: Iterable[float] = ()
    ) -> None:
        """Tie nodes to a reference node ("KINEMATIC"), or the latter to their mean."""
        self.groups[name] = nodes
        self.couplings.append(f"*SURFACE, TYPE=NODE, NAME={name}")
        if not weights:
            self.couplings.append(name)
        pairs = zip(nodes, weights, strict=False)
        self.couplings += [f"{node}, {weight:.12g}" for node, weight in pairs]
        self.couplings += [
            f"*COUPLING, CONSTRAINT NAME={name}, SURFACE={name}, REF NODE={reference}"
        ]
        self.couplings.append(f"*{kind}")


class _Blank(NamedTuple):
    """A midside node that the row of an element lacks."""

    row: list[str]
    column: int
    ends: frozenset[str]  # the nodes of its edge


def _midside_nodes(rows: list[list[str]]) -> tuple[dict[frozenset[str], str], list[_Blank]]:
    """Return the midside node of each edge by its ends, and those that rows of elements lack."""
    kinds = {count: kind for kind, count in NODES_PER_CELL.items()}
    middles: dict[frozenset[str], str] = {}
    blanks: list[_Blank] = []
    for row in rows:
        kind = kinds[len(row) - 1]
        edges = EDGES[kind]
        first = corners_of_cell(kind) + 1
        for i, edge in enumerate(edges[: len(row) - first], first):
            ends = frozenset(row[1 + end] for end in edge)
            if row[i] != "0":
                middles[ends] = row[i]
            else:
                blanks.append(_Blank(row, i, ends))
    return middles, blanks


def rows_of(texts: Iterable[str]) -> list[str]:
    """Return rows of ten texts each."""
    texts = list(texts)
    return [", ".join(texts[i : i + 10]) for i in range(0, len(texts), 10)]
