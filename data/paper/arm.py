"""Figure 10 of the paper: a robot on a plate, and its table against direct finite elements."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data.paper.part import (
    LOADS,
    OUTPUTS,
    Curve,
    Effort,
    Mask,
    PaperPart,
    Plot,
    ProgressCallback,
    Vector,
)
from data.paper.scenes import LoopRun, move_arm
from tests.validation.clamped import shipped
from tests.validation.finding import Finding
from wrenchbook.fea.solve import Solver
from wrenchbook.service.client import Client

METHODS = (None, "griddata")  # None: the table's own choice
# Of each output's range over the trajectory, worst output, RMS: an engineer's one per cent.
ERROR = 1e-2
INSIDE = 0.9  # of the errors lie within the error bars, which are 95 % ones
SMALL = 0.1  # of the largest of its kind: an output that the straight influence may not resolve
WIDER = 0.05  # of the span that each load had on the rigid plate
SOLVE_S = 600.0


@dataclass(frozen=True, eq=False)
class Check:
    """The errors of one method at k moments of the trajectory that are no rows of its table."""

    run: LoopRun  # the trajectory on the method's answers
    method: str
    chosen: NDArray[np.intp]  # (k,): indices of the moments
    answered: Vector  # (k, 6), m and rad
    bars: Vector  # (k, 6), m and rad
    solved: Vector  # (k, 6), m and rad
    # Median times, s, of an answer in this process, of one over HTTP, and of a solve.
    answer_s: float
    http_s: float
    solve_s: float

    @property
    def error(self) -> Vector:
        """Shape (k, 6), m and rad."""
        return np.abs(self.answered - self.solved)

    @property
    def span(self) -> Vector:
        """Range of each output over the solved moments, shape (6,), m and rad."""
        return np.ptp(self.solved, axis=0)

    @property
    def relative(self) -> Vector:
        """RMS error over the range of each output, shape (6,), dimensionless."""
        return np.sqrt(np.mean(self.error**2, axis=0)) / self.span

    @property
    def inside(self) -> float:
        """The part of all errors that lie within their error bars, dimensionless."""
        return float(np.mean(self.error <= self.bars))


def arm(client: Client, effort: Effort, report: ProgressCallback) -> PaperPart:
    """Move a six-joint arm on two plates, and compare its tables with direct solves."""
    part = PaperPart(
        "Robot on a plate (figure 10)",
        f"Six joints, 8 kg, {effort.arm_seconds:g} s past three postures, a wrench every 10 ms. "
        f"The first run is recorded on the rigid plate (LM_direct); at most {effort.arm_solves} of "
        "its wrenches are solved (LM_start), and the corners of what each axis met, which griddata "
        "needs: it knows nothing outside its rows. The same trajectory then runs on that table, by "
        f"its own method and by griddata; {effort.arm_checks} of its moments are solved directly.",
    )
    for number, name in enumerate(effort.plates):

        def progress(fraction: float, message: str, number: int = number, name: str = name) -> None:
            report((number + fraction) / len(effort.plates), f"arm on {name}, {message}")

        recorded, facts = _filled(client, name, effort, progress)
        checks = _checks(client, name, effort, progress)
        limits = np.repeat(list(client.component(name)["tolerance"].values()), 3)
        part.findings += _findings(name, checks, limits)
        part.numbers[name] = {**facts, **_numbers(checks, limits), "recorded": _trace(recorded)}
        part.plots += [*_wrench_plots(name, recorded), *_displacement_plots(name, checks)]
    return part


def _filled(
    client: Client, name: str, effort: Effort, report: ProgressCallback
) -> tuple[LoopRun, dict[str, Any]]:
    """Record the trajectory on the rigid component, and have the wrenches it met solved."""
    report(0.0, "recording")
    recorded = move_arm(client, name, effort.arm_seconds, mode="record")
    started = client.start_recording(name, effort.arm_solves)
    at_corners = [client.solve(name, wrench).job for wrench in corners(recorded.wrenches)]
    jobs = [*started.jobs, *(job for job in at_corners if job is not None)]
    for number, job in enumerate(jobs):
        report(0.7 * number / len(jobs), f"solve {number + 1} of {len(jobs)}")
        client.wait(job, SOLVE_S)
    rows = client.component(name, wait_s=60)["rows"]  # which waits for them
    return recorded, {"wrenches": len(recorded.times), "solves": len(jobs), "rows": rows}


def corners(wrenches: Vector) -> Vector:
    """Return the corners of each axis' loads in wrenches (n, 6), N and N·m: griddata's hull.

    Shape (m, 6), m at most 24: eight corners of F_i, M_j, M_k of each axis, the other loads zero.
    Each span holds zero and is wider by `WIDER`, since the plate bends under the arm.
    """
    low, high = np.minimum(wrenches.min(axis=0), 0.0), np.maximum(wrenches.max(axis=0), 0.0)
    wider = WIDER * (high - low)
    ends = np.array([low - wider, high + wider])
    points = []
    for axis in range(3):
        loads = [axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3]
        for chosen in product((0, 1), repeat=3):
            corner = np.zeros(6)
            corner[loads] = ends[np.array(chosen), np.array(loads)]
            points.append(corner)
    return np.unique(points, axis=0)


def _checks(client: Client, name: str, effort: Effort, report: ProgressCallback) -> list[Check]:
    """Run the trajectory by each method; solve moments of the first run directly, for both."""
    table = client.download(name)
    runs = [move_arm(table, name, effort.arm_seconds, method=method) for method in METHODS]
    # Odd places of as many equal parts: neither the first nor the last moment, at rest.
    steps = (2 * np.arange(effort.arm_checks) + 1) / (2 * effort.arm_checks)
    chosen = (steps * len(runs[0].times)).astype(np.intp)
    wrenches = runs[0].wrenches[chosen]
    solver, seconds, solved = Solver(shipped(name)), [], np.empty((len(chosen), 6))
    for number, wrench in enumerate(wrenches):
        report(0.7 + 0.3 * number / len(chosen), f"direct solve {number + 1} of {len(chosen)}")
        began = perf_counter()
        solved[number] = solver.solve(wrench).displacement
        seconds.append(perf_counter() - began)

    def over_http(wrench: Vector, method: str | None) -> Any:
        return client.displacement(name, wrench, on_thin="estimate", method=method)

    checks = []
    for method, run in zip(METHODS, runs, strict=True):
        batch = table.batch(wrenches, method=method)
        here = [_seconds_of(table.answer, wrench, method) for wrench in run.wrenches]
        there = [_seconds_of(over_http, wrench, method) for wrench in run.wrenches]
        times = (float(np.median(times_s)) for times_s in (here, there, seconds))
        answers = batch.displacements, batch.errors
        checks.append(Check(run, str(batch.method), chosen, *answers, solved, *times))
    return checks


def _seconds_of(ask: Any, wrench: Vector, method: str | None) -> float:
    """Return what one answer to a wrench, shape (6,), N and N·m, takes, s."""
    began = perf_counter()
    ask(wrench, method=method)
    return perf_counter() - began


def _findings(name: str, checks: list[Check], limits: Vector) -> list[Finding]:
    """Compare the default method with its bands; report griddata's. Limits: (6,), m and rad."""
    findings = []
    for check, is_band in zip(checks, (True, False), strict=True):
        worst = int(np.argmax(check.relative))
        label = f"arm on {name}, {check.method}"
        over = float((check.error / limits).max())
        for title, value, most in (
            (
                f"RMS error over range, worst output ({OUTPUTS[worst]})",
                check.relative[worst],
                ERROR,
            ),
            ("largest error over tolerance", over, 1.0),
        ):
            limit = most if is_band else None
            title = f"{label}: {title}"
            findings.append(Finding(title, "direct solves", 0.0, float(value), limit, "absolute"))
        title = f"{label}: part of the errors inside their error bars"
        findings.append(Finding(title, "95 % error bars", INSIDE, check.inside, 0.0, "at least"))
        title = f"{label}: a solve over an answer of the table, time"
        ratio = check.solve_s / check.answer_s
        findings.append(Finding(title, "run time", 1.0, ratio))
    return findings


