"""The spring of the paper's section 6 on three levels: closed form, finite elements, whole loop."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from data.paper.part import (
    LEVELS,
    PAPER,
    Curve,
    Effort,
    Mask,
    PaperPart,
    Plot,
    ProgressCallback,
    Vector,
    worst_relative,
)
from data.paper.scenes import press
from tests.validation.clamped import shipped
from tests.validation.finding import Finding
from tests.validation.spring import PRINTED_14, Rod, rod_of
from wrenchbook.fea.solve import Solver
from wrenchbook.service.client import Client

# N/mm: the paper's stiffness by finite elements with its spread, and by its whole loop.
BAND, BAND_WIDTH, PAPER_LOOP = 0.582, 0.001, 0.585
FORMULA_13 = 0.59  # N/mm, as the paper rounds it
SMALL_LOAD = 2.0  # N: the range of the band; a spring softens as it is pressed
LOOP = 1e-6  # of the third level against the second
ROD_FORCE, ROD_ROTATION = 5e-3, 1e-2  # of the solver against rod theory, as of `make validate`
SMALL_SHORTENING = 1e-7  # m: rod theory is linear up to it
SOLVE_S = 300.0


@dataclass(frozen=True)
class Line:
    """A line by least squares, y = slope x + intercept."""

    slope: float
    intercept: float
    error: float  # standard error of the slope, by the scatter and the bend about the line
    points: int


def line_through(x: ArrayLike, y: ArrayLike) -> Line:
    """Return the line through n points, three or more, by ordinary least squares.

    Its error is sqrt(sum of squared residuals / (n - 2) / sum of (x - mean x)^2) (Draper and Smith,
    Applied Regression Analysis, section 1.4).

    Raises ValueError if there are fewer points, a number is not finite, or all x are the same.
    """
    across, up = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if across.shape != up.shape or across.ndim != 1 or len(across) < 3:
        shapes = f"{across.shape} and {up.shape}"
        raise ValueError(f"a line needs three points (x, y) or more, not x and y of shape {shapes}")
    if not (np.isfinite(across).all() and np.isfinite(up).all()):
        raise ValueError("the points of a line must be finite")
    centred = across - across.mean()
    spread = float(centred @ centred)
    if spread == 0.0:
        raise ValueError(f"all points of the line have the same x, {across[0]:g}")
    slope = float(centred @ (up - up.mean())) / spread
    intercept = float(up.mean() - slope * across.mean())
    residual = up - slope * across - intercept
    scatter = float(residual @ residual) / (len(across) - 2)
    return Line(slope, intercept, float(np.sqrt(scatter / spread)), len(across))


def spring(client: Client, effort: Effort, report: ProgressCallback) -> PaperPart:
    """Press the spring on three levels, and compare stiffness and turn."""
    part = PaperPart(
        "Spring on three levels (section 6, figures 8, 11 and 12)",
        "Guided along its axis, free to turn about it. Level 1 is rod theory (Love, article 271), "
        "level 2 a nonlinear solve a load, level 3 MuJoCo on the service's table, whose rows are "
        "the loads that a first run recorded (LM_direct) and had solved (LM_start). The stiffness "
        f"falls as the spring is pressed: the paper's band is for 0 to {SMALL_LOAD:g} N.",
    )
    component = shipped("spring")
    rod, solver = rod_of(component), Solver(component)
    report(0.0, "spring, recording")
    _record(client, effort)
    report(0.3, "spring, the loop on its table")
    run = press(client, "spring", effort.spring_loads)
    loads, looped = -run.wrenches[:, 2], _pressed(run.displacements)
    solved = np.empty((len(loads), 2))
    for number, wrench in enumerate(run.wrenches):
        report(0.3 + 0.7 * number / len(loads), f"spring, {loads[number]:.1f} N by finite elements")
        solved[number] = _pressed(solver.solve(wrench).displacement[None])[0]
    closed = np.array([_rod_under(rod, load) for load in loads])
    levels = dict(zip(LEVELS, (closed, solved, looped), strict=True))
    stopped = press(client, "spring", effort.spring_rows, mode="solve")  # its rows are there
    fits = {name: _fits(loads, moved[:, 0]) for name, moved in levels.items()}
    tangent = 1e-3 / float(solver.compliance[2, 2])
    rows = np.isin(effort.spring_loads, effort.spring_rows)
    part.findings = [*_stiffness(rod, fits, tangent), *_between(levels, run.covered)]
    part.findings.append(_direct(_pressed(stopped.displacements), solved[rows]))
    part.findings += _rotation_findings(loads, levels)
    part.numbers = {
        "load_N": loads.tolist(),
        "row": rows.tolist(),
        "covered": run.covered.tolist(),
        "answers_not_covered": run.not_covered,
        "tangent_k_N_per_mm": {"closed form": 1e-3 * _tangent(rod), "finite elements": tangent},
        "levels": _level_numbers(levels, fits),
    }
    part.plots = _plots(loads, levels, fits)
    return part


def _level_numbers(levels: dict[str, Vector], fits: dict[str, dict[str, Line]]) -> dict[str, Any]:
    """Return the curves, shape (n, 2), mm and degrees, and stiffness of each level for JSON."""
    return {
        name: {
            "shortening_mm": moved[:, 0].tolist(),
            "turn_deg": moved[:, 1].tolist(),
            "k_N_per_mm": {span: asdict(line) for span, line in fits[name].items()},
        }
        for name, moved in levels.items()
    }


def _record(client: Client, effort: Effort) -> None:
    """Record the wrenches of a loop on the rigid spring (LM_direct); solve them (LM_start)."""
    press(client, "spring", effort.spring_rows, mode="record")
    for job in client.start_recording("spring").jobs:
        client.wait(job, SOLVE_S)
    client.component("spring", wait_s=60)  # which waits for the rows


def _pressed(displacements: Vector) -> Vector:
    """Return shortening, mm, and turn, degrees, shape (n, 2), of displacements, m and rad."""
    return np.column_stack([-1e3 * displacements[:, 2], -np.degrees(displacements[:, 5])])


def _rod_under(rod: Rod, load: float) -> tuple[float, float]:
    """Return shortening, mm, and turn, degrees, of rod theory under a load, N."""
    if load < 1e-9:  # N: the equation below has its root at its end
        return 0.0, 0.0
    limit = 0.5 * rod.height
    solved: Any = brentq(lambda short: rod.pressed(short)[0] - load, 0.0, limit, xtol=1e-14)
    shortening = float(solved)
    return 1e3 * shortening, float(np.degrees(rod.pressed(shortening)[1]))


def _tangent(rod: Rod) -> float:
    """Return rod theory's stiffness at no load, N/m."""
    return rod.pressed(SMALL_SHORTENING)[0] / SMALL_SHORTENING


