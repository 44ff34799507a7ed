"""Writes the meshes of `link` and `hot_bracket`: ``python -m tests.fea.shipped_meshes``.

Both are hex20 on a lattice of cells, some of which are left out. They are mesh files, so that a
server without gmsh solves the parts.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count, pairwise, product
from pathlib import Path

import numpy as np

COMPONENTS = Path(__file__).parents[2] / "data" / "components"

# Nodes of hex20 on a lattice of half cells: corners, then midside nodes, as Abaqus counts them.
CORNERS = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)]
EDGES += [(0, 4), (1, 5), (2, 6), (3, 7)]
HEX20 = np.array([*CORNERS, *(np.add(CORNERS[a], CORNERS[b]) // 2 for a, b in EDGES)])

Sets = dict[str, Callable[[np.ndarray], np.ndarray]]
"""Node sets by name: which points, shape (n, 3), mm, are in it."""


def halves(ends: list[float], cells: list[int]) -> np.ndarray:
    """Return the lattice lines of intervals, each in so many cells, with lines half-way."""
    pairs = zip(pairwise(ends), cells, strict=True)
    parts = [np.linspace(a, b, 2 * n + 1)[1:] for (a, b), n in pairs]
    return np.concatenate(([ends[0]], *parts))


def written(title: str, cells: dict[str, list[np.ndarray]], sets: Sets) -> str:
    """Return an Abaqus file of cells, shape (20, 3) each, mm, by element set."""
    numbers: dict[tuple[float, ...], int] = {}
    lines, element = [], count(1)
    for name, own in cells.items():
        lines.append(f"*ELEMENT, TYPE=C3D20R, ELSET={name}")
        for cell in own:
            keys = [tuple((np.round(point, 4) + 0.0).tolist()) for point in cell]
            nodes = [str(numbers.setdefault(key, len(numbers) + 1)) for key in keys]
            lines += [f"{next(element)}," + ",".join(nodes[:10]) + ",", " " + ",".join(nodes[10:])]
    points = np.array(list(numbers))
    for name, inside in sets.items():
        lines.append(f"*NSET, NSET={name}")
        chosen = (np.flatnonzero(inside(points)) + 1).tolist()
        lines += [",".join(map(str, chosen[i : i + 16])) + "," for i in range(0, len(chosen), 16)]
    nodes = [f"{i},{x:g},{y:g},{z:g}" for i, (x, y, z) in enumerate(numbers, 1)]
    return "\n".join([f"** {title}", "*NODE", *nodes, *lines, ""])


def link() -> str:
    """Return the link: a tube of 25 x 1.5 mm along x, 350 mm long, flanges of 50 x 6 mm."""
    radii, around = halves([11, 12.5, 25], [1, 2]), np.linspace(0, 2 * np.pi, 25)
    along = halves([0, 6, 12, 175, 338, 344, 350], [1, 1, 6, 6, 1, 1])
    cells = []
    for i, j, k in product(range(3), range(12), range(16)):
        if i == 0 or k in (0, 15):
            r, angle, x = (np.array((2 * i, 2 * j, 2 * k)) + HEX20).T
            turn = around[angle]
            cells.append(
                np.column_stack((along[x], radii[r] * np.cos(turn), radii[r] * np.sin(turn)))
            )
    sets: Sets = {
        "left": lambda p: p[:, 0] == 0,
        "middle": lambda p: (p[:, 0] == 175) & (np.hypot(p[:, 1], p[:, 2]) > 12.4),
        "right": lambda p: p[:, 0] == 350,
    }
    return written("Link, mm: a tube with two flanges", {"aluminium": cells}, sets)


def hot_bracket() -> str:
    """Return the bracket: a steel angle of 3 mm, its arm under an aluminium plate of 3 mm."""
    x = halves([0, 3, 6, 80, 120], [1, 1, 10, 5])
    y = halves([-20, 20], [6])
    z = halves([-60, -6, 0, 3, 6], [6, 2, 1, 1])
    cells: dict[str, list[np.ndarray]] = {"steel": [], "aluminium": []}
    for i, j, k in product(range(17), range(6), range(10)):
        if k == 8 or (i == 0 and k < 8) or (k == 9 and i > 1):
            place = (np.array((2 * i, 2 * j, 2 * k)) + HEX20).T
            own = cells["aluminium" if k == 9 else "steel"]
            own.append(np.column_stack((x[place[0]], y[place[1]], z[place[2]])))
    sets: Sets = {
        "wall": lambda p: p[:, 0] == 0,
        "seat": lambda p: (p[:, 0] >= 80) & (p[:, 2] == 6),
    }
    return written("Bracket, mm: aluminium on a steel angle", cells, sets)


def main() -> None:
    """Write both files."""
    (COMPONENTS / "link" / "link.inp").write_text(link())
    (COMPONENTS / "hot_bracket" / "hot_bracket.inp").write_text(hot_bracket())


if __name__ == "__main__":
    main()
