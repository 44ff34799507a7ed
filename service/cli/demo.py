"""The main job, end to end: a thin table, a solve, a fill, and the error against the run time."""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.cli import render
from wrenchbook.service.client import Client, Displacement, Job
from wrenchbook.service.contract import OUTPUTS

COMPONENT = "plate_thin"
SOLVERS = 2
BUDGET = 120
CHECKED = 50
FINER = 2  # times as many cells a side: the solver's own error is an eighth on smooth parts
SEED = 20170726
SOLVE_S = 300.0
WRENCH = ((150.0, -100.0, -900.0), (20.0, 30.0, 5.0))


def run(out: Console, keep: Path | None = None) -> dict[str, Any]:
    """Run the demonstration; return its figures, with ``failed``: why, or None if all worked."""
    from wrenchbook.service.workers.private import private_server

    started, complaint = time.monotonic(), None
    room = nullcontext(str(keep)) if keep else tempfile.TemporaryDirectory(prefix="wrenchbook-")
    with room as folder, private_server(Path(folder), SOLVERS) as client:
        steps = (_ask_an_empty_table, _solve_it, _fill, _refine, _compare)
        for number, step in enumerate(steps, start=1):
            heading = (step.__doc__ or "").rstrip(".")
            out.rule(f"[bold]{number}. {heading}", align="left")
            complaint = step(out, client)
            if complaint:
                out.print(f"[red]The demonstration failed:[/red] {complaint}")
                break
        answer, component = client.displacement(COMPONENT, *WRENCH), client.component(COMPONENT)
    seconds = time.monotonic() - started
    if complaint is None:
        out.print(f"Done in {seconds:.0f} s.")
    figures = {"component": COMPONENT, "rows": component["rows"], "answer": answer.raw}
    return {"failed": complaint, "seconds": round(seconds, 3), **figures}


def _ask_an_empty_table(out: Console, client: Client) -> str | None:
    """Ask an empty table: the solve is queued."""
    component = client.component(COMPONENT)
    out.print(f"{component['title']}: {component['rows']} rows.")
    answer = client.displacement(COMPONENT, *WRENCH)
    out.print(render.answer_table(answer))
    if answer.job is None or answer.coverage == "covered":
        return "an empty table should have queued a solve"
    return None


def _solve_it(out: Console, client: Client) -> str | None:
    """Follow the job, and ask the same wrench with on_thin 'wait'."""
    job = client.displacement(COMPONENT, *WRENCH).job
    if job is not None:
        render.follow(out, client, [job], SOLVE_S)
    answer = client.displacement(COMPONENT, *WRENCH, on_thin="wait", wait_s=SOLVE_S)
    out.print(render.answer_table(answer))
    return None if answer.source == "fea" else f"expected source fea, got {answer.source}"


def _fill(out: Console, client: Client) -> str | None:
    """Fill the table where its error bar is largest."""
    if not render.fill(out, client, COMPONENT, BUDGET, {})["spent"]:
        return "no solve was spent"
    out.print(render.method_line(client.component(COMPONENT)), highlight=False)
    return None


def _refine(out: Console, client: Client) -> str | None:
    """Ask a wrench that no solve was made for, and solve it on a finer mesh."""
    force, moment = [0.9 * load for load in WRENCH[0]], WRENCH[1]
    answer = client.displacement(COMPONENT, force, moment)
    out.print(render.answer_table(answer))
    if answer.coverage != "covered":
        return f"not covered: {answer.reason}"
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        finer = client.add_component(_finer(Path(folder)))["name"]
    job = _job(client.solve(finer, force, moment))
    (job,) = render.follow(out, client, [job], SOLVE_S)
    true = np.array([*job.raw["translation"], *job.raw["rotation"]])
    error = np.abs(np.array(answer.vector, dtype=float) - true)
    bars = np.array(answer.error_vector, dtype=float)
    out.print(
        f"On a mesh of {FINER} x {FINER} cells for each, u_z is {true[2]:.4e} m: the answer is "
        f"{error[2]:.1e} m off, its error bar {bars[2]:.1e} m."
    )
    return (
        None
        if (error <= bars).all()
        else "the error bar does not hold the answer of the finer mesh"
    )


def _finer(folder: Path) -> Path:
    """Return a copy of the component's bundle with more cells, under another name."""
    bundle = shutil.copytree(SHIPPED / COMPONENT, folder / f"{COMPONENT}_finer")
    about = bundle / "component.toml"
    text = about.read_text().replace(f'name = "{COMPONENT}"', f'name = "{bundle.name}"')
    times = re.compile(r"^(cells|rings|corner_cells) = (\d+)", re.MULTILINE)
    about.write_text(times.sub(lambda one: f"{one[1]} = {FINER * int(one[2])}", text))
    return bundle


