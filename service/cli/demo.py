"""The main job, end to end: a thin table, a solve, a fill, and the error against the run time."""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.cli import progress
from wrenchbook.service.cli.render import UNITS, answer_shown
from wrenchbook.service.client import Client, Displacement, Job
from wrenchbook.service.contract import counted
from wrenchbook.surrogate.table.rows import Floats

COMPONENT = "plate_thin"
SOLVERS = 2
BUDGET = 120  # largest number of solves of the fill
CHECKED = 30  # random wrenches compared with solves: on two idle cores the demonstration takes 50 s
FINER = 2  # ratio of cells a side: the solver's own error is an eighth on smooth parts
SEED = 20170726
FORCE, MOMENT = (150.0, -100.0, -900.0), (20.0, 30.0, 5.0)  # N, N·m: the wrench that is solved
NEAR = 0.9  # factor on the force: a wrench near it that was not solved


class Compared(NamedTuple):
    """One wrench's answers from the table, by its own method and by griddata, and its solve."""

    answer: Displacement
    plain: Displacement
    job: Job


def run(out: Console, keep: Path | None = None) -> dict[str, Any]:
    """Run the demonstration; return its figures, with ``failed``: the cause, or None."""
    from wrenchbook.service.workers.private import private_server

    started = time.monotonic()
    failure = None
    data = nullcontext(str(keep)) if keep else tempfile.TemporaryDirectory(prefix="wrenchbook-")
    with data as folder, private_server(Path(folder), SOLVERS) as client:
        # The docstring of a step is its heading.
        steps = (_ask_an_empty_table, _solve_it, _fill, _refine, _compare)
        for number, step in enumerate(steps, start=1):
            heading = (step.__doc__ or "").rstrip(".")
            out.rule(Text(f"{number}. {heading}", style="bold"), align="left")
            failure = step(out, client)
            if failure:
                out.print(Text("The demonstration failed:", style="red"), failure)
                break
        answer = client.displacement(COMPONENT, FORCE, MOMENT)
        component = client.component(COMPONENT, wait_s=60.0)  # with the solves of the comparison
    seconds = time.monotonic() - started
    if failure is None:
        out.print(f"Done in {seconds:.0f} s.")
    figures = {"component": COMPONENT, "rows": component["rows"], "answer": answer.raw}
    return {"failed": failure, "seconds": round(seconds, 3), **figures}


def _ask_an_empty_table(out: Console, client: Client) -> str | None:
    """Ask an empty table: the solve is queued."""
    component = client.component(COMPONENT)
    out.print(f"{component['title']}: {counted(component['rows'], 'row')}.")
    answer = client.displacement(COMPONENT, FORCE, MOMENT)
    out.print(answer_shown(answer))
    if answer.job is None or answer.coverage == "covered":
        return "an empty table should have queued a solve"
    return None


def _solve_it(out: Console, client: Client) -> str | None:
    """Follow the job, and ask the same wrench with on_thin 'wait'."""
    job = client.displacement(COMPONENT, FORCE, MOMENT).job
    if job is not None:
        progress.follow(out, client, [job])
    answer = client.displacement(COMPONENT, FORCE, MOMENT, on_thin="wait")
    out.print(answer_shown(answer))
    return None if answer.source == "fea" else f"expected source fea, got {answer.source}"


def _fill(out: Console, client: Client) -> str | None:
    """Fill the table where its error bar is largest."""
    if not progress.fill(out, client, COMPONENT, BUDGET, {})["spent"]:
        return "no solve was spent"
    coverage = client.component(COMPONENT)["coverage"]
    out.print(f"{coverage['method']} answers: {coverage['method_reason']}.", highlight=False)
    return None


def _refine(out: Console, client: Client) -> str | None:
    """Ask a wrench that no solve was made for, and solve it on a finer mesh."""
    force = [NEAR * load for load in FORCE]
    answer = client.displacement(COMPONENT, force, MOMENT)
    out.print(answer_shown(answer))
    if answer.coverage != "covered":
        return f"not covered: {answer.reason}"
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        # A copy of the component's bundle with more cells, under another name.
        bundle = shutil.copytree(SHIPPED / COMPONENT, Path(folder) / f"{COMPONENT}_finer")
        file = bundle / "component.toml"
        text = file.read_text().replace(f'name = "{COMPONENT}"', f'name = "{bundle.name}"')
        cells = re.compile(r"^(cells|rings|corner_cells) = (\d+)", re.MULTILINE)
        file.write_text(cells.sub(lambda key: f"{key[1]} = {FINER * int(key[2])}", text))
        finer = client.add_component(bundle)["name"]

    job = client.solve(finer, force, MOMENT).job
    assert job is not None
    (job,) = progress.follow(out, client, [job])
    true = np.array([*job.raw["translation"], *job.raw["rotation"]])
    error = np.abs(np.array(answer.vector, dtype=float) - true)
    bars = np.array(answer.error_vector, dtype=float)
    out.print(
        f"On a mesh of {FINER} x {FINER} cells for each, u_z is {true[2]:.4e} m: the answer is "
        f"{error[2]:.1e} m off, its error bar {bars[2]:.1e} m."
    )
    if not (error <= bars).all():
        return "the error bar does not hold the answer of the finer mesh"
    return None


