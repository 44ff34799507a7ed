"""A user's own component by CalculiX too.

``python -m tests.validation.second_opinion FOLDER`` runs it.

The same mesh, materials, supports and loads, each solver on its own: a table of the differences,
and status 1 if one is beyond its tolerance. CalculiX does not report the motion of a distributing
coupling. A linear component with one is loaded by the nodal forces it stands for; a nonlinear one
is compared with its section made rigid in both.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.validation import calculix
from tests.validation.calculix import LINEAR, NONLINEAR
from tests.validation.clamped import attached
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.component import ComponentModel, build
from wrenchbook.fea.element.pressure_projection import projects
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import FREEDOMS

TIMEOUT = 3600.0
"""Seconds that CalculiX may take for one wrench."""


@dataclass(frozen=True)
class Opinion:
    """One wrench in both solvers.

    Attributes
    ----------
    wrench
        Six numbers, N and N·m.
    found, calculix
        The two displacements, m and rad; empty where `failed` says why.
    difference
        The largest over the three translations relative to the largest of them, or the same of the
        rotations, whichever is more.
    tolerance
        The most that it may be.
    seconds, calculix_seconds
        What each took.
    """

    wrench: tuple[float, ...]
    found: tuple[float, ...] = ()
    calculix: tuple[float, ...] = ()
    difference: float = math.inf
    tolerance: float = LINEAR
    seconds: float = 0.0
    calculix_seconds: float = 0.0
    failed: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the difference is within the tolerance."""
        return self.difference <= self.tolerance


def comparable(part: ComponentModel) -> tuple[ComponentModel, tuple[str, ...]]:
    """Return the component that both can solve, and how it differs from the user's."""
    if part.bolts:  # a deck's displacements count from before they are tightened
        part = replace(part, analysis=replace(part.analysis, zero="untightened"))
    turning = any(joint.stiffness is not None for joint in part.joints)
    notes = ("axes of springs between groups turn with the first group, but not in CalculiX",)
    notes = notes if turning and part.analysis.nonlinear else ()
    if part.interfaces[0].coupling == "rigid" or not part.analysis.nonlinear:
        return part, notes
    notes += (
        "CalculiX does not report the motion of a distributing coupling: both solve the component "
        'with coupling = "rigid" in its place, so the answers are not those of the component',
    )
    return attached(part, coupling="rigid"), notes


def second_opinion(solver: Solver, wrench: Sequence[float], timeout: float = TIMEOUT) -> Opinion:
    """Solve one wrench with both.

    Parameters
    ----------
    solver
        Of a component from `comparable`.
    wrench
        Shape (6,), N and N·m.
    timeout
        Seconds for CalculiX.
    """
    part, loads = solver.component, tuple(float(load) for load in wrench)
    nonlinear = part.analysis.nonlinear
    tolerance = NONLINEAR if nonlinear else LINEAR
    try:
        own = solver.solve(loads)
        if part.interfaces[0].coupling == "rigid":
            rotation = own.displacement[3:] if nonlinear else None
            reply = calculix.solve_rigid(part, loads, rotation, timeout=timeout)
        else:
            reply = calculix.solve_distributed(part, loads, timeout=timeout)
    except SolveFailed as error:
        return Opinion(loads, tolerance=tolerance, failed=f"not solved: {error}")
    except (BundleError, RuntimeError, subprocess.TimeoutExpired) as error:
        return Opinion(loads, tolerance=tolerance, failed=str(error))
    return Opinion(
        loads,
        tuple(own.displacement.tolist()),
        tuple(reply.displacement.tolist()),
        difference(own.displacement, reply.displacement),
        tolerance,
        own.seconds,
        reply.seconds,
    )


