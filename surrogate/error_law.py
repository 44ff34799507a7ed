"""How the error of piecewise linear interpolation grows with the size of a simplex.

Linear interpolation of a function with second derivatives H errs by half the barycentric mean of
(x - x_v)' H (x - x_v) over the vertices x_v. Of the function |x|^2 / 2, whose H is one, that is the
*unit error* S(x) = 1/2 sum_v l_v |x - x_v|^2. So the error of any response is taken for noise of
variance A and curvature of variance C:

    95 % error bar = sqrt(A + C S^2)

A and C come from points left out of the interpolation. Such an error has the noise of the point
besides that of the vertices, which barycentric coordinates l_v weigh: squared errors are fitted by
a (1 + sum_v l_v^2) + c S^2, and a and c multiplied so that the bars hold 95 % of the errors. An
answer has the noise a sum_v l_v^2, at most a.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .calibration import common_quantile, conformal_factor, widening

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


class LeftOutErrors(NamedTuple):
    """Errors at k left-out points within the hull of the others, of q outputs.

    Attributes
    ----------
    size, stated : ndarray, shape (k, q), m and rad
        Absolute errors, and the stated uncertainty that every error bar has besides.
    unit_errors, noise_shares : ndarray, shape (k,), dimensionless
        S, and sum_v l_v^2.
    """

    size: Floats
    stated: Floats
    unit_errors: Floats
    noise_shares: Floats


def error_law(left: LeftOutErrors, least: Floats) -> ErrorLaw:
    """Return the law that holds 95 % of left-out errors, unknown where they are too few.

    Parameters
    ----------
    least : ndarray, shape (q,), m and rad
        The least error bar: rounding.
    """
    if len(left.size) < FEWEST:
        return ErrorLaw.unknown(left.size.shape[1])
    noise, growth = 1.0 + left.noise_shares[:, None], left.unit_errors[:, None] ** 2
    a, c = _variances(left.size**2, noise, growth)
    bars = np.maximum(np.sqrt(a * noise + c * growth), least)
    ratios = np.maximum(left.size - left.stated, 0.0) / np.maximum(bars, np.finfo(float).tiny)
    # Each output by itself, or, where that is more, with the quantile that all have in common.
    sizes = np.sqrt((ratios**2).mean(axis=0))
    common = sizes * common_quantile(ratios, sizes) * widening(len(ratios))
    factor = np.maximum(conformal_factor(ratios), common) ** 2
    return ErrorLaw(np.maximum(factor * a, least**2), factor * c)


def _variances(squares: Floats, noise: Floats, growth: Floats) -> tuple[Floats, Floats]:
    """Fit squared errors (k, q) by a noise + c growth, (k, 1) each, a and c not below zero.

    Least squares, weighted by the inverse square of the variance that the round before fitted:
    squared errors scatter in proportion to their mean. Unweighted, a few large simplices decide for
    all (measured: error bars 1.3 times as wide at 1,000 points).
    """
    size = growth.max()
    if not size > 0:
        return squares.mean(axis=0) / noise.mean(), np.zeros(squares.shape[1])
    t = growth / size
    model = np.tile(squares.mean(axis=0), (len(t), 1))
    a = c = np.zeros(squares.shape[1])
    for _ in range(ROUNDS):
        top = np.maximum(model.max(axis=0), np.finfo(float).tiny)
        weight = (top / np.maximum(model, LEAST_WEIGHT * top)) ** 2
        n0, n1, n2 = (np.sum(weight * one, axis=0) for one in (noise**2, noise * t, t**2))
        y0, y1 = np.sum(weight * noise * squares, axis=0), np.sum(weight * t * squares, axis=0)
        apart = n0 * n2 - n1**2
        tells = apart > ALIKE * n0 * n2
        over = 1.0 / np.where(tells, apart, 1.0)
        a, c = (n2 * y0 - n1 * y1) * over, (n0 * y1 - n1 * y0) * over
        noiseless, level = ~tells | (a < 0), tells & (c < 0)
        a = np.where(noiseless, 0.0, np.where(level, y0 / n0, a))
        c = np.where(noiseless, y1 / n2, np.where(level, 0.0, c))
        model = a * noise + c * t
    return a, c / size