def _numbers(checks: list[Check], limits: Vector) -> dict[str, Any]:
    """Return the figures of each method as JSON-able values; limits: shape (6,), m and rad."""
    return {
        "tolerance": limits.tolist(),
        "methods": {
            requested or "default": {
                "method": check.method,
                "coverage": dict(
                    zip(("covered", "thin", "outside", "unknown"), check.run.coverage, strict=True)
                ),
                "range": check.span.tolist(),
                "small": [OUTPUTS[place] for place in np.flatnonzero(_is_small(check.span))],
                "rms_over_range": check.relative.tolist(),
                "largest_error": check.error.max(axis=0).tolist(),
                "median_bar": np.median(check.bars, axis=0).tolist(),
                "inside_bars": np.mean(check.error <= check.bars, axis=0).tolist(),
                "answer_s": check.answer_s,
                "http_s": check.http_s,
                "solve_s": check.solve_s,
                "loop_s": check.run.wall_s,
                "solved": check.solved.tolist(),
                "answered": check.answered.tolist(),
                "run": _trace(check.run),
            }
            for requested, check in zip(METHODS, checks, strict=True)
        },
    }


def _is_small(span: Vector) -> Mask:
    """Return which outputs hardly move against the largest of their kind; (6,), m and rad."""
    return (span.reshape(2, 3) < SMALL * span.reshape(2, 3).max(axis=1)[:, None]).ravel()


