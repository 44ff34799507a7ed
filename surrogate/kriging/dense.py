"""Answers of tables that one dense factor holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .correlation import (
    PLACES,
    Hyperparameters,
    Mask,
    block,
    covariance,
    mean_terms,
    numbers,
)
from .equations import OUTPUTS, Equations
from .factor import Factor, border, factorise
from .left_out import LeftOut, left_out
from .neighbourhood import Finder, LocalFactor, local_factor
from .rounding import rounding_of
from .settings import DEFAULTS, KrigingSettings
from .shares import Share


@dataclass(frozen=True)
class Spread:
    """What tells sigma for the outputs of one factor; loads and variances are dimensionless.

    Attributes
    ----------
    factor : Factor
    finder : Finder
    around : tuple of LocalFactor
        The neighbourhood of each anchor.
    anchors : ndarray of int, shape (k,)
        Rows that are the nearest one of some wrench: all of the factor's, or a scene's.
    """

    factor: Factor
    finder: Finder
    around: tuple[LocalFactor, ...]
    anchors: NDArray[np.intp]


@dataclass(frozen=True)
class Dense:
    """The kriging of scaled loads by one factor, or one for each kind of output.

    All numbers are dimensionless: outputs are in spreads.

    Attributes
    ----------
    equations : Equations
    held : Hyperparameters
    shares : tuple of Spread
    weights : ndarray, shape (n, 7, 6), spreads
    coefficients : ndarray, shape (7, 6), spreads
    deviation : ndarray, shape (6,), spreads
        Process standard deviation.
    rounding : ndarray, shape (6,), spreads
        What answers may lose to it: no bar is smaller.
    rows : ndarray of int, shape (k,)
        Rows left out.
    errors, deviations : ndarray, shape (k, 6), spreads
        Of these; NaN where a row does not bring the output.
    sizes : ndarray, shape (k, 6), dimensionless
        Root mean square of errors over deviations, of values and slopes; NaN likewise.
    """

    equations: Equations
    held: Hyperparameters
    shares: tuple[Spread, ...]
    weights: Floats
    coefficients: Floats
    deviation: Floats
    rounding: Floats
    rows: NDArray[np.intp]
    errors: Floats
    deviations: Floats
    sizes: Floats

    def answers(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return values and sigmas (m, 6) and slopes (m, outputs, loads) at places (m, 6)."""
        across = block(x, self.equations.x, self.held, slopes_x=True, slopes_v=True)
        across = across.reshape(len(x), PLACES, -1)
        told = across @ self.weights.reshape(-1, OUTPUTS)
        values = told[:, 0] + self.coefficients[0] + x @ self.coefficients[1:]
        slopes = told[:, 1:] + self.coefficients[1:]
        return values, self._sigmas(x, across[:, 0]), slopes.transpose(0, 2, 1)

    def _sigmas(self, x: Floats, across: Floats) -> Floats:
        """Return the posterior deviation at places (m, 6), shape (m, 6), spreads.

        `across` (m, 7 n) is the covariance of their values with all places of all rows.
        """
        out = np.empty((len(x), OUTPUTS))
        terms = np.concatenate((np.ones((len(x), 1)), x), axis=1)
        prior = float(self.held.prior[0])
        for share in self.shares:
            squared = np.empty(len(x))
            place = np.searchsorted(share.anchors, share.finder.nearest(x))
            for anchor in np.unique(place):
                asked, local = np.flatnonzero(place == anchor), share.around[anchor]
                squared[asked] = local.squared_deviation(
                    across[np.ix_(asked, local.places)],
                    terms[asked],
                    prior,
                    share.factor.mean_covariance,
                )
            sigma = np.sqrt(squared)[:, None] * self.deviation[share.factor.outputs]
            out[:, share.factor.outputs] = sigma
        return out

    def sigmas_with(self, pending: Floats, x: Floats) -> Floats:
        """Return sigma at places (m, 6) over what it will be once others are solved, shape (m,).

        The ratio, below 1, is of the whole factor of the outputs that most rows tell.
        """
        factor = max((share.factor for share in self.shares), key=lambda own: len(own.rows))
        known = np.zeros((len(pending), PLACES), dtype=bool)
        known[:, 0] = True
        known[:, 1:] = self.equations.known[:, 1:].any(axis=0)
        value = np.zeros((len(x), PLACES), dtype=bool)
        value[:, 0] = True
        new, new_left = self._unexplained(factor, pending, known)
        here, here_left = self._unexplained(factor, x, value)
        within = covariance(pending, known, pending, known, self.held) - new @ new.T
        within += new_left @ factor.mean_covariance @ new_left.T
        prior = np.tile(self.held.prior, (len(pending), 1))[known]
        within[np.diag_indices_from(within)] += factor.nugget * prior
        between = covariance(x, value, pending, known, self.held) - here @ new.T
        between += here_left @ factor.mean_covariance @ new_left.T
        before = float(self.held.prior[0]) - np.einsum("me,me->m", here, here)
        loose = np.einsum("ma,ab,mb->m", here_left, factor.mean_covariance, here_left)
        before = np.maximum(before, factor.nugget) + loose
        won = np.einsum("mp,pm->m", between, np.linalg.solve(within, between.T))
        return np.sqrt(np.clip(1 - won / before, 0.0, 1.0))

    def _unexplained(self, factor: Factor, x: Floats, known: Mask) -> tuple[Floats, Floats]:
        """Return T times the covariance with places, and of the mean's terms what rows leave."""
        own = self.equations.take(factor.rows)
        reduced = covariance(x, known, own.x, own.known, self.held) @ factor.T.T
        return reduced, mean_terms(x, known) - reduced @ factor.TF


