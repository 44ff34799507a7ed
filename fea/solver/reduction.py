"""Reduction of a component to its frames and a few modes (Craig and Bampton 1968).

The frames are the base, which the supports or the held interface stand on, and the other
interfaces; each has six freedoms, a translation and a rotation vector in the mesh's axes. Unit
motions of a frame while the others stand still are the static shapes; to them come the lowest modes
of the part with all frames held, of unit mass each. The base's shapes are rigid motions of the part
less what these move of the interfaces, so that rigid motions cost no energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.sparse import csr_array

from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling.coupling import PER_INTERFACE
from wrenchbook.fea.solver.vibration import Inertia, lowest_modes, static_shapes
from wrenchbook.fea.tensors import skew

_HELD_SEED = 19680701  # seed of the held modes' start vector: the same bundle gives the same digits


@dataclass(frozen=True, eq=False)
class CraigBampton:
    """Stiffness and mass of f frames and n modes."""

    names: tuple[str, ...]  # names of the frames; that of supports is "base"
    origins: np.ndarray  # shape (f, 3), m: origins of the undeformed frames, in the mesh's axes
    rotations: np.ndarray  # shape (f, 3, 3): the columns are a frame's axes in the mesh's
    # stiffness, mass: shape (6 f + n, 6 f + n): of six freedoms a frame along the mesh's axes, then
    # the modes; N/m, N, N·m and kg, kg·m, kg·m^2 for frames, (rad/s)^2 and 1 for modes, kg^0.5 and
    # kg^0.5·m between both.
    stiffness: np.ndarray
    mass: np.ndarray
    # held, free: Natural frequencies, Hz, ascending: with all frames held, shape (n,); and with
    # only the base held, by these matrices, shape (6 f - 6 + n,).
    held: np.ndarray
    free: np.ndarray


def craig_bampton(
    system: System,
    mass: csr_array,
    points: np.ndarray,
    body: np.ndarray,
    frames: Sequence[tuple[str, np.ndarray, np.ndarray]],
    modes: int,
) -> CraigBampton:
    """Return the part's matrices with a number of modes of the part with all frames held.

    mass: shape (n, n), kg: `consistent_mass`.
    points, body: shape (n, 3), m: the nodes in the mesh's axes; and (3, 3): the axes of the
    equations' fields in the mesh's, in rows.
    frames: name, point (3,), m, and axes of the base, and then of each interface that moves.

    Raises ValueError if freedoms are locked, nothing has a mass, or the part has fewer modes.
    Raises SolveFailed of kind ``mechanism`` or ``ill_conditioned`` if the equations are singular.
    """
    count = system.coupling.n_freedoms
    inertia = Inertia(system, mass, np.zeros((count, count)))
    (_, origin, _), *moving = frames
    freedoms = inertia.active.size
    needed = PER_INTERFACE * max(len(moving), 1)  # a single interface that is locked is the base
    if freedoms != needed:
        locked = f"{needed - freedoms} freedoms are locked"
        raise ValueError(f"{locked}, but a condensed mass needs all six; leave locked out")
    if not mass.nnz:
        raise ValueError("no material has a density; write density, in kg/m^3, in [[material]]")
    if not 0 < modes < inertia.size - freedoms:
        raise ValueError(f"the modes must be 1 to {inertia.size - freedoms - 1}, not {modes}")
    shapes, compliance = static_shapes(inertia)
    squares, motions = _held_modes(inertia, shapes, modes)
    # Rigid motions of the interfaces by unit motions of the base, (6 i, 6), and the rotation from
    # the mesh's axes to those of the interfaces, (6 i, 6 i).
    rigid = np.concatenate(
        [np.vstack([_rigid((point - origin)[None])[0], np.eye(6)[3:]]) for _, point, _ in moving]
    )
    turn = np.asarray(block_diag(*(axes for _, _, axes in moving for _ in range(2))))

    # Fields of the base, the interfaces and the modes, each (n, 3, k).
    static = _nodal(inertia, shapes) @ turn
    rigid_fields = _rigid(points - origin) * ~system.body.slips[:, None, None]
    base = np.einsum("ij,njk->nik", body, rigid_fields) - static @ rigid
    fields = np.concatenate([base, static, _nodal(inertia, motions)], axis=2)
    products = sum(fields[:, axis].T @ (mass @ fields[:, axis]) for axis in range(3))
    reduced_mass = 0.5 * np.asarray(products + np.transpose(products))

    # Motions of the interfaces relative to the base by unit motions of the frames, (6 i, 6 f).
    elastic = turn @ np.hstack([-rigid, np.eye(len(compliance))])
    of_frames = elastic.T @ np.linalg.inv(compliance) @ elastic
    stiffness = np.asarray(block_diag(0.5 * (of_frames + of_frames.T), np.diag(squares)))
    eigenvalues = eigh(stiffness[6:, 6:], reduced_mass[6:, 6:], eigvals_only=True)
    held, free = (np.sqrt(squared) / (2 * np.pi) for squared in (squares, eigenvalues))
    names, origins, axes = zip(*frames, strict=True)
    rotations = np.array(axes).swapaxes(1, 2)
    return CraigBampton(names, np.array(origins), rotations, stiffness, reduced_mass, held, free)


def _held_modes(inertia: Inertia, shapes: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return squares of frequencies (count,), (rad/s)^2, and motions of unit mass, (size, count).

    By Lanczos' method with the inverse of the stiffness while the interfaces are held: a solve,
    less the static shapes times the motions of the interfaces in it.
    """
    interface_rows = slice(inertia.first, inertia.first + inertia.active.size)

    def held(loads: np.ndarray) -> np.ndarray:
        moved = inertia.solve(loads)
        return moved - shapes @ moved[interface_rows]

    start = held(np.random.default_rng(_HELD_SEED).standard_normal(inertia.size))
    squares, motions = lowest_modes(inertia, held, start, count)
    order = np.argsort(squares)
    return squares[order], motions[:, order]


def _nodal(inertia: Inertia, motions: np.ndarray) -> np.ndarray:
    """Return all nodes' motions, shape (n, 3, k), of unknowns (size, k)."""
    return np.stack([inertia.fields(motion)[0] for motion in motions.T], axis=2)


def _rigid(arms: np.ndarray) -> np.ndarray:
    """Return the motion of points at arms (n, 3), m, by a frame's unit motions: shape (n, 3, 6)."""
    translations = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
    return np.concatenate([translations, -skew(arms)], axis=2)