def _trace(run: LoopRun) -> dict[str, Any]:
    """Return a run as JSON-able values: s; N and N·m; m and rad."""
    return {
        "time": run.times.tolist(),
        "wrench": run.wrenches.tolist(),
        "displacement": run.displacements.tolist(),
    }


def _wrench_plots(name: str, run: LoopRun) -> list[Plot]:
    """Draw figure 10a: forces and moments of the recorded run."""
    drawn = []
    for kind, unit, indices in (("forces", "N", range(3)), ("moments", "N·m", range(3, 6))):
        curves = tuple(Curve.of(LOADS[k], run.times, run.wrenches[:, k]) for k in indices)
        drawn.append(Plot(f"Figure 10a: {kind} on {name}", "time, s", f"{kind}, {unit}", curves))
    return drawn


def _displacement_plots(name: str, checks: list[Check]) -> list[Plot]:
    """Draw figure 10b: displacements of the table's own method, and of direct solves.

    Outputs that hardly move have a plot of their own, with griddata's: there the methods differ.
    """
    small = _is_small(checks[0].span)
    groups = (
        ("translation", "µm", 1e6, np.flatnonzero(~small[:3]), checks[:1]),
        ("rotation", "mrad", 1e3, np.flatnonzero(~small[3:]) + 3, checks[:1]),
        ("small translations", "µm", 1e6, np.flatnonzero(small[:3]), checks),
        ("small rotations", "mrad", 1e3, np.flatnonzero(small[3:]) + 3, checks),
    )
    return [
        Plot(
            f"Figure 10b: {kind} of {name}, interpolated and solved directly",
            "time, s",
            f"{kind}, {unit}",
            tuple(curve for k in indices for curve in _against_solves(shown, int(k), factor)),
        )
        for kind, unit, factor, indices, shown in groups
        if len(indices)
    ]


def _against_solves(checks: list[Check], output: int, factor: float) -> list[Curve]:
    """Return the curves of one output by each method, and the direct solves of the first."""
    curves = [
        Curve.of(
            f"{OUTPUTS[output]}, {check.method}",
            check.run.times,
            factor * check.run.displacements[:, output],
            "dash" if number else "line",
        )
        for number, check in enumerate(checks)
    ]
    first = checks[0]
    times, solved = first.run.times[first.chosen], factor * first.solved[:, output]
    return [*curves, Curve.of(f"{OUTPUTS[output]}, solved", times, solved, "points")]
