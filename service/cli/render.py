"""What the command line shows: tables of answers, jobs and components, and progress bars."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from wrenchbook.service.cli.pace import Pace, error_bars
from wrenchbook.service.client import Client, Displacement, Job, ProblemError
from wrenchbook.service.client.errors import mistake_line
from wrenchbook.service.client.wrenches import wrench_of
from wrenchbook.service.contract import LOADS, OUTPUTS

POLL_S = 0.2
INTERRUPTED = 130  # exit status of shells: 128 + SIGINT


def answer_table(answer: Displacement, interface: str = "") -> Table:
    """Lay out one answer with its error bar, at a named interface where there are several."""
    over = [_OVER] if answer.covered and answer.within_tolerance is False else []
    notes = "\n".join([answer.reason, *over, *answer.raw.get("notes", ())]).strip()
    table = Table(
        title=_headline(answer, interface), title_justify="left", caption=escape(notes) or None
    )
    for heading in ("", "value", "error bar", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for place, name in enumerate(OUTPUTS):
        table.add_row(
            name,
            _number(answer.vector, place),
            _number(answer.error_vector, place),
            "m" if place < 3 else "rad",
        )
    return table


_OVER = (
    "The bar is over the tolerance by the solver's own error (its mesh, say), which no more solves "
    "lower: the component's warnings say what to do."
)


def open_job_line(answer: Displacement, data: Path | None) -> str:
    """Return a sentence on the open job of an answer: what it does and how to see its state.

    `data` is the data directory whose private server has ended, if one had been started.
    """
    if answer.job is None or answer.job.ended:
        return ""
    value = "No estimate yet" if answer.vector is None else "The values are an estimate"
    job = f"{value}: job {answer.job.id} solves this wrench or one close to it."
    if data is not None:
        return f"{job} It runs while a server is up: wrenchbook serve --data {data}"
    return f"{job} Its state: wrenchbook jobs --component {answer.component}"


def own_error_lines(component: dict[str, Any]) -> list[str]:
    """Say what of a component's tolerance its solver does not meet, however thick the table."""
    return [one["message"] for one in component.get("warnings", ()) if one["where"] == "tolerance"]


def _headline(answer: Displacement, interface: str) -> str:
    place = f"{answer.component} {interface}".strip()
    words = [place, answer.coverage]
    if answer.source:
        words.append(f"source: {answer.source}")
    if answer.method:
        words.append(f"method: {answer.method}")
    if answer.elapsed_us is not None:
        words.append(f"{answer.elapsed_us:.0f} µs")
    if answer.job is not None:
        words.append(f"job {answer.job.id}: {answer.job.status}")
    return " · ".join(words)


def _number(values: Any, place: int) -> str:
    if values is None or math.isnan(values[place]):
        return "unknown"
    return f"{values[place]:.6e}"


def method_line(component: dict[str, Any]) -> str:
    """Say which method answers a component's table, and why."""
    coverage = component["coverage"]
    return f"{coverage['method']} answers: {coverage['method_reason']}."


def compliance_tables(body: dict[str, Any]) -> list[Table]:
    """Lay out the compliance at zero load, and the mean over the load range."""
    # Servers before 0.3 name neither columns nor rows.
    inputs = [name.split(" ")[0] for name in body.get("columns", LOADS)]
    known = [load in body["known_loads"] for load in inputs]
    mean = [
        [value if tells else None for value, tells in zip(line, known, strict=True)]
        for line in body["matrix"]
    ]
    matrices = (
        (f"tangent at zero load ({body['tangent_origin']})", body["tangent"]),
        (f"mean over the load range ({body['origin']})", mean),
    )
    outputs = [name.split(" ")[0] for name in body.get("rows", OUTPUTS)]
    return [matrix_table(title, outputs, inputs, lines) for title, lines in matrices]


