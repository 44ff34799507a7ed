"""Measured rows beside a reference: the answer of the solves alone, or of another import's rows.

The reference never holds the rows that are compared with it: a table of both answers between them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import ImportRecord
from wrenchbook.surrogate.answer import NAMES
from wrenchbook.surrogate.build import SOLVED, Table, build
from wrenchbook.surrogate.findings.comparison import factor_of
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Floats, LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Space

MAX_COMPARED = 3_000  # rows of a reply: 2 MB of JSON; a plot shows no more
MAX_REFERENCE = 3_000  # rows of another import that a reference is built from: seconds
COVERED_OR_THIN = 2  # codes of coverage below it have an answer that is more than an extrapolation
Spans = Sequence[tuple[int, int, ImportRecord]]


class UncomparableError(ValueError):
    """No such import, or it is the reference itself; the message says what to do."""


class Setup(NamedTuple):
    """The options of a component's table that answers depend on."""

    load_range: LoadRange
    tolerance: Tolerance | None
    linear: bool
    locked: Sequence[int] = ()
    error: SolverError | None = None  # of the solver; None where it is not known


def table_of(rows: Rows, setup: Setup) -> Table:
    """Return the table of some rows of a component alone."""
    return build(
        rows,
        setup.load_range,
        tolerance=setup.tolerance,
        linear=setup.linear,
        locked=setup.locked,
        solver_error=setup.error,
    )


