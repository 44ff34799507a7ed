"""Maximum likelihood of the hyperparameters, with the process variances and mean profiled.

Half the negative logarithm of the likelihood is, for each output of e equations with covariance
s^2 K and profiled s^2, (e log s^2 + log det K) / 2; its derivative by a parameter is
tr((inv(K) - a a' / s^2) dK) / 2 with a = inv(K) (y - F b).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize
from scipy.sparse import csr_array

from ..table.rows import Floats
from .correlation import (
    Hyperparameters,
    covariance,
    derivatives_of_term,
    indices,
    joins,
    numbers,
    order_of,
    positions_of,
)
from .equations import Equations, Scaling, farthest_first
from .factor import KrigingFactor, OutputGroup, SingularCovarianceError, factorise, output_groups
from .settings import DEFAULTS, KrigingSettings

REFUSED = 1e10  # of a covariance that cannot be factorised: more than any likelihood's logarithm
DECIMALS = 9  # to which two distances are a tie, resolved by the order of the rows


def profile(
    equations: Equations,
    hyperparameters: Hyperparameters,
    group: OutputGroup,
    ratio: float = 0.0,
    settings: KrigingSettings = DEFAULTS,
    table: Floats | None = None,
) -> tuple[KrigingFactor, Floats, Floats, float]:
    """Return the likelihood of a group's outputs, with process variances and means profiled.

    Parameters
    ----------
    ratio : float
        Variance of an observation of unknown noise over the process variance. With a ratio the
        spread of observations at a wrench counts too (Binois, Gramacy and Ludkovski 2018).
    table : ndarray, shape (e, e), dimensionless, optional
        The covariance of all equations, where it is at hand.

    Returns
    -------
    factor : KrigingFactor
    variance : ndarray, shape (k,), spreads squared
        Process variance of each output.
    values : ndarray, shape (k,), dimensionless
        Half the negative log likelihood of each output.
    by_noise : float
        Its derivative by the logarithm of an observation's noise, without the part of inv(K).
    """
    noise = group.noise + ratio * observation_noise_parts(equations, group)
    noisy = group._replace(noise=noise)
    factor = factorise(equations, hyperparameters, noisy, settings, table)
    count, repeats, scatter = len(factor.T), 0.0, np.zeros(len(group.outputs))
    if ratio > 0:
        chosen = np.ix_(group.rows, group.outputs)
        repeats = np.maximum(equations.observations[chosen] - 1, 0.0).sum(axis=0).mean()
        scatter = equations.scatter[chosen].sum(axis=0) / ratio
    variance = (count * factor.variance + scatter) / (count + repeats)
    values = 0.5 * (count + repeats) * np.log(variance) - np.log(np.diag(factor.T)).sum()
    values += 0.5 * repeats * np.log(ratio) if repeats else 0.0
    return factor, variance, values, 0.5 * (repeats - float((scatter / variance).mean()))


def observation_noise_parts(equations: Equations, group: OutputGroup) -> Floats:
    """Return the variance of a group's values over that of an observation; 0 of known noise.

    Shape (r,), dimensionless, the mean over the group's outputs.
    """
    observations = equations.observations[np.ix_(group.rows, group.outputs)]
    parts = np.zeros_like(observations)
    np.divide(1.0, observations, out=parts, where=observations > 0)
    return parts.mean(axis=1)


def negative_log_likelihood(
    logarithms: Floats,
    equations: Equations,
    groups: list[OutputGroup],
    settings: KrigingSettings = DEFAULTS,
) -> tuple[float, Floats]:
    """Return half the negative log likelihood, mean over the outputs, and its gradient.

    The gradient is by the hyperparameters' logarithms, shape (7,), or (8,) with that of the
    variance of an observation of unknown noise over the process variance; all is dimensionless.
    """
    n_logarithms = equations.loads + equations.weights
    hyperparameters = _hyperparameters(logarithms, equations)
    ratio = float(np.exp(logarithms[n_logarithms])) if len(logarithms) > n_logarithms else 0.0
    outputs = sum(len(group.outputs) for group in groups)
    value, gradient = 0.0, np.zeros(n_logarithms + 1)
    for group in groups:
        try:
            profiled = profile(equations, hyperparameters, group, ratio, settings)
        except SingularCovarianceError:
            return REFUSED, np.zeros(len(logarithms))
        (factor, variance, likelihoods, by_noise), fraction = profiled, len(group.outputs) / outputs
        value += fraction * float(likelihoods.mean())
        unit = factor.weights / np.sqrt(variance * len(group.outputs))
        sensitivity = factor.T.T @ factor.T - unit @ unit.T
        gradient[:n_logarithms] += 0.5 * fraction * _contracted(sensitivity, factor)
        values = numbers(factor.equations.known)[:, 0]
        by_ratio = ratio * observation_noise_parts(equations, group) @ np.diag(sensitivity)[values]
        gradient[n_logarithms] += fraction * (0.5 * by_ratio + by_noise)
    return value, gradient[: len(logarithms)]


def _contracted(sensitivity: Floats, factor: KrigingFactor) -> Floats:
    """Return the sum of a symmetric matrix (e, e) times the covariance's seven derivatives."""
    equations, hyperparameters = factor.equations, factor.hyperparameters
    # A symmetric matrix's sums by the derivatives that its entries stand with.
    n, count = len(equations), equations.n_derivatives
    full = np.zeros((n, count, n, count))
    known = np.flatnonzero(equations.known)
    full.reshape(n * count, n * count)[np.ix_(known, known)] = sensitivity
    first, second = np.triu_indices(n, 1)
    diagonal = np.einsum("ipiq->pq", full)
    diagonal[np.diag_indices(count)] *= 1 + factor.nugget
    pairs = np.concatenate((2 * full[first, :, second], diagonal[None]))
    joined, sign = joins(equations.loads, count, count)
    shape = (int(joined.max()) + 1, joined.size)
    gather = csr_array((sign.ravel(), (joined.ravel(), np.arange(joined.size))), shape=shape)
    delta = np.concatenate(
        (equations.x[first] - equations.x[second], np.zeros((1, equations.loads)))
    )
    parts, delta = gather @ pairs.reshape(len(pairs), -1).T, np.ascontiguousarray(delta.T)
    order, loads = 2 * order_of(equations.n_derivatives, equations.loads), equations.loads
    by_rate, by_weight = np.zeros(loads), []
    for rates, weight in zip(*hyperparameters.terms, strict=True):
        chosen = np.flatnonzero(rates)
        columns = parts[list(positions_of(loads, tuple(chosen.tolist()), order))]
        term = delta[chosen], rates[chosen], order, hyperparameters.smoothness
        by_rate[chosen] += weight * _by_rates(columns, *term)
        by_weight.append(weight * sum(map(np.dot, columns, derivatives_of_term(*term))))
    by_weight = by_weight[-len(hyperparameters.weights) :]
    return np.append(by_rate * hyperparameters.inverse_squares, by_weight)


