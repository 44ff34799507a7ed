"""Maximum likelihood of the hyperparameters, with the process variances and mean profiled.

Half the negative logarithm of the likelihood is, for each output of e equations with covariance
s^2 K and profiled s^2, (e log s^2 + log det K) / 2; its derivative by a parameter is
tr((inv(K) - a a' / s^2) dK) / 2 with a = inv(K) (y - F b).
"""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .correlation import Hyperparameters
from .equations import Equations, Scaling, farthest_first
from .factor import OutputGroup, SingularCovarianceError, factorise, output_groups
from .gradient import contracted, minimised
from .noise import REFUSED, Estimate, estimate_noise
from .settings import DEFAULTS, KrigingSettings


def negative_log_likelihood(
    logarithms: Floats,
    equations: Equations,
    groups: list[OutputGroup],
    settings: KrigingSettings = DEFAULTS,
) -> tuple[float, Floats]:
    """Return half the negative log likelihood, mean over the outputs, and its gradient.

    The gradient is by the hyperparameters' logarithms, shape (7,); all is dimensionless.
    """
    hyperparameters = _hyperparameters(logarithms, equations)
    outputs = sum(len(group.outputs) for group in groups)
    value = 0.0
    gradient = np.zeros(len(logarithms))
    for group in groups:
        try:
            factor = factorise(equations, hyperparameters, group, settings)
        except SingularCovarianceError:
            return REFUSED, np.zeros(len(logarithms))
        fraction = len(group.outputs) / outputs
        likelihoods = 0.5 * len(factor.T) * np.log(factor.variance)
        likelihoods -= np.log(np.diag(factor.T)).sum()
        value += fraction * float(likelihoods.mean())
        unit = factor.weights / np.sqrt(factor.variance * len(group.outputs))
        sensitivity = factor.T.T @ factor.T - unit @ unit.T
        derivative = contracted(sensitivity, factor.equations, hyperparameters, factor.nugget)
        gradient += 0.5 * fraction * derivative
    return value, gradient


def maximise(
    equations: Equations, groups: list[OutputGroup], settings: KrigingSettings = DEFAULTS
) -> Hyperparameters:
    """Return the most likely hyperparameters, from two starts."""
    bounds = [settings.theta_bounds] * equations.loads
    bounds += [settings.weight_bounds] * equations.weights
    weights = [0.0] * (equations.weights - 1) + [settings.weight_start]
    # With second derivatives the first start ended at the higher maximum, or both starts at the
    # same, for 35 of 35 tables: real solves of `plate_thin` and synthetic parts.
    thetas = settings.theta_starts[: 1 if equations.weights > 1 else None]
    starts = [np.array([theta] * equations.loads + weights) for theta in thetas]
    arguments = bounds, settings, equations, groups
    runs = [minimised(negative_log_likelihood, start, *arguments) for start in starts]
    return _hyperparameters(min(runs, key=itemgetter(1))[0], equations)


def _hyperparameters(logarithms: Floats, equations: Equations) -> Hyperparameters:
    return Hyperparameters.of_logarithms(logarithms, equations.groups, equations.smoothness)


def estimated(
    equations: Equations, scaling: Scaling, points: Floats, settings: KrigingSettings
) -> Estimate:
    """Return the covariances of outputs and the noise of rows.

    Outputs of solves share one covariance. Noise is estimated where rows have any.

    `points`: see `estimate_noise`.
    """
    ones = np.ones_like(scaling.spread)
    if (equations.unit_noise[:, ~scaling.constant] > settings.nugget).any():
        return estimate_noise(equations, scaling, points, settings)
    chosen = equations.take(spread_rows(equations, settings.likelihood_equations))
    # The groups that have enough rows, without outputs that vary by rounding only.
    varying = [
        group._replace(outputs=group.outputs[~scaling.constant[group.outputs]])
        for group in output_groups(chosen, ones, settings)
    ]
    groups = [group for group in varying if len(group.outputs) and len(group.rows)]
    kernel = maximise(chosen, groups, settings=settings)
    return Estimate((kernel,) * len(ones), ones, np.zeros_like(ones), ones, ones)


def limited_to_factor(equations: Equations, settings: KrigingSettings) -> Equations:
    """Return the equations that fit into a factor: second derivatives of as many rows as possible.

    Where slopes alone are too many, only as many rows as fit count, with their slopes: with 1,500
    solves errors were 0.6 to 1.0 times those of all values and as many slopes as fit. These rows
    are spread farthest: slopes count most between distant rows.
    """
    limit = settings.dense_equations
    if equations.count <= limit:
        return equations
    second = equations.known & (np.arange(equations.n_derivatives) > equations.loads)
    plain = replace(equations, known=equations.known & ~second)
    if plain.count >= limit:
        return plain.take(spread_rows(plain, limit))
    with_second = np.zeros((len(equations), 1), dtype=bool)
    with_second[spread_rows(replace(equations, known=second), limit - plain.count)] = True
    return replace(equations, known=plain.known | second & with_second)


def spread_rows(equations: Equations, max_equations: int) -> NDArray[np.intp]:
    """Return rows within the limit, each the farthest from those before it, in ascending order.

    Shape (k,): indices of the rows.
    """
    total = 0
    chosen = []
    for row in farthest_first(equations.x):
        total += int(equations.known[row].sum())
        if chosen and total > max_equations:
            break
        chosen.append(row)
    return np.sort(chosen)
