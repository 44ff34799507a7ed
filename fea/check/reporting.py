"""The report on a bundle."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.accuracy.advice import over_tolerance, straight_edges
from wrenchbook.fea.accuracy.estimate import accuracy_or_why
from wrenchbook.fea.accuracy.roundness import polygon_warnings
from wrenchbook.fea.bundle.read import FILE_NAME, Bundle, BundleError, read_bundle
from wrenchbook.fea.bundle.tables import ComponentFile
from wrenchbook.fea.check.cost import estimate
from wrenchbook.fea.check.deck_differences import contradictions, listing
from wrenchbook.fea.check.mechanisms import listed_bodies, motion_problems
from wrenchbook.fea.check.strength import strength
from wrenchbook.fea.check.trial import (
    deflection_warnings,
    frequency,
    solver_of,
    trial,
    weight_warnings,
)
from wrenchbook.fea.component import AttachedInterface, ComponentModel, build
from wrenchbook.fea.deck.running import deck_report
from wrenchbook.fea.inspection import (
    coincidence_warnings,
    set_up_warnings,
    stack_problems,
    strength_at,
)
from wrenchbook.fea.mesh.bodies import Bodies, bodies_of, coincident_nodes
from wrenchbook.fea.mesh.cad.meshing import list_shape
from wrenchbook.fea.mesh.face_choice import toml_line
from wrenchbook.fea.mesh.facets import Face
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.quality import quality, quality_warnings
from wrenchbook.fea.mesh.sources import mesh_of, surface_of
from wrenchbook.fea.mesh.surface import Surface
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.keys import keys_of, kind_of, validate
from wrenchbook.fea.spec.mesh_source import GEOMETRY_ENDINGS
from wrenchbook.fea.spec.problems import BundleProblem

# Largest estimated time of a linear solve, s, for an estimate of the solver's error too: it takes
# up to three more solves, and in addition the memory of a coarser mesh.
_MAX_SECONDS = 5.0
_MAX_BYTES = 1e9
_MATERIAL_KEYS = ["region", "law", "youngs_modulus", "poisson_ratio", "density", "yield_strength"]


def report(
    folder: str | Path,
    riding: Riding | None = None,
    nonlinear: bool = False,
    surface: Surface | None = None,
) -> dict[str, Any]:
    """Read the bundle, build its mesh, find its groups and look for possible mistakes.

    Parameters
    ----------
    folder
        The bundle's.
    riding
        The rigid mass that the interface will carry, for the natural frequency.
    nonlinear
        Whether stresses under the full range are those of a nonlinear solve, where the component is
        nonlinear; without it they are first order.
    surface
        Of `surface_in`, to list its faces.

    Returns
    -------
    dict
        Always ``ok``, ``problems`` (mistakes that prevent a solve) and ``warnings`` (possible
        mistakes), each a list of ``{"where", "message"}``. If the bundle allows it: ``name``,
        ``fingerprint``, ``has_fea``; ``faces`` and ``bodies`` of a geometry file (``faces`` with
        ``toml`` of any surface); ``unknowns`` (three a node), ``nodes``, ``cells``, ``groups``,
        ``quality`` (see `fea.mesh.quality`), ``parts``, ``coincident_nodes``; of an input deck
        ``mesh_file`` (see `fea.check.deck_differences`); ``materials``, ``section`` (of several
        interfaces ``sections``, with their names), ``supports``, ``ties``, ``temperature`` and
        ``acceleration`` where there are any; ``estimate`` (`fea.check.cost.Cost`), ``trial``,
        ``vibration`` (`Trial`, `Oscillation` of `fea.check.trial`) and ``strength``
        (`LargestStress`); for meshes that solve in seconds ``solver_error`` (see
        `fea.accuracy.estimate`). Lengths in m. Instead of all from ``faces`` on, ``deck`` (see
        `fea.deck.running`).
    """
    summary: dict[str, Any] = {"ok": False, "problems": [], "warnings": []}
    folder = Path(folder)
    if surface is not None:
        summary["faces"] = [listed(surface, face) for face in surface.faces]
    try:
        try:
            bundle = read_bundle(folder)
        except BundleError as error:
            try:
                _list_geometry(_geometry_named_in(folder), summary)
            except BundleError as other:
                raise BundleError([*error.problems, *other.problems]) from None
            raise
        summary |= {key: getattr(bundle, key) for key in ("name", "fingerprint", "has_fea")}
        if bundle.deck is not None:  # a deck answers in place of the embedded solver
            summary["deck"], warnings = deck_report(bundle.deck)
            summary["warnings"] += warnings
            if riding is not None:
                message = "gives no natural frequency, so a mass has no effect; leave the mass out"
                summary["warnings"].append(BundleProblem("deck", message))
        elif bundle.mesh is not None:
            if bundle.mesh.geometry is not None:
                _list_geometry(bundle.mesh.file, summary)
            _inspect_mesh(bundle, mesh_of(bundle.mesh), riding, nonlinear, summary)
    except BundleError as error:
        summary["problems"] = list(map(asdict, error.problems))
    summary["warnings"] = list(map(asdict, summary["warnings"]))
    summary["ok"] = not summary["problems"]
    return summary


def surface_in(folder: Path, problems: list[BundleProblem] | None = None) -> Surface | None:
    """Return the surface of a bundle's mesh, or its deck's; None if [mesh] or its file is wrong.

    `problems` gets the mistakes of [mesh] and of its file.
    """
    problems = [] if problems is None else problems
    try:
        content = tomllib.loads((folder / FILE_NAME).read_text("utf-8-sig"))
        deck = content.get("deck", {})
        table = content.get("mesh") or {"unit": deck.get("unit", "m"), "file": deck["file"]}
        keys = {key: value for key, value in table.items() if key not in ("groups", "regions")}
        source = validate(kind_of(keys_of(ComponentFile)["mesh"]), keys, "mesh", problems, folder)
        return None if source is None else surface_of(source)
    except BundleError as error:
        problems += error.problems
    except (OSError, ValueError, RecursionError, LookupError, AttributeError):
        pass  # `report` has the problem
    return None


def listed(surface: Surface, face: Face) -> dict[str, Any]:
    """Return a face with the ``toml`` that selects it; lengths in m, areas in m^2."""
    if face.kind == "Cylinder" and face.axis is None:  # a face of a geometry file
        face = surface.cylinder(np.flatnonzero(surface.numbers == face.number), face) or face
    return asdict(face) | {"toml": toml_line(surface, face)}


def _geometry_named_in(folder: Path) -> Path | None:
    """Return the STEP file of a bundle with mistakes: its faces help to complete the bundle."""
    try:
        name = tomllib.loads((folder / FILE_NAME).read_text("utf-8-sig"))["mesh"]["file"]
        path = (folder / name).resolve()
    except (OSError, ValueError, RecursionError, LookupError, TypeError):
        return None
    fits = path.suffix.lower() in GEOMETRY_ENDINGS and path.is_relative_to(folder.resolve())
    return path if fits and path.is_file() else None


def _list_geometry(path: Path | None, summary: dict[str, Any]) -> None:
    """Add the bodies of a geometry file, and its faces unless they are there with their TOML."""
    if path is not None:
        faces, summary["bodies"] = list_shape(path)
        summary.setdefault("faces", faces)


def _inspect_mesh(
    bundle: Bundle, mesh: Mesh, riding: Riding | None, nonlinear: bool, summary: dict[str, Any]
) -> None:
    """Add the results of the mesh and of trial solves to `summary`, with `warnings`.

    Raises BundleError for a mistake that prevents a solve; `summary` then has all earlier results.
    """
    facets = {name: group.blocks for name, group in mesh.facet_groups.items()}
    summary |= {"unknowns": mesh.unknowns, "nodes": len(mesh.points), "cells": mesh.cell_counts}
    summary["groups"] = {
        "cells": {name: sum(map(len, by_block)) for name, by_block in mesh.regions.items()},
        "facets": {name: sum(len(nodes) for _, nodes in of) for name, of in facets.items()},
        "nodes": {name: len(nodes) for name, nodes in mesh.node_groups.items()},
    }
    summary["quality"] = quality(mesh)
    warnings: list[BundleProblem] = summary["warnings"]
    warnings += [BundleProblem("mesh", text) for text in quality_warnings(summary["quality"])]
    bodies = bodies_of(mesh)
    summary["parts"] = listed_bodies(mesh, bodies)
    if mesh.deck is not None:
        summary["mesh_file"] = listing(mesh.deck)
    try:
        component = build(bundle, mesh)
        mesh = component.uncut_mesh
    finally:  # warn of unmerged nodes that no tie joins, also if the build fails
        pairs = coincident_nodes(mesh)
        summary["coincident_nodes"] = len(pairs)
        warnings += coincidence_warnings(mesh, bodies, pairs, bundle.joints)
    warnings += contradictions(component) + polygon_warnings(component)
    _inspect_component(component, bodies, pairs, summary)
    # Find failures of every solve before its errors.
    solver = solver_of(component)
    _try_out(solver, component, riding, nonlinear, summary)
    cost = summary["estimate"]
    if cost["linear_seconds"] > _MAX_SECONDS or cost["memory_bytes"] > _MAX_BYTES:
        return
    error = summary["solver_error"] = accuracy_or_why(solver)
    if error["mesh"] is None:
        why = f"the discretisation error is unknown: {error['mesh_basis']}"
        measure = "`wrenchbook converge FOLDER` measures it on finer meshes"
        warnings.append(BundleProblem("mesh", f"{why}; {measure}"))
    warnings += straight_edges(error)
    limit = bundle.tolerance
    warnings += over_tolerance(error, *(() if limit is None else astuple(limit)))


def _try_out(
    solver: Solver,
    component: ComponentModel,
    riding: Riding | None,
    nonlinear: bool,
    summary: dict[str, Any],
) -> None:
    """Add trial displacements, vibration and strength to `summary`, with `warnings`.

    Raises BundleError for a mistake that prevents a solve.
    """
    warnings: list[BundleProblem] = summary["warnings"]
    summary["trial"], problems = trial(solver, summary["estimate"])
    problems = problems or stack_problems(component)  # a mechanism is reported as such
    if problems:
        raise BundleError(problems)
    warnings += deflection_warnings(component, summary["trial"]["deflection"])
    if summary["trial"]["deflection"] is not None:
        warnings += weight_warnings(solver)
    summary["vibration"], resonances = frequency(solver, riding)
    warnings += resonances
    stresses, overloads = strength(solver, nonlinear)
    summary["strength"] = [stress.as_json() for stress in stresses]
    warnings += overloads


def _inspect_component(
    component: ComponentModel, bodies: Bodies, pairs: np.ndarray, summary: dict[str, Any]
) -> None:
    """Add sections, supports and joints of the bundle, and the cost of a solve, to `summary`.

    pairs: coincident nodes, shape (k, 2).

    Raises BundleError if a body can move freely.
    """
    summary["materials"] = [
        {key: getattr(material, key) for key in _MATERIAL_KEYS}
        | {"cells": sum(int((numbers == i).sum()) for numbers in component.material_of_cells)}
        for i, material in enumerate(component.materials)
    ]
    supports = {"nodes": len(component.fixed_nodes)}
    summary["supports"] = supports
    n_sliding = len(component.sliding[0])
    if n_sliding:
        supports["sliding_nodes"] = n_sliding
    if component.bushings:
        supports["bushings"] = len(component.bushings)
    # The ranges of the further inputs, if there are any.
    temperature = component.temperature
    if temperature is not None:
        keys = ("low", "high", "reference")
        summary["temperature"] = {key: getattr(temperature, key) for key in keys}
    if component.accelerated:
        summary["acceleration"] = [scalar.high for scalar in component.further[-3:]]

    summary |= _joining(component)
    sections = [_section(interface) for interface in component.interfaces]
    if len(sections) > 1:
        summary["sections"] = sections
    else:
        summary["section"] = sections[0]
    summary["nonlinear"] = component.analysis.nonlinear
    summary["warnings"] += set_up_warnings(component)
    problems = motion_problems(component, bodies, pairs)
    if problems:
        raise BundleError(problems)
    summary["estimate"] = estimate(component)


def _joining(component: ComponentModel) -> dict[str, Any]:
    """Return the report's entries of ties, bolts and springs, which join parts of the mesh."""
    entries: dict[str, Any] = {}
    if component.ties:
        entries["ties"] = [
            {"secondary": names.secondary, "main": names.main}
            | {"nodes": len(tie.nodes), "untied": tie.untied, "gap": tie.max_gap}
            for names, tie in zip(component.bundle.ties, component.ties, strict=True)
        ]
    if component.bolts:
        entries["bolts"] = [
            {
                "shank": cut.bolt.region or cut.bolt.group,
                "cells": sum(len(cells) for cells in cut.cells),
                "at": component.mesh.points[cut.slip].tolist(),
                "area": cut.area,
                "force": cut.bolt.force,
                "keeps": cut.bolt.keeps,
                "stress": cut.bolt.force / cut.area,
                "yield_strength": strength_at(component, cut),
            }
            for cut in component.bolts
        ]
        entries["zero"] = component.analysis.zero
    if component.joints:
        entries["springs"] = [
            {
                "groups": list(source.groups),
                "nodes": [len(end.section.node_ids) for end in joint.ends],
                "point": joint.ends[0].point.tolist(),
                "coupling": source.coupling,
                "rigid": source.rigid,
            }
            for source, joint in zip(component.bundle.joints, component.joints, strict=True)
        ]
    return entries


def _section(interface: AttachedInterface) -> dict[str, Any]:
    """Return the report's entry of an interface's section."""
    section = interface.section
    name = {"name": interface.name} if interface.name else {}
    return name | {
        "nodes": len(section.node_ids),
        "area": section.area,
        "centre": section.centre.tolist(),
        "point": interface.point.tolist(),
        "coupling": interface.coupling,
        "locked": list(interface.locked),
    }
