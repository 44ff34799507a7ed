"""Answers of tables that one dense factor holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..table.axes import AXES, CLEAN
from ..table.levels import has_levels
from ..table.rows import Floats, LoadRange
from ..table.spread import spread_wrenches
from .calibration import Calibration, Level, calibrate, groupings
from .correlation import (
    LOADS,
    PLACES,
    Hyperparameters,
    Mask,
    block,
    covariance,
    mean_terms,
    numbers,
)
from .equations import OUTPUTS, Equations, Scaling
from .factor import Factor, factorise
from .left_out import left_out
from .neighbourhood import Finder, LocalFactor, local_factor, row_by_row
from .rounding import rounding_of
from .settings import DEFAULTS, KrigingSettings
from .shares import Share

ASKED = 256  # places that stand for what is asked: their median is known to a tenth of its size
# Of the distance within which rows are one: what the span leaves on both sides of a load that no
# row varies, and rounding.
STILL = 2.5


@dataclass(frozen=True)
class Spread:
    """What tells sigma for the outputs of one factor; loads and variances are dimensionless.

    Attributes
    ----------
    factor : Factor
    finder : Finder
    around : tuple of LocalFactor
        The neighbourhood of each of the factor's rows.
    """

    factor: Factor
    finder: Finder
    around: tuple[LocalFactor, ...]


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
        What answers may lose to it: no error bar is smaller.
    errors : ndarray, shape (n, 6), spreads
        Of rows left out, each by itself; NaN where a row does not bring the output.
    calibrations : tuple of Calibration
        One of each of `shares`.
    span : ndarray, shape (2, 6), half ranges
        Ends of the loads that the rows span: beyond them errors are not known.
    """

    equations: Equations
    held: Hyperparameters
    shares: tuple[Spread, ...]
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
        across = block(x, self.equations.x, self.held, slopes_x=False, slopes_v=True)
        across = across.reshape(len(x), -1)
        values = row_by_row(across, self.weights.reshape(-1, OUTPUTS))
        values += self.coefficients[0] + row_by_row(x, self.coefficients[1:])
        errors, known = np.empty((len(x), OUTPUTS)), np.empty((len(x), OUTPUTS), dtype=bool)
        for share, found in zip(self.shares, self.calibrations, strict=True):
            sigma, outputs = deviations(x, across, self.held, share), share.factor.outputs
            errors[:, outputs] = sigma[:, None] * found.at(sigma) * self.deviation[outputs]
            known[:, outputs] = (sigma <= found.reach)[:, None]
        known &= ((x >= self.span[0]) & (x <= self.span[1])).all(axis=1)[:, None]
        return values, errors, known

    def slopes(self, x: Floats) -> Floats:
        """Return the derivatives of the values by the loads at places (m, 6), shape (m, 6, 6)."""
        across = block(x, self.equations.x, self.held, slopes_x=True, slopes_v=True)[:, 1:]
        told = across.reshape(len(x), LOADS, -1) @ self.weights.reshape(-1, OUTPUTS)
        return (told + self.coefficients[1:]).transpose(0, 2, 1)

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


def deviations(x: Floats, across: Floats, held: Hyperparameters, share: Spread) -> Floats:
    """Return the posterior deviation (m,), process deviations, at places (m, 6), of one factor.

    `across` (m, 7 n) is the covariance of their values with all places of all rows.
    """
    terms = np.concatenate((np.ones((len(x), 1)), x), axis=1)
    squared, prior = np.empty(len(x)), float(held.prior[0])
    place = np.searchsorted(share.factor.rows, share.finder.nearest(x))
    for anchor in np.unique(place):
        asked, local = np.flatnonzero(place == anchor), share.around[anchor]
        squared[asked] = local.squared_deviation(
            across[np.ix_(asked, local.places)], terms[asked], prior, share.factor.mean_covariance
        )
    return np.sqrt(squared)