def _compare(out: Console, client: Client) -> str | None:
    """Compare wrenches the table has never seen with direct FEA."""
    component = client.component(COMPONENT)
    spans = np.array([*component["range"]["force"], *component["range"]["moment"]])
    rng = np.random.default_rng(SEED)
    wrenches = rng.uniform(spans[:, 0], spans[:, 1], (CHECKED, 6)).round(6)
    answers, plain = _answers(client, wrenches, None), _answers(client, wrenches, "griddata")
    queued = [client.solve(COMPONENT, row[:3], row[3:]).job for row in wrenches]
    jobs = progress.follow(out, client, [job for job in queued if job])
    by_id = {job.id: job for job in jobs}
    compared = [
        Compared(answer, plain_answer, by_id[job.id])
        for answer, plain_answer, job in zip(answers, plain, queued, strict=True)
        if job
        and by_id[job.id].status == "done"
        and answer.vector is not None
        and plain_answer.vector is not None
    ]
    failed = sum(job.status == "failed" for job in jobs)
    if failed:
        out.print(f"{failed} of {CHECKED} solves failed by name; they are left out below.")
    if len(compared) < CHECKED // 2:
        return f"only {len(compared)} of {CHECKED} wrenches could be compared"

    out.print(_error_table(compared))
    times = np.array([answer.elapsed_us for answer in answers], dtype=float)
    seconds = np.array([job.seconds for job in jobs if job.status == "done"], dtype=float)
    out.print(_time_table(times, seconds))

    within = sum(answer.within_tolerance is True for answer in answers)
    bars = [answer.error_vector[2] for answer in answers if answer.error_vector is not None]
    solved = np.array([row.job.raw["translation"][2] for row in compared])
    answered = np.array([row.answer.vector for row in compared], dtype=float)[:, 2]
    error = np.abs(answered - solved)
    limit = component["tolerance"]
    out.print(
        f"The table of {component['rows']} rows answers in {np.median(times):.0f} µs; one "
        f"solve takes {np.median(seconds):.1f} s.\n"
        f"In {len(compared)} new solves u_z is up to {np.abs(solved).max():.1e} m.\n"
        f"Error of the table's u_z: median {np.median(error):.1e} m, largest {error.max():.1e} m.\n"
        f"Error bar of u_z, with the error of the mesh: median {np.median(bars):.1e} m.\n"
        f"{within} of {CHECKED} answers are within the tolerance of {limit['translation']:g} m and "
        f"{limit['rotation']:g} rad."
    )
    return None if within == CHECKED else "all answers should be within the tolerance"


def _answers(client: Client, wrenches: Floats, method: str | None) -> list[Displacement]:
    """Return the table's answers to wrenches (n, 6), N and N·m, by a method; None: by its own."""
    return [
        client.displacement(COMPONENT, row[:3], row[3:], on_thin="estimate", method=method)
        for row in wrenches
    ]


def _time_table(times: Floats, seconds: Floats) -> Table:
    """Return a table of the run times of answers (n,), µs, and of solves (k,), s."""
    table = Table(title="Run time of one answer")
    for heading in ("", "median", "95 %"):
        table.add_column(heading, justify="right" if heading else "left")
    answer, solve = np.median(times), np.median(seconds)
    table.add_row("table", f"{answer:.0f} µs", f"{np.quantile(times, 0.95):.0f} µs")
    slow = f"{np.quantile(seconds, 0.95):.2f} s"
    table.add_row("FEA, a process of its own", f"{solve:.2f} s", slow)
    table.caption = f"The table is {1e6 * solve / answer:,.0f} times faster."
    return table


def _error_table(compared: Sequence[Compared]) -> Table:
    """Return a table of the errors against FEA for each output, with griddata's beside them."""
    raw = [row.job.raw for row in compared]
    true = np.array([[*job["translation"], *job["rotation"]] for job in raw])
    error = np.abs(np.array([row.answer.vector for row in compared]) - true)
    plain_error = np.abs(np.array([row.plain.vector for row in compared]) - true)
    bars = np.array([row.answer.error_vector for row in compared])
    span = np.ptp(true, axis=0)
    method = compared[0].answer.method
    table = Table(title=f"{method} against FEA, {len(compared)} full wrenches not in the table")
    for heading in ("", "range", "RMS error", "largest", "RMS/range", "in bar", "griddata"):
        table.add_column(heading, justify="right" if heading else "left")
    for output, (name, unit) in enumerate(UNITS.items()):
        rms = np.sqrt(np.mean(error[:, output] ** 2))
        plain_rms = np.sqrt(np.mean(plain_error[:, output] ** 2))
        table.add_row(
            f"{name}, {unit}",
            f"{span[output]:.2e}",
            f"{rms:.2e}",
            f"{error[:, output].max():.2e}",
            f"{rms / span[output]:.3%}",
            f"{np.mean(error[:, output] <= bars[:, output]):.0%}",
            f"{plain_rms / span[output]:.1%}",
        )
    table.caption = "griddata: what interpolation between the same rows misses, RMS/range"
    return table
