"""LM_start: the solves of what a recording, an envelope or another setup of a component holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import JobRecord, packed
from wrenchbook.service.library.component import Component
from wrenchbook.service.recording.store import RecordingStore
from wrenchbook.service.recording.thinning import farthest_first, scaled_loads
from wrenchbook.service.submission import NoSetupError
from wrenchbook.service.tables.rows import unsolved
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.answer import COVERED

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class StartedSolves:
    """The jobs that wait or run for these wrenches, and counts of the others.

    `solved` are rows of the table already, `covered` are covered by it, `failed` have failed
    before, `beyond_range` lie outside the load range, `left` exceed the budget. `reason` says why
    not all are queued, or why none is; it is empty if all are.
    """

    jobs: list[JobRecord]
    solved: int = 0
    covered: int = 0
    failed: int = 0
    beyond_range: int = 0
    left: int = 0
    reason: str = ""


def start_recording(
    workspace: Workspace, name: str, store: RecordingStore, *, budget: int, beyond_range: bool
) -> StartedSolves:
    """Queue the solves of recorded wrenches that the table does not cover.

    The wrench farthest from all that is solved or queued comes first, so that a budget is spent
    where it gains most. The recording stays as it is. Raises UnknownComponentError, NoSetupError if
    nothing can be solved for it, TableBehindError if the table does not hold all rows yet.
    """
    component = _solvable(workspace, name)
    wrenches = store.recording(name).wrenches
    if component.linear:
        return _start_linear(workspace, component, wrenches, beyond_range)
    # First what is queued, then what is known: see `Workspace.fill`.
    pending = workspace.submission.pending_wrenches(name)
    table = workspace.tables.caught_up(name, CATCH_UP_S)
    inside, beyond = _within(component, wrenches, beyond_range)
    solved = _are_rows(inside, table.rows.wrench)
    covered = np.zeros(len(inside), dtype=bool)
    if len(inside):
        covered = (table.packed.batch(inside).coverage == COVERED) & ~solved
    counts = StartedSolves([], int(solved.sum()), int(covered.sum()), beyond_range=beyond)
    known = np.concatenate([table.rows.wrench, pending])
    left = inside[~solved & ~covered]
    return _submitted(workspace, component, left, known, budget, counts, "recording")


def start_envelope(
    workspace: Workspace, name: str, store: RecordingStore, *, beyond_range: bool
) -> StartedSolves:
    """Queue the solves of the wrenches that reached an envelope's extremes, covered or not.

    Raises as `start_recording` does.
    """
    component = _solvable(workspace, name)
    envelope = store.envelope(name)
    wrenches = np.concatenate([envelope.lowest, envelope.highest])
    wrenches = np.unique(wrenches, axis=0) if len(wrenches) else wrenches
    if component.linear:
        return _start_linear(workspace, component, wrenches, beyond_range)
    known = workspace.tables.caught_up(name, CATCH_UP_S).rows.wrench
    inside, beyond = _within(component, wrenches, beyond_range)
    solved = _are_rows(inside, known)
    counts = StartedSolves([], int(solved.sum()), beyond_range=beyond)
    left = inside[~solved]
    return _submitted(workspace, component, left, known, len(left), counts, "envelope")


def start_resolving(
    workspace: Workspace, name: str, *, budget: int, beyond_range: bool
) -> StartedSolves:
    """Queue a solve for each wrench of rows of another setup that no row of the table has.

    Raises as `start_recording` does.
    """
    component = workspace.submission.solvable(name)
    others = workspace.ledger.of_other_setups(name, component.fingerprint)
    wrenches = unsolved(component, others, np.empty((0, len(component.space.inputs))))
    if not len(wrenches):
        return StartedSolves([], reason=f"no row of {name!r} belongs to another setup")
    if component.linear:
        return _start_linear(workspace, component, wrenches, beyond_range)
    known = workspace.tables.caught_up(name, CATCH_UP_S).rows.wrench
    left = unsolved(component, others, known)
    inside, beyond = _within(component, left, beyond_range)
    counts = StartedSolves([], len(wrenches) - len(left), beyond_range=beyond)
    return _submitted(workspace, component, inside, known, budget, counts, "resolve")


def _solvable(workspace: Workspace, name: str) -> Component:
    component = workspace.library[name]
    if not component.has_fea:
        raise NoSetupError(
            f"{name!r} has rows loaded from outside and no finite-element setup, so nothing was "
            "queued; the recorded wrenches stay. GET them, measure or solve them elsewhere, "
            f"and load the rows: POST /v1/components/{name}/table."
        )
    return component


def _within(component: Component, wrenches: Floats, beyond_range: bool) -> tuple[Floats, int]:
    """Return the wrenches, (n, inputs), that may be solved, and how many may not."""
    if beyond_range or not len(wrenches):
        return wrenches, 0
    holds = component.load_range.holds(wrenches)
    return wrenches[holds], int((~holds).sum())


def _are_rows(wrenches: Floats, known: Floats) -> NDArray[np.bool_]:
    """Which wrenches, (n, inputs), are rows of the table, (k, inputs): shape (n,)."""
    rows = set(packed(known))
    return np.array([key in rows for key in packed(wrenches)], dtype=bool)


def _submitted(
    workspace: Workspace,
    component: Component,
    wrenches: Floats,
    known: Floats,
    budget: int,
    counts: StartedSolves,
    purpose: str,
) -> StartedSolves:
    """Accept the jobs of wrenches, (n, inputs); a wrench that is queued costs no budget."""
    keys = packed(wrenches)
    jobs = workspace.ledger.jobs_for(component.name, component.fingerprint, keys)
    status = [jobs[key].status if key in jobs else "" for key in keys]
    fresh = np.flatnonzero([state in ("", "cancelled", "done") for state in status])
    scale = component.load_range.scale
    order = farthest_first(scaled_loads(wrenches[fresh], scale), scaled_loads(known, scale), budget)
    accepted = workspace.submission.fill(component.name, wrenches[fresh[order]], asked_by=purpose)
    present = [jobs[key] for key in keys if key in jobs]
    queued = [job for job in present if job.status in ("waiting", "running")]
    failed, left = status.count("failed"), len(fresh) - len(order)
    reasons = []
    if left:
        reasons.append(f"{left} are left by the budget: start again once these are solved")
    if failed:
        reasons.append(
            f"{failed} have failed before: see GET /v1/jobs?status=failed and retry them"
        )
    if counts.beyond_range:
        beyond = f"{counts.beyond_range} are outside the load range"
        reasons.append(f"{beyond}: start with beyond_range true to solve them all the same")
    if not len(wrenches) and not reasons:
        any_known = counts.solved + counts.covered
        reasons.append("the table covers all of them" if any_known else "nothing was gathered yet")
    return StartedSolves(
        queued + [job for job in accepted if not job.is_final],
        counts.solved,
        counts.covered,
        failed,
        counts.beyond_range,
        left,
        "; ".join(reasons),
    )


def _start_linear(
    workspace: Workspace, component: Component, wrenches: Floats, beyond_range: bool
) -> StartedSolves:
    """Queue the solves of a linear component's compliance: it answers every wrench."""
    if not len(wrenches):
        return StartedSolves([], reason="nothing was gathered yet")
    inside, beyond = _within(component, wrenches, beyond_range)
    if not workspace.tables.caught_up(component.name, CATCH_UP_S).needs_compliance:
        reason = "the component is linear and its compliance known: it answers every wrench"
        return StartedSolves([], covered=len(inside), beyond_range=beyond, reason=reason)
    workspace.fill(component.name, len(component.space.inputs), None)
    queued = workspace.ledger.open_jobs(component.name, component.fingerprint)
    reason = "the component is linear: its compliance, once solved, answers every wrench"
    if not queued:
        reason = (
            "the component is linear and the solves of its compliance have failed: see "
            "GET /v1/jobs?status=failed and retry them"
        )
    jobs = [workspace.ledger.job(job.id) for job in queued]
    return StartedSolves(jobs, beyond_range=beyond, reason=reason)
