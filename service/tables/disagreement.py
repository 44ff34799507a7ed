"""Measured rows against solved ones: measurements outside the error bars of the solves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wrenchbook.service.contract import LOADS, OUTPUTS
from wrenchbook.surrogate.build import AnyTable, build
from wrenchbook.surrogate.kernel.packing import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

MOST_ROWS = 5000  # measured ones that are compared; more are thinned evenly
MOST_LISTED = 500
FEA = "fea"


def disagreement(
    rows: Rows,
    span: LoadRange,
    tolerance: Tolerance | None,
    linear: bool,
    locked: Sequence[int] = (),
    error: SolverError | None = None,
) -> dict[str, Any]:
    """Compare each measured row with a table of the solved rows alone.

    Parameters
    ----------
    rows : Rows
        All rows of a component's present setup, solved and measured.
    span : LoadRange, N and N·m
    tolerance : Tolerance or None, m and rad
    linear : bool
        Whether the component is linear.
    locked : sequence of int
        The places of the loads on locked freedoms.
    error : SolverError or None
        What the solver of the rows may be wrong by; nothing where that is not known.

    Returns
    -------
    dict
        ``measured``, ``solved``, ``compared``, ``outside`` (rows with an output outside of both
        error bars, the solves' and its own), ``outputs`` (of each: how many outside, the
        mean difference, m or rad, which shows an offset) and ``rows``, the worst first.
    """
    solved = rows.source == FEA
    counts: dict[str, Any] = {"measured": int((~solved).sum()), "solved": int(solved.sum())}
    within = np.asarray(span.holds(rows.wrench)) & ~solved
    counts["beyond_range"] = counts["measured"] - int(within.sum())
    if not counts["solved"] or not within.any():
        reason = "there is no solved row" if not counts["solved"] else "there is no measured row"
        return counts | {"compared": 0, "outside": 0, "outputs": {}, "rows": [], "reason": reason}
    of_solves = rows.take(solved)
    none = np.zeros((len(span.space.outputs), len(span.low)))
    known = error or SolverError({"mesh": none.tolist(), "loads": span.scale.tolist()})
    how: dict[str, Any] = {"tolerance": tolerance, "linear": linear, "locked": locked}
    table = build(of_solves, span, solver_error=known, **how)
    places = np.flatnonzero(within)
    places = places[:: max(1, -(-len(places) // MOST_ROWS))]
    return counts | _compared(table, rows.take(places))


def _compared(table: AnyTable, measured: Rows) -> dict[str, Any]:
    expected = packed_of(table).batch(measured.wrench)
    off = measured.displacement - expected.outputs
    own = np.where(np.isfinite(measured.uncertainty), measured.uncertainty, 0.0)
    bound = np.hypot(expected.errors, own)  # two independent 95 % half widths
    known = np.isfinite(off) & np.isfinite(bound) & (expected.coverage < 2)[:, None]
    ratio = np.where(known, np.abs(off) / np.maximum(bound, np.finfo(float).tiny), 0.0)
    outside = ratio > 1.0
    outliers = [
        _row(measured, expected.outputs, bound, ratio, at, output)
        for at, output in np.argwhere(outside).tolist()
    ]
    outliers.sort(key=lambda row: -row["ratio"])
    return {
        "compared": int(known.any(axis=1).sum()),
        "outside": int(outside.any(axis=1).sum()),
        "not_told": int((~known.any(axis=1)).sum()),
        "outputs": {
            name: {
                "compared": int(known[:, output].sum()),
                "outside": int(outside[:, output].sum()),
                "mean_difference": _mean(off[known[:, output], output]),
            }
            for output, name in enumerate(OUTPUTS)
        },
        "rows": outliers[:MOST_LISTED],
    }


def _row(
    rows: Rows, expected: np.ndarray, bound: np.ndarray, ratio: np.ndarray, at: int, output: int
) -> dict[str, Any]:
    return {
        "row": int(rows.seq[at]),
        "wrench": dict(zip(LOADS, rows.wrench[at].tolist(), strict=True)),
        "output": OUTPUTS[output],
        "measured": float(rows.displacement[at, output]),
        "expected": float(expected[at, output]),
        "bar": float(bound[at, output]),
        "ratio": float(ratio[at, output]),
    }


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None
