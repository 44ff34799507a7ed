"""Measured rows against solved ones: measurements outside the error bars of the solves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wrenchbook.service.contract import LOADS, OUTPUTS
from wrenchbook.service.tables.comparison import Setup, table_of
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

MAX_ROWS = 5000  # measured ones that are compared; more are thinned evenly
MAX_LISTED = 500
FEA = "fea"


def disagreement(
    rows: Rows,
    span: LoadRange,
    tolerance: Tolerance | None,
    linear: bool,
    locked: Sequence[int] = (),
    error: SolverError | None = None,
) -> dict[str, Any]:
    """Compare each measured row of a component's setup with a table of the solved rows alone.

    `error` is what the solver may be wrong by, nothing where that is not known; `locked` are the
    indices of loads on locked freedoms. In the result ``outside`` counts rows with an output out
    of the error bars of both, row and solves; ``outputs`` has of each how many are outside and
    the mean difference, m or rad, which shows an offset; ``rows`` are the worst first.
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
    packed = packed_of(table_of(of_solves, Setup(span, tolerance, linear, locked, known)))
    indices = np.flatnonzero(within)
    measured = rows.take(indices[:: max(1, -(-len(indices) // MAX_ROWS))])
    expected = packed.batch(measured.wrench)
    off = measured.displacement - expected.outputs
    uncertainty = np.where(np.isfinite(measured.uncertainty), measured.uncertainty, 0.0)
    bound = np.hypot(expected.errors, uncertainty)  # two independent 95 % half widths
    compared = np.isfinite(off) & np.isfinite(bound) & (expected.coverage < 2)[:, None]
    ratio = np.where(compared, np.abs(off) / np.maximum(bound, np.finfo(float).tiny), 0.0)
    outside = ratio > 1.0
    outliers = [
        {
            "row": int(measured.seq[at]),
            "wrench": dict(zip(LOADS, measured.wrench[at].tolist(), strict=True)),
            "output": OUTPUTS[output],
            "measured": float(measured.displacement[at, output]),
            "expected": float(expected.outputs[at, output]),
            "bar": float(bound[at, output]),
            "ratio": float(ratio[at, output]),
        }
        for at, output in np.argwhere(outside).tolist()
    ]
    outputs: dict[str, Any] = {}
    for output, name in enumerate(OUTPUTS):
        differences = off[compared[:, output], output]
        outputs[name] = {
            "compared": len(differences),
            "outside": int(outside[:, output].sum()),
            "mean_difference": float(differences.mean()) if len(differences) else None,
        }
    return counts | {
        "compared": int(compared.any(axis=1).sum()),
        "outside": int(outside.any(axis=1).sum()),
        "not_told": int((~compared.any(axis=1)).sum()),
        "outputs": outputs,
        "rows": sorted(outliers, key=lambda row: -row["ratio"])[:MAX_LISTED],
    }
