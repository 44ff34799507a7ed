"""Faults of a mesh and its supports, and contradictions between a component and its deck.

Bodies that can move follow from the nodes alone. Each body of the mesh counts as rigid, which it is
at most, so every motion found here is a mechanism of the real part too; nothing is assembled or
factorised. A body's motion is q = (t, L theta) about the mesh's centre with L the mesh's size, and
moves a node at x by

    N(x) q = t + theta x (x - centre).

Supports say N q = 0, nodes that two bodies share say N q_1 = N q_2, a rigid coupling says the same
of section and interface, a distributed coupling that the interface moves as the section does in the
mean (least squares), and locked freedoms hold the interface; each of several likewise. A bushing is
coupled to its group as an interface is, and held where its spring resists; so are the ends of a
joint to each other. What satisfies all of this is the null space of a small dense matrix. While
bolts are tightened the two sides of a cut shift along its axis.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from wrenchbook.fea.component import AttachedInterface, ComponentModel
from wrenchbook.fea.inspection import Bodies, bodies_of, gap
from wrenchbook.fea.mesh.deck_content import (
    CoupledGroup,
    DeckContent,
    DeckSpring,
    HeldGroup,
    SolidSection,
    in_si,
)
from wrenchbook.fea.mesh.facets import group_nodes
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.material import Cylinder, Orthotropic
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.spec.schema import FREEDOMS

Array = np.ndarray

_MAX_BODIES = 40
_MAX_REPORTED = 5


def parts(mesh: Mesh, bodies: Bodies) -> list[dict[str, Any]]:
    """Return number, cells, size (m) and middle (m) of the largest bodies."""
    return [
        {
            "part": number + 1,
            "cells": int(bodies.cells[number]),
            "size": np.ptp(mesh.points[bodies.nodes[number]], axis=0).tolist(),
            "middle": middle(mesh.points[bodies.nodes[number]]).tolist(),
        }
        for number in range(min(bodies.count, _MAX_BODIES))
    ]


def motion_problems(component: ComponentModel, bodies: Bodies, pairs: Array) -> list[BundleProblem]:
    """Return a problem for each body that supports and coupling do not hold.

    component, bodies: what is looked at, and the bodies it falls into.
    pairs: shape (k, 2), int64: indices of coincident nodes
    (`fea.inspection.coincident_nodes`).
    """
    if bodies.count > _MAX_BODIES:
        message = (
            f"falls into {bodies.count} parts that share no face with each other; merge the nodes "
            "in the mesher before exporting"
        )
        return [BundleProblem("mesh", message)]
    motions = free_motions(component, bodies)
    if component.bolts and not any(map(len, motions)):
        parts = bodies_of(component.mesh)
        slipping = next((m for m in free_motions(component, parts) if len(m)), None)
        if slipping is not None:
            message = (
                "nothing but bolts holds the part together while they are tightened: "
                f"{_motions_text(component, slipping)}; the parts that they clamp must be joined "
                "beside the shanks, or each be held"
            )
            return [BundleProblem("bolt", message)]
    loose = [number for number, motion in enumerate(motions) if len(motion)]
    if not loose:
        return []
    if bodies.count == 1:
        mechanism = f"the part is a mechanism, {_motions_text(component, motions[0])}"
        if len(component.sliding[0]) or component.bushings:
            return [BundleProblem("supports", f"{mechanism}; hold these as well")]
        message = f"{mechanism}; fix at least three points that are not on one line"
        return [BundleProblem("supports.fixed", message)]
    problems = []
    for n in loose[:_MAX_REPORTED]:
        nodes = component.mesh.points[bodies.nodes[n]]
        size = " x ".join(f"{1e3 * x:.4g}" for x in np.ptp(nodes, axis=0))
        message = (
            f"part {n + 1} of {bodies.count} ({bodies.cells[n]} cells, {size} mm, middle at "
            f"{point_text(middle(nodes))} m) is free: {_motions_text(component, motions[n])}. "
            f"{_neighbour(component.mesh, bodies, n, pairs)}"
        )
        problems.append(BundleProblem("mesh", message))
    if len(loose) > _MAX_REPORTED:
        problems.append(BundleProblem("mesh", f"{len(loose) - _MAX_REPORTED} more parts are free"))
    return problems


def _motions_text(component: ComponentModel, motions: Array) -> str:
    if len(motions) == 6:
        return "it can move in all six ways, nothing holds it"
    points = component.mesh.points
    texts = [describe(motion, middle(points), size_of(points)) for motion in simplest(motions)]
    if len(texts) == 1:
        return f"it can {texts[0]}"
    return f"{len(texts)} of its six rigid motions meet no resistance: {', '.join(texts)}"


def _neighbour(mesh: Mesh, bodies: Bodies, number: int, pairs: Array) -> str:
    """Describe the contact of a free body with the others: none, at shared or coincident nodes."""
    mine_nodes = bodies.nodes[number]
    others = [n for n in range(bodies.count) if n != number]
    shared = {n: len(np.intersect1d(mine_nodes, bodies.nodes[n])) for n in others}
    joined = max(shared, key=lambda n: shared[n])
    if shared[joined]:
        return (
            f"It hangs on part {joined + 1} by {shared[joined]} nodes on one line or point only: "
            "a hinge; join them by faces"
        )
    mine = np.isin(pairs, mine_nodes)
    twins = int((mine[:, 0] != mine[:, 1]).sum())
    if twins:
        return f"It has {twins} nodes in the places of another part's nodes: merge them"
    gaps = {n: gap(mesh, mine_nodes, bodies.nodes[n]) for n in others}
    nearest = min(gaps, key=lambda n: gaps[n])
    return (
        f"The nearest is part {nearest + 1}, {1e3 * gaps[nearest]:.3g} mm away and without a "
        "common node: mesh them as one, leave the part out or fix it"
    )


_ZERO = 1e-7
"""Singular value, relative to the largest, that counts as none."""

_ROUNDOFF = 1e-14  # of a stiffness, relative to the largest


def free_motions(component: ComponentModel, bodies: Bodies) -> list[Array]:
    """Return for each body the motions left to it.

    Result: each of shape (k, 6), m: translation of the mesh's centre and rotation times the mesh's
    size, orthonormal; k = 0 for a body without free motion.
    """
    equations = _Equations(component, bodies)
    equations.hold_supports()
    equations.join_bodies()
    for number, interface in enumerate(component.interfaces, start=bodies.count):
        equations.tie_interface(interface, number)
    first = bodies.count + len(component.interfaces)
    for number, frame in enumerate(component.frames, start=first):
        equations.tie_interface(frame, number)
    for ends, stiffness in component.springs:
        equations.hold_spring(component.frames[ends[0]], stiffness, [first + n for n in ends])
    equations.join_cuts()
    free = equations.null_space()
    motions = []
    for number in range(bodies.count):
        _, size, rows = np.linalg.svd(free[:, 6 * number : 6 * number + 6])
        motions.append(rows[: int((size > 1e-6).sum())])
    return motions


def describe(motion: Array, centre: Array, extent: float) -> str:
    """Return a motion of `free_motions` as text.

    The motion has shape (6,), m, the mesh's centre (3,), m; the mesh's size is in m.
    """
    shift, rotation = motion[:3], motion[3:] / extent
    if np.linalg.norm(motion[3:]) < 1e-6:
        return f"slide along {_direction(shift)}"
    square = rotation @ rotation
    at = centre + np.cross(rotation, shift) / square
    pitch = shift @ rotation / square
    line = f"turn about the line through {point_text(at)} m along {_direction(rotation)}"
    return line if abs(pitch) < 1e-6 * extent else f"{line}, sliding along it"


def simplest(motions: Array) -> Array:
    """Return motions, shape (k, 6), of the same space: about and along axes as far as they can.

    By row reduction, rotations first, so what only slides comes last.
    """
    rows, done = motions.copy(), 0
    for column in (3, 4, 5, 0, 1, 2):
        if done == len(rows):
            break
        best = done + int(np.abs(rows[done:, column]).argmax())
        if abs(rows[best, column]) < 1e-6:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, column], rows[done])
        done += 1
    return rows


class _Equations:
    """Rows of a matrix over the motions of all bodies, interfaces and bushings."""

    def __init__(self, component: ComponentModel, bodies: Bodies) -> None:
        self.component = component
        self.bodies = bodies
        points = component.mesh.points
        self.centre = middle(points)
        self.extent = size_of(points)
        self.rows: list[Array] = []
        self.owner = np.full(len(points), -1)
        for number in reversed(range(bodies.count)):
            self.owner[bodies.nodes[number]] = number

    def hold_supports(self) -> None:
        for number, nodes in enumerate(self.bodies.nodes):
            fixed = nodes[np.isin(nodes, self.component.fixed_nodes)]
            if fixed.size:
                self._add({number: _condensed(self._moves(fixed))})
            chosen = np.isin(self.component.sliding[0], nodes)
            if chosen.any():
                sliding, held = (part[chosen] for part in self.component.sliding)
                rows = held @ self._moves(sliding).reshape(-1, 3, 6)
                self._add({number: _condensed(rows.reshape(-1, 6))})

    def join_bodies(self) -> None:
        if self.bodies.count == 1:
            return
        if (dependents := self.component.whole.dependents) is not None:
            # How the motions of all bodies move dependent nodes less what these follow.
            size = len(self.component.whole.points)  # without cuts, as these dependents
            moves = np.zeros((size, 3, 6 * self.bodies.count))
            for number, nodes in enumerate(self.bodies.nodes):
                mine = nodes[(self.owner[nodes] == number) & (nodes < size)]
                moves[mine, :, 6 * number : 6 * number + 6] = self._moves(mine).reshape(-1, 3, 6)
            apart = (moves - dependents.expanded(moves))[dependents.nodes]
            self._add({0: _condensed(apart.reshape(-1, moves.shape[2]))})
        for number, nodes in enumerate(self.bodies.nodes):
            shared = nodes[self.owner[nodes] != number]
            for other in np.unique(self.owner[shared]).tolist():
                moves = _condensed(self._moves(shared[self.owner[shared] == other]))
                self._add({number: moves, other: -moves})

    def tie_interface(self, attached: AttachedInterface, interface: int) -> None:
        """Tie an interface, the motion of that number, to its section; hold locked freedoms."""
        section = attached.section
        owner = self.owner[section.node_ids]
        moves_of = {n: self._moves(section.node_ids[owner == n]) for n in np.unique(owner).tolist()}
        if attached.coupling == "rigid":
            for number, moves in moves_of.items():
                tie = _condensed(moves)
                self._add({number: tie, interface: -tie})
        else:
            weights = {n: np.repeat(section.weights[owner == n], 3) for n in moves_of}
            inertias = {n: (moves.T * weights[n]) @ moves for n, moves in moves_of.items()}
            mean = np.linalg.inv(sum(inertias.values(), np.zeros((6, 6))))
            self._add(
                {n: -mean @ inertia for n, inertia in inertias.items()} | {interface: np.eye(6)}
            )
        for name in attached.locked:
            self._add({interface: self._freedoms(attached)[FREEDOMS.index(name)][None]})

    def join_cuts(self) -> None:
        """Let the sides of bolts' cuts, if they are two bodies', shift along the axis alone."""
        for bolt in self.component.bolts:
            pairs = self.owner[np.stack([bolt.nodes, bolt.copies])]
            for low, high in np.unique(pairs, axis=1).T.tolist():
                if high in (-1, low):  # of the mesh without cuts; or joined elsewhere
                    continue
                nodes = bolt.nodes[(pairs[0] == low) & (pairs[1] == high)]
                moves = self._moves(nodes).reshape(-1, 3, 6)
                moves -= bolt.axis[:, None] * (bolt.axis @ moves).mean(axis=0)
                rows = _condensed(moves.reshape(-1, 6))
                self._add({low: -rows, high: rows})

    def hold_spring(self, frame: AttachedInterface, stiffness: Array, ends: list[int]) -> None:
        """Hold the motion of a frame, or the difference of two motions, where a spring resists."""
        lengths = np.repeat([1.0, self.extent], 3)
        sizes, motions = np.linalg.eigh(stiffness / lengths / lengths[:, None])
        resisted = motions[:, sizes > _ROUNDOFF * sizes[-1]].T
        rows = resisted @ self._freedoms(frame)
        self._add({ends[-1]: rows} | ({ends[0]: -rows} if ends[1:] else {}))

    def _freedoms(self, attached: AttachedInterface) -> Array:
        """Return ux to rz of a point by a motion, (6, 6), the rotations times the mesh's size."""
        turns = np.concatenate([np.zeros((3, 3)), attached.axes], axis=1)
        return np.concatenate([attached.axes @ self._moves_of(attached.point[None]), turns])

    def null_space(self) -> Array:
        matrix = np.concatenate(self.rows)
        _, size, rows = np.linalg.svd(matrix, full_matrices=True)
        rank = int((size > _ZERO * size[0]).sum())
        return rows[rank:]

    def _moves(self, nodes: Array) -> Array:
        return self._moves_of(self.component.mesh.points[nodes])

    def _moves_of(self, points: Array) -> Array:
        """Return N of each point, stacked, shape (3 k, 6)."""
        x, y, z = ((points - self.centre) / self.extent).T
        moves = np.zeros((len(points), 3, 6))
        moves[:, :, :3] = np.eye(3)
        moves[:, 0, 4], moves[:, 0, 5] = z, -y
        moves[:, 1, 3], moves[:, 1, 5] = -z, x
        moves[:, 2, 3], moves[:, 2, 4] = y, -x
        return moves.reshape(-1, 6)

    def _add(self, parts: dict[int, Array]) -> None:
        count = self.bodies.count + len(self.component.interfaces) + len(self.component.frames)
        rows = np.zeros((len(next(iter(parts.values()))), 6 * count))
        for number, part in parts.items():
            rows[:, 6 * number : 6 * number + part.shape[1]] = part
        self.rows.append(rows)


