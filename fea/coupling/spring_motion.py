"""Springs, q^T K q / 2 of a frame's motion q, or of a second frame's relative to the first.

A frame's motion is its translation t and rotation vector r. Of two frames that are one at rest q
is R1^T (t2 - t1) and the rotation vector of R1^T R2, in axes that turn with the first: a rigid
motion of both costs no energy at any rotation. The gradient B^T K q has B = dq/d(t1, r1, t2, r2)
in closed form, the tangent is its derivative by complex steps, exact to roundoff, and the third
derivatives are those of the tangent by differences, which leave out 1e-12.
"""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.tensors import COMPLEX_STEP, rotation, rotation_vector, skew, spin_per_vector

_PER_FRAME = 6  # motions of a frame: translation and rotation vector
_TURNS = (3, 4, 5, 9, 10, 11)  # the rotations among the motions of two frames
_STEP = 1e-3  # rad: differences of fourth order leave out its fourth power
# Weights of a first derivative by differences of fourth order.
_SLOPE = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}


def relative_motion(motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q, (6,), m and rad, of one frame's motion, (6,), or two, (12,), and B, (6, k)."""
    first = np.zeros(3) if len(motions) == _PER_FRAME else motions[3:_PER_FRAME]
    turned = rotation_vector(rotation(first).T @ rotation(motions[-3:]))
    return _motion_and_jacobian(motions, turned)


def energy_hessian(motions: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the second derivatives of the energy by the motions, shape (k, k)."""
    q, jacobian = relative_motion(motions)
    columns = []
    turned, rate = q[3:], jacobian[3:]
    for unit in 1j * COMPLEX_STEP * np.eye(len(motions)):
        q, jacobian = _motion_and_jacobian(motions + unit, turned + rate @ unit)
        columns.append(np.imag(jacobian.T @ stiffness @ q) / COMPLEX_STEP)
    return np.stack(columns, axis=1)


def energy_third_derivatives(motions: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the third derivatives of the energy by the motions, shape (k, k, k).

    Those by translations alone are zero: at fixed rotations the energy is quadratic.
    """
    tensor = np.zeros((len(motions),) * 3)
    if len(motions) == _PER_FRAME:  # the energy of a single frame is quadratic
        return tensor
    for turn in _TURNS:
        unit = _STEP * np.eye(len(motions))[turn]
        hessians = (w * energy_hessian(motions + n * unit, stiffness) for n, w in _SLOPE.items())
        slope = sum(hessians) / _STEP
        tensor[turn], tensor[:, turn], tensor[:, :, turn] = slope, slope, slope
    return tensor


def _motion_and_jacobian(motions: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q and B, (6,) and (6, k), of motions (k,) by the rotation vector of q."""
    if len(motions) == _PER_FRAME:
        return motions, np.eye(_PER_FRAME)
    t1, r1, t2, r2 = motions.reshape(4, 3)
    back = rotation(r1).T
    spin = spin_per_vector(r1)
    rate = np.linalg.inv(spin_per_vector(turned)) @ back
    zero = np.zeros((3, 3))
    shifts = [-back, back @ skew(t2 - t1) @ spin, back, zero]
    turns = [zero, -rate @ spin, zero, rate @ spin_per_vector(r2)]
    return np.append(back @ (t2 - t1), turned), np.block([shifts, turns])
