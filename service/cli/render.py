"""Output of the commands: tables of answers, jobs, plans and components, and plain text."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from wrenchbook.service.client import ComponentPlan, Displacement, Job
from wrenchbook.service.client.wrenches import wrench_of
from wrenchbook.service.contract import OUTPUTS

# Control characters except tab and line end: a note or a log with them could move the cursor,
# rename the window or type into some terminals.
_CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
UNITS = {name: "m" if name[0] == "u" else "rad" for name in OUTPUTS}


class Screen(Console):
    """A console that prints texts literally, without markup."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a text, with a symbol in place of each control character."""
        return super().render_str(_CONTROLS.sub("\N{REPLACEMENT CHARACTER}", text), **options)

    def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
        """Render as `Console` does; a `Text` has no control characters either."""
        if isinstance(renderable, Text):
            renderable = renderable.copy()
            renderable.plain = _CONTROLS.sub("\N{REPLACEMENT CHARACTER}", renderable.plain)
        return super().render(renderable, options)


def print_json(reply: Any) -> None:
    """Print a reply as JSON; paths are texts."""
    sys.stdout.write(json.dumps(reply, indent=2, default=str) + "\n")


def plain(out: Console, text: str, style: str | None = None) -> None:
    """Print text without markup: ``Fz [lbf]`` is a column and its unit, not a colour.

    The terminal breaks its lines, so that a command in the text can be copied.
    """
    out.print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def show(reply: Any, as_json: bool, shown: str | Callable[[], Iterable[RenderableType]]) -> None:
    """Print a reply as JSON, or as a text, or as tables and lines."""
    if as_json:
        print_json(reply)
        return
    parts = [shown] if isinstance(shown, str) else shown()
    for part in parts:
        if isinstance(part, str):
            plain(Screen(), part)
            continue
        if isinstance(part, Table):
            for column in part.columns:
                column.overflow = "fold"  # no value is cut in a narrow terminal
        Screen().print(part)


def _remedy(answer: Displacement, interface: str, tolerance: Mapping[str, float] | None) -> str:
    """Return what lowers a covered answer's error bar beyond the tolerance, m and rad, or ""."""
    if not answer.covered or answer.within_tolerance is not False:
        return ""
    over = "The error bar is larger than the tolerance."
    if tolerance is None or answer.error_vector is None:
        return over
    limits = np.repeat([tolerance["translation"], tolerance["rotation"]], 3)
    if not (answer.error_vector > limits).any():
        return ""  # another interface has the larger error bar
    # Without parts it is the answer of a solve, which has no interpolation error.
    table = (answer.raw.get("error_parts") or {}).get("table") or {}
    table = table.get(interface, table)
    of_rows = [*table.get("translation", [0.0] * 3), *table.get("rotation", [0.0] * 3)]
    if (answer.error_vector - np.array(of_rows, dtype=float) > limits).any():
        return (
            f"{over} The sum of its parts other than the interpolation error (such as that of the "
            "mesh) is too, and more solves do not reduce it. See the warnings of the component."
        )
    return (
        f"{over} The sum of its parts other than the interpolation error is not, so more rows "
        f"help: wrenchbook fill {answer.component} with a smaller tolerance, or an import."
    )


