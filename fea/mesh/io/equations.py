"""Equations of an Abaqus or CalculiX deck: nodes that depend on others."""

from __future__ import annotations

import math
from collections import defaultdict

from wrenchbook.fea.mesh.element_order import SECOND
from wrenchbook.fea.mesh.io.abaqus import Deck, labels_of
from wrenchbook.fea.mesh.io.abaqus_keywords import Keyword, real, whole
from wrenchbook.fea.mesh.io.reader import Reader
from wrenchbook.fea.spec.problems import MeshFileError

_LOOSE = (
    "ties nodes in an unsupported way, so they move freely here. Write equal weights in all three "
    "directions for nodes of second-order solid cells; otherwise merge the nodes in the mesh, or "
    "write [[tie]]"
)
_NO_CELL = (
    "ties a node that belongs to no second-order solid cell, so the nodes move freely here. Tie "
    "nodes of these cells to each other directly, or merge them in the mesh, or write [[tie]]"
)


def take_equations(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read equations: the number of terms, then node, freedom and factor of each."""
    if "REMOVE" in keyword.options:
        reader.lack(keyword, "removes equations, which remain in effect here; delete both instead")
        return
    fields = [each for row in keyword.rows for each in row if each]
    while fields:
        count = whole(fields[0])
        terms = fields[1 : 3 * count + 1]
        fields = fields[3 * count + 1 :]
        if count < 1 or len(terms) != 3 * count:
            raise MeshFileError(
                f"has an equation of {count} terms with {len(terms)} fields; write node, freedom "
                "and factor of each term"
            )
        nodes = [labels_of(deck, deck.node_sets, name, keyword.frame) for name in terms[::3]]
        if sizes := [len(each) for each in nodes if len(each) != 1]:
            raise MeshFileError(f"equates a set of {sizes[0]} nodes; write one node in each term")
        labels = [label for each in nodes for label in each]
        factors = map(real, terms[2::3])
        _equate(reader, keyword, list(zip(labels, terms[1::3], factors, strict=True)))


def take_constraints(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read pairs of nodes that move alike."""
    for kind, *names in keyword.rows:
        labels = [labels_of(deck, deck.node_sets, name, keyword.frame) for name in names]
        alike = kind.upper() in ("TIE", "PIN") and [len(each) for each in labels] == [1, 1]
        # Freedom 0 does not exist: the reader notes the mistake.
        for axis in "123" if alike else "0":
            _equate(reader, keyword, [(labels[0][0], axis, -1.0), (labels[-1][0], axis, 1.0)])


def _equate(reader: Reader, keyword: Keyword, terms: list[tuple[int, str, float]]) -> None:
    """Store that a node depends on others by terms of nodes, freedoms from "1", and factors."""
    (node, freedom, factor), *others = terms
    weights: dict[int, float] = defaultdict(float)
    for label, _, other in others:
        weights[label] -= other / factor if factor else math.nan
    if not all(map(math.isfinite, weights.values())):
        listed = ", ".join(f"{each:g}" for _, _, each in terms)
        raise MeshFileError(f"has factors {listed}; write finite numbers, the first not 0")
    axis = whole(freedom) - 1
    rows = reader.equations.setdefault(node, {})
    alone = {other for _, other, _ in terms} == {freedom} and axis not in rows
    rows[axis if alone else None] = keyword, weights


def following(reader: Reader, deck: Deck) -> list[tuple[int, int, float]]:
    """Return dependent nodes, their masters, and weights, by the rows of nodes.

    All belong to second-order cells, and have the same weights and axes in all three directions.
    """
    row = {label: i for i, label in enumerate(deck.nodes)}
    entries = []
    blocks = zip(deck.kinds, deck.cells, strict=True)
    second = [cell for kind, cells in blocks if kind in SECOND.values() for cell in cells]
    solid = {label for cell in second for label in cell}
    for node, rows in reader.equations.items():
        keyword, weights = next(iter(rows.values()))
        nodes = {node, *weights}
        same_weights = weights and all(other == weights for _, other in rows.values())
        same_axes = len({reader.turned.get(label) for label in nodes}) == 1
        if {*rows} == {0, 1, 2} and same_weights and same_axes and nodes <= solid:
            entries += [(row[node], row[label], weight) for label, weight in weights.items()]
        else:
            reader.lack(keyword, _LOOSE if nodes <= solid else _NO_CELL)
    return entries
