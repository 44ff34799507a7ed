"""A proposed component of an input deck: ``wrenchbook new``.

What a deck has is taken over; what it has not is written with a mark, and said.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.bundle.read import FILE_NAME
from wrenchbook.fea.check.reporting import report
from wrenchbook.fea.inspection import stacked_singly
from wrenchbook.fea.mesh.deck_content import (
    Constant,
    CoupledGroup,
    DeckContent,
    LoadCase,
    SolidSection,
    in_si,
)
from wrenchbook.fea.mesh.element_order import SECOND, second_order
from wrenchbook.fea.mesh.io.ansys import read_ansys
from wrenchbook.fea.mesh.io.nastran import read_nastran
from wrenchbook.fea.mesh.io.raw import Translated
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.deck_text import DeckText, deck_text
from wrenchbook.fea.spec.mesh_source import UNITS
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, MeshFileError
from wrenchbook.fea.spec.schema import FREEDOMS, Tie

_TRANSLATORS: dict[str, Callable[[DeckText], Translated]] = {
    ".cdb": read_ansys,
    **dict.fromkeys((".bdf", ".nas", ".dat"), read_nastran),
}
_INCLUDE = re.compile(r"^[ \t]*(/INPUT,|\*USE,)[^!\n]*", re.I | re.M)
_FACES = "`wrenchbook check FOLDER --faces` lists its faces, with lines for [mesh.groups]"
_CHOOSE = "CHOOSE"  # a group that no mesh has: `check` then lists those there are
_UNITS = ((1e8, "m"), (2e6, "in"), (-1.0, "mm"))
"""Young's moduli above which a deck's unit is likely: few in Pa are below 1e8, none in MPa is above
2e6 (diamond 1.2e6), and metals in psi are between (magnesium 6.5e6, aluminium 1e7, steel 3e7)."""
_IN_KILOGRAMS = 25.0  # kg/m³, foams too; t/mm³ and pounds of any kind an inch³ are below 1
_IN_SLINCHES = (3e-5, 9e-4)  # lbf·s²/in⁴, plastics 1e-4, steel 7e-4; g/mm³ are above, kg/mm³ below
_MAX_CASES = 12  # in one line of `decide`
_ELASTIC = ("youngs_modulus", "poisson_ratio")
_FORCE, _LEVER = 100.0, 0.1  # N and m, where the deck has no load


class _Proposal:
    """The lines of a component, and what is open: `decide` and `skipped`, as text."""

    def __init__(self, mesh: Mesh, unit: str, case: str | None) -> None:
        self.mesh, self.unit = mesh, unit
        self.deck = mesh.deck or DeckContent()
        self.groups = {*mesh.facet_groups, *mesh.node_groups}
        self.decide: list[str] = []
        self.skipped: list[str] = []
        self.case = self.chosen(case)

    def chosen(self, name: str | None) -> LoadCase:
        """Return the case of a name, else the last; where cases differ, `decide` lists them."""
        cases = {case.name.upper(): case for case in self.deck.cases}
        if name is not None and name.upper() not in cases:
            names = ", ".join(f'"{case.name}"' for case in cases.values() if case.name)
            there = f"name one of {names}" if names else "it has no steps, so leave --case out"
            raise BundleError([BundleProblem("case", f'the deck has no "{name}"; {there}')])
        case = cases[name.upper()] if name is not None else self.deck.cases[-1]
        alike: dict[str, list[str]] = {}
        for other in self.deck.cases:
            alike.setdefault(other.summary(), []).append(f'"{other.name}"')
        if len(alike) > 1 and name is None:
            parts = [f"{', '.join(names)} {summary}" for summary, names in alike.items()]
            more = [f"{len(parts) - _MAX_CASES} more"] if len(parts) > _MAX_CASES else []
            self.decide.append(
                f'case: the deck has several; "{case.name}" is taken (or write --case NAME). '
                + ". ".join(parts[:_MAX_CASES] + more)
            )
        return case

    def lines(self, name: str, file: str) -> list[str]:
        """Return the lines of ``component.toml``."""
        if not self.groups:
            self.decide.append(f"groups: the mesh has none, so define them: {_FACES}")
        first = sorted({kind for kind in self.mesh.cell_counts if kind in SECOND})
        if first:
            self.decide.append(f"{', '.join(first)} cells get midside nodes (order = 2)")
        return [
            f"name = {_text(name)}",
            f"title = {_text(name)}",
            "",
            "[mesh]",
            f"file = {_text(file)}",
            f"unit = {_text(self.unit)}",
            *(["order = 2"] if first else []),
            *self.materials(),
            *self.supports(),
            *self.interfaces(),
            *(line for _, tie in self.deck.ties for line in self.tie(tie)),
            *self.springs(2),
            "",
            "[analysis]",
            *self.integration(bool(first)),
            f"nonlinear = {'true' if self.case.nonlinear else 'false'}",
        ]

    def integration(self, first: bool) -> list[str]:
        """Return full integration for cells that follow each other singly, else nothing."""
        is_full = any(re.match("C3D20(?!R)", kind) for kind in self.deck.elements)
        if is_full or not len(stacked_singly(second_order(self.mesh) if first else self.mesh)):
            return []
        why = "cells follow each other singly; by reduced integration they have hourglass motions"
        self.decide.append(f'integration = "full": {why}')
        return ['integration = "full"']

    def materials(self) -> list[str]:
        sections = [
            section for section in self.deck.sections if section.region in self.mesh.regions
        ]
        kinds = {(section.material, self.directions(section)) for section in sections}
        one_material = len(kinds) == 1 and self.filled(sections)
        by_region = {"all" if one_material else section.region: section for section in sections}
        lines = []
        for region, section in (by_region or {"all": SolidSection("", "all", "")}).items():
            constants = self.deck.materials.get(section.material, {})
            each = ((key, _numbers(constants[key], in_si(key, self.unit))) for key in constants)
            values = [*(f"{key} = {value}" for key, value in each), *self.directions(section)]
            lacking = [key for key in _ELASTIC if key not in constants]
            if lacking:
                known, name = ", ".join(self.deck.materials) or "none", section.material
                lost = f'the deck has no *MATERIAL "{name}" (it has {known}); '
                lost *= bool(name) and name not in self.deck.materials
                write = f"write its {' and '.join(lacking)}"
                self.decide.append(f'material of "{region}": {lost}{write}')
            lines += ["", "[[material]]", f"region = {_text(region)}", *values]
        return lines

    def directions(self, section: SolidSection) -> tuple[str, ...]:
        """Return the law and the axes of an orthotropic material."""
        constants = self.deck.materials.get(section.material, {})
        if not isinstance(constants.get("youngs_modulus"), tuple):
            return ()
        axes = section.orientation
        if len(axes) != 6:
            return ('law = "orthotropic"', *_axes(axes))
        point, axis = _numbers(axes[:3], UNITS[self.unit], 15), _numbers(axes[3:], digits=15)
        return 'law = "orthotropic"', f"cylinder = {{point = {point}, axis = {axis}}}"

    def filled(self, sections: list[SolidSection]) -> bool:
        """Return whether each cell is in a section."""
        by_block = zip(*(self.mesh.regions[section.region] for section in sections), strict=True)
        pairs = zip(by_block, self.mesh.blocks, strict=True)
        return all(np.unique(np.concatenate(cells)).size == len(block) for cells, block in pairs)

    def supports(self) -> list[str]:
        held = [support for support in self.case.supports if support.group in self.groups]
        fixed = [slide.group for slide in held if slide.directions == "xyz"]
        sliding = [slide for slide in held if slide.directions != "xyz"]
        bushings = self.springs(1)
        if not held and not bushings:
            self.decide.append("supports: the deck fixes no node; name the groups to fix")
            fixed = [_CHOOSE]
        names = ", ".join(map(_text, dict.fromkeys(fixed)))
        lines = ["", "[supports]", *([f"fixed = [{names}]"] if fixed else [])]
        for support in sliding:
            ways = ", ".join(_text(way) for way in support.directions)
            lines += [
                "[[supports.sliding]]",
                f"group = {_text(support.group)}",
                f"directions = [{ways}]",
            ]
            lines += _axes(support.axes)
        return [*lines, *bushings]

    def springs(self, ends: int) -> list[str]:
        """Return the bushings, of one end each, or the springs between groups, of two."""
        lines = []
        for spring in (spring for spring in self.case.springs if len(spring.ends) == ends):
            groups = ", ".join(_text(end.group) for end in spring.ends)
            table = ["", "[[spring]]", f"groups = [{groups}]"]
            if ends == 1:
                table = ["[[supports.bushing]]", f"group = {groups}"]
            matrix = spring.in_si(self.unit)
            rows = [_numbers(tuple(row), digits=15) for row in matrix.tolist()]
            values = f"[{', '.join(rows)}]"
            if not (matrix - np.diag(np.diagonal(matrix))).any():
                values = _numbers(tuple(np.diagonal(matrix).tolist()), digits=15)
            lines += [*table, *self.attached(spring.ends[0]), f"stiffness = {values}"]
        return lines

    def interfaces(self) -> list[str]:
        """Return each coupling that is free, else the group with forces, as an interface."""
        groups = [coupled for coupled in self.case.couplings if coupled.group in self.groups]
        sections = {coupled.group for coupled in groups} or set(list(self.case.loads)[:1])
        self.skipped += [
            f'forces on "{group}", which is not an interface'
            for group, loads in self.case.loads.items()
            if any(loads) and group not in sections
        ]
        if not groups:
            group, loads = next(iter(self.case.loads.items()), (_CHOOSE, [0.0] * 6))
            group = group if group in self.groups else _CHOOSE
            self.decide.append(f"interface: no coupling is free; check section = {group}")
            groups = [CoupledGroup("", group, "distributed", (), set(), loads)]
        if len(groups) == 1:
            return [
                "",
                "[interface]",
                *self.interface(groups[0]),
                "",
                "[range]",
                *self.range(groups[0]),
            ]
        lines = []
        for coupled in groups:
            lines += ["", "[[interface]]", f"name = {_text(_name(coupled.group))}"]
            lines += [*self.interface(coupled), "[interface.range]", *self.range(coupled)]
        return lines

    def tie(self, tie: Tie) -> list[str]:
        near = f"distance = {(tie.distance or 0.0) * UNITS[self.unit]:.9g}"
        sides = f"secondary = {_text(tie.secondary)}", f"main = {_text(tie.main)}"
        return ["", "[[tie]]", *sides, *([near] if tie.distance else [])]

    def interface(self, group: CoupledGroup) -> list[str]:
        locked = ", ".join(_text(FREEDOMS[i]) for i in sorted(group.held))
        locks = [f"locked = [{locked}]"] if locked else []
        return [f"section = {_text(group.group)}", *self.attached(group), *locks]

    def attached(self, group: CoupledGroup) -> list[str]:
        return [
            *([f"point = {_numbers(group.point, UNITS[self.unit], 15)}"] if group.point else []),
            f"coupling = {_text(group.kind)}",
            *(['weights = "deck"'] if group.weighted else []),
        ]

    def range(self, group: CoupledGroup) -> list[str]:
        """Return plus and minus the largest force and moment, or those of a lever."""
        force = max(map(abs, group.loads[:3])) * in_si("force", self.unit)
        moment = max(map(abs, group.loads[3:])) * in_si("moment", self.unit)
        complete = force and moment
        force = force or moment / _LEVER or _FORCE
        moment = moment or force * _LEVER
        if not complete:
            why = f"the deck lacks a force or a moment; check {force:.4g} N and {moment:.4g} N·m"
            self.decide.append(f'range at "{group.group}": {why}')
        return [
            f"{k} = [{v:.4g}, {v:.4g}, {v:.4g}]" for k, v in (("force", force), ("moment", moment))
        ]


def propose(
    file: Path, folder: Path, unit: str | None = None, case: str | None = None
) -> dict[str, Any]:
    """Write a component's folder from a deck.

    file: Abaqus or CalculiX (.inp), Nastran (.bdf, .nas, .dat) or Ansys (.cdb).
    folder: a folder to write, without a ``component.toml``.
    unit: the deck's length unit, a key of `fea.spec.mesh_source.UNITS`; None guesses mm, in or m by
    the elastic constants and densities.
    case: the step, load case or subcase whose supports and loads are taken over; None for the last.
    Returns ``files`` written, ``left``: what is not taken over, ``decide``: what the deck does not
    give, and ``check``: the report on the proposal.
    Raises BundleError if the deck cannot be read or lacks the case, or the folder has a component
    or another deck of this name.
    """
    if (folder / FILE_NAME).exists():
        raise BundleError([BundleProblem(str(folder), f"has a {FILE_NAME}; name a new folder")])
    text, skipped, decide = _deck_text(file)
    deck = folder / f"{file.stem}.inp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if deck.exists() and deck.read_bytes() != text.encode():  # a second try writes the same
            message = f"has another {deck.name}, which is left as it is; name a new folder"
            raise BundleError([BundleProblem(str(folder), message)])
        deck.write_text(text, encoding="utf-8")
    except OSError as error:
        message = f"cannot be written ({error.strerror}); name a new folder"
        raise BundleError([BundleProblem(str(folder), message)]) from None
    proposal = _Proposal(read_mesh(deck, unit or "m"), unit or "m", case)
    proposal.decide += decide
    if unit is None:
        materials = proposal.deck.materials.values()
        largest, density = (
            max([0.0, *(np.max(material.get(key, 0.0)) for material in materials)])
            for key in ("youngs_modulus", "density")
        )
        unit = next(unit for least, unit in _UNITS if largest > least)
        if density > _IN_KILOGRAMS:
            unit = "m"
        elif _IN_SLINCHES[0] < density < _IN_SLINCHES[1]:
            unit = "in"
        why = (
            f"; {unit} by its constants" if largest or density else f" and has no constants; {unit}"
        )
        pounds = ", with pounds and psi" * (unit == "in")
        proposal.decide.append(f"unit: a deck names none{why}{pounds} (--unit)")
        proposal.unit = unit
    lines = proposal.lines(_name(file.stem), deck.name)
    at = f"{deck.name}, " * (deck.name != file.name)  # whose lines these are
    skipped += [*proposal.skipped, *(f"{at}{note}" for note in proposal.deck.notes)]
    notes = [f"# DECIDE: {note}" for note in proposal.decide]
    notes += [f"# not taken over: {note}" for note in skipped]
    (folder / FILE_NAME).write_text("\n".join([*lines, "", *notes, ""]), encoding="utf-8")
    files = [str(folder / FILE_NAME), str(deck)]
    return {"files": files, "left": skipped, "decide": proposal.decide, "check": report(folder)}


def _deck_text(file: Path) -> tuple[str, list[str], list[str]]:
    """Return an Abaqus deck, the file's contents that it lacks, and values the file leaves open."""
    try:
        text = deck_text(file)
        if (translate := _TRANSLATORS.get(file.suffix.lower())) is not None:
            if include := _INCLUDE.search(text):
                where = f"line {text.count(chr(10), 0, include.start()) + 1}: {include[0].strip()}"
                raise MeshFileError(f"{where} is not read; insert that file's lines in its place")
            translated = translate(text)
            skipped = [f"{name} ({count})" for name, count in translated.skipped.items() if count]
            return "\n".join(translated.lines()), skipped, translated.decide
        if file.suffix.lower() != ".inp":
            raise MeshFileError(
                f"is not an .inp, {', '.join(_TRANSLATORS)}; write [mesh] by hand: {_FACES}"
            )
        return text, [], []
    except OSError as error:
        message = f"cannot be read ({error.strerror}); name an input deck"
        raise BundleError([BundleProblem(str(file), message)]) from None
    except MeshFileError as error:
        raise BundleError([BundleProblem(file.name, str(error))]) from None


def _numbers(value: Constant, factor: float = 1.0, digits: int = 9) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_numbers(each, factor, digits) for each in value)}]"
    return f"{value * factor + 0.0:.{digits}g}"


def _axes(axes: tuple[float, ...]) -> list[str]:
    rows = ", ".join(_numbers(axes[i : i + 3], digits=15) for i in range(0, len(axes), 3))
    return [f"axes = [{rows}]"] if axes else []


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def _name(text: str) -> str:
    return re.sub(r"[^a-z0-9_-]+", "_", text.lower()).strip("_-")[:64] or "part"