def _by_rates(parts: Floats, delta: Floats, rates: Floats, order: int, smoothness: int) -> Floats:
    """Return sums of parts (k, p) times a term's derivatives by its rates, shape (loads,).

    The derivative by t_a of D_K m(q) is D_K (d_a^2 m'(q)): by the product rule
    d_a^2 D_K m' + 2 k_a d_a D_(K - a) m' + k_a (k_a - 1) D_(K - a - a) m', k_a how often K has a.
    """
    listed = indices(len(rates), order)
    derivatives = dict(
        zip(listed, derivatives_of_term(delta, rates, order, smoothness, 1), strict=True)
    )
    total = sum(part * derivatives[index] for part, index in zip(parts, listed, strict=True))
    once, twice = np.zeros_like(delta), np.zeros(len(rates))
    for part, index in zip(parts, listed, strict=True):
        for load in set(index):
            lower_index, count = list(index), index.count(load)
            lower_index.remove(load)
            once[load] += count * part * derivatives[tuple(lower_index)]
            if count > 1:
                lower_index.remove(load)
                twice[load] += count * (count - 1) * (part @ derivatives[tuple(lower_index)])
    return (delta**2 * total + 2 * delta * once).sum(axis=1) + twice


def maximise(
    equations: Equations,
    groups: list[OutputGroup],
    before: Hyperparameters | None = None,
    settings: KrigingSettings = DEFAULTS,
    *,
    with_noise: bool = False,
) -> Hyperparameters:
    """Return the most likely hyperparameters, from two starts or from those before.

    With noise, that of an observation of unknown noise is searched too; all outputs are taken to
    have the same over their process variance.
    """
    bounds = [settings.theta_bounds] * equations.loads + [
        settings.weight_bounds
    ] * equations.weights
    if before is not None:
        starts = [np.clip(before.logarithms, *np.array(bounds).T)]
    else:
        weights = [0.0] * (equations.weights - 1) + [settings.weight_start]
        # With second derivatives the first start ended at the higher maximum, or both at one, for
        # 35 of 35 tables: real solves of `plate_thin` and made-up parts.
        thetas = settings.theta_starts[: 1 if equations.weights > 1 else None]
        starts = [np.array([theta] * equations.loads + weights) for theta in thetas]
    if with_noise:
        bounds.append(settings.ratio_bounds)
        starts = [np.append(start, settings.ratio_start) for start in starts]
    runs = [
        minimize(
            negative_log_likelihood,
            start,
            args=(equations, groups, settings),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": settings.likelihood_steps, "ftol": settings.likelihood_accuracy},
        )
        for start in starts
    ]
    # Rounded so that the rounding of another unit does not change them; the likelihood is flat.
    best = np.round(min(runs, key=lambda run: run.fun).x, settings.decimals)
    return _hyperparameters(best, equations)


