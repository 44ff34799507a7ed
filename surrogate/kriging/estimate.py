"""The hyperparameters of a table: on which rows, and what noise counts against."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .correlation import Hyperparameters
from .equations import Equations, Scaling
from .factor import Share, factorise, shares_of
from .likelihood import maximise, maximise_with_noise
from .reading_noise import reading_noise
from .settings import KrigingSettings

DECIMALS = 9  # to which two distances are a tie, settled by the rows' own order


class Estimate(NamedTuple):
    """What the likelihood settles, in dimensionless numbers.

    Attributes
    ----------
    hyperparameters : Hyperparameters
        Common to all outputs.
    noise_scale : ndarray, shape (6,), spreads squared
        Process variances that noise is held against.
    reading_variance : ndarray, shape (6,), spreads squared
        Of one reading whose uncertainty nobody stated; 0 where all is stated or solved.
    """

    hyperparameters: Hyperparameters
    noise_scale: Floats
    reading_variance: Floats


def estimated(
    equations: Equations,
    scaling: Scaling,
    settings: KrigingSettings,
) -> Estimate:
    """Return the hyperparameters, and how noisy the rows are.

    Noise counts relative to the process variance, which the hyperparameters decide: with noise the
    likelihood is maximised a second time, with what the first time found. Noise that nobody stated
    is one more hyperparameter, first of all outputs together, then of each by itself.
    """
    chosen = equations.take(spread_rows(equations, settings.likelihood_equations))
    variance, reading = np.ones_like(scaling.spread), np.zeros_like(scaling.spread)
    unstated = bool((chosen.readings > 0).any())
    if unstated:
        bounds = settings.theta_bounds[0], settings.noise_theta_most
        settings = replace(settings, theta_bounds=bounds)
    before: Hyperparameters | None = None
    noisy = unstated or bool((chosen.noise > settings.nugget).any())
    for stage in range(1 + noisy):
        current = chosen.with_reading_noise(reading)
        shares = _telling(shares_of(current, variance, settings), scaling)
        search = maximise_with_noise if unstated and not stage else maximise
        before = search(current, shares, before, settings)
        if unstated:
            variance, reading = reading_noise(equations, scaling, before, variance, settings)
            continue
        for share in shares:
            found = factorise(chosen, before, *share, settings)
            variance[share.outputs] = found.variance
    assert before is not None
    return Estimate(before, variance, reading)


def _telling(shares: list[Share], scaling: Scaling) -> list[Share]:
    """Return the shares without the outputs that vary by rounding only, and with enough rows."""
    varying = [
        share._replace(outputs=share.outputs[~scaling.silent[share.outputs]]) for share in shares
    ]
    return [share for share in varying if len(share.outputs) and len(share.rows)]


def within_one_factor(equations: Equations, settings: KrigingSettings) -> Equations:
    """Return the equations that one factor holds: second derivatives of as many rows as fit.

    These rows are spread farthest: between distant rows a second derivative tells most.
    """
    if equations.count <= settings.dense_equations:
        return equations
    second = np.zeros_like(equations.known)
    second[:, 1 + equations.loads :] = equations.known[:, 1 + equations.loads :]
    room = settings.dense_equations - int((equations.known & ~second).sum())
    kept = np.zeros((len(equations), 1), dtype=bool)
    kept[spread_rows(replace(equations, known=second), room)] = True
    return replace(equations, known=equations.known & (~second | kept))


def spread_rows(equations: Equations, most_equations: int) -> NDArray[np.intp]:
    """Return rows within the limit, each the farthest from those before it, in their own order.

    Shape (k,): indices of the rows.
    """
    size = equations.known.sum(axis=1)
    chosen = [int(np.argmin(np.round((equations.x**2).sum(axis=1), DECIMALS)))]
    total = size[chosen[0]]
    distance = np.full(len(equations), np.inf)
    while len(chosen) < len(equations):
        apart = ((equations.x - equations.x[chosen[-1]]) ** 2).sum(axis=1)
        distance = np.minimum(distance, apart)
        place = int(np.argmax(np.round(distance, DECIMALS)))
        total += size[place]
        if total > most_equations:
            break
        chosen.append(place)
    return np.sort(chosen)
