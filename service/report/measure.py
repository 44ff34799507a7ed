"""Measuring a report: reference solves, solves on coarser meshes, and tables of several sizes.

The reference is the component on the finest of three meshes, under wrenches that no table contains.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.stats import qmc

from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import FREEDOMS, Bundle
from wrenchbook.surrogate.answer import METHODS, UnknownMethodError
from wrenchbook.surrogate.build import AnyTable, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.packing import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, acting
from wrenchbook.surrogate.table.space import Space

Array = np.ndarray
Report = Callable[[float, str], None]

LEVELS = (("coarse", 0.67), ("own", 1.0), ("fine", 1.5))
PARTS = (0.25, 0.5, 1.0)
NEAR_ZERO = 1e-3  # of the largest output of its kind: below it an output counts as near zero


def measure(
    bundle: Bundle, rows: Rows, load_range: LoadRange, count: int, seed: int, report: Report
) -> dict[str, Any]:
    """Return all figures of a report, as JSON-able values; processor times in s and µs, else SI.

    Parameters
    ----------
    count
        Wrenches to compare.
    """
    linear = not bundle.analysis.nonlinear
    freedoms = [name in one.locked for one in bundle.interfaces for name in FREEDOMS]
    locked = np.flatnonzero(freedoms).tolist()
    wrenches = acting(random_wrenches(load_range, count, seed), locked)
    levels = _solve_levels(bundle, wrenches, report)
    finest, own = levels[-1], next(level for level in levels if level["level"] == "own")
    solved = _solved_in_both(finest, own)
    reference = finest["displacement"][solved]
    space = load_range.space
    scale = _scale(reference, space)
    report(0.85, "measuring tables")
    compared = wrenches[solved]
    references = {"finest": reference, "own": own["displacement"][solved]}
    tables = []
    for part in PARTS:
        some = rows.take(np.arange(max(1, round(part * len(rows)))))
        tables += _tables(some, load_range, compared, references, scale, own["seconds_p50"], linear)
    meshes = [_mesh_entry(level, solved, reference, scale) for level in levels]
    limit = bundle.tolerance
    return {
        "component": bundle.name,
        "title": bundle.title,
        "rows": len(rows),
        "wrenches": {"asked": count, "compared": int(solved.sum()), "seed": seed},
        "range": np.ptp(reference, axis=0).tolist(),
        "floor": scale.tolist(),
        "outputs": list(space.output_names),
        "tolerance": limit
        and np.where(space.is_rotation, limit.rotation, limit.translation).tolist(),
        "default": _default(build(rows, load_range, linear=linear).coverage_summary()),
        "fea": meshes,
        "tables": tables,
        "pareto": pareto(meshes, tables),
    }


def _default(summary: dict[str, Any]) -> dict[str, Any]:
    """Return which method answers and why, from a coverage summary."""
    names = {"method": "method", "method_reason": "reason"}
    same = ("errors_left_out", "full_wrench_rows")
    return {own: summary[name] for name, own in (*names.items(), *zip(same, same, strict=True))}


def _solved_in_both(finest: dict[str, Any], own: dict[str, Any]) -> Array:
    """Return which wrenches both levels have solved, shape (n,).

    Raises
    ------
    ValueError
        If there is none.
    """
    solved = np.isfinite(finest["displacement"] + own["displacement"]).all(axis=1)
    if not solved.any():
        kinds = {failure["kind"] for level in (finest, own) for failure in level["failures"]}
        raise ValueError(
            f"none of the {len(solved)} wrenches could be solved ({', '.join(sorted(kinds))}); "
            "solve one and look at its job's files, or lower the component's load range"
        )
    return solved


def random_wrenches(load_range: LoadRange, count: int, seed: int) -> Array:
    """Return full wrenches spread over the load range, shape (count, n), SI."""
    points = qmc.Halton(d=len(load_range.low), rng=seed).random(count)
    return load_range.low + points * (load_range.high - load_range.low)


def _solve_levels(bundle: Bundle, wrenches: Array, report: Report) -> list[dict[str, Any]]:
    """Solve all wrenches on each mesh, the finest last; one level if it cannot be refined."""
    chosen = [(name, refined(bundle, factor)) for name, factor in LEVELS]
    bundles = [(name, one) for name, one in chosen if one is not None] or [("own", bundle)]
    levels = []
    for number, (name, one) in enumerate(bundles):

        def heard(fraction: float, name: str = name, number: int = number) -> None:
            report(0.85 * (number + fraction) / len(bundles), f"{name} mesh, {fraction:.0%}")

        levels.append({"level": name, **_solve_all(one, wrenches, heard)})
    return levels


def _solve_all(bundle: Bundle, wrenches: Array, heard: Callable[[float], None]) -> dict[str, Any]:
    started = time.process_time()
    solver = Solver(bundle)
    setup = time.process_time() - started
    displacement = np.full((len(wrenches), len(FREEDOMS) * len(bundle.interfaces)), np.nan)
    seconds, failures = [], []
    for place, wrench in enumerate(wrenches):
        heard(place / len(wrenches))
        started = time.process_time()
        try:
            displacement[place] = solver.solve(wrench).displacement
        except SolveFailed as failure:
            failures.append({"wrench": wrench.tolist(), "kind": failure.kind})
            continue
        seconds.append(time.process_time() - started)
    return {
        "unknowns": solver.unknowns,
        "setup_s": setup,
        "seconds_p50": float(np.median(seconds)) if seconds else float("nan"),
        "seconds_p95": float(np.quantile(seconds, 0.95)) if seconds else float("nan"),
        "failures": failures,
        "displacement": displacement,
    }


def _mesh_entry(
    level: dict[str, Any], solved: Array, reference: Array, scale: Array
) -> dict[str, Any]:
    error = np.abs(level.pop("displacement")[solved] - reference)
    return {**level, "error": errors(error, scale)}


def _tables(
    rows: Rows,
    load_range: LoadRange,
    wrenches: Array,
    references: dict[str, Array],
    scale: Array,
    solve_seconds: float,
    linear: bool,
) -> list[dict[str, Any]]:
    """Measure one size of the table with every method."""
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    surrogate = build(rows, load_range, linear=linear)
    memory = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    started = time.process_time()
    build(rows, load_range, linear=linear)
    build_s = time.process_time() - started
    size = {
        "rows": len(rows),
        "build_s": build_s,
        "memory_bytes": memory,
        "fea_s": float(np.sum(rows.source == "fea") * solve_seconds),
    }
    found = []
    for method in METHODS:
        with suppress(UnknownMethodError):  # several interfaces have no axes
            answer = packed_of(surrogate).answer(wrenches[0].tolist(), None, method)
            if answer.method != method:  # few rows have no kriging: the default answers
                continue
            figures = _method(surrogate, method, wrenches, references, scale)
            found.append({"method": method, **size, **figures})
    return found


def _method(
    surrogate: AnyTable,
    method: str,
    wrenches: Array,
    references: dict[str, Array],
    scale: Array,
) -> dict[str, Any]:
    table = packed_of(surrogate)
    answers = table.batch(wrenches, method=method)
    error = np.abs(answers.outputs - references["own"])
    known = np.isfinite(answers.errors)
    outputs = range(known.shape[1])
    inside = [_share(error[known[:, k], k] <= answers.errors[known[:, k], k]) for k in outputs]
    middle, late = answer_times(table, method, wrenches)
    return {
        "covered": float(np.mean(answers.coverage == 0)),
        "query_us_p50": middle,
        "query_us_p99": late,
        "error": errors(np.abs(answers.outputs - references["finest"]), scale),
        "lookup_error": errors(error, scale),
        "inside_error_bar": inside,
        "bar_over_error": [
            _ratio(answers.errors[known[:, k], k], error[known[:, k], k]) for k in outputs
        ],
    }


def errors(error: Array, scale: Array) -> dict[str, list[float | None]]:
    """Return RMS, 95 % and largest error per output, m and rad; rows with NaN are left out.

    `error` has shape (n, m), m and rad; ``rms_relative`` is in parts of `scale`, shape (m,).
    """
    kept = error[np.isfinite(error).all(axis=1)]
    if not len(kept):
        nothing: list[float | None] = [None] * len(scale)
        return dict.fromkeys(("rms", "p95", "max", "rms_relative"), nothing)
    rms = np.sqrt(np.mean(kept**2, axis=0))
    return {
        "rms": rms.tolist(),
        "p95": np.quantile(kept, 0.95, axis=0).tolist(),
        "max": kept.max(axis=0).tolist(),
        "rms_relative": (rms / scale).tolist(),
    }


def _scale(reference: Array, space: Space) -> Array:
    """Return what an error is relative to, shape (m,): the range, or a floor if near zero."""
    span = np.ptp(reference, axis=0)
    return np.maximum(span, NEAR_ZERO * space.largest_of_kind(span))


def worst(entry: dict[str, Any]) -> float:
    """Return the largest relative RMS error of an entry against the finest mesh.

    Infinite if nothing was answered.
    """
    return _largest(entry["error"])


def lookup(table: dict[str, Any]) -> float:
    """Return `worst` of a table against solves on its own mesh: its interpolation error."""
    return _largest(table["lookup_error"])


def _largest(error: dict[str, list[float | None]]) -> float:
    known = [one for one in error["rms_relative"] if one is not None]
    return max(known) if len(known) == len(error["rms_relative"]) else float("inf")


def mesh_error(report: dict[str, Any]) -> float | None:
    """Return the largest relative RMS error of the component's own mesh; None if unknown."""
    own = [entry for entry in report["fea"][:-1] if entry["level"] == "own"]
    return worst(own[0]) if own else None