def _condensed(moves: Array) -> Array:
    """Return at most six rows with the same null space, of about unit size."""
    return np.asarray(np.linalg.qr(moves / np.sqrt(len(moves)), mode="r"))


def middle(points: Array) -> Array:
    """Return the middle, shape (3,), m, of the box around points of shape (n, 3), m."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def size_of(points: Array) -> float:
    """Return the diagonal, m, of the box around points of shape (n, 3), m."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _direction(vector: Array) -> str:
    unit = vector / np.linalg.norm(vector)
    largest = unit[np.abs(unit).argmax()]
    return point_text(np.round(unit * np.sign(largest), 4) + 0.0)


_SAME = 1e-3  # relative: decks write constants to three digits and more
_NEAR = 1e-6  # of the mesh's size: two points coincide
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
    and what else they are than in the deck, often nothing.
    """
    elements = {name: {"count": n, "instead": _instead(name)} for name, n in deck.elements.items()}
    read, ignored = (
        {word: sorted(set(lines)) for word, lines in lines_of.items()}  # of all instances of a part
        for lines_of in (deck.taken, deck.ignored)
    )
    return {"read": read, "ignored": ignored, "elements": elements}


def _instead(name: str) -> str:
    """Name the element solved in place of a deck's; empty where it is the same."""
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
    """Return the contradictions of a component and its deck, and what of the deck it leaves out."""
    deck = component.mesh.deck
    if deck is None:
        return []
    messages = [f"{where} {text}" for where, text in deck.missing.items()]
    integration = component.analysis.integration
    messages += [
        f'has {name}; [analysis] says integration = "{integration}" for it'
        for name in deck.elements
        if name.startswith("C3D20") and ("R" in name) != (integration == "reduced")
    ]
    messages += [
        text for section in deck.sections for text in _other_material(component, deck, section)
    ]
    written = {(tie.secondary, tie.main) for tie in component.bundle.ties}
    messages += [
        f'{where} ties "{tie.secondary}" to "{tie.main}"; these are loose here: write [[tie]]'
        for where, tie in deck.ties
        if (tie.secondary, tie.main) not in written
    ]
    cases = [
        [text for support in case.supports for text in _freed(component, support)]
        + [text for coupled in case.couplings for text in _uncoupled(component, coupled)]
        + [text for spring in case.springs for text in _unsprung(component, spring)]
        for case in deck.cases
    ]
    messages += min(cases, key=len)  # a component is of one case of its deck
    return [BundleProblem("mesh.file", text) for text in messages]


