"""Writing a mesh with its groups as an Abaqus or CalculiX deck, which `read_inp` reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from wrenchbook.fea.mesh.mesh import Mesh

_TYPES = {
    "hex8": "C3D8",
    "tet4": "C3D4",
    "tet10": "C3D10",
    "wedge6": "C3D6",
    "wedge15": "C3D15",
    "pyramid5": "C3D5",
    "pyramid13": "C3D13",
    "tri3": "S3",
    "quad4": "S4",
    "tri6": "STRI65",
    "quad8": "S8R",
}


def deck_lines(mesh: Mesh, metres: float, integration: str = "reduced") -> Iterator[str]:
    """Yield the lines of a deck: nodes, elements, regions, facet groups as shells, node groups.

    Parameters
    ----------
    mesh
        Of cells that Abaqus has: no hex27.
    metres
        The deck's length unit in metres.
    integration
        Of 20-node hexahedra: "reduced" (C3D20R) or "full" (C3D20).
    """
    types = _TYPES | {"hex20": "C3D20R" if integration == "reduced" else "C3D20"}
    yield "*NODE"
    places = (mesh.points / metres).tolist()
    yield from (f"{i}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in enumerate(places, 1))
    first, starts = 1, []
    for block in mesh.blocks:
        yield f"*ELEMENT, TYPE={types[block.kind]}"
        starts.append(first)
        for cell in block.nodes + 1:
            yield from _rows([first, *cell.tolist()], ",")
            first += 1
    for name, regions in mesh.regions.items():
        yield f"*ELSET, ELSET={name}"
        yield from _rows(np.concatenate([s + r for s, r in zip(starts, regions, strict=True)]))
    for name, group in mesh.facet_groups.items():
        for kind, nodes in group.blocks:
            yield f"*ELEMENT, TYPE={types[kind]}, ELSET={name}"
            for facet in nodes + 1:
                yield from _rows([first, *facet.tolist()], ",")
                first += 1
    for name, nodes in mesh.node_groups.items():
        yield f"*NSET, NSET={name}"
        yield from _rows(nodes + 1)


def _rows(numbers: Iterable[int], more: str = "") -> Iterator[str]:
    """Yield whole numbers, ten a line; `more` ends each line but the last."""
    words = [str(number) for number in numbers]
    ends = range(0, len(words), 10)
    yield from (", ".join(words[i : i + 10]) + more * (i + 10 < len(words)) for i in ends)
