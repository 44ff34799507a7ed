"""Measured rows beside a reference: the answers of the solves alone, or of another import's rows.

The reference never contains the compared rows: a table of both would answer between them.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.contract import Coverage
from wrenchbook.service.ledger import ImportSpan, import_numbers
from wrenchbook.service.library.component import Component
from wrenchbook.service.messages import FiniteArray, FloatArray, Message, Vector, left_out
from wrenchbook.service.tables.build import build_table
from wrenchbook.surrogate.answer import NAMES
from wrenchbook.surrogate.findings.comparison import scale_factor
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import SOLVED, Floats, Rows
from wrenchbook.surrogate.table.space import Space

MAX_COMPARED = 3_000  # rows of a reply: 2 MB of JSON; a plot shows no more
MAX_REFERENCE = 3_000  # rows of another import in a reference: its build takes a second
MAX_LISTED = 500  # rows of a list of disagreements, the worst first: 0.1 MB of JSON
_OUTSIDE = NAMES.index("outside")
_KINDS = "displacement", "expected", "residual", "bar", "uncertainty"
Indices = NDArray[np.intp]
Spans = Sequence[ImportSpan]


class DisagreeingRow(Message):
    """A measured row beside the answer of the solves, in m or rad of one output.

    `bar` is the bound of the difference: the error bars of reading and solves together.
    """

    row: int
    wrench: dict[str, float]
    output: str
    measured: float
    expected: float
    bar: float
    ratio: float


class Disagreement(Message):
    """Measured rows beside the solves, and the rows that differ most."""

    component: str
    table_version: int
    measured: int
    solved: int
    beyond_range: int
    compared: int
    outside: int
    not_told: int | None = left_out(default=None)
    outputs: dict[str, Any]
    rows: Sequence[DisagreeingRow]
    reason: str = left_out(default="")


class Comparison(Message):
    """Measured rows beside a reference; arrays have one entry a row, in the order of the rows.

    `bar` is the error bar of the reference alone.
    """

    component: str
    table_version: int
    inputs: Sequence[str]
    reference: dict[Literal["import", "rows", "of", "method", "bars_are_complete"], Any]
    measured: int
    beyond_range: int
    compared: int
    coverages: dict[Coverage, int]
    noise: Annotated[Vector, FloatArray(None)]
    reason: str
    outputs: dict[str, dict[str, Any]]
    campaigns: Sequence[dict[Literal["import", "rows", "outputs"], Any]]
    row: Sequence[int]
    campaign: Sequence[int | None]
    coverage: Sequence[Coverage]
    wrench: Annotated[Vector, FiniteArray(None, None)]
    displacement: Annotated[Vector, FloatArray(None, None)]
    expected: Annotated[Vector, FloatArray(None, None)]
    residual: Annotated[Vector, FloatArray(None, None)]
    bar: Annotated[Vector, FloatArray(None, None)]
    uncertainty: Annotated[Vector, FloatArray(None, None)]


class UncomparableError(ValueError):
    """An import does not exist, or is the reference itself; the message has the remedy."""


def _even_choice(indices: Indices, count: int) -> Indices:
    """Return at most `count` of the indices, (n,), at equal distances."""
    stride = math.ceil(len(indices) / count) or 1
    return indices[::stride]


class _Answers(NamedTuple):
    """The answers of a reference at k rows, m and rad; NaN where unknown."""

    method: str
    coverage: NDArray[np.integer]  # (k,): indices of `NAMES`
    expected: Floats  # (k, m)
    bar: Floats  # (k, m): 95 %
    noise: Floats  # (m,): 95 % noise of one reading, by the compared rows alone


def _answers(
    component: Component, rows: Rows, reference: Rows, error: SolverError | None, *, solved: bool
) -> _Answers:
    """Return the answers of a table of the reference at rows; unknown ones if either is empty.

    `solved`: whether the reference is the solves, with the `error` of their solver.
    """
    if not len(rows) or not len(reference):
        unknown = np.full(rows.displacement.shape, np.nan)
        none = np.full(len(rows), _OUTSIDE)
        return _Answers("none", none, unknown, unknown, np.full(rows.displacement.shape[1], np.nan))
    of_rig = replace(component, linear=False)  # measured rows need not be linear
    noise = build_table(of_rig, rows, 0).observation_noise
    model = component if solved else of_rig
    packed = packed_of(build_table(model, reference, 0, error if solved else None))
    # Between measured rows, since a reading at the same wrench has its own noise.
    replies = packed.batch(rows.wrench, without_rows=not solved)
    answered = (replies.coverage != _OUTSIDE)[:, None]
    if not solved or error is not None:
        # Far from its rows a kriging extrapolates and has no error bar.
        answered = answered & np.isfinite(replies.errors)
    expected = np.where(answered, replies.outputs, np.nan)
    bar = np.where(answered, replies.errors, np.nan)
    return _Answers(packed.answers_by(), replies.coverage, expected, bar, noise)


def comparison(
    component: Component,
    rows: Rows,
    version: int,
    error: SolverError | None,
    spans: Spans = (),
    number: int | None = None,
    against: int | None = None,
) -> Comparison:
    """Return measured rows beside a reference.

    `rows`, `version`: of the component's table, in ascending order of `seq`.
    `error`: error of the solver; None if unknown.
    `spans`: the rows of each import.
    `number`: the import whose rows are compared; all measured rows if None.
    `against`: the import whose rows are the reference; the solves if None.

    Raises UncomparableError if the table has no measured rows of an import, or the two are the
    same.
    """
    of_import = import_numbers(spans, rows.seq)  # (n,): 0 for a row without an import
    measured = rows.source != SOLVED
    for wanted in (number, against):
        if wanted is not None and not (measured & (of_import == wanted)).any():
            listed = np.unique(of_import[measured & (of_import > 0)])[-10:].tolist()
            known = ", ".join(map(str, listed))
            advice = f"its newest are {known}" if known else "import a file of measured rows first"
            raise UncomparableError(f"the table has no measured rows of import {wanted}; {advice}")
    if number is not None and number == against:
        raise UncomparableError(f"import {number} cannot be its own reference; name another import")
    of_reference = ~measured if against is None else measured & (of_import == against)
    chosen = measured & ~of_reference & (number is None or of_import == number)
    inside = np.asarray(component.load_range.holds(rows.wrench))
    selected = _even_choice(np.flatnonzero(chosen & inside), MAX_COMPARED)
    available = used = np.flatnonzero(of_reference)
    if against is not None:
        used = _even_choice(available, MAX_REFERENCE)

    compared, reference = rows.take(selected), rows.take(used)
    solved = against is None
    answers = _answers(component, compared, reference, error, solved=solved)
    stated = np.ascontiguousarray(compared.uncertainty)  # contiguous for the JSON writer
    scatter = _scatter(stated, answers.noise)

    def summaries(mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Return the differences of each output over the rows of a mask, (k,)."""
        columns = compared.displacement, answers.expected, answers.bar, scatter
        return {
            name: _summary(*(column[mask, output] for column in columns))
            for output, name in enumerate(component.space.output_names)
        }

    campaign = of_import[selected]
    campaigns = []
    for of_campaign in np.unique(campaign).tolist():
        mask = campaign == of_campaign
        part = {"rows": int(mask.sum()), "outputs": summaries(mask)}
        campaigns.append({"import": of_campaign or None, **part})
    coverage = [NAMES[code] for code in answers.coverage.tolist()]
    return Comparison(
        component=component.name,
        table_version=version,
        inputs=component.space.input_names,
        reference={
            "import": against,
            "rows": len(reference),
            "of": len(available),
            "method": answers.method,
            "bars_are_complete": not solved or error is not None,
        },
        measured=int(chosen.sum()),
        beyond_range=int((chosen & ~inside).sum()),
        compared=len(compared),
        coverages={name: coverage.count(name) for name in NAMES},
        noise=answers.noise,
        reason=_incomparable(component, compared, reference, against),
        outputs=summaries(np.ones(len(compared), dtype=bool)),
        campaigns=campaigns,
        row=compared.seq.tolist(),
        campaign=[of_campaign or None for of_campaign in campaign.tolist()],
        coverage=coverage,
        wrench=compared.wrench,
        displacement=compared.displacement,
        expected=answers.expected,
        residual=compared.displacement - answers.expected,
        bar=answers.bar,
        uncertainty=stated,
    )