def matrix_table(
    title: str,
    rows: Sequence[str],
    columns: Sequence[str],
    lines: Sequence[Sequence[float | None]] | None,
) -> Table:
    """Lay out a matrix in SI; a dash stands for a number that is not known."""
    table = Table(title=title, title_justify="left", caption="rows and columns in SI")
    for heading in ("", *columns):
        # A number goes on in the next line where the terminal is too narrow: its exponent is shown.
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for name, line in zip(rows, lines or [[None] * len(columns)] * len(rows), strict=True):
        table.add_row(name, *("-" if value is None else f"{value:.2e}" for value in line))
    return table


def component_table(components: Sequence[dict[str, Any]]) -> Table:
    """Lay out the library."""
    table = Table("name", "title", "rows", "analysis", "largest force, N", "largest moment, N·m")
    for one in components:
        kind = "table only" if not one["has_fea"] else "linear" if one["linear"] else "nonlinear"
        spans = one["range"].get("loads") or {"": one["range"]}
        force, moment = (
            "; ".join(
                " ".join(filter(None, (name, *(f"{max(map(abs, ends)):g}" for ends in own[word]))))
                for name, own in spans.items()
            )
            for word in ("force", "moment")
        )
        rows, others = str(one["rows"]), one.get("another_setup", {}).get("rows")
        if others:
            rows += f" (and {others} of another setup)"
        if pending := one.get("pending_rows"):  # servers before 0.3 have none
            rows += f" ({pending} more are being built)"
        table.add_row(one["name"], escape(one["title"]), rows, kind, force, moment)
    return table


def job_table(jobs: Sequence[Job]) -> Table:
    """Lay out jobs, with how far they are or why they failed."""
    table = Table("id", "component", "status", "attempt", "wrench, N and N·m", "")
    for job in jobs:
        wrench = _inputs(job.raw)
        table.add_row(
            str(job.id),
            job.component,
            job.status,
            str(job.raw["attempt"]),
            wrench,
            escape(_state(job)),
        )
    return table


def _state(job: Job) -> str:
    if job.raw.get("error"):
        return f"{job.raw['error']['kind']}: {job.raw['error']['message']}"
    progress = job.raw.get("progress") or {}
    return f"{progress.get('fraction', 0):.0%} {progress.get('message', '')}" if progress else ""


def _inputs(raw: Mapping[str, Any]) -> str:
    """Return the inputs of a job in words: its loads, by interface, and further ones by name."""
    loads = raw.get("loads") or {"": raw}
    words = [
        " ".join(filter(None, (name, *(f"{load:g}" for load in wrench_of(one)))))
        for name, one in loads.items()
    ]
    words += [f"{name} {value:g}" for name, value in raw.get("inputs", {}).items()]
    return ", ".join(words)


def row_errors(out: Console, reply: dict[str, Any]) -> None:
    """Print the mistakes of a table file, one cause a line."""
    for cause in reply.get("causes", reply["errors"]):  # servers before 0.3 have no causes
        plain(out, mistake_line(cause))


def body_errors(out: Console, error: ProblemError) -> None:
    """Print the mistakes a problem answer lists, one cause a line."""
    for one in error.body.get("causes", error.errors):
        plain(out, f"  {mistake_line(one)}")


def plain(out: Console, text: str, style: str | None = None) -> None:
    """Print text as it is: ``Fz [lbf]`` is a column and its unit, not a colour."""
    out.print(text, style=style, markup=False, highlight=False)


