"""A report's figures as sections, and those as Markdown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from service.report.measure import name_of, worst

OUTPUTS = ("u_x", "u_y", "u_z", "r_x", "r_y", "r_z")


@dataclass(frozen=True)
class Section:
    """A heading, what the figures below it are, and a table of them, which may be empty."""

    title: str
    note: str
    head: tuple[str, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()


def title_of(report: dict[str, Any]) -> str:
    """Return a report's title."""
    return f"{report['title']}: error against run time"


def summary_of(report: dict[str, Any]) -> str:
    """Say what was compared with what."""
    wrenches = report["wrenches"]
    return (
        f"{wrenches['compared']} of {wrenches['asked']} random full wrenches (seed "
        f"{wrenches['seed']}), none of them in the table. Errors are RMS over the range of each "
        f"output, against finite elements on the finest mesh; the table has {report['rows']} rows."
    )


def sections(report: dict[str, Any]) -> list[Section]:
    """Return a report's figures."""
    return [
        _meshes(report),
        _tables(report),
        _absolute(report),
        _bars(report),
        _left_out(report),
    ]


def as_markdown(report: dict[str, Any]) -> str:
    """Lay out a report's figures as Markdown tables."""
    parts = [f"# {title_of(report)}", summary_of(report)]
    for section in sections(report):
        parts += [f"## {section.title}", section.note]
        if section.lines:
            rule = ("---", *["---:"] * (len(section.head) - 1))
            cells = (section.head, rule, *section.lines)
            parts.append("\n".join("| " + " | ".join(line) + " |" for line in cells))
    return "\n\n".join(parts) + "\n"


def _meshes(report: dict[str, Any]) -> Section:
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
    head = ("mesh", "unknowns", "set-up, s", "solve p50, s", "p95, s", *OUTPUTS)
    return Section("Finite elements", "Direct solves, one thread.", head, lines)


def _tables(report: dict[str, Any]) -> Section:
    lines = tuple(
        (
            entry["method"],
            str(entry["rows"]),
            f"{entry['fea_s']:.0f}",
            f"{entry['build_s']:.2f}",
            f"{entry['query_us_p50']:.0f}",
            f"{entry['query_us_p99']:.0f}",
            f"{entry['memory_bytes'] / 1e6:.1f}",
            *_percents(entry["error"]["rms_relative"]),
            f"{entry['covered']:.0%}",
        )
        for entry in sorted(report["tables"], key=lambda entry: (entry["rows"], worst(entry)))
    )
    head = ("method", "rows", "FEA spent, s", "build, s", "p50, µs", "p99, µs", "MB", *OUTPUTS)
    front = f"Neither beaten in error nor in run time: {'; '.join(report['pareto'])}."
    return Section("Tables", front, (*head, "covered"), lines)


def _absolute(report: dict[str, Any]) -> Section:
    whole = [entry for entry in report["tables"] if entry["rows"] == report["rows"]]
    lines = tuple(
        (f"{name_of(entry)}, {word}", *_numbers(entry["error"][key]))
        for entry in (*whole, *report["fea"][:-1])
        for key, word in (("rms", "RMS"), ("p95", "95 %"), ("max", "largest"))
    )
    note = (
        "Absolute errors against the finest mesh, m and rad. An output whose range is below a "
        "thousandth of the largest of its kind counts as near zero: its relative error is taken "
        "over that floor."
    )
    return Section("Absolute errors", note, ("", *OUTPUTS), lines)


def _bars(report: dict[str, Any]) -> Section:
    whole = [entry for entry in report["tables"] if entry["rows"] == report["rows"]]
    lines = tuple(
        (name_of(entry), *map(_inside, entry["inside_error_bar"], entry["bar_over_error"]))
        for entry in whole
    )
    note = (
        "Share of true errors within the bar (against the table's own mesh), and the median bar "
        "over the median error."
    )
    return Section("Error bars", note, ("method", *OUTPUTS), lines)


def _inside(share: float | None, ratio: float | None) -> str:
    if share is None:
        return "-"
    return f"{share:.0%}" + (f", {ratio:.1f}x" if ratio is not None else "")


def _left_out(report: dict[str, Any]) -> Section:
    title, left_out = "What straight direction influence leaves out", report["left_out"]
    if not left_out:
        return Section(
            title, "Nothing: the component is linear, its 6x6 compliance is the whole truth."
        )
    if not left_out.get("full_wrench_rows"):
        note = "Unknown: the table has no row with a full wrench. A fill asks for some."
        return Section(title, note)
    together = left_out.get("acting_together", {})
    lines = tuple((name, f"{bound:.2e}") for name, bound in together.items())
    note = f"Seen on {left_out['full_wrench_rows']} rows with full wrenches, m and rad."
    return Section(title, note, ("output", "left out"), lines)


def _numbers(values: list[float | None]) -> tuple[str, ...]:
    return tuple("-" if value is None else f"{value:.2e}" for value in values)


def _percents(values: list[float | None]) -> tuple[str, ...]:
    return tuple("-" if value is None else f"{value:.2%}" for value in values)