def _other_material(component: ComponentModel, deck: DeckContent, section: Any) -> Iterator[str]:
    cells = component.mesh.regions.get(section.region, ())
    numbers = [value[c] for value, c in zip(component.material_of_cells, cells, strict=False)]
    unit = component.bundle.mesh.unit if component.bundle.mesh else "m"
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
            yield from _turned(component, section, material.orthotropic, start, unit)
        for key in filter(constants.__contains__, _COMPARED):
            three = key.replace("modulus", "moduli").replace("ratio", "ratios")
            value = getattr(material, three if orthotropic else key)
            other = np.multiply(constants[key], in_si(key, unit))
            if value is None and key == "yield_strength":
                continue  # named with *PLASTIC itself
            if value is None or np.abs(value - other).max() > _SAME * np.abs(other).max():
                there = (
                    "none" if value is None else _listed(value if orthotropic else np.unique(value))
                )
                here = (
                    f"{_listed(constants[key], 6)}, with lengths in {unit} {_listed(other)} in SI"
                )
                yield f"{start}: {key} {here}; the component has {there}"


def _listed(values: Any, digits: int = 4) -> str:
    return ", ".join(f"{value:.{digits}g}" for value in np.ravel(values))


def _turned(
    component: ComponentModel, section: SolidSection, material: Orthotropic, start: str, unit: str
) -> Iterator[str]:
    """Compare the directions of a material with those of the deck at the nodes of the section."""
    mesh, axes = component.mesh, section.orientation or np.eye(3).ravel()
    cells = zip(mesh.blocks, mesh.regions[section.region], strict=True)
    points = mesh.points[np.unique(np.concatenate([b.nodes[c].ravel() for b, c in cells]))]
    if len(axes) == 6:
        (x, y, z), (a, b, c) = in_si("length", unit) * np.array(axes[:3]), axes[3:]
        other = replace(material, cylinder=Cylinder((x, y, z), (a, b, c)))
    else:
        other = replace(material, axes=np.reshape(axes, (3, 3)), cylinder=None)
    same = np.abs((material.directions(points) * other.directions(points)).sum(axis=-1))
    if (same < 1 - _SAME).any(axis=-1).mean() > 0.5:  # on a cylinder's axis they are of no kind
        yield f"{start} in other directions than the component: see its *ORIENTATION"


