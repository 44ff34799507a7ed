"""The walk of the batch call: many queries to their answers and their solves."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter_ns

import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

from wrenchbook.service.answering.queries import BatchOutcome, BatchQuery, QueuedWrench
from wrenchbook.service.answering.refusals import BeyondRangeError, NotCoveredError
from wrenchbook.service.library.component import Component
from wrenchbook.service.submission import Placed
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.rows import why_beyond

Places = NDArray[np.intp]


async def answer_or_submit_many(workspace: Workspace, name: str, batch: BatchQuery) -> BatchOutcome:
    """Answer a batch from a component's table and, where that is too thin, by solves.

    ``queue`` places wrenches as a loop's are; ``wait`` gives each its own exact solve. Either adds
    no more open jobs than queries may have.

    Raises
    ------
    UnknownComponentError
        If there is no such component.
    NotCoveredError
        If the table does not cover all wrenches and ``on_thin`` is ``reject``.
    BeyondRangeError
        If solves were to be waited for, and a wrench is outside the load range.
    NoSetupError
        If a solve is needed and the component has no finite-element setup.
    """
    outcome = await run_in_threadpool(_answered, workspace, name, batch)
    if batch.on_thin == "wait":
        waited = {one.job.id for one in outcome.jobs if one.job and not one.job.is_final}
        if waited:
            await workspace.polls.wait_all(sorted(waited), batch.wait_s)
            await run_in_threadpool(_look_again, workspace, batch, outcome)
    return outcome


def _answered(workspace: Workspace, name: str, batch: BatchQuery) -> BatchOutcome:
    """Answer from the table, and place what it does not cover."""
    table = workspace.surrogate(name)
    outcome = answered_many(name, table, batch)
    thin = np.flatnonzero(outcome.coverage)
    if len(thin):
        workspace.rows_being_built(name, table, batch.on_thin)
        component = workspace.library.as_read(name)
        span, batch = component.load_range, _acting(component, batch)
        workspace.query_counts.note_batch(name, span, batch.wrenches, outcome.coverage)
    if not len(thin) or batch.on_thin == "estimate":
        return outcome
    refuse_thin(batch, table, thin)
    rows = workspace.unbuilt_rows(name, batch.wrenches[thin])
    for index, row in zip(thin[rows > 0].tolist(), rows[rows > 0].tolist(), strict=True):
        _take_row(workspace, batch, outcome, index, row)
    thin = thin[rows == 0]
    outcome.jobs = _placed(workspace, name, batch, thin)
    _take_rows(workspace, batch, outcome)
    return outcome


def answered_many(name: str, table: ServedTable, batch: BatchQuery) -> BatchOutcome:
    """Answer by a table as it is."""
    started = perf_counter_ns()
    how = table.limits(batch.tolerance), batch.method
    answers = table.packed.batch(batch.wrenches, *how)
    elapsed_us = (perf_counter_ns() - started) / 1e3
    method = table.packed.answers_by(batch.method)
    found = answers.outputs, answers.errors, answers.coverage
    outcome = BatchOutcome(name, *found, table.version, elapsed_us, [], method)
    if table.bars_are_whole:
        outcome.tolerance = batch.tolerance or table.tolerance
    if batch.derivatives:
        outcome.derivatives = table.packed.derivatives(batch.wrenches, *how)
    return outcome


def refuse_thin(batch: BatchQuery, table: ServedTable, thin: Places) -> None:
    """Refuse a batch that wants no wrench but covered ones.

    Raises
    ------
    NotCoveredError
        If ``on_thin`` is ``reject``.
    """
    if batch.on_thin == "reject":
        first = batch.wrenches[thin[0]].tolist()
        reason = table.packed.answer(first, table.limits(batch.tolerance), batch.method).reason
        raise NotCoveredError(
            f"{len(thin)} of {len(batch.wrenches)} wrenches are not covered, the first is number "
            f"{thin[0]}: {reason}. Ask with on_thin 'queue', 'wait' or 'estimate'.",
            batch.tolerance or table.tolerance,
            reason=reason,
            uncovered=thin.tolist(),
        )


def _acting(component: Component, batch: BatchQuery) -> BatchQuery:
    """Return a batch without the loads on locked freedoms: jobs and demand leave these out."""
    return replace(batch, wrenches=component.acting(batch.wrenches))


def _placed(workspace: Workspace, name: str, batch: BatchQuery, thin: Places) -> list[QueuedWrench]:
    """Find a job for each of the thin wrenches, or the reason why it has none."""
    component, submission = workspace.submission.solvable(name), workspace.submission
    out = ~component.load_range.holds(batch.wrenches[thin]) & (not batch.beyond_range)
    if out.any() and batch.on_thin == "wait":
        first = int(thin[out][0])
        raise BeyondRangeError(
            f"{int(out.sum())} wrenches are outside the load range, the first is number {first}: "
            f"{why_beyond(component.load_range, batch.wrenches[first])}. Nothing was queued. Ask "
            "with beyond_range true to have them solved all the same.",
            beyond=thin[out].tolist(),
        )
    place = submission.each if batch.on_thin == "wait" else submission.queue
    within = iter(place(name, batch.wrenches[thin[~out]]))
    return [
        QueuedWrench(index, None, own=False, reason="beyond-range")
        if is_out
        else _with_reason(index, next(within))
        for index, is_out in zip(thin.tolist(), out.tolist(), strict=True)
    ]


def _with_reason(index: int, placed: Placed) -> QueuedWrench:
    return QueuedWrench(index, placed.job, placed.own, "" if placed.job else "queue-limit")


def _look_again(workspace: Workspace, batch: BatchQuery, outcome: BatchOutcome) -> None:
    """Read the jobs anew and take the rows of those that are done by now."""
    numbers = {one.job.id for one in outcome.jobs if one.job}
    now = {number: workspace.ledger.job(number) for number in numbers}
    outcome.jobs = [
        QueuedWrench(one.index, now[one.job.id], one.own) if one.job else one
        for one in outcome.jobs
    ]
    _take_rows(workspace, batch, outcome)


def _take_rows(workspace: Workspace, batch: BatchQuery, outcome: BatchOutcome) -> None:
    """Put the rows of the jobs that are done in the place of the table's estimates."""
    batch = _acting(workspace.library[outcome.component], batch)
    for one in outcome.jobs:
        if one.job is not None and one.job.row is not None and one.own:
            _take_row(workspace, batch, outcome, one.index, one.job.row)


def _take_row(
    workspace: Workspace, batch: BatchQuery, outcome: BatchOutcome, index: int, seq: int
) -> None:
    """Put a row's answer in the place of the table's estimate of one wrench."""
    table, wrench = workspace.row_table(outcome.component, seq), batch.wrenches[index, None]
    found = table.packed.batch(wrench, table.limits(batch.tolerance))
    outcome.displacements[index], outcome.errors[index] = found.outputs[0], found.errors[0]
    outcome.coverage[index] = found.coverage[0]
    if outcome.derivatives is not None:
        tangents = table.packed.derivatives(wrench, table.limits(batch.tolerance))
        outcome.derivatives[index] = tangents[0]
