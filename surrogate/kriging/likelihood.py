"""Maximum likelihood of the hyperparameters, with the process variances and mean profiled.

Half the negative logarithm of the likelihood is, for each output of e equations with covariance
s^2 K and profiled s^2, (e log s^2 + log det K) / 2; its derivative by a parameter is
tr((inv(K) - a a' / s^2) dK) / 2 with a = inv(K) (y - F b).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array

from ..table.rows import Floats
from .correlation import (
    Hyperparameters,
    derivatives_of_term,
    indices,
    joins,
    numbers,
    order_of,
    seen_by,
)
from .equations import Equations
from .factor import KrigingFactor, Share, SingularCovarianceError, factorise
from .settings import DEFAULTS, KrigingSettings

REFUSED = 1e10  # of a covariance that cannot be factorised: more than any likelihood's logarithm


class Profile(NamedTuple):
    """The likelihood of a share's outputs, their process variances and means settled.

    All numbers are dimensionless.

    Attributes
    ----------
    factor : KrigingFactor
    variance : ndarray, shape (k,), spreads squared
        Process variance of each output.
    values : ndarray, shape (k,)
        Half the negative log likelihood of each output.
    by_noise : float
        Its derivative by the logarithm of a reading's noise, but for what inv(K) tells.
    """

    factor: KrigingFactor
    variance: Floats
    values: Floats
    by_noise: float


def profile(
    equations: Equations,
    hyperparameters: Hyperparameters,
    share: Share,
    ratio: float = 0.0,
    settings: KrigingSettings = DEFAULTS,
    table: Floats | None = None,
) -> Profile:
    """Return the likelihood of a share.

    Parameters
    ----------
    ratio : float
        Variance of one reading of unstated noise over the process variance. The spread of readings
        at one wrench has its say too (Binois, Gramacy and Ludkovski 2018); without a ratio, not.
    table : ndarray, shape (e, e), dimensionless, optional
        The covariance of all equations, where it is at hand.
    """
    noise = share.noise + ratio * reading_parts(equations, share)
    factor = factorise(
        equations, hyperparameters, share.outputs, share.rows, noise, settings, table
    )
    count, more, scatter = len(factor.T), 0.0, np.zeros(len(share.outputs))
    if ratio > 0:
        chosen = np.ix_(share.rows, share.outputs)
        more = np.maximum(equations.readings[chosen] - 1, 0.0).sum(axis=0).mean()
        scatter = equations.scatter[chosen].sum(axis=0) / ratio
    variance = (count * factor.variance + scatter) / (count + more)
    values = 0.5 * (count + more) * np.log(variance) - np.log(np.diag(factor.T)).sum()
    values += 0.5 * more * np.log(ratio) if more else 0.0
    return Profile(factor, variance, values, 0.5 * (more - (scatter / variance).mean()))


def reading_parts(equations: Equations, share: Share) -> Floats:
    """Return the variance of a share's values over that of one reading; 0 where noise is stated.

    Shape (r,), dimensionless, the mean over the share's outputs.
    """
    readings = equations.readings[np.ix_(share.rows, share.outputs)]
    parts = np.zeros_like(readings)
    np.divide(1.0, readings, out=parts, where=readings > 0)
    return parts.mean(axis=1)


def negative_log_likelihood(
    logarithms: Floats,
    equations: Equations,
    shares: list[Share],
    settings: KrigingSettings = DEFAULTS,
) -> tuple[float, Floats]:
    """Return half the negative log likelihood, mean over the outputs, and its gradient.

    The gradient is by the hyperparameters' logarithms, shape (7,), or (8,) with that of the
    variance of one reading of unstated noise over the process variance; all is dimensionless.
    """
    places = equations.loads + equations.weights
    hyperparameters = _hyperparameters(logarithms, equations)
    ratio = float(np.exp(logarithms[places])) if len(logarithms) > places else 0.0
    outputs = sum(len(share.outputs) for share in shares)
    value, gradient = 0.0, np.zeros(places + 1)
    for share in shares:
        try:
            found = profile(equations, hyperparameters, share, ratio, settings)
        except SingularCovarianceError:
            return REFUSED, np.zeros(len(logarithms))
        factor, own, part = found.factor, equations.take(share.rows), len(share.outputs) / outputs
        value += part * float(found.values.mean())
        unit = factor.weights / np.sqrt(found.variance * len(share.outputs))
        sensitivity = factor.T.T @ factor.T - unit @ unit.T
        gradient[:places] += (
            0.5 * part * _contracted(sensitivity, own, hyperparameters, factor.nugget)
        )
        values = numbers(own.known)[:, 0]
        by_ratio = ratio * reading_parts(equations, share) @ np.diag(sensitivity)[values]
        gradient[places] += part * (0.5 * by_ratio + found.by_noise)
    return value, gradient[: len(logarithms)]


def _contracted(
    sensitivity: Floats, own: Equations, hyperparameters: Hyperparameters, nugget: float
) -> Floats:
    """Return the sum of a symmetric matrix (e, e) times the covariance's seven derivatives."""
    # A symmetric matrix's sums by the derivatives that its entries stand with.
    n, places = len(own), own.places
    whole = np.zeros((n, places, n, places))
    known = np.flatnonzero(own.known)
    whole.reshape(n * places, n * places)[np.ix_(known, known)] = sensitivity
    one, other = np.triu_indices(n, 1)
    itself = np.einsum("ipiq->pq", whole)
    itself[np.diag_indices(places)] *= 1 + nugget
    pairs = np.concatenate((2 * whole[one, :, other], itself[None]))
    joined, sign = joins(own.loads, places, places)
    shape = (int(joined.max()) + 1, joined.size)
    gather = csr_array((sign.ravel(), (joined.ravel(), np.arange(joined.size))), shape=shape)
    apart = np.concatenate((own.x[one] - own.x[other], np.zeros((1, own.loads))))
    parts, apart = gather @ pairs.reshape(len(pairs), -1).T, np.ascontiguousarray(apart.T)
    order, loads = 2 * order_of(own.places, own.loads), own.loads
    by_rate, by_weight = np.zeros(loads), []
    for rates, weight in zip(*hyperparameters.terms, strict=True):
        chosen = np.flatnonzero(rates)
        seen = parts[list(seen_by(loads, tuple(chosen.tolist()), order))]
        term = apart[chosen], rates[chosen], order, hyperparameters.smoothness
        by_rate[chosen] += weight * _by_rates(seen, *term)
        by_weight.append(weight * sum(map(np.dot, seen, derivatives_of_term(*term))))
    by_weight = by_weight[-len(hyperparameters.weights) :]
    return np.append(by_rate * hyperparameters.inverse_squares, by_weight)


