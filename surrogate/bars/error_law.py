"""How the error of piecewise linear interpolation grows with the size of a simplex.

Linear interpolation of a function with second derivatives H errs by half the barycentric mean of
(x - x_v)' H (x - x_v) over the vertices x_v. Of the function |x|^2 / 2, whose H is one, that is the
*unit error* S(x) = 1/2 sum_v l_v |x - x_v|^2. So the error of any response is taken for noise of
variance A and curvature of variance C:

    95 % error bar = sqrt(A + C S^2)

A and C come from points left out of the interpolation: their squared errors, fitted by a + c S^2,
and multiplied so that the bars hold 95 % of the errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conformal import conformal_factor

Floats = NDArray[np.float64]

FEWEST = 5  # left-out errors; the conformal factor of five is already 2.2 times the largest ratio
ROUNDS = 10  # of reweighting: the fit changes by less than a part in 100 after five
LEAST_WEIGHT = 1e-6  # of the largest variance: what rounding leaves of small ones fits nothing
ALIKE = 1e-12  # of its largest value, a determinant that tells A from C no more


@dataclass(frozen=True)
class ErrorLaw:
    """The error bars sqrt(A + C S^2) of several outputs.

    Attributes
    ----------
    noise_variance, curvature_variance : ndarray, shape (q,), m² and rad²
        A and C, NaN where errors are unknown. They are of 95 % error bars, not of deviations.
    """

    noise_variance: Floats
    curvature_variance: Floats

    @classmethod
    def unknown(cls, outputs: int = 6) -> ErrorLaw:
        """Return the law of outputs whose errors are not known."""
        return cls(np.full(outputs, np.nan), np.full(outputs, np.nan))

    @property
    def known(self) -> bool:
        """Whether the errors of all outputs are known."""
        return bool(np.isfinite(self.noise_variance).all())

    def bars(self, unit_error: Floats) -> Floats:
        """Return error bars (k, q), m and rad, at unit errors (k,), dimensionless."""
        return np.sqrt(self.noise_variance + self.curvature_variance * unit_error[:, None] ** 2)


def error_law(errors: Floats, unit_errors: Floats, stated: Floats, least: Floats) -> ErrorLaw:
    """Return the law that holds 95 % of left-out errors, unknown where they are too few.

    Parameters
    ----------
    errors, stated : ndarray, shape (k, q), m and rad
        Absolute errors, and the stated uncertainty that every error bar has besides.
    unit_errors : ndarray, shape (k,), dimensionless
    least : ndarray, shape (q,), m and rad
        The least error bar: rounding.
    """
    if len(errors) < FEWEST:
        return ErrorLaw.unknown(errors.shape[1])
    law = ErrorLaw(*_variances(errors**2, unit_errors**2))
    bars = np.maximum(law.bars(unit_errors), least)
    factor = conformal_factor(np.maximum(errors - stated, 0.0), bars) ** 2
    noise = np.maximum(factor * law.noise_variance, least**2)
    return ErrorLaw(noise, factor * law.curvature_variance)


def _variances(squares: Floats, growth: Floats) -> tuple[Floats, Floats]:
    """Fit squared errors (k, q) by a + c growth, growth (k,), neither below zero; return a and c.

    Least squares, weighted by the inverse square of the variance that the round before fitted:
    squared errors scatter in proportion to their mean. Unweighted, a few large simplices decide for
    all (measured: error bars 1.3 times as wide at 1,000 points).
    """
    size = growth.max()
    if not size > 0:
        return squares.mean(axis=0), np.zeros(squares.shape[1])
    t = growth[:, None] / size
    model = np.tile(squares.mean(axis=0), (len(t), 1))
    a = c = np.zeros(squares.shape[1])
    for _ in range(ROUNDS):
        least = np.maximum(LEAST_WEIGHT * model.max(axis=0), np.finfo(float).tiny)
        weight = (model.max(axis=0).clip(np.finfo(float).tiny) / np.maximum(model, least)) ** 2
        n0, n1, n2 = (np.sum(weight * t**power, axis=0) for power in range(3))
        y0, y1 = np.sum(weight * squares, axis=0), np.sum(weight * t * squares, axis=0)
        apart = n0 * n2 - n1**2
        tells = apart > ALIKE * n0 * n2
        over = 1.0 / np.where(tells, apart, 1.0)
        a, c = (n2 * y0 - n1 * y1) * over, (n0 * y1 - n1 * y0) * over
        straight, level = ~tells | (a < 0), tells & (c < 0)
        a = np.where(straight, 0.0, np.where(level, y0 / n0, a))
        c = np.where(straight, y1 / n2, np.where(level, 0.0, c))
        model = a + c * t
    return a, c / size