def _freed(component: ComponentModel, group: HeldGroup) -> Iterator[str]:
    nodes = _nodes(component.mesh, group.group)
    nodes = np.setdiff1d(nodes, component.fixed_nodes)
    held_ones = [attached for attached in component.interfaces if len(attached.locked) == 6]
    for interface in (*held_ones, *(bushing for bushing, _ in component.bushings)):
        nodes = np.setdiff1d(nodes, interface.section.node_ids)
    held = np.zeros((len(component.mesh.points), 3, 3))
    sliding, projectors = component.sliding
    held[sliding] = projectors
    axes = np.reshape(group.axes or np.eye(3), (3, 3))
    ways = axes[["xyz".index(letter) for letter in group.directions]]
    free = int((np.einsum("di,nij,dj->nd", ways, held[nodes], ways) < 1 - _NEAR).any(axis=1).sum())
    if free:
        yield (
            f'{group.where} holds "{group.group}" along {", ".join(group.directions)}; {free} of '
            "its nodes are free in the component: name it under [supports]"
        )


def _uncoupled(component: ComponentModel, group: CoupledGroup) -> Iterator[str]:
    nodes = _nodes(component.mesh, group.group)
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
    unit = component.bundle.mesh.unit if component.bundle.mesh else "m"
    point = np.array(group.point) * in_si("length", unit)
    size = np.ptp(component.mesh.points, axis=0).max()
    if group.point and np.abs(point - same[0].point).max() > _NEAR * size:
        here, there = (", ".join(f"{x:.5g}" for x in p) for p in (point, same[0].point))
        yield f"{start} at ({here}) m; {same[0].key}.point is ({there}) m"