def comparison(
    rows: Rows, spans: Spans, setup: Setup, number: int | None, against: int | None
) -> dict[str, Any]:
    """Return measured rows beside a reference: fields of `messages.Comparison`, arrays by column.

    Parameters
    ----------
    rows : Rows
        Of a version of a table, in ascending order of `seq`.
    spans
        The rows that imports brought.
    number, against : int, optional
        The import whose rows are compared, all measured ones without; and the import whose rows
        are the reference, the solves without.

    Raises
    ------
    UncomparableError
        If the table has no rows of an import, or the two are the same.
    """
    campaign = _campaigns(rows.seq, spans)
    solved = rows.source == SOLVED
    for one in (number, against):
        if one is not None and not (~solved & (campaign == one)).any():
            known = np.unique(campaign[~solved & (campaign > 0)])[-10:].tolist()
            listed = ", ".join(map(str, known)) or "none yet"
            raise UncomparableError(
                f"the table has no measured rows of import {one}; its last are {listed}"
            )
    if number is not None and number == against:
        raise UncomparableError(f"import {number} is its own reference; name two imports")
    of_reference = solved if against is None else ~solved & (campaign == against)
    chosen = ~solved & ~of_reference
    if number is not None:
        chosen &= campaign == number
    inside = np.asarray(setup.load_range.holds(rows.wrench))
    places, base = np.flatnonzero(chosen & inside), rows.take(of_reference)
    places = places[:: -(-len(places) // MAX_COMPARED) or 1]
    used = (
        base
        if against is None
        else base.take(np.arange(0, len(base), -(-len(base) // MAX_REFERENCE)))
    )
    some, outputs = rows.take(places), setup.load_range.space.output_names
    reason, method, complete = "", "none", False
    expected, bar = np.full((2, *some.displacement.shape), np.nan)
    noise = np.full(len(outputs), np.nan)
    coverage = np.full(len(some), COVERED_OR_THIN)
    if not len(base):
        reason = "there is no solved row: name the import of the reference with against"
    elif not len(some):
        reason = "there is no measured row to compare within the load range"
    else:
        of_rig = setup._replace(linear=False, error=None)  # nothing makes a rig linear
        packed = packed_of(table_of(used, setup if against is None else of_rig))
        noise = table_of(some, of_rig).observation_noise
        method, complete = packed.answers_by(), against is not None or setup.error is not None
        # A reading at the same wrench is no answer: its noise would be the reference's.
        replies = packed.batch(some.wrench, without_rows=against is not None)
        coverage, answered = replies.coverage, (replies.coverage < COVERED_OR_THIN)[:, None]
        expected = np.where(answered, replies.outputs, np.nan)
        bar = np.where(answered, replies.errors, np.nan)
    residual = some.displacement - expected
    own = np.ascontiguousarray(some.uncertainty)  # as the JSON writer needs it
    scatter = np.where(np.isfinite(own), own, noise)
    of_import = campaign[places]

    def summaries(at: NDArray[np.bool_]) -> dict[str, Any]:
        columns = [column[at].T for column in (some.displacement, expected, bar, scatter)]
        return {name: _summary(*numbers) for name, *numbers in zip(outputs, *columns, strict=True)}

    return {
        "reference": {
            "kind": "solves" if against is None else "import",
            "import": against,
            "rows": len(used),
            "of": len(base),
            "method": method,
            "bars_are_complete": complete,
        },
        "measured": int(chosen.sum()),
        "beyond_range": int((chosen & ~inside).sum()),
        "compared": len(some),
        "coverages": {name: int((coverage == code).sum()) for code, name in enumerate(NAMES)},
        "noise": noise,
        "reason": reason,
        "outputs": summaries(np.ones(len(some), dtype=bool)),
        "campaigns": [
            {
                "import": one or None,
                "rows": int((of_import == one).sum()),
                "outputs": summaries(of_import == one),
            }
            for one in np.unique(of_import).tolist()
        ],
        "row": some.seq.tolist(),
        "campaign": [one or None for one in of_import.tolist()],
        "coverage": [NAMES[code] for code in coverage.tolist()],
        "wrench": some.wrench,
        "displacement": some.displacement,
        "expected": expected,
        "residual": residual,
        "bar": bar,
        "uncertainty": own,
    }


def _campaigns(seq: NDArray[np.int64], spans: Spans) -> NDArray[np.int64]:
    """Return the number of the import of each row, (n,); 0 of rows that no import brought."""
    if not spans:
        return np.zeros(len(seq), dtype=np.int64)
    first, last, number = np.array([(a, b, record.id) for a, b, record in spans]).T
    at = np.searchsorted(first, seq, side="right") - 1
    return np.where((at >= 0) & (seq <= last[at]), number[at], 0)


def _summary(measured: Floats, expected: Floats, bar: Floats, own: Floats) -> dict[str, Any]:
    """Return the differences of one output, (n,) each, m or rad: None where they are not known."""
    residual = measured - expected
    known = np.isfinite(residual)
    # Two independent 95 % half widths; if nothing tells a reading's, the reference's alone.
    bound = np.hypot(bar, np.where(np.isfinite(own), own, 0.0))[known & np.isfinite(bar)]
    beyond = np.abs(residual[known & np.isfinite(bar)]) > bound
    factor, half_width, of_reference = factor_of(measured, expected, bar, own)
    some = residual[known]
    numbers = {
        "mean": some.mean() if len(some) else np.nan,
        "rms": np.sqrt(np.mean(some**2)) if len(some) else np.nan,
        "factor": factor,
        "half_width": half_width,
        "of_reference": of_reference,
    }
    return {
        "compared": len(some),
        "beyond_bars": int(beyond.sum()),
        "bars_unknown": len(some) - len(bound),
        **{name: float(one) if np.isfinite(one) else None for name, one in numbers.items()},
    }


def comparison_csv(reply: Mapping[str, Any], space: Space) -> str:
    """Return the rows of a comparison as CSV, SI; empty where a number is not known."""
    units = [one.unit.replace("·", "*") for one in (*space.inputs, *space.outputs)]
    loads, outputs = space.input_names, space.output_names
    head = ["row", "import", "coverage"]
    head += [f"{name} [{unit}]" for name, unit in zip(loads, units, strict=False)]
    kinds = "displacement", "expected", "residual", "bar", "uncertainty"
    for kind in kinds:
        more = "" if kind == "displacement" else f"_{kind}"
        pairs = zip(outputs, units[len(loads) :], strict=True)
        head += [f"{name}{more} [{unit}]" for name, unit in pairs]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(head)
    numbers = np.hstack([reply["wrench"], *(reply[kind] for kind in kinds)])
    for row, number, coverage, line in zip(
        reply["row"], reply["campaign"], reply["coverage"], numbers.tolist(), strict=True
    ):
        cells = ["" if value != value else repr(value) for value in line]
        writer.writerow([row, number or "", coverage, *cells])
    return file.getvalue()
