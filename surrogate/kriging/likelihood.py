"""Maximum likelihood of the seven hyperparameters, with the process variances and mean profiled.

Half the negative logarithm of the likelihood is, for each output of e equations with covariance
s^2 K and profiled s^2, (e log s^2 + log det K) / 2; its derivative by a parameter is
tr((inv(K) - a a' / s^2) dK) / 2 with a = inv(K) (y - F b).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ..table.rows import Floats
from .correlation import (
    Hyperparameters,
    matern,
    numbers,
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
    places = equations.places
    hyperparameters = Hyperparameters.of_logarithms(logarithms[:places], equations.groups)
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
    if not own.known[:, 1:].any():
        return _contracted_values(sensitivity, own, hyperparameters, nugget)
    n, count, groups = len(own), own.places, hyperparameters.groups
    whole = np.zeros((n, count, n, count))
    places = np.flatnonzero(own.known)
    whole.reshape(n * count, n * count)[np.ix_(places, places)] = sensitivity
    apart = own.x[:, None, :] - own.x[None, :, :]
    by_rate, by_weight = np.zeros(count - 1), 0.0
    for group, (rates, weight) in enumerate(zip(*hyperparameters.terms, strict=True)):
        loads = np.flatnonzero(groups[group])
        seen = np.append(0, 1 + loads)
        term = _one_term(whole[:, seen][:, :, :, seen], apart[..., loads], rates[loads])
        by_rate[loads] += weight * term[0]
        by_weight += weight * term[1] if group == len(groups) - 1 else 0.0
    diagonal = np.where(own.known, np.einsum("ipip->ip", whole), 0.0).sum(axis=0)
    terms, weights = hyperparameters.terms
    by_rate += nugget * 1.4 * diagonal[1:] * (weights @ groups)
    by_weight += nugget * (
        hyperparameters.weight * diagonal[0]
        + 1.4 * hyperparameters.weight * diagonal[1:] @ terms[-1]
    )
    return np.append(by_rate * hyperparameters.inverse_squares, by_weight)


def _contracted_values(
    sensitivity: Floats, own: Equations, hyperparameters: Hyperparameters, nugget: float
) -> Floats:
    """Return what `_contracted` does where no row brings slopes: a tenth of the work.

    Each pair of rows counts twice; on the diagonal covariances are their terms' weights.
    """
    one, other = np.triu_indices(len(own), 1)
    squares = (own.x[one] - own.x[other]).T ** 2
    pairs, trace = 2 * sensitivity[one, other], np.trace(sensitivity)
    by_rate = np.zeros(own.x.shape[1])
    itself = np.zeros_like(pairs)
    for rates, weight in zip(*hyperparameters.terms, strict=True):
        loads = np.flatnonzero(rates)
        itself, first, _, _ = matern(rates[loads] @ squares[loads])
        by_rate[loads] += weight * (squares[loads] @ (pairs * first))
    by_weight = hyperparameters.weight * (pairs @ itself + (1 + nugget) * trace)
    return np.append(by_rate * hyperparameters.inverse_squares, by_weight)


def _one_term(whole: Floats, apart: Floats, rates: Floats) -> tuple[Floats, float]:
    """Return the contraction with one term's derivatives by its rates, and with the term itself.

    Parameters
    ----------
    whole : ndarray, shape (n, 1 + loads, n, 1 + loads)
    apart : ndarray, shape (n, n, loads)
    """
    values, first, second, third = matern(apart**2 @ rates)
    by_load = 2 * apart * rates
    value = whole[:, 0, :, 0]
    slope = whole[:, 1:, :, 0].transpose(0, 2, 1)
    curved = whole[:, 1:, :, 1:].transpose(0, 2, 1, 3)
    trace = np.einsum("ijaa->ija", curved)
    rotated = (curved @ by_load[..., None])[..., 0]
    along = (slope * by_load).sum(axis=2)
    bent = (rotated * by_load).sum(axis=2)
    traced = trace @ rates
    by_distance = value * first + 2 * along * second - bent * third - 2 * traced * second
    by_rate = np.einsum("ij,ija->a", by_distance, apart**2)
    by_rate += 4 * np.einsum("ij,ija->a", first, slope * apart)
    by_rate -= 4 * np.einsum("ij,ija->a", second, rotated * apart)
    by_rate -= 2 * np.einsum("ij,ija->a", first, trace)
    itself = value * values + 2 * along * first - bent * second - 2 * traced * first
    return by_rate, float(itself.sum())


def maximise(
    equations: Equations,
    shares: list[Share],
    before: Hyperparameters | None = None,
    settings: KrigingSettings = DEFAULTS,
) -> Hyperparameters:
    """Return the most likely hyperparameters, from two starts or from those before."""
    starts, bounds = _starts(equations, before, settings), _bounds(equations, settings)
    found = _best(starts, bounds, equations, shares, settings)
    return Hyperparameters.of_logarithms(found, equations.groups)


def maximise_with_noise(
    equations: Equations,
    shares: list[Share],
    before: Hyperparameters | None = None,
    settings: KrigingSettings = DEFAULTS,
) -> Hyperparameters:
    """Return the most likely hyperparameters where the noise of readings is to be found too.

    All outputs are taken to have the same noise over their process variance here.
    """
    bounds = [*_bounds(equations, settings), settings.ratio_bounds]
    starts = [
        np.append(start, settings.ratio_start) for start in _starts(equations, before, settings)
    ]
    found = _best(starts, bounds, equations, shares, settings)
    return Hyperparameters.of_logarithms(found[: equations.places], equations.groups)


def _bounds(equations: Equations, settings: KrigingSettings) -> list[tuple[float, float]]:
    return [settings.theta_bounds] * equations.x.shape[1] + [settings.weight_bounds]


def _starts(
    equations: Equations, before: Hyperparameters | None, settings: KrigingSettings
) -> list[Floats]:
    """Return where the search begins: the logarithms of the hyperparameters."""
    if before is not None:
        return [np.clip(before.logarithms, *np.array(_bounds(equations, settings)).T)]
    loads = equations.x.shape[1]
    return [np.array([theta] * loads + [settings.weight_start]) for theta in settings.theta_starts]


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
