"""Made-up parts whose displacements are the gradient of an energy, with all that solves bring.

The complementary energy is a quadratic and a sum of functions of single combinations of the scaled
loads, so its third derivatives stand in closed form. Rows are made at loads (F, mu) by which the
energy is written; their wrenches (F, M) follow from the rotation.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from tests.surrogate.responses import HIGH
from wrenchbook.surrogate.table.rows import Rows
from wrenchbook.surrogate.table.second_derivatives import moment_map

Slopes = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""From combinations of loads to the first three derivatives of their energy."""


def stiffening(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    root = np.sqrt(1 + s**2)
    return np.arcsinh(s), 1 / root, -s / root**3


def saturating(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first = np.tanh(s)
    second = 1 - first**2
    return first, second, -2 * first * second


def waving(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.sin(1.5 * s), 1.5 * np.cos(1.5 * s), -2.25 * np.sin(1.5 * s)


def rising(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first = np.exp(1.5 * (s - 1))
    return first, 1.5 * first, 2.25 * first


class Part(NamedTuple):
    """A part by its energy; lengths, translations in m and rotations in rad are of one size.

    Attributes
    ----------
    stiff : ndarray, shape (6, 6)
        Of the quadratic, by scaled loads.
    directions : ndarray, shape (k, 6)
        Combinations of the scaled loads.
    slopes : callable
    size : float
        Energy of one combination, J.
    """

    stiff: np.ndarray
    directions: np.ndarray
    slopes: Slopes
    size: float

    def rows(self, parts: np.ndarray, *, second: bool = True) -> Rows:
        """Return rows at scaled loads (F, mu), shape (n, 6), as solves write them."""
        first, bend, third = self.slopes(parts @ self.directions.T)
        a = self.directions
        displacement = (parts @ self.stiff + self.size * first @ a) / HIGH
        by_q = (self.stiff + self.size * np.einsum("nk,ka,kb->nab", bend, a, a)) / HIGH[:, None]
        by_q /= HIGH
        tensor = self.size * np.einsum("nk,ka,kb,kc->nabc", third, a, a, a)
        chosen = tuple(np.array(list(combinations_with_replacement(range(6), 3))).T)
        curvature = (tensor / (HIGH[:, None, None] * HIGH[:, None] * HIGH))[:, *chosen]
        # M = J(r)^-T mu, and C = (1 - C_q S)^-1 C_q B
        unit = moment_map(displacement[:, None, 3:], np.eye(3))
        J = unit.value
        moment = np.linalg.solve(np.swapaxes(J, 1, 2), (parts * HIGH)[:, 3:, None])[..., 0]
        by_load, by_motion = np.tile(np.eye(6), (2, len(parts), 1, 1))
        by_motion[:] = 0.0
        by_load[:, 3:, 3:] = np.swapaxes(J, 1, 2)
        by_motion[:, 3:, 3:] = np.einsum("nk,nkia->nia", moment, unit.by_rotation)
        compliance = np.linalg.solve(np.eye(6) - by_q @ by_motion, by_q @ by_load)
        wrench = np.concatenate((parts[:, :3] * HIGH[:3], moment), axis=1)
        known = {"curvature": curvature} if second else {}
        source = ["fea"] * len(parts)
        return Rows.of(wrench, displacement, compliance=compliance, source=source, **known)


def part(slopes: Slopes, seed: int, nonlinear: float = 0.3, count: int = 8) -> Part:
    """Return a part whose nonlinear combinations have some loads each."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(6, 6)) * 0.3
    stiff = 0.02 * HIGH.max() * 1e-3 * (np.eye(6) + spread @ spread.T)
    directions = rng.normal(size=(count, 6)) * (rng.uniform(size=(count, 6)) < 0.6)
    size = nonlinear * 0.02 * HIGH.max() * 1e-3
    return Part(stiff, directions, slopes, size)


PARTS = {item.__name__: item for item in (stiffening, saturating, waving, rising)}
