"""From a query to its answer by a table, or to its solve. All quantities are SI.

`answer` only computes; `submit` and `submit_many` use the ledger, in one thread.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import hypot
from time import perf_counter_ns
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from starlette.concurrency import run_in_threadpool

from wrenchbook.fea.spec.schema import LARGEST_LOAD
from wrenchbook.service.client.replies import EXACT, ROUNDED
from wrenchbook.service.contract import QUERY_WAIT_S, OnThin, by_part, counted
from wrenchbook.service.ledger import JobRecord, LedgerUnavailableError
from wrenchbook.service.library.component import Component
from wrenchbook.service.submission import Placement
from wrenchbook.service.tables import mapped
from wrenchbook.service.tables.mapped import ServedTable, TableBehindError
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.findings.find import error_of_a_reading
from wrenchbook.surrogate.kernel.explain import explain
from wrenchbook.surrogate.kernel.replies import Replies, Reply
from wrenchbook.surrogate.solver_error import UNKNOWN
from wrenchbook.surrogate.table.merging import RowIndex
from wrenchbook.surrogate.table.rows import Floats, Rows, Tolerance, acting_wrench, why_beyond

Handling = OnThin | Literal["solve"]

_PLAIN_FIELDS = frozenset({"force", "moment", "on_thin"})
_NUMBERS = frozenset({int, float})  # not bool, which is an int to isinstance
_ON_THIN: dict[str, OnThin] = {word: word for word in get_args(OnThin)}


class Query(NamedTuple):
    """A query of the main call, of a batch or of DirectFEA.

    A tuple, since a dataclass takes three times as long to make, in each call of a loop.
    `on_thin` "solve" uses no table; without `method` or `tolerance` the component's apply. A batch
    has its wrenches separately: its `wrench` is empty.
    """

    wrench: tuple[float, ...]
    on_thin: Handling = "queue"
    wait_s: float = QUERY_WAIT_S
    tolerance: Tolerance | None = None
    method: str | None = None
    detail: bool = False
    beyond_range: bool = False
    derivatives: bool = False


class RefusedError(Exception):
    """A refusal with its remedy; `facts` are for programs."""

    def __init__(self, message: str, **facts: Any) -> None:
        super().__init__(message)
        self.facts = facts


class NotCoveredError(RefusedError):
    """The table does not cover the wrench, and the query accepts no other answer.

    The message ends with the values of on_thin that get one, and with the tolerance `limit`.
    """

    def __init__(
        self, why: str, component: Component, wrench: Floats, limit: Tolerance | None, **facts: Any
    ) -> None:
        inside = component.load_range.holds(wrench)[0]
        how = "" if inside else " with beyond_range (--beyond-range)"
        solve = f"'queue' or 'wait'{how} for a solve, or " if component.has_fea else ""
        message = f"{why} Ask with on_thin {solve}'estimate' for the best guess."
        tolerance = None
        if limit is not None:
            message = f"{message} Tolerance: {limit.translation:g} m, {limit.rotation:g} rad."
            tolerance = {"translation": limit.translation, "rotation": limit.rotation}
        super().__init__(message, tolerance=tolerance, **facts)


class BeyondRangeError(RefusedError):
    """The wrench is outside the load range, and the query does not allow that."""


class SolveFailedError(RefusedError):
    """The solve of this wrench failed."""

    def __init__(self, job: JobRecord) -> None:
        error = job.error or {}
        message, remedy = error.get("message", ""), error.get("remedy", "")
        # Failures that older versions stored end in their remedy already.
        text = message if message.endswith(remedy) else f"{message} {remedy}"
        retry = f"Once it is repaired, POST /v1/jobs/{job.id}/retry."
        super().__init__(f"{text} {retry}".strip(), job=job_link(job), error=error)
        self.kind = error.get("kind", "unknown")


@dataclass(slots=True)
class Outcome:
    """The kernel's reply, and the solve that gave it or will give it.

    `unsolved`: a solve was requested and is not done. `began`: the begin of the request that has
    the job, s since the epoch; later jobs are new. `row`: the ledger's number of a solve's row,
    `notes` those of its solver. `details`: further fields of the reply.
    """

    component: str
    table: ServedTable
    reply: Reply
    elapsed_us: float
    unsolved: bool = False
    job: JobRecord | None = None
    began: float | None = None
    row: int | None = None
    notes: list[str] = field(default_factory=list)
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class BatchOutcome:
    """The kernel's replies to wrenches; `jobs`: those of uncovered wrenches, by their index.

    `derivatives` (k, outputs, inputs) has NaN where du/dw is unknown; `tolerance` is that of the
    error bars; `began` as in `Outcome`.
    """

    component: str
    table: ServedTable
    replies: Replies
    elapsed_us: float
    method: str
    began: float
    jobs: dict[int, Placement] = field(default_factory=dict)
    derivatives: Floats | None = None
    tolerance: Tolerance | None = None

    @property
    def unsolved(self) -> bool:
        """Whether a requested solve is not done."""
        return any(queued.job is None or not queued.job.is_final for queued in self.jobs.values())


# The reply before a solve that no table answers.
_NOTHING = Reply._make([None] * len(Reply._fields))._replace(
    coverage="thin", reason="", method="", exact=False, missing=()
)


def plain_query(fields: Any) -> Query | None:
    """Return the query of a body of only force, moment and on_thin; None if it is unusual."""
    if type(fields) is not dict or not fields.keys() <= _PLAIN_FIELDS:
        return None
    force, moment = fields.get("force"), fields.get("moment")
    if type(force) is not list or type(moment) is not list or len(force) != 3 or len(moment) != 3:
        return None
    numbers = (*force, *moment)
    # Finite loads that are too large together: pydantic finds the one that is too large, if any.
    if not _NUMBERS.issuperset(map(type, numbers)) or hypot(*numbers) > LARGEST_LOAD:
        return None
    word = fields.get("on_thin", "queue")
    on_thin = _ON_THIN.get(word) if type(word) is str else None
    # Adding zero converts all to floats, and -0 to 0.
    return Query(tuple([number + 0.0 for number in numbers]), on_thin) if on_thin else None


def answer(table: ServedTable, query: Query) -> Reply:
    """Return the table's reply to a query: nothing is read, queued or counted."""
    reply = table.packed.answer(query.wrench, table.limits(query.tolerance), query.method)
    if reply.row is None:
        return reply
    return reply._replace(reason=f"{EXACT if reply.exact else ROUNDED} {reply.reason}".rstrip())


