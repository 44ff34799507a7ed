"""A proposed component of an input deck: ``wrenchbook new``.

The deck's materials, supports, couplings and loads become lines of ``component.toml``. Missing
values get a starting value, and a comment ``# DECIDE``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from wrenchbook.fea.bundle.read import FILE_NAME
from wrenchbook.fea.check.reporting import report
from wrenchbook.fea.mesh.bodies import stacked_singly
from wrenchbook.fea.mesh.deck_content import (
    Constant,
    CoupledGroup,
    DeckContent,
    LoadCase,
    SolidSection,
    si_factor,
)
from wrenchbook.fea.mesh.element_order import SECOND, second_order
from wrenchbook.fea.mesh.groups import CHOOSE
from wrenchbook.fea.mesh.io.ansys import read_ansys
from wrenchbook.fea.mesh.io.nastran import read_nastran
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.io.translated import Translated
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
_UNIT_BY_MODULUS = ((1e8, "m"), (2e6, "in"), (-1.0, "mm"))
"""Young's moduli from which a deck's unit is likely: few in Pa are below 1e8, none in MPa is above
2e6 (diamond 1.2e6), and metals in psi are between (magnesium 6.5e6, aluminium 1e7, steel 3e7)."""
# Least density in kg/m³, that of foams; t/mm³ and pounds of any kind an inch³ are below 1.
_IN_KILOGRAMS = 25.0
# Densities in lbf·s²/in⁴: plastics 1e-4, steel 7e-4; g/mm³ are above, kg/mm³ below.
_IN_SLINCHES = (3e-5, 9e-4)
_MAX_CASES = 12  # load cases in one line of `decide`: more would be unreadable
_ELASTIC = ("youngs_modulus", "poisson_ratio")
_FORCE, _LEVER = 100.0, 0.1  # N and m: starting values if the deck has no load
_EXACT = 15  # digits of points, axes and stiffnesses: as many as a double has in any case


class _Proposal:
    """The lines of a component, and its open values.

    mesh, deck, unit: the deck's mesh, its other contents, and its length unit.
    groups: names of facet and node groups of the mesh. case: the proposed load case.
    decide: values that the deck lacks. skipped: contents that the proposal leaves out.
    """

    def __init__(self, mesh: Mesh, unit: str, case: str | None) -> None:
        self.mesh = mesh
        self.unit = unit
        self.deck = mesh.deck or DeckContent()
        self.groups = {*mesh.facet_groups, *mesh.node_groups}
        self.decide: list[str] = []
        self.skipped: list[str] = []
        self.case = self.choose_case(case)

    def choose_case(self, name: str | None) -> LoadCase:
        """Return the case of a name, else the last; where cases differ, `decide` lists them.

        Raises BundleError if the deck has no case of this name.
        """
        if name is not None:
            cases = {case.name.upper(): case for case in self.deck.cases}
            if name.upper() in cases:
                return cases[name.upper()]
            names = ", ".join(f'"{case.name}"' for case in cases.values() if case.name)
            there = f"name one of {names}" if names else "it has no steps, so leave --case out"
            raise BundleError([BundleProblem("case", f'the deck has no case "{name}"; {there}')])
        case = self.deck.cases[-1]
        alike: dict[str, list[LoadCase]] = {}
        for other in self.deck.cases:
            alike.setdefault(other.conditions(), []).append(other)
        if len(alike) > 1:
            parts = [
                f"{', '.join(_text(each.name) for each in cases)} {cases[0].summary()}"
                for cases in alike.values()
            ]
            if (more := len(parts) - _MAX_CASES) > 0:
                parts[_MAX_CASES:] = [f"{more} more"]
            self.decide.append(
                f'case: the deck has several; "{case.name}" is taken (or write --case NAME). '
                + ". ".join(parts)
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
        """Return full integration for cells of both kinds or stacked singly, else nothing.

        first: whether cells are of first order, and so get midside nodes.
        """
        of_deck = {"R" in kind for kind in self.deck.elements if kind.startswith("C3D20")}
        mesh = second_order(self.mesh) if first else self.mesh
        if len(of_deck) > 1:
            why = "C3D20 is full in the deck, C3D20R reduced; here both are full, or both reduced"
        elif False not in of_deck and len(stacked_singly(mesh)):
            why = "cells follow each other singly; reduced integration allows hourglass motions"
        else:
            return []
        self.decide.append(f'integration = "full": {why}')
        return ['integration = "full"']

    def materials(self) -> list[str]:
        """Return a material for each section, or a single one for "all" if it fills the mesh."""
        sections = [
            section for section in self.deck.sections if section.region in self.mesh.regions
        ]
        kinds = {(section.material, self.directions(section)) for section in sections}
        by_region = {section.region: section for section in sections}
        if not sections:
            by_region = {"all": SolidSection("", "all", "")}
        elif len(kinds) == 1 and self.cover_mesh(sections):
            by_region = {"all": sections[-1]}
        lines = []
        for region, section in by_region.items():
            name = section.material
            constants = self.deck.materials.get(name, {})
            lines += ["", "[[material]]", f"region = {_text(region)}"]
            for key, value in constants.items():
                lines.append(f"{key} = {_numbers(value, si_factor(key, self.unit))}")
            if "thermal_expansion" in constants and self.unit in ("in", "ft"):
                self.decide.append(
                    f"thermal_expansion of {name or region} is taken per K; if the deck's is per "
                    "degree Fahrenheit, multiply it by 1.8"
                )
            lines += self.directions(section)
            lacking = [key for key in _ELASTIC if key not in constants]
            if lacking:
                lost = ""
                if name and name not in self.deck.materials:
                    known = ", ".join(self.deck.materials) or "none"
                    lost = f'the deck has no *ELASTIC of *MATERIAL "{name}" (it has {known}); '
                write = f"write its {' and '.join(lacking)}"
                self.decide.append(f'material of "{region}": {lost}{write}')
        return lines

    def directions(self, section: SolidSection) -> tuple[str, ...]:
        """Return the law and the axes of an orthotropic material."""
        constants = self.deck.materials.get(section.material, {})
        if not isinstance(constants.get("youngs_modulus"), tuple):
            return ()
        axes = section.orientation
        if len(axes) != 6:
            return ('law = "orthotropic"', *_axes(axes))
        point = _numbers(axes[:3], UNITS[self.unit], _EXACT)
        axis = _numbers(axes[3:], digits=_EXACT)
        return 'law = "orthotropic"', f"cylinder = {{point = {point}, axis = {axis}}}"

    def cover_mesh(self, sections: list[SolidSection]) -> bool:
        """Return whether each cell is in a section."""
        for number, block in enumerate(self.mesh.blocks):
            cells = [self.mesh.regions[section.region][number] for section in sections]
            if np.unique(np.concatenate(cells)).size < len(block):
                return False
        return True

    def supports(self) -> list[str]:
        """Return the groups that the case fixes, lets slide, or holds by springs."""
        held = [support for support in self.case.supports if support.group in self.groups]
        fixed = [support.group for support in held if support.directions == "xyz"]
        bushings = self.springs(1)
        if not held and not bushings:
            self.decide.append("supports: the deck fixes no node; name the groups to fix")
            fixed = [CHOOSE]
        lines = ["", "[supports]"]
        if fixed:
            names = ", ".join(map(_text, dict.fromkeys(fixed)))
            lines.append(f"fixed = [{names}]")
        for support in held:
            if support.directions != "xyz":
                directions = ", ".join(map(_text, support.directions))
                lines += ["[[supports.sliding]]", f"group = {_text(support.group)}"]
                lines += [f"directions = [{directions}]", *_axes(support.axes)]
        return lines + bushings

    def springs(self, ends: int) -> list[str]:
        """Return the bushings, of one end each, or the springs between groups, of two."""
        lines = []
        for spring in self.case.springs:
            if len(spring.ends) != ends:
                continue
            groups = ", ".join(_text(end.group) for end in spring.ends)
            if ends == 1:
                lines += ["[[supports.bushing]]", f"group = {groups}"]
            else:
                lines += ["", "[[spring]]", f"groups = [{groups}]"]
            matrix = spring.stiffness_in_si(self.unit)
            diagonal = np.diagonal(matrix)
            if (matrix == np.diag(diagonal)).all():
                values = _numbers(tuple(diagonal.tolist()), digits=_EXACT)
            else:
                rows = [_numbers(tuple(row), digits=_EXACT) for row in matrix.tolist()]
                values = f"[{', '.join(rows)}]"
            lines += [*self.coupling(spring.ends[0]), f"stiffness = {values}"]
        return lines

    def interfaces(self) -> list[str]:
        """Return each free coupling as an interface, else the group with forces."""
        groups = [coupled for coupled in self.case.couplings if coupled.group in self.groups]
        sections = {coupled.group for coupled in groups}
        if not groups:
            group, loads = next(iter(self.case.loads.items()), (CHOOSE, [0.0] * 6))
            sections = {group}
            if group not in self.groups:
                group = CHOOSE
            self.decide.append(f"interface: no coupling is free; check section = {group}")
            groups = [CoupledGroup("", group, "distributed", (), set(), loads)]
        self.skipped += [
            f'forces on "{group}", which is not an interface'
            for group, loads in self.case.loads.items()
            if any(loads) and group not in sections
        ]
        if len(groups) == 1:
            interface, load_range = self.interface(groups[0]), self.range(groups[0])
            return ["", "[interface]", *interface, "", "[range]", *load_range]
        lines = []
        for coupled in groups:
            lines += ["", "[[interface]]", f"name = {_text(_name(coupled.group))}"]
            lines += [*self.interface(coupled), "[interface.range]", *self.range(coupled)]
        return lines

    def tie(self, tie: Tie) -> list[str]:
        """Return the lines of a tie, its distance in m."""
        lines = ["", "[[tie]]", f"secondary = {_text(tie.secondary)}", f"main = {_text(tie.main)}"]
        if tie.distance:
            lines.append(f"distance = {tie.distance * UNITS[self.unit]:.9g}")
        return lines

    def interface(self, group: CoupledGroup) -> list[str]:
        """Return section, point, coupling and locked freedoms of an interface."""
        lines = [f"section = {_text(group.group)}", *self.coupling(group)]
        if group.held:
            locked = ", ".join(_text(FREEDOMS[i]) for i in sorted(group.held))
            lines.append(f"locked = [{locked}]")
        return lines

    def coupling(self, group: CoupledGroup) -> list[str]:
        """Return point, coupling and weights of an interface or of a spring's end."""
        lines = [f"coupling = {_text(group.kind)}"]
        if group.point:
            lines.insert(0, f"point = {_numbers(group.point, UNITS[self.unit], _EXACT)}")
        if group.weighted:
            lines.append('weights = "deck"')
        return lines

    def range(self, group: CoupledGroup) -> list[str]:
        """Return plus and minus the largest force and moment; a zero one follows from `_LEVER`."""
        force = max(map(abs, group.loads[:3])) * si_factor("force", self.unit)
        moment = max(map(abs, group.loads[3:])) * si_factor("moment", self.unit)
        is_complete = force and moment
        if not force:
            force = moment / _LEVER if moment else _FORCE
        if not moment:
            moment = force * _LEVER
        if not is_complete:
            why = f"the deck lacks a force or a moment; check {force:.4g} N and {moment:.4g} N·m"
            self.decide.append(f'range at "{group.group}": {why}')
        return [
            f"force = [{force:.4g}, {force:.4g}, {force:.4g}]",
            f"moment = [{moment:.4g}, {moment:.4g}, {moment:.4g}]",
        ]


