"""The commands ``wrenchbook check``, ``converge``, ``condense`` and ``new``.

A process of the service runs them in a child process, so the service never imports finite elements.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from wrenchbook.fea.accuracy.convergence import convergence_study, write
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.reference import json_schema
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.check.report_text import as_text
from wrenchbook.fea.check.reporting import report, surface_in
from wrenchbook.fea.export import reduced
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.surface import Surface
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.mesh_source import UNITS
from wrenchbook.fea.spec.problems import BundleError

_SHOWN = 5  # frequencies that `condense` prints; the file has all
# Largest first node: eight digits in Nastran, less 10 million for frames and modes.
_MAX_FIRST_NODE = 89_999_999

Reply = tuple[int, Mapping[str, Any], str]
"""The exit status, the JSON-able reply, and the text in its place."""


def check(options: argparse.Namespace) -> Reply:
    """Report on a bundle's mesh, groups, supports and the cost of a solve."""
    if options.schema:
        schema = json_schema()
        return 0, schema, json.dumps(schema, indent=2, ensure_ascii=False)
    if not options.folder:
        options.usage_error("name the FOLDER, or give --schema")
    riding = None
    try:
        if options.mass is not None:
            riding = Riding.of(options.mass, options.inertia, options.centre)
        elif options.inertia is not None or options.centre is not None:
            raise ValueError("--inertia and --centre need --mass KG; add it")
    except ValueError as error:
        options.usage_error(str(error))
    _check_plot(options)
    surface = surface_in(options.folder) if options.faces or options.plot else None
    summary = report(options.folder, riding, options.nonlinear, surface)
    if surface is not None and options.plot is not None:
        figure = faces_figure(surface, summary["faces"])
        figure.write_html(options.plot, include_plotlyjs=True, post_script=_CLICK)
    return int(not summary["ok"]), summary, as_text(summary)


# A module of the service's page; plotly embeds it as a plain script.
_PRESSED = Path(__file__).with_name("pressed.js").read_text("utf-8").removeprefix("export ")
_CLICK = f"""{_PRESSED}
const line = document.createElement("pre");
line.textContent = "Click a face: its lines for component.toml";
document.body.prepend(line);
pressed(document.getElementById("{{plot_id}}"), trace => {{
  line.textContent = "[mesh.groups]\\nNAME = " + trace.meta;
}});"""


def faces_figure(surface: Surface, faces: list[dict[str, Any]]) -> go.Figure:
    """Draw numbered faces, mm; each trace has the TOML that selects its face as ``meta``."""
    figure = go.Figure()
    points = 1e3 * surface.mesh.points
    owners = surface.numbers[surface.owners]
    off = 0.01 * np.ptp(points, axis=0).max()
    for face in faces:
        nodes, rows = np.unique(surface.triangles[owners == face["number"]], return_inverse=True)
        x, y, z = points[nodes].T
        i, j, k = rows.reshape(-1, 3).T
        name = f"{face['number']}: {face['kind'].lower()}"
        shown = {"name": name, "meta": face["toml"], "hovertemplate": name + "<br>%{meta}"}
        figure.add_mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, **shown)
        members = np.flatnonzero(surface.numbers == face["number"])
        middle = 1e3 * surface.middles[members]
        at = np.linalg.norm(middle - 1e3 * np.array(face["centre"]), axis=1).argmin()
        x, y, z = middle[at] + off * surface.normals[members[at]]
        figure.add_scatter3d(x=[x], y=[y], z=[z], mode="text", text=str(face["number"]), **shown)
    return figure.update_layout(scene_aspectmode="data", showlegend=False, height=800)


def new(options: argparse.Namespace) -> Reply:
    """Propose a component for an input deck; status 0 if its check finds no problem."""
    folder = options.folder or Path(options.deck.stem)
    proposal = propose(options.deck, folder, options.unit, options.case)
    summary = proposal["check"]
    lines = [f"wrote {file}" for file in proposal["files"]]
    lines += [f"not taken over: {text}" for text in proposal["left"]]
    lines += [f"decide: {text}" for text in proposal["decide"]]
    for kind, entries in (("warning", summary["warnings"]), ("error", summary["problems"])):
        lines += [f"{kind}: {entry['where']}: {entry['message']}" for entry in entries]
    lines.append("ready to solve" if summary["ok"] else f"then: wrenchbook check {folder}")
    return int(not summary["ok"]), proposal, "\n".join(lines)


