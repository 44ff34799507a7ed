"""Answers of tables that one dense factor holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .calibration import Calibration, calibrated
from .correlation import (
    Hyperparameters,
    Mask,
    block,
    covariance,
    mean_terms,
)
from .equations import Equations, Scaling
from .factor import KrigingFactor, Share, factorise
from .left_out import left_out
from .neighbourhood import Neighbourhoods, deviations, neighbourhoods_of, row_by_row
from .settings import DEFAULTS, KrigingSettings

# What one covariance times one weight may lose, relative: its squared distance, root, exponential
# and polynomial some units in the last place each. The errors have either sign: sums of compiled
# code and of arrays were apart by up to 2.1 eps times the sum of magnitudes.
LOST = 4 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Dense:
    """The kriging of scaled loads by one factor, or one for each kind of output.

    All numbers are dimensionless: outputs are in spreads.

    Attributes
    ----------
    equations : Equations
    hyperparameters : Hyperparameters
    shares : tuple of Neighbourhoods
    weights : ndarray, shape (n, p, 6), spreads
    coefficients : ndarray, shape (7, 6), spreads
    deviation : ndarray, shape (6,), spreads
        Process standard deviation.
    rounding : ndarray, shape (6,), spreads
        What answers may lose to it: no error bar is smaller.
    errors : ndarray, shape (n, 6), spreads
        Of rows left out, each by itself; NaN where a row does not bring the output.
    calibrations : tuple of Calibration
        One of each of `shares`.
    span : ndarray, shape (2, 6), half ranges
        Ends of the loads that the rows span: beyond them errors are not known.
    """

    equations: Equations
    hyperparameters: Hyperparameters
    shares: tuple[Neighbourhoods, ...]
    weights: Floats
    coefficients: Floats
    deviation: Floats
    rounding: Floats
    errors: Floats
    calibrations: tuple[Calibration, ...]
    span: Floats

    def answers(self, x: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return values, errors, and whether the errors are known, (m, 6) each, at places (m, 6).

        Errors are 95 % error bars; where they are not known, some answers err by more.
        """
        outputs = self.weights.shape[2]
        errors, known = np.empty((len(x), outputs)), np.empty((len(x), outputs), dtype=bool)
        across = block(x, self.equations.x, self.hyperparameters, 1, self.equations.places)
        across = across.reshape(len(x), -1)
        values = row_by_row(across, self.weights.reshape(-1, outputs)) + self.coefficients[0]
        values += row_by_row(x, self.coefficients[1:])
        for share, found in zip(self.shares, self.calibrations, strict=True):
            sigma, own = deviations(x, across, share), share.factor.outputs
            errors[:, own] = sigma[:, None] * found.at(sigma) * self.deviation[own]
            known[:, own] = (sigma <= found.reach)[:, None]
        known &= ((x >= self.span[0]) & (x <= self.span[1])).all(axis=1)[:, None]
        return values, errors, known

    def sigmas_with(self, pending: Floats, x: Floats) -> Floats:
        """Return sigma at places (m, 6) over what it will be once others are solved, (m,).

        The ratio, below 1, is that of the factor that most rows tell of.
        """
        factor = max((share.factor for share in self.shares), key=lambda own: len(own.rows))
        held = self.hyperparameters
        known = np.zeros((len(pending), self.equations.places), dtype=bool)
        known[:, 0] = True
        known[:, 1:] = self.equations.known[:, 1:].any(axis=0)
        value = np.zeros((len(x), self.equations.places), dtype=bool)
        value[:, 0] = True
        new, new_left = self._unexplained(factor, pending, known)
        here, here_left = self._unexplained(factor, x, value)
        within = covariance(pending, known, pending, known, held) - new @ new.T
        within += new_left @ factor.mean_covariance @ new_left.T
        prior = np.tile(held.prior(known.shape[1]), (len(pending), 1))[known]
        within[np.diag_indices_from(within)] += factor.nugget * prior
        between = covariance(x, value, pending, known, held) - here @ new.T
        between += here_left @ factor.mean_covariance @ new_left.T
        before = float(held.prior(1)[0]) - np.einsum("me,me->m", here, here)
        loose = np.einsum("ma,ab,mb->m", here_left, factor.mean_covariance, here_left)
        before = np.maximum(before, factor.nugget) + loose
        won = np.einsum("mp,pm->m", between, np.linalg.solve(within, between.T))
        return np.sqrt(np.clip(1 - won / before, 0.0, 1.0))

    def _unexplained(self, factor: KrigingFactor, x: Floats, known: Mask) -> tuple[Floats, Floats]:
        """Return T times the covariance with places, and of the mean's terms what rows leave."""
        own = self.equations.take(factor.rows)
        reduced = covariance(x, known, own.x, own.known, factor.hyperparameters) @ factor.T.T
        return reduced, mean_terms(x, known) - reduced @ factor.TF