def table_answer(workspace: Workspace, name: str, query: Query) -> Outcome:
    """Return the answer of a component's newest table.

    Raises UnknownComponentError if there is no such component.
    """
    table = workspace.tables.surrogate(name)
    if query.on_thin == "solve":
        return Outcome(name, table, _NOTHING, 0.0)
    started = perf_counter_ns()
    reply = answer(table, query)
    elapsed_us = (perf_counter_ns() - started) / 1e3
    if reply.coverage != "covered" and table.other_wrenches:
        reply = reply._replace(reason=_joined(reply.reason, mapped.note_on_other_rows(name, table)))
    outcome = Outcome(name, table, reply, elapsed_us)
    if query.derivatives or query.detail:
        _describe(workspace, query, outcome)
    return outcome


def answer_at_once(workspace: Workspace, name: str, query: Query) -> tuple[Outcome, bool]:
    """Return the table's answer, and whether it completes the reply to a plain query.

    It does not if the reply needs a solve, another thread or a refusal.
    """
    outcome = table_answer(workspace, name, query)
    table, coverage = outcome.table, outcome.reply.coverage
    if coverage == "covered":
        return outcome, True
    if query.on_thin != "estimate" or table.needs_compliance or not table.row_count:
        return outcome, False
    component = workspace.library.as_read(name)
    wrench = tuple(acting_wrench(query.wrench, component.idle))
    workspace.demand_maps.note(name, component.load_range, wrench, coverage)
    return outcome, True


async def answer_or_submit(
    workspace: Workspace, name: str, query: Query, outcome: Outcome | None = None
) -> Outcome:
    """Return the answer of a component's table or, if the table is too thin, of a solve.

    `outcome` is the table's answer if it is known already.

    Raises UnknownComponentError if there is no such component, and the errors of `submit`.
    """
    if outcome is None and (query.detail or query.method is not None):
        outcome = await run_in_threadpool(table_answer, workspace, name, query)
    outcome = outcome or table_answer(workspace, name, query)
    if outcome.reply.coverage == "covered":
        return outcome
    outcome = await run_in_threadpool(submit, workspace, query, outcome)
    job = outcome.job
    if query.on_thin in ("wait", "solve") and query.wait_s and job and not job.is_final:
        (outcome.job,) = await workspace.polls.wait_all([job.id], query.wait_s)
        outcome = await run_in_threadpool(_finish, workspace, query, outcome)
    return outcome