def condense(options: argparse.Namespace) -> Reply:
    """Write a part as stiffness and mass for its frames and modes."""
    wanted = f"{options.out}: name a file that ends in .npz, .pch (Nastran) or .mtx (Abaqus)"
    _check_output(options, options.out, (".npz", ".pch", ".mtx"), wanted)
    if not 0 <= options.damping < 1:
        options.usage_error(f"--damping must be a ratio such as 0.01, not {options.damping:g}")
    if not 0 < options.first <= _MAX_FIRST_NODE:
        options.usage_error(f"--first must be 1 to {_MAX_FIRST_NODE}, not {options.first}")
    part = Solver(read_bundle(options.folder)).craig_bampton(options.modes)
    content = reduced.arrays(part, options.damping)
    if options.out.suffix.lower() == ".npz":
        with options.out.open("wb") as file:
            np.savez(file, **content)
    else:
        text = reduced.nastran if options.out.suffix.lower() == ".pch" else reduced.abaqus
        options.out.write_text(text(content, options.first), encoding="utf-8")
    first = {name: [float(f"{f:.6g}") for f in content[name][:_SHOWN]] for name in ("free", "held")}
    header = {"file": str(options.out), "frames": list(part.names), "modes": options.modes}
    lines = [
        f"{options.out}: frames {', '.join(part.names)}; {options.modes} modes",
        f"first frequencies with the first frame held: {first['free']} Hz",
        f"with all frames held: {first['held']} Hz",
    ]
    return 0, header | first, "\n".join(lines)


def converge(options: argparse.Namespace) -> Reply:
    """Solve a part on finer meshes and write the study beside its component."""
    _check_plot(options)
    bundle = read_bundle(options.folder)
    file = write(bundle, convergence_study(bundle, options.finer))
    study = json.loads(file.read_text(encoding="utf-8"))
    if options.plot is not None:
        write_plot(study, options.plot)
    text = f"{_study_text(study)}\n{file}: error bars of this component take it from here"
    return 0, {"file": str(file)} | study, text


def _study_text(study: dict[str, Any]) -> str:
    """Return a line for each mesh, the order, and each response's error on the component's mesh."""
    rows = [("response, SI", study["outputs"])]
    for count, size, values in zip(study["nodes"], study["sizes"], study["values"], strict=True):
        rows.append((f"{count} nodes, {1e3 * size:.4g} mm", [f"{value:.6g}" for value in values]))
    if len(study["nodes"]) > 2:
        order = ["none" if value is None else f"{value:.2g}" for value in study["order"]]
        limit = ["none" if value is None else f"{value:.6g}" for value in study["extrapolated"]]
        rows += [("order", order), ("extrapolated limit", limit)]
    else:
        rows.append(("two meshes do not show the order; give a third with --finer", []))
    pairs = zip(study["first_lacks"], study["values"][0], strict=True)
    errors = [f"{100 * lack / value:.2g} %" for lack, value in pairs]
    rows.append(("error of the first mesh", errors))
    return "\n".join(
        f"{label:<26}{''.join(f'{text:>13}' for text in texts)}".rstrip() for label, texts in rows
    )


def write_plot(study: dict[str, Any], page: Path) -> None:
    """Draw each response's distance from its limit, or the finest mesh, over the cells' size."""
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


def _check_plot(options: argparse.Namespace) -> None:
    if options.plot is not None:
        wanted = f"--plot {options.plot}: name a file that ends in .html"
        _check_output(options, options.plot, (".html", ".htm"), wanted)


