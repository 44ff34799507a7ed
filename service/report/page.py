"""A report as one HTML page with plots, which needs nothing but itself."""

from __future__ import annotations

import html
import math
from typing import Any

import plotly.graph_objects as go

from wrenchbook.service.report.measure import mesh_error, name_of, seconds_of, worst
from wrenchbook.service.report.text import (
    OUTPUTS,
    ReportSection,
    advice_of,
    sections,
    summary_of,
    title_of,
)

STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;"
    "color:#1b1f24}h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2rem}"
    ".wide{overflow-x:auto}table{border-collapse:collapse;font-size:13px;white-space:nowrap}"
    "th,td{padding:.25rem .6rem;text-align:right;border-bottom:1px solid #d0d7de}"
    "th:first-child,td:first-child{text-align:left;white-space:normal;min-width:11rem}"
)
LAYOUT = {"template": "plotly_white", "height": 460, "margin": {"t": 20, "r": 20}}
# Colours that remain apart for the colour-blind (Okabe and Ito 2008), and a mark and a dash each.
_LOOKS = {
    "kriging": ("#0072b2", "circle", "solid"),
    "griddata": ("#d55e00", "square", "dash"),
    "additive": ("#e69f00", "diamond", "longdashdot"),
    "tangent": ("#009e73", "triangle-up", "dashdot"),
    "linear": ("#cc79a7", "x", "dot"),
    "nearest": ("#8c8c8c", "cross", "longdash"),
    "FEA": ("#000000", "diamond", "dot"),
}


def as_page(report: dict[str, Any]) -> str:
    """Lay out a report as an HTML page of its own."""
    plots = (
        ("Error against run time of one answer", _front(report)),
        ("Error against rows", _growth(report)),
        ("How often the true error lies within the error bar", _calibration(report)),
    )
    parts = []
    for number, (title, figure) in enumerate(plots):
        drawn = figure.to_html(full_html=False, include_plotlyjs=number == 0)
        parts.append(f"<h2>{html.escape(title)}</h2>{drawn}")
    parts += [section_html(section) for section in sections(report)]
    heading = html.escape(title_of(report))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{heading}</title>'
        f"<style>{STYLE}</style></head><body><h1>{heading}</h1>"
        f"<p>{html.escape(summary_of(report))}</p>"
        f"<p><strong>{html.escape(advice_of(report))}</strong></p>{''.join(parts)}</body></html>"
    )


def section_html(section: ReportSection) -> str:
    """Lay out a section as HTML: heading, note, table."""
    head = _line("th", section.head) if section.head else ""
    body = "".join(_line("td", line) for line in section.lines)
    return (
        f"<h2>{html.escape(section.title)}</h2><p>{html.escape(section.note)}</p>"
        f'<div class="wide"><table>{head}{body}</table></div>'
    )


def _line(tag: str, cells: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _look(name: str) -> dict[str, Any]:
    """Return how the curve of a method is drawn, so that curves that cross stay apart."""
    colour, symbol, dash = _LOOKS[name]
    line = {"color": colour, "dash": dash, "width": 2}
    return {
        "name": name,
        "mode": "markers+lines",
        "marker": {"size": 11, "symbol": symbol, "color": colour, "opacity": 0.85},
        "line": line,
    }


def _with_mesh_line(figure: go.Figure, report: dict[str, Any]) -> go.Figure:
    """Add the error of the component's own mesh, below which no table can be better."""
    figure.update_yaxes(type="log", title="largest RMS error, % of the range", tickformat="~g")
    error = mesh_error(report)
    if error is not None and error > 0.0:
        text = "error of the mesh itself: below it more rows gain nothing"
        figure.add_hline(y=100 * error, line={"dash": "dash", "color": "#57606a", "width": 1.5})
        figure.add_annotation(
            text=text,
            font={"color": "#57606a"},
            showarrow=False,
            xref="paper",
            x=1,
            y=math.log10(100 * error),  # annotations count in decades where the axis does
            xanchor="right",
            yanchor="top",
        )
    return figure.update_layout(**LAYOUT)


def _front(report: dict[str, Any]) -> go.Figure:
    figure = go.Figure()
    groups: dict[str, list[dict[str, Any]]] = {}
    for entry in report["tables"]:
        groups.setdefault(entry["method"], []).append(entry)
    groups["FEA"] = report["fea"][:-1]
    for name, entries in groups.items():
        shown = [entry for entry in entries if 0.0 < worst(entry) < float("inf")]
        figure.add_scatter(
            x=[seconds_of(entry) for entry in shown],
            y=[100 * worst(entry) for entry in shown],
            text=[name_of(entry) for entry in shown],
            **_look(name),
        )
    figure.update_xaxes(type="log", title="run time of one answer, s", exponentformat="power")
    return _with_mesh_line(figure, report)


def _growth(report: dict[str, Any]) -> go.Figure:
    figure = go.Figure()
    sizes = sorted({entry["rows"] for entry in report["tables"]})
    for method in dict.fromkeys(entry["method"] for entry in report["tables"]):
        shown = [
            entry
            for entry in report["tables"]
            if entry["method"] == method and 0.0 < worst(entry) < float("inf")
        ]
        figure.add_scatter(
            x=[entry["rows"] for entry in shown],
            y=[100 * worst(entry) for entry in shown],
            **_look(method),
        )
    figure.update_xaxes(type="log", title="rows of the table", tickvals=sizes)
    return _with_mesh_line(figure, report)


def _calibration(report: dict[str, Any]) -> go.Figure:
    figure = go.Figure()
    for entry in report["tables"]:
        if entry["rows"] == report["rows"]:
            name = entry["method"]
            figure.add_bar(
                x=list(OUTPUTS),
                y=entry["inside_error_bar"],
                name=name,
                marker={"color": _LOOKS[name][0]},
            )
    figure.add_hline(y=0.9, line={"dash": "dash", "color": "#57606a"})
    figure.update_yaxes(title="share within the error bar", tickformat=".0%", range=[0, 1.02])
    return figure.update_layout(**LAYOUT, barmode="group")
