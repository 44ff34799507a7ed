"""Measured rows beside a reference: the answer of the solves alone, or of another import's rows.

The reference never holds the rows that are compared with it: a table of both answers between them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import ImportRecord
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.build import build_table
from wrenchbook.surrogate.answer import NAMES
from wrenchbook.surrogate.build import SOLVED
from wrenchbook.surrogate.findings.comparison import factor_of
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Floats, Rows
from wrenchbook.surrogate.table.space import Space

MAX_COMPARED = 3_000  # rows of a reply: 2 MB of JSON; a plot shows no more
MAX_REFERENCE = 3_000  # rows of another import that a reference is built from: a second
MAX_LISTED = 500
_OUTSIDE = NAMES.index("outside")
_KINDS = "displacement", "expected", "residual", "bar", "uncertainty"
Spans = Sequence[tuple[int, int, ImportRecord]]


class UncomparableError(ValueError):
    """No such import, or it is the reference itself; the message says what to do."""


def comparison(
    component: Component,
    rows: Rows,
    error: SolverError | None,
    spans: Spans = (),
    number: int | None = None,
    against: int | None = None,
) -> dict[str, Any]:
    """Return measured rows beside a reference: fields of `messages.Comparison`.

    `rows`: of a version of the component's table, in ascending order of `seq`.
    `error`: what the solver may be wrong by; None where it is not known.
    `spans`: the rows that imports brought.
    `number`, `against`: the import whose rows are compared, all measured ones without; and the
    import whose rows are the reference, the solves without.
    Raises UncomparableError if the table has no measured rows of an import, or the two are the
    same.
    """
    of_import, measured = _imports(rows.seq, spans), rows.source != SOLVED
    for each in (number, against):
        if each is not None and not (measured & (of_import == each)).any():
            listed = np.unique(of_import[measured & (of_import > 0)])[-10:].tolist()
            known = ", ".join(map(str, listed))
            raise UncomparableError(
                f"the table has no measured rows of import {each}; "
                + (f"its last are {known}" if known else "import a file of measured rows first")
            )
    if number is not None and number == against:
        raise UncomparableError(f"import {number} cannot be its own reference; name two imports")
    reference = ~measured if against is None else measured & (of_import == against)
    chosen = measured & ~reference & (number is None or of_import == number)
    inside = np.asarray(component.load_range.holds(rows.wrench))
    compared, base = np.flatnonzero(chosen & inside), np.flatnonzero(reference)
    compared = compared[:: -(-len(compared) // MAX_COMPARED) or 1]
    used = base if against is None else base[:: -(-len(base) // MAX_REFERENCE)]
    some, outputs, campaign = rows.take(compared), component.space.output_names, of_import[compared]
    reason, method, complete = "", "none", np.bool_(against is not None or error is not None)
    expected, bar = np.full((2, *some.displacement.shape), np.nan)
    noise, coverage = np.full(len(outputs), np.nan), np.full(len(some), _OUTSIDE)
    if not len(base):
        reason = "there is no solved row; fill the table"
    elif not len(some):
        beside = f" beside those of import {against}" if against is not None else ""
        reason = f"there is no measured row{beside}; import some"
    else:
        of_rig = replace(component, linear=False)  # nothing makes a rig linear
        noise = build_table(of_rig, some, 0).observation_noise
        law, its = (component, error) if against is None else (of_rig, None)
        packed = packed_of(build_table(law, rows.take(used), 0, its))
        # A reading at the same wrench is no answer: its noise would be the reference's.
        replies = packed.batch(some.wrench, without_rows=against is not None)
        method, coverage = packed.answers_by(), replies.coverage
        # Far from its rows a kriging extrapolates and has no bar.
        answered = (coverage != _OUTSIDE)[:, None] & (np.isfinite(replies.errors) | ~complete)
        expected = np.where(answered, replies.outputs, np.nan)
        bar = np.where(answered, replies.errors, np.nan)
    stated = np.ascontiguousarray(some.uncertainty)  # as the JSON writer needs it
    columns = some.displacement, expected, bar, np.where(np.isfinite(stated), stated, noise)

    def summaries(at: NDArray[np.bool_]) -> dict[str, Any]:
        numbers = zip(*(column[at].T for column in columns), strict=True)
        return {name: _summary(*four) for name, four in zip(outputs, numbers, strict=True)}

    return {
        "reference": {
            "import": against,
            "rows": len(used),
            "of": len(base),
            "method": method,
            "bars_are_complete": bool(complete),
        },
        "measured": int(chosen.sum()),
        "beyond_range": int((chosen & ~inside).sum()),
        "compared": len(some),
        "coverages": {name: int((coverage == code).sum()) for code, name in enumerate(NAMES)},
        "noise": noise,
        "reason": reason,
        "outputs": summaries(campaign >= 0),
        "campaigns": [
            {
                "import": each or None,
                "rows": int((campaign == each).sum()),
                "outputs": summaries(campaign == each),
            }
            for each in np.unique(campaign).tolist()
        ],
        "row": some.seq.tolist(),
        "campaign": [each or None for each in campaign.tolist()],
        "coverage": [NAMES[code] for code in coverage.tolist()],
        "wrench": some.wrench,
        "displacement": some.displacement,
        "expected": expected,
        "residual": some.displacement - expected,
        "bar": bar,
        "uncertainty": stated,
    }


def _imports(seq: NDArray[np.int64], spans: Spans) -> NDArray[np.int64]:
    """Return the number of the import of each row, (n,); 0 of rows that no import brought."""
    none = [(0, 0, 0)]
    first, last, number = np.array([(a, b, record.id) for a, b, record in spans] or none).T
    at = np.searchsorted(first, seq, side="right") - 1
    return np.where((at >= 0) & (seq <= last[at]), number[at], 0)


def _bound(bar: Floats, scatter: Floats) -> Floats:
    """Return the 95 % half width of a residual: of the reference alone if no scatter is known."""
    return np.hypot(bar, np.where(np.isfinite(scatter), scatter, 0.0))


def _summary(measured: Floats, expected: Floats, bar: Floats, scatter: Floats) -> dict[str, Any]:
    """Return the differences of one output, (n,) each, m or rad: None where they are not known."""
    residual, bound = measured - expected, _bound(bar, scatter)
    some = residual[np.isfinite(residual)]
    factor, half_width, of_reference = factor_of(measured, expected, bar, scatter)
    numbers = {
        "mean": some.mean() if len(some) else np.nan,
        "rms": np.sqrt(np.mean(some**2)) if len(some) else np.nan,
        "factor": factor,
        "half_width": half_width,
        "of_reference": of_reference,
    }
    return {
        "compared": len(some),
        "unanswered": int((np.isfinite(measured) & np.isnan(expected)).sum()),
        "beyond_bars": int((np.abs(residual) > bound).sum()),
        "bars_unknown": int((np.isfinite(residual) & np.isnan(bound)).sum()),
        **{name: float(value) if np.isfinite(value) else None for name, value in numbers.items()},
    }


def comparison_csv(reply: Mapping[str, Any], space: Space) -> str:
    """Return the rows of a comparison as CSV, SI; empty where a number is not known."""
    head = ["row", "import", "coverage", *(f"{item.name} [{item.unit}]" for item in space.inputs)]
    for kind in _KINDS:
        more = "" if kind == "displacement" else f"_{kind}"
        head += [f"{item.name}{more} [{item.unit}]" for item in space.outputs]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([name.replace("·", "*") for name in head])
    numbers = np.hstack([reply["wrench"], *(reply[kind] for kind in _KINDS)]).tolist()
    names = zip(reply["row"], reply["campaign"], reply["coverage"], strict=True)
    for first, line in zip(names, numbers, strict=True):
        writer.writerow([*first, *(None if value != value else value for value in line)])
    return file.getvalue()


def disagreement(component: Component, rows: Rows, error: SolverError | None) -> dict[str, Any]:
    """Return the measured rows outside the bars of reading and solves: `messages.Disagreement`.

    `error` is what the solver may be wrong by; nothing where that is not known.
    """
    span = component.load_range
    none = np.zeros((len(span.space.outputs), len(span.low)))
    known = error or SolverError({"mesh": none.tolist(), "loads": span.scale.tolist()})
    reply = comparison(component, rows, known)
    stated, residual = reply["uncertainty"], reply["residual"]
    bound = _bound(reply["bar"], np.where(np.isfinite(stated), stated, reply["noise"]))
    compared = np.isfinite(residual) & np.isfinite(bound)
    ratio = np.where(compared, np.abs(residual) / np.maximum(bound, np.finfo(float).tiny), 0.0)
    inputs, outputs = component.space.input_names, component.space.output_names
    outliers = [
        {
            "row": reply["row"][at],
            "wrench": dict(zip(inputs, reply["wrench"][at].tolist(), strict=True)),
            "output": outputs[output],
            "measured": float(reply["displacement"][at, output]),
            "expected": float(reply["expected"][at, output]),
            "bar": float(bound[at, output]),
            "ratio": float(ratio[at, output]),
        }
        for at, output in np.argwhere(ratio > 1.0).tolist()
    ]
    return {
        **{name: reply[name] for name in ("measured", "beyond_range", "reason")},
        "solved": reply["reference"]["of"],
        "compared": int(compared.any(axis=1).sum()),
        "outside": int((ratio > 1.0).any(axis=1).sum()),
        "not_told": int((~compared.any(axis=1)).sum()) if not reply["reason"] else None,
        "outputs": {
            name: {
                "compared": summary["compared"] - summary["bars_unknown"],
                "outside": summary["beyond_bars"],
                "mean_difference": summary["mean"],
            }
            for name, summary in reply["outputs"].items()
            if not reply["reason"]
        },
        "rows": sorted(outliers, key=lambda row: -row["ratio"])[:MAX_LISTED],
    }