def _check_output(
    options: argparse.Namespace, file: Path, endings: tuple[str, ...], wanted: str
) -> None:
    """End with a usage error if an output file has a wrong ending, or its folder is missing."""
    if file.suffix.lower() not in endings:
        options.usage_error(wanted)
    if not file.absolute().parent.is_dir():
        start = wanted.partition(":")[0]
        options.usage_error(f"{start}: create the folder {file.absolute().parent} first")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, print its reply as JSON or text, and return its exit status.

    The status is 1 if something is wrong with the part; a wrong call ends the process with 2.
    """
    options, unknown = _parser().parse_known_args(arguments)
    if unknown:  # with the usage of the command, which argparse would not print
        options.usage_error(f"unknown arguments: {' '.join(unknown)}; leave them out")
    try:
        status, reply, text = options.run(options)
    except options.errors as error:
        text = _text_of(error)
        status = 1
        reply = {"error": {"title": type(error).__name__, "detail": text}}
    try:
        print(json.dumps(reply) if options.json else text, flush=True)
    except BrokenPipeError:  # `| head` closed the pipe; the interpreter's own flush would fail too
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return status


def _text_of(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return "the memory is not enough; mesh the part coarser, or use a machine with more"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(prog="wrenchbook")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(run: Any, description: str, *further: type[Exception]) -> Any:
        subparser = commands.add_parser(run.__name__, description=description)
        errors = (BundleError, SolveFailed, OSError, MemoryError, *further)
        subparser.set_defaults(run=run, errors=errors, usage_error=subparser.error)
        subparser.add_argument(
            "--json", action="store_true", help="one line of JSON instead of text"
        )
        return subparser.add_argument

    add = command(check, "Check a component bundle: mesh, groups, supports, cost of a solve.")
    add("--mass", type=float, help="mass at the interface, kg, for the natural frequency")
    add(
        "--inertia",
        type=_numbers,
        help="inertia of the --mass about its centre, kg·m^2: xx,yy,zz or six",
    )
    add("--centre", type=_numbers, help="centre of the --mass from the interface point, m: x,y,z")
    add(
        "--nonlinear",
        action="store_true",
        help="solve nonlinearly for the stresses over the load range",
    )
    add(
        "--schema", action="store_true", help="print the JSON schema of component.toml, for editors"
    )
    add("--faces", action="store_true", help="list the faces of the mesh, each with its TOML")
    add("--plot", type=Path, help="write a page with the numbered faces to this .html file")
    add("folder", type=Path, metavar="FOLDER", nargs="?", help="folder of the component bundle")

    text = "Solve a part on finer meshes: order, limit, and the error of its mesh."
    add = command(converge, text, ValueError)
    text = "finer mesh with the same groups; given once or twice, the finest last"
    add("--finer", type=Path, action="append", default=[], help=text)
    add("--plot", type=Path, help="write a page with the errors over cell sizes to this .html file")
    add("folder", type=Path, help="folder of the component bundle")

    text = "Write stiffness and mass of frames and modes (Craig-Bampton) for other programs."
    add = command(condense, text, ValueError)
    add("--modes", type=int, default=10, help="number of modes with all frames held (default 10)")
    add("--damping", type=float, default=0.0, help="damping ratio of all elastic modes (default 0)")
    add(
        "--first", type=int, default=1, help="number of the first node in .pch and .mtx (default 1)"
    )
    add("folder", type=Path, help="folder of the component bundle")
    add("out", type=Path, help="the file to write: .npz, .pch (Nastran) or .mtx (Abaqus)")

    add = command(new, "Propose a component for an input deck, and print its open points.")
    add("--unit", choices=tuple(UNITS), help="length unit; by default guessed from the constants")
    add("--case", help="step, load case or subcase to take over; by default the last")
    add("deck", type=Path, help="Abaqus or CalculiX (.inp), Nastran (.bdf), Ansys (.cdb)")
    add("folder", type=Path, nargs="?", help="folder to write; by default the deck's name")
    return parser


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        message = f'"{text}" must be numbers separated by commas, such as 1,1,0.5'
        raise argparse.ArgumentTypeError(message) from None


if __name__ == "__main__":
    sys.exit(main())