def submit(workspace: Workspace, query: Query, outcome: Outcome) -> Outcome:
    """Return the outcome of a query that the table does not cover: a newer row's answer, or a job.

    Raises NotCoveredError if the query accepts only covered answers, BeyondRangeError if it waits
    for a solve outside the load range, NoSetupError if nothing can be solved, SolveFailedError if
    the solve of this wrench failed, TableBehindError if only rows that are being built can answer.
    """
    name = outcome.component
    outcome.began = time.time()
    if outcome.table.needs_compliance:
        workspace.surrogate(name)  # queues its solves
    component = workspace.library[name]
    # Jobs and statistics leave out the loads on locked freedoms.
    query = query._replace(wrench=tuple(acting_wrench(query.wrench, component.idle)))
    wrench = np.array([query.wrench])
    if query.on_thin != "solve":
        rows = _note_uncovered(workspace, component, query, outcome)
        if query.on_thin == "estimate":
            return outcome
        row = _rows_at(component, rows, wrench)[0]
        if row is not None:
            return _by_row(workspace, query, outcome, row)
    outcome.unsolved = True
    submission = workspace.submission
    component = submission.solvable(name, outcome.reply.reason)
    if not query.beyond_range and not component.load_range.holds(wrench)[0]:
        beyond = why_beyond(component.load_range, wrench[0])
        remedy = "solve it nevertheless, set beyond_range to true (--beyond-range)"
        if query.on_thin != "queue":
            message = f"{beyond}. Nothing was queued. To {remedy}."
            raise BeyondRangeError(message, coverage="outside")
        reason = without_parts(outcome.reply.reason, beyond)
        why = f"{beyond}; no solve is queued for it: to {remedy}"
        outcome.reply = outcome.reply._replace(reason=_joined(reason, why))
        return outcome
    if query.on_thin == "queue":
        (placement,) = submission.queue(name, wrench)
    else:
        urgent = query.wait_s > 0
        job = submission.accept(name, query.wrench, urgent=urgent, asked_by=query.on_thin)
        placement = Placement(job, exact=True)
    outcome.job = placement.job
    if placement.job is None:
        reason = _joined(outcome.reply.reason, placement.refusal)
        outcome.reply = outcome.reply._replace(reason=reason)
        return outcome
    return _finish(workspace, query, outcome) if placement.exact else outcome


def _note_uncovered(
    workspace: Workspace, component: Component, query: Query, outcome: Outcome
) -> Rows:
    """Count a query that the table does not cover, complete the reason, and refuse it for `reject`.

    Returns the rows that no table has yet.
    """
    table, reply = outcome.table, outcome.reply
    count, rows = workspace.unbuilt(component, table)
    soon = _unbuilt_text(component, table, count)
    reason = _joined(reply.reason if table.row_count or not soon else "", soon)
    workspace.demand_maps.note(component.name, component.load_range, query.wrench, reply.coverage)
    if table.needs_compliance and query.on_thin in ("estimate", "reject"):
        with suppress(LedgerUnavailableError):  # an estimate needs no ledger
            for job in workspace.ledger.open_jobs(component.name, component.fingerprint)[:1]:
                awaited = f"job {job.id} solves the component's compliance"
                reason = _joined(reason, f"{awaited}; ask again once it is done")
    outcome.reply = reply._replace(reason=reason)
    if query.on_thin == "reject":
        wrench = component.acting(np.atleast_2d(query.wrench))
        limit, coverage = query.tolerance or table.tolerance, reply.coverage
        raise NotCoveredError(
            f"{reason}.", component, wrench, limit, reason=reason, coverage=coverage
        )
    return rows


