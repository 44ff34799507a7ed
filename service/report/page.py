"""A report as one HTML page with plots, which needs nothing but itself."""

from __future__ import annotations

import html
from typing import Any

import plotly.graph_objects as go

from service.report.measure import name_of, seconds_of, worst
from service.report.text import OUTPUTS, as_markdown

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;"
    "color:#1b1f24}pre{background:#f6f8fa;padding:1rem;overflow:auto;font-size:13px}"
    "h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2rem}"
)
_LAYOUT = {"template": "plotly_white", "height": 460, "margin": {"t": 20, "r": 20}}


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
    heading = html.escape(f"{report['title']}: error against run time")
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{heading}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{heading}</h1>{''.join(parts)}"
        f"<h2>Figures</h2><pre>{html.escape(as_markdown(report))}</pre></body></html>"
    )


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
            y=[worst(entry) for entry in shown],
            text=[name_of(entry) for entry in shown],
            name=name,
            mode="markers+lines",
            marker={"size": 11},
            line={"dash": "dot"},
        )
    figure.update_xaxes(type="log", title="run time of one answer, s", exponentformat="power")
    figure.update_yaxes(type="log", title="largest RMS error / range", tickformat=".2%")
    return figure.update_layout(**_LAYOUT)


def _growth(report: dict[str, Any]) -> go.Figure:
    figure = go.Figure()
    methods = dict.fromkeys(entry["method"] for entry in report["tables"])
    for method in methods:
        shown = [e for e in report["tables"] if e["method"] == method and worst(e) < float("inf")]
        figure.add_scatter(
            x=[entry["rows"] for entry in shown],
            y=[worst(entry) for entry in shown],
            name=method,
            mode="markers+lines",
        )
    figure.update_xaxes(type="log", title="rows of the table")
    figure.update_yaxes(type="log", title="largest RMS error / range", tickformat=".2%")
    return figure.update_layout(**_LAYOUT)


def _calibration(report: dict[str, Any]) -> go.Figure:
    figure = go.Figure()
    for entry in report["tables"]:
        if entry["rows"] == report["rows"]:
            figure.add_bar(x=list(OUTPUTS), y=entry["inside_error_bar"], name=entry["method"])
    figure.add_hline(y=0.9, line={"dash": "dash", "color": "#57606a"})
    figure.update_yaxes(title="share within the bar", tickformat=".0%", range=[0, 1.02])
    return figure.update_layout(**_LAYOUT, barmode="group")
