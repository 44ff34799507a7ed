"""``wrenchbook converge``: a part on finer meshes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from wrenchbook.service.cli.connect import AsJson
from wrenchbook.service.files.program import run_child


def converge(
    bundle: Annotated[Path, typer.Argument(help="folder of the component bundle")],
    finer: Annotated[
        list[Path] | None,
        typer.Option(help="a finer mesh with the same groups; once or twice, the finest last"),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="write errors over cell sizes as a page, .html")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Solve a part on finer meshes: order, limit, and the error of its own mesh for its bars."""
    flags = [f"--finer={one}" for one in finer or []] + (["--json"] if as_json else [])
    status = run_child("wrenchbook.fea.check.converge", *flags, "--", str(bundle))
    if plot is not None and status == 0:
        _write_plot(bundle / "convergence.json", plot)
    raise typer.Exit(status)


def _write_plot(study: Path, page: Path) -> None:
    """Draw each response's distance to its limit, or to the finest mesh, over the cells' size."""
    import plotly.graph_objects as go

    found = json.loads(study.read_text(encoding="utf-8"))
    figure = go.Figure()
    for i, name in enumerate(found["outputs"]):
        values = [row[i] for row in found["values"]]
        limit = found["extrapolated"][i]
        end, known = (values[-1], values[:-1]) if limit is None else (limit, values)
        errors = [100 * abs(one / end - 1) for one in known]
        sizes = [1e3 * one for one in found["sizes"][: len(known)]]
        figure.add_scatter(x=sizes, y=errors, name=name, mode="lines+markers")
    figure.update_xaxes(type="log", title="cell size, mm")
    figure.update_yaxes(type="log", title="off its limit, or the finest mesh, %")
    figure.write_html(page, include_plotlyjs=True)
