"""Maximum likelihood of the seven hyperparameters, with the process variances and mean profiled.

Half the negative logarithm of the likelihood is, for each output of e equations with covariance
s^2 K and profiled s^2, (e log s^2 + log det K) / 2; its derivative by a parameter is
tr((inv(K) - a a' / s^2) dK) / 2 with a = inv(K) (y - F b).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from ..table.rows import Floats
from .correlation import (
    GROUPS,
    LOADS,
    PLACES,
    Hyperparameters,
    matern,
)
from .equations import Equations
from .factor import SingularCovarianceError, factorise
from .settings import DEFAULTS, KrigingSettings
from .shares import Share

REFUSED = 1e10  # of a covariance that cannot be factorised: more than any likelihood's logarithm


def negative_log_likelihood(
    logarithms: Floats,
    equations: Equations,
    shares: list[Share],
    settings: KrigingSettings = DEFAULTS,
) -> tuple[float, Floats]:
    """Return half the negative log likelihood, mean over the outputs, and its gradient (7,).

    The gradient is by the hyperparameters' logarithms, shape (7,); all is dimensionless.
    """
    held = Hyperparameters.of_logarithms(logarithms)
    outputs = sum(len(share.outputs) for share in shares)
    value, gradient = 0.0, np.zeros(PLACES)
    for share in shares:
        try:
            factor = factorise(equations, held, *share, settings)
        except SingularCovarianceError:
            return REFUSED, np.zeros(PLACES)
        own = equations.take(share.rows)
        part = len(share.outputs) / outputs
        count = len(factor.T)
        log_determinant = -2 * np.log(np.diag(factor.T)).sum()
        value += 0.5 * part * (count * np.log(factor.variance).mean() + log_determinant)
        unit = factor.weights / np.sqrt(factor.variance * len(share.outputs))
        sensitivity = factor.T.T @ factor.T - unit @ unit.T
        gradient += 0.5 * part * _contracted(sensitivity, own, held, factor.nugget)
    return float(value), gradient


def _contracted(
    sensitivity: Floats, own: Equations, held: Hyperparameters, nugget: float
) -> Floats:
    """Return the sum of a symmetric matrix (e, e) times the covariance's seven derivatives."""
    n = len(own)
    whole = np.zeros((n, PLACES, n, PLACES))
    places = np.flatnonzero(own.known)
    whole.reshape(n * PLACES, n * PLACES)[np.ix_(places, places)] = sensitivity
    apart = own.x[:, None, :] - own.x[None, :, :]
    by_rate, by_weight = np.zeros(LOADS), 0.0
    for group, (rates, weight) in enumerate(zip(*held.terms, strict=True)):
        loads = np.flatnonzero(GROUPS[group])
        seen = np.append(0, 1 + loads)
        term = _one_term(whole[:, seen][:, :, :, seen], apart[..., loads], rates[loads])
        by_rate[loads] += weight * term[0]
        by_weight += weight * term[1] if group == len(GROUPS) - 1 else 0.0
    diagonal = np.where(own.known, np.einsum("ipip->ip", whole), 0.0).sum(axis=0)
    terms, weights = held.terms
    by_rate += nugget * 1.4 * diagonal[1:] * (weights @ GROUPS)
    by_weight += nugget * (held.weight * diagonal[0] + 1.4 * held.weight * diagonal[1:] @ terms[-1])
    return np.append(by_rate * held.inverse_squares, by_weight)


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
    turned = (curved @ by_load[..., None])[..., 0]
    along = (slope * by_load).sum(axis=2)
    bent = (turned * by_load).sum(axis=2)
    traced = trace @ rates
    by_distance = value * first + 2 * along * second - bent * third - 2 * traced * second
    by_rate = np.einsum("ij,ija->a", by_distance, apart**2)
    by_rate += 4 * np.einsum("ij,ija->a", first, slope * apart)
    by_rate -= 4 * np.einsum("ij,ija->a", second, turned * apart)
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
    bounds = [settings.theta_bounds] * LOADS + [settings.weight_bounds]
    starts = [
        np.array([theta] * LOADS + [settings.weight_start]) for theta in settings.theta_starts
    ]
    if before is not None:
        starts = [np.clip(before.logarithms, *np.array(bounds).T)]
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
    best = np.round(min(found, key=lambda run: run.fun).x, settings.decimals)
    return Hyperparameters.of_logarithms(best)
