"""The report on a bundle as text for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from wrenchbook.fea.spec.schema import ACCELERATIONS, FREEDOMS

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