def dense(
    equations: Equations,
    held: Hyperparameters,
    shares: list[Share],
    before: Dense | None = None,
    settings: KrigingSettings = DEFAULTS,
) -> Dense:
    """Return the dense kriging of a table.

    Parameters
    ----------
    before : Dense, optional
        Of the table's first rows, with the same hyperparameters, scaling and shares: its factors
        are bordered.
    """
    table = covariance(equations.x, equations.known, equations.x, equations.known, held)
    spreads = []
    for number, share in enumerate(shares):
        known = before.shares[number] if before else None
        factor = _factor(equations, held, share, table, known, settings)
        spreads.append(_spread(equations, held, factor, table, known, settings))
    weights, coefficients, deviation = _together(equations, [own.factor for own in spreads])
    return Dense(
        equations,
        held,
        tuple(spreads),
        weights,
        coefficients,
        deviation,
        rounding_of(equations, table, weights),
        *_all_left_out(equations, held, spreads, table, settings),
    )


def _all_left_out(
    equations: Equations,
    held: Hyperparameters,
    spreads: list[Spread],
    table: Floats,
    settings: KrigingSettings,
) -> tuple[NDArray[np.intp], Floats, Floats, Floats]:
    """Return the rows left out (k,), their errors, deviations and sizes (k, 6)."""
    errors = np.full((len(equations), OUTPUTS), np.nan)
    deviations, sizes = errors.copy(), errors.copy()
    for spread in spreads:
        out, squared = _left_out(equations, held, spread, table, settings)
        # With hardly more rows than the mean has terms, rounding leaves no variance to speak of:
        # such a row says nothing.
        squared[~(squared > 0)] = np.nan
        places = np.ix_(out.rows, spread.factor.outputs)
        errors[places] = np.where(np.isnan(squared)[:, None], np.nan, out.errors)
        deviations[places] = np.sqrt(squared)[:, None] * np.sqrt(spread.factor.variance)
        unstated = (equations.readings[places] > 0).any(axis=1, keepdims=True)
        alone = np.abs(errors[places]) / deviations[places]
        sizes[places] = np.where(unstated, alone, out.sizes)
    told = np.flatnonzero(np.isfinite(errors).any(axis=1))
    return told, errors[told], deviations[told], sizes[told]


