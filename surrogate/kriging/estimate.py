"""The hyperparameters of a table: on which rows, and what noise counts against."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ..table.rows import Floats
from .correlation import Hyperparameters, covariance
from .equations import OUTPUTS, Equations, Scaling
from .factor import Share, SingularCovarianceError, factorise, shares_of
from .likelihood import REFUSED, Profile, maximise, maximise_with_noise, profile
from .settings import KrigingSettings

DECIMALS = 9  # to which two distances are a tie, settled by the rows' own order


class Estimate(NamedTuple):
    """What the likelihood settles, in dimensionless numbers.

    Attributes
    ----------
    hyperparameters : Hyperparameters
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
    limits = settings.likelihood_rows, settings.likelihood_equations
    chosen = equations.take(spread_rows(equations, *limits))
    variance, reading = np.ones(OUTPUTS), np.zeros(OUTPUTS)
    unstated = bool((chosen.readings > 0).any())
    before: Hyperparameters | None = None
    noisy = unstated or bool((chosen.noise > settings.nugget).any())
    for stage in range(1 + noisy):
        current = chosen.with_reading_noise(reading)
        shares = _telling(shares_of(current, variance, settings), scaling)
        search = maximise_with_noise if unstated and not stage else maximise
        before = search(current, shares, before, settings)
        if unstated:
            variance, reading = _each_output(equations, scaling, before, variance, settings)
            continue
        for share in shares:
            found = factorise(chosen, before, *share, settings)
            variance[share.outputs] = found.variance
    assert before is not None
    return Estimate(before, variance, reading)


def _each_output(
    equations: Equations,
    scaling: Scaling,
    hyperparameters: Hyperparameters,
    before: Floats,
    settings: KrigingSettings,
) -> tuple[Floats, Floats]:
    """Return each output's process variance and that of one of its readings, (6,) each.

    Of rows as they lie, near each other too: rows spread widely do not tell little noise.
    """
    variance, reading = before.copy(), np.zeros(OUTPUTS)
    ends = np.searchsorted(np.cumsum(equations.known.sum(axis=1)), settings.likelihood_equations)
    count = max(min(int(ends), len(equations)), 1)
    chosen = equations.take(np.linspace(0, len(equations) - 1, count).round().astype(np.intp))
    table = covariance(chosen.x, chosen.known, chosen.x, chosen.known, hyperparameters)
    for output in np.flatnonzero(~scaling.silent):
        rows = np.flatnonzero(chosen.measured[:, output])
        noise = chosen.noise[rows, output] / before[output]
        own = Share(np.array([output]), rows, noise)

        def likelihood(logarithm: float, own: Share = own) -> Profile:
            return profile(chosen, hyperparameters, own, float(np.exp(logarithm)), settings, table)

        logarithm = _least_noise(lambda at: likelihood(at).value, settings)
        variance[output] = likelihood(logarithm).variance[0]
        reading[output] = np.exp(logarithm) * variance[output]
    return variance, reading


def _least_noise(value: Callable[[float], float], settings: KrigingSettings) -> float:
    """Return the logarithm of the least noise that is nearly as likely as the most likely.

    What might be response and might be noise is taken for response, whose bars are wider.
    """

    def less_likely(logarithm: float) -> float:
        try:
            return value(logarithm)
        except SingularCovarianceError:
            return REFUSED

    bounds, accuracy = settings.ratio_bounds, settings.ratio_accuracy
    found: Any = minimize_scalar(
        less_likely, bounds=bounds, method="bounded", options={"xatol": accuracy}
    )
    low, high = bounds[0], float(found.x)
    limit = float(found.fun) + settings.ratio_caution
    if less_likely(low) <= limit:
        return low
    while high - low > accuracy:
        middle = (low + high) / 2
        low, high = (low, middle) if less_likely(middle) <= limit else (middle, high)
    return high


def _telling(shares: list[Share], scaling: Scaling) -> list[Share]:
    """Return the shares without the outputs that vary by rounding only, and with enough rows."""
    varying = [
        share._replace(outputs=share.outputs[~scaling.silent[share.outputs]]) for share in shares
    ]
    return [share for share in varying if len(share.outputs) and len(share.rows)]


def spread_rows(equations: Equations, most_rows: int, most_equations: int) -> NDArray[np.intp]:
    """Return rows within the limits, each the farthest from those before it, in their own order.

    Shape (k,): indices of the rows.
    """
    size = equations.known.sum(axis=1)
    chosen = [int(np.argmin(np.round((equations.x**2).sum(axis=1), DECIMALS)))]
    total = size[chosen[0]]
    distance = np.full(len(equations), np.inf)
    while len(chosen) < min(len(equations), most_rows):
        apart = ((equations.x - equations.x[chosen[-1]]) ** 2).sum(axis=1)
        distance = np.minimum(distance, apart)
        place = int(np.argmax(np.round(distance, DECIMALS)))
        total += size[place]
        if total > most_equations:
            break
        chosen.append(place)
    return np.sort(chosen)
