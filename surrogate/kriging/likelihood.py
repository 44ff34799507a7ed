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
    seen_by,
)
from .equations import Equations, Scaling
from .factor import KrigingFactor, OutputGroup, SingularCovarianceError, factorise, output_groups
from .settings import DEFAULTS, KrigingSettings

REFUSED = 1e10  # of a covariance that cannot be factorised: more than any likelihood's logarithm
DECIMALS = 9  # to which two distances are a tie, settled by the rows' own order


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
        Variance of one reading of unstated noise over the process variance. The spread of readings
        at one wrench has its say too (Binois, Gramacy and Ludkovski 2018); without a ratio, not.
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
        Its derivative by the logarithm of a reading's noise, but for what inv(K) tells.
    """
    noise = group.noise + ratio * observation_noise_parts(equations, group)
    made = group._replace(noise=noise)
    factor = factorise(equations, hyperparameters, made, settings, table)
    count, more, scatter = len(factor.T), 0.0, np.zeros(len(group.outputs))
    if ratio > 0:
        chosen = np.ix_(group.rows, group.outputs)
        more = np.maximum(equations.observations[chosen] - 1, 0.0).sum(axis=0).mean()
        scatter = equations.scatter[chosen].sum(axis=0) / ratio
    variance = (count * factor.variance + scatter) / (count + more)
    values = 0.5 * (count + more) * np.log(variance) - np.log(np.diag(factor.T)).sum()
    values += 0.5 * more * np.log(ratio) if more else 0.0
    return factor, variance, values, 0.5 * (more - float((scatter / variance).mean()))


def observation_noise_parts(equations: Equations, group: OutputGroup) -> Floats:
    """Return the variance of a group's values over that of one reading; 0 where noise is stated.

    Shape (r,), dimensionless, the mean over the group's outputs.
    """
    readings = equations.observations[np.ix_(group.rows, group.outputs)]
    parts = np.zeros_like(readings)
    np.divide(1.0, readings, out=parts, where=readings > 0)
    return parts.mean(axis=1)


def negative_log_likelihood(
    logarithms: Floats,
    equations: Equations,
    groups: list[OutputGroup],
    settings: KrigingSettings = DEFAULTS,
) -> tuple[float, Floats]:
    """Return half the negative log likelihood, mean over the outputs, and its gradient.

    The gradient is by the hyperparameters' logarithms, shape (7,), or (8,) with that of the
    variance of one reading of unstated noise over the process variance; all is dimensionless.
    """
    places = equations.loads + equations.weights
    hyperparameters = _hyperparameters(logarithms, equations)
    ratio = float(np.exp(logarithms[places])) if len(logarithms) > places else 0.0
    outputs = sum(len(group.outputs) for group in groups)
    value, gradient = 0.0, np.zeros(places + 1)
    for group in groups:
        try:
            found = profile(equations, hyperparameters, group, ratio, settings)
        except SingularCovarianceError:
            return REFUSED, np.zeros(len(logarithms))
        (factor, variance, likely, by_noise), part = found, len(group.outputs) / outputs
        value += part * float(likely.mean())
        unit = factor.weights / np.sqrt(variance * len(group.outputs))
        sensitivity = factor.T.T @ factor.T - unit @ unit.T
        gradient[:places] += 0.5 * part * _contracted(sensitivity, factor)
        values = numbers(factor.equations.known)[:, 0]
        by_ratio = ratio * observation_noise_parts(equations, group) @ np.diag(sensitivity)[values]
        gradient[places] += part * (0.5 * by_ratio + by_noise)
    return value, gradient[: len(logarithms)]


def _contracted(sensitivity: Floats, factor: KrigingFactor) -> Floats:
    """Return the sum of a symmetric matrix (e, e) times the covariance's seven derivatives."""
    own, hyperparameters = factor.equations, factor.hyperparameters
    # A symmetric matrix's sums by the derivatives that its entries stand with.
    n, places = len(own), own.n_derivatives
    whole = np.zeros((n, places, n, places))
    known = np.flatnonzero(own.known)
    whole.reshape(n * places, n * places)[np.ix_(known, known)] = sensitivity
    one, other = np.triu_indices(n, 1)
    itself = np.einsum("ipiq->pq", whole)
    itself[np.diag_indices(places)] *= 1 + factor.nugget
    pairs = np.concatenate((2 * whole[one, :, other], itself[None]))
    joined, sign = joins(own.loads, places, places)
    shape = (int(joined.max()) + 1, joined.size)
    gather = csr_array((sign.ravel(), (joined.ravel(), np.arange(joined.size))), shape=shape)
    apart = np.concatenate((own.x[one] - own.x[other], np.zeros((1, own.loads))))
    parts, apart = gather @ pairs.reshape(len(pairs), -1).T, np.ascontiguousarray(apart.T)
    order, loads = 2 * order_of(own.n_derivatives, own.loads), own.loads
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
    groups: list[OutputGroup],
    before: Hyperparameters | None = None,
    settings: KrigingSettings = DEFAULTS,
    *,
    with_noise: bool = False,
) -> Hyperparameters:
    """Return the most likely hyperparameters, from two starts or from those before.

    With noise, that of a reading which nobody stated is searched too; all outputs are taken to have
    the same over their process variance.
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
    found = [
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
    best = np.round(min(found, key=lambda run: run.fun).x, settings.decimals)
    return _hyperparameters(best, equations)


def _hyperparameters(logarithms: Floats, equations: Equations) -> Hyperparameters:
    own = logarithms[: equations.loads + equations.weights]
    return Hyperparameters.of_logarithms(own, equations.groups, equations.smoothness)


def observation_noise(
    equations: Equations,
    scaling: Scaling,
    hyperparameters: Hyperparameters,
    before: Floats,
    settings: KrigingSettings,
) -> tuple[Floats, Floats]:
    """Return each output's process variance and that of one of its readings, (6,) each.

    The variance of a reading is the least with which any of several kernels is nearly as likely as
    the most likely one. What may be response and may be noise is taken for response, whose error
    bars are wider; one kernel for all outputs would take for noise what an output alone does.
    Of rows as they lie, near each other too: rows spread widely do not show little noise.

    Parameters
    ----------
    before : ndarray, shape (6,), spreads squared
        Process variances that stated noise is held against.
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
    # the logarithms of a reading's variance over it.
    values, variances = np.full((2, len(kernels), len(ratios), len(before)), REFUSED)
    for number, (kernel, rough) in enumerate(kernels):
        table = covariance(x, known, x, known, kernel)
        if rough:
            table = table + rough * sum(np.exp(-np.abs(one[:, None] - one)) for one in x.T)
        for group in output_groups(chosen, before, settings):
            for place, ratio in enumerate(np.exp(ratios).tolist() if len(group.rows) else ()):
                try:
                    found = profile(chosen, kernel, group, ratio, settings, table)
                except SingularCovarianceError:
                    continue
                variances[number, place, group.outputs] = np.log(found[1])
                values[number, place, group.outputs] = found[2]
    variance, reading = before.copy(), np.zeros_like(before)
    fine = np.arange(ratios[0], ratios[-1], settings.ratio_accuracy)
    for output in np.flatnonzero(~scaling.constant):
        readings, usable = ratios + variances[:, :, output], values[:, :, output] < REFUSED
        usable = usable.all(axis=1)
        smooth = np.array([CubicSpline(ratios, one)(fine) for one in values[usable, :, output]])
        likely = smooth <= smooth.min() + settings.ratio_caution
        at = np.array([np.interp(fine, ratios, one) for one in readings[usable]])
        least = float(at[likely].min())
        own = np.maximum.accumulate(readings[0])  # it grows with the ratio but for rounding
        ratio = np.interp(least, own, ratios)
        reading[output], variance[output] = np.exp(least), np.exp(least - ratio)
    return variance, reading


