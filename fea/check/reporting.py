"""The report on a bundle, and the program that prints it."""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wrenchbook.fea.accuracy.advice import over_tolerance, straight_edges
from wrenchbook.fea.accuracy.estimate import accuracy_or_why
from wrenchbook.fea.bundle.read import FILE_NAME, Bundle, BundleError, read_bundle
from wrenchbook.fea.bundle.reference import json_schema
from wrenchbook.fea.check import findings
from wrenchbook.fea.check.cost import estimate
from wrenchbook.fea.check.deck_comparison import contradictions, listing
from wrenchbook.fea.check.strength import strength
from wrenchbook.fea.check.text import as_text
from wrenchbook.fea.check.trial import (
    deflection_warnings,
    frequency,
    solver_of,
    trial,
    weight_warnings,
)
from wrenchbook.fea.component import AttachedInterface, ComponentModel, build, mesh_of
from wrenchbook.fea.deck.running import deck_report
from wrenchbook.fea.inspection.bodies import Bodies, bodies_of, coincident_nodes
from wrenchbook.fea.inspection.cells import quality, quality_warnings
from wrenchbook.fea.inspection.warnings import coincidence_warnings, set_up_warnings, stack_problems
from wrenchbook.fea.mesh.cad.meshing import list_shape
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import GEOMETRY_ENDINGS

_MOST_SECONDS = 5.0
"""Of a linear solve, to estimate the solver's error too: that takes up to three more."""
_MOST_BYTES = 1e9  # of the same: a coarser mesh and nonlinear solves come on top


def report(
    folder: str | Path, riding: Riding | None = None, nonlinear: bool = False
) -> dict[str, Any]:
    """Read the bundle, build its mesh, resolve its groups and look for what would go wrong.

    Parameters
    ----------
    folder
        The bundle's.
    riding
        The rigid mass that the interface will carry, for the natural frequency.
    nonlinear
        Whether stresses under the full range are those of a nonlinear solve, where the component is
        nonlinear; without it they are first order.

    Returns
    -------
    dict
        Always ``ok``, ``problems`` (what stops a solve) and ``warnings`` (what may make it wrong),
        each a list of ``{"where", "message"}``. As far as it gets: ``name``, ``fingerprint``,
        ``has_fea``; ``faces`` and ``bodies`` of a geometry file; ``unknowns`` (three a node),
        ``nodes``, ``cells``, ``groups``, ``quality`` (see `fea.inspection.cells`), ``parts``,
        ``coincident_nodes``; of an input deck ``mesh_file`` (see `fea.check.deck_comparison`);
        ``materials``, ``section`` (of several interfaces ``sections``, with
        their names), ``supports``, ``temperature`` and ``acceleration`` where they are inputs, and
        ``estimate`` (see `fea.check.cost`), ``trial`` (see `fea.check.trial`), and where a density
        or a mass is given ``vibration`` (see `fea.check.trial`), and where a yield strength is
        given ``strength`` (see `fea.check.strength`), and where it takes no longer than a check may
        ``solver_error``
        (see `fea.accuracy.estimate`). Lengths in m. Instead of all from ``faces`` on,
        ``deck`` (see `fea.deck.running`).
    """
    summary: dict[str, Any] = {"ok": False, "problems": [], "warnings": []}
    folder = Path(folder)
    try:
        try:
            bundle = read_bundle(folder)
        except BundleError:
            _list_geometry(_geometry_named_in(folder), summary)
            raise
        summary |= {
            "name": bundle.name,
            "fingerprint": bundle.fingerprint,
            "has_fea": bundle.has_fea,
        }
        if bundle.deck is not None:  # it answers in place of the embedded solver
            summary["deck"], warnings = deck_report(bundle.deck)
            if riding is not None:
                message = "no natural frequency: its solver gives none, the mass counts for nothing"
                warnings.append(BundleProblem("deck", message))
            _warn(summary, warnings)
        elif bundle.mesh is not None:
            if bundle.mesh.geometry is not None:
                _list_geometry(bundle.mesh.file, summary)
            _look_at_mesh(bundle, mesh_of(bundle.mesh), riding, nonlinear, summary)
    except BundleError as error:
        summary["problems"] += [_entry(problem) for problem in error.problems]
    summary["ok"] = not summary["problems"]
    return summary