def bar(out: Console) -> Progress:
    """Make a progress bar over solves."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total}"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
        console=out,
    )


@contextmanager
def cancelled_on_interrupt(client: Client, jobs: Sequence[Job]) -> Iterator[None]:
    """Cancel the open jobs that this command queued if Ctrl-C ends the wait for them."""
    try:
        yield
    except KeyboardInterrupt:
        own = [job for job in jobs if job.raw.get("new")]
        count = 0
        for job in own:
            with suppress(ProblemError):  # 409: it has ended
                count += client.cancel(job).status == "cancelled"
        others = len(jobs) - len(own)
        rest = f"; {others} that were queued before go on" if others else ""
        plain(
            Console(stderr=True), f"Interrupted: {count} solve(s) of this command cancelled{rest}."
        )
        raise typer.Exit(INTERRUPTED) from None


def follow(
    out: Console, client: Client, jobs: Sequence[Job], seconds: float, pace: Pace | None = None
) -> list[Job]:
    """Show a bar until all jobs have ended, and return them as they are then.

    A pace has it say how fast they go.

    Raises
    ------
    RuntimeError
        If they have not ended after ``seconds``.
    """
    deadline = time.monotonic() + seconds
    done: dict[int, Job] = {}
    with cancelled_on_interrupt(client, jobs), bar(out) as progress:
        task = progress.add_task("solving", total=len(jobs), note="")
        while len(done) < len(jobs):
            for job in jobs:
                if job.id in done:
                    continue
                now = client.job(job.id, wait_s=POLL_S)
                if now.ended:
                    done[job.id] = now
                so_far = len(done) + now.progress % 1
                note = " · ".join(filter(None, (pace.note(so_far) if pace else "", _state(now))))
                progress.update(task, completed=so_far, note=note)
                if not now.ended:
                    break
            if time.monotonic() > deadline:
                raise RuntimeError(
                    f"{len(jobs) - len(done)} solves have not ended after {seconds:g} s; they go "
                    "on in the server. Look with: wrenchbook jobs"
                )
    return list(done.values())


def follow_report(out: Console, client: Client, name: str) -> None:
    """Show a bar until a report is made.

    Raises
    ------
    RuntimeError
        If it could not be made.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[note]}"), console=out) as progress:
        task = progress.add_task("reporting", total=1.0, note="")
        while True:
            state = client.report_state(name)
            progress.update(task, completed=state["fraction"], note=state["message"])
            if state["state"] == "failed":
                raise RuntimeError(f"the report could not be made: {state['message']}")
            if state["state"] != "running":
                return
            time.sleep(POLL_S)


def fill(
    out: Console,
    client: Client,
    name: str,
    budget: int,
    options: dict[str, Any],
    round_size: int = 24,
    seconds: float = 3600.0,
) -> dict[str, Any]:
    """Fill a table round by round, with a bar each; `options` are those of `Client.fill`.

    Returns the solves ``spent`` and ``failed``, ``rows``, and the last ``stage`` and ``reason``.

    Raises
    ------
    RuntimeError
        If a round does not end in time.
    """
    spent, failures, pace, order = 0, 0, Pace(budget), None
    plain(out, f"choosing wrenches for {name}")
    while spent < budget:
        order = client.fill(name, budget=min(round_size, budget - spent), **options)
        with cancelled_on_interrupt(client, order.jobs):
            plain(out, f"{order.stage}: {order.reason}")
            if not order.jobs:
                break
            ended = follow(out, client, order.jobs, seconds, pace)
        pace.ended = spent = spent + len(ended)
        now = client.component(name)
        parts = f"{spent} solves", pace.note(), f"{now['rows']} rows", error_bars(now["coverage"])
        plain(out, "; ".join(filter(None, parts)))
        failed = [job for job in ended if job.status == "failed"]
        failures += len(failed)
        for job in failed:
            plain(out, f"job {job.id} failed: {_state(job)}", style="red")
        if len(failed) == len(ended):
            raise RuntimeError("every solve of this round failed: wrenchbook jobs --status failed")
    now = client.component(name)
    out.print(f"{spent} solves; {name} has {now['rows']} rows.")
    for line in own_error_lines(now):
        plain(out, f"warning: {line}", style="yellow")
    assert order is not None  # a budget is positive
    about = {"component": name, "stage": order.stage, "reason": order.reason}
    return {**about, "spent": spent, "failed": failures, "rows": now["rows"]}