def seconds_of(entry: dict[str, Any]) -> float:
    """Return what one answer of an entry costs, s."""
    return entry["query_us_p50"] * 1e-6 if "method" in entry else entry["seconds_p50"]


def pareto(meshes: list[dict[str, Any]], tables: list[dict[str, Any]]) -> list[str]:
    """Return the names of the entries that no other beats in both error and run time.

    The finest mesh is the reference, its error zero by definition.
    """
    points = [(seconds_of(e), worst(e), name_of(e)) for e in (*tables, *meshes)]
    points = sorted(point for point in points if np.isfinite(point[0]) and np.isfinite(point[1]))
    front: list[str] = []
    best = float("inf")
    for _, error, name in points:
        if error < best:
            best = error
            front.append(name)
    return front


def name_of(entry: dict[str, Any]) -> str:
    """Return what an entry is called in tables and plots."""
    if "method" in entry:
        return f"{entry['method']}, {entry['rows']} rows"
    return f"FEA, {entry['level']} mesh"


def _share(inside: Array) -> float | None:
    return float(np.mean(inside)) if len(inside) else None


def _ratio(bars: Array, error: Array) -> float | None:
    """Return the median error bar over the median true error; None where the error is nothing."""
    true = float(np.median(error)) if len(error) else 0.0
    return float(np.median(bars)) / true if true > 0.0 else None


TIMED_QUERIES, TIMED_SECONDS = 2000, 0.5


def answer_times(table: PackedTable, method: str, wrenches: np.ndarray) -> tuple[float, float]:
    """Return median and 99 % of the processor times of single answers, µs.

    Parameters
    ----------
    wrenches : ndarray, shape (n, 6), N and N·m
        Answered in order; the first once before, so that one-time work is not counted.
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
