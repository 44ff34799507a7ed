"""Derivatives of rows by q = (F, mu), the loads that are work-conjugate to the displacements.

mu = J(r)^T M is the moment that works on the rotation vector r; J is the left Jacobian of the
rotation vector, M the spatial moment. Derivatives by (F, M), which rows store, are unsymmetric by
as much as the rotation.
"""

from __future__ import annotations

from itertools import combinations_with_replacement, permutations
from math import factorial
from typing import NamedTuple

import numpy as np

from .space import PER_INTERFACE, Floats, Space

# Terms of the series of J: at 20 degrees the next term adds 5e-16 to the second derivative.
TERMS = 14

_CROSS = np.zeros((3, 3, 3))  # (a x b)_i = _CROSS[i, j, k] a_j b_k
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


class MomentMap(NamedTuple):
    """J(r)^T M and its derivatives by r at fixed M."""

    value: Floats  # (..., 3), N·m
    by_rotation: Floats  # (..., 3, 3), N·m/rad: [i, a]: of component i by r_a
    second: Floats  # (..., 3, 3, 3), N·m/rad^2: [i, a, b]: of component i by r_a and r_b


def moment_map(rotation: Floats, moment: Floats) -> MomentMap:
    """Return J(r)^T M of rotation vectors r, (..., 3), rad, and moments M, (..., 3), N·m.

    J^T M = sum of v_n / (n + 1)! over n >= 0, with v_0 = M and v_n = -r x v_(n-1): the series of
    the left Jacobian (Sola, Deray and Atchuthan 2018, A micro Lie theory, equation 145). The
    product rule gives the derivatives of v_n. Leading dimensions broadcast; J^T M is linear in M,
    so that unit moments give the columns of J^T.
    """
    cross = -np.einsum("ijk,...j->...ik", _CROSS, rotation)  # cross @ v = -r x v
    lead = np.broadcast_shapes(np.shape(rotation), np.shape(moment))[:-1]
    value = np.array(np.broadcast_to(moment, (*lead, 3)), dtype=float)
    term = MomentMap(value, np.zeros((*lead, 3, 3)), np.zeros((*lead, 3, 3, 3)))
    total = MomentMap(*map(np.copy, term))
    for order in range(1, TERMS):
        value, first, second = term
        mixed = -(_CROSS.reshape(9, 3) @ first).reshape(second.shape)  # [i, a, b]: -e_a x v_,b
        term = MomentMap(
            (cross @ value[..., None])[..., 0],
            cross @ first - np.einsum("iak,...k->...ia", _CROSS, value),
            (cross @ second.reshape(*lead, 3, 9)).reshape(second.shape)
            + mixed
            + np.swapaxes(mixed, -1, -2),
        )
        for result, part in zip(total, term, strict=True):
            result += part / factorial(order + 1)
    return total


class LoadChange(NamedTuple):
    """The change of q along the equilibria of n rows, SI: with y = (u, r), q(w, y)."""

    along: Floats  # (n, I, I): [q, w]: dq/dw = B + S C, C = dy/dw
    by_motion: Floats  # (n, I, O): S = dq/dy at fixed w = diag(0, d(J^T M)/dr)
    bend: Floats  # (n, I, I, I): [q, w, w]: the second derivatives by w, less S d2y/dw2