def _hyperparameters(logarithms: Floats, equations: Equations) -> Hyperparameters:
    chosen = logarithms[: equations.loads + equations.weights]
    return Hyperparameters.of_logarithms(chosen, equations.groups, equations.smoothness)


def observation_noise(
    equations: Equations,
    scaling: Scaling,
    hyperparameters: Hyperparameters,
    variance_before: Floats,
    settings: KrigingSettings,
) -> tuple[Floats, Floats]:
    """Return each output's process variance and that of an observation's noise, (6,) each.

    The variance of an observation is the least with which any of several kernels is nearly as
    likely as the most likely one. What may be response and may be noise is taken for response,
    whose error bars are wider; one kernel for all outputs would take for noise what an output alone
    does. Of rows as they lie, near each other too: rows spread widely do not show little noise.

    Parameters
    ----------
    before : ndarray, shape (6,), spreads squared
        Process variances that known noise is relative to.
    """
    ends = np.searchsorted(np.cumsum(equations.known.sum(axis=1)), settings.likelihood_equations)
    count = max(min(int(ends), len(equations)), 1)
    chosen = equations.take(np.linspace(0, len(equations) - 1, count).round().astype(np.intp))
    ratios = np.arange(*settings.ratio_bounds, settings.ratio_step)
    groups, x, known = equations.groups, chosen.x, chosen.known
    one_length = [  # kernels of one length in all loads
        Hyperparameters.of_logarithms(np.array([theta] * groups.shape[1] + [weight]), groups)
        for theta in settings.noise_thetas
        for weight in settings.noise_weights
    ]
    kernels = [(kernel, 0.0) for kernel in (hyperparameters, *one_length)]
    if not known[:, 1:].any():
        kernels += [(hyperparameters, rough) for rough in settings.noise_rough]
    # Half the negative log likelihood and the logarithm of the process variance of each kernel, by
    # the logarithms of an observation's variance over it.
    values, variances = np.full((2, len(kernels), len(ratios), len(variance_before)), REFUSED)
    for index, (kernel, rough) in enumerate(kernels):
        table = covariance(x, known, x, known, kernel)
        if rough:
            table = table + rough * sum(np.exp(-np.abs(column[:, None] - column)) for column in x.T)
        for group in output_groups(chosen, variance_before, settings):
            for step, ratio in enumerate(np.exp(ratios).tolist() if len(group.rows) else ()):
                try:
                    profiled = profile(chosen, kernel, group, ratio, settings, table)
                except SingularCovarianceError:
                    continue
                variances[index, step, group.outputs] = np.log(profiled[1])
                values[index, step, group.outputs] = profiled[2]
    variance, noise_variance = variance_before.copy(), np.zeros_like(variance_before)
    fine = np.arange(ratios[0], ratios[-1], settings.ratio_accuracy)
    for output in np.flatnonzero(~scaling.constant):
        log_noise, usable = ratios + variances[:, :, output], values[:, :, output] < REFUSED
        usable = usable.all(axis=1)
        smooth = np.array([CubicSpline(ratios, row)(fine) for row in values[usable, :, output]])
        likely = smooth <= smooth.min() + settings.ratio_caution
        likely_noise = np.array([np.interp(fine, ratios, row) for row in log_noise[usable]])
        smallest = float(likely_noise[likely].min())
        ascending = np.maximum.accumulate(log_noise[0])  # it grows with the ratio but for rounding
        ratio = np.interp(smallest, ascending, ratios)
        noise_variance[output], variance[output] = np.exp(smallest), np.exp(smallest - ratio)
    return variance, noise_variance


