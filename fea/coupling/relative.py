"""The spring between two frames: q^T K q / 2 of the second's motion q relative to the first.

With translations t and rotation vectors r of frames that are one at rest, in their axes there,
q is R1^T (t2 - t1) and the rotation vector of R1^T R2: a rigid motion of both costs no energy at
any rotation. The gradient g = B^T K q has B = dq/d(t1, r1, t2, r2) in closed form. The tangent is
its derivative by complex steps, exact to roundoff, and the third derivatives those of the tangent
by differences, which leave out 1e-12 of them.
"""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.tensors import rotation, rotation_vector, skew, spin_per_vector

Array = np.ndarray

_COMPLEX_STEP = 1e-30
_STEP = 1e-3  # rad
_SLOPE = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # weights of a first derivative
_ROTATIONS = (3, 4, 5, 9, 10, 11)


def relative(motions: Array) -> Array:
    """Return q, shape (6,), m and rad, of both frames' motions, shape (12,)."""
    _, first, _, second = motions.reshape(4, 3)
    return _change(motions, rotation_vector(rotation(first).T @ rotation(second)))[0]


def gradient(motions: Array, stiffness: Array) -> Array:
    """Return the derivatives of the energy, shape (12,), N and N·m, by the motions, (12,)."""
    q, change = _change(motions, relative(motions)[3:])
    return change.T @ stiffness @ q


def tangent(motions: Array, stiffness: Array) -> Array:
    """Return the second derivatives of the energy, shape (12, 12)."""
    turned = relative(motions)[3:]
    _, change = _change(motions, turned)
    columns = []
    for unit in np.eye(12):
        step = 1j * _COMPLEX_STEP
        q, ahead = _change(motions + step * unit, turned + step * (change[3:] @ unit))
        columns.append(np.imag(ahead.T @ stiffness @ q) / _COMPLEX_STEP)
    return np.stack(columns, axis=1)


def third(motions: Array, stiffness: Array) -> Array:
    """Return the third derivatives of the energy, shape (12, 12, 12).

    Those by translations alone are zero: at fixed rotations the energy is quadratic.
    """
    tensor = np.zeros((12, 12, 12))
    for turn in _ROTATIONS:
        unit = _STEP * np.eye(12)[turn]
        slopes = (w * tangent(motions + n * unit, stiffness) for n, w in _SLOPE.items())
        slope = sum(slopes, np.zeros((12, 12))) / _STEP
        tensor[turn], tensor[:, turn], tensor[:, :, turn] = slope, slope, slope
    return tensor


def _change(motions: Array, turned: Array) -> tuple[Array, Array]:
    """Return q and B, (6,) and (6, 12), where `turned` is the relative rotation vector."""
    place, first, other, second = motions.reshape(4, 3)
    back, spin = rotation(first).T, spin_per_vector(first)
    change = np.zeros((6, 12), dtype=motions.dtype)
    change[:3, 6:9] = back
    change[:3, :3] = -back
    change[:3, 3:6] = back @ skew(other - place) @ spin
    rate = np.linalg.inv(spin_per_vector(turned)) @ back
    change[3:, 3:6] = -rate @ spin
    change[3:, 9:] = rate @ spin_per_vector(second)
    return np.concatenate([back @ (other - place), turned]), change