def _together(equations: Equations, factors: list[Factor]) -> tuple[Floats, Floats, Floats]:
    """Return weights (n, 7, 6), coefficients (7, 6) and process deviations (6,) of all outputs."""
    weights = np.zeros((len(equations), PLACES, OUTPUTS))
    coefficients, deviation = np.empty((PLACES, OUTPUTS)), np.empty(OUTPUTS)
    for factor in factors:
        own = equations.known & np.isin(np.arange(len(equations)), factor.rows)[:, None]
        for column, output in enumerate(factor.outputs):
            weights[own, output] = factor.weights[:, column]
        coefficients[:, factor.outputs] = factor.coefficients
        deviation[factor.outputs] = np.sqrt(factor.variance)
    return weights, coefficients, deviation


def _factor(
    equations: Equations,
    held: Hyperparameters,
    share: Share,
    table: Floats,
    before: Spread | None,
    settings: KrigingSettings,
) -> Factor:
    """Return a share's factor, bordered where all but some last rows are in one already."""
    if before is None:
        return factorise(equations, held, *share, settings, table)
    added = share.rows[len(before.factor.rows) :]
    if not len(added):
        return before.factor
    return border(before.factor, equations, held, added, share.noise[-len(added) :], settings)


def _spread(
    equations: Equations,
    held: Hyperparameters,
    factor: Factor,
    table: Floats,
    before: Spread | None,
    settings: KrigingSettings,
) -> Spread:
    """Return the neighbourhoods of a factor's rows; those that have not changed are kept."""
    limits = settings.deviation_rows, settings.deviation_equations
    finder = Finder(equations, factor.rows, held, *limits)
    noise = _noise(equations, factor)
    kept = {own.members.tobytes(): own for own in before.around} if before else {}
    around = []
    for members in finder.members(equations.x[factor.rows]):
        own = kept.get(members.tobytes())
        if own is None:
            own = local_factor(equations, noise, held, members, factor.nugget, settings, table)
        around.append(own)
    return Spread(factor, finder, tuple(around), factor.rows)


def _noise(equations: Equations, factor: Factor) -> Floats:
    """Return the noise of every row of the table, zero where the factor has none."""
    noise = np.zeros(len(equations))
    noise[factor.rows] = factor.noise
    return noise


def _left_out(
    equations: Equations,
    held: Hyperparameters,
    spread: Spread,
    table: Floats,
    settings: KrigingSettings,
) -> tuple[LeftOut, Floats]:
    """Return the rows left out and sigma squared (k,) as an answer there would tell it.

    The errors are those of the whole factor; sigma is from the neighbourhood of the nearest row
    left, without the row itself, since that is what an answer's bar is made of.
    """
    factor, prior = spread.factor, float(held.prior[0])
    out = left_out(equations, factor, settings)
    anchors = spread.finder.nearest_others(out.rows, equations.x)
    noise, number = _noise(equations, factor), numbers(equations.known)
    # What was found to be noise may be response that the kernel does not follow: bars hold it.
    stated = np.where((equations.readings[:, factor.outputs] > 0).any(axis=1), 0.0, noise)
    squared = np.empty(len(out.rows))
    lists = spread.finder.members(equations.x[anchors], without=out.rows)
    for place, (row, members) in enumerate(zip(out.rows, lists, strict=True)):
        local = local_factor(equations, noise, held, members, factor.nugget, settings, table)
        told = number[members][equations.known[members]]
        found = local.squared_deviation(
            table[np.ix_(number[row, :1], told)],
            np.append(1.0, equations.x[row])[None],
            prior,
            out.mean_covariances[place],
        )
        squared[place] = found[0] + stated[row] + factor.nugget * prior
    return out, squared
