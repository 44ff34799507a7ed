"""Solves of the wrenches of a recording, of an envelope or of another setup's rows."""

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
from wrenchbook.surrogate.table.rows import Floats

_NOTHING = "nothing is recorded yet; run a simulation with a Recorder or a Mount, then start again"


@dataclass(frozen=True)
class StartedSolves:
    """The waiting or running jobs for these wrenches, and counts of the others.

    `solved` are rows of the table already, `covered` are covered by it, `failed` have failed
    before, `beyond_range` lie outside the load range, `left` exceed the budget. `reason` is empty
    if all wrenches are queued, else it says why some or all are not.
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

    The wrench farthest from all solved and queued ones comes first, which gains most from a budget.
    The recording is not changed.

    Raises UnknownComponentError if there is no such component, NoSetupError if nothing can be
    solved for it, TableBehindError if the table lacks rows.
    """
    component = _solvable(workspace, name)
    wrenches = store.recording(name).wrenches
    return _start(workspace, component, wrenches, budget, "recording", beyond_range=beyond_range)


def start_envelope(
    workspace: Workspace, name: str, store: RecordingStore, *, beyond_range: bool
) -> StartedSolves:
    """Queue the solves of the wrenches at an envelope's extremes; errors of `start_recording`."""
    component = _solvable(workspace, name)
    envelope = store.envelope(name)
    wrenches = np.concatenate([envelope.lowest, envelope.highest])
    wrenches = np.unique(wrenches, axis=0) if len(wrenches) else wrenches
    budget = len(wrenches)
    return _start(workspace, component, wrenches, budget, "envelope", beyond_range=beyond_range)


def start_resolving(
    workspace: Workspace, name: str, *, budget: int, beyond_range: bool
) -> StartedSolves:
    """Queue a solve for each wrench of rows of another setup that no row of the table has.

    Raises the errors of `start_recording`.
    """
    component = workspace.submission.solvable(name)
    others = workspace.ledger.of_other_setups(name, component.fingerprint)
    wrenches = unsolved(component, others, np.empty((0, len(component.space.inputs))))
    if not len(wrenches):
        return StartedSolves([], reason=f"no row of {name!r} belongs to another setup")
    return _start(workspace, component, wrenches, budget, "resolve", beyond_range=beyond_range)


def _solvable(workspace: Workspace, name: str) -> Component:
    """Return a component whose wrenches can be solved; raises NoSetupError if they cannot."""
    component = workspace.library[name]
    if not component.has_fea:
        raise NoSetupError(
            f"{name!r} has no finite-element setup, so nothing was queued. The recorded wrenches "
            f"stay. Measure them, then load the rows with: wrenchbook import {name} FILE"
        )
    return component


def _start(
    workspace: Workspace,
    component: Component,
    wrenches: Floats,
    budget: int,
    purpose: str,
    *,
    beyond_range: bool,
) -> StartedSolves:
    """Accept the jobs of wrenches, (n, inputs); a wrench that is queued costs no budget."""
    holds = np.ones(len(wrenches), dtype=bool)
    if len(wrenches) and not beyond_range:
        holds = component.load_range.holds(wrenches)
    if component.linear:
        return _start_linear(workspace, component, holds)

    name = component.name
    # Queued wrenches are read before the rows: a job that ends in between is then in both.
    pending = workspace.submission.pending_wrenches(name)
    table = workspace.tables.caught_up(name, CATCH_UP_S)
    rows = set(packed(component.acting(table.rows.wrench)))
    solved = np.array([key in rows for key in packed(wrenches)], dtype=bool)
    beyond = int((~holds & ~solved).sum())
    inside = wrenches[holds & ~solved]
    covered = np.zeros(len(inside), dtype=bool)
    if len(inside) and purpose == "recording":
        covered = table.packed.batch(inside).coverage == COVERED

    unknown = inside[~covered]
    keys = packed(unknown)
    jobs = workspace.ledger.jobs_for(name, component.fingerprint, keys)
    status = [jobs[key].status if key in jobs else "" for key in keys]
    fresh = unknown[[state in ("", "cancelled", "done") for state in status]]
    known = np.concatenate([table.rows.wrench, pending])
    scale = component.load_range.scale
    order = farthest_first(scaled_loads(fresh, scale), scaled_loads(known, scale), budget)
    accepted = workspace.submission.fill(name, fresh[order], asked_by=purpose)
    queued = [jobs[key] for key in keys if key in jobs and not jobs[key].is_final]
    queued += [job for job in accepted if not job.is_final]

    failed = status.count("failed")
    over_budget = len(fresh) - len(order)
    reason = _unqueued(over_budget, failed, beyond)
    if not len(unknown) and not reason:
        any_known = solved.any() or covered.any()
        reason = "the table covers all of them" if any_known else _NOTHING
    return StartedSolves(
        queued,
        solved=int(solved.sum()),
        covered=int(covered.sum()),
        failed=failed,
        beyond_range=beyond,
        left=over_budget,
        reason=reason,
    )


def _unqueued(over_budget: int, failed: int, beyond: int) -> str:
    """Return why some wrenches get no job; an empty text if all do."""
    reasons = []
    if over_budget:
        reasons.append(f"{over_budget} exceed the budget; start again once these are solved")
    if failed:
        reasons.append(
            f"{failed} have failed before; see GET /v1/jobs?status=failed and retry them"
        )
    if beyond:
        reasons.append(
            f"{beyond} are outside the load range; to solve them nevertheless, start with "
            "beyond_range true (--beyond-range)"
        )
    return "; ".join(reasons)


def _start_linear(
    workspace: Workspace, component: Component, holds: NDArray[np.bool_]
) -> StartedSolves:
    """Queue the solves of a linear component's compliance, which answers every wrench."""
    if not len(holds):
        return StartedSolves([], reason=_NOTHING)
    inside = int(holds.sum())
    beyond = len(holds) - inside
    if not workspace.tables.caught_up(component.name, CATCH_UP_S).needs_compliance:
        reason = "the component is linear and its compliance known: it answers every wrench"
        return StartedSolves([], covered=inside, beyond_range=beyond, reason=reason)
    design, accepted = workspace.fill(component.name, len(component.space.inputs), None)
    queued = {job.id for job in accepted}  # some may have been solved meanwhile
    queued |= {job.id for job in workspace.ledger.open_jobs(component.name, component.fingerprint)}
    reason = "the component is linear: its compliance, once solved, answers every wrench"
    if not queued and design.stage != "met":
        reason = (
            "the component is linear and the solves of its compliance have failed; see GET "
            "/v1/jobs?status=failed and retry them"
        )
    jobs = [workspace.ledger.job(number) for number in sorted(queued)]
    return StartedSolves(jobs, beyond_range=beyond, reason=reason)