def job_link(job: JobRecord, since: float | None = None) -> dict[str, Any]:
    """Return the short form of a job in displacement answers.

    `since`, the start of a request, s, adds whether this request has queued the job.
    """
    new = {} if since is None else {"new": job.created >= since}
    return {"id": job.id, "status": job.status, "url": f"/v1/jobs/{job.id}", **new}


def fields_of(outcome: Outcome) -> dict[str, Any]:
    """Return the fields of a `messages.Displacement` in the form of its JSON."""
    table, reply = outcome.table, outcome.reply
    value, error, names = reply.outputs, reply.error, outcome.table.interfaces
    fields: dict[str, Any] = {"component": outcome.component}
    if names:
        values = by_part(value, names) if value else {}
        errors = by_part(error, names) if error else {}
        unknown = {"translation": None, "rotation": None}
        fields["displacements"] = {
            name: values.get(name, unknown) | {"error": errors.get(name)} for name in names
        }
    else:
        fields["translation"] = value[:3] if value else None
        fields["rotation"] = value[3:] if value else None
        fields["error"] = {"translation": error[:3], "rotation": error[3:]} if error else None
    fields["coverage"] = reply.coverage
    fields["within_tolerance"] = reply.within_tolerance
    fields["source"] = reply.source or ("table" if value else None)
    fields["method"] = reply.method or None
    fields["table_version"] = table.version
    fields["elapsed_us"] = outcome.elapsed_us
    if reply.reason:
        fields["reason"] = reply.reason
    if reply.missing:
        fields["missing"] = reply.missing
    if outcome.row is not None:
        fields["row"] = outcome.row
    if outcome.notes:
        fields["notes"] = outcome.notes
    if outcome.details:
        fields |= outcome.details
    if outcome.job is not None or outcome.unsolved:
        fields["job"] = outcome.job and job_link(outcome.job, outcome.began)
    return fields


async def answer_or_submit_many(
    workspace: Workspace, name: str, wrenches: Floats, query: Query
) -> BatchOutcome:
    """Return the answers of a component's table to wrenches or, if it is too thin, of solves.

    `queue` places wrenches as those of a loop; `wait` gives each an exact solve. Either adds no
    more open jobs than queries may have.

    Raises UnknownComponentError if there is no such component, and the errors of `submit_many`.
    """
    outcome = await run_in_threadpool(submit_many, workspace, name, wrenches, query)
    open_jobs = {queued.job.id for queued in outcome.jobs.values() if queued.job}
    if query.on_thin == "wait" and outcome.unsolved and open_jobs:
        jobs = await workspace.polls.wait_all(sorted(open_jobs), query.wait_s)
        await run_in_threadpool(_take_rows, workspace, wrenches, query, outcome, {}, jobs)
    return outcome


