"""The layout of a report: its figures as sections, and these as Markdown and as one HTML page."""

from __future__ import annotations

import html
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

PAGE_STYLE: Final = Path(__file__).with_name("page.css")
_SCRIPTS: Final = (  # the second draws with the functions of the first
    Path(__file__).parents[1] / "page" / "js" / "report_plots.js",
    Path(__file__).with_name("page.js"),
)
UNKNOWN = "-"  # stands for a number that a table lacks
CONFIDENCE: Final = 0.95  # of the share of true errors within their bars: the level of the bars
MIN_PERCENT: Final = 0.001  # smaller errors are rounding of linear solves
PREFIXES: Final = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))  # smaller ones are rounding
ACCEPTED: Final = 0.9  # share of true errors within their bars; as in the plot
FEW_WRENCHES: Final = 20  # with fewer one miss is more than 5 %
STAR = " ★"  # follows the name of an entry that no other beats in both error and run time


@dataclass(frozen=True)
class ReportSection:
    """A heading, a note on the figures below it, and their table, which may be empty."""

    title: str
    note: str
    head: tuple[str, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()


def summary_of(report: dict[str, Any]) -> str:
    """Return the two sides of the comparison, and the certainty of its number of wrenches."""
    wrenches = report["wrenches"]
    compared = wrenches["compared"]
    # Clopper and Pearson (1934): with n successes of n, the lower limit is (1 - confidence)^(1/n).
    min_share = (1 - CONFIDENCE) ** (1 / max(compared, 1))
    return (
        f"{compared} of {wrenches['asked']} random full wrenches (seed "
        f"{wrenches['seed']}), none of them in the table, which has {report['rows']} rows. Errors "
        "are RMS over the range of each output. The plots show all errors against the finest mesh. "
        f"If all {compared} true errors of an output lie within its bars, the share over the load "
        f"range is at least {100 * min_share:.0f} % with {100 * CONFIDENCE:.0f} % confidence."
    )


def advice_of(report: dict[str, Any]) -> dict[str, Any]:
    """Return the advice on the table, and whether it has too small bars and needs rows."""
    table = next(
        entry
        for entry in _complete_tables(report)
        if entry["method"] == report["default"]["method"]
    )
    too_small = _bars_are_too_small(table)
    on_rows, needs_rows = _advice_on_rows(report, table)
    return {
        "advice": (_advice_on_bars(report, table) if too_small else "") + on_rows,
        "bars_too_small": too_small,
        "needs_rows": too_small or needs_rows,
    }


def _bars_are_too_small(table: dict[str, Any]) -> bool:
    beyond = table["beyond_error_bar"]
    return beyond["of"] - beyond["missed"] < ACCEPTED * beyond["of"]


def _advice_on_bars(report: dict[str, Any], table: dict[str, Any]) -> str:
    """Return a warning of error bars that hold too few true errors."""
    beyond, compared = table["beyond_error_bar"], report["wrenches"]["compared"]
    few = ""
    if compared < FEW_WRENCHES:
        few = f" (few wrenches were compared: {compared}; compare {FEW_WRENCHES} or more)"
    return (
        f"The error bars of {table['method']} were too small for {beyond['missed']} of "
        f"{beyond['of']} answers{few}. Do not rely on them; fill the table further. "
    )


def _advice_on_rows(report: dict[str, Any], table: dict[str, Any]) -> tuple[str, bool]:
    """Return the sentence that recommends more rows, a finer mesh or nothing.

    Its errors are against the finest mesh. The second result says whether it recommends rows.
    """
    mesh, total = report["mesh_error"], table["largest_error"]
    error = table["largest_interpolation_error"]
    too_small = _bars_are_too_small(table)
    sentence = f"the table ({table['name']}) does not answer all outputs"
    if total is not None:
        sentence = f"the table ({table['name']}) errs by {_percent(total)} of the range"
        sentence += " against the finest mesh"
    if None not in (mesh, error) and error <= mesh:
        lowered = "lower no error, but improve the error bars" if too_small else "change nothing"
        return (
            f"Result: {sentence}, its mesh by {_percent(mesh)}, so that more rows {lowered}; "
            "if that is too much, refine the mesh."
        ), False

    p95 = zip(table["lookup_error"]["p95"], report["tolerance"] or (), strict=False)
    for output, (value, limit) in zip(report["outputs"], p95, strict=False):
        if value is None or value > limit:
            return (
                f"More rows help: {sentence}, and {output} exceeds the tolerance; "
                f"wrenchbook fill {report['component']}."
            ), True

    if mesh is not None:
        sentence += f", its mesh by {_percent(mesh)}"
    lacks_bars = False
    if report["tolerance"]:
        sentence += "; its interpolation error is within the tolerance"
        lacks_bars = not table["beyond_error_bar"]["of"]
        if lacks_bars:
            sentence += " at these wrenches; for error bars fill the table further"
        elif too_small:
            sentence += " at these wrenches"
        else:
            sentence += ": it needs no more rows"
    return f"Result: {sentence}.", lacks_bars


def sections_of(report: dict[str, Any]) -> list[ReportSection]:
    """Return a report's figures."""
    default = report["default"]
    outputs = tuple(report["outputs"])
    omitted = tuple((name, _percent(error)) for name, error in default["errors_left_out"].items())
    failed = "".join(map(_failures_in, report["fea"]))
    unsolved = " Failed solves: see Finite elements." if failed else ""
    of_tables = ("method", "rows", "FEA spent, s", "build, s", "median, µs", "99 %, µs", "MB")

    return [
        ReportSection(
            "Which method answers, and why",
            f"Without a choice of method {default['method']} answers: {default['reason']}. "
            f"{default['full_wrench_rows']} rows load more than one axis.",
            ("at rows left out", "RMS error / range") if omitted else (),
            omitted,
        ),
        ReportSection(
            "Finite elements",
            "Direct solves, one thread; processor times: the median, and the time in which 95 % of "
            f"the solves end.{STAR}: no other entry is both better and faster.{failed}",
            ("mesh", "unknowns", "set-up, s", "solve median, s", "95 %, s", *outputs),
            _mesh_lines(report),
        ),
        ReportSection(
            "Tables",
            "Errors against solves on the table's own mesh. Times of an answer: the median, and "
            "the time in which 99 % of the answers come. MB: memory of the table."
            f"{STAR}: no other entry is both better, against the finest mesh, and faster.",
            (*of_tables, *outputs, "covered"),
            _table_lines(report),
        ),
        ReportSection(
            "Absolute errors against the tolerance",
            "A table's against its own mesh, a mesh's against the finest. An output "
            "whose range is below a thousandth of the largest of its kind counts as near zero: its "
            f"relative error is taken over that floor.{unsolved}",
            ("", *outputs),
            _error_lines(report),
        ),
        ReportSection(
            "Error bars",
            "Share of true errors within the error bar (against the table's own mesh), and the "
            "median error bar over the median error.",
            ("method", *outputs),
            tuple(map(_bar_line, _complete_tables(report))),
        ),
    ]


def _complete_tables(report: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the entries of the tables that have all rows."""
    return [entry for entry in report["tables"] if entry["rows"] == report["rows"]]


def _star(report: dict[str, Any], entry: dict[str, Any]) -> str:
    return STAR if entry["name"] in report["pareto"] else ""


def _mesh_lines(report: dict[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Return a line for each mesh, the reference last: name, size, times, relative errors."""
    marks = [""] * (len(report["fea"]) - 1) + [" (reference)"]
    return tuple(
        (
            entry["level"] + mark + _star(report, entry),
            f"{entry['unknowns']:,}",
            _digits(entry["setup_s"]),
            *_each((entry["seconds_p50"], entry["seconds_p95"]), _digits),
            *_each(entry["error"]["rms_relative"], _percent),
        )
        for entry, mark in zip(report["fea"], marks, strict=True)
    )


def _table_lines(report: dict[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Return a line for each table and method: costs, relative errors and covered part, by rows."""

    def by_rows_and_error(entry: dict[str, Any]) -> tuple[int, float]:
        return entry["rows"], entry["largest_interpolation_error"] or float("inf")

    return tuple(
        (
            entry["method"] + _star(report, entry),
            str(entry["rows"]),
            _digits(entry["fea_s"]),
            _digits(entry["build_s"]),
            _digits(entry["query_us_p50"]),
            _digits(entry["query_us_p99"]),
            _digits(entry["memory_bytes"] / 1e6),
            *_each(entry["lookup_error"]["rms_relative"], _percent),
            f"{100 * entry['covered']:.0f} %",
        )
        for entry in sorted(report["tables"], key=by_rows_and_error)
    )


def _error_lines(report: dict[str, Any]) -> tuple[tuple[str, ...], ...]:
    """Return the tolerance, if there is one, then three errors of each table and coarser mesh."""
    outputs = report["outputs"]
    lines = [("tolerance", *_lengths(outputs, report["tolerance"]))] if report["tolerance"] else []
    measured = [(entry["name"], entry["lookup_error"]) for entry in _complete_tables(report)]
    measured += [(entry["name"], entry["error"]) for entry in report["fea"][:-1]]
    for name, errors in measured:
        for key, label in (("rms", "RMS"), ("p95", "95 %"), ("max", "largest")):
            lines.append((f"{name}, {label}", *_lengths(outputs, errors[key])))
    return tuple(lines)


def _bar_line(entry: dict[str, Any]) -> tuple[str, ...]:
    """Return a table's name and of each output "95 %, 1.3x": see the section Error bars."""
    inside = _each(entry["inside_error_bar"], lambda share: f"{100 * share:.0f} %")
    ratios = _each(entry["bar_over_error"], _digits)
    cells = [
        share if ratio == UNKNOWN else f"{share}, {ratio}x"
        for share, ratio in zip(inside, ratios, strict=True)
    ]
    return entry["name"], *cells


def _failures_in(level: dict[str, Any]) -> str:
    """Return a note on failed solves of a mesh, with their causes; "" if none failed."""
    failures = level["failures"]
    kinds = Counter(failure["kind"] for failure in failures)
    first = {failure["kind"]: failure for failure in reversed(failures)}
    reasons = "; ".join(
        f"{count} x {kind} ({first[kind]['message']} {first[kind]['remedy']})"
        for kind, count in kinds.items()
    )
    failed = f"On the {level['level']} mesh {len(failures)} of {level['solves']} solves failed"
    return f" {failed}: {reasons}." if failures else ""


def _each(values: Iterable[float | None], text: Callable[[float], str]) -> tuple[str, ...]:
    """Return numbers as texts; `UNKNOWN` for None."""
    return tuple(UNKNOWN if value is None else text(value) for value in values)


def _digits(value: float) -> str:
    """Return a number with three significant digits, without a power of ten."""
    digits = 2 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(0, digits)}f}"


def _percent(fraction: float) -> str:
    """Return a fraction in percent with two digits."""
    percent = 100 * fraction
    if 0 < percent < MIN_PERCENT:
        return f"< {MIN_PERCENT} %"
    return f"{percent:.0f} %" if percent >= 99.5 else f"{percent:.2g} %"


def _lengths(outputs: Sequence[str], values: Iterable[float | None]) -> tuple[str, ...]:
    """Return displacements with SI prefixes, as "12.3 µm" or "1.20 mrad"."""

    def text(value: float, unit: str) -> str:
        scale, prefix = next((prefix for prefix in PREFIXES if value >= prefix[0]), PREFIXES[-1])
        return f"{_digits(value / scale)} {prefix}{unit}" if value >= scale else f"0 {unit}"

    units = ("m" if output.rpartition(".")[2].startswith("u") else "rad" for output in outputs)
    return tuple(
        UNKNOWN if value is None else text(value, unit)
        for value, unit in zip(values, units, strict=True)
    )


def as_markdown(report: dict[str, Any]) -> str:
    """Return a report's figures as Markdown tables."""
    parts = [f"# {report['title']}: error against run time", report["summary"]]
    parts.append(f"**{report['advice']}**")
    for section in sections_of(report):
        parts += [f"## {section.title}", section.note]
        if section.lines:
            rule = ("---", *["---:"] * (len(section.head) - 1))
            cells = (section.head, rule, *section.lines)
            parts.append("\n".join("| " + " | ".join(line) + " |" for line in cells))
    return "\n\n".join(parts) + "\n"


def as_page(report: dict[str, Any]) -> str:
    """Return a report as a separate HTML page, drawn by the script of the server's page."""
    figures = {name: value for name, value in report.items() if name != "sections"}
    heading = html.escape(f"{report['title']}: error against run time")
    script = "".join(path.read_text("utf-8") for path in _SCRIPTS)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{heading}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{PAGE_STYLE.read_text('utf-8')}</style></head><body><h1>{heading}</h1>"
        f"<p>{html.escape(report['summary'])}</p>"
        f"<p><strong>{html.escape(report['advice'])}</strong></p>"
        f'<div id="plots"></div>{"".join(map(section_html, sections_of(report)))}'
        '<script type="application/json" id="report">'
        f"{json.dumps(figures).replace('<', chr(92) + 'u003c')}</script>"
        f'<script type="module">{script}</script></body></html>'
    )


def section_html(section: ReportSection) -> str:
    """Return a section as HTML: heading, note, table."""
    rows = [("th", section.head)] if section.head else []
    rows += [("td", line) for line in section.lines]
    lines = (
        "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"
        for tag, cells in rows
    )
    return (
        f"<h2>{html.escape(section.title)}</h2><p>{html.escape(section.note)}</p>"
        f'<div class="wide"><table>{"".join(lines)}</table></div>'
    )