def difference(result: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Return the largest difference relative to the largest of its kind, shapes (6,), m and rad."""
    worst = 0.0
    for kind in (slice(0, 3), slice(3, 6)):
        size = np.abs(expected[kind]).max()
        gap = np.abs(result[kind] - expected[kind]).max()
        if gap > 0:
            worst = max(worst, float(gap / size) if size > 0 else math.inf)
    return worst


def chosen_wrenches(part: ComponentModel, texts: Sequence[str]) -> list[tuple[float, ...]]:
    """Return the wrenches that the texts tell; without any, half the range's upper bounds.

    Raises
    ------
    ValueError
        If one is not six finite numbers.
    """
    if not texts:
        return [tuple((0.5 * part.bundle.range.high).tolist())]
    return [_six(text) for text in texts]


def _six(text: str) -> tuple[float, ...]:
    try:
        loads = tuple(float(word) for word in text.split(","))
    except ValueError:
        loads = ()
    if len(loads) != 6 or not all(map(math.isfinite, loads)):
        raise ValueError(
            f'--wrench "{text}" is not six numbers Fx,Fy,Fz,Mx,My,Mz in N and N·m, such as '
            "0,0,-500,10,0,0"
        )
    return loads


def table(opinion: Opinion) -> str:
    """Return one wrench's differences as lines for people."""
    loads = ", ".join(f"{load:g}" for load in opinion.wrench)
    lines = [f"\nwrench ({loads}) N, N·m"]
    if opinion.failed:
        return "\n".join([*lines, f"  {opinion.failed}"])
    lines.append(f"  {'':<4} {'here':>15} {'CalculiX':>15} {'difference':>12} {'relative':>9}")
    for i, name in enumerate(FREEDOMS):
        own, theirs = opinion.found[i], opinion.calculix[i]
        size = max(map(abs, opinion.calculix[:3] if i < 3 else opinion.calculix[3:]))
        relative = f"{abs(own - theirs) / size:.1e}" if size > 0 else ""
        unit = "m" if i < 3 else "rad"
        lines.append(
            f"  {name:<4} {own:>15.7e} {theirs:>15.7e} {own - theirs:>12.2e} {relative:>9} {unit}"
        )
    verdict = "agrees" if opinion.agrees else "DIFFERS"
    return "\n".join(
        [
            *lines,
            f"  {verdict}: {opinion.difference:.1e} of the largest, at most "
            f"{opinion.tolerance:.0e}; {opinion.seconds:.2g} s here, "
            f"{opinion.calculix_seconds:.2g} s in CalculiX",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare the bundle that the arguments name; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.validation.second_opinion")
    parser.add_argument("--wrench", action="append", default=[], metavar="FX,FY,FZ,MX,MY,MZ")
    parser.add_argument("--timeout", type=float, default=TIMEOUT, help="s for each CalculiX run")
    parser.add_argument("--json", action="store_true", help="print one JSON array")
    parser.add_argument("folder", type=Path)
    options = parser.parse_args(arguments)
    try:
        solver, wrenches, notes = _made_ready(options.folder, options.wrench)
    except (BundleError, SolveFailed, ValueError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    opinions = []
    for note in () if options.json else notes:
        print(f"note: {note}")
    for wrench in wrenches:
        opinions.append(second_opinion(solver, wrench, options.timeout))
        if not options.json:
            print(table(opinions[-1]), flush=True)
    if options.json:
        rows = [asdict(opinion) | {"agrees": opinion.agrees} for opinion in opinions]
        print(json.dumps([row | {"difference": _number(row["difference"])} for row in rows]))
    return 0 if all(opinion.agrees for opinion in opinions) else 1


def _made_ready(
    folder: Path, texts: Sequence[str]
) -> tuple[Solver, list[tuple[float, ...]], list[str]]:
    if not calculix.installed():
        raise RuntimeError(f"{calculix.ABSENT}: on Debian and Ubuntu apt-get install calculix-ccx")
    bundle = read_bundle(folder)
    if bundle.deck is not None:
        message = "answers in place of the embedded solver, so there is nothing to compare with"
        raise BundleError([BundleProblem("deck", message)])
    keys = ["interface" for _ in bundle.others] + [item.key for item in bundle.further]
    for key in keys[:1]:
        message = "comparisons of several interfaces or further inputs are not there yet"
        raise BundleError([BundleProblem(key, message)])
    part, notes = comparable(build(bundle))
    wrenches = chosen_wrenches(part, texts)
    deck_of(attached(part, coupling="rigid"))  # what CalculiX has no counterpart of, before a solve
    return Solver(part), wrenches, [*notes, *_projections(part)]


def _projections(part: ComponentModel) -> list[str]:
    ratios = np.array([material.poisson_ratio for material in part.materials])
    numbers = zip(part.mesh.blocks, part.material_of_cells, strict=True)
    cells = sum(int(projects(block, ratios[own]).sum()) for block, own in numbers)
    if not cells:
        return []
    return [
        f"{cells} cells of a nearly incompressible material have a pressure of their own here and "
        "none in CalculiX: on one mesh the two differ by some %, less on a finer one"
    ]


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


if __name__ == "__main__":
    sys.exit(main())
