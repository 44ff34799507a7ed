"""The walk of the main call and of DirectFEA: from one query to its answer or its solve."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from time import perf_counter_ns
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool

from wrenchbook.service.answering.queries import Outcome, Query, also
from wrenchbook.service.answering.refusals import (
    BeyondRangeError,
    NotCoveredError,
    SolveFailedError,
)
from wrenchbook.service.client.replies import EXACT, ROUNDED
from wrenchbook.service.contract import by_part
from wrenchbook.service.ledger import JobRecord
from wrenchbook.service.library.component import Component
from wrenchbook.service.submission import Placed
from wrenchbook.service.tables.mapped import ROW, ROW_DETAIL, ServedTable, others_in_words
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.kernel.explain import explain
from wrenchbook.surrogate.kernel.replies import Reply
from wrenchbook.surrogate.rig_error import error_of_a_reading
from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError
from wrenchbook.surrogate.table.rows import acting_one, why_beyond

Bars = Sequence[float | None]


def answer_at_once(workspace: Workspace, name: str, query: Query) -> Outcome | None:
    """Return what `answer_or_submit` does to a plain query, if the table alone answers it.

    None where that needs a solve, another thread or a refusal. Not for `solve`, another method
    than the component's own, `detail` or `derivatives`.

    Raises
    ------
    UnknownComponentError
        If there is no such component.
    """
    table = workspace.surrogate(name)
    outcome = _from_table(name, table, query)
    if outcome.coverage != "covered":
        if query.on_thin != "estimate" or table.needs_compliance:
            return None
        if not table.row_count:
            return None  # rows that are being built are part of the reason
        _note(workspace, query, outcome)
    return outcome


async def answer_or_submit(workspace: Workspace, name: str, query: Query) -> Outcome:
    """Answer a query from a component's table or, where that is too thin, by a solve.

    Raises
    ------
    UnknownComponentError
        If there is no such component.
    NotCoveredError
        If the table does not cover the wrench and ``on_thin`` is ``reject``.
    BeyondRangeError
        If a solve was to be waited for, and the wrench is outside the load range.
    NoSetupError
        If a solve is needed and the component has no finite-element setup.
    SolveFailedError
        If the solve of this wrench failed.
    """
    table = workspace.surrogate(name)
    if query.on_thin == "solve":
        outcome = _unanswered(name, table)
    else:
        outcome = await answered(name, table, query)
        if query.detail:
            tell_parts(workspace, table, query, outcome)
        if outcome.coverage != "covered":
            how = name, table, query.on_thin
            rows = await run_in_threadpool(workspace.rows_being_built, *how)
            known = outcome.reason if table.row_count or not rows else ""
            outcome.reason = also(known, rows)
            _note(workspace, query, outcome)
            if table.needs_compliance:
                await _name_awaited(workspace, query, outcome)
        if outcome.coverage == "covered" or query.on_thin == "estimate":
            return outcome
        refuse_uncovered(query, table, outcome, solved=workspace.library.as_read(name).has_fea)
    return await _submitted(workspace, query, outcome)


def refuse_uncovered(
    query: Query, table: ServedTable, outcome: Outcome, *, solved: bool = False
) -> None:
    """Refuse an answer that is not covered if the request takes no other.

    Parameters
    ----------
    solved
        Whether the component can be solved.

    Raises
    ------
    NotCoveredError
        If ``on_thin`` is ``reject``.
    """
    if query.on_thin == "reject":
        solve = "'queue' or 'wait' to have it solved, or " if solved else ""
        raise NotCoveredError(
            f"{outcome.reason}. Ask with on_thin {solve}'estimate' for the best guess.",
            query.tolerance or table.tolerance,
            reason=outcome.reason,
            coverage=outcome.coverage,
        )


def _note(workspace: Workspace, query: Query, outcome: Outcome) -> None:
    """Count what the table does not cover."""
    component = workspace.library.as_read(outcome.component)
    wrench = _acting(component, query).wrench
    workspace.query_counts.note(outcome.component, component.load_range, wrench, outcome.coverage)


def _acting(component: Component, query: Query) -> Query:
    """Return a query without the loads on locked freedoms: jobs and demand leave these out."""
    return query._replace(wrench=tuple(acting_one(query.wrench, component.idle)))


async def answered(name: str, table: ServedTable, query: Query) -> Outcome:
    """Answer here by the component's own method; others may have to be built first, elsewhere."""
    if query.method is None:
        outcome = _from_table(name, table, query)
    else:
        outcome = await run_in_threadpool(_from_table, name, table, query)
    request = query.wrench, table.limits(query.tolerance), query.method
    if query.derivatives:
        outcome.derivative = table.packed.derivative(*request)
    if query.detail:
        # A row answers without the axes, which only one interface alone has.
        by_axes = outcome.method != ROW and table.load_range.space.is_default
        outcome.axes = await run_in_threadpool(explain, table.packed, *request) if by_axes else []
        outcome.method_detail = table.method_detail(outcome.method or table.default)
    return outcome


