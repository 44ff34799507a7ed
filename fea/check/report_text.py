"""The report on a bundle as text for people.

Each part of the text yields its lines, none if the report lacks its values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from wrenchbook.fea.spec.schema import ACCELERATIONS, FREEDOMS

_MAX_LINES = 60  # lines of bodies, and of faces: a screen


def as_text(report: Mapping[str, Any]) -> str:
    """Return a report of `fea.check.report` as lines, its warnings and errors last."""
    lines = [f"{report.get('name', 'bundle')}  {report.get('fingerprint', '')}".rstrip()]
    if report.get("has_fea") is False:
        lines.append("a table only: nothing to mesh or solve")
    for part in (_source, _mesh, _materials, _set_up, _trial, _error_bars, _vibration):
        lines += part(report)
    lines += [*_strength(report), *_cost(report)]
    counts = {}
    for kind, entries in (("warning", report["warnings"]), ("error", report["problems"])):
        lines += [f"{kind}: {entry['where']}: {entry['message']}" for entry in entries]
        counts[kind] = f"1 {kind}" if len(entries) == 1 else f"{len(entries)} {kind}s"
    if report["ok"]:
        warned = f", {counts['warning']}" if report["warnings"] else ""
        return "\n".join([*lines, f"ready to solve{warned}"])
    return "\n".join([*lines, counts["error"]])


def _source(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield a deck that replaces the embedded solver, and bodies and faces of a file."""
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
    """Yield a table of faces, each with its shape and the TOML that selects it."""
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
    """Yield cells, parts, their deck, groups, and the worst shapes."""
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