def submit_many(workspace: Workspace, name: str, wrenches: Floats, query: Query) -> BatchOutcome:
    """Return a table's answers to wrenches (k, inputs), those of newer rows, and jobs of others.

    Raises NotCoveredError if the query accepts only covered answers, BeyondRangeError if it waits
    for solves outside the load range, NoSetupError if nothing can be solved, TableBehindError if
    only rows that are being built can answer.
    """
    table = workspace.surrogate(name)
    began = time.time()
    started = perf_counter_ns()
    options = table.limits(query.tolerance), query.method
    replies = table.packed.batch(wrenches, *options)
    elapsed_us = (perf_counter_ns() - started) / 1e3
    method = table.packed.answers_by(query.method)
    outcome = BatchOutcome(name, table, replies, elapsed_us, method, began)
    if table.bars_are_complete:
        outcome.tolerance = query.tolerance or table.tolerance
    if query.derivatives:
        outcome.derivatives = table.packed.derivatives(wrenches, *options)
    coverage = replies.coverage
    uncovered = np.flatnonzero(coverage)
    if not len(uncovered):
        return outcome
    component = workspace.library[name]
    count, new = workspace.unbuilt(component, table)
    soon = _unbuilt_text(component, table, count)
    acting = component.acting(wrenches)
    workspace.demand_maps.note_batch(name, component.load_range, acting, coverage)
    if query.on_thin == "estimate":
        return outcome
    if query.on_thin == "reject":
        first = query._replace(wrench=tuple(wrenches[uncovered[0]].tolist()))
        reason = _joined(answer(table, first).reason, soon)
        are = "is" if len(uncovered) == 1 else "are"
        why = f"{counted(len(uncovered), 'wrench')} of {len(wrenches)} {are} not covered."
        why += f" The first is number {uncovered[0]}: {reason}."
        wrench, limit = acting[uncovered[:1]], query.tolerance or table.tolerance
        facts = {"reason": reason, "uncovered": uncovered.tolist()}
        raise NotCoveredError(why, component, wrench, limit, **facts)

    rows = dict(zip(uncovered.tolist(), _rows_at(component, new, acting[uncovered]), strict=True))
    known = {index: row for index, row in rows.items() if row is not None}
    uncovered = uncovered[[row is None for row in rows.values()]]
    component = workspace.submission.solvable(name, soon)
    is_beyond = ~component.load_range.holds(acting[uncovered]) & (not query.beyond_range)
    beyond, inside = uncovered[is_beyond].tolist(), uncovered[~is_beyond]
    place_jobs = workspace.submission.queue
    if query.on_thin == "wait":
        place_jobs = workspace.submission.each
        if beyond:
            are = "is" if len(beyond) == 1 else "are"
            raise BeyondRangeError(
                f"{counted(len(beyond), 'wrench')} {are} outside the load range. The first is "
                f"number {beyond[0]}: {why_beyond(component.load_range, acting[beyond[0]])}. "
                "Nothing was queued. To solve them nevertheless, set beyond_range to true "
                "(--beyond-range).",
                beyond=beyond,
            )
    jobs = dict(zip(inside.tolist(), place_jobs(name, acting[inside]), strict=True))
    jobs |= dict.fromkeys(beyond, Placement(None, exact=False, reason="beyond-range"))
    outcome.jobs = dict(sorted(jobs.items()))
    _take_rows(workspace, acting, query, outcome, known)
    return outcome


def known_slopes(derivative: Floats) -> Floats | None:
    """Return du/dw (outputs, inputs) in contiguous form for orjson; None if it is unknown."""
    return None if np.isnan(derivative).all() else np.ascontiguousarray(derivative)


def _joined(reason: str, more: str) -> str:
    """Join two reasons to one text; either may be empty."""
    return f"{reason}; {more}" if reason and more else reason or more


def without_parts(reason: str, repeated: str) -> str:
    """Return a reason without the statements of another."""
    statements = repeated.split("; ")
    return "; ".join(part for part in reason.split("; ") if part not in statements)


def _unbuilt_text(component: Component, table: ServedTable, count: int) -> str:
    """Return the number of rows that are being built into a table, as text; "" if none.

    A table with rows answers, or refuses, by its own version, for any rate of new rows.

    Raises TableBehindError if the table has no rows, and no solve can answer in their place.
    """
    if not count:
        return ""
    rows = f"{count} new row{'s are' if count > 1 else ' is'} being built"
    if not (component.has_fea or table.row_count):
        raise TableBehindError.unbuilt(component.name, rows)
    return f"{rows}; the table answers from them soon"


def _rows_at(component: Component, rows: Rows, wrenches: Floats) -> list[Rows | None]:
    """Return the row at each wrench (k, inputs), within 1e-6 of the range in each load."""
    if not len(rows):
        return [None] * len(wrenches)
    indices = RowIndex(rows.wrench, component.load_range.scale).indices(wrenches)
    return [None if index < 0 else rows.take([index]) for index in indices.tolist()]


def _stored_row(workspace: Workspace, component: Component, seq: int) -> Rows:
    """Return the ledger's row of a number."""
    stored = workspace.ledger.row(seq)
    names = ("seq", "compliance", "curvature", "uncertainty", "source", "fingerprint")
    values = {name: getattr(stored, name) for name in names}
    columns = {name: [value] for name, value in values.items() if value is not None}
    return Rows.of(stored.wrench, stored.displacement, component.space, **columns)


def _by_row(workspace: Workspace, query: Query, outcome: Outcome, row: Rows) -> Outcome:
    """Return the answer of a row that no table has yet."""
    name, job = outcome.component, outcome.job
    component, newest = workspace.library[name], workspace.tables.surrogate(name)
    table = mapped.row_table(component, row, workspace.solver_error(component, newest), newest)
    query = query._replace(method=None)
    notes = workspace.notes(job) if job else []
    reply = answer(table, query)
    seq = int(table.rows.seq[0])
    solved = Outcome(name, table, reply, outcome.elapsed_us, job=job, row=seq, notes=notes)
    _describe(workspace, query, solved)
    return solved


