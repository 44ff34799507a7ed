"""Rows of decks; `*.inp`, `*.bdf` and `*.cdb` beside it are one part as five CAE tools write it.

A block of 20 x 20 x 60 mm, aluminium, in mm, N and MPa, held at z = 0, with 50 N and 800 N·mm on a
point 20 mm above its other end. Layout and words are those of Abaqus/CAE (parts and instances), of
HyperMesh (orphan mesh), of PrePoMax (CalculiX), of Patran (Nastran) and of Ansys' CDWRITE.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.fea.boxes import box
from wrenchbook.fea.mesh.mesh import Mesh

HERE = Path(__file__).parent
HEX = box("hex20", (2, 2, 4), (20.0, 20.0, 60.0))
TET = box("tet10", (1, 1, 3), (20.0, 20.0, 60.0))


def rows(values: Iterable[object], count: int = 16) -> list[str]:
    """Return values, so many a line."""
    words = [str(value) for value in values]
    parts = [", ".join(words[i : i + count]) for i in range(0, len(words), count)]
    return [part + "," for part in parts[:-1]] + parts[-1:]


def nodes(mesh: Mesh) -> list[str]:
    """Return the rows of ``*NODE``."""
    points = enumerate(mesh.points.tolist(), 1)
    return [f"{i:7d}, {x:12.6g}, {y:12.6g}, {z:12.6g}" for i, (x, y, z) in points]


def cells(mesh: Mesh) -> list[str]:
    """Return the rows of ``*ELEMENT``."""
    table = (mesh.blocks[0].nodes + 1).tolist()
    return [line for i, cell in enumerate(table, 1) for line in rows([i, *cell])]


def at(mesh: Mesh, place: float, axis: int = 2) -> list[int]:
    """Return the numbers of nodes at a place along an axis, mm."""
    return (np.flatnonzero(np.abs(mesh.points[:, axis] - place) < 1e-9) + 1).tolist()


def card(name: str, *fields: object) -> list[str]:
    """Return a small-field card with its continuations."""
    words = [str(each) for each in fields]
    lines = [words[i : i + 8] for i in range(0, len(words), 8)]
    heads = [name, *["+"] * (len(lines) - 1)]
    return [
        f"{head:8s}" + "".join(f"{each:>8s}" for each in line)
        for head, line in zip(heads, lines, strict=True)
    ]


def archive(mesh: Mesh, loads: str, order: list[int] | None = None, sets: str = "") -> str:
    """Return a mesh as an archive of Ansys; `order` has the nodes of a SOLID186 by the cell's."""
    lines = ["/PREP7", "ET,1,186", "NBLOCK,6,SOLID", "(3i9,6e21.13e3)"]
    for i, point in enumerate(mesh.points.tolist(), 1):
        lines.append(f"{i:9d}{0:9d}{0:9d}" + "".join(f"{x:21.13E}" for x in point))
    lines += ["N,R5.3,LOC,       -1,", "EBLOCK,19,SOLID,40,40", "(19i9)"]
    for i, cell in enumerate((mesh.blocks[0].nodes + 1).tolist(), 1):
        fields = [1, 1, 1, 1, 0, 0, 0, 0, 20, 0, i, *(cell[j] for j in order or range(20))]
        lines += ["".join(f"{n:9d}" for n in part) for part in (fields[:19], fields[19:])]
    return "\n".join(
        [*lines, f"{-1:9d}{sets}", "MP,EX,1,70000", "MP,PRXY,1,0.3", loads, "FINISH", ""]
    )