def _incomparable(
    component: Component, compared: Rows, reference: Rows, against: int | None
) -> str:
    """Return the reason for which there is no comparison; empty if there is one."""
    if not component.has_fea and against is None:
        return (
            f"{component.name!r} has no finite-element setup, so it has no solves; compare two "
            "imports with against (--import A --against B)"
        )
    if not len(reference):
        return "there is no solved row; fill the table"
    if len(compared):
        return ""
    beside = "" if against is None else f" beside those of import {against}"
    return f"there is no measured row{beside}; import some"


def _scatter(stated: Floats, noise: Floats) -> Floats:
    """Return the 95 % scatter of readings, (k, m): the `noise`, (m,), where none is stated."""
    return np.where(np.isfinite(stated), stated, noise)


def _bound(bar: Floats, scatter: Floats) -> Floats:
    """Return the 95 % half width of a residual: the reference's own if no scatter is known."""
    return np.hypot(bar, np.where(np.isfinite(scatter), scatter, 0.0))


def _summary(measured: Floats, expected: Floats, bar: Floats, scatter: Floats) -> dict[str, Any]:
    """Return the differences of one output, (n,) each, m or rad: None if unknown."""
    residual = measured - expected
    bound = _bound(bar, scatter)
    known = residual[np.isfinite(residual)]
    factor, half_width, of_reference = scale_factor(measured, expected, bar, scatter)
    numbers = {
        "mean": known.mean() if len(known) else np.nan,
        "rms": np.sqrt(np.mean(known**2)) if len(known) else np.nan,
        "factor": factor,
        "half_width": half_width,
        "of_reference": of_reference,
    }
    return {
        "compared": len(known),
        "unanswered": int((np.isfinite(measured) & np.isnan(expected)).sum()),
        "beyond_bars": int((np.abs(residual) > bound).sum()),
        "bars_unknown": int((np.isfinite(residual) & np.isnan(bound)).sum()),
        **{name: float(value) if np.isfinite(value) else None for name, value in numbers.items()},
    }