def _finish(workspace: Workspace, query: Query, outcome: Outcome) -> Outcome:
    """Return the answer of the outcome's job if it has ended.

    Raises SolveFailedError if it failed.
    """
    job = outcome.job
    assert job is not None
    if job.status == "failed":
        raise SolveFailedError(job)
    if job.row is None:
        return outcome
    row = _stored_row(workspace, workspace.library[outcome.component], job.row)
    return _by_row(workspace, query, outcome, row)


def _describe(workspace: Workspace, query: Query, outcome: Outcome) -> None:
    """Add the derivative and the details that a query requests."""
    table, reply, details = outcome.table, outcome.reply, outcome.details
    options = query.wrench, table.limits(query.tolerance), query.method
    if query.derivatives:
        details["derivative"] = known_slopes(table.packed.derivative(*options))
    if not query.detail:
        return
    by_row = outcome.row is not None or reply.method == mapped.ROW
    # Only a component of a single wrench has axes, and a row answers without them.
    by_axes = table.load_range.space.is_default and not by_row
    details["axes"] = explain(table.packed, *options) if by_axes else []
    details["method_detail"] = mapped.ROW_DETAIL if by_row else table.method_detail(reply.method)
    has_fea = workspace.library.as_read(outcome.component).has_fea
    if reply.interpolation is not None:
        details["error_parts"] = _error_parts(table, reply, has_fea=has_fea)
    noise = table.summary.get("noise_of_a_reading")
    bars = reply.error, reply.interpolation, noise
    if all(six is not None and None not in six for six in bars):
        six = error_of_a_reading(*(np.array(six, dtype=float) for six in bars)).tolist()
        details["error_of_a_reading"] = by_part(six, table.interfaces)


def _error_parts(table: ServedTable, reply: Reply, *, has_fea: bool) -> dict[str, Any]:
    """Return the parts of an error bar by cause, and their bases as text."""

    def part(bars: Sequence[float | None] | None) -> dict[str, Any] | None:
        return None if bars is None else by_part(bars, table.interfaces)

    parts: dict[str, Any] = {"table": part(reply.interpolation)}
    solver = table.solver_error
    if has_fea and solver is None:
        parts |= {"mesh": None, "mesh_basis": UNKNOWN}
    elif has_fea and solver is not None:
        parts["mesh"] = part(reply.discretisation)
        if "linearity" in solver.values:
            parts["linearity"] = part(reply.linearity)
        parts |= {name: text for name, text in solver.values.items() if name.endswith("_basis")}
    if any(reply.measurement or ()):
        parts["measurement"] = part(reply.measurement)
    return parts


def _take_rows(
    workspace: Workspace,
    wrenches: Floats,
    query: Query,
    outcome: BatchOutcome,
    rows: Mapping[int, Rows],
    jobs: Sequence[JobRecord] = (),
) -> None:
    """Replace the table's answers to wrenches (k, inputs) by those of rows and of done jobs.

    `rows` are by the wrench's index; `jobs` have the newest state of the outcome's, after a wait.
    """
    component = workspace.library[outcome.component]
    newest = workspace.tables.surrogate(outcome.component)
    wrenches = component.acting(wrenches)
    states = {job.id: job for job in jobs}
    by_index = dict(rows)
    for index, placement in outcome.jobs.items():
        if placement.job is not None:
            job = states.get(placement.job.id, placement.job)
            outcome.jobs[index] = replace(placement, job=job)
            if job.row is not None and placement.exact:
                by_index[index] = _stored_row(workspace, component, job.row)
    replies = outcome.replies
    for index, row in by_index.items():
        table = mapped.row_table(component, row, workspace.solver_error(component, newest), newest)
        wrench = wrenches[index, None]
        limits = table.limits(query.tolerance)
        new = table.packed.batch(wrench, limits)
        replies.outputs[index], replies.errors[index] = new.outputs[0], new.errors[0]
        replies.coverage[index] = new.coverage[0]
        if outcome.derivatives is not None:
            outcome.derivatives[index] = table.packed.derivatives(wrench, limits)[0]