def dense(
    equations: Equations,
    held: Hyperparameters,
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
    table = covariance(equations.x, equations.known, equations.x, equations.known, held)
    spreads = []
    for share in shares:
        factor = factorise(equations, held, *share, settings, table)
        spreads.append(_spread(equations, held, factor, table, settings))
    weights, coefficients, deviation = _together(equations, [own.factor for own in spreads])
    errors = np.full((len(equations), OUTPUTS), np.nan)
    for own in spreads:
        alone = left_out(equations, own.factor, np.arange(len(own.factor.rows)))
        errors[np.ix_(own.factor.rows, own.factor.outputs)] = alone.errors
    span = span_of(equations, scaling, settings)
    return Dense(
        equations,
        held,
        tuple(spreads),
        weights,
        coefficients,
        deviation,
        rounding_of(equations, table, weights),
        errors,
        tuple(_calibrated(equations, held, own, table, scaling, span, settings) for own in spreads),
        span,
    )


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


def _typical_places(span: Floats, full: NDArray[np.bool_], settings: KrigingSettings) -> Floats:
    """Return places as they are asked for: spread over what the rows span, (m, 6), half ranges.

    Where nearly all rows load one axis each, so do these.
    """
    active = np.isfinite(span[0])
    low, high = np.where(active, np.clip(span, -1.0, 1.0), 0.0)
    # A load that no row varies is asked for as the rows have it: off that the mean is unsettled.
    still = high - low <= STILL * settings.same
    low, high = np.where(still, (low + high) / 2, [low, high])
    places = spread_wrenches(LoadRange(low, high), ASKED)
    if full.sum() < min(settings.full_rows, len(full) / 2):
        inputs = [np.isin(np.arange(6), axis.inputs) for axis in AXES]
        places = places * np.stack(inputs)[np.arange(ASKED) % len(AXES)]
    return places


def _calibrated(
    equations: Equations,
    held: Hyperparameters,
    spread: Spread,
    table: Floats,
    scaling: Scaling,
    span: Floats,
    settings: KrigingSettings,
) -> Calibration:
    """Return by how much a share's deviations are multiplied for its error bars."""
    own, outputs = equations.take(spread.factor.rows), len(spread.factor.outputs)
    if not own.known[:, 1:].any() and not has_levels(own.x[:, scaling.active]):
        return Calibration.unknown(outputs, settings)
    at_rest = scaling.loads(np.zeros((1, LOADS)))
    loaded = np.abs(own.x - at_rest) > CLEAN
    full = ~np.any([~loaded[:, axis.others].any(axis=1) for axis in AXES], axis=0)
    # What is asked loads all axes too, and rows at the corners of one axis err more.
    rows = np.flatnonzero(full) if full.sum() >= settings.full_rows else np.arange(len(own))
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), settings.left_out_rows))
    rows = rows[np.unique(chosen.round().astype(np.intp))]
    levels = (
        level
        for labels in groupings(own.x * np.sqrt(held.inverse_squares), settings)
        if (level := _level(equations, held, spread, table, labels, rows, settings)) is not None
    )
    asked = _typical_places(span, full, settings)
    across = block(asked, equations.x, held, slopes_x=False, slopes_v=True)
    sigma = deviations(asked, across.reshape(len(asked), -1), held, spread)
    # The mean's coefficients, which all rows settle: these in proportion.
    coefficients = (1 + scaling.active.sum()) * len(rows) / len(own)
    return calibrate(levels, outputs, sigma, coefficients, settings)


def _level(
    equations: Equations,
    held: Hyperparameters,
    spread: Spread,
    table: Floats,
    labels: NDArray[np.intp],
    rows: NDArray[np.intp],
    settings: KrigingSettings,
) -> Level | None:
    """Return what some of a factor's rows show, left out in groups; None if they show nothing.

    The errors are those of the whole factor; sigma is from the neighbourhood of the nearest row
    left, without the group, since that is what an answer's error bar is made of.
    """
    factor, prior = spread.factor, float(held.prior[0])
    if len(np.unique(labels)) < 2:
        return None
    out = left_out(equations, factor, labels)
    anchors = spread.finder.nearest_others(rows, equations.x, labels)
    noise, number = _noise(equations, factor), numbers(equations.known)
    # What was found to be noise may be response that the kernel does not follow: bars hold it.
    unstated = np.asarray((equations.readings[:, factor.outputs] > 0).any(axis=1))
    stated = np.where(unstated, 0.0, noise)
    squared = np.full(len(rows), np.nan)
    lists = spread.finder.members(equations.x[anchors], labels, labels[rows])
    for place, (row, members) in enumerate(zip(factor.rows[rows], lists, strict=True)):
        local = local_factor(equations, noise, held, members, factor.nugget, settings, table)
        told = number[members][equations.known[members]]
        found = local.squared_deviation(
            table[np.ix_(number[row, :1], told)],
            np.append(1.0, equations.x[row])[None],
            prior,
            out.mean_covariances[rows[place]],
        )
        squared[place] = found[0] + stated[row] + factor.nugget * prior
    # With hardly more rows than the mean has terms, rounding leaves no variance to speak of.
    finite = np.isfinite(out.errors[rows]).all(axis=1)
    known = np.flatnonzero((squared > 0) & finite)
    if not len(known):
        return None
    sigma, errors = np.sqrt(squared[known]), out.errors[rows[known]] / np.sqrt(factor.variance)
    alone = np.abs(errors) / sigma[:, None]
    by_value = unstated[factor.rows[rows[known]]][:, None]
    sizes = np.where(by_value, alone, out.sizes[rows[known]])
    return Level(labels[rows[known]], errors, sizes, sigma)


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


def _spread(
    equations: Equations,
    held: Hyperparameters,
    factor: Factor,
    table: Floats,
    settings: KrigingSettings,
) -> Spread:
    """Return the neighbourhoods of a factor's rows."""
    limits = settings.deviation_rows, settings.deviation_equations
    finder = Finder(equations, factor.rows, held, *limits)
    noise = _noise(equations, factor)
    around = tuple(
        local_factor(equations, noise, held, members, factor.nugget, settings, table)
        for members in finder.members(equations.x[factor.rows])
    )
    return Spread(factor, finder, around)


def _noise(equations: Equations, factor: Factor) -> Floats:
    """Return the noise of every row of the table, zero where the factor has none."""
    noise = np.zeros(len(equations))
    noise[factor.rows] = factor.noise
    return noise
