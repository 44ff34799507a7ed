"""The report on a bundle, and its text for people."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.accuracy.advice import over_tolerance, straight_edges
from wrenchbook.fea.accuracy.estimate import accuracy_or_why
from wrenchbook.fea.bundle.read import FILE_NAME, Bundle, BundleError, read_bundle
from wrenchbook.fea.bundle.tables import ComponentFile
from wrenchbook.fea.check.cost import estimate
from wrenchbook.fea.check.deck_differences import contradictions, listing
from wrenchbook.fea.check.mechanisms import listed_bodies, motion_problems
from wrenchbook.fea.check.trial import (
    deflection_warnings,
    frequency,
    solver_of,
    strength,
    trial,
    weight_warnings,
)
from wrenchbook.fea.component import AttachedInterface, ComponentModel, build, mesh_of, surface_of
from wrenchbook.fea.deck.running import deck_report
from wrenchbook.fea.inspection import (
    Bodies,
    bodies_of,
    coincidence_warnings,
    coincident_nodes,
    quality,
    quality_warnings,
    set_up_warnings,
    stack_problems,
    strength_at,
)
from wrenchbook.fea.mesh.bolts import BoltCut
from wrenchbook.fea.mesh.cad.meshing import list_shape
from wrenchbook.fea.mesh.facets import Face
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.surface import Surface
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.keys import keys_of, kind_of, validated
from wrenchbook.fea.spec.mesh_source import GEOMETRY_ENDINGS
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import ACCELERATIONS, FREEDOMS

_MAX_SECONDS = 5.0
"""Of a linear solve, to estimate the solver's error too: that takes up to three more."""
_MAX_BYTES = 1e9  # of the same: a coarser mesh and nonlinear solves come on top
_OF_MATERIAL = ["region", "law", "youngs_modulus", "poisson_ratio", "density", "yield_strength"]


