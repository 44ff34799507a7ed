"""Differences between a component and the input deck of its mesh."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.deck_content import (
    CoupledGroup,
    DeckContent,
    DeckSpring,
    HeldGroup,
    SolidSection,
    si_factor,
)
from wrenchbook.fea.mesh.groups import group_nodes
from wrenchbook.fea.spec.material import Cylinder, Orthotropic
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import FREEDOMS

_SAME_VALUE = 1e-3  # relative: decks write constants with three digits and more
# Part of the nodes whose directions may differ: on a cylinder's axis all are right.
_MAX_TURNED = 0.5
_ROUNDOFF = 1e-6  # part of the mesh's size, or of a direction: decks write seven digits
_SOLID = re.compile(r"(C3D\d+)([A-Z]*)")
_COMPARED = (
    "shear_modulus",
    "youngs_modulus",
    "poisson_ratio",
    "density",
    "thermal_expansion",
    "yield_strength",
)


def listing(deck: DeckContent) -> dict[str, Any]:
    """Return the lines of each keyword that is read or compared, and ignored, and the elements.

    Result: ``read`` and ``ignored``: line numbers by keyword. ``elements``: by type, their number
    and the element solved in their place, if it differs.
    """
    elements = {name: {"count": n, "instead": _instead(name)} for name, n in deck.elements.items()}
    read, ignored = (
        # The lines of all instances of a part.
        {word: sorted(set(lines)) for word, lines in lines_of.items()}
        for lines_of in (deck.taken, deck.ignored)
    )
    return {"read": read, "ignored": ignored, "elements": elements}


def _instead(name: str) -> str:
    """Return the element that is solved in place of a deck's; empty if it is the same."""
    solid = _SOLID.fullmatch(name)
    if solid is None:
        return ""
    if solid[1] in ("C3D4", "C3D6", "C3D8"):
        return "solved with midside nodes (order = 2), else refused"
    letters = solid[2].replace("R", "")
    if letters != "H":
        return f"solved as {solid[1]}" if letters else ""
    projected = "their volumetric strain projected above a Poisson's ratio of 0.4"
    locks = "refused where they would lock"
    return f"displacements alone, {projected if solid[1] == 'C3D20' else locks}"


def contradictions(component: ComponentModel) -> list[BundleProblem]:
    """Return contradictions of a component to its deck, and contents of the deck that it lacks."""
    deck = component.mesh.deck
    if deck is None:
        return []
    messages = deck.notes
    unit = component.bundle.mesh.unit if component.bundle.mesh else "m"
    integration = component.analysis.integration
    messages += [
        f'has {name}; [analysis] says integration = "{integration}" for it'
        for name in deck.elements
        if name.startswith("C3D20") and ("R" in name) != (integration == "reduced")
    ]
    messages += [
        text
        for section in deck.sections
        for text in _other_material(component, deck, section, unit)
    ]
    written = {(tie.secondary, tie.main) for tie in component.bundle.ties}
    messages += [
        f'{where} ties "{tie.secondary}" to "{tie.main}"; these are loose here: write [[tie]]'
        for where, tie in deck.ties
        if (tie.secondary, tie.main) not in written
    ]
    cases = [
        [text for support in case.supports for text in _other_support(component, support)]
        + [text for coupled in case.couplings for text in _other_coupling(component, coupled, unit)]
        + [text for spring in case.springs for text in _other_spring(component, spring, unit)]
        for case in deck.cases
    ]
    messages += min(cases, key=len)  # a component is one case of its deck
    return [BundleProblem("mesh.file", text) for text in messages]


def _other_material(
    component: ComponentModel, deck: DeckContent, section: SolidSection, unit: str
) -> Iterator[str]:
    """Yield the constants and directions of a section's material that the component lacks."""
    cells = component.mesh.regions.get(section.region, ())
    numbers = [value[c] for value, c in zip(component.material_of_cells, cells, strict=False)]
    constants = deck.materials.get(section.material, {})
    for number in np.unique(np.concatenate([np.empty(0, dtype=int), *numbers])).tolist():
        material = component.bundle.materials[number]
        start = f'{section.where} gives "{section.region}" the material "{section.material}"'
        orthotropic = isinstance(constants.get("youngs_modulus"), tuple)
        if (material.law == "orthotropic") != orthotropic and "youngs_modulus" in constants:
            law = "orthotropic" if orthotropic else "isotropic"
            yield f'{start}, which is {law}; the component has law = "{material.law}"'
            continue
        if material.orthotropic is not None:
            yield from _other_directions(component, section, material.orthotropic, start, unit)
        for key in filter(constants.__contains__, _COMPARED):
            three = key.replace("modulus", "moduli").replace("ratio", "ratios")
            value = getattr(material, three if orthotropic else key)
            other = np.multiply(constants[key], si_factor(key, unit))
            if value is None and key == "yield_strength":
                continue  # *PLASTIC is listed by itself
            if value is None or np.abs(value - other).max() > _SAME_VALUE * np.abs(other).max():
                there = "none"
                if value is not None:
                    there = _listed(value if orthotropic else np.unique(value))
                here = _listed(constants[key], 6)
                in_unit = f"with lengths in {unit} {_listed(other)} in SI"
                yield f"{start}: {key} {here}, {in_unit}; the component has {there}"