def _materials(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each material."""
    for material in report.get("materials", []):
        law = material["law"]
        young = f"E = {material['youngs_modulus']:.4g} Pa"
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


def _set_up(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield supports, ties, joints, inputs and interfaces."""
    if (supports := report.get("supports")) is None:
        return
    sliding = f", {supports['sliding_nodes']} sliding" if "sliding_nodes" in supports else ""
    bushings = f"; bushings: {supports['bushings']}" if "bushings" in supports else ""
    yield f"supports: {supports['nodes']} nodes fixed{sliding}{bushings}"
    for tie in report.get("ties", ()):
        yield (
            f"tie: {tie['nodes']} nodes of {tie['secondary']} follow {tie['main']}, "
            f"{tie['untied']} are not tied; largest gap {1e3 * tie['gap']:.3g} mm"
        )
    for bolt in report.get("bolts", []):
        of_yield = _of_yield(bolt["stress"], bolt["yield_strength"])
        of_yield = f" ({of_yield})" if of_yield else ""
        yield (
            f"bolt {bolt['shank']}: {bolt['force']:g} N, keeps its {bolt['keeps']}, cut below "
            f"{bolt['cells']} cells near {_vector(bolt['at'])} m, {1e6 * bolt['area']:.5g} mm^2, "
            f"mean stress {bolt['stress'] / 1e6:.4g} MPa{of_yield}"
        )
    for spring in report.get("springs", []):
        kind = "rigid joint" if spring["rigid"] else f"spring with {spring['coupling']} ends"
        nodes = " and ".join(map(str, spring["nodes"]))
        groups = " and ".join(spring["groups"])
        at = _vector(spring["point"])
        yield f"{kind} between {groups}: {nodes} nodes, point at {at} m"
    if warm := report.get("temperature"):
        yield f"temperature: {warm['low']:g} to {warm['high']:g}, reference {warm['reference']:g}"
    if largest := report.get("acceleration"):
        yield f"acceleration: up to {_vector(largest)} m/s^2 along the mesh's axes"
    for section in report.get("sections", [report.get("section")]):
        area = "no area" if section["area"] is None else f"{1e6 * section['area']:.5g} mm^2"
        locked = ""
        if len(section["locked"]) == len(FREEDOMS):
            locked = ", held"
        elif section["locked"]:
            locked = f", locked {', '.join(section['locked'])}"
        name = f" {section['name']}" if "name" in section else ""
        yield (
            f"interface{name}: {section['nodes']} nodes, {area}, {section['coupling']}{locked}, "
            f"point at {_vector(section['point'])} m"
        )


_AT_REST = {
    None: ("self-weight moves", "of the mesh without its weight"),
    "preloaded": ("self-weight moves", "as its bolts are tightened, without its weight"),
    "untightened": ("preload, and self-weight if any, move", "before its bolts are tightened"),
}
"""For each zero of displacement: the cause of a displacement at no load, and the part at zero."""


def _trial(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield size and mass, the displacement at no load, and the largest over the range."""
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


def _error_bars(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the error bar of the mesh at the full range, and the part of it by straight edges."""
    if (error := report.get("solver_error")) is None:
        return
    if error["mesh"] is None:
        yield f"error bar of the mesh: not known; {error['mesh_basis']}"
        return
    parts = {"error bar of the mesh at full range": error["mesh"]}
    if "rounded" in error:
        parts["of that by straight edges"] = error["rounded"]["mesh"]
    for label, matrix in parts.items():
        at_full_range = (np.array(matrix) @ error["loads"]).tolist()
        for name, bar in _by_interface(report, at_full_range):
            moved, turned = _vectors(bar, ".2g")
            where = f", {name}" if name else ""
            yield f"{label}{where}: {moved} m, {turned} rad"
    yield f"error bar of the mesh from {error['mesh_basis']}"
    if error.get("linearity") is None:
        return
    for name, bar in _by_interface(report, error["linearity"]):
        moved, turned = _vectors(bar, ".2g")
        where = f", {name}" if name else ""
        yield f"error bar of the linear analysis at full range{where}: {moved} m, {turned} rad"


def _vibration(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the mass and the first natural frequency, with the motion of the interfaces."""
    if not (swing := report.get("vibration")):
        return
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


def _strength(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield the largest stress of each region, with the inputs that cause it."""
    for stress in report.get("strength", []):
        of_yield = _of_yield(stress["largest"], stress["yield_strength"])
        of_yield = f", {of_yield}" if of_yield else ""
        order = " to first order (--nonlinear solves)" if stress["first_order"] else ""
        loads = []
        for name, load in _by_interface(report, stress["wrench"]):
            label = f"{name} " if name else ""
            loads.append(f"{label}force {_vector(load[:3])} N, moment {_vector(load[3:])} N·m")
        warm = f" at the temperature {stress['temperature']:g}" if "temperature" in stress else ""
        pulled = ""
        if "ax" in stress:
            pulled = f", acceleration {_vector([stress[axis] for axis in ACCELERATIONS])}"
        yield (
            f"largest von Mises stress of {stress['region']} at the integration points under the "
            f"full range{order}: "
            f"{stress['largest'] / 1e6:.4g} MPa{of_yield}, near {_vector(stress['at'])} m under "
            f"{'; '.join(loads)}{warm}{pulled}"
        )


def _cost(report: Mapping[str, Any]) -> Iterator[str]:
    """Yield time and memory of one solve."""
    if cost := report.get("estimate"):
        size = cost["memory_bytes"]
        memory = f"{_two_digits(size / 1e9)} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"
        yield (
            f"one solve: about {_time(cost['linear_seconds'])} linear, "
            f"{_time(cost['nonlinear_seconds'])} nonlinear, {memory} of memory ({cost['basis']})"
        )


def _of_yield(stress: float, strength: float | None) -> str:
    """Write a stress relative to a yield strength, both in Pa; empty if that is not known."""
    return "" if strength is None else f"{100 * (stress / strength):.3g} % of its yield strength"


def _by_interface(report: Mapping[str, Any], values: list[float]) -> list[tuple[str, list[float]]]:
    """Return six values of each interface with its name, empty for a single interface."""
    names = [section["name"] for section in report.get("sections", [])] or [""]
    each = len(FREEDOMS)  # number of values of an interface
    starts = range(0, len(values), each)
    return [(name, values[i : i + each]) for name, i in zip(names, starts, strict=True)]


def _vectors(values: list[float], digits: str) -> tuple[str, str]:
    """Write the translation and the rotation of an interface, each by a format such as ``.3g``."""
    texts = [format(x, digits) for x in values]
    return f"({', '.join(texts[:3])})", f"({', '.join(texts[3:])})"


def _vector(vector: Sequence[float]) -> str:
    """Write a point or direction; numbers 12 digits below the largest are roundoff and become 0."""
    least = 1e-12 * max(1.0, *map(abs, vector))
    texts = [f"{x if abs(x) > least else 0.0:.5g}" for x in vector]
    return f"({', '.join(texts)})"


def _time(seconds: float) -> str:
    """Write a time with two digits in s, min or h: the first unit with fewer than 99.5 of it."""
    minutes, hours = seconds / 60, seconds / 3600
    if seconds < _EXPONENT:
        return f"{_two_digits(seconds)} s"
    return f"{_two_digits(minutes)} min" if minutes < _EXPONENT else f"{_two_digits(hours)} h"


_EXPONENT = 99.5  # from this value on two digits would be written as 1e+02


def _two_digits(value: float) -> str:
    """Write two digits, or all digits before the point."""
    return f"{value:.2g}" if value < _EXPONENT else f"{value:.0f}"