def report(
    folder: str | Path,
    riding: Riding | None = None,
    nonlinear: bool = False,
    surface: Surface | None = None,
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
    surface
        Of `surface_in`, to list its faces.

    Returns
    -------
    dict
        Always ``ok``, ``problems`` (what stops a solve) and ``warnings`` (what may make it wrong),
        each a list of ``{"where", "message"}``. As far as it gets: ``name``, ``fingerprint``,
        ``has_fea``; ``faces`` and ``bodies`` of a geometry file (``faces`` with ``toml`` of any
        surface); ``unknowns`` (three a node), ``nodes``, ``cells``, ``groups``, ``quality`` (see
        `fea.inspection`), ``parts``, ``coincident_nodes``; of an input deck ``mesh_file`` (see
        `fea.check.deck_differences`); ``materials``, ``section`` (of several interfaces
        ``sections``, with their names), ``supports``, ``ties``, ``temperature`` and
        ``acceleration`` where there are any; ``estimate`` (`fea.check.cost.Cost`), ``trial``,
        ``vibration`` and ``strength`` (`Trial`, `Swing` and `LargestStress` of `fea.check.trial`);
        for meshes that solve in seconds ``solver_error`` (see `fea.accuracy.estimate`). Lengths in
        m. Instead of all from ``faces`` on, ``deck`` (see `fea.deck.running`).
    """
    summary: dict[str, Any] = {"ok": False, "problems": [], "warnings": []}
    folder = Path(folder)
    if surface is not None:
        summary["faces"] = [listed(surface, face) for face in surface.faces]
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
            summary["warnings"] += warnings
            if riding is not None:
                message = "gives no natural frequency, so the mass has no effect; leave it out"
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
    """Return the surface of a bundle's mesh, or its deck's; None if [mesh] or file will not do.

    `problems` gets the mistakes of [mesh] and of its file.
    """
    problems = [] if problems is None else problems
    try:
        content = tomllib.loads((folder / FILE_NAME).read_text("utf-8"))
        deck = content.get("deck", {})
        table = content.get("mesh") or {"unit": deck.get("unit", "m"), "file": deck["file"]}
        keys = {key: value for key, value in table.items() if key not in ("groups", "regions")}
        source = validated(kind_of(keys_of(ComponentFile)["mesh"]), keys, "mesh", problems, folder)
        return None if source is None else surface_of(source)
    except BundleError as error:
        problems += error.problems
    except (OSError, ValueError, RecursionError, LookupError, AttributeError):
        pass  # `report` says why
    return None


def listed(surface: Surface, face: Face) -> dict[str, Any]:
    """Return a face with the ``toml`` that selects it; lengths in m, areas in m^2."""
    if face.kind == "Cylinder" and face.axis is None:  # of a geometry file
        face = surface.cylinder(np.flatnonzero(surface.numbers == face.number), face) or face
    return asdict(face) | {"toml": surface.line(face)}


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
        faces, summary["bodies"] = list_shape(path)
        summary.setdefault("faces", faces)


def _inspect_mesh(
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
    warnings: list[BundleProblem] = summary["warnings"]
    warnings += [BundleProblem("mesh", text) for text in quality_warnings(summary["quality"])]
    bodies = bodies_of(mesh)
    summary["parts"] = listed_bodies(mesh, bodies)
    if mesh.deck is not None:
        summary["mesh_file"] = listing(mesh.deck)
    try:
        component = build(bundle, mesh)
        mesh = component.uncut_mesh
    finally:  # warn of unmerged nodes, those that no tie joins, whether or not the build succeeds
        pairs = coincident_nodes(mesh)
        summary["coincident_nodes"] = len(pairs)
        warnings += coincidence_warnings(mesh, bodies, pairs)
    warnings += contradictions(component)
    _inspect_component(component, bodies, pairs, summary)
    # Find what every solve would refuse, then how the part moves and swings.
    solver = solver_of(component)
    summary["trial"], problems = trial(solver, summary["estimate"])
    problems = problems or stack_problems(component)  # a mechanism is named as such
    if problems:
        raise BundleError(problems)
    warnings += deflection_warnings(component, summary["trial"]["deflection"])
    if summary["trial"]["deflection"] is not None:
        warnings += weight_warnings(solver)
    summary["vibration"], more = frequency(solver, riding)
    warnings += more
    stresses, more = strength(solver, nonlinear)
    summary["strength"] = [stress.as_json() for stress in stresses]
    warnings += more
    # Find what the solver's answers may be wrong by, and whether that is over the tolerance.
    cost, bundle = summary["estimate"], solver.component.bundle
    if cost["linear_seconds"] > _MAX_SECONDS or cost["memory_bytes"] > _MAX_BYTES:
        return
    summary["solver_error"] = accuracy_or_why(solver)
    if summary["solver_error"]["mesh"] is None:
        why = f"the discretisation error is unknown: {summary['solver_error']['mesh_basis']}"
        warnings.append(BundleProblem("mesh", why))
    warnings += straight_edges(summary["solver_error"])
    limit = None if bundle is None else bundle.tolerance
    if limit is not None:
        warnings += over_tolerance(summary["solver_error"], limit.translation, limit.rotation)


def _inspect_component(
    component: ComponentModel, bodies: Bodies, pairs: Any, summary: dict[str, Any]
) -> None:
    numbers = component.material_of_cells
    attached = [_section(interface) for interface in component.interfaces]
    joined: dict[str, Any] = {}
    if component.ties:
        joined["ties"] = [
            {"secondary": names.secondary, "main": names.main}
            | {"nodes": len(tie.nodes), "untied": tie.untied, "gap": tie.gap}
            for names, tie in zip(component.bundle.ties, component.ties, strict=True)
        ]
    # The ranges of the inputs behind the loads, where there are any.
    inputs: dict[str, Any] = {}
    if warm := component.temperature:
        inputs["temperature"] = {"low": warm.low, "high": warm.high, "reference": warm.reference}
    if component.accelerated:
        inputs["acceleration"] = [scalar.high for scalar in component.further[-3:]]
    if component.bolts:
        joined["bolts"] = [_bolt(component, bolt) for bolt in component.bolts]
        joined["zero"] = component.analysis.zero
    if component.joints:
        sources = zip(component.bundle.joints, component.joints, strict=True)
        joined["springs"] = [
            {
                "groups": list(source.groups),
                "nodes": [len(end.section.node_ids) for end in joint.ends],
                "point": joint.ends[0].point.tolist(),
                "coupling": source.coupling,
                "rigid": source.rigid,
            }
            for source, joint in sources
        ]
    counts = {"sliding_nodes": len(component.sliding[0]), "bushings": len(component.bushings)}
    summary |= {
        "materials": [
            {key: getattr(material, key) for key in _OF_MATERIAL}
            | {"cells": sum(int((block == i).sum()) for block in numbers)}
            for i, material in enumerate(component.materials)
        ],
        "supports": {"nodes": len(component.fixed_nodes)}
        | {name: count for name, count in counts.items() if count},
        **inputs,
        **joined,
        **({"sections": attached} if attached[1:] else {"section": attached[0]}),
        "nonlinear": component.analysis.nonlinear,
    }
    summary["warnings"] += set_up_warnings(component)
    problems = motion_problems(component, bodies, pairs)
    if problems:
        raise BundleError(problems)
    summary["estimate"] = estimate(component)


def _bolt(component: ComponentModel, cut: BoltCut) -> dict[str, Any]:
    return {
        "shank": cut.bolt.region or cut.bolt.group,
        "cells": sum(len(cells) for cells in cut.cells),
        "at": component.mesh.points[cut.slip].tolist(),
        "area": cut.area,
        "force": cut.bolt.force,
        "keeps": cut.bolt.keeps,
        "stress": cut.bolt.force / cut.area,
        "yield_strength": strength_at(component, cut),
    }


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


_MAX_LINES = 60  # of bodies, and of faces
_EACH = len(FREEDOMS)  # values of one interface


def as_text(report: Mapping[str, Any]) -> str:
    """Return a report of `fea.check.report` as lines, its warnings and errors last."""
    lines = [f"{report.get('name', 'bundle')}  {report.get('fingerprint', '')}".rstrip()]
    if report.get("has_fea") is False:
        lines.append("a table only: nothing to mesh or solve")
    for rows in (_source, _mesh, _set_up, _trial, _estimates):
        lines += rows(report)
    counts = []
    for kind, entries in (("warning", report["warnings"]), ("error", report["problems"])):
        lines += [f"{kind}: {entry['where']}: {entry['message']}" for entry in entries]
        counts.append(f"{len(entries)} {kind}{'s'[: len(entries) != 1]}" if entries else "")
    ready = ", ".join(filter(None, ("ready to solve", counts[0])))
    return "\n".join([*lines, ready if report["ok"] else counts[1]])


def _source(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is of a deck that solves, and of a geometry file."""
    if deck := report.get("deck"):
        program = deck["program"] or "a program that is not here"
        yield (
            f"deck: {deck['file']} in {deck['unit']}, run by {program} for {deck['timeout']:g} s "
            f"at most, read by {deck['reader']}; its moments are {deck['moment']}"
        )
    if "faces" not in report:
        return
    if "bodies" in report:
        yield "bodies:  number  volume cm^3  middle m"
    for body in report.get("bodies", [])[:_MAX_LINES]:
        yield f"  {body['number']:>13}  {1e6 * body['volume']:>11.5g}  {_vector(body['centre'])}"
    yield from _faces(report["faces"])


def _faces(faces: list[dict[str, Any]]) -> Iterator[str]:
    yield "faces:   number  area mm^2    middle m                      what"
    for face in faces[:_MAX_LINES]:
        shape = str(face["kind"]).lower()
        if face["normal"] is not None:
            shape = f"plane, normal {_vector(face['normal'])}"
        elif face["radius"] is not None:
            shape = f"cylinder, radius {1e3 * face['radius']:.5g} mm"
            if face["axis"] is not None:
                shape += f", axis {_vector(face['axis'])} through {_vector(face['point'])}"
        head = f"  {face['number']:>13}  {1e6 * face['area']:>11.5g}  {_vector(face['centre']):<28}"
        yield f"{head}  {shape}"
        if "toml" in face:
            yield f"{'':>17}NAME = {face['toml']}"
    if (more := len(faces) - _MAX_LINES) > 0:
        yield f"  and {more} more"


def _mesh(report: Mapping[str, Any]) -> Iterator[str]:
    if "cells" not in report:
        return
    cells = ", ".join(f"{count} {kind}" for kind, count in report["cells"].items())
    yield f"mesh: {cells}; {report['nodes']} nodes, {report['unknowns']} unknowns"
    for part in report["parts"] if len(report["parts"]) > 1 else ():
        size = " x ".join(f"{1e3 * x:.4g}" for x in part["size"])
        yield (
            f"  part {part['part']}: {part['cells']} cells, {size} mm, middle at "
            f"{_vector(part['middle'])} m"
        )
    if file := report.get("mesh_file"):
        for key, label in (("read", "read or compared"), ("ignored", "ignored")):
            lines = ", ".join(f"*{word} ({len(at)})" for word, at in file[key].items())
            yield f"deck, {label}: {lines or 'nothing'}"
        for name, element in file["elements"].items():
            if element["instead"]:
                yield f"deck, elements: {element['count']} {name}: {element['instead']}"
    for kind, groups in report["groups"].items():
        listed = ", ".join(f"{name} ({count})" for name, count in groups.items()) or "none"
        yield f"groups of {kind}: {listed}"
    for name, worst in report.get("quality", {}).items():
        bad = f", {worst['bad']} beyond {worst['limit']:g}" if worst["bad"] else ""
        at = _vector(worst["at"])
        yield f"worst {name.replace('_', ' ')}: {worst['worst']:.3g} near {at} m{bad}"


def _set_up(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield what the bundle attaches to the mesh: materials, supports, inputs, interfaces."""
    if "supports" not in report:
        return
    for material in report["materials"]:
        law, young = material["law"], f"E = {material['youngs_modulus']:.4g} Pa"
        if law == "orthotropic":
            values = [f"orthotropic, largest {young}"]
        else:
            values = [law] if law != "isotropic" else []
            values += [young, f"nu = {material['poisson_ratio']:g}"]
        if (density := material.get("density")) is not None:
            values.append(f"{density:g} kg/m^3")
        if (strength := material.get("yield_strength")) is not None:
            values.append(f"yields at {strength:.4g} Pa")
        yield f"material {material['region']}: {', '.join(values)}, {material['cells']} cells"
    supports = report["supports"]
    sliding = f", {supports['sliding_nodes']} sliding" if "sliding_nodes" in supports else ""
    bushings = f"; bushings: {supports['bushings']}" if "bushings" in supports else ""
    yield f"supports: {supports['nodes']} nodes fixed{sliding}{bushings}"
    for tie in report.get("ties", ()):
        yield (
            f"tie: {tie['nodes']} nodes of {tie['secondary']} follow {tie['main']}, "
            f"{tie['untied']} are not tied; largest gap {1e3 * tie['gap']:.3g} mm"
        )
    yield from _joints(report)
    if warm := report.get("temperature"):
        yield f"temperature: {warm['low']:g} to {warm['high']:g}, reference {warm['reference']:g}"
    if largest := report.get("acceleration"):
        yield f"acceleration: up to {_vector(largest)} m/s^2 along the mesh's axes"
    for section in report.get("sections", [report.get("section")]):
        area = "no area" if section["area"] is None else f"{1e6 * section['area']:.5g} mm^2"
        locked = f", locked {', '.join(section['locked'])}" if section["locked"] else ""
        locked = ", held" if len(section["locked"]) == _EACH else locked
        name = f" {section['name']}" if "name" in section else ""
        yield (
            f"interface{name}: {section['nodes']} nodes, {area}, {section['coupling']}{locked}, "
            f"point at {_vector(section['point'])} m"
        )


def _joints(report: Mapping[str, Any]) -> Iterator[str]:
    for bolt in report.get("bolts", []):
        used = bolt["yield_strength"] and bolt["stress"] / bolt["yield_strength"]
        of_yield = "" if used is None else f" ({100 * used:.3g} % of its yield strength)"
        yield (
            f"bolt {bolt['shank']}: {bolt['force']:g} N, keeps its {bolt['keeps']}, cut below "
            f"{bolt['cells']} cells near {_vector(bolt['at'])} m, {1e6 * bolt['area']:.5g} mm^2, "
            f"mean stress {bolt['stress'] / 1e6:.4g} MPa{of_yield}"
        )
    for spring in report.get("springs", []):
        kind = "rigid joint" if spring["rigid"] else f"spring, {spring['coupling']}"
        nodes = " and ".join(map(str, spring["nodes"]))
        groups, at = " and ".join(spring["groups"]), _vector(spring["point"])
        yield f"{kind} between {groups}: {nodes} nodes, point at {at} m"


_AT_REST = {
    None: ("self-weight moves", "of the mesh without its weight"),
    "preloaded": ("self-weight moves", "as its bolts are tightened, without its weight"),
    "untightened": ("preload, and self-weight if any, move", "before its bolts are tightened"),
}
"""By the zero of displacement: the cause of the one at no load, and that zero."""


def _trial(report: Mapping[str, Any]) -> Iterator[str]:
    if (trial := report.get("trial")) is None:
        return
    size = " x ".join(f"{1e3 * x:.4g}" for x in trial["size"])
    mass = "no density, so no mass" if trial["mass"] is None else f"{trial['mass']:.4g} kg"
    yield f"size: {size} mm, {1e6 * trial['volume']:.4g} cm^3, {mass}"
    if trial.get("failed"):
        return
    if trial["deflection"] is None:
        yield "at full range: not tried, a solve takes too long for a check"
        return
    cause, zero = _AT_REST[report.get("zero")]
    for name, sag in _by_interface(report, trial["sag"]) if "sag" in trial else ():
        moved, turned = _vectors(sag, ".3g")
        yield (
            f"{cause} {name or 'it'} by {moved} m and turns it by {turned} rad, "
            "linearly, in the interface frame: the answer at zero load. Displacements "
            f"are relative to the part {zero}"
        )
    for key, when in (
        ("deflection", "at full range, linearly,"),
        ("by_temperature", "by the temperature alone"),
        ("by_acceleration", "by the acceleration alone"),
    ):
        for name, largest in _by_interface(report, trial[key]) if key in trial else ():
            moved, turned = _vectors(largest, ".3g")
            yield f"{when} {name or 'it'} moves by {moved} m and turns by {turned} rad at most"


def _estimates(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the error bar, frequency, stresses and cost, as far as the report has them."""
    error = report.get("solver_error")
    if error is not None and error["mesh"] is None:
        yield f"error bar of the mesh: not known; {error['mesh_basis']}"
    elif error is not None:
        parts = {"error bar of the mesh at full range": error["mesh"]}
        if "rounded" in error:
            parts["of that by straight edges"] = error["rounded"]["mesh"]
        for label, matrix in parts.items():
            for name, bar in _by_interface(report, (np.array(matrix) @ error["loads"]).tolist()):
                moved, turned = _vectors(bar, ".2g")
                yield f"{label}{f', {name}' if name else ''}: {moved} m, {turned} rad"
        yield f"error bar of the mesh from {error['mesh_basis']}"
    if swing := report.get("vibration"):
        carried = f"with {swing['riding_mass']:g} kg on it" if swing["riding_mass"] else "by itself"
        mass = "not known" if swing["mass"] is None else f"{swing['mass']:.4g} kg"
        moves = "; ".join(
            f"{name or 'interface'} moves along {_vector(motion[:3])}, turns about "
            f"{_vector(motion[3:])}"
            for name, motion in _by_interface(report, swing["motion"])
        )
        yield (
            f"mass {mass}; first natural frequency {swing['first_frequency']:.4g} Hz {carried} "
            f"({moves})"
        )
    for stress in report.get("strength", []):
        used = stress["yield_strength"] and stress["largest"] / stress["yield_strength"]
        of_yield = "" if used is None else f", {100 * used:.3g} % of its yield strength"
        order = " to first order (--nonlinear solves)" if stress["first_order"] else ""
        loads = "; ".join(
            f"{name and name + ' '}force {_vector(load[:3])} N, moment {_vector(load[3:])} N·m"
            for name, load in _by_interface(report, stress["wrench"])
        )
        warm = f" at {stress['temperature']:g}" if "temperature" in stress else ""
        pulled = _vector([stress[axis] for axis in ACCELERATIONS]) if "ax" in stress else ""
        yield (
            f"largest von Mises stress of {stress['region']} under the full range{order}: "
            f"{stress['largest'] / 1e6:.4g} MPa{of_yield}, near {_vector(stress['at'])} m under "
            f"{loads}{warm}{pulled and f', acceleration {pulled}'}"
        )
    if cost := report.get("estimate"):
        size = cost["memory_bytes"]
        memory = f"{size / 1e9:.2g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"
        yield (
            f"one solve: about {_time(cost['linear_seconds'])} linear, "
            f"{_time(cost['nonlinear_seconds'])} nonlinear, {memory} of memory ({cost['basis']})"
        )


def _by_interface(report: Mapping[str, Any], values: list[float]) -> list[tuple[str, list[float]]]:
    """Return six values of each interface with its name, empty for a single interface."""
    names = [section["name"] for section in report.get("sections", [])] or [""]
    starts = range(0, len(values), _EACH)
    return [(name, values[i : i + _EACH]) for name, i in zip(names, starts, strict=True)]


def _vectors(values: list[float], digits: str) -> tuple[str, str]:
    """Write the translation and the rotation of an interface."""
    texts = [format(x, digits) for x in values]
    return f"({', '.join(texts[:3])})", f"({', '.join(texts[3:])})"


def _vector(vector: Any) -> str:
    """Write a point or direction; what is 12 digits below the largest is roundoff."""
    least = 1e-12 * max(1.0, *map(abs, vector))
    return "(" + ", ".join(f"{x if abs(x) > least else 0.0:.5g}" for x in vector) + ")"


def _time(seconds: float) -> str:
    if seconds < 99.5:  # of two digits: more would be written 1e+02
        return f"{seconds:.2g} s"
    minutes, hours = seconds / 60, seconds / 3600
    if minutes < 99.5:
        return f"{minutes:.2g} min"
    return f"{hours:.2g} h" if hours < 99.5 else f"{hours:.0f} h"