def estimated(
    equations: Equations, scaling: Scaling, settings: KrigingSettings
) -> tuple[Hyperparameters, Floats, Floats]:
    """Return the hyperparameters of all outputs, and the noise of the rows.

    Noise counts relative to the process variance, which the hyperparameters decide: with noise the
    likelihood is maximised a second time, with the result of the first. Unknown noise
    is one more hyperparameter, first of all outputs together, then of each by itself.

    Returns
    -------
    hyperparameters : Hyperparameters
    noise_scale : ndarray, shape (6,), spreads squared
        Process variances that noise is relative to.
    reading_variance : ndarray, shape (6,), spreads squared
        Of an observation of unknown uncertainty; 0 where all are known or solved.
    """
    chosen = equations.take(spread_rows(equations, settings.likelihood_equations))
    variance, observation_variance = np.ones_like(scaling.spread), np.zeros_like(scaling.spread)
    unknown_noise = bool((chosen.observations > 0).any())
    if unknown_noise:
        bounds = settings.theta_bounds[0], settings.noise_theta_max
        settings = replace(settings, theta_bounds=bounds)
    before: Hyperparameters | None = None
    noisy = unknown_noise or bool((chosen.noise > settings.nugget).any())
    for stage in range(1 + noisy):
        current = chosen.with_observation_noise(observation_variance)
        # The groups without the outputs that vary by rounding only, and with enough rows.
        varying = [
            group._replace(outputs=group.outputs[~scaling.constant[group.outputs]])
            for group in output_groups(current, variance, settings)
        ]
        groups = [group for group in varying if len(group.outputs) and len(group.rows)]
        before = maximise(current, groups, before, settings, with_noise=unknown_noise and not stage)
        if unknown_noise:
            variance, observation_variance = observation_noise(
                equations, scaling, before, variance, settings
            )
            continue
        for group in groups:
            variance[group.outputs] = factorise(chosen, before, group, settings).variance
    assert before is not None
    return before, variance, observation_variance


def within_one_factor(equations: Equations, settings: KrigingSettings) -> Equations:
    """Return the equations that a factor holds: second derivatives of as many rows as fit.

    These rows are spread farthest: between distant rows a second derivative counts most.
    """
    if equations.count <= settings.dense_equations:
        return equations
    second = np.zeros_like(equations.known)
    second[:, 1 + equations.loads :] = equations.known[:, 1 + equations.loads :]
    n_left = settings.dense_equations - int((equations.known & ~second).sum())
    with_second = np.zeros((len(equations), 1), dtype=bool)
    with_second[spread_rows(replace(equations, known=second), n_left)] = True
    return replace(equations, known=equations.known & (~second | with_second))


def spread_rows(equations: Equations, max_equations: int) -> NDArray[np.intp]:
    """Return rows within the limit, each the farthest from those before it, in ascending order.

    Shape (k,): indices of the rows.
    """
    total, chosen = 0, []
    for row in farthest_first(equations.x):
        total += int(equations.known[row].sum())
        if chosen and total > max_equations:
            break
        chosen.append(row)
    return np.sort(chosen)