def answer_shown(
    answer: Displacement, interface: str = "", tolerance: Mapping[str, float] | None = None
) -> Group:
    """Return one answer with its error bar, at a named interface if there are several.

    `tolerance`, m and rad, is that of `within_tolerance`, if it is known.
    """
    title = [f"{answer.component} {interface}".strip(), answer.coverage]
    title += [f"source: {answer.source}"] if answer.source else []
    title += [f"method: {answer.method}"] if answer.method else []
    title += [f"{answer.elapsed_us:.0f} µs"] if answer.elapsed_us is not None else []
    title += [f"job {answer.job.id}: {answer.job.status}"] if answer.job is not None else []
    remedy = _remedy(answer, interface, tolerance)
    notes = "\n".join(filter(None, [answer.reason, remedy, *answer.raw.get("notes", ())]))
    table = Table()
    for heading in ("", "value", "error bar", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for k, (name, unit) in enumerate(UNITS.items()):
        numbers = (
            "unknown" if values is None or math.isnan(values[k]) else f"{values[k]:.6e}"
            for values in (answer.vector, answer.error_vector)
        )
        table.add_row(name, *numbers, unit)
    # Not the table's own title and caption, which are wrapped to its width.
    lines = [Text(line) for line in (" · ".join(title), notes)]
    return Group(lines[0], table, *lines[1:] if notes else ())


def print_answer(
    answer: Displacement, as_json: bool, data: Path | None, tolerance: Mapping[str, float] | None
) -> None:
    """Print an answer, at each interface, and the state of its open job.

    `tolerance`, m and rad, is that of `within_tolerance`; `data` is the data directory whose
    private server has ended, if one had been started.
    """
    interfaces = answer.interfaces or {"": answer}
    shown: list[RenderableType] = [
        answer_shown(part, name, tolerance) for name, part in interfaces.items()
    ]
    if answer.job is not None and not answer.job.ended:
        value = "No estimate yet" if answer.vector is None else "The values are an estimate"
        state = f"Its state: wrenchbook jobs --component {answer.component}"
        if data is not None:
            state = f"It runs while a server is up: wrenchbook serve --data {data}"
        job = f"job {answer.job.id} solves this wrench or one close to it."
        shown.append(f"{value}: {job} {state}")
    show(answer.raw, as_json, lambda: shown)


def comparison_shown(reply: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the factors of a comparison, of all rows and of each import."""
    reference = reply["reference"]
    if reply["reason"] and not reference["of"]:
        yield f"Nothing is compared: {reply['reason']}."
        return
    rows = f"{reference['rows']} of {reference['of']} rows"
    named = "the solves" if reference["import"] is None else f"import {reference['import']}"
    counts = ", ".join(f"{number} {name}" for name, number in reply["coverages"].items() if number)
    yield (
        f"{reply['compared']} of {reply['measured']} measured rows beside {named} ({rows}, method "
        f"{reference['method']}); by the reference's rows: {counts or 'none'}."
    )
    if beyond := reply["beyond_range"]:
        yield f"{beyond} measured rows are outside the load range and are not compared."
    if unanswered := max(output["unanswered"] for output in reply["outputs"].values()):
        yield f"{unanswered} rows are outside the reference's rows and are not compared."
    if reply["reason"]:
        yield f"Nothing is compared: {reply['reason']}."
        return
    if not reference["bars_are_complete"]:
        yield "The reference's bars are not known, since the solver's own error is not."

    table = Table()
    columns = "import", "", "factor", "± 95 %", "from reference", "mean residual", "rms"
    for heading in (*columns, "beyond bars"):
        table.add_column(heading, justify="right" if heading else "left")
    campaigns = reply["campaigns"] if len(reply["campaigns"]) > 1 else []
    for part in ({"import": "all", **reply}, *campaigns):
        for name, output in part["outputs"].items():
            if not output["compared"]:
                continue

            value, half = output["factor"], output["half_width"]
            is_known = value is not None and (half is None or half < abs(value))
            factor = f"{value:.5g}" if is_known else "uncertain"
            parts = [half, output["of_reference"], output["mean"], output["rms"]]
            numbers = ("unknown" if part is None else f"{part:.2g}" for part in parts)
            beyond = f"{output['beyond_bars']} of {output['compared']}"
            table.add_row(str(part["import"] or "none"), name, factor, *numbers, beyond)
    yield table
    yield (
        "Measured = factor x reference. A residual within the bars of both is no difference; "
        "± has the reference's own bar in it."
    )


def compliance_tables(body: dict[str, Any]) -> list[Table]:
    """Return tables of the compliance at zero load, and of the mean over the load range."""
    inputs = [name.split(" ")[0] for name in body["columns"]]
    outputs = [name.split(" ")[0] for name in body["rows"]]
    known = [load in body["known_loads"] for load in inputs]
    mean = [
        [value if is_known else None for value, is_known in zip(line, known, strict=True)]
        for line in body["matrix"]
    ]
    at_zero = f"tangent at zero load ({body['tangent_origin']})"
    if body["tangent_origin"] == "none":
        at_zero += f"; for a known one: wrenchbook fill {body['component']}, or import rows"
    return [
        matrix_table(at_zero, outputs, inputs, body["tangent"]),
        matrix_table(f"mean over the load range ({body['origin']})", outputs, inputs, mean),
    ]


def matrix_table(
    title: str,
    rows: Sequence[str],
    columns: Sequence[str],
    lines: Sequence[Sequence[float | None]] | None,
) -> Table:
    """Return a table of a matrix in SI; a dash is an unknown number."""
    table = Table(title=title, title_justify="left", caption="rows and columns in SI")
    for heading in ("", *columns):
        # A number continues in the next line of a narrow terminal, so that its exponent is visible.
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for name, line in zip(rows, lines or [[None] * len(columns)] * len(rows), strict=True):
        table.add_row(name, *(cell(value, ".2e") for value in line))
    return table


def cell(value: float | None, form: str) -> str:
    """Return a number in a format; a dash for an unknown number."""
    return "-" if value is None or math.isnan(value) else f"{value:{form}}"


def stiffness_lines(body: dict[str, Any]) -> Iterator[Table | str]:
    """Yield the measured stiffness between two loads, by branch, and the play."""
    low, high = body["between"]
    title = f"{body['axis']} over {body['of']}, {low:g} to {high:g}, {body['unit']}"
    names = ("slope", "slope_half_width", "residual", "r2")
    table = Table("rows", "number", "slope", "+- 95 %", "residual", "r2", title=title)
    for name, line in body["lines"].items():
        if line is not None:
            table.add_row(name, str(line["rows"]), *(f"{line[key]:.6g}" for key in names))
    span = f"{body['axis']} from {low:g} to {high:g} N (N·m)"
    yield table if table.row_count else f"Fewer than three measured rows have {span}; import more."
    for name, play in body["play"].items():
        unit = body["unit"].rpartition("/")[2]
        yield f"Play at no load, of {name}: {play['value']:.4g} +- {play['half_width']:.2g} {unit}"
    for name, size in body["other_loads"].items():
        unit = "N·m" if name.rpartition(".")[2].startswith("m") else "N"
        yield f"{name} varies by {size:.3g} {unit} in these rows, and the slopes have its effect."


def component_table(components: Sequence[dict[str, Any]]) -> Table:
    """Return a table of the library."""
    table = Table("name", "title", "rows", "analysis", "largest force, N", "largest moment, N·m")
    for component in components:
        kind = "table only"
        if component["has_fea"]:
            kind = "linear" if component["linear"] else "nonlinear"
        spans = component["range"].get("loads") or {"": component["range"]}
        force = "; ".join(_largest(name, span["force"]) for name, span in spans.items())
        moment = "; ".join(_largest(name, span["moment"]) for name, span in spans.items())
        rows = str(component["rows"])
        if others := component["another_setup"]["rows"]:
            rows += f" (and {others} of another setup)"
        if pending := component["pending_rows"]:
            rows += f" ({pending} more are being built)"
        table.add_row(component["name"], component["title"], rows, kind, force, moment)
    return table


def _largest(interface: str, ranges: Sequence[Sequence[float]]) -> str:
    """Return the largest size of each load of an interface."""
    return _after_name(interface, [max(map(abs, ends)) for ends in ranges])


def job_table(jobs: Sequence[Job]) -> Table:
    """Return a table of jobs, with their inputs, and their progress or failure."""
    table = Table("id", "component", "actor", "status", "attempt", "wrench, N and N·m", "")
    for job in jobs:
        loads = job.raw.get("loads") or {"": job.raw}
        inputs = [_after_name(name, wrench_of(wrench)) for name, wrench in loads.items()]
        inputs += [_after_name(name, [value]) for name, value in job.raw.get("inputs", {}).items()]
        attempt = str(job.raw["attempt"])
        state = job_state(job)
        actor = job.raw.get("actor") or ""
        wrench = ", ".join(inputs)
        table.add_row(str(job.id), job.component, actor, job.status, attempt, wrench, state)
    return table


def _after_name(name: str, numbers: Iterable[float]) -> str:
    """Return numbers after the name of their interface, which is empty if there is only one."""
    return " ".join(filter(None, (name, *(f"{number:g}" for number in numbers))))


def job_state(job: Job) -> str:
    """Return the cause of a job's failure, or its progress."""
    if job.raw.get("error"):
        return f"{job.raw['error']['kind']}: {job.raw['error']['message']}"
    progress = job.raw.get("progress") or {}
    return f"{progress.get('fraction', 0):.0%} {progress.get('message', '')}" if progress else ""


def plan_lines(plans: Mapping[str, ComponentPlan]) -> Iterator[Table | str]:
    """Yield a scene's plan, one line a component, then reasons and the origin of the numbers."""
    table = Table()
    for heading in ("component", "decision", "axes: loads", "moves at most", "solves", "saves"):
        table.add_column(heading)
    for name, plan in plans.items():
        axes = [
            f"{axis}: {' '.join(part['inputs'])}, {part['dimensions']}-D"
            for axis, part in plan.axes.items()
        ]
        bounds = [
            f"{output} {bound:.2g} {UNITS[output]}" if np.isfinite(bound) else f"{output} unknown"
            for output, bound in zip(OUTPUTS, plan.displacement_bound, strict=True)
            if output in plan.outputs
        ]
        saves = plan.saves
        saved = ["not known yet"]
        if saves["build_s"] is not None:
            sizes = saves["build_s"], saves["memory_bytes"] / 1e6, saves["us_per_answer"]
            units = "s building", "MB", "µs an answer"
            pairs = zip(sizes, units, strict=True)  # a cut table may also answer more slowly
            saved = [f"{size:.2g} {unit}" for size, unit in pairs if size > 0] or ["nothing"]
        solves = f"{plan.solves['scene']} of {plan.solves['whole']}"
        cells = (axes or ["none"]), bounds, [solves], saved
        table.add_row(name, plan.decision, *map("\n".join, cells))
    yield table
    for name, plan in plans.items():
        yield f"{name}: {plan.reason}."
        numbers_of: dict[str, list[str]] = {}
        for number, origin in plan.saves_from.items():
            numbers_of.setdefault(origin, []).append(number)
        yield from (f"  {', '.join(numbers)}: {origin}." for origin, numbers in numbers_of.items())
