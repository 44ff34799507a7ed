"""Bodies of a mesh that supports, couplings and springs do not hold.

They follow from the nodes alone. Each body of the mesh counts as rigid, the stiffest case, so every
motion of this model is a mechanism of the real part too; no matrix is assembled or factorised. A
body's motion is q = (t, L theta) about the mesh's centre with L the mesh's size, and moves a node
at x by

    N(x) q = t + theta x (x - centre).

Supports give N q = 0, nodes that two bodies share N q_1 = N q_2. A rigid coupling gives the same
for section and interface; a distributed coupling moves the interface as the section moves in the
mean (least squares); locked freedoms hold the interface. With several interfaces each has these
equations. A bushing is coupled to its group as an interface is, and held where its spring resists;
so are the ends of a joint to each other. The motions that satisfy all equations are the null space
of a small dense matrix. While bolts are tightened the two sides of a cut shift along its axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wrenchbook.fea.component import AttachedInterface, ComponentModel
from wrenchbook.fea.mesh.bodies import Bodies, bodies_of, gap
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.spec.schema import FREEDOMS

# Bodies that are checked and listed: the equations' matrix is dense, with six columns a body.
_MAX_BODIES = 40
_MAX_REPORTED = 5  # free bodies in the report; the message counts the others


def listed_bodies(mesh: Mesh, bodies: Bodies) -> list[dict[str, Any]]:
    """Return number, cells, size (m) and middle (m) of the first `_MAX_BODIES` bodies."""
    return [
        {
            "part": number + 1,
            "cells": int(bodies.cells[number]),
            "size": np.ptp(mesh.points[bodies.nodes[number]], axis=0).tolist(),
            "middle": middle(mesh.points[bodies.nodes[number]]).tolist(),
        }
        for number in range(min(bodies.count, _MAX_BODIES))
    ]


def motion_problems(
    component: ComponentModel, bodies: Bodies, pairs: np.ndarray
) -> list[BundleProblem]:
    """Return a problem for each body that supports and coupling do not hold.

    bodies: those of the component's mesh before bolts are cut.
    pairs: shape (k, 2), int64: indices of coincident nodes (`fea.mesh.bodies.coincident_nodes`).
    """
    if bodies.count > _MAX_BODIES:
        message = (
            f"consists of {bodies.count} parts that share no face, but at most {_MAX_BODIES} are "
            "checked; if they are one body, merge their nodes in the mesher, else leave some out"
        )
        return [BundleProblem("mesh", message)]
    motions = free_motions(component, bodies)
    loose = [number for number, motion in enumerate(motions) if len(motion)]
    if not loose:
        return _slipping(component) if component.bolts else []
    if bodies.count == 1:
        mechanism = f"the part is a mechanism, {_motions_text(component, motions[0])}"
        if len(component.sliding[0]) or component.bushings:
            message = f"{mechanism}; add a support under [supports] that stops this"
            return [BundleProblem("supports", message)]
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
        message = f"{len(loose) - _MAX_REPORTED} more parts are free; support or join them too"
        problems.append(BundleProblem("mesh", message))
    return problems


def _slipping(component: ComponentModel) -> list[BundleProblem]:
    """Return a problem if a body can move while bolts are tightened, their cuts free to slip."""
    slipping = next((m for m in free_motions(component, bodies_of(component.mesh)) if len(m)), None)
    if slipping is None:
        return []
    message = (
        "only the bolts hold the part together while they are tightened: "
        f"{_motions_text(component, slipping)}; join the clamped parts outside the shanks, or "
        "support each of them"
    )
    return [BundleProblem("bolt", message)]


def _motions_text(component: ComponentModel, motions: np.ndarray) -> str:
    """Return the motions (k, 6) of a free body as text."""
    if len(motions) == 6:
        return "it can move in all six directions, because nothing holds it"
    points = component.mesh.points
    texts = [describe(motion, middle(points), size_of(points)) for motion in simplest(motions)]
    if len(texts) == 1:
        return f"it can {texts[0]}"
    return f"{len(texts)} of its six rigid motions meet no resistance: {', '.join(texts)}"


def _neighbour(mesh: Mesh, bodies: Bodies, number: int, pairs: np.ndarray) -> str:
    """Describe a free body's contact with others: none, at shared or at coincident nodes."""
    nodes = bodies.nodes[number]
    others = [n for n in range(bodies.count) if n != number]
    shared = {n: len(np.intersect1d(nodes, bodies.nodes[n])) for n in others}
    joined = max(shared, key=lambda n: shared[n])
    if shared[joined]:
        return (
            f"It is joined to part {joined + 1} by only {shared[joined]} nodes on one line or at "
            "one point, which is a hinge; join the two by faces"
        )
    inside = np.isin(pairs, nodes)
    doubled = int((inside[:, 0] != inside[:, 1]).sum())
    if doubled:
        return f"At {doubled} of its nodes there are also nodes of another part; merge these pairs"
    gaps = {n: gap(mesh, nodes, bodies.nodes[n]) for n in others}
    nearest = min(gaps, key=lambda n: gaps[n])
    return (
        f"The nearest part is number {nearest + 1}, {1e3 * gaps[nearest]:.3g} mm away and without "
        "a common node; mesh the two as one, leave the part out, or fix it"
    )


