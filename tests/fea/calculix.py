"""The same mesh solved by CalculiX, for comparison: all nodes, stresses, its own coupling."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from tests.validation.clamped import attached
from wrenchbook.fea.export.calculix import PLACEHOLDERS, deck_of
from wrenchbook.fea.tensors import spin_per_vector

# Corner numbers of the faces S1 to S6 of a hexahedron.
FACES = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]


def require_ccx():
    """Skip where CalculiX is not installed; in CI that is a failure."""
    if shutil.which("ccx") is None:
        if os.environ.get("CI") == "true":
            pytest.fail("CI needs the CalculiX solver: Debian package calculix-ccx")
        pytest.skip("the CalculiX solver ccx is not installed (Debian package calculix-ccx)")


def conjugate(wrench, displacement):
    """Return the wrench that CalculiX is told: its moment works on the rotation vector."""
    told = np.array(wrench, dtype=float)
    told[3:] = spin_per_vector(displacement[3:]).T @ told[3:]
    return told


def deck_lines(part, wrench, nonlinear=False):
    """Return a deck's lines, which prints all nodes; a distributed coupling is CalculiX's own."""
    analysis = replace(part.analysis, nonlinear=nonlinear)
    text = deck_of(attached(replace(part, analysis=analysis), coupling="rigid"))
    for place, load in zip(PLACEHOLDERS, wrench, strict=True):
        text = text.replace(place, f"{load:.12e}" if load else "")
    lines = [line for line in text.splitlines() if not re.fullmatch(r"(REF|ROT), \d, ", line)]
    lines.insert(lines.index("*NODE PRINT, NSET=REF"), "*NODE PRINT, NSET=ALL\nU")
    if part.interfaces[0].coupling == "distributed":
        place = lines.index(next(one for one in lines if one.startswith("*RIGID BODY")))
        inside, surface = set(part.interfaces[0].section.node_ids.tolist()), ["*SURFACE, NAME=SURF"]
        for i, cell in enumerate(part.mesh.blocks[0].nodes, 1):
            own = [side for side, face in enumerate(FACES, 1) if {*cell[list(face)]} <= inside]
            surface += [f"{i}, S{side}" for side in own]
        surface.append(f"*COUPLING, REF NODE={len(part.mesh.points) + 1}, SURFACE=SURF, "
                       "CONSTRAINT NAME=C1")  # fmt: skip
        lines[place : place + 1] = [*surface, "*DISTRIBUTING", "1,3"]
        # It takes loads of the node by its number alone.
        node = f"{len(part.mesh.points) + 1}, "
        lines = [re.sub("^REF, ", node, line) for line in lines]
    return lines


def printed(lines, folder):
    """Run a deck; return the rows of words that it prints."""
    (folder / "job.inp").write_text("\n".join(lines) + "\n")
    done = subprocess.run(
        ["ccx", "job"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=240,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    rows = [line.split() for line in (folder / "job.dat").read_text().splitlines()]
    assert rows, done.stdout[-2000:]
    return [row for row in rows if row and row[0].isdigit()]


def solve(part, wrench, folder, *, nonlinear=False):
    """Return the reference node's displacement, (6,), and those of all nodes, (n, 3), m.

    `wrench` is what CalculiX takes: its moment is conjugate to the rotation vector.
    """
    rows = printed(deck_lines(part, wrench, nonlinear), folder)
    moved = {int(row[0]): [float(word) for word in row[1:]] for row in rows if len(row) == 4}
    count = len(part.mesh.points)
    nodes = np.array([moved[i + 1] for i in range(count)])
    return np.array(moved[count + 1] + moved[count + 2]), nodes


def stresses(part, wrench, folder, *, nonlinear):
    """Return the stresses at C3D20R's or C3D10's integration points, (p, 6), in our order."""
    lines = deck_lines(part, wrench, nonlinear)
    lines.insert(lines.index("*END STEP"), "*EL PRINT, ELSET=E0\nS")
    found = [row[2:] for row in printed(lines, folder) if len(row) == 8]
    (block,) = part.mesh.blocks
    points = {"hex20": 8, "tet10": 4}[block.kind] * len(block)
    stress = np.array(found, dtype=float)[-points:]
    if block.kind == "hex20":  # CalculiX counts its points along x first, we along z
        stress = stress.reshape(-1, 2, 2, 2, 6).transpose(0, 3, 2, 1, 4)
    return stress.reshape(-1, 6)