def tell_parts(workspace: Workspace, table: ServedTable, query: Query, outcome: Outcome) -> None:
    """Add the parts whose sum an answer's error bar is."""
    found = table.packed.answer(query.wrench, table.limits(query.tolerance), query.method)
    solver, shares = table.solver_error, {}
    if solver is not None:
        shares["mesh"] = found.discretisation
        if "linearity" in solver.values:
            shares["linearity"] = found.linearity
    has_fea = workspace.library.as_read(outcome.component).has_fea
    parts = _error_parts(found.interpolation, solver, shares, table.interfaces, has_fea=has_fea)
    if parts is not None and any(found.measurement or ()):
        parts["measurement"] = _split(found.measurement, table.interfaces)
    outcome.error_parts = parts
    outcome.error_of_a_reading = _split(_of_a_reading(table, found), table.interfaces)


def _of_a_reading(table: ServedTable, found: Reply) -> Bars | None:
    """Return the error bars of one more reading, six, m and rad; None where not known."""
    noise = table.summary.get("noise_of_a_reading")
    parts = found.error, found.interpolation, noise
    if any(part is None or None in part for part in parts):
        return None
    return tuple(error_of_a_reading(*(np.array(part, dtype=float) for part in parts)).tolist())


def _error_parts(
    table: Bars | None,
    solver: SolverError | None,
    shares: Mapping[str, Bars | None],
    interfaces: Sequence[str],
    *,
    has_fea: bool,
) -> dict[str, Any] | None:
    """Return the shares of a bar in the form of a reply.

    Parameters
    ----------
    table
        The table's own bars, six an interface, m and rad; None where it has none.
    solver
        What the solver may be wrong by; None if unknown.
    shares
        From `SolverError.parts`, six an interface an entry, m and rad.
    interfaces
        Their names where there are several.
    has_fea
        Whether rows come of a solver at all: measured tables have no share of one.

    Returns
    -------
    dict or None
        ``table``, ``mesh`` and of a linear component ``linearity``, each ``{"translation",
        "rotation"}`` like ``error``, or None where it is not known; ``mesh_basis`` in words.
    """
    if table is None:
        return None
    parts: dict[str, Any] = {"table": _split(table, interfaces)}
    if not has_fea:
        return parts
    if solver is None:
        return parts | {"mesh": None, "mesh_basis": UNKNOWN}
    parts |= {cause: _split(share, interfaces) for cause, share in shares.items()}
    words = {name: text for name, text in solver.values.items() if name.endswith("_basis")}
    return parts | words


def _split(bars: Bars | None, interfaces: Sequence[str]) -> dict[str, Any] | None:
    return None if bars is None else by_part(list(bars), interfaces)


def _from_table(name: str, table: ServedTable, query: Query) -> Outcome:
    """Answer by the table as it is."""
    started = perf_counter_ns()
    found = table.packed.answer(query.wrench, table.limits(query.tolerance), query.method)
    elapsed_us = (perf_counter_ns() - started) / 1e3
    source, reason = "table" if found.outputs else None, found.reason
    if found.row is not None:
        source = found.source
        reason = f"{EXACT if found.exact else ROUNDED} {reason}".rstrip()
    outcome = Outcome(
        name,
        found.outputs,
        found.error,
        found.coverage,
        source,
        found.method,
        table.version,
        elapsed_us,
        reason,
    )
    outcome.missing, outcome.interfaces = found.missing, table.interfaces
    if found.coverage != "covered" and table.other_wrenches:
        outcome.reason = also(reason, others_in_words(name, table))
    outcome.within_tolerance = found.within_tolerance
    return outcome


