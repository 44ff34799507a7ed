"""Answers of tables too large for one factor: each from the rows around it.

The mean and the process variances come from rows spread widely over the table; an answer is the
mean, and the kriging of what it leaves at the nearest rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .correlation import (
    PLACES,
    Hyperparameters,
    block,
)
from .equations import OUTPUTS, Equations
from .factor import Factor, factorise
from .neighbourhood import Finder, LocalFactor, local_factor
from .settings import DEFAULTS, KrigingSettings
from .shares import Share
from .spread_rows import spread_rows


@dataclass(frozen=True)
class Region:
    """What answers the outputs of one share.

    Attributes
    ----------
    mean : Factor
        Over rows spread widely: the mean and the process variances.
    finder : Finder
    noise : ndarray, shape (n,), dimensionless
        Of every row of the table, over the process variance.
    """

    mean: Factor
    finder: Finder
    noise: Floats


@dataclass(frozen=True)
class Nearest:
    """The kriging of scaled loads by the nearest rows.

    All numbers are dimensionless: outputs are in spreads.

    Attributes
    ----------
    equations : Equations
    held : Hyperparameters
    shares : tuple of Region
    deviation : ndarray, shape (6,), spreads
        Process standard deviation.
    rows : ndarray of int, shape (k,)
        Rows left out.
    errors, deviations : ndarray, shape (k, 6), spreads
        Of these; NaN where a row does not bring the output.
    settings : KrigingSettings
    """

    equations: Equations
    held: Hyperparameters
    shares: tuple[Region, ...]
    deviation: Floats
    rows: NDArray[np.intp]
    errors: Floats
    deviations: Floats
    settings: KrigingSettings

    @property
    def rounding(self) -> Floats:
        """What is known to be lost to rounding, shape (6,), dimensionless: nothing here.

        The weights of so few rows are smaller, and sigma's least is above what their sums lose.
        """
        return np.zeros(OUTPUTS)

    @property
    def sizes(self) -> Floats:
        """Errors over deviations, of the values alone, shape (k, 6), dimensionless."""
        return np.abs(self.errors) / self.deviations

    def answers(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return values and sigmas (m, 6) and slopes (m, outputs, loads) at places (m, 6)."""
        told, sigma = np.empty((len(x), PLACES, OUTPUTS)), np.empty((len(x), OUTPUTS))
        for region in self.shares:
            anchors = region.finder.nearest(x)
            each, inverse = np.unique(anchors, return_inverse=True)
            lists = region.finder.members(self.equations.x[each])
            for number, members in enumerate(lists):
                asked = np.flatnonzero(inverse == number)
                local = _local(self.equations, self.held, region, members, self.settings)
                found, squared = _answer(
                    self.equations, self.held, region, local, x[asked], region.mean.mean_covariance
                )
                told[np.ix_(asked, np.arange(PLACES), region.mean.outputs)] = found
                scale = self.deviation[region.mean.outputs]
                sigma[np.ix_(asked, region.mean.outputs)] = np.sqrt(squared)[:, None] * scale
        return told[:, 0], sigma, told[:, 1:].transpose(0, 2, 1)

    def sigmas_with(self, pending: Floats, x: Floats) -> Floats:
        """Return sigma at places (m, 6) over what it will be once others are solved, shape (m,).

        From each place's neighbourhood with and without the nearest of the pending ones.
        """
        region = max(self.shares, key=lambda own: len(own.finder.rows))
        n, keep = len(self.equations), min(len(pending), self.settings.deviation_rows // 2)
        with_pending = self.equations.plus(_unsolved(self.equations, pending))
        noise = np.append(region.noise, np.zeros(len(pending)))
        extended = Region(region.mean, region.finder, noise)
        rates, out = self.held.inverse_squares, np.empty(len(x))
        anchors = region.finder.nearest(x)
        for place, members in enumerate(region.finder.members(self.equations.x[anchors])):
            here = x[place : place + 1]
            near = n + np.argsort(((pending - here) ** 2) @ rates, kind="stable")[:keep]
            squared = []
            for rows in (members, np.append(members, near)):
                local = _local(with_pending, self.held, extended, rows, self.settings)
                cov = region.mean.mean_covariance
                squared.append(_answer(with_pending, self.held, extended, local, here, cov)[1][0])
            out[place] = np.sqrt(min(squared[1] / max(squared[0], region.mean.nugget), 1.0))
        return out


def nearest(
    equations: Equations,
    held: Hyperparameters,
    shares: list[Share],
    settings: KrigingSettings = DEFAULTS,
) -> Nearest:
    """Return the kriging of a large table."""
    errors = np.full((len(equations), OUTPUTS), np.nan)
    deviations, variance = errors.copy(), np.empty(OUTPUTS)
    regions = []
    for share in shares:
        region = _region(equations, held, share, settings)
        outputs = region.mean.outputs
        variance[outputs] = region.mean.variance
        rows, found, squared = _left_out(equations, held, region, settings)
        errors[np.ix_(rows, outputs)] = found
        scale = np.sqrt(squared)[:, None] * np.sqrt(region.mean.variance)
        deviations[np.ix_(rows, outputs)] = scale
        regions.append(region)
    told = np.flatnonzero(np.isfinite(errors).any(axis=1))
    return Nearest(
        equations,
        held,
        tuple(regions),
        np.sqrt(variance),
        told,
        errors[told],
        deviations[told],
        settings,
    )


def _region(
    equations: Equations, held: Hyperparameters, share: Share, settings: KrigingSettings
) -> Region:
    chosen = spread_rows(
        equations.take(share.rows), settings.mean_equations, settings.mean_equations
    )
    mean = factorise(
        equations, held, share.outputs, share.rows[chosen], share.noise[chosen], settings
    )
    noise = np.zeros(len(equations))
    noise[share.rows] = share.noise
    limits = settings.local_rows, settings.local_equations
    return Region(mean, Finder(equations, share.rows, held, *limits), noise)


def _local(
    equations: Equations,
    held: Hyperparameters,
    region: Region,
    members: NDArray[np.intp],
    settings: KrigingSettings,
) -> LocalFactor:
    return local_factor(equations, region.noise, held, members, region.mean.nugget, settings)


def _answer(
    equations: Equations,
    held: Hyperparameters,
    region: Region,
    local: LocalFactor,
    x: Floats,
    mean_covariance: Floats,
) -> tuple[Floats, Floats]:
    """Return values and slopes (m, 7, q) and sigma squared (m,), from one neighbourhood."""
    own, coefficients = equations.take(local.members), region.mean.coefficients
    reduced = local.T @ own.told[own.known][:, region.mean.outputs] - local.TF @ coefficients
    across = block(x, own.x, held, slopes_x=True, slopes_v=True)
    across = across.reshape(len(x), PLACES, -1)[:, :, own.known.ravel()]
    told = across @ (local.T.T @ reduced)
    terms = np.concatenate((np.ones((len(x), 1)), x), axis=1)
    told[:, 0] += terms @ coefficients
    told[:, 1:] += coefficients[1:]
    prior = float(held.prior[0])
    return told, local.squared_deviation(across[:, 0], terms, prior, mean_covariance)


def _left_out(
    equations: Equations, held: Hyperparameters, region: Region, settings: KrigingSettings
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return some rows left out, their errors (k, q) and sigma squared, answered without them."""
    finder = region.finder
    count = min(len(finder.rows), settings.left_out_rows)
    rows = finder.rows[np.linspace(0, len(finder.rows) - 1, count).round().astype(np.intp)]
    anchors = finder.nearest_others(rows, equations.x)
    errors, squared = np.empty((count, len(region.mean.outputs))), np.empty(count)
    lists = finder.members(equations.x[anchors], without=rows)
    # What was found to be noise may be response that the kernel does not follow: bars hold it.
    unstated = (equations.readings[:, region.mean.outputs] > 0).any(axis=1)
    stated = np.where(unstated, 0.0, region.noise)
    for place, (row, members) in enumerate(zip(rows, lists, strict=True)):
        local = _local(equations, held, region, members, settings)
        here, cov = equations.x[row : row + 1], region.mean.mean_covariance
        told, found = _answer(equations, held, region, local, here, cov)
        errors[place] = equations.told[row, 0, region.mean.outputs] - told[0, 0]
        squared[place] = found[0] + stated[row] + region.mean.nugget * held.prior[0]
    return rows, errors, squared


def _unsolved(equations: Equations, pending: Floats) -> Equations:
    """Return the equations that wrenches will bring, their answers unknown as yet."""
    known = np.zeros((len(pending), PLACES), dtype=bool)
    known[:, 0] = True
    known[:, 1:] = equations.known[:, 1:].any(axis=0)
    return Equations(
        x=pending,
        known=known,
        told=np.zeros((len(pending), PLACES, OUTPUTS)),
        measured=np.ones((len(pending), OUTPUTS), dtype=bool),
        noise=np.zeros((len(pending), OUTPUTS)),
        readings=np.zeros((len(pending), OUTPUTS)),
        scatter=np.zeros((len(pending), OUTPUTS)),
    )
