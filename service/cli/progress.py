"""Progress bars of solves and reports, the rounds of a fill, and Ctrl-C while they are shown."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeElapsedColumn

from wrenchbook.service.cli.render import Screen, job_state, plain
from wrenchbook.service.client import Client, Job, ProblemError, ServerTimeout, ServerUnreachable
from wrenchbook.service.client.job import ROUND
from wrenchbook.service.contract import counted

POLL_S = 0.2  # s between updates: a bar that moves five times a second looks continuous
BUILD_S = 25.0  # s that the last rows of a fill are waited for
INTERRUPTED = 130  # exit status of shells after Ctrl-C: 128 + SIGINT


class Pace:
    """The rate of ended solves over all rounds of a fill of at most `budget` solves."""

    def __init__(self, budget: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._budget = budget
        self._clock = clock
        self._started = clock()
        self.ended = 0

    def note(self, in_round: float = 0.0) -> str:
        """Return solves a minute and the longest remaining time, including the present round."""
        solves = self.ended + in_round
        seconds = self._clock() - self._started
        if solves < 1 or seconds <= 0:
            return ""
        remaining = max(0.0, self._budget - solves) * seconds / solves
        if remaining < 90.0:
            text = f"{remaining:.0f} s"
        elif remaining < 90.0 * 60.0:
            text = f"{remaining / 60:.0f} min"
        else:
            text = f"{remaining / 3600:.1f} h"
        return f"{60 * solves / seconds:.0f} solves/min, at most {text} left"


@contextmanager
def cancelled_on_interrupt(client: Client, jobs: Sequence[Job]) -> Iterator[None]:
    """Cancel this command's open jobs if Ctrl-C ends the wait for them."""
    try:
        yield
    except KeyboardInterrupt:
        queued = [job for job in jobs if job.raw.get("new")]
        count = 0
        others = len(jobs) - len(queued)
        rest = f"; {others} that were queued before go on" if others else ""
        try:
            for job in queued:
                try:
                    count += client.cancel(job).status == "cancelled"
                except ProblemError as error:
                    if error.status != 409:  # it has ended
                        raise
        except (ServerUnreachable, ServerTimeout) as error:
            rest += f"; the others were not cancelled: the server does not answer: {error}"
        except ProblemError as error:
            rest += f"; the others were not cancelled: {str(error).rstrip('.')}"
        plain(
            Screen(stderr=True),
            f"Interrupted: {counted(count, 'solve')} of this command cancelled{rest}.",
        )
        raise typer.Exit(INTERRUPTED) from None


def _bar(out: Console, *columns: ProgressColumn) -> Progress:
    """Return a progress bar with its description before it, and `columns` and its note after it."""
    front = TextColumn("{task.description}", markup=False), BarColumn()
    note = TextColumn("{task.fields[note]}", markup=False)
    return Progress(*front, *columns, note, console=out)


def follow(
    out: Console,
    client: Client,
    jobs: Sequence[Job],
    seconds: float = math.inf,
    pace: Pace | None = None,
) -> list[Job]:
    """Show a bar until all jobs have ended, and return their final state.

    With `pace` the bar shows their rate.

    Raises RuntimeError if they have not ended after `seconds`.
    """
    deadline = time.monotonic() + seconds
    done: dict[int, Job] = {}
    columns = TextColumn("{task.completed:.0f}/{task.total}", markup=False), TimeElapsedColumn()
    with cancelled_on_interrupt(client, jobs), _bar(out, *columns) as progress:
        task = progress.add_task("solving", total=len(jobs), note="")
        while len(done) < len(jobs):
            for job in jobs:
                if job.id in done:
                    continue
                now = client.job(job.id, wait_s=POLL_S)
                if now.ended:
                    done[job.id] = now
                so_far = len(done) + now.progress % 1
                notes = pace.note(so_far) if pace else "", job_state(now)
                progress.update(task, completed=so_far, note=" · ".join(filter(None, notes)))
                if not now.ended:
                    break
            if time.monotonic() > deadline:
                raise RuntimeError(
                    f"{len(jobs) - len(done)} of {len(jobs)} solves have not ended after "
                    f"{seconds:g} s. The server continues them; list them with: wrenchbook jobs "
                    f"--component {jobs[0].component}"
                )
    return list(done.values())


def follow_report(out: Console, client: Client, name: str) -> None:
    """Show a bar until a report is made; raises RuntimeError if it cannot be made."""
    with _bar(out, TimeElapsedColumn()) as progress:
        task = progress.add_task("reporting", total=1.0, note="")
        while True:
            state = client.report_state(name)
            progress.update(task, completed=state["fraction"], note=state["message"])
            if state["state"] == "failed":
                raise RuntimeError(
                    f"the report of {name} could not be made: {state['message']}. Correct the "
                    f"cause, then run again: wrenchbook report {name}"
                )
            if state["state"] != "running":
                return
            time.sleep(POLL_S)


def fill(
    out: Console,
    client: Client,
    name: str,
    budget: int,
    options: dict[str, Any],
    round_size: int = ROUND,
) -> dict[str, Any]:
    """Fill a table round by round, with a bar each; `options` are those of `Client.fill`.

    Returns the solves ``spent`` and ``failed``, ``rows``, and the last ``stage`` and ``reason``.

    Raises RuntimeError if all solves of a round fail.
    """
    spent = 0
    failures = 0
    pace = Pace(budget)
    order = None
    plain(out, f"choosing wrenches for {name}")
    while spent < budget:
        order = client.fill(name, budget=min(round_size, budget - spent), **options)
        with cancelled_on_interrupt(client, order.jobs):
            plain(out, f"{order.stage}: {order.reason}")
            if not order.jobs:
                break
            ended = follow(out, client, order.jobs, pace=pace)

        pace.ended = spent = spent + len(ended)
        now = client.component(name)
        rows = now["rows"] + now["pending_rows"]
        parts = f"{spent} solves", pace.note(), f"{rows} rows"
        plain(out, "; ".join(filter(None, parts)))
        failed = [job for job in ended if job.status == "failed"]
        failures += len(failed)
        for job in failed:
            plain(out, f"job {job.id} failed: {job_state(job)}", style="red")
        if len(failed) == len(ended):
            raise RuntimeError(
                f"all {len(failed)} solves of this round failed; their causes are above. To list "
                f"the jobs: wrenchbook jobs --component {name} --status failed"
            )

    now = client.component(name, wait_s=BUILD_S)
    out.print(f"{counted(spent, 'solve')}; {name} has {counted(now['rows'], 'row')}.")
    for warning in now.get("warnings", ()):
        # The solver's own error is over the tolerance, for a table of any size.
        if warning["where"] == "tolerance":
            plain(out, f"warning: {warning['message']}", style="yellow")
    assert order is not None  # a budget is positive
    return {
        "component": name,
        "stage": order.stage,
        "reason": order.reason,
        "spent": spent,
        "failed": failures,
        "rows": now["rows"],
    }