def dense(
    equations: Equations,
    hyperparameters: Hyperparameters,
    shares: list[Share],
    scaling: Scaling,
    settings: KrigingSettings = DEFAULTS,
) -> Dense:
    """Return the dense kriging of a table.

    Parameters
    ----------
    scaling : Scaling
        Tells which loads take part and where no load is.
    """
    x, known, span = equations.x, equations.known, span_of(equations, scaling, settings)
    weights, errors = np.zeros(equations.data.shape), np.full(equations.measured.shape, np.nan)
    coefficients = np.empty((1 + equations.loads, equations.data.shape[2]))
    deviation, rounding = np.empty((2, equations.data.shape[2]))
    spreads: list[Neighbourhoods] = []
    calibrations: list[Calibration] = []
    table = covariance(x, known, x, known, hyperparameters)
    for share in shares:
        factor = factorise(equations, hyperparameters, *share, settings, table)
        own, outputs = neighbourhoods_of(equations, factor, table, settings), factor.outputs
        weights[:, :, outputs] = _of_all_rows(equations, factor)
        coefficients[:, outputs] = factor.coefficients
        deviation[outputs] = np.sqrt(factor.variance)
        rounding[outputs] = rounding_of(equations, table, weights[:, :, outputs])
        alone = left_out(equations, factor, np.arange(len(factor.rows)))
        errors[np.ix_(factor.rows, outputs)] = alone.errors
        spreads.append(own)
        calibrations.append(calibrated(equations, own, table, scaling, span, settings))
    parts = weights, coefficients, deviation, rounding, errors
    return Dense(equations, hyperparameters, tuple(spreads), *parts, tuple(calibrations), span)


def span_of(equations: Equations, scaling: Scaling, settings: KrigingSettings) -> Floats:
    """Return the ends of the loads that rows span, shape (2, 6), half ranges.

    Rows that are spread evenly over an interval leave so much of it beyond the outermost ones, at
    most, at the confidence of the settings: of n uniform numbers the largest is above the part
    a^(1/n) of their interval with the probability 1 - a. A load that takes no part has no ends.
    """
    low, high = equations.x.min(axis=0), equations.x.max(axis=0)
    beyond = (settings.beyond_rows ** (-1 / len(equations)) - 1) * (high - low) + settings.same
    ends = np.stack((low - beyond, high + beyond))
    return np.where(scaling.active, ends, [[-np.inf], [np.inf]])


def _of_all_rows(equations: Equations, factor: KrigingFactor) -> Floats:
    """Return a factor's weights among the readings of all rows, shape (n, p, k), spreads."""
    weights = np.zeros((*equations.known.shape, len(factor.outputs)))
    weights[equations.known & np.isin(np.arange(len(equations)), factor.rows)[:, None]] = (
        factor.weights
    )
    return weights


def rounding_of(equations: Equations, table: Floats, weights: Floats) -> Floats:
    """Return what answers may lose to rounding, shape (k,), spreads: no error bar is smaller.

    Long length scales leave the covariance nearly singular, with weights up to 1e8 times their sum.

    Parameters
    ----------
    table : ndarray, shape (e, e), dimensionless
        The covariance of all e equations.
    weights : ndarray, shape (n, p, k), spreads
    """
    values = np.zeros_like(equations.known)
    values[:, 0] = True
    across = table[values[equations.known]]
    return LOST * (np.abs(across) @ np.abs(weights[equations.known])).max(axis=0)
