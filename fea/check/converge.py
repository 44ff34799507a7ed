"""Solve a part on finer meshes and keep what its own lacks: ``wrenchbook converge``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from wrenchbook.fea.accuracy.convergence import studied, write
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.spec.problems import BundleError


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the study and print it; return 1 if a mesh cannot be made or solved."""
    parser = argparse.ArgumentParser(
        prog="wrenchbook converge",
        description="Solve a part on finer meshes: order, limit, and the error of its own mesh.",
    )
    add = parser.add_argument
    add("--json", action="store_true", help="one line of JSON instead of text")
    add(
        "--finer",
        type=Path,
        action="append",
        default=[],
        help="a finer mesh with the same groups; once or twice, the finest last",
    )
    add("--plot", type=Path, help="write errors over cell sizes as a page, .html")
    add("folder", type=Path, help="folder of the component bundle")
    options = parser.parse_args(arguments)
    if options.plot is not None and options.plot.suffix.lower() not in (".html", ".htm"):
        parser.error(f"--plot {options.plot}: the page is an .html file")
    if options.plot is not None and not options.plot.absolute().parent.is_dir():
        parser.error(f"--plot {options.plot}: there is no folder {options.plot.absolute().parent}")
    try:
        bundle = read_bundle(options.folder)
        file = write(bundle, studied(bundle, options.finer))
    except (BundleError, SolveFailed, ValueError, OSError, MemoryError) as error:
        kind, message = type(error).__name__, str(error)
        reply = json.dumps({"error": {"title": kind, "detail": message}})
        print(reply if options.json else message)
        return 1
    study = json.loads(file.read_text(encoding="utf-8"))
    if options.plot is not None:
        write_plot(study, options.plot)
    if options.json:
        print(json.dumps({"file": str(file)} | study))
        return 0
    # A line a mesh, the order, and what the component's own mesh lacks of each response.
    rows = [("response, SI", study["outputs"])]
    for count, size, values in zip(study["nodes"], study["sizes"], study["values"], strict=True):
        rows.append((f"{count} nodes, {1e3 * size:.4g} mm", [f"{value:.6g}" for value in values]))
    if len(study["nodes"]) > 2:
        rows.append(("order", _known(study["order"], ".2g")))
        rows.append(("at cells without size", _known(study["extrapolated"], ".6g")))
    else:
        rows.append(("two meshes show no order: give a third by --finer", []))
    pairs = zip(study["first_lacks"], study["values"][0], strict=True)
    rows.append(
        (
            "the first mesh lacks",
            [f"{100 * lack / first_value:.2g} %" for lack, first_value in pairs],
        )
    )
    for label, texts in rows:
        print(f"{label:<26}{''.join(f'{text:>13}' for text in texts)}".rstrip())
    print(f"{file}: error bars of this component take it from here")
    return 0


def write_plot(study: dict[str, Any], page: Path) -> None:
    """Draw each response's distance to its limit, or to the finest mesh, over the cells' size."""
    figure = go.Figure()
    for i, name in enumerate(study["outputs"]):
        values = [row[i] for row in study["values"]]
        limit = study["extrapolated"][i]
        end, known = (values[-1], values[:-1]) if limit is None else (limit, values)
        errors = [100 * abs(value / end - 1) for value in known]
        sizes = [1e3 * size for size in study["sizes"][: len(known)]]
        figure.add_scatter(x=sizes, y=errors, name=name, mode="lines+markers")
    figure.update_xaxes(type="log", title="cell size, mm")
    figure.update_yaxes(type="log", title="off its limit, or the finest mesh, %")
    figure.write_html(page, include_plotlyjs=True)


def _known(values: Sequence[float | None], digits: str) -> list[str]:
    return ["none" if value is None else format(value, digits) for value in values]


if __name__ == "__main__":
    raise SystemExit(main())
