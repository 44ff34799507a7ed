"""A report's figures as sections, and those as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from wrenchbook.service.contract import OUTPUTS
from wrenchbook.service.report.measure import lookup, mesh_error, name_of


@dataclass(frozen=True)
class ReportSection:
    """A heading, what the figures below it are, and a table of them, which may be empty."""

    title: str
    note: str
    head: tuple[str, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()


def title_of(report: dict[str, Any]) -> str:
    """Return a report's title."""
    return f"{report['title']}: error against run time"


def summary_of(report: dict[str, Any]) -> str:
    """Return what was compared with what."""
    wrenches = report["wrenches"]
    return (
        f"{wrenches['compared']} of {wrenches['asked']} random full wrenches (seed "
        f"{wrenches['seed']}), none of them in the table, which has {report['rows']} rows. Errors "
        "are RMS over the range of each output. The plots show all errors against the finest mesh."
    )


def advice_of(report: dict[str, Any]) -> str:
    """Return advice on the table in one sentence."""
    table = default_entry(report)
    error, mesh, name = lookup(table), mesh_error(report), report["component"]
    sentence = f"the table ({name_of(table)}) errs by {100 * error:.2g} % of the range"
    if mesh is not None and error <= mesh:
        return (
            f"The mesh decides: {sentence}, its mesh by {100 * mesh:.2g} %, so that more rows "
            "change nothing; if that is too much, refine the mesh."
        )
    over = _over_tolerance(report, table)
    if over:
        return (
            f"More rows help: {sentence}, and {over} exceeds the tolerance; wrenchbook fill {name}."
        )
    mesh_part = f", its mesh by {100 * mesh:.2g} %" if mesh is not None else ""
    within = "; its interpolation error is within the tolerance: it needs no more rows" * bool(
        report["tolerance"]
    )
    return f"The table decides: {sentence}{mesh_part}{within}."


def default_entry(report: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of the whole table by its default method."""
    name, rows = report["default"]["method"], report["rows"]
    return next(e for e in report["tables"] if e["method"] == name and e["rows"] == rows)


def _outputs(report: dict[str, Any]) -> Sequence[str]:
    """Return the names of the outputs; reports of version 0.2 have none."""
    return report.get("outputs", OUTPUTS)


def _over_tolerance(report: dict[str, Any], entry: dict[str, Any]) -> str:
    """Return the first output whose 95 % error is over the tolerance, or an empty text."""
    if report["tolerance"] is None:
        return ""
    errors = entry["lookup_error"]["p95"]
    for name, error, limit in zip(_outputs(report), errors, report["tolerance"], strict=True):
        if error is None or error > limit:
            return name
    return ""


def sections(report: dict[str, Any]) -> list[ReportSection]:
    """Return a report's figures."""
    return [
        _default(report),
        _meshes(report),
        _tables(report),
        _absolute(report),
        _bars(report),
    ]


def as_markdown(report: dict[str, Any]) -> str:
    """Lay out a report's figures as Markdown tables."""
    parts = [f"# {title_of(report)}", summary_of(report), f"**{advice_of(report)}**"]
    for section in sections(report):
        parts += [f"## {section.title}", section.note]
        if section.lines:
            rule = ("---", *["---:"] * (len(section.head) - 1))
            cells = (section.head, rule, *section.lines)
            parts.append("\n".join("| " + " | ".join(line) + " |" for line in cells))
    return "\n\n".join(parts) + "\n"


def _meshes(report: dict[str, Any]) -> ReportSection:
    lines = tuple(
        (
            entry["level"] + (" (reference)" if entry is report["fea"][-1] else ""),
            f"{entry['unknowns']:,}",
            f"{entry['setup_s']:.2f}",
            f"{entry['seconds_p50']:.3f}",
            f"{entry['seconds_p95']:.3f}",
            *_percents(entry["error"]["rms_relative"]),
        )
        for entry in report["fea"]
    )
    head = ("mesh", "unknowns", "set-up, s", "solve p50, s", "p95, s", *_outputs(report))
    note = "Direct solves, one thread; processor times."
    return ReportSection("Finite elements", note, head, lines)


def _tables(report: dict[str, Any]) -> ReportSection:
    lines = tuple(
        (
            entry["method"],
            str(entry["rows"]),
            f"{entry['fea_s']:.0f}",
            f"{entry['build_s']:.2f}",
            f"{entry['query_us_p50']:.0f}",
            f"{entry['query_us_p99']:.0f}",
            f"{entry['memory_bytes'] / 1e6:.1f}",
            *_percents(entry["lookup_error"]["rms_relative"]),
            f"{entry['covered']:.0%}",
        )
        for entry in sorted(report["tables"], key=lambda entry: (entry["rows"], lookup(entry)))
    )
    head = (
        "method",
        "rows",
        "FEA spent, s",
        "build, s",
        "p50, µs",
        "p99, µs",
        "MB",
        *_outputs(report),
    )
    note = (
        "Errors against solves on the table's own mesh. Beaten neither in error against the finest "
        "mesh nor in run time: "
        f"{'; '.join(report['pareto'])}."
    )
    return ReportSection("Tables", note, (*head, *_outputs(report), "covered"), lines)


def _absolute(report: dict[str, Any]) -> ReportSection:
    whole = [entry for entry in report["tables"] if entry["rows"] == report["rows"]]
    measured = [(entry, entry["lookup_error"]) for entry in whole]
    measured += [(entry, entry["error"]) for entry in report["fea"][:-1]]
    lines = tuple(
        (f"{name_of(entry)}, {word}", *_numbers(errors[key]))
        for entry, errors in measured
        for key, word in (("rms", "RMS"), ("p95", "95 %"), ("max", "largest"))
    )
    if report["tolerance"] is not None:
        lines = (("tolerance", *_numbers(report["tolerance"])), *lines)
    note = (
        "m and rad; a table's against its own mesh, a mesh's against the finest. An output whose "
        "range is below a thousandth of the largest of its kind counts as near zero: its relative "
        "error is taken over that floor."
    )
    return ReportSection(
        "Absolute errors against the tolerance", note, ("", *_outputs(report)), lines
    )


def _bars(report: dict[str, Any]) -> ReportSection:
    whole = [entry for entry in report["tables"] if entry["rows"] == report["rows"]]
    lines = tuple(
        (name_of(entry), *map(_inside, entry["inside_error_bar"], entry["bar_over_error"]))
        for entry in whole
    )
    note = (
        "Share of true errors within the error bar (against the table's own mesh), and the median "
        "error bar over the median error."
    )
    return ReportSection("Error bars", note, ("method", *_outputs(report)), lines)


def _inside(share: float | None, ratio: float | None) -> str:
    if share is None:
        return "-"
    return f"{share:.0%}" + (f", {ratio:.1f}x" if ratio is not None else "")


def _default(report: dict[str, Any]) -> ReportSection:
    default = report["default"]
    note = (
        f"Without a choice of method {default['method']} answers: {default['reason']}. "
        f"{default['full_wrench_rows']} rows load more than one axis."
    )
    errors = default["errors_left_out"]
    lines = tuple((name, f"{error:.2e}") for name, error in errors.items())
    head = ("at rows left out", "RMS error / range") if lines else ()
    return ReportSection("Which method answers, and why", note, head, lines)


def _numbers(values: list[float | None]) -> tuple[str, ...]:
    return tuple("-" if value is None else f"{value:.2e}" for value in values)


def _percents(values: list[float | None]) -> tuple[str, ...]:
    return tuple("-" if value is None else f"{value:.2%}" for value in values)
