"""The report of `fea.check` as text for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wrenchbook.fea.spec.schema import ACCELERATIONS, FREEDOMS

_MOST_LINES = 60
_WIDTH = 100
_EACH = len(FREEDOMS)  # values of one interface


def as_text(report: Mapping[str, Any]) -> str:
    """Write out a report of `fea.check.report`.

    Returns
    -------
    str
        Lines without a newline at the end; what is wrong comes last, where it is read first.
    """
    lines = [f"{report.get('name', 'bundle')}  {report.get('fingerprint', '')}".rstrip()]
    if report.get("has_fea") is False:
        lines.append("a table only: nothing to mesh or solve")
    solved = (_trial, _accuracy, _vibration, _strength, _estimate)
    for write in (_deck, _geometry, _mesh, _mesh_file, _groups, _quality, _set_up, *solved):
        lines += write(report)
    lines += _complaints("warning", report["warnings"])
    lines += _complaints("error", report["problems"])
    warnings = _counted(report["warnings"], "warning")
    ready = ", ".join(filter(None, ("ready to solve", warnings)))
    lines.append(ready if report["ok"] else _counted(report["problems"], "error"))
    return "\n".join(lines)


def _counted(found: Sequence[Any], word: str) -> str:
    """Return a number of things in words, nothing of none."""
    return f"{len(found)} {word}{'s'[: len(found) != 1]}" if found else ""


def _deck(report: Mapping[str, Any]) -> list[str]:
    if "deck" not in report:
        return []
    deck = report["deck"]
    program = deck["program"] or "a program that is not here"
    return [
        f"deck: {deck['file']} in {deck['unit']}, run by {program} for {deck['timeout']:g} s at "
        f"most, read by {deck['reader']}; its moments are {deck['moment']}"
    ]


def _geometry(report: Mapping[str, Any]) -> list[str]:
    if "faces" not in report:
        return []
    lines = ["bodies:  number  volume cm^3  middle m"]
    lines += [
        f"  {body['number']:>13}  {1e6 * body['volume']:>11.5g}  {_place(body['centre'])}"
        for body in report["bodies"][:_MOST_LINES]
    ]
    lines.append("faces:   number  area mm^2    middle m                      what")
    for face in report["faces"][:_MOST_LINES]:
        head = f"  {face['number']:>13}  {1e6 * face['area']:>11.5g}  {_place(face['centre']):<28}"
        lines.append(f"{head}  {_shape(face)}")
    left = len(report["faces"]) - _MOST_LINES
    return lines + ([f"  and {left} more"] if left > 0 else [])


def _shape(face: Mapping[str, Any]) -> str:
    if face["normal"] is not None:
        return f"plane, normal {_place(face['normal'])}"
    if face["radius"] is not None:
        return f"cylinder, radius {1e3 * face['radius']:.5g} mm"
    return str(face["kind"]).lower()


def _mesh(report: Mapping[str, Any]) -> list[str]:
    if "cells" not in report:
        return []
    cells = ", ".join(f"{count} {kind}" for kind, count in report["cells"].items())
    lines = [f"mesh: {cells}; {report['nodes']} nodes, {report['unknowns']} unknowns"]
    if len(report["parts"]) > 1:
        for part in report["parts"]:
            size = " x ".join(f"{1e3 * x:.4g}" for x in part["size"])
            lines.append(
                f"  part {part['part']}: {part['cells']} cells, {size} mm, middle at "
                f"{_place(part['middle'])} m"
            )
    return lines


def _mesh_file(report: Mapping[str, Any]) -> list[str]:
    if "mesh_file" not in report:
        return []
    one = report["mesh_file"]
    lines = [
        f"deck, {words}: {', '.join(f'*{w} ({len(one[key][w])})' for w in one[key]) or 'nothing'}"
        for key, words in (("read", "read or compared"), ("ignored", "ignored"))
    ]
    return lines + [
        f"deck, elements: {own['count']} {name}: {own['instead']}"
        for name, own in one["elements"].items()
        if own["instead"]
    ]


def _groups(report: Mapping[str, Any]) -> list[str]:
    if "groups" not in report:
        return []
    lines = []
    for kind, found in report["groups"].items():
        listed = ", ".join(f"{name} ({count})" for name, count in found.items()) or "none"
        lines.append(f"groups of {kind}: {listed}")
    return lines


def _quality(report: Mapping[str, Any]) -> list[str]:
    lines = []
    for name, one in report.get("quality", {}).items():
        bad = f", {one['bad']} beyond {one['limit']:g}" if one["bad"] else ""
        words = name.replace("_", " ")
        lines.append(f"worst {words}: {one['worst']:.3g} near {_place(one['at'])} m{bad}")
    return lines


def _set_up(report: Mapping[str, Any]) -> list[str]:
    if "supports" not in report:
        return []
    lines = [
        f"material {m['region']}: {_law(m)}{_optional(m)}{m['cells']} cells"
        for m in report["materials"]
    ]
    return [
        *lines,
        f"supports: {_supports(report['supports'])}",
        *_further(report),
        *(_interface(one) for one in report.get("sections", [report.get("section")])),
    ]


def _further(report: Mapping[str, Any]) -> list[str]:
    lines = []
    if own := report.get("temperature"):
        ends = f"{own['low']:g} to {own['high']:g}"
        lines.append(f"temperature: {ends}, reference {own['reference']:g}")
    if most := report.get("acceleration"):
        lines.append(f"acceleration: up to {_place(most)} m/s^2 along the mesh's axes")
    return lines


def _supports(supports: Mapping[str, Any]) -> str:
    sliding = f", {supports['sliding_nodes']} sliding" if "sliding_nodes" in supports else ""
    bushings = f"; bushings: {supports['bushings']}" if "bushings" in supports else ""
    return f"{supports['nodes']} nodes fixed{sliding}{bushings}"


def _interface(section: Mapping[str, Any]) -> str:
    area = "no area" if section["area"] is None else f"{1e6 * section['area']:.5g} mm^2"
    locked = f", locked {', '.join(section['locked'])}" if section["locked"] else ""
    locked = ", held" if len(section["locked"]) == _EACH else locked
    name = f" {section['name']}" if "name" in section else ""
    return (
        f"interface{name}: {section['nodes']} nodes, {area}, {section['coupling']}{locked}, "
        f"point at {_place(section['point'])} m"
    )


def _law(material: Mapping[str, Any]) -> str:
    young, ratio = material["youngs_modulus"], material["poisson_ratio"]
    if material["law"] == "orthotropic":
        return f"orthotropic, largest E = {young:.4g} Pa, "
    name = "" if material["law"] == "isotropic" else f"{material['law']}, "
    return f"{name}E = {young:.4g} Pa, nu = {ratio:g}, "


def _optional(material: Mapping[str, Any]) -> str:
    """Write what a bundle need not say of a material."""
    density, strength = material.get("density"), material.get("yield_strength")
    words = "" if density is None else f"{density:g} kg/m^3, "
    return words + ("" if strength is None else f"yields at {strength:.4g} Pa, ")


def _trial(report: Mapping[str, Any]) -> list[str]:
    if "trial" not in report:
        return []
    one = report["trial"]
    size = " x ".join(f"{1e3 * x:.4g}" for x in one["size"])
    weight = "no density, so no mass" if one["mass"] is None else f"{one['mass']:.4g} kg"
    lines = [f"size: {size} mm, {1e6 * one['volume']:.4g} cm^3, {weight}"]
    if one.get("failed"):
        return lines
    if one["deflection"] is None:
        return [*lines, "at full range: not tried, a solve takes too long for a check"]
    for name, own in _by_interface(report, one["sag"]) if "sag" in one else ():
        sag = [f"{x:.3g}" for x in own]
        lines.append(
            f"own weight moves {name or 'it'} by ({', '.join(sag[:3])}) m and turns it by "
            f"({', '.join(sag[3:])}) rad, linearly, in the interface frame: the answer at zero "
            "load. Displacements are relative to the part of the mesh without its weight"
        )
    lines += _moved(report, "at full range, linearly,", one["deflection"])
    for name in ("temperature", "acceleration"):
        if f"by_{name}" in one:
            lines += _moved(report, f"by the {name} alone", one[f"by_{name}"])
    return lines


def _moved(report: Mapping[str, Any], when: str, values: list[float]) -> list[str]:
    lines = []
    for name, own in _by_interface(report, values):
        moved = [f"{x:.3g}" for x in own]
        lines.append(
            f"{when} {name or 'it'} moves by ({', '.join(moved[:3])}) m and "
            f"turns by ({', '.join(moved[3:])}) rad at most"
        )
    return lines


def _by_interface(report: Mapping[str, Any], values: list[float]) -> list[tuple[str, list[float]]]:
    """Return six values of each interface with its name, empty where there is one."""
    names = [one["name"] for one in report.get("sections", [])] or [""]
    ends = range(0, len(values), _EACH)
    return [(name, values[i : i + _EACH]) for name, i in zip(names, ends, strict=True)]


def _accuracy(report: Mapping[str, Any]) -> list[str]:
    one = report.get("solver_error")
    if one is None or one["mesh"] is None:
        return [] if one is None else [f"error bar of the mesh: not known; {one['mesh_basis']}"]
    parts = {"error bar of the mesh at full range": one["mesh"]}
    if "rounded" in one:
        parts["of that by straight edges"] = one["rounded"]["mesh"]
    lines = []
    for words, matrix in parts.items():
        for name, own in _by_interface(report, (np.array(matrix) @ one["loads"]).tolist()):
            bar = [f"{x:.2g}" for x in own]
            where = f", {name}" if name else ""
            lines.append(f"{words}{where}: ({', '.join(bar[:3])}) m, ({', '.join(bar[3:])}) rad")
    return [*lines, f"error bar of the mesh from {one['mesh_basis']}"]


def _vibration(report: Mapping[str, Any]) -> list[str]:
    if not report.get("vibration"):
        return []
    one = report["vibration"]
    carried = f"with {one['riding_mass']:g} kg on it" if one["riding_mass"] else "by itself"
    weight = "not known" if one["mass"] is None else f"{one['mass']:.4g} kg"
    moves = "; ".join(
        f"{name or 'interface'} moves along {_place(own[:3])}, turns about {_place(own[3:])}"
        for name, own in _by_interface(report, one["motion"])
    )
    return [
        f"mass {weight}; first natural frequency {one['first_frequency']:.4g} Hz {carried} "
        f"({moves})"
    ]


def _strength(report: Mapping[str, Any]) -> list[str]:
    lines = []
    for one in report.get("strength", []):
        used = one["yield_strength"] and one["largest"] / one["yield_strength"]
        ends = "" if used is None else f", {100 * used:.3g} % of its yield strength"
        order = " to first order (--nonlinear solves)" if one["first_order"] else ""
        lines.append(
            f"largest von Mises stress of {one['region']} under the full range{order}: "
            f"{one['largest'] / 1e6:.4g} MPa{ends}, near {_place(one['at'])} m under "
            + "; ".join(
                f"{name and name + ' '}force {_place(own[:3])} N, moment {_place(own[3:])} N·m"
                for name, own in _by_interface(report, one["wrench"])
            )
            + (f" at {one['temperature']:g}" if "temperature" in one else "")
            + (f", acceleration {_place([one[a] for a in ACCELERATIONS])}" if "ax" in one else "")
        )
    return lines


def _estimate(report: Mapping[str, Any]) -> list[str]:
    if "estimate" not in report:
        return []
    one = report["estimate"]
    return [
        f"one solve: about {_time(one['linear_seconds'])} linear, "
        f"{_time(one['nonlinear_seconds'])} nonlinear, {_size(one['memory_bytes'])} of memory "
        f"({one['basis']})"
    ]


def _complaints(kind: str, entries: list[Mapping[str, str]]) -> list[str]:
    return [f"{kind}: {entry['where']}: {entry['message']}" for entry in entries]


def _place(place: Any) -> str:
    """Write a place or direction; what is 12 digits below the rest is roundoff."""
    least = 1e-12 * max(1.0, *map(abs, place))
    return "(" + ", ".join(f"{x if abs(x) > least else 0.0:.5g}" for x in place) + ")"


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.2g} min" if seconds < 7200 else f"{seconds / 3600:.2g} h"


def _size(count: float) -> str:
    return f"{count / 1e9:.2g} GB" if count >= 1e9 else f"{count / 1e6:.3g} MB"