def _unsprung(component: ComponentModel, spring: DeckSpring) -> Iterator[str]:
    ends = [replace(end, point=spring.ends[0].point) for end in spring.ends]
    yield from (text for end in ends for text in _uncoupled(component, end))
    groups = {_nodes(component.mesh, end.group).tobytes() for end in ends}
    expected = spring.in_si(component.bundle.mesh.unit if component.bundle.mesh else "m")
    there = np.zeros((6, 6))
    for numbers, stiffness in component.springs:
        frames = [component.frames[i] for i in numbers]
        if {frame.section.node_ids.tobytes() for frame in frames} == groups:
            turn = np.kron(np.eye(2), frames[0].axes)
            there = turn.T @ stiffness @ turn
    sizes = np.sqrt(np.maximum(*map(np.diagonal, (there, expected))))
    if (np.abs(there - expected) > _SAME * np.outer(sizes, sizes)).any():
        here, other = (_listed(np.diagonal(matrix)) for matrix in (expected, there))
        name = ends[0].group
        yield f'{spring.where} has "{name}" on springs of {here} in SI; the component has {other}'


def _nodes(mesh: Mesh, group: str) -> Array:
    """Return the nodes of a group, shape (k,), indices; none if the mesh has none of it."""
    return group_nodes(mesh, "", group, [])
