"""Equations of an Abaqus or CalculiX deck: nodes that follow others."""

from __future__ import annotations

import math
from collections import defaultdict

from wrenchbook.fea.mesh.element_order import SECOND
from wrenchbook.fea.mesh.io.abaqus import Deck, Keyword, named
from wrenchbook.fea.mesh.io.reader import Reader

_LOOSE = (
    "ties nodes in an unsupported way, so they move freely here. Write equal weights in all three "
    "directions for nodes of second-order solid cells; otherwise merge the nodes in the mesh, or "
    "write [[tie]]"
)


def take_equations(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Take equations: the number of terms, then node, freedom and factor of each."""
    fields = [each for row in keyword.rows for each in row if each]
    while fields and "REMOVE" not in keyword.options:
        count = int(fields[0])
        terms, fields = fields[1 : 3 * count + 1], fields[3 * count + 1 :]
        nodes = [named(deck, deck.node_sets, name, keyword.frame) for name in terms[::3]]
        labels = [label for each in nodes for label in each]
        if not len(labels) == count == len(terms) / 3:
            raise ValueError(f"an equation must have {count} terms of node, freedom and factor")
        factors = map(float, terms[2::3])
        _equate(reader, keyword, list(zip(labels, terms[1::3], factors, strict=True)))


def take_constraints(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Take pairs of nodes that move alike."""
    for kind, *names in keyword.rows:
        labels = [named(deck, deck.node_sets, name, keyword.frame) for name in names]
        alike = kind.upper() in ("TIE", "PIN") and [len(each) for each in labels] == [1, 1]
        for axis in "123" if alike else "0":
            _equate(reader, keyword, [(labels[0][0], axis, -1.0), (labels[-1][0], axis, 1.0)])


def _equate(reader: Reader, keyword: Keyword, terms: list[tuple[int, str, float]]) -> None:
    (node, freedom, factor), *others = terms
    weights: dict[int, float] = defaultdict(float)
    for label, _, other in others:
        weights[label] -= other / factor if factor else math.nan
    if not all(map(math.isfinite, weights.values())):
        raise ValueError("its factors must be numbers other than zero")
    rows, axis = reader.equations.setdefault(node, {}), int(freedom) - 1
    alone = {other for _, other, _ in terms} == {freedom} and axis not in rows
    rows[axis if alone else None] = keyword, weights


def following(reader: Reader, deck: Deck) -> list[tuple[int, int, float]]:
    """Return nodes that follow others, these, and weights, by the rows of nodes.

    All are of second-order cells, and have the same weights and axes in all three directions.
    """
    row, entries = {label: i for i, label in enumerate(deck.nodes)}, []
    cells = [c for k, c in zip(deck.kinds, deck.cells, strict=True) if k in SECOND.values()]
    solid = {label for block in cells for cell in block for label in cell}
    for node, rows in reader.equations.items():
        keyword, weights = next(iter(rows.values()))
        nodes = {node, *weights}
        alike = weights and all(other == weights for _, other in rows.values())
        axes = {reader.turned.get(label) for label in nodes}
        if {*rows} == {0, 1, 2} and alike and len(axes) == 1 and nodes <= solid:
            entries += [(row[node], row[label], weight) for label, weight in weights.items()]
        else:
            reader.lack(keyword, _LOOSE)
    return entries
