"""A report as Markdown."""

from __future__ import annotations

from typing import Any

from service.report.measure import name_of, worst

OUTPUTS = ("u_x", "u_y", "u_z", "r_x", "r_y", "r_z")


def as_markdown(report: dict[str, Any]) -> str:
    """Lay out a report's figures as Markdown tables."""
    wrenches = report["wrenches"]
    parts = [
        f"# {report['title']}: error against run time",
        f"{wrenches['compared']} of {wrenches['asked']} random full wrenches (seed "
        f"{wrenches['seed']}), none of them in the table. Errors are RMS over the range of each "
        f"output, against finite elements on the finest mesh; the table has {report['rows']} rows.",
        "## Finite elements",
        _mesh_table(report),
        "## Tables",
        _table_table(report),
        f"Neither beaten in error nor in run time: {'; '.join(report['pareto'])}.",
        "## Error bars",
        "Share of true errors within the bar (against the table's own mesh), and the median bar "
        "over the median error, whole table:",
        _bar_table(report),
        "## What straight direction influence leaves out",
        _left_out(report),
    ]
    return "\n\n".join(parts) + "\n"


def _table(head: list[str], lines: list[list[str]]) -> str:
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *lines))


def _mesh_table(report: dict[str, Any]) -> str:
    head = ["mesh", "unknowns", "set-up, s", "solve p50, s", "p95, s", *OUTPUTS]
    lines = [
        [
            entry["level"] + (" (reference)" if entry is report["fea"][-1] else ""),
            f"{entry['unknowns']:,}",
            f"{entry['setup_s']:.2f}",
            f"{entry['seconds_p50']:.3f}",
            f"{entry['seconds_p95']:.3f}",
            *_percents(entry["error"]["rms_relative"]),
        ]
        for entry in report["fea"]
    ]
    return _table(head, lines)


def _table_table(report: dict[str, Any]) -> str:
    head = ["method", "rows", "FEA spent, s", "build, s", "p50, µs", "p99, µs", "MB"]
    lines = [
        [
            entry["method"],
            str(entry["rows"]),
            f"{entry['fea_s']:.0f}",
            f"{entry['build_s']:.2f}",
            f"{entry['query_us_p50']:.0f}",
            f"{entry['query_us_p99']:.0f}",
            f"{entry['memory_bytes'] / 1e6:.1f}",
            *_percents(entry["error"]["rms_relative"]),
            f"{entry['covered']:.0%}",
        ]
        for entry in sorted(report["tables"], key=lambda entry: (entry["rows"], worst(entry)))
    ]
    return _table([*head, *OUTPUTS, "covered"], lines)


def _bar_table(report: dict[str, Any]) -> str:
    whole = [entry for entry in report["tables"] if entry["rows"] == report["rows"]]
    lines = [
        [name_of(entry), *map(_inside, entry["inside_error_bar"], entry["bar_over_error"])]
        for entry in whole
    ]
    return _table(["method", *OUTPUTS], lines)


def _inside(share: float | None, ratio: float | None) -> str:
    if share is None:
        return "-"
    return f"{share:.0%}" + (f", {ratio:.1f}x" if ratio is not None else "")


def _left_out(report: dict[str, Any]) -> str:
    left_out = report["left_out"]
    if not left_out:
        return "Nothing: the component is linear, its 6x6 compliance is the whole truth."
    together = left_out.get("acting_together", {})
    if not left_out.get("full_wrench_rows"):
        return "Unknown: the table has no row with a full wrench. `wrenchbook fill` asks for some."
    lines = [[name, f"{bound:.2e}"] for name, bound in together.items()]
    note = f"Seen on {left_out['full_wrench_rows']} rows with full wrenches, m and rad:"
    return note + "\n\n" + _table(["output", "left out"], lines)


def _percents(values: list[float | None]) -> list[str]:
    return ["-" if value is None else f"{value:.2%}" for value in values]