def _geometry_named_in(folder: Path) -> Path | None:
    """Return the STEP file of a bundle with mistakes: its faces help to write the rest."""
    try:
        name = tomllib.loads((folder / FILE_NAME).read_text("utf-8"))["mesh"]["file"]
        path = (folder / name).resolve()
    except (OSError, ValueError, RecursionError, LookupError, TypeError):
        return None
    fits = path.suffix.lower() in GEOMETRY_ENDINGS and path.is_relative_to(folder.resolve())
    return path if fits and path.is_file() else None


def _list_geometry(path: Path | None, summary: dict[str, Any]) -> None:
    if path is not None:
        summary["faces"], summary["bodies"] = list_shape(path)


def _look_at_mesh(
    bundle: Bundle, mesh: Mesh, riding: Riding | None, nonlinear: bool, summary: dict[str, Any]
) -> None:
    facets = {
        name: sum(len(nodes) for _, nodes in group.blocks)
        for name, group in mesh.facet_groups.items()
    }
    summary |= {
        "unknowns": mesh.unknowns,
        "nodes": len(mesh.points),
        "cells": mesh.cell_counts,
        "groups": {
            "cells": {n: sum(len(part) for part in r) for n, r in mesh.regions.items()},
            "facets": facets,
            "nodes": {name: len(nodes) for name, nodes in mesh.node_groups.items()},
        },
    }
    summary["quality"] = quality(mesh)
    _warn(
        summary,
        [BundleProblem("mesh", message) for message in quality_warnings(summary["quality"])],
    )
    bodies = bodies_of(mesh)
    pairs = coincident_nodes(mesh)
    summary["parts"] = findings.parts(mesh, bodies)
    summary["coincident_nodes"] = len(pairs)
    _warn(summary, coincidence_warnings(mesh, bodies, pairs))
    if mesh.deck is not None:
        summary["mesh_file"] = listing(mesh.deck)
    component = build(bundle, mesh)
    _warn(summary, contradictions(component))
    _look_at_component(component, bodies, pairs, summary)
    # Find what every solve would refuse, then how the part moves and swings.
    solver, problems = solver_of(component)
    if solver is None:
        raise BundleError(problems)
    summary["trial"], problems = trial(solver, summary["estimate"])
    problems = problems or stack_problems(component)  # a mechanism is named as such
    if problems:
        raise BundleError(problems)
    _warn(summary, deflection_warnings(component, summary["trial"]["deflection"]))
    if summary["trial"]["deflection"] is not None:
        _warn(summary, weight_warnings(solver))
    summary["vibration"], warnings = frequency(solver, riding)
    _warn(summary, warnings)
    summary["strength"], warnings = strength(solver, nonlinear)
    _warn(summary, warnings)
    # Find what the solver's answers may be wrong by, and whether that is over the tolerance.
    cost, bundle = summary["estimate"], solver.component.bundle
    if cost["linear_seconds"] > _MOST_SECONDS or cost["memory_bytes"] > _MOST_BYTES:
        return
    summary["solver_error"] = accuracy_or_why(solver)
    if summary["solver_error"]["mesh"] is None:
        why = f"its error bar is not known: {summary['solver_error']['mesh_basis']}"
        _warn(summary, [BundleProblem("mesh", why)])
    _warn(summary, straight_edges(summary["solver_error"]))
    limit = None if bundle is None else bundle.tolerance
    if limit is not None:
        _warn(summary, over_tolerance(summary["solver_error"], limit.translation, limit.rotation))


