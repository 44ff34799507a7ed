"""A report as one HTML page with plots, which needs nothing but itself."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any, Final

from wrenchbook.service.report.text import (
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
# Colours that remain apart for the colour-blind (Okabe and Ito 2008).
_COLOURS: Final = (
    ":root{--accent:#0072b2;--outside:#d55e00;--query:#e69f00;--covered:#009e73;--thin:#cc79a7;"
    "--muted:#57606a;--ink:#000;--line:#d0d7de;--card:#fff}"
    ".key-of-marks{display:flex;flex-wrap:wrap;gap:.3rem 1.2rem;list-style:none;padding:0}"
)
_PLOTS: Final = Path(__file__).parents[1] / "page" / "js" / "report_plots.js"
_DRAW: Final = """
const report = JSON.parse(document.getElementById("report").textContent);
for (const name of Object.keys(PLOTS)) show(document.getElementById(name), name, report);
"""


def as_page(report: dict[str, Any]) -> str:
    """Lay out a report as an HTML page of its own, drawn by the script of the server's page."""
    titles = {
        "front": "Error against run time of one answer",
        "growth": "Error against rows",
        "calibration": "How often the true error lies within the error bar",
    }
    plots = [f'<h2>{title}</h2><div id="{name}"></div>' for name, title in titles.items()]
    figures = json.dumps(report).replace("<", "\\u003c")
    heading, body = html.escape(title_of(report)), map(section_html, sections(report))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{heading}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}{_COLOURS}</style></head><body><h1>{heading}</h1>"
        f"<p>{html.escape(summary_of(report))}</p>"
        f"<p><strong>{html.escape(advice_of(report))}</strong></p>{''.join([*plots, *body])}"
        f'<script type="application/json" id="report">{figures}</script>'
        f'<script type="module">{_PLOTS.read_text(encoding="utf-8")}{_DRAW}</script></body></html>'
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