def propose(
    file: Path, folder: Path, unit: str | None = None, case: str | None = None
) -> dict[str, Any]:
    """Write a component's folder from a deck.

    file: Abaqus or CalculiX (.inp), Nastran (.bdf, .nas, .dat) or Ansys (.cdb).
    folder: a folder to write, without a ``component.toml``.
    unit: the deck's length unit, a key of `fea.spec.mesh_source.UNITS`; None guesses mm, in or m by
    the elastic constants and densities.
    case: the step, load case or subcase with the supports and loads to use; None for the last.
    Returns ``files`` written, ``left``: contents that are left out, ``decide``: values that the
    deck lacks, and ``check``: the report on the proposal.

    Raises BundleError if the deck cannot be read or lacks the case, or the folder has a component
    or another deck of this name.
    """
    if (folder / FILE_NAME).exists():
        raise BundleError(
            [BundleProblem(str(folder), f"has a {FILE_NAME} already; name a new folder")]
        )
    text, skipped, decide = _deck_text(file)
    deck = folder / f"{file.stem}.inp"
    with TemporaryDirectory() as scratch:  # a deck that cannot be used leaves no folder
        copy = Path(scratch) / deck.name
        copy.write_text(text, encoding="utf-8")
        proposal = _Proposal(read_mesh(copy, unit or "m"), unit or "m", case)
    proposal.decide += decide
    if unit is None:
        proposal.unit, why = _guessed_unit(proposal.deck)
        proposal.decide.append(why)
    lines = proposal.lines(_name(file.stem), deck.name)

    # Notes name lines of the deck that is written, which may differ from the file.
    prefix = "" if deck.name == file.name else f"{deck.name}, "
    skipped += [*proposal.skipped, *(f"{prefix}{note}" for note in proposal.deck.notes)]
    notes = [f"# DECIDE: {note}" for note in proposal.decide]
    notes += [f"# not taken over: {note}" for note in skipped]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if deck.exists() and deck.read_bytes() != text.encode():  # a second run writes the same
            message = f"has another {deck.name}, which is left as it is; name a new folder"
            raise BundleError([BundleProblem(str(folder), message)])
        deck.write_text(text, encoding="utf-8")
        (folder / FILE_NAME).write_text("\n".join([*lines, "", *notes, ""]), encoding="utf-8")
    except OSError as error:
        message = f"cannot be written ({error.strerror}); name a new folder"
        raise BundleError([BundleProblem(str(folder), message)]) from None
    files = [str(folder / FILE_NAME), str(deck)]
    return {"files": files, "left": skipped, "decide": proposal.decide, "check": report(folder)}