def _compare(out: Console, client: Client) -> str | None:
    """Compare wrenches the table has never seen with direct FEA."""
    wrenches = _random_wrenches(client.component(COMPONENT))
    answers, plain = (
        [
            client.displacement(COMPONENT, one[:3], one[3:], on_thin="estimate", method=method)
            for one in wrenches
        ]
        for method in (None, "griddata")
    )
    rounds = [client.solve(COMPONENT, wrench[:3], wrench[3:]) for wrench in wrenches]
    jobs = render.follow(out, client, [_job(order) for order in rounds], SOLVE_S * CHECKED)
    compared = [
        (answer, plain_answer, job)
        for answer, plain_answer, job in zip(answers, plain, _in_order(jobs, rounds), strict=True)
        if job.status == "done" and answer.vector is not None and plain_answer.vector is not None
    ]
    failed = sum(job.status == "failed" for job in jobs)
    if failed:
        out.print(f"{failed} of {CHECKED} solves failed by name; they are left out below.")
    if len(compared) < CHECKED // 2:
        return f"only {len(compared)} of {CHECKED} wrenches could be compared"
    out.print(_error_table(compared))
    out.print(_time_table(answers, jobs))
    return _summarise(out, client.component(COMPONENT), answers, jobs)


def _summarise(
    out: Console, component: dict, answers: Sequence[Displacement], jobs: Sequence[Job]
) -> str | None:
    within = sum(answer.within_tolerance is True for answer in answers)
    limit, known = component["tolerance"], [one for one in answers if one.error_vector is not None]
    microseconds = np.median(np.array([one.elapsed_us for one in known], dtype=float))
    bars = np.median(np.array([one.error_vector for one in known], dtype=float), axis=0)
    seconds = np.median([float(job.seconds) for job in jobs if job.seconds])
    out.print(
        f"You have a table of {component['rows']} rows that answers any wrench of the range in "
        f"{microseconds:.0f} µs.\n"
        f"{within} of {CHECKED} answers are within the tolerance of {limit['translation']:g} m and "
        f"{limit['rotation']:g} rad, the mesh's error included.\n"
        f"The median error bar of u_z is {bars[2]:.1e} m; one solve takes {seconds:.1f} s."
    )
    return None if within == CHECKED else "all answers should be within the tolerance"


def _job(order: Displacement) -> Job:
    assert order.job is not None
    return order.job


def _in_order(jobs: Sequence[Job], rounds: Sequence[Displacement]) -> list[Job]:
    by_id = {job.id: job for job in jobs}
    return [by_id[_job(order).id] for order in rounds]


def _random_wrenches(component: dict) -> np.ndarray:
    """Draw full six-component wrenches from the load range, shape (50, 6), N and N·m."""
    spans = np.array([*component["range"]["force"], *component["range"]["moment"]])
    rng = np.random.default_rng(SEED)
    return rng.uniform(spans[:, 0], spans[:, 1], (CHECKED, 6)).round(6)


def _error_table(compared: Sequence[tuple[Displacement, Displacement, Job]]) -> Table:
    """Lay out the table's errors against FEA per output, and griddata's next to them."""
    body, plain, bars = (
        np.array(rows)
        for rows in (
            [answer.vector for answer, _, _ in compared],
            [plain_answer.vector for _, plain_answer, _ in compared],
            [answer.error_vector for answer, _, _ in compared],
        )
    )
    true = np.array([[*job.raw["translation"], *job.raw["rotation"]] for *_, job in compared])
    error, other = np.abs(body - true), np.abs(plain - true)
    span = np.ptp(true, axis=0)
    method = compared[0][0].method
    table = Table(title=f"{method} against FEA, {len(compared)} full wrenches not in the table")
    for heading in ("", "range", "RMS error", "largest", "RMS/range", "in bar", "griddata"):
        table.add_column(heading, justify="right" if heading else "left")
    for place, name in enumerate(OUTPUTS):
        one, unit = error[:, place], "m" if place < 3 else "rad"
        rms, plain_rms = (np.sqrt(np.mean(e[:, place] ** 2)) for e in (error, other))
        table.add_row(
            f"{name}, {unit}",
            f"{span[place]:.2e}",
            f"{rms:.2e}",
            f"{one.max():.2e}",
            f"{rms / span[place]:.3%}",
            f"{np.mean(one <= bars[:, place]):.0%}",
            f"{plain_rms / span[place]:.1%}",
        )
    table.caption = "griddata: what interpolation between the same rows misses, RMS/range"
    return table


def _time_table(answers: Sequence[Displacement], jobs: Sequence[Job]) -> Table:
    """Lay out what an answer costs: from the table, and from a solve."""
    looked_up = np.array([answer.elapsed_us for answer in answers])
    solved = np.array([job.seconds for job in jobs if job.status == "done"], dtype=float) * 1e6
    table = Table(title="Run time of one answer")
    for heading in ("", "median", "95 %"):
        table.add_column(heading, justify="right" if heading else "left")
    table.add_row(
        "table", f"{np.median(looked_up):.0f} µs", f"{np.quantile(looked_up, 0.95):.0f} µs"
    )
    table.add_row(
        "FEA, a process of its own",
        f"{np.median(solved) / 1e6:.2f} s",
        f"{np.quantile(solved, 0.95) / 1e6:.2f} s",
    )
    table.caption = f"The table is {np.median(solved) / np.median(looked_up):,.0f} times faster."
    return table
