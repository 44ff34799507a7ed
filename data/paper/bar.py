"""Figure 2 of the paper: a bar with a load, in closed form, by finite elements, and in the loop."""

from __future__ import annotations

import numpy as np

from data.paper.part import (
    LEVELS,
    PAPER,
    Curve,
    Effort,
    PaperPart,
    Plot,
    ProgressCallback,
    Vector,
    worst_relative,
)
from data.paper.scenes import press
from tests.validation.clamped import shipped
from tests.validation.finding import Finding
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.solve import Solver
from wrenchbook.service.client import Client
from wrenchbook.service.client.rotation import rotation_matrix

LEVERS = (0.0, 0.1)  # m: as in the figure, and with a moment at the tip as well
# Euler's bar leaves out shear and the clamp's grip on lateral contraction: 0.2 % at this length.
CLOSED_FORM = 5e-3
LOOP = 1e-6  # of the third level against the second
ROUNDS = 12  # of the lever that moves as the bar bends: each leaves some 1e-3 of the error


def tip_load(client: Client, effort: Effort, report: ProgressCallback) -> PaperPart:
    """Load the bar, and compare deflection and rotation of its tip on three levels."""
    part = PaperPart(
        "Bar with a load (figure 2)",
        "Steel bar, 1 m, 20 x 20 mm, clamped: u_z = F L^3/(3 E I) + M L^2/(2 E I), r_y = F "
        "L^2/(2 E I) + M L/(E I). With a lever the load's moment changes as the bar bends, and "
        "every level settles with that.",
    )
    component = shipped("bar")
    compliances = euler(component), Solver(component).compliance
    client.displacement("bar", [0, 0, -50.0], on_thin="wait", wait_s=120)  # its one solve
    client.component("bar", wait_s=60)  # which waits for the row
    for number, lever in enumerate(LEVERS):
        report(number / len(LEVERS), f"bar, lever {lever:g} m")
        loads = np.array(effort.tip_loads)
        closed, solved = (coupled(matrix, loads, lever) for matrix in compliances)
        run = press(client, "bar", loads, lever)
        levels = dict(zip(LEVELS, (closed, solved, run.displacements), strict=True))
        part.findings += _findings(lever, levels)
        part.numbers[f"lever {lever:g} m"] = {
            "load_N": loads.tolist(),
            "answers_not_covered": run.not_covered,
            **{name: matrix[:, [2, 4]].tolist() for name, matrix in levels.items()},
        }
        part.plots += _plots(lever, loads, levels)
    return part


def euler(component: ComponentModel) -> Vector:
    """Return the closed form's compliance, shape (6, 6), m/N to rad/(N·m), for F_z and M_y.

    Figure 2: delta = F L^3/(3 E I), theta = F L^2/(2 E I); M L^2/(2 E I), M L/(E I).
    """
    length, width, height = np.ptp(component.mesh.points, axis=0).tolist()
    bending = component.materials[0].youngs_modulus * width * height**3 / 12
    compliance = np.zeros((6, 6))
    compliance[2, 2] = length**3 / (3 * bending)
    compliance[4, 4] = length / bending
    compliance[2, 4] = compliance[4, 2] = -(length**2) / (2 * bending)
    return compliance


def coupled(compliance: Vector, loads: Vector, lever: float) -> Vector:
    """Return the equilibrium displacements (n, 6), m and rad, of a linear component.

    The loads (n,), N, act downwards on a lever, m along x from the interface point, which moves and
    turns with the interface. The compliance (6, 6) is in m/N to rad/(N·m).
    """
    displacements = np.zeros((len(loads), 6))
    for row, load in enumerate(loads):
        force = np.array([0.0, 0.0, -load])
        for _ in range(ROUNDS):
            arm = rotation_matrix(displacements[row, 3:]) @ [lever, 0.0, 0.0]
            displacements[row] = compliance @ np.concatenate([force, np.cross(arm, force)])
    return displacements


def _findings(lever: float, levels: dict[str, Vector]) -> list[Finding]:
    """Compare each level with the one before it; shapes (n, 6), m and rad."""
    closed, solved, looped = levels.values()
    at = f"lever {lever:g} m"
    findings = []
    for output, name, unit in ((2, "u_z", "m"), (4, "r_y", "rad")):
        last = float(closed[-1, output]), float(solved[-1, output])
        source = f"closed form, {PAPER}, figure 2"
        findings.append(
            Finding(f"bar, {at}: {name} by finite elements, {unit}", source, *last, CLOSED_FORM)
        )
    largest = max(worst_relative(looped[:, output], solved[:, output]) for output in (2, 4))
    quantity = f"bar, {at}: MuJoCo and service, worst relative"
    findings.append(Finding(quantity, "finite elements", 0.0, largest, LOOP, "absolute"))
    return findings


def _plots(lever: float, loads: Vector, levels: dict[str, Vector]) -> list[Plot]:
    """Draw deflection and turn against load; loads have shape (n,), N, levels (n, 6), m and rad."""
    styles = ("line", "points", "crosses")
    drawn = []
    for output, name, unit, factor in (
        (2, "deflection -u_z", "mm", -1e3),
        (4, "turn r_y", "mrad", 1e3),
    ):
        curves = tuple(
            Curve.of(level, loads, factor * displacements[:, output], style)
            for (level, displacements), style in zip(levels.items(), styles, strict=True)
        )
        title = f"Figure 2: {name} of the bar, lever {lever:g} m"
        drawn.append(Plot(title, "load, N", f"{name}, {unit}", curves))
    return drawn