def estimated(
    equations: Equations, scaling: Scaling, settings: KrigingSettings
) -> tuple[Hyperparameters, Floats, Floats]:
    """Return the hyperparameters of all outputs, and how noisy the rows are.

    Noise counts relative to the process variance, which the hyperparameters decide: with noise the
    likelihood is maximised a second time, with what the first time found. Noise that nobody stated
    is one more hyperparameter, first of all outputs together, then of each by itself.

    Returns
    -------
    hyperparameters : Hyperparameters
    noise_scale : ndarray, shape (6,), spreads squared
        Process variances that noise is held against.
    reading_variance : ndarray, shape (6,), spreads squared
        Of one reading whose uncertainty nobody stated; 0 where all is stated or solved.
    """
    chosen = equations.take(spread_rows(equations, settings.likelihood_equations))
    variance, reading = np.ones_like(scaling.spread), np.zeros_like(scaling.spread)
    unstated = bool((chosen.observations > 0).any())
    if unstated:
        bounds = settings.theta_bounds[0], settings.noise_theta_max
        settings = replace(settings, theta_bounds=bounds)
    before: Hyperparameters | None = None
    noisy = unstated or bool((chosen.noise > settings.nugget).any())
    for stage in range(1 + noisy):
        current = chosen.with_observation_noise(reading)
        # The groups without the outputs that vary by rounding only, and with enough rows.
        varying = [
            group._replace(outputs=group.outputs[~scaling.constant[group.outputs]])
            for group in output_groups(current, variance, settings)
        ]
        groups = [group for group in varying if len(group.outputs) and len(group.rows)]
        before = maximise(current, groups, before, settings, with_noise=unstated and not stage)
        if unstated:
            variance, reading = observation_noise(equations, scaling, before, variance, settings)
            continue
        for group in groups:
            variance[group.outputs] = factorise(chosen, before, group, settings).variance
    assert before is not None
    return before, variance, reading


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
