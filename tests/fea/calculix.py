"""The same mesh solved by CalculiX, for comparison in tests."""

from __future__ import annotations

import os
import shutil
import subprocess

import numpy as np
import pytest

from wrenchbook.fea.tensors import spin_per_vector

ELEMENTS = {"hex20": "C3D20R", "tet10": "C3D10"}
# Corner numbers of the faces S1 to S6 of a hexahedron.
FACES = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
FREEDOMS = ("ux", "uy", "uz", "rx", "ry", "rz")


def require_ccx():
    """Skip where CalculiX is not installed; in CI that is a failure."""
    if shutil.which("ccx") is None:
        if os.environ.get("CI") == "true":
            pytest.fail("CI needs the CalculiX solver: Debian package calculix-ccx")
        pytest.skip("the CalculiX solver ccx is not installed (Debian package calculix-ccx)")


def solve(part, wrench, folder, *, nonlinear=False):
    """Solve a component with ccx.

    `wrench` is what CalculiX takes: its moment is conjugate to the rotation vector.

    Returns
    -------
    displacement
        Shape (6,): of the reference node; zeros for a distributed coupling, which CalculiX does
        not report.
    nodes
        Shape (n, 3), m.
    """
    rows = printed(deck_lines(part, wrench, nonlinear), folder)
    moved = {int(row[0]): [float(word) for word in row[1:]] for row in rows if len(row) == 4}
    count = len(part.mesh.points)
    nodes = np.array([moved[i + 1] for i in range(count)])
    return np.array(moved[count + 1] + moved[count + 2]), nodes


def conjugate(wrench, displacement):
    """Return the wrench that CalculiX is told: its moment works on the rotation vector."""
    reported = np.array(wrench, dtype=float)
    reported[3:] = spin_per_vector(displacement[3:]).T @ reported[3:]
    return reported


def stresses(part, wrench, folder, *, nonlinear):
    """Return the stresses at C3D20R's or C3D10's integration points, (p, 6), in our order."""
    lines = deck_lines(part, wrench, nonlinear)
    lines.insert(lines.index("*END STEP"), "*EL PRINT, ELSET=EALL\nS")
    result = [row[2:] for row in printed(lines, folder) if len(row) == 8]
    (block,) = part.mesh.blocks
    points = {"hex20": 8, "tet10": 4}[block.kind] * len(block)
    stress = np.array(result, dtype=float)[-points:]
    if block.kind == "hex20":  # CalculiX counts its points along x first, we along z
        stress = stress.reshape(-1, 2, 2, 2, 6).transpose(0, 3, 2, 1, 4)
    return stress.reshape(-1, 6)


def printed(lines, folder):
    """Run a deck; return the rows of words that it prints."""
    (folder / "job.inp").write_text("\n".join(lines) + "\n")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        ["ccx", "job"], cwd=folder, capture_output=True, text=True, env=environment
    )
    rows = [line.split() for line in (folder / "job.dat").read_text().splitlines()]
    assert rows, done.stdout[-2000:]
    return [row for row in rows if row and row[0].isdigit()]


def deck_lines(part, wrench, nonlinear=False):
    """Return a deck that prints all nodes, written without the program's own export."""
    return [*_deck(part, wrench, nonlinear)]


def _deck(part, wrench, nonlinear):
    mesh, count = part.mesh, len(part.mesh.points)
    (block,) = mesh.blocks
    (material,) = part.materials
    points = [*mesh.points, part.interfaces[0].point, part.interfaces[0].point]
    yield "*NODE, NSET=NALL"
    yield from (f"{i + 1}," + ",".join(f"{x:.12e}" for x in p) for i, p in enumerate(points))
    yield f"*ELEMENT, TYPE={ELEMENTS[block.kind]}, ELSET=EALL"
    for i, cell in enumerate(block.nodes + 1):
        words = [str(i + 1), *map(str, cell)]
        yield from [",".join(words[:11]) + ",", ",".join(words[11:])]
    yield "*MATERIAL, NAME=M"
    yield "*ELASTIC"
    yield f"{material.youngs_modulus:.12e},{material.poisson_ratio}"
    yield "*SOLID SECTION, ELSET=EALL, MATERIAL=M"
    yield from ["*NSET, NSET=FIX", *(f"{i + 1}," for i in part.fixed_nodes)]
    yield from ["*NSET, NSET=SEC", *(f"{i + 1}," for i in part.interfaces[0].section.node_ids)]
    yield from ["*BOUNDARY", "FIX,1,3"]
    yield from _coupling(part, block, count)
    for name in part.interfaces[0].locked:
        freedom = FREEDOMS.index(name)
        yield f"*BOUNDARY\n{count + 1 + freedom // 3},{freedom % 3 + 1},{freedom % 3 + 1}"
    yield "*STEP, NLGEOM, INC=200" if nonlinear else "*STEP"
    yield "*STATIC"
    if nonlinear:
        yield from ["0.25,1.,1e-5,0.25", "*CONTROLS, PARAMETERS=FIELD", "1e-7,1e-7"]
    yield "*CLOAD"
    for freedom, load in enumerate(wrench):
        if load:
            yield f"{count + 1 + freedom // 3},{freedom % 3 + 1},{load:.12e}"
    yield from ["*NODE PRINT, NSET=NALL", "U", "*END STEP"]


def _coupling(part, block, count):
    if part.interfaces[0].coupling == "rigid":
        yield f"*RIGID BODY, NSET=SEC, REF NODE={count + 1}, ROT NODE={count + 2}"
        return
    inside = set(part.interfaces[0].section.node_ids.tolist())
    yield "*SURFACE, NAME=SURF, TYPE=ELEMENT"
    for i, cell in enumerate(block.nodes):
        for side, corners in enumerate(FACES):
            if all(int(cell[c]) in inside for c in corners):
                yield f"{i + 1},S{side + 1}"
    yield f"*COUPLING, REF NODE={count + 1}, SURFACE=SURF, CONSTRAINT NAME=C1"
    yield from ["*DISTRIBUTING", "1,3"]