def _unanswered(name: str, table: ServedTable) -> Outcome:
    interfaces = table.interfaces
    return Outcome(name, None, None, "thin", None, None, table.version, 0.0, interfaces=interfaces)


async def _submitted(workspace: Workspace, query: Query, outcome: Outcome) -> Outcome:
    """Have the wrench solved as the query wants it, and take the solve's row if it is there."""
    outcome.began = time.time()
    query = _acting(workspace.library.as_read(outcome.component), query)
    if query.on_thin != "solve":
        wrench = np.array([query.wrench])
        rows = await run_in_threadpool(workspace.unbuilt_rows, outcome.component, wrench)
        if rows[0]:
            return await run_in_threadpool(_by_row, workspace, query, outcome, int(rows[0]))
    if query.on_thin == "queue":
        placed = await run_in_threadpool(_queued, workspace, query, outcome)
    else:
        job = await run_in_threadpool(_own_job, workspace, query, outcome.component)
        if query.wait_s and not job.is_final:
            (job,) = await workspace.polls.wait_all([job.id], query.wait_s)
        placed = Placed(job, own=True)
    outcome.unsolved, outcome.job = True, placed.job
    if placed.job is None or not placed.own:
        return outcome
    if placed.job.status == "failed":
        raise SolveFailedError(placed.job)
    if placed.job.row is not None:
        return await run_in_threadpool(_by_row, workspace, query, outcome, placed.job.row)
    return outcome


def _queued(workspace: Workspace, query: Query, outcome: Outcome) -> Placed:
    """Queue without getting in the way of a loop: a wrench that is not queued has a reason."""
    component = workspace.submission.solvable(outcome.component)
    wrench = np.array([query.wrench])
    if not query.beyond_range and not component.load_range.holds(wrench)[0]:
        beyond = why_beyond(component.load_range, wrench[0])
        own = "" if outcome.reason == beyond else outcome.reason
        why = f"no solve is queued beyond the load range unless beyond_range: {beyond}"
        outcome.reason = also(own, why)
        return Placed(None, own=False)
    placed = workspace.submission.queue(outcome.component, wrench)[0]
    if placed.job is None:
        limit = workspace.submission.queue_limit
        outcome.reason = also(
            outcome.reason,
            f"no solve is queued: {limit} jobs of queries are open already (serve --queue-limit)",
        )
    return placed


def _own_job(workspace: Workspace, query: Query, name: str) -> JobRecord:
    """Accept the job of exactly this wrench."""
    component = workspace.submission.solvable(name)
    wrench = np.array([query.wrench])
    if not query.beyond_range and not component.load_range.holds(wrench)[0]:
        raise BeyondRangeError(
            f"{why_beyond(component.load_range, wrench[0])}. Nothing was queued. Ask with "
            "beyond_range true to have it solved all the same.",
            coverage="outside",
        )
    return workspace.submission.own(
        name, query.wrench, urgent=query.wait_s > 0, asked_by=query.on_thin
    )


def _by_row(workspace: Workspace, query: Query, outcome: Outcome, seq: int) -> Outcome:
    """Answer with the row of a solve in the place of the table's estimate."""
    table, query = workspace.row_table(outcome.component, seq), query._replace(method=None)
    found = _from_table(outcome.component, table, query)
    if query.derivatives:
        found.derivative = table.packed.derivative(query.wrench, table.limits(query.tolerance))
    if query.detail:
        tell_parts(workspace, table, query, found)
        found.axes, found.method_detail = [], ROW_DETAIL
    found.job, found.row, found.elapsed_us = outcome.job, seq, outcome.elapsed_us
    found.notes = workspace.notes(outcome.job) if outcome.job else []
    return found


async def _name_awaited(workspace: Workspace, query: Query, outcome: Outcome) -> None:
    """Name the job whose answer will be the whole truth of a linear component."""
    if query.on_thin not in ("estimate", "reject"):
        return  # the others are given a job themselves
    job = await run_in_threadpool(workspace.first_open_job, outcome.component)
    if job is not None:
        awaited = f"job {job.id} solves the component's compliance: ask again once it is done"
        outcome.reason = also(outcome.reason, awaited)
