"""The walk of a question to an earlier version of a table: it answers as it did, and is left so.

Nothing is queued, since a solve makes a new version, and nothing is counted as asked for.
"""

from __future__ import annotations

import numpy as np
from anyio import to_thread
from starlette.concurrency import run_in_threadpool

from wrenchbook.service.answering.many import answered_many, refuse_thin
from wrenchbook.service.answering.one import answered, refuse_uncovered, tell_parts
from wrenchbook.service.answering.queries import (
    BatchOutcome,
    BatchQuery,
    Outcome,
    Query,
    QueuedWrench,
    also,
)
from wrenchbook.service.tables.served import ServedTable
from wrenchbook.service.workspace import Workspace

NOT_QUEUED = "no solve is queued: the question is to an earlier version of the table"


async def answer_at(workspace: Workspace, name: str, query: Query, version: int) -> Outcome:
    """Answer a query from a component's table as it was at a version.

    Raises
    ------
    UnknownComponentError
        If there is no such component.
    UnknownVersionError, PastTooLargeError, PastDamagedError
        If that version cannot be asked: see `PastTables.surrogate`.
    NotCoveredError
        If it does not cover the wrench and ``on_thin`` is ``reject``.
    """
    table = await table_at(workspace, name, version)
    outcome = await answered(name, table, query)
    if query.detail:
        tell_parts(workspace, table, query, outcome)
    if outcome.coverage != "covered":
        refuse_uncovered(query, table, outcome)
        if query.on_thin == "queue":
            outcome.unsolved, outcome.reason = True, also(outcome.reason, NOT_QUEUED)
    return outcome


async def answer_many_at(
    workspace: Workspace, name: str, batch: BatchQuery, version: int
) -> BatchOutcome:
    """Answer a batch from a component's table as it was at a version; errors as `answer_at`."""
    table = await table_at(workspace, name, version)
    outcome = await run_in_threadpool(answered_many, name, table, batch)
    thin = np.flatnonzero(outcome.coverage)
    if len(thin):
        refuse_thin(batch, table, thin)
        if batch.on_thin == "queue":
            why = "table-version"
            outcome.jobs = [QueuedWrench(at, None, own=False, reason=why) for at in thin.tolist()]
    return outcome


async def table_at(workspace: Workspace, name: str, version: int) -> ServedTable:
    """Return a component's table as it was at a version; errors as `answer_at`."""
    table = workspace.past.cached(name, version)
    if table is None:
        limit = workspace.past.turns
        table = await to_thread.run_sync(workspace.past.surrogate, name, version, limiter=limit)
    table.prefer(workspace.settings.method)
    return table
