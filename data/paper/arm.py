"""Figure 10 of the paper: a robot on a plate, with the plate's table against direct solves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data.paper.part import LOADS, Curve, Effort, Mask, PaperPart, Plot, ProgressCallback, Vector
from data.paper.scenes import LoopRun, move_arm
from tests.validation.clamped import shipped
from tests.validation.finding import Finding
from wrenchbook.fea.solve import Solver
from wrenchbook.service.client import Client
from wrenchbook.service.contract import OUTPUTS

METHODS = (None, "griddata")  # None: the table's own choice
# Largest RMS error of an output over its range in the trajectory: an engineer's one per cent.
MAX_ERROR = 1e-2
MIN_WITHIN_BARS = 0.9  # part of the errors within their error bars, which are 95 % ones
# Part of the largest output of its kind: the straight influence may not resolve a smaller one.
SMALL_OUTPUT = 0.1
MARGIN = 0.05  # part of the span that each load had on the rigid plate
SOLVE_S = 600.0  # time for one solve on a slow machine


@dataclass(frozen=True, eq=False)
class Check:
    """The errors of one method at k moments of the trajectory that are no rows of its table."""

    run: LoopRun  # the trajectory with the method's answers
    method: str
    moments: NDArray[np.intp]  # (k,): indices of the moments
    answered: Vector  # (k, 6), m and rad
    error_bars: Vector  # (k, 6), m and rad
    solved: Vector  # (k, 6), m and rad
    answer_s: float  # median time of an answer in this process
    http_s: float  # median time of an answer over HTTP
    solve_s: float  # median time of a solve

    @property
    def error(self) -> Vector:
        """Difference from the solves, shape (k, 6), m and rad."""
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
    def within_bars(self) -> Vector:
        """Part of each output's errors that lie within their error bars, shape (6,)."""
        return np.mean(self.error <= self.error_bars, axis=0)


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

    def report_plate(number: int, fraction: float, message: str) -> None:
        name = effort.plates[number]
        report((number + fraction) / len(effort.plates), f"arm on {name}, {message}")

    for number, name in enumerate(effort.plates):
        progress = partial(report_plate, number)
        recorded, counts = _record_and_solve(client, name, effort, progress)
        checks = _checks(client, name, effort, progress)
        limits = np.repeat(list(client.component(name)["tolerance"].values()), 3)
        part.findings += _findings(name, checks, limits)
        part.numbers[name] = {**counts, **_numbers(checks, limits), "recorded": _trace(recorded)}
        part.plots += _plots(name, recorded, checks)
    return part


def _record_and_solve(
    client: Client, name: str, effort: Effort, report: ProgressCallback
) -> tuple[LoopRun, dict[str, int]]:
    """Record the trajectory on the rigid plate, solve its wrenches; return it and the counts."""
    report(0.0, "recording")
    recorded = move_arm(client, name, effort.arm_seconds, mode="record")
    started = client.start_recording(name, effort.arm_solves)
    at_corners = [client.solve(name, wrench).job for wrench in corners(recorded.wrenches)]
    jobs = [*started.jobs, *(job for job in at_corners if job is not None)]
    for number, job in enumerate(jobs):
        report(0.7 * number / len(jobs), f"solve {number + 1} of {len(jobs)}")
        client.wait(job, SOLVE_S)
    rows = client.component(name, wait_s=60)["rows"]  # once the table has the solved rows
    return recorded, {"wrenches": len(recorded.times), "solves": len(jobs), "rows": rows}


def corners(wrenches: Vector) -> Vector:
    """Return the corners of each axis' loads in wrenches (n, 6), N and N·m: griddata's hull.

    Shape (m, 6), m at most 24: eight corners of F_i, M_j, M_k of each axis, the other loads zero.
    Each span holds zero and is wider by `MARGIN`, since the plate bends under the arm.
    """
    low, high = np.minimum(wrenches.min(axis=0), 0.0), np.maximum(wrenches.max(axis=0), 0.0)
    margin = MARGIN * (high - low)
    ends = np.array([low - margin, high + margin])
    points = []
    for axis in range(3):
        loads = [axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3]
        for sides in product((0, 1), repeat=3):
            corner = np.zeros(6)
            corner[loads] = ends[sides, loads]
            points.append(corner)
    return np.unique(points, axis=0)


def _checks(client: Client, name: str, effort: Effort, report: ProgressCallback) -> list[Check]:
    """Run the trajectory by each method; solve moments of the first run directly, for both."""
    table = client.download(name)
    runs = [move_arm(table, name, effort.arm_seconds, method=method) for method in METHODS]
    # The middles of equal parts: neither the first nor the last moment, at rest.
    middles = (2 * np.arange(effort.arm_checks) + 1) / (2 * effort.arm_checks)
    moments = (middles * len(runs[0].times)).astype(np.intp)
    wrenches = runs[0].wrenches[moments]
    solver, solved, solve_times = Solver(shipped(name)), np.empty((len(moments), 6)), []
    for number, wrench in enumerate(wrenches):
        report(0.7 + 0.3 * number / len(moments), f"direct solve {number + 1} of {len(moments)}")
        began = perf_counter()
        solved[number] = solver.solve(wrench).displacement
        solve_times.append(perf_counter() - began)

    checks = []
    for method, run in zip(METHODS, runs, strict=True):
        batch = table.batch(wrenches, method=method)
        over_http = partial(client.displacement, name, on_thin="estimate", method=method)
        check = Check(
            run=run,
            method=str(batch.method),
            moments=moments,
            answered=batch.displacements,
            error_bars=batch.errors,
            solved=solved,
            answer_s=_median_seconds(partial(table.answer, method=method), run.wrenches),
            http_s=_median_seconds(over_http, run.wrenches),
            solve_s=float(np.median(solve_times)),
        )
        checks.append(check)
    return checks