def _fits(loads: Vector, shortening: Vector) -> dict[str, Line]:
    """Fit force, N, over shortening, mm, shapes (n,), over all loads and over the small ones."""
    small = loads <= SMALL_LOAD * (1 + 1e-9)
    return {
        f"0 to {SMALL_LOAD:g} N": line_through(shortening[small], loads[small]),
        "0 to 10 N": line_through(shortening, loads),
    }


def _stiffness(rod: Rod, fits: dict[str, dict[str, Line]], tangent: float) -> list[Finding]:
    """Compare each level's stiffness, N/mm, with the paper's."""
    formula = rod.young / (2 * (1 + rod.poisson)) * rod.wire**4 / (8 * rod.turns * rod.mean**3)
    band = f"{PAPER}: {BAND} ± {BAND_WIDTH} by finite elements"
    by_formula, unloaded = "spring: k by formula 13, N/mm", "spring: k of a solve at no load, N/mm"
    findings = [
        Finding(by_formula, PAPER, FORMULA_13, 1e-3 * formula, 5e-3, "absolute"),
        Finding(unloaded, "rod theory", 1e-3 * _tangent(rod), tangent, ROD_FORCE),
        Finding(unloaded, band, BAND, tangent, None, "absolute"),
    ]
    for level, spans in fits.items():
        for span, line in spans.items():
            quantity = f"spring: k, {level}, {span}, N/mm (standard error {line.error:.1g})"
            is_band = level != "closed form" and span != "0 to 10 N"
            width = BAND_WIDTH if is_band else None
            findings.append(Finding(quantity, band, BAND, line.slope, width, "absolute"))
    for span, line in fits[LEVELS[2]].items():
        quantity = f"spring: k, MuJoCo and service over finite elements, {span}"
        ratio = line.slope / fits[LEVELS[1]][span].slope
        findings.append(Finding(quantity, LEVELS[1], 1.0, ratio, LOOP))
    loop = fits[LEVELS[2]]["0 to 10 N"]
    source = f"{PAPER}: 0.585 ± 0.003, whole loop"
    findings.append(
        Finding("spring: k, MuJoCo and service, 0 to 10 N, N/mm", source, PAPER_LOOP, loop.slope)
    )
    return findings


