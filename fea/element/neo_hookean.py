"""Cells of a neo-Hookean material: rubber.

The energy per undeformed volume is that of CalculiX's *HYPERELASTIC, NEO HOOKE,

    W = mu/2 (J^(-2/3) tr C - 3) + kappa/2 (J - 1)^2,     C10 = mu/2, D1 = 2/kappa,

with mu and kappa those of Young's modulus and Poisson's ratio at small strains, so that a linear
analysis is that of the isotropic material. S and its moduli are Bonet and Wood's ("Nonlinear
continuum mechanics for finite element analysis", 2008, section 6.5) in a form that keeps its digits
at small strains: with C = I + 2 E

    S = 2 mu J^(-2/3) C^-1 dev(E) + p J C^-1,        p = kappa (J - 1).

Third derivatives along strains E_a: with X_a = C^-1 E_a, t_a = tr X_a, p_ab = tr(X_a X_b) and
q_abc = tr(X_a X_b X_c), ln J has t_a, -2 p_ab and 8 q_abc, from which those of J and J^(-2/3)
follow, and tr C has 2 tr E_a alone. `third_of_law` has those of W.

Cells that project (`fea.element.pressure_projection`) take the projection of J - 1 in lambda's part
of kappa = lambda + 2 mu/3, as isotropic cells do with tr(E): the mean dilatation of Simo, Taylor
and Pister (1985) with a linear pressure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.element.cell_state import (
    UNIT_STRAINS,
    CellState,
    DenseState,
    Which,
    green_strain,
    symmetrised,
)
from wrenchbook.fea.element.st_venant_kirchhoff import IsotropicStiffness, projected_gram, weighted
from wrenchbook.fea.tensors import COLUMNS, ROWS, deviator


@dataclass(frozen=True, eq=False)
class NeoHookeanStiffness(IsotropicStiffness):
    """Neo-Hookean cells of one block; first_lame and shear are those at small strains."""

    def state(self, part: Which, displacement: np.ndarray | None) -> CellState:
        """Return strains and stresses, displacements of shape (cells, 3, nodes), m."""
        if displacement is None:
            return super().state(part, None)
        return _State(self, part, displacement)


class _State(DenseState):
    """Strains and stresses of a few cells; see `CellState` for H, F, E and wS.

    growth, J, mean_C, inverse: J - 1 with all its digits, J, tr C / 3 and C^-1, dimensionless.
    scale, pressure, deviatoric: mu J^(-2/3), p and S without p, times the weights, Pa m^3.
    Shapes: (cells, points), with (3, 3) of matrices; shear and first_lame (cells, 1), Pa.
    """

    def __init__(self, cells: NeoHookeanStiffness, part: Which, displacement: np.ndarray) -> None:
        super().__init__(cells.gradients, part, displacement)
        self._cells = cells
        self._part = part
        self.shear = cells.shear[part, None]
        self.first_lame = cells.first_lame[part, None]
        self.modes = cells.modes_of(part)
        trace = np.trace(self.H, axis1=-2, axis2=-1)
        minors = 0.5 * (trace**2 - np.sum(self.H * self.H.swapaxes(-1, -2), axis=(-2, -1)))
        self.growth = trace + minors + np.linalg.det(self.H)  # J - 1
        self.J = 1.0 + self.growth
        self.inverse = np.linalg.inv(np.eye(3) + 2.0 * self.E)
        self.mean_C = 1.0 + 2.0 / 3.0 * np.trace(self.E, axis1=-2, axis2=-1)
        # A cell turned inside out has no energy: not a number, which Newton's method takes as such.
        with np.errstate(invalid="ignore", divide="ignore"):
            self.scale = self.weights * self.shear * np.exp(-2.0 / 3.0 * np.log1p(self.growth))
        self.pressure = self._pressure_of(self.growth)
        self.deviatoric = 2.0 * _times(self.scale, self.inverse @ deviator(self.E))
        self.wS = self.deviatoric + _times(self.pressure * self.J, self.inverse)

    def extrapolate(self, step: np.ndarray) -> None:
        """Replace the stress and the pressure by their linear extrapolations.

        The pressure in the moduli too: with the true forces this is Newton's method for
        displacement and pressure as separate unknowns, the pressure condensed. The pressure of
        the new state itself is off by kappa times the square of the step, which at a ratio of
        0.4999 takes the iteration ten times as many steps.
        """
        aim, change = step
        before = _State(self._cells, self._part, aim - change)
        slope = self.gradient(change)
        aimed = green_strain(self.gradient(aim)) - 0.5 * (slope.swapaxes(2, 3) @ slope)
        strain = aimed - before.E
        along = before._along(strain)
        self.pressure = before.pressure + before._pressure_of(before.J * along)
        inside = before._sandwiched(strain)
        deviatoric = before.deviatoric + before._deviatoric_change(strain, along, inside)
        self.wS = deviatoric + _times(self.pressure * self.J, self.inverse)

    def weighted_change(self, strain: np.ndarray) -> np.ndarray:
        along = self._along(strain)
        pressure = self._pressure_of(self.J * along)
        return self._at_pressure(strain, along) + _times(pressure * self.J, self.inverse)

    def third_of_law(self, fields: np.ndarray, strain: np.ndarray) -> np.ndarray:
        """Return the third derivatives of W along strains: shape (k, k, k), J.

        With g = mu J^(-2/3), m = tr C / 3, s_a = tr E_a, P_a = J kappa J t_a and the module's t_a,
        p_ab and q_abc they are, integrated, with sums over the three choices of c:
            8 (p J - g m) q_abc + sum t_a t_b ((p J - 4/9 g m) t_c / 3 + 4/9 g s_c + P_c)
            + sum p_ab (4/3 g (s_c - m t_c) - 2 (p J t_c + P_c))
        """
        # X_a, X_a X_b, and the traces t_a, s_a and p_ab
        count = len(fields)
        X = self.inverse @ strain
        rows = X.swapaxes(-1, -2).reshape(count, -1)
        XX = X[:, None] @ X
        t, s, p = (np.trace(tensor, axis1=-2, axis2=-1) for tensor in (X, strain, XX))
        # g m, p J and P_c times the weights, and the factors of t_a t_b and of p_ab
        gm = self.scale * self.mean_C
        pJ = self.pressure * self.J
        P = self.J * self._pressure_of(self.J * t)
        of_tt = (pJ - 4.0 / 9.0 * gm) / 3.0 * t + 4.0 / 9.0 * self.scale * s + P
        of_p = 4.0 / 3.0 * (self.scale * s - gm * t) - 2.0 * (pJ * t + P)
        # The term of q_abc, which is symmetric, and the sums over the points of the other two
        of_q = _times(8.0 * (pJ - gm), XX).reshape(count, count, -1) @ rows.T
        pairs = np.stack([t[:, None] * t, p]).reshape(2, count, count, -1)
        sums = pairs @ np.stack([of_tt, of_p]).reshape(2, 1, count, -1).swapaxes(-1, -2)
        return of_q + symmetrised(np.asarray(sums.sum(axis=0)))

    def _pressure_of(self, growth: np.ndarray) -> np.ndarray:
        """Return the pressure of J - 1, shape (..., cells, points), times the weights."""
        projected = self.first_lame * weighted(growth, self.weights, self.modes)
        return projected + self._local_pressure_of(growth)

    def _local_pressure_of(self, growth: np.ndarray) -> np.ndarray:
        """Return the part of `_pressure_of` that is not projected."""
        return 2.0 / 3.0 * self.shear * self.weights * growth

    def _along(self, strain: np.ndarray) -> np.ndarray:
        """Return the change of ln J along strains, tr(C^-1 E): shape (..., cells, points)."""
        return np.sum(self.inverse * strain, axis=(-2, -1))

    def _sandwiched(self, strain: np.ndarray) -> np.ndarray:
        """Return C^-1 E C^-1, minus half the change of C^-1 along E: the shape of `strain`."""
        return self.inverse @ strain @ self.inverse

    def _at_pressure(self, strain: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Return the change of `wS` along E while the pressure stays; `along` is `_along` of it."""
        inside = self._sandwiched(strain)
        pressed = _times(along, self.inverse) - 2.0 * inside
        deviatoric = self._deviatoric_change(strain, along, inside)
        return deviatoric + _times(self.pressure * self.J, pressed)

    def _deviatoric_change(
        self, strain: np.ndarray, along: np.ndarray, inside: np.ndarray
    ) -> np.ndarray:
        """Return the change along E of `deviatoric`, by `_along` and `_sandwiched` of E."""
        trace = np.trace(strain, axis1=-2, axis2=-1)
        deviatoric = _times(self.mean_C, inside) - _times(along / 3.0, np.eye(3))
        deviatoric += _times(self.mean_C * along / 3.0 - trace / 3.0, self.inverse)
        return 2.0 * _times(self.scale, deviatoric)

    def moduli(self) -> np.ndarray:
        strains = np.broadcast_to(UNIT_STRAINS[:, None, None], (6, *self.E.shape))
        # A projected pressure has no modulus at a point: see `tangent`.
        pressure_of = self._pressure_of if self.modes is None else self._local_pressure_of
        along = self._along(strains)
        pressure = pressure_of(self.J * along)
        changes = self._at_pressure(strains, along) + _times(pressure * self.J, self.inverse)
        return np.moveaxis(changes[..., ROWS, COLUMNS], 0, -1)

    def tangent(self, out: np.ndarray) -> None:
        super().tangent(out)
        if self.modes is not None:
            cells, points, _, nodes = self.slopes.shape
            g = _times(self.J, np.linalg.inv(self.F).swapaxes(2, 3)) @ self.slopes
            gram = projected_gram(self.modes, g.reshape(cells, points, 3 * nodes))
            out += self.first_lame[..., None] * gram

    def energy(self) -> float:
        """Return the energy; its first part from C = (tr C / 3)(I + 2 e) with tr e = 0.

        J^(-2/3) tr C / 3 = det(I + 2 e)^(-1/3), and det(I + 2 e) = 1 - 2 e:e + 8 det e.
        """
        e = _times(1.0 / self.mean_C, deviator(self.E))
        less = 8.0 * np.linalg.det(e) - 2.0 * np.sum(e * e, axis=(-2, -1))
        density = 1.5 * self.shear * np.expm1(-np.log1p(less) / 3.0)
        density = np.where(self.J > 0.0, density, np.nan)
        return float(np.vdot(self.weights, density) + 0.5 * np.vdot(self.pressure, self.growth))


def _times(factor: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Multiply matrices, shape (..., 3, 3), by numbers, shape (...)."""
    return factor[..., None, None] * matrices