def _guessed_unit(deck: DeckContent) -> tuple[str, str]:
    """Return the probable length unit of a deck, by its moduli and densities, and the reason."""

    def largest(key: str) -> float:
        values = [np.max(material.get(key, 0.0)) for material in deck.materials.values()]
        return max([0.0, *values])

    modulus, density = largest("youngs_modulus"), largest("density")
    unit = next(unit for least, unit in _UNIT_BY_MODULUS if modulus > least)
    if density > _IN_KILOGRAMS:
        unit = "m"
    elif _IN_SLINCHES[0] < density < _IN_SLINCHES[1]:
        unit = "in"
    by = "by its constants" if modulus or density else "is assumed"
    pounds = ", with pounds and psi" if unit == "in" else ""
    return unit, f"unit: the deck names no unit; {unit} {by}{pounds}. Change it with --unit"


def _deck_text(file: Path) -> tuple[str, list[str], list[str]]:
    """Return an Abaqus deck, the file's contents that it lacks, and values that are undecided.

    Raises BundleError if the file cannot be read.
    """
    try:
        text = deck_text(file)
        if (translate := _TRANSLATORS.get(file.suffix.lower())) is not None:
            if include := _INCLUDE.search(text):
                line = text[: include.start()].count("\n") + 1
                message = "is not read; insert that file's lines in its place"
                raise MeshFileError(f"line {line}: {include[0].strip()} {message}")
            translated = translate(text)
            skipped = [f"{name} ({count})" for name, count in translated.skipped.items() if count]
            if not translated.elements:
                there = f" (not taken over: {', '.join(skipped[:_MAX_CASES])})" if skipped else ""
                raise MeshFileError(
                    f"has no solid elements{there}; export the volume mesh, or "
                    "rename the file: .inp is Abaqus and CalculiX, .bdf Nastran, .cdb Ansys"
                )
            return "\n".join(translated.lines()), skipped, translated.decide
        if file.suffix.lower() != ".inp":
            endings = ", ".join(_TRANSLATORS)
            raise MeshFileError(
                f"has the ending {file.suffix!r}, but a deck ends in .inp, {endings}; rename the "
                f"file, or write [mesh] of another mesh by hand: {_FACES}"
            )
        return text, [], []
    except OSError as error:
        message = f"cannot be read ({error.strerror}); name an input deck"
        raise BundleError([BundleProblem(str(file), message)]) from None
    except MeshFileError as error:
        raise BundleError([BundleProblem(file.name, str(error))]) from None


def _numbers(value: Constant, factor: float = 1.0, digits: int = 9) -> str:
    """Write a number or an array times a factor as TOML; + 0.0 makes -0.0 a plain 0."""
    if isinstance(value, tuple):
        return f"[{', '.join(_numbers(each, factor, digits) for each in value)}]"
    return f"{value * factor + 0.0:.{digits}g}"


def _axes(axes: tuple[float, ...]) -> list[str]:
    """Return the line of nine numbers, directions in rows; none for the global axes."""
    if not axes:
        return []
    rows = ", ".join(_numbers(axes[i : i + 3], digits=_EXACT) for i in range(0, len(axes), 3))
    return [f"axes = [{rows}]"]


def _text(value: str) -> str:
    """Write a string as TOML."""
    return json.dumps(value, ensure_ascii=False)


def _name(text: str) -> str:
    """Return a name of a component or an interface from any text."""
    return re.sub(r"[^a-z0-9_-]+", "_", text.lower()).strip("_-")[:64] or "part"
