"""The same mesh solved by CalculiX, if its program ``ccx`` is installed; cases that compare."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.validation.clamped import attached
from tests.validation.finding import Finding
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.coupling.coupling import each_interface
from wrenchbook.fea.export.calculix import deck_of, further_placeholder, placeholders
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.tensors import spin_per_vector

_TIGHT = "*CONTROLS, PARAMETERS=FIELD\n1e-7, 1e-7\n"
_ENDING = "*NODE PRINT"
PROGRAM = "ccx"
ABSENT = "ccx is not installed"


class CalculixResult(NamedTuple):
    """What ccx found.

    Attributes
    ----------
    displacement
        Shape (6 i,), m and rad: of the i interfaces.
    seconds
        Wall time.
    """

    displacement: NDArray[np.float64]
    seconds: float


def installed() -> bool:
    """Return whether there is a ``ccx`` to run."""
    return shutil.which(PROGRAM) is not None


def solve_rigid(
    part: ComponentModel,
    wrench: Sequence[float],
    rotation: NDArray[np.float64] | None = None,
    *,
    tight: bool = True,
    timeout: float = 600.0,
) -> CalculixResult:
    """Solve a component with a rigid coupling.

    Parameters
    ----------
    part
        In any analysis; CalculiX follows it.
    wrench
        Shape (6 i,), N and N·m, and the further inputs behind.
    rotation
        The rotation vectors that the answer will have, shape (i, 3) or (3,), rad: CalculiX takes
        the moment that works on one, m = J_left(rotation)^T M. None where they are small.
    tight
        Nonlinear: converge to 1e-7 instead of CalculiX's default, which leaves up to 5e-3 in small
        rotations.
    timeout
        Seconds.

    Raises
    ------
    RuntimeError
        If ccx ends without an answer.
    """
    loads, further = np.split(np.array(wrench, dtype=float), [6 * len(part.interfaces)])
    if rotation is not None:
        for own, turn in zip(each_interface(loads), np.atleast_2d(rotation), strict=True):
            own[3:] = spin_per_vector(turn).T @ own[3:]
    deck, places = deck_of(part), [interface.name for interface in part.interfaces]
    for name, own in zip(places, each_interface(loads), strict=True):
        for placeholder, load in zip(placeholders(name), own, strict=True):
            deck = deck.replace(placeholder, f"{load:.12e}")
    for one, value in zip(part.further, further, strict=True):
        deck = deck.replace(further_placeholder(one.name), f"{value:.12e}")
    rows, seconds = _run(deck if tight else deck.replace(_TIGHT, ""), timeout)
    first = len(part.mesh.points) + 1
    return CalculixResult(
        np.concatenate([rows[first + i] for i in range(2 * len(places))]), seconds
    )


def solve_distributed(
    part: ComponentModel, wrench: Sequence[float], timeout: float = 600.0
) -> CalculixResult:
    """Solve a component with a distributed coupling in linear analysis.

    CalculiX reports no motion of its own distributing coupling and takes no moment there. So the
    wrench goes in as nodal forces w_i (F + m x rho_i), area-weighted, and the interface
    displacement is the least-squares rigid motion of the section's nodes.
    """
    weights = part.interfaces[0].section.weights / part.interfaces[0].section.weights.sum()
    places = (part.mesh.points - part.interfaces[0].point) @ part.axes.T
    own = places[part.interfaces[0].section.node_ids]
    centre = weights @ own
    arms = own - centre
    inertia = (weights * (arms**2).sum(axis=1)).sum() * np.eye(3) - (arms.T * weights) @ arms
    force, moment = np.split(np.array(wrench, dtype=float), 2)
    spin = np.linalg.solve(inertia, moment - np.cross(centre, force))
    loads = weights[:, None] * (force + np.cross(spin, arms))
    rows, seconds = _run(_with_loads(part, loads), timeout)
    moved = np.array([rows[int(node) + 1] for node in part.interfaces[0].section.node_ids])
    rotation = np.linalg.solve(inertia, weights @ np.cross(arms, moved))
    return CalculixResult(
        np.concatenate([weights @ moved - np.cross(rotation, centre), rotation]), seconds
    )


def _with_loads(part: ComponentModel, loads: NDArray[np.float64]) -> str:
    """Return the deck with nodal loads, shape (k, 3), N, in place of the rigid body."""
    linear = replace(part.analysis, nonlinear=False)
    deck = deck_of(attached(replace(part, analysis=linear), coupling="rigid"))
    above = deck[: deck.rindex("*CLOAD")].splitlines()
    lines = [line for line in above if not line.startswith("*RIGID BODY, NSET=SECTION")]
    lines.append("*CLOAD")
    for node, load in zip(part.interfaces[0].section.node_ids + 1, loads, strict=True):
        lines += [f"{node}, {i + 1}, {load[i]:.12e}" for i in range(3)]
    return "\n".join([*lines, f"{_ENDING}, NSET=SECTION", "U", "*END STEP"]) + "\n"


def _run(deck: str, timeout: float) -> tuple[dict[int, list[float]], float]:
    """Run one deck on one thread; return the last printed row of each node, and the seconds."""
    threads = {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "job.inp").write_text(deck, encoding="utf-8")
        started = time.perf_counter()
        done = subprocess.run(
            [PROGRAM, "job"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=timeout,
            env={**os.environ, **threads},
            check=False,
        )
        seconds = time.perf_counter() - started
        printed = folder / "job.dat"
        rows = _rows(printed.read_text(encoding="utf-8")) if printed.exists() else {}
    if not rows or "job finished" not in done.stdout.lower():
        raise RuntimeError(f"ccx ended without an answer:\n{done.stdout[-2000:]}")
    return rows, seconds


def _rows(text: str) -> dict[int, list[float]]:
    texts = (line.split() for line in text.splitlines())
    return {int(w[0]): [float(x) for x in w[1:]] for w in texts if len(w) == 4 and w[0].isdigit()}


LINEAR, NONLINEAR = 1e-5, 1e-4
"""Relative difference allowed in each of the six components."""

_SOURCE = "CalculiX ccx, tolerance 1e-7"


def same_mesh(
    name: str, part: ComponentModel, wrench: Sequence[float], *, nonlinear: bool
) -> Iterator[Finding]:
    """Compare one solve on one mesh: the largest relative difference of the six components."""
    part = replace(part, analysis=replace(part.analysis, nonlinear=nonlinear))
    kind = "nonlinear" if nonlinear else "linear"
    quantity = f"{name}, {part.interfaces[0].coupling}, {kind}: worst of six components, relative"
    if not installed():
        yield Finding(quantity, _SOURCE, missing=ABSENT)
        return
    result = Solver(part).solve(wrench).displacement
    if part.interfaces[0].coupling == "rigid":
        reply = solve_rigid(part, wrench, result[3:] if nonlinear else None)
    else:
        reply = solve_distributed(part, wrench)
    tolerance = NONLINEAR if nonlinear else LINEAR
    gap = worst_gap(result, reply.displacement)
    yield Finding(quantity, _SOURCE, 0.0, gap, tolerance, "absolute")


def worst_gap(result: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Return the largest relative difference of two displacements, shape (6,), m and rad.

    Both are exactly zero in what a guide holds.
    """
    zero = (result == 0) & (expected == 0)
    scale = np.where(zero, 1.0, np.abs(expected))
    return float(np.abs((result - expected) / scale).max())
