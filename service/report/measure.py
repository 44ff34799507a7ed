"""Measurement of a report: reference solves, solves on coarser meshes, tables of several sizes.

The reference is the component on the finest of three meshes, under wrenches that no table has.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import qmc

from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import FREEDOMS, Bundle
from wrenchbook.surrogate.answer import COVERED, METHODS, UnknownMethodError
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance, acting

Array = np.ndarray
Report = Callable[[float, str], None]

# Cells along an edge, over those of the own mesh.
LEVELS = (("coarse", 0.67), ("own", 1.0), ("fine", 1.5))
PARTS = (0.25, 0.5, 1.0)  # parts of the rows, for tables of growing size
SOLVES_FRACTION = 0.85  # part of a report's time, for its progress
NEAR_ZERO = 1e-3  # part of the largest output of its kind: a smaller output counts as near zero
TIMED_QUERIES, TIMED_SECONDS = 2000, 0.5  # limits for each method: the 99 % rest on 20 answers


def measure(
    bundle: Bundle, rows: Rows, load_range: LoadRange, count: int, seed: int, report: Report
) -> dict[str, Any]:
    """Return all figures of a report, as JSON-able values; processor times in s and µs, else SI.

    `count` wrenches, drawn by `seed`, are compared; `report` is called with the completed fraction
    and the current step.

    Raises ValueError if no wrench is solved on both finest meshes.
    """
    space = load_range.space
    locked = [name in entry.locked for entry in bundle.interfaces for name in FREEDOMS]
    points = qmc.Halton(d=len(load_range.low), rng=seed).random(count)
    wrenches = load_range.low + points * (load_range.high - load_range.low)
    wrenches = acting(wrenches, np.flatnonzero(locked).tolist())

    levels = _solve_levels(bundle, wrenches, report)
    displacements = [level.pop("displacement") for level in levels]
    own = [level["level"] for level in levels].index("own")
    solved = np.isfinite(displacements[-1] + displacements[own]).all(axis=1)
    if not solved.any():
        kinds = {failure["kind"] for level in levels for failure in level["failures"]}
        raise ValueError(
            f"none of the {count} wrenches could be solved ({', '.join(sorted(kinds))}); lower "
            f"the range in component.toml, or see the cause with: wrenchbook solve {bundle.name} "
            "--force FX FY FZ"
        )

    references = displacements[-1][solved], displacements[own][solved]
    # An error is relative to the range of its output, or to a minimum if that is near zero.
    span = np.ptp(references[0], axis=0)
    scale = np.maximum(span, NEAR_ZERO * space.largest_of_kind(span))
    for level, displacement in zip(levels, displacements, strict=True):
        level |= {"name": f"FEA, {level['level']} mesh", "seconds": level["seconds_p50"]}
        level["error"] = errors(np.abs(displacement[solved] - references[0]), scale)
        level["largest_error"] = _largest(level["error"])

    report(SOLVES_FRACTION, "measuring tables")
    limit = bundle.tolerance
    make = partial(  # as the server builds a component's table
        build,
        load_range=load_range,
        tolerance=Tolerance(limit.translation, limit.rotation) if limit else None,
        linear=not bundle.analysis.nonlinear,
        locked=np.flatnonzero(locked).tolist(),
    )
    summary = make(rows).coverage_summary()
    seconds = levels[own]["seconds_p50"]
    tables = _measure_tables(rows, make, wrenches[solved], references, scale, seconds)
    limits = limit and np.where(space.is_rotation, limit.rotation, limit.translation).tolist()
    is_finest = own == len(levels) - 1  # its error is unknown
    return {
        "component": bundle.name,
        "title": bundle.title,
        "rows": len(rows),
        "wrenches": {"asked": count, "compared": int(solved.sum()), "seed": seed},
        "range": span.tolist(),
        "floor": scale.tolist(),
        "outputs": list(space.output_names),
        "tolerance": limits,
        "default": {
            "method": summary["method"],
            "reason": summary["method_reason"],
            "errors_left_out": summary["errors_left_out"],
            "full_wrench_rows": summary["full_wrench_rows"],
        },
        "mesh_error": None if is_finest else levels[own]["largest_error"],
        "fea": levels,
        "tables": tables,
        "pareto": pareto([*tables, *levels]),
    }


def _solve_levels(bundle: Bundle, wrenches: Array, report: Report) -> list[dict[str, Any]]:
    """Solve wrenches (n, inputs) on each mesh, the finest last; one if it cannot be refined."""
    chosen = [(name, refined(bundle, factor)) for name, factor in LEVELS]
    meshes = [(name, mesh) for name, mesh in chosen if mesh is not None] or [("own", bundle)]
    levels = []
    for number, (name, mesh) in enumerate(meshes):
        started = time.process_time()
        solver = Solver(mesh)
        setup = time.process_time() - started

        displacement = np.full((len(wrenches), len(FREEDOMS) * len(mesh.interfaces)), np.nan)
        seconds, failures = [], []
        for index, wrench in enumerate(wrenches):
            fraction = index / len(wrenches)
            done = SOLVES_FRACTION * (number + fraction) / len(meshes)
            report(done, f"{name} mesh: wrench {index + 1} of {len(wrenches)}")
            started = time.process_time()
            try:
                displacement[index] = solver.solve(wrench).displacement
            except SolveFailed as failure:
                why = {"kind": failure.kind, "message": failure.message, "remedy": failure.remedy}
                failures.append({"wrench": wrench.tolist(), **why})
                continue
            seconds.append(time.process_time() - started)

        levels.append(
            {
                "level": name,
                "unknowns": solver.unknowns,
                "setup_s": setup,
                "seconds_p50": float(np.median(seconds)) if seconds else None,
                "seconds_p95": float(np.quantile(seconds, 0.95)) if seconds else None,
                "solves": len(wrenches),
                "failures": failures,
                "displacement": displacement,
            }
        )
    return levels


def _measure_tables(
    rows: Rows,
    make: Callable[[Rows], Table],
    wrenches: Array,
    references: tuple[Array, Array],
    scale: Array,
    solve_seconds: float,
) -> list[dict[str, Any]]:
    """Build tables of more and more of the first rows, and compare each of their methods.

    `references` and `scale` as of `_compare_method`; `solve_seconds`: time of one solve, s.
    """
    tables: list[dict[str, Any]] = []
    for part in PARTS:
        first = rows.take(np.arange(max(1, round(part * len(rows)))))
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        table = make(first)
        memory = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()

        started = time.process_time()  # of a second build: the first one was traced
        make(first)
        cost = {
            "rows": len(first),
            "build_s": time.process_time() - started,
            "memory_bytes": memory,
            "fea_s": float(first.is_solved.sum() * solve_seconds),
        }
        for method in METHODS:
            entry = _compare_method(packed_of(table), method, wrenches, references, scale)
            if entry is not None:
                name = f"{method}, {len(first)} rows"
                tables.append({"name": name, "method": method, **cost, **entry})
    return tables


def _compare_method(
    table: PackedTable, method: str, wrenches: Array, references: tuple[Array, Array], scale: Array
) -> dict[str, Any] | None:
    """Compare a method with solves on the finest mesh and on the table's mesh; None without it.

    `references` are displacements on both, shape (n, m), m and rad; `scale` as of `errors`.
    """
    finest, same_mesh = references
    try:
        answer = table.answer(wrenches[0].tolist(), None, method)
    except UnknownMethodError:  # several interfaces have no axes
        return None
    if answer.method != method:  # few rows have no kriging: the axes answer instead
        return None

    answers = table.batch(wrenches, method=method)
    error = np.abs(answers.outputs - same_mesh)
    inside, ratios, missed, compared = [], [], 0, 0
    for bars, true in zip(answers.errors.T, error.T, strict=True):
        known = np.isfinite(bars)
        bars, true = bars[known], true[known]
        median = float(np.median(true)) if len(true) else 0.0
        inside.append(float(np.mean(true <= bars)) if len(true) else None)
        missed, compared = missed + int(np.sum(true > bars)), compared + len(true)
        # None if the error is zero.
        ratios.append(float(np.median(bars)) / median if median > 0.0 else None)

    median_us, p99_us = answer_times(table, method, wrenches)
    of_finest = errors(np.abs(answers.outputs - finest), scale)
    of_mesh = errors(error, scale)
    return {
        "covered": float(np.mean(answers.coverage == COVERED)),
        "seconds": median_us * 1e-6,
        "query_us_p50": median_us,
        "query_us_p99": p99_us,
        "error": of_finest,
        "largest_error": _largest(of_finest),
        "lookup_error": of_mesh,
        "largest_interpolation_error": _largest(of_mesh),
        "inside_error_bar": inside,
        "beyond_error_bar": {"missed": missed, "of": compared},
        "bar_over_error": ratios,
    }


def errors(error: Array, scale: Array) -> dict[str, list[float | None]]:
    """Return RMS, 95 % and largest error per output, m and rad; rows with NaN are left out.

    `error` has shape (n, m), m and rad; ``rms_relative`` is in parts of `scale`, shape (m,).
    """
    known = error[np.isfinite(error).all(axis=1)]
    if not len(known):
        nothing: list[float | None] = [None] * len(scale)
        return dict.fromkeys(("rms", "p95", "max", "rms_relative"), nothing)
    rms = np.sqrt(np.mean(known**2, axis=0))
    return {
        "rms": rms.tolist(),
        "p95": np.quantile(known, 0.95, axis=0).tolist(),
        "max": known.max(axis=0).tolist(),
        "rms_relative": (rms / scale).tolist(),
    }


def _largest(error: dict[str, list[float | None]]) -> float | None:
    """Return the largest relative RMS error of all outputs; None if nothing was answered."""
    known = [value for value in error["rms_relative"] if value is not None]
    return max(known) if len(known) == len(error["rms_relative"]) else None


def pareto(entries: list[dict[str, Any]]) -> list[str]:
    """Return the names of the entries that no other beats in both error and run time.

    The finest mesh is the reference, its error zero by definition.
    """
    points = sorted(
        (entry["seconds"], entry["largest_error"], entry["name"])
        for entry in entries
        if None not in (entry["seconds"], entry["largest_error"])
    )
    front: list[str] = []
    best = float("inf")
    for _, error, name in points:
        if error < best:
            best = error
            front.append(name)
    return front


def answer_times(table: PackedTable, method: str, wrenches: np.ndarray) -> tuple[float, float]:
    """Return median and 99 % of the processor times of single answers, µs.

    The `wrenches`, (n, inputs), N and N·m, are answered in order; the first one also once before,
    so that one-time work does not count.
    """
    loads = wrenches.tolist()
    table.answer(loads[0], None, method)
    times: list[float] = []
    deadline = time.perf_counter() + TIMED_SECONDS
    while len(times) < TIMED_QUERIES and time.perf_counter() < deadline:
        wrench = loads[len(times) % len(loads)]
        started = time.process_time_ns()
        table.answer(wrench, None, method)
        times.append((time.process_time_ns() - started) / 1e3)
    return float(np.median(times)), float(np.quantile(times, 0.99))