def _median_seconds(answer: Callable[[Vector], object], wrenches: Vector) -> float:
    """Return the median time of an answer to wrenches (n, 6), N and N·m, in seconds."""
    times = []
    for wrench in wrenches:
        began = perf_counter()
        answer(wrench)
        times.append(perf_counter() - began)
    return float(np.median(times))


def _findings(name: str, checks: list[Check], limits: Vector) -> list[Finding]:
    """Return the errors and times of each method; the default method's errors have a limit.

    limits: the tolerance of each output, shape (6,), m and rad.
    """
    findings = []
    for method, check in zip(METHODS, checks, strict=True):
        label = f"arm on {name}, {check.method}"
        worst = int(np.argmax(check.relative))
        rms = f"RMS error over range, worst output ({OUTPUTS[worst]})"
        over_tolerance = float((check.error / limits).max())
        for title, error, limit in (
            (rms, float(check.relative[worst]), MAX_ERROR),
            ("largest error over tolerance", over_tolerance, 1.0),
        ):
            tolerance = limit if method is None else None
            compared = f"{label}: {title}"
            findings.append(Finding(compared, "direct solves", 0.0, error, tolerance, "absolute"))
        title = f"{label}: part of the errors inside their error bars"
        within = float(check.within_bars.mean())
        findings.append(Finding(title, "95 % error bars", MIN_WITHIN_BARS, within, 0.0, "at least"))
        title = f"{label}: a solve over an answer of the table, time"
        findings.append(Finding(title, "run time", 1.0, check.solve_s / check.answer_s))
    return findings


def _numbers(checks: list[Check], limits: Vector) -> dict[str, Any]:
    """Return the numbers of each method for JSON; limits: shape (6,), m and rad."""
    return {
        "tolerance": limits.tolist(),
        "methods": {
            requested or "default": {
                "method": check.method,
                "coverage": check.run.coverage,
                "range": check.span.tolist(),
                "small": [OUTPUTS[output] for output in np.flatnonzero(_is_small(check.span))],
                "rms_over_range": check.relative.tolist(),
                "largest_error": check.error.max(axis=0).tolist(),
                "median_bar": np.median(check.error_bars, axis=0).tolist(),
                "inside_bars": check.within_bars.tolist(),
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
    """Return which outputs move little against the largest of their kind; (6,), m and rad."""
    by_kind = span.reshape(2, 3)
    return (by_kind < SMALL_OUTPUT * by_kind.max(axis=1, keepdims=True)).ravel()


def _trace(run: LoopRun) -> dict[str, Any]:
    """Return times, s, wrenches, N and N·m, and displacements, m and rad, for JSON."""
    return {
        "time": run.times.tolist(),
        "wrench": run.wrenches.tolist(),
        "displacement": run.displacements.tolist(),
    }


def _plots(name: str, recorded: LoopRun, checks: list[Check]) -> list[Plot]:
    """Draw the loads of the recorded run (10a), and displacements by table and solves (10b).

    Small outputs are drawn apart and by griddata too, because there the methods differ.
    """
    plots = []
    for kind, unit, loads in (("forces", "N", range(3)), ("moments", "N·m", range(3, 6))):
        curves = [Curve.of(LOADS[k], recorded.times, recorded.wrenches[:, k]) for k in loads]
        title = f"Figure 10a: {kind} on {name}"
        plots.append(Plot(title, "time, s", f"{kind}, {unit}", tuple(curves)))
    small = _is_small(checks[0].span)
    groups = (
        ("translation", "µm", 1e6, np.flatnonzero(~small[:3]), checks[:1]),
        ("rotation", "mrad", 1e3, np.flatnonzero(~small[3:]) + 3, checks[:1]),
        ("small translations", "µm", 1e6, np.flatnonzero(small[:3]), checks),
        ("small rotations", "mrad", 1e3, np.flatnonzero(small[3:]) + 3, checks),
    )
    for kind, unit, factor, outputs, drawn in groups:
        if len(outputs):
            curves = [curve for k in outputs for curve in _curves(drawn, int(k), factor)]
            title = f"Figure 10b: {kind} of {name}, interpolated and solved directly"
            plots.append(Plot(title, "time, s", f"{kind}, {unit}", tuple(curves)))
    return plots


def _curves(checks: list[Check], output: int, factor: float) -> list[Curve]:
    """Return the curves of one output by each method, and its direct solves."""
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
    times, solved = first.run.times[first.moments], factor * first.solved[:, output]
    return [*curves, Curve.of(f"{OUTPUTS[output]}, solved", times, solved, "points")]