def load_change(
    wrench: Floats, displacement: Floats, compliance: Floats, space: Space
) -> LoadChange:
    """Return the change of q along the equilibria of n rows.

    B = dq/dw at fixed r = diag(1, J^T). Further inputs are entries of q as they are. A locked
    freedom, whose load moves nothing, takes no part: the solver leaves out what acts on it.

    `wrench` (n, I), SI; `displacement` (n, O), m and rad.
    `compliance` (n, O, I), SI: the rows' tangents by (F, M); the result is NaN where they are NaN.
    """
    free = np.any(compliance != 0, axis=1)
    inputs = len(space.inputs)
    acting = np.where(free, wrench, 0.0)
    by_load = np.broadcast_to(np.eye(inputs), (*free.shape, inputs)).copy()
    by_motion = np.zeros_like(np.swapaxes(compliance, 1, 2))
    bend = np.zeros((*free.shape, inputs, inputs))
    for first in range(PER_INTERFACE // 2, len(space.outputs), PER_INTERFACE):
        r = slice(first, first + 3)
        turned = compliance[:, first : first + 3]
        # [n, k, i] is J^T's column k: J itself; its slope times the moment is S.
        unit = moment_map(displacement[:, None, r], np.eye(3))
        by_load[:, r, r] = np.swapaxes(unit.value, 1, 2)
        by_motion[:, r, r] = np.einsum("nk,nkia->nia", acting[:, r], unit.by_rotation)
        second = np.einsum("nk,nkiab->niab", acting[:, r], unit.second)
        bend[:, r] += np.einsum("niab,nav,nbw->nivw", second, turned, turned, optimize=True)
        mixed = np.zeros_like(bend[:, r])
        mixed[:, :, r] = np.einsum("nkia,naw->nikw", unit.by_rotation, turned)
        bend[:, r] += mixed + np.swapaxes(mixed, 2, 3)
    locked = np.logical_not(free)
    either_locked = locked[:, :, None] | locked[:, None, :]
    by_load = np.where(either_locked, np.eye(inputs), by_load)
    by_motion = np.where(locked[:, :, None], 0.0, by_motion)
    bend = np.where(locked[:, :, None, None] | either_locked[:, None], 0.0, bend)
    return LoadChange(by_load + by_motion @ compliance, by_motion, bend)


def symmetric_tangents(
    wrench: Floats, displacement: Floats, compliance: Floats, space: Space
) -> Floats:
    """Return tangents of n rows by q, C (B + S C)^-1 of `load_change`, shape (n, O, I), SI.

    The columns of the loads are symmetric if the row is a nonlinear solve. NaN where the tangent
    by (F, M) is NaN or has no such counterpart: where dq/dw is singular.

    `wrench`, `displacement`, `compliance`, `space`: as `load_change` takes them.
    """
    change = load_change(wrench, displacement, compliance, space).along
    with np.errstate(invalid="ignore"):  # NaN stays NaN
        change[np.linalg.det(change) == 0] = np.nan
        return compliance @ np.linalg.inv(change)


def second_derivatives(
    wrench: Floats, displacement: Floats, compliance: Floats, curvature: Floats, space: Space
) -> Floats:
    """Return the second derivatives of the displacements by (F, M), shape (n, O, I, I), SI.

    With T the third derivatives of the complementary energy, C_q the tangent by q, and q_v the
    change of q with w_v: d2y/dw2 = T[q_v, q_w] + C_q d2q/dw2, and d2q/dw2 = bend + S d2y/dw2. NaN
    where a row has no curvature.

    `wrench`, `displacement`, `compliance`, `space`: as `load_change` takes them.
    `curvature` (n, p), SI: T[a, b, c] of each row, a <= b <= c, as `Rows.curvature`.
    """
    inputs, outputs = len(space.inputs), len(space.outputs)
    change = load_change(wrench, displacement, compliance, space)
    # Index of T[a, b, c] in the numbers of a row.
    positions = np.zeros((inputs,) * 3, dtype=np.intp)
    for position, index in enumerate(combinations_with_replacement(range(inputs), 3)):
        for order in permutations(index):
            positions[order] = position
    third = curvature[:, positions][:, :outputs]
    by_loads = symmetric_tangents(wrench, displacement, compliance, space)
    second = np.einsum("noab,nav,nbw->novw", third, change.along, change.along, optimize=True)
    second += np.einsum("noa,navw->novw", by_loads, change.bend)
    # Solved for d2y/dw2, which occurs on both sides through S.
    matrix = np.eye(outputs) - by_loads @ change.by_motion
    return np.linalg.solve(matrix, second.reshape(len(second), outputs, -1)).reshape(second.shape)
