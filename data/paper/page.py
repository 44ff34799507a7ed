"""The reproduction as one HTML page with plots, which needs nothing but itself."""

from __future__ import annotations

import html
from typing import Any

import plotly.graph_objects as go

from wrenchbook.service.contract import OUTPUTS
from wrenchbook.service.report.layout import PAGE_STYLE, ReportSection, section_html

LAYOUT = {"template": "plotly_white", "height": 460, "margin": {"t": 20, "r": 20}}
# Colours that remain apart for the colour-blind (Okabe and Ito 2008).
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_STYLES: dict[str, dict[str, Any]] = {
    "line": {"mode": "lines", "line": {"width": 2}},
    "dash": {"mode": "lines", "line": {"width": 2, "dash": "dash"}},
    "points": {"mode": "markers", "marker": {"size": 8, "symbol": "circle-open"}},
    "crosses": {"mode": "markers", "marker": {"size": 8, "symbol": "x-thin-open"}},
}
# Columns of a component's outputs: the key of the numbers, and their format.
_COLUMNS = {
    "range": ("range", ".2e"),
    "RMS/range": ("rms_over_range", ".1e"),
    "largest error": ("largest_error", ".1e"),
    "median error bar": ("median_bar", ".1e"),
    "inside": ("inside_bars", ".0%"),
}
HEAD = ("quantity", "beside", "reference", "computed", "error", "band", "verdict")


def as_page(body: dict[str, Any]) -> str:
    """Return the result of `run`, JSON-able values, as an HTML page."""
    heading = "The coupling paper, reproduced"
    parts, first = [], True
    for part in body["parts"].values():
        section = ReportSection(part["title"], part["note"], HEAD, lines_of(part["findings"]))
        parts.append(section_html(section))
        for plot in part["plots"]:
            drawn = _figure(plot).to_html(full_html=False, include_plotlyjs=first)
            parts.append(f"<h3>{html.escape(plot['title'])}</h3>{drawn}")
            first = False
        parts += [section_html(table) for table in _components(part["numbers"])]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{heading}</title>'
        f"<style>{PAGE_STYLE.read_text('utf-8')}td:nth-child(2){{white-space:normal}}</style></head><body><h1>{heading}</h1>"
        f"<p>{html.escape(body['summary'])}</p>{''.join(parts)}</body></html>"
    )


def lines_of(findings: list[dict[str, Any]]) -> tuple[tuple[str, ...], ...]:
    """Return findings as words, in the order of `HEAD`."""
    return tuple(
        (
            finding["quantity"],
            finding["source"],
            f"{finding['reference']:.5g}",
            f"{finding['computed']:.6g}",
            f"{finding['error']:.2g}",
            _band(finding),
            finding["verdict"],
        )
        for finding in findings
    )


def _band(finding: dict[str, Any]) -> str:
    """Return a finding's tolerance in words."""
    tolerance, comparison = finding["tolerance"], finding["comparison"]
    if tolerance is None:
        return ""
    if comparison == "at least":
        return f"at least {finding['reference'] - tolerance:g}"
    return f"{tolerance:g}" + " relative" * (comparison == "relative")


def _figure(plot: dict[str, Any]) -> go.Figure:
    """Draw a plot; curves of one output share their colour."""
    figure = go.Figure()
    shades: dict[str, str] = {}
    for curve in plot["curves"]:
        group = curve["name"].split(",")[0]
        colour = shades.setdefault(group, _COLOURS[len(shades) % len(_COLOURS)])
        style = _STYLES[curve["style"]]
        figure.add_scatter(
            x=curve["x"],
            y=curve["y"],
            name=curve["name"],
            mode=style["mode"],
            line={"color": colour, **style.get("line", {})},
            marker={"color": colour, **style.get("marker", {})},
        )
    figure.update_xaxes(title=plot["x"])
    figure.update_yaxes(title=plot["y"], exponentformat="power")
    return figure.update_layout(**LAYOUT, showlegend=True)


def _components(numbers: dict[str, Any]) -> list[ReportSection]:
    """Return each component's errors, output by output, the small ones named."""
    sections = []
    for name, part in numbers.items():
        if not isinstance(part, dict) or "methods" not in part:
            continue
        lines = [
            (
                figures["method"],
                output,
                *(f"{figures[key][k]:{form}}" for key, form in _COLUMNS.values()),
                "small" if output in figures["small"] else "",
            )
            for figures in part["methods"].values()
            for k, output in enumerate(OUTPUTS)
        ]
        note = (
            f"{part['rows']} rows for {part['wrenches']} wrenches. Ranges, errors, error bars in m "
            "and rad; small: below a tenth of the largest output of its kind."
        )
        head = ("method", "output", *_COLUMNS, "")
        sections.append(ReportSection(f"Error of each output on {name}", note, head, tuple(lines)))
        sections.append(_times(name, part))
    return sections


def _times(name: str, part: dict[str, Any]) -> ReportSection:
    """Return a component's run times by method."""
    head = ("method", "covered", "one answer", "over HTTP", "one solve", "the whole loop")
    lines = tuple(
        (
            figures["method"],
            f"{figures['coverage']['covered']} of {sum(figures['coverage'].values())}",
            f"{1e6 * figures['answer_s']:.0f} µs",
            f"{1e6 * figures['http_s']:.0f} µs",
            f"{figures['solve_s']:.2f} s",
            f"{figures['loop_s']:.2f} s",
        )
        for figures in part["methods"].values()
    )
    note = "Medians of wall time; other programs on the machine stretch them."
    return ReportSection(f"Run time on {name}", note, head, lines)