_RANK = 1e-7
"""Singular value, relative to the largest, that counts as zero."""

_ZERO_STIFFNESS = 1e-14  # eigenvalue relative to the largest; smaller ones are roundoff
_ZERO_PART = 1e-6  # part of a motion of length 1: smaller components are roundoff of the null space


def free_motions(component: ComponentModel, bodies: Bodies) -> list[np.ndarray]:
    """Return the free motions of each body.

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
        motions.append(rows[: int((size > _ZERO_PART).sum())])
    return motions


def describe(motion: np.ndarray, centre: np.ndarray, extent: float) -> str:
    """Return a motion of `free_motions` as text.

    The motion has shape (6,), m, the mesh's centre (3,), m; the mesh's size is in m.
    """
    shift = motion[:3]
    rotation = motion[3:] / extent
    if np.linalg.norm(motion[3:]) < _ZERO_PART:
        return f"slide along {_direction(shift)}"
    square = rotation @ rotation
    at = centre + np.cross(rotation, shift) / square
    pitch = shift @ rotation / square
    line = f"turn about the line through {point_text(at)} m along {_direction(rotation)}"
    return line if abs(pitch) < _ZERO_PART * extent else f"{line}, sliding along it"


def simplest(motions: np.ndarray) -> np.ndarray:
    """Return motions, shape (k, 6), of the same space, along and about single axes where possible.

    By row reduction, rotations first, so that pure translations come last.
    """
    rows = motions.copy()
    done = 0
    for column in (3, 4, 5, 0, 1, 2):
        if done == len(rows):
            break
        best = done + int(np.abs(rows[done:, column]).argmax())
        if abs(rows[best, column]) < _ZERO_PART:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, column], rows[done])
        done += 1
    return rows


class _Equations:
    """Rows of a matrix over the motions of all bodies, interfaces and frames, six columns each.

    centre, extent: of the mesh, (3,), m, and m; rows: the matrix so far, each part (k, columns).
    owner: shape (n,): the body of each node, the first of several; -1 for a node of no body.
    """

    def __init__(self, component: ComponentModel, bodies: Bodies) -> None:
        self.component = component
        self.bodies = bodies
        points = component.mesh.points
        self.centre = middle(points)
        self.extent = size_of(points)
        self.rows: list[np.ndarray] = []
        self.owner = np.full(len(points), -1)
        for number in reversed(range(bodies.count)):
            self.owner[bodies.nodes[number]] = number

    def hold_supports(self) -> None:
        """Hold fixed nodes, and sliding ones along their held directions."""
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
        """Let shared nodes move alike in their bodies, and dependent nodes as their masters."""
        if self.bodies.count == 1:
            return
        if (dependents := self.component.uncut_mesh.dependents) is not None:
            # The motions of dependent nodes less those that their masters give, by the motions of
            # all bodies.
            size = len(self.component.uncut_mesh.points)  # without cuts, as these dependents
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
        """Tie an interface, the motion of this index, to its section; hold locked freedoms."""
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
        """Let the sides of bolts' cuts shift along the axis alone, if they belong to two bodies."""
        for bolt in self.component.bolts:
            pairs = self.owner[np.stack([bolt.nodes, bolt.copies])]
            for low, high in np.unique(pairs, axis=1).T.tolist():
                if high in (-1, low):  # nodes of the mesh without cuts, or joined elsewhere
                    continue
                nodes = bolt.nodes[(pairs[0] == low) & (pairs[1] == high)]
                moves = self._moves(nodes).reshape(-1, 3, 6)
                moves -= bolt.axis[:, None] * (bolt.axis @ moves).mean(axis=0)
                rows = _condensed(moves.reshape(-1, 6))
                self._add({low: -rows, high: rows})

    def hold_spring(self, frame: AttachedInterface, stiffness: np.ndarray, ends: list[int]) -> None:
        """Hold the motion of a frame, or the difference of two motions, where a spring resists."""
        lengths = np.repeat([1.0, self.extent], 3)
        sizes, motions = np.linalg.eigh(stiffness / lengths / lengths[:, None])
        resisted = motions[:, sizes > _ZERO_STIFFNESS * sizes[-1]].T
        rows = resisted @ self._freedoms(frame)
        self._add({ends[-1]: rows} | ({ends[0]: -rows} if ends[1:] else {}))

    def _freedoms(self, attached: AttachedInterface) -> np.ndarray:
        """Return ux to rz of a point for a motion, (6, 6), the rotations times the mesh's size."""
        turns = np.concatenate([np.zeros((3, 3)), attached.axes], axis=1)
        return np.concatenate([attached.axes @ self._moves_of(attached.point[None]), turns])

    def null_space(self) -> np.ndarray:
        """Return orthonormal motions that satisfy all rows, shape (k, columns)."""
        matrix = np.concatenate(self.rows)
        _, size, rows = np.linalg.svd(matrix, full_matrices=True)
        rank = int((size > _RANK * size[0]).sum())
        return rows[rank:]

    def _moves(self, nodes: np.ndarray) -> np.ndarray:
        """Return N of each node, stacked, shape (3 k, 6)."""
        return self._moves_of(self.component.mesh.points[nodes])

    def _moves_of(self, points: np.ndarray) -> np.ndarray:
        """Return N of each point, stacked, shape (3 k, 6)."""
        x, y, z = ((points - self.centre) / self.extent).T
        moves = np.zeros((len(points), 3, 6))
        moves[:, :, :3] = np.eye(3)
        moves[:, 0, 4], moves[:, 0, 5] = z, -y
        moves[:, 1, 3], moves[:, 1, 5] = -z, x
        moves[:, 2, 3], moves[:, 2, 4] = y, -x
        return moves.reshape(-1, 6)

    def _add(self, blocks: dict[int, np.ndarray]) -> None:
        """Add rows that are zero except for blocks of columns, by the index of their motion."""
        count = self.bodies.count + len(self.component.interfaces) + len(self.component.frames)
        rows = np.zeros((len(next(iter(blocks.values()))), 6 * count))
        for number, block in blocks.items():
            rows[:, 6 * number : 6 * number + block.shape[1]] = block
        self.rows.append(rows)


def _condensed(moves: np.ndarray) -> np.ndarray:
    """Return at most six rows with the same null space, of about unit size."""
    return np.asarray(np.linalg.qr(moves / np.sqrt(len(moves)), mode="r"))


def middle(points: np.ndarray) -> np.ndarray:
    """Return the middle, shape (3,), m, of the box around points of shape (n, 3), m."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def size_of(points: np.ndarray) -> float:
    """Return the diagonal, m, of the box around points of shape (n, 3), m."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _direction(vector: np.ndarray) -> str:
    unit = vector / np.linalg.norm(vector)
    largest = unit[np.abs(unit).argmax()]
    return point_text(np.round(unit * np.sign(largest), 4) + 0.0)
