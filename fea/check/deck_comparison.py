"""What of an input deck a component reads and ignores, and where the two contradict each other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.deck_content import CoupledGroup, DeckContent, HeldGroup, in_si
from wrenchbook.fea.mesh.groups import group_nodes
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleProblem

Array = np.ndarray

_SAME = 1e-3  # relative: decks write constants to three digits and more
_NEAR = 1e-6  # of the mesh's size: two places are one
_SOLID = re.compile(r"(C3D\d+)([A-Z]*)")
_COMPARED = ("youngs_modulus", "poisson_ratio", "density", "thermal_expansion", "yield_strength")


def listing(deck: DeckContent) -> dict[str, Any]:
    """Return the lines of each keyword that is read or compared, and ignored, and the elements.

    Returns
    -------
    dict
        ``read`` and ``ignored``: line numbers by keyword. ``elements``: by type, their number and
        what else they are than in the deck, often nothing.
    """
    elements = {name: {"count": n, "instead": _instead(name)} for name, n in deck.elements.items()}
    read, ignored = (
        {word: sorted(set(lines)) for word, lines in found.items()}  # of all instances of a part
        for found in (deck.taken, deck.ignored)
    )
    return {"read": read, "ignored": ignored, "elements": elements}


def _instead(name: str) -> str:
    """Say what an element of a deck is here, where it is not the same."""
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
    """Return what a component leaves out of its deck, and does in another way."""
    deck = component.mesh.deck
    if deck is None:
        return []
    found = [f"{where} {words}" for where, words in deck.missing.items()]
    found += _integrated(component, deck)
    found += [words for one in deck.sections for words in _other_material(component, deck, one)]
    cases = [
        [words for one in case.supports for words in _freed(component, one)]
        + [words for one in case.couplings for words in _uncoupled(component, one)]
        for case in deck.cases
    ]
    found += min(cases, key=len)  # a component is of one case of its deck
    return [BundleProblem("mesh.file", words) for words in found]


def _integrated(component: ComponentModel, deck: DeckContent) -> Iterator[str]:
    own = component.analysis.integration
    for name in deck.elements:
        if name.startswith("C3D20") and ("R" in name) != (own == "reduced"):
            yield f'has {name}; [analysis] says integration = "{own}" for it'


def _other_material(component: ComponentModel, deck: DeckContent, one: Any) -> Iterator[str]:
    cells = component.mesh.regions.get(one.region, ())
    numbers = [own[c] for own, c in zip(component.material_of_cells, cells, strict=False)]
    unit = component.bundle.mesh.unit if component.bundle.mesh else "m"
    constants = deck.materials.get(one.material, {})
    for number in np.unique(np.concatenate([np.empty(0, dtype=int), *numbers])).tolist():
        material = component.bundle.materials[number]
        words = f'{one.where} gives "{one.region}" the material "{one.material}"'
        if material.law == "orthotropic":
            if "youngs_modulus" in constants:
                yield f'{words}, which is isotropic; the component has law = "orthotropic"'
            continue
        for key in filter(constants.__contains__, _COMPARED):
            own, other = getattr(material, key), constants[key] * in_si(key, unit)
            own = own[0] if isinstance(own, tuple) else own
            if own is None and key == "yield_strength":
                continue  # named with *PLASTIC itself
            if own is None or abs(own - other) > _SAME * abs(other):
                yield (
                    f"{words}: {key} {constants[key]:g}, with lengths in {unit} {other:.4g} in SI; "
                    f"the component has {'none' if own is None else format(own, '.4g')}"
                )


def _freed(component: ComponentModel, one: HeldGroup) -> Iterator[str]:
    nodes = _nodes(component.mesh, one.group)
    nodes = np.setdiff1d(nodes, component.fixed_nodes)
    held_ones = [own for own in component.interfaces if len(own.locked) == 6]
    for interface in (*held_ones, *(own for own, _ in component.bushings)):
        nodes = np.setdiff1d(nodes, interface.section.node_ids)
    held = np.zeros((len(component.mesh.points), 3))
    sliding, projectors = component.sliding
    held[sliding] = np.diagonal(projectors, axis1=1, axis2=2)
    ways = ["xyz".index(letter) for letter in one.directions]
    free = int((held[nodes][:, ways] < 1 - _NEAR).any(axis=1).sum())
    if free:
        yield (
            f'{one.where} holds "{one.group}" along {", ".join(one.directions)}; {free} of its '
            "nodes are free in the component: name it under [supports]"
        )


def _uncoupled(component: ComponentModel, one: CoupledGroup) -> Iterator[str]:
    nodes = _nodes(component.mesh, one.group)
    attached = [*component.interfaces, *(own for own, _ in component.bushings)]
    same = [own for own in attached if np.array_equal(own.section.node_ids, nodes)]
    words = f'{one.where} makes "{one.group}" follow a point'
    if not same:
        if np.setdiff1d(nodes, component.fixed_nodes).size:
            yield f"{words}; no interface or bushing of the component has these nodes"
        return
    if same[0].coupling != one.kind:
        yield f'{words} as a "{one.kind}" coupling; {same[0].key} says "{same[0].coupling}"'
    unit = component.bundle.mesh.unit if component.bundle.mesh else "m"
    point = np.array(one.point) * in_si("length", unit)
    size = np.ptp(component.mesh.points, axis=0).max()
    if one.point and np.abs(point - same[0].point).max() > _NEAR * size:
        here, there = (", ".join(f"{x:.5g}" for x in p) for p in (point, same[0].point))
        yield f"{words} at ({here}) m; {same[0].key}.point is ({there}) m"


def _nodes(mesh: Mesh, group: str) -> Array:
    """Return the nodes of a group, shape (k,), indices; none if the mesh has none of it."""
    return group_nodes(mesh, "", group, [])