def _look_at_component(
    component: ComponentModel, bodies: Bodies, pairs: Any, summary: dict[str, Any]
) -> None:
    numbers = component.material_of_cells
    attached = [_section(interface) for interface in component.interfaces]
    # The ranges of the inputs behind the loads, where there are any.
    inputs: dict[str, Any] = {}
    if warm := component.temperature:
        inputs["temperature"] = {"low": warm.low, "high": warm.high, "reference": warm.reference}
    if component.accelerated:
        inputs["acceleration"] = [scalar.high for scalar in component.further[-3:]]
    counts = {"sliding_nodes": len(component.sliding[0]), "bushings": len(component.bushings)}
    summary |= {
        "materials": [
            {
                "region": material.region,
                "law": material.law,
                "youngs_modulus": material.youngs_modulus,
                "poisson_ratio": material.poisson_ratio,
                "density": material.density,
                "yield_strength": material.yield_strength,
                "cells": sum(int((block == i).sum()) for block in numbers),
            }
            for i, material in enumerate(component.materials)
        ],
        "supports": {"nodes": len(component.fixed_nodes)}
        | {name: count for name, count in counts.items() if count},
        **inputs,
        **({"sections": attached} if component.others else {"section": attached[0]}),
        "nonlinear": component.analysis.nonlinear,
    }
    _warn(summary, set_up_warnings(component))
    problems = findings.motion_problems(component, bodies, pairs)
    if problems:
        raise BundleError(problems)
    summary["estimate"] = estimate(component)


def _section(interface: AttachedInterface) -> dict[str, Any]:
    section = interface.section
    name = {"name": interface.name} if interface.name else {}
    return name | {
        "nodes": len(section.node_ids),
        "area": section.area if section.by_area else None,
        "centre": section.centre.tolist(),
        "point": interface.point.tolist(),
        "coupling": interface.coupling,
        "locked": list(interface.locked),
    }


def _warn(summary: dict[str, Any], warnings: list[BundleProblem]) -> None:
    summary["warnings"] += [_entry(warning) for warning in warnings]


def _entry(problem: BundleProblem) -> dict[str, str]:
    return {"where": problem.where, "message": problem.message}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the report on a folder, as one line of JSON or as text; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="wrenchbook check",
        description="Check a component bundle: mesh, groups, supports, cost of a solve.",
        exit_on_error=False,
    )
    add = parser.add_argument
    add("--json", action="store_true", help="one line of JSON instead of text")
    add("--mass", type=float, help="mass at the interface, kg, for the natural frequency")
    add("--inertia", type=_numbers, help="its inertia about its centre, kg·m^2: xx,yy,zz or six")
    add("--centre", type=_numbers, help="its centre from the interface point, m: x,y,z")
    add("--nonlinear", action="store_true", help="nonlinear solves for the stresses over the range")
    add("--schema", action="store_true", help="the JSON schema of component.toml, for editors")
    add("folder", type=Path, metavar="FOLDER", nargs="?", help="folder of the component bundle")
    try:
        options = parser.parse_args(arguments)
        if options.schema:
            print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
            return 0
        if options.folder is None:
            raise ValueError("name the FOLDER of a component bundle, or --schema")
        # The mass of the arguments; None without any.
        if options.mass is None and options.inertia is None and options.centre is None:
            riding = None
        else:
            if options.mass is None:
                raise ValueError("--inertia and --centre need --mass")
            riding = Riding.of(options.mass, options.inertia, options.centre)
    except SystemExit as error:
        return int(error.code or 0)
    except (argparse.ArgumentError, ValueError) as error:
        print(f"{parser.format_usage()}{error}")
        return 2
    summary = report(options.folder, riding, options.nonlinear)
    print(json.dumps(summary) if options.json else as_text(summary))
    return 0 if summary["ok"] else 1


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        message = f'"{text}" must be numbers with commas between them, such as 1,1,0.5'
        raise argparse.ArgumentTypeError(message) from None