def _between(levels: dict[str, Vector], covered: Mask) -> list[Finding]:
    """Compare the third level with the second, shapes (n, 2), mm and degrees.

    The rotation is compared with its largest value: the solves end at 1e-6 of the displacement,
    which is large against the rotation under small loads. The error of each rotation is reported.
    So is the rotation of answers that are not covered: those are estimates with error bars.
    """
    _, solved, looped = levels.values()
    findings = []
    for region, chosen in (("where covered", covered), ("where not covered", ~covered)):
        if not solved[chosen].any():
            continue
        shortening = worst_relative(looped[chosen, 0], solved[chosen, 0])
        rotation = float(np.abs(looped[chosen, 1] - solved[chosen, 1]).max() / solved[:, 1].max())
        relative = worst_relative(looped[chosen, 1], solved[chosen, 1])
        for quantity, error, limit in (
            ("shortening, worst relative", shortening, LOOP),
            ("turn, worst over the largest turn", rotation, LOOP if chosen is covered else None),
            ("turn, worst relative", relative, None),
        ):
            name = f"spring: {quantity}, MuJoCo and service {region}"
            findings.append(Finding(name, LEVELS[1], 0.0, error, limit, "absolute"))
    return findings


def _direct(stopped: Vector, solved: Vector) -> Finding:
    """Compare the loop that stops for a solve with the second level, (n, 2), mm and degrees."""
    error = max(worst_relative(stopped[:, column], solved[:, column]) for column in (0, 1))
    name = "spring: shortening and turn, the loop by DirectFEA, worst relative"
    return Finding(name, LEVELS[1], 0.0, error, LOOP, "absolute")


def _rotation_findings(loads: Vector, levels: dict[str, Vector]) -> list[Finding]:
    """Compare the turn under the largest load, N, with rod theory and the printed formula."""
    closed, solved, _ = levels.values()
    printed = float(np.interp(PRINTED_14[0][-1], *PRINTED_14))
    by_rod = float(np.interp(PRINTED_14[0][-1], closed[:, 0], closed[:, 1]))
    largest = f"spring: turn at {loads[-1]:.3g} N, degrees"
    as_printed = "spring: turn at 17 mm by formula 14 as printed, degrees"
    return [
        Finding(largest, "rod theory", closed[-1, 1], solved[-1, 1], ROD_ROTATION),
        Finding(as_printed, "rod theory", by_rod, printed),
    ]


def _plots(
    loads: Vector, levels: dict[str, Vector], fits: dict[str, dict[str, Line]]
) -> list[Plot]:
    """Draw figures 8, 11 and 12: loads have shape (n,), N, levels (n, 2), mm and degrees."""
    styles = dict(zip(LEVELS, ("line", "points", "crosses"), strict=True))
    force = {
        name: Curve.of(name, moved[:, 0], loads, styles[name]) for name, moved in levels.items()
    }
    line = fits[LEVELS[2]]["0 to 10 N"]
    ends = np.array([0.0, levels[LEVELS[2]][-1, 0]])
    label = f"k = {line.slope:.4f} ± {line.error:.1g} N/mm"
    fitted = Curve.of(label, ends, line.slope * ends + line.intercept, "dash")
    turns = [Curve.of(name, loads, moved[:, 1], styles[name]) for name, moved in levels.items()]
    shown = levels[LEVELS[0]]
    forces_14 = np.interp(PRINTED_14[0], shown[:, 0], loads)
    printed = Curve.of("formula 14 as printed", forces_14, PRINTED_14[1], "dash")
    by_rod, by_solver, in_loop = force.values()
    titles = (
        "Figure 8: force against shortening, solver and rod theory",
        "Figure 11: force against shortening in the whole loop, with its line",
        "Figure 12: turn against force",
    )
    return [
        Plot(titles[0], "shortening, mm", "force, N", (by_rod, by_solver)),
        Plot(titles[1], "shortening, mm", "force, N", (by_solver, in_loop, fitted)),
        Plot(titles[2], "force, N", "turn, degrees", (*turns, printed)),
    ]