def comparison_csv(reply: Comparison, space: Space) -> str:
    """Return the rows of a comparison as CSV, SI; a cell is empty if its number is unknown."""
    head = ["row", "import", "coverage", *(f"{item.name} [{item.unit}]" for item in space.inputs)]
    for kind in _KINDS:
        more = "" if kind == "displacement" else f"_{kind}"
        head += [f"{item.name}{more} [{item.unit}]" for item in space.outputs]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([name.replace("·", "*") for name in head])
    numbers = np.hstack([reply.wrench, *(getattr(reply, kind) for kind in _KINDS)]).tolist()
    names = zip(reply.row, reply.campaign, reply.coverage, strict=True)
    for first, line in zip(names, numbers, strict=True):
        writer.writerow([*first, *(None if value != value else value for value in line)])
    return file.getvalue()


def disagreement(
    component: Component, rows: Rows, version: int, error: SolverError | None
) -> Disagreement:
    """Return the measured rows outside the error bars of reading and solves.

    `error`: error of the solver; None if unknown.
    """
    if error is None:
        # Without it no answer would have an error bar: that of the interpolation decides.
        span = component.load_range
        zero = np.zeros((len(span.space.outputs), len(span.low)))
        error = SolverError({"mesh": zero.tolist(), "loads": span.scale.tolist()})
    reply = comparison(component, rows, version, error)
    bound = _bound(reply.bar, _scatter(reply.uncertainty, reply.noise))
    compared = np.isfinite(reply.residual) & np.isfinite(bound)
    ratio = np.abs(reply.residual) / np.maximum(bound, np.finfo(float).tiny)
    ratio = np.where(compared, ratio, 0.0)
    return Disagreement(
        component=component.name,
        table_version=version,
        measured=reply.measured,
        solved=reply.reference["of"],
        beyond_range=reply.beyond_range,
        compared=int(compared.any(axis=1).sum()),
        outside=int((ratio > 1.0).any(axis=1).sum()),
        not_told=int((~compared.any(axis=1)).sum()) if not reply.reason else None,
        outputs={
            name: {
                "compared": summary["compared"] - summary["bars_unknown"],
                "outside": summary["beyond_bars"],
                "mean_difference": summary["mean"],
            }
            for name, summary in reply.outputs.items()
            if not reply.reason
        },
        rows=_outliers(component.space, reply, bound, ratio)[:MAX_LISTED],
        reason=reply.reason,
    )


def _outliers(
    space: Space, reply: Comparison, bound: Floats, ratio: Floats
) -> list[DisagreeingRow]:
    """Return the rows and outputs whose `ratio` of residual and `bound` (k, m) is above 1.

    The largest ratio comes first.
    """
    rows = [
        DisagreeingRow(
            row=reply.row[at],
            wrench=dict(zip(space.input_names, reply.wrench[at].tolist(), strict=True)),
            output=space.output_names[output],
            measured=float(reply.displacement[at, output]),
            expected=float(reply.expected[at, output]),
            bar=float(bound[at, output]),
            ratio=float(ratio[at, output]),
        )
        for at, output in np.argwhere(ratio > 1.0).tolist()
    ]
    return sorted(rows, key=lambda row: -row.ratio)