def _by_rates(parts: Floats, apart: Floats, rates: Floats, order: int, smoothness: int) -> Floats:
    """Return sums of parts (k, p) times a term's derivatives by its rates, shape (loads,).

    The derivative by t_a of D_K m(q) is D_K (d_a^2 m'(q)): by the product rule
    d_a^2 D_K m' + 2 k_a d_a D_(K - a) m' + k_a (k_a - 1) D_(K - a - a) m', k_a how often K has a.
    """
    listed = indices(len(rates), order)
    lower = dict(zip(listed, derivatives_of_term(apart, rates, order, smoothness, 1), strict=True))
    whole = sum(part * lower[index] for part, index in zip(parts, listed, strict=True))
    once, twice = np.zeros_like(apart), np.zeros(len(rates))
    for part, index in zip(parts, listed, strict=True):
        for load in set(index):
            rest, count = list(index), index.count(load)
            rest.remove(load)
            once[load] += count * part * lower[tuple(rest)]
            if count > 1:
                rest.remove(load)
                twice[load] += count * (count - 1) * (part @ lower[tuple(rest)])
    return (apart**2 * whole + 2 * apart * once).sum(axis=1) + twice


def maximise(
    equations: Equations,
    shares: list[Share],
    before: Hyperparameters | None = None,
    settings: KrigingSettings = DEFAULTS,
) -> Hyperparameters:
    """Return the most likely hyperparameters, from two starts or from those before."""
    starts, bounds = _starts(equations, before, settings), bounds_of(equations, settings)
    found = _best(starts, bounds, equations, shares, settings)
    return _hyperparameters(found, equations)


def maximise_with_noise(
    equations: Equations,
    shares: list[Share],
    before: Hyperparameters | None = None,
    settings: KrigingSettings = DEFAULTS,
) -> Hyperparameters:
    """Return the most likely hyperparameters where the noise of readings is to be found too.

    All outputs are taken to have the same noise over their process variance here.
    """
    bounds = [*bounds_of(equations, settings), settings.ratio_bounds]
    starts = [
        np.append(start, settings.ratio_start) for start in _starts(equations, before, settings)
    ]
    found = _best(starts, bounds, equations, shares, settings)
    return _hyperparameters(found, equations)


def _hyperparameters(logarithms: Floats, equations: Equations) -> Hyperparameters:
    own = logarithms[: equations.loads + equations.weights]
    return Hyperparameters.of_logarithms(own, equations.groups, equations.smoothness)


def bounds_of(equations: Equations, settings: KrigingSettings) -> list[tuple[float, float]]:
    """Return the bounds of the hyperparameters' logarithms."""
    weights = [settings.weight_bounds] * equations.weights
    return [settings.theta_bounds] * equations.loads + weights


def _starts(
    equations: Equations, before: Hyperparameters | None, settings: KrigingSettings
) -> list[Floats]:
    """Return where the search begins: the logarithms of the hyperparameters."""
    if before is not None:
        return [np.clip(before.logarithms, *np.array(bounds_of(equations, settings)).T)]
    weights = [0.0] * (equations.weights - 1) + [settings.weight_start]
    # With second derivatives the first start ended at the higher maximum, or both at one, for 35 of
    # 35 tables: real solves of `plate_thin` and made-up parts.
    thetas = settings.theta_starts[: 1 if equations.weights > 1 else None]
    return [np.array([theta] * equations.loads + weights) for theta in thetas]


def _best(
    starts: list[Floats],
    bounds: list[tuple[float, float]],
    equations: Equations,
    shares: list[Share],
    settings: KrigingSettings,
) -> Floats:
    """Return the most likely logarithms that a search from these starts ends at."""
    found = [
        minimize(
            negative_log_likelihood,
            start,
            args=(equations, shares, settings),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": settings.likelihood_steps, "ftol": settings.likelihood_accuracy},
        )
        for start in starts
    ]
    # Rounded so that the rounding of another unit does not change them; the likelihood is flat.
    return np.round(min(found, key=lambda run: run.fun).x, settings.decimals)