def _listed(values: Any, digits: int = 4) -> str:
    """Write a number, or the entries of an array, separated by commas."""
    return ", ".join(f"{value:.{digits}g}" for value in np.ravel(values))


def _other_directions(
    component: ComponentModel, section: SolidSection, material: Orthotropic, start: str, unit: str
) -> Iterator[str]:
    """Yield differences of a material's directions from the deck's at the section's nodes."""
    mesh = component.mesh
    axes = section.orientation or np.eye(3).ravel()
    cells = zip(mesh.blocks, mesh.regions[section.region], strict=True)
    points = mesh.points[np.unique(np.concatenate([b.nodes[c].ravel() for b, c in cells]))]
    if len(axes) == 6:
        (x, y, z), (a, b, c) = si_factor("length", unit) * np.array(axes[:3]), axes[3:]
        other = replace(material, cylinder=Cylinder((x, y, z), (a, b, c)))
    else:
        other = replace(material, axes=np.reshape(axes, (3, 3)), cylinder=None)
    same = np.abs((material.directions(points) * other.directions(points)).sum(axis=-1))
    if (same < 1 - _SAME_VALUE).any(axis=-1).mean() > _MAX_TURNED:
        yield f"{start} in other directions than the component: see its *ORIENTATION"


def _other_support(component: ComponentModel, group: HeldGroup) -> Iterator[str]:
    """Yield the number of nodes that are free in a direction in which the deck holds them."""
    nodes = group_nodes(component.mesh, "", group.group, [])  # empty if the mesh has no such group
    nodes = np.setdiff1d(nodes, component.fixed_nodes)
    held = [attached for attached in component.interfaces if attached.locked == FREEDOMS]
    for interface in (*held, *(bushing for bushing, _ in component.bushings)):
        nodes = np.setdiff1d(nodes, interface.section.node_ids)
    held_along = np.zeros((len(component.mesh.points), 3, 3))
    sliding, projectors = component.sliding
    held_along[sliding] = projectors
    axes = np.reshape(group.axes or np.eye(3), (3, 3))
    directions = axes[["xyz".index(letter) for letter in group.directions]]
    parts_held = np.einsum("di,nij,dj->nd", directions, held_along[nodes], directions)
    if free := int((parts_held < 1 - _ROUNDOFF).any(axis=1).sum()):
        yield (
            f'{group.where} holds "{group.group}" along {", ".join(group.directions)}; {free} of '
            "its nodes are free in the component: name it under [supports]"
        )


def _other_coupling(component: ComponentModel, group: CoupledGroup, unit: str) -> Iterator[str]:
    """Yield differences of a coupling of the deck from the component's with the same nodes."""
    nodes = group_nodes(component.mesh, "", group.group, [])
    attached = [*component.interfaces, *component.frames]
    same = [
        interface for interface in attached if np.array_equal(interface.section.node_ids, nodes)
    ]
    start = f'{group.where} makes "{group.group}" follow a point'
    if not same:
        if np.setdiff1d(nodes, component.fixed_nodes).size:
            yield f"{start}; no interface or bushing of the component has these nodes"
        return
    if same[0].coupling != group.kind:
        yield f'{start} as a "{group.kind}" coupling; {same[0].key} says "{same[0].coupling}"'
    elif group.weighted and same[0].weights != "deck":
        yield f'{start} by weights of its own; {same[0].key} says weights = "{same[0].weights}"'
    point = np.array(group.point) * si_factor("length", unit)
    size = np.ptp(component.mesh.points, axis=0).max()
    if group.point and np.abs(point - same[0].point).max() > _ROUNDOFF * size:
        here, there = (", ".join(f"{x:.5g}" for x in p) for p in (point, same[0].point))
        yield f"{start} at ({here}) m; {same[0].key}.point is ({there}) m"


def _other_spring(component: ComponentModel, spring: DeckSpring, unit: str) -> Iterator[str]:
    """Yield differences of a spring of the deck, (6, 6), from that of the component's groups."""
    ends = [replace(end, point=spring.ends[0].point) for end in spring.ends]
    yield from (text for end in ends for text in _other_coupling(component, end, unit))
    groups = {group_nodes(component.mesh, "", end.group, []).tobytes() for end in ends}
    expected = spring.stiffness_in_si(unit)
    there = np.zeros((6, 6))
    for numbers, stiffness in component.springs:
        frames = [component.frames[i] for i in numbers]
        if {frame.section.node_ids.tobytes() for frame in frames} == groups:
            turn = np.kron(np.eye(2), frames[0].axes)
            there = turn.T @ stiffness @ turn
    sizes = np.sqrt(np.maximum(*map(np.diagonal, (there, expected))))
    if (np.abs(there - expected) > _SAME_VALUE * np.outer(sizes, sizes)).any():
        here, other = (_listed(np.diagonal(matrix)) for matrix in (expected, there))
        name = ends[0].group
        yield f'{spring.where} has "{name}" on springs of {here} in SI; the component has {other}'
