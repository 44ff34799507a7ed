"""A linear part as stiffness and mass of its frames and some modes (Craig and Bampton 1968).

The frames are the base, which the supports or the held interface stand on, and the other
interfaces; each has six freedoms, a translation and a rotation vector in its own axes. Unit motions
of a frame while the others stand still are the static shapes; to them come the lowest modes of the
part with all frames held, of unit mass each. The base's shapes are rigid motions of the whole part
less what these move of the interfaces, so that rigid motions cost no energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.sparse.linalg import eigsh

from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling.rotation import skew
from wrenchbook.fea.solver.vibration import Applied, Inertia, static_shapes

Array = np.ndarray

_SEED = 19680701  # of the start vector: the same bundle gives the same digits


@dataclass(frozen=True, eq=False)
class CraigBampton:
    """Stiffness and mass of f frames and n modes."""

    names: tuple[str, ...]  # of the frames; that of supports is "base"
    origins: Array  # shape (f, 3), m: of the frames, undeformed, in the mesh's axes
    rotations: Array  # shape (f, 3, 3): the columns are a frame's axes in the mesh's
    # stiffness, mass: shape (6 f + n, 6 f + n): of six freedoms a frame, then the modes; N/m, N,
    # N·m and kg, kg·m, kg·m^2 for frames, (rad/s)^2 and 1 for modes, kg^0.5 and kg^0.5·m between
    # both.
    stiffness: Array
    mass: Array
    # held, free: Natural frequencies, Hz, ascending: with all frames held, shape (n,); and with the
    # base alone held, by these matrices, shape (6 f - 6 + n,).
    held: Array
    free: Array


def craig_bampton(
    system: System,
    mass: csr_array,
    points: Array,
    body: Array,
    frames: Sequence[tuple[str, Array, Array]],
    modes: int,
) -> CraigBampton:
    """Return the part's matrices, of so many modes with all frames held.

    mass: shape (n, n), kg: `fea.solver.vibration.consistent_mass`.
    points, body: shape (n, 3), m: the nodes in the mesh's axes; and (3, 3): the axes of the
    equations' fields in the mesh's, in rows.
    frames: of the base, and then of each interface that moves, the name, point (3,), m, and axes.
    Raises ValueError if freedoms are locked, nothing has a mass, or there are not so many modes.
    Raises SolveFailed: ``mechanism`` or ``ill_conditioned``.
    """
    count = system.coupling.freedoms
    inertia = Inertia(system, mass, np.zeros((count, count)))
    (_, origin, axes), *moving = frames
    freedoms = inertia.active.size
    if freedoms != 6 * len(moving):
        raise ValueError("a frame needs its six freedoms: leave `locked` out of the interface")
    if not mass.nnz:
        raise ValueError("nothing has a mass: give the materials a density")
    if not 0 < modes < inertia.size - freedoms:
        raise ValueError(f"there are 1 to {inertia.size - freedoms - 1} modes, not {modes}")
    shapes, compliance = static_shapes(inertia)
    squares, motions = _held_modes(inertia, shapes, modes)
    # Each frame's motion (6, 6), in its own axes, by that of the first frame.
    turned = np.hstack([np.zeros((3, 3)), axes.T])
    motions_of = [
        np.vstack([eigenvalues @ _rigid((point - origin)[None], axes)[0], eigenvalues @ turned])
        for _, point, eigenvalues in moving
    ]
    moved = np.concatenate(motions_of)
    static = _nodal(inertia, shapes)
    base = np.einsum("ij,njk->nik", body, _rigid(points - origin, axes)) - static @ moved
    fields = np.concatenate([base, static, _nodal(inertia, motions)], axis=2)
    total = sum(fields[:, axis].T @ (mass @ fields[:, axis]) for axis in range(3))
    energies = 0.5 * np.asarray(total + np.transpose(total))  # twice the kinetic ones of pairs
    # The stiffness of base, interfaces and modes, from what the base moves (6 i, 6).
    both = np.hstack([-moved, np.eye(len(compliance))])
    first = both.shape[1]
    stiffness = np.zeros((first + len(squares),) * 2)
    stiffness[:first, :first] = both.T @ np.linalg.inv(compliance) @ both
    stiffness[first:, first:] = np.diag(squares)
    stiffness = 0.5 * (stiffness + stiffness.T)
    eigenvalues = eigh(stiffness[6:, 6:], energies[6:, 6:], eigvals_only=True)
    names, origins, rows = zip(*frames, strict=True)
    turned = np.array(rows).swapaxes(1, 2)
    held, free = (np.sqrt(squared) / (2 * np.pi) for squared in (squares, eigenvalues))
    return CraigBampton(names, np.array(origins), turned, stiffness, energies, held, free)


def _held_modes(inertia: Inertia, shapes: Array, count: int) -> tuple[Array, Array]:
    """Return squares of frequencies (count,), (rad/s)^2, and motions of unit mass, (size, count).

    By Lanczos' method with the inverse of the stiffness while the interfaces are held: a solve less
    the static shapes of what it moves them by.
    """
    interface_rows = slice(inertia.first, inertia.first + inertia.active.size)

    def held(loads: Array) -> Array:
        moved = inertia.solved(loads)
        return moved - shapes @ moved[interface_rows]

    mass, inverse = (Applied(inertia.size, apply) for apply in (inertia.times, held))
    start = held(np.random.default_rng(_SEED).standard_normal(inertia.size))
    squares, motions = eigsh(mass, k=count, M=mass, sigma=0.0, which="LM", OPinv=inverse, v0=start)
    order = np.argsort(squares)
    return squares[order], motions[:, order]


def _nodal(inertia: Inertia, motions: Array) -> Array:
    """Return all nodes' motions, shape (n, 3, k), of unknowns (size, k)."""
    return np.stack([inertia.fields(motion)[0] for motion in motions.T], axis=2)


def _rigid(arms: Array, axes: Array) -> Array:
    """Return how points at arms (n, 3), m, move by unit motions of a frame: shape (n, 3, 6).

    Arms and results are in the mesh's axes, the motions in the frame's, its rows `axes`.
    """
    translations = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
    return np.concatenate([translations, -skew(arms)], axis=2) @ np.kron(np.eye(2), axes.T)
