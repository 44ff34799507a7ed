"""The noise of measured rows, by restricted likelihood, and each output's covariance.

Readings of an output have the covariance s^2 (K + r D) about the mean F b. D is known, one over
the number of readings behind a row or its stated variance; r is the noise over the process
variance. With D^(-1/2) F projected away (Patterson and Thompson 1971) and the eigenvalues l of what
remains of D^(-1/2) K D^(-1/2), z the readings along its eigenvectors, half the negative logarithm
of the restricted likelihood is, for every r without another factor,

    (m log s^2 + sum log(l_i + r)) / 2,   s^2 = sum(z_i^2 / (l_i + r)) / m.

Several readings at a wrench bring their scatter about their mean (Binois, Gramacy and Ludkovski
2018). Equations without noise, of solves and slopes, are eliminated first.

An output has length scales of its own where rows bring values alone: one of six that bends by a
load where the others are straight would be taken for noise. Noise is averaged over its posterior
and that of lengths; what these leave open of the response is in the error bars by the law of total
variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..calibration import CONFIDENCE
from ..table.rows import Floats
from .correlation import (
    Hyperparameters,
    covariance,
    matern,
    mean_terms,
    squared_differences,
    symmetric,
)
from .equations import Equations, Scaling, evenly
from .factor import (
    Indices,
    OutputGroup,
    SingularCovarianceError,
    factorise,
    inverse_factor,
    output_groups,
)
from .gradient import contracted, minimised
from .settings import KrigingSettings

# Half the negative log likelihood of a covariance without a factor: above any other.
REFUSED = 1e10
TINY = 1e-30  # variance, spreads squared, below any rounding


class Estimate(NamedTuple):
    """The quantities that the likelihood determines, of each output."""

    kernels: tuple[Hyperparameters, ...]  # the same object for outputs of one covariance
    variance: Floats  # (6,), spreads squared: process variances
    noise: Floats  # (6,), dimensionless: factor on `Equations.unit_noise`
    # (6,), dimensionless: deviation of the response with all uncertainty of kernel and noise, over
    # the deviation with the single kernel
    widening: Floats
    # (6,), dimensionless: largest deviation of the noise, at the confidence of error bars, over its
    # estimate
    noise_widening: Floats


class NoisyRows(NamedTuple):
    """Outputs that the same rows bring with noise in the same proportions."""

    equations: Equations  # equations of these rows
    outputs: NDArray[np.intp]  # (k,)
    parts: Floats  # (e,): the diagonal of D; 0 of equations without noise
    scale: Floats  # (k,): `Equations.unit_noise` is D times this
    # repeats, scatter: (k,): readings besides the first of each wrench, and their squared
    # differences from their mean over this scale
    repeats: Floats
    scatter: Floats
    basis: Floats  # (e, m): normal to D^(-1/2) F; none where some equations have no noise
    # (6, e (e + 1) / 2): squared differences of pairs of rows; none where rows bring slopes
    squares: Floats

    def output(self, index: int) -> NoisyRows:
        """Return the rows with a single output."""
        names = "outputs", "scale", "repeats", "scatter"
        return self._replace(**{name: getattr(self, name)[[index]] for name in names})


def noisy_rows(
    equations: Equations, scaling: Scaling, settings: KrigingSettings
) -> list[NoisyRows]:
    """Return the rows whose noise is estimated, for each group of outputs."""
    unit = equations.unit_noise
    noisy = []
    with_noise = _with_noise(equations, scaling)
    size = np.log(np.where(with_noise, unit, 1.0)).sum(axis=0)
    scale = np.exp(size / np.maximum(with_noise.sum(axis=0), 1))
    groups = output_groups(replace(equations, noise=unit), scale, settings)
    for group in groups:
        outputs = group.outputs[with_noise[:, group.outputs].any(axis=0)]
        if not len(outputs):
            continue
        rows = equations.take(group.rows)
        known = rows.known
        basis = np.empty((0, 0))
        squares = np.empty((0, 0))
        parts = np.zeros(known.shape)
        parts[:, 0] = group.noise
        if (parts[known] > 0).all():
            terms = mean_terms(rows.x, known)
            left, sizes, _ = np.linalg.svd(terms / np.sqrt(parts[known])[:, None])
            # Directions in which the rows vary less than this are determined by the mean's prior.
            basis = left[:, (sizes > sizes[0] / np.sqrt(settings.mean_variance)).sum() :]
        if not known[:, 1:].any():
            squares = squared_differences(rows.x).T
        repeats = np.maximum(rows.observations[:, outputs] - 1, 0.0).sum(axis=0)
        scatter = rows.scatter[:, outputs].sum(axis=0) / equations.typical_noise[outputs]
        scatter *= scale[outputs]
        parts = parts[known]
        noisy.append(
            NoisyRows(rows, outputs, parts, scale[outputs], repeats, scatter, basis, squares)
        )
    return noisy


def _with_noise(equations: Equations, scaling: Scaling) -> NDArray[np.bool_]:
    """Return which outputs of which rows are readings whose noise is estimated, (rows, outputs)."""
    return (equations.unit_noise > 0) & equations.measured & ~scaling.constant


class Spectrum(NamedTuple):
    """The diagonalising transform for every r: T s^2 (K + r D) T' = s^2 diag(values + r noisy)."""

    rotation: Floats  # (m, e): T
    values: Floats  # (m,)
    noisy: Floats  # (m,)
    data: Floats  # (m, k), spreads: T times the readings
    logarithm: float  # logarithm of T's determinant, as far as it depends on the covariance
    # correlation of pairs of rows for each term, and its derivative by q; empty with slopes
    terms: list[list[Floats]]


def spectrum(rows: NoisyRows, kernel: Hyperparameters, settings: KrigingSettings) -> Spectrum:
    """Return the spectrum of a kernel.

    Raises SingularCovarianceError if solves contradict each other.
    """
    x = rows.equations.x
    known = rows.equations.known
    terms = []
    if len(rows.squares):
        rates, weights = kernel.terms
        terms = [matern(rate @ rows.squares, 1, kernel.smoothness) for rate in rates]
        values = [weight * m[0] for weight, m in zip(weights, terms, strict=True)]
        matrix = symmetric(np.sum(values, axis=0), len(x))
    else:
        matrix = covariance(x, known, x, known, kernel)
    prior = np.tile(kernel.prior(rows.equations.n_derivatives), (len(x), 1))[known]
    matrix[np.diag_indices_from(matrix)] += settings.nugget * prior

    data = rows.equations.data[known][:, rows.outputs]
    exact = rows.parts <= 0
    white = 1 / np.sqrt(rows.parts[~exact])
    if not exact.any():
        basis = white[:, None] * rows.basis
        values, vectors = np.linalg.eigh(basis.T @ matrix @ basis)
        rotation = vectors.T @ basis.T
        count, logarithm = 0, 0.0
    else:  # eliminate the equations without noise
        mean = mean_terms(x, known)
        matrix += settings.mean_variance * mean @ mean.T
        inverse, _ = inverse_factor(
            matrix[np.ix_(exact, exact)], settings.nugget, settings.nugget_limit, prior[exact]
        )
        count = len(inverse)
        logarithm = -float(np.log(np.diag(inverse)).sum())
        across = inverse @ matrix[np.ix_(exact, ~exact)]
        remainder = matrix[np.ix_(~exact, ~exact)] - across.T @ across
        values, vectors = np.linalg.eigh(white[:, None] * remainder * white)
        rotation = np.zeros_like(matrix)
        rotation[:count, exact], rotation[count:, ~exact] = inverse, vectors.T * white
        rotation[count:, exact] = -rotation[count:, ~exact] @ across.T @ inverse
    values = np.append(np.ones(count), np.maximum(values, 0.0))
    noisy = (np.arange(len(values)) >= count).astype(float)
    return Spectrum(rotation, values, noisy, rotation @ data, logarithm, terms)


class Posterior(NamedTuple):
    """The posterior at g ratios of noise over process variance, for outputs (k,)."""

    values: Floats  # (g, k): half the negative logarithm
    variance: Floats  # (g, k), spreads squared: of the process
    noise: Floats  # (g, k), spreads squared: noise of a row where D is 1
    inverse: Floats  # (g, m): 1 / (l + r d), d 1 of rows with noise and 0 of others
    # (g, k): half the derivative of `values` by the sum of squares, times the process variance
    by_square: Floats


def posterior(rows: NoisyRows, eigen: Spectrum, settings: KrigingSettings) -> Posterior:
    """Return the posterior of the ratios of the settings, the process variance integrated out."""
    ratios = np.exp(np.arange(*settings.ratio_bounds, settings.ratio_step))[:, None]
    inverse = 1 / (eigen.values + ratios * eigen.noisy)
    # 0 where the rows determine nothing but the mean.
    freedom = np.maximum(len(eigen.values) + rows.repeats, 1.0)
    variance = np.maximum((inverse @ eigen.data**2 + rows.scatter / ratios) / freedom, TINY)
    values = 0.5 * (freedom * np.log(variance) + rows.repeats * np.log(ratios)) + eigen.logarithm
    values -= 0.5 * np.log(inverse).sum(axis=1)[:, None]
    stated = not (rows.equations.observations > 0).any()
    centre, deviation = settings.stated_prior if stated else settings.noise_prior
    away = (np.log(ratios * variance / rows.scale) - centre) / deviation
    by_square = 1 + 2 * away / deviation / freedom
    return Posterior(values + 0.5 * away**2, variance, ratios * variance, inverse, by_square)


def negative_log_posterior(
    logarithms: Floats, groups: list[NoisyRows], settings: KrigingSettings
) -> tuple[float, Floats]:
    """Return half the negative log posterior of a kernel, mean over outputs, and its gradient.

    Noise and process variance of each output are integrated out. The gradient is by the
    hyperparameters' logarithms, shape (7,).
    """
    example = groups[0].equations
    kernel = Hyperparameters.of_logarithms(logarithms, example.groups, example.smoothness)
    gradient = np.zeros(len(logarithms))
    centre, deviation = settings.length_prior
    away = (logarithms[: example.loads] - centre) / deviation
    total, gradient[: example.loads] = 0.5 * float(away @ away), away / deviation
    for rows in groups:
        try:
            eigen = spectrum(rows, kernel, settings)
        except SingularCovarianceError:
            return REFUSED, np.zeros(len(logarithms))
        result = posterior(rows, eigen, settings)
        # The posterior probability of each ratio, (g, k).
        least = result.values.min(axis=0)
        probability = np.exp(least - result.values)
        total += float((least - np.log(probability.mean(axis=0))).sum())
        probability /= probability.sum(axis=0)

        solved = (result.inverse[:, :, None] * eigen.data).transpose(1, 0, 2)
        solved = solved.reshape(len(eigen.data), probability.size)
        weight = (probability / result.variance * result.by_square).ravel()
        middle = np.diag(probability.sum(axis=1) @ result.inverse) - (solved * weight) @ solved.T
        sensitivity = eigen.rotation.T @ middle @ eigen.rotation
        if not eigen.terms:
            derivative = contracted(sensitivity, rows.equations, kernel, settings.nugget)
        else:
            derivative = _contracted_values(
                sensitivity, rows.squares, eigen.terms, kernel, settings.nugget
            )
        gradient += 0.5 * derivative
    count = sum(len(rows.outputs) for rows in groups)
    return total / count, gradient / count


def _contracted_values(
    sensitivity: Floats,
    squares: Floats,
    terms: list[list[Floats]],
    kernel: Hyperparameters,
    nugget: float,
) -> Floats:
    """Return the result of `contracted` for equations of values alone."""
    first, second = np.triu_indices(len(sensitivity))
    pairs = sensitivity[first, second] * np.where(first == second, 1 + nugget, 2.0)
    rates, weights = kernel.terms
    by_rate = sum(
        np.where(rate > 0, weight, 0.0) * (squares @ (pairs * m[1]))
        for rate, weight, m in zip(rates, weights, terms, strict=True)
    )
    by_weight = [weight * (pairs @ m[0]) for weight, m in zip(weights, terms, strict=True)]
    return np.append(by_rate * kernel.inverse_squares, by_weight[-len(kernel.weights) :])


def _evenly(equations: Equations, rows: Indices, limit: int) -> Indices:
    """Return an even choice of `rows` with about `limit` equations, at least one row."""
    count = int(np.searchsorted(np.cumsum(equations.known[rows].sum(axis=1)), limit))
    return rows[evenly(len(rows), max(count, 1))]


def estimate_noise(
    equations: Equations, scaling: Scaling, points: Floats, settings: KrigingSettings
) -> Estimate:
    """Return the noise and the kernels of outputs.

    All rows count, near each other or not: widely spread rows alone would hide small noise.

    `points` (m, 6), half ranges: where answers' variance is averaged: see `Estimate.widening`.
    """
    search = _sample(equations, scaling, settings, settings.search_equations)
    complete = _sample(equations, scaling, settings, settings.likelihood_equations)
    samples = [(search, complete)]
    if all(len(rows.squares) for rows in search):  # each output has a kernel of its own
        all_rows = _by_output(complete)
        samples = [([rows], [all_rows[output]]) for output, rows in _by_output(search).items()]
    n_outputs = len(scaling.spread)
    level = 1 - (1 - CONFIDENCE) / n_outputs
    estimates: dict[int, _OutputEstimate] = {}
    for search_rows, rows in samples:
        estimates |= _fitted(search_rows, rows, points, settings, level)
    without_noise = _OutputEstimate(estimates[min(estimates)].kernel, 1.0, 0.0, 1.0, 1.0)
    outputs = [estimates.get(output, without_noise) for output in range(n_outputs)]
    return Estimate(
        kernels=tuple(output.kernel for output in outputs),
        variance=np.array([output.variance for output in outputs]),
        noise=np.array([output.noise for output in outputs]),
        widening=np.array([output.widening for output in outputs]),
        noise_widening=np.array([output.noise_widening for output in outputs]),
    )


def _sample(
    equations: Equations, scaling: Scaling, settings: KrigingSettings, limit: int
) -> list[NoisyRows]:
    """Return an even choice of rows with about `limit` equations, and of readings if it has none.

    An even choice may miss a few readings among many solves.
    """
    noisy = _with_noise(equations, scaling)
    chosen = _evenly(equations, np.arange(len(equations)), limit)
    missed = noisy.any(axis=0) & ~noisy[chosen].any(axis=0)
    if missed.any():
        readings = np.flatnonzero(noisy[:, missed].any(axis=1))
        chosen = np.union1d(chosen, _evenly(equations, readings, limit // 2))
    return noisy_rows(equations.take(chosen), scaling, settings)


def _by_output(groups: list[NoisyRows]) -> dict[int, NoisyRows]:
    """Return the rows of each output alone."""
    return {
        int(output): rows.output(index)
        for rows in groups
        for index, output in enumerate(rows.outputs)
    }


class _OutputEstimate(NamedTuple):
    """An output's part of `Estimate`."""

    kernel: Hyperparameters
    variance: float
    noise: float
    widening: float
    noise_widening: float


class _Candidate(NamedTuple):
    """A likely kernel, and the posterior of each group of rows by it."""

    logarithms: Floats
    kernel: Hyperparameters
    posteriors: list[Posterior]


class _Mixture(NamedTuple):
    """Posteriors of k outputs of the same rows by each candidate, with their probabilities."""

    rows: NoisyRows
    kernels: list[Hyperparameters]
    posteriors: list[Posterior]  # by each kernel
    weights: Floats  # (kernels, g, k): probability of each kernel and noise ratio
    chosen: int  # index of the kernel in use


def _fitted(
    search: list[NoisyRows],
    complete: list[NoisyRows],
    points: Floats,
    settings: KrigingSettings,
    level: float,
) -> dict[int, _OutputEstimate]:
    """Return the estimate of each output of the rows; all have one kernel.

    `search`: the rows used in the search for the kernel.
    `complete`: the rows used for everything else.
    `level`: probability that the noise is below its largest deviation.
    """
    candidates = _candidates(search, complete, settings)
    logarithms = np.array([candidate.logarithms for candidate in candidates])
    centre, deviation = settings.length_prior
    lengths = logarithms[:, : search[0].equations.loads]
    prior = 0.5 * (((lengths - centre) / deviation) ** 2).sum(axis=1)
    joint = -prior
    weights = []
    for group in range(len(complete)):
        values = np.array([item.posteriors[group].values for item in candidates])  # (kernels, g, k)
        joint = joint + np.logaddexp.reduce(-values, axis=1).sum(axis=1)
        values += prior[:, None, None]
        weight = np.exp(values.min(axis=(0, 1)) - values)
        weights.append(weight / weight.sum(axis=(0, 1)))
    chosen = int(np.argmax(joint))

    kernels = [candidate.kernel for candidate in candidates]
    estimates = {}
    for group, rows in enumerate(complete):
        posteriors = [candidate.posteriors[group] for candidate in candidates]
        mixture = _Mixture(rows, kernels, posteriors, weights[group], chosen)
        for index, output in enumerate(rows.outputs):
            estimates[int(output)] = _output_estimate(mixture, index, points, settings, level)
    return estimates


def _candidates(
    search: list[NoisyRows], complete: list[NoisyRows], settings: KrigingSettings
) -> list[_Candidate]:
    """Return the likely kernels whose covariance is not singular, at least one."""
    example = search[0].equations
    candidates = []
    singular = SingularCovarianceError()
    for row in _likely_logarithms(search, settings):
        kernel = Hyperparameters.of_logarithms(row, example.groups, example.smoothness)
        try:  # solves may bear the likeliest lengths and not those shifted from them
            posteriors = [
                posterior(rows, spectrum(rows, kernel, settings), settings) for rows in complete
            ]
        except SingularCovarianceError as error:
            singular = error
            continue
        candidates.append(_Candidate(row, kernel, posteriors))
    if not candidates:
        raise singular
    return candidates


def _output_estimate(
    mixture: _Mixture, index: int, points: Floats, settings: KrigingSettings, level: float
) -> _OutputEstimate:
    """Return the estimate of the output `index` of the rows, at points (m, 6), half ranges."""
    rows, kernels, posteriors, weights, chosen = mixture
    of_kernels = weights[:, :, index].sum(axis=1)
    means = [
        float(part[:, index] @ item.noise[:, index] / max(part[:, index].sum(), TINY))
        for part, item in zip(weights, posteriors, strict=True)
    ]
    noise = float(of_kernels @ means)
    largest = _noise_quantile(posteriors, weights, index, level)
    variance = variance_of(posteriors[chosen], index, noise)
    mean, known = _answers(rows, index, kernels[chosen], noise, variance, points, settings)
    total = np.zeros(len(points))
    used = np.flatnonzero(of_kernels > settings.min_probability)
    for k in used:
        size = variance_of(posteriors[k], index, means[k])
        moved, spread = _answers(rows, index, kernels[k], means[k], size, points, settings)
        total += of_kernels[k] / of_kernels[used].sum() * (spread + (moved - mean) ** 2)
    return _OutputEstimate(
        kernel=kernels[chosen],
        variance=variance,
        noise=noise / rows.scale[index],
        widening=float(np.sqrt(max(float(total.mean() / known.mean()), 1.0))),
        noise_widening=float(np.sqrt(max(largest / noise, 1.0))),
    )


def _likely_logarithms(rows: list[NoisyRows], settings: KrigingSettings) -> Floats:
    """Return the logarithms of the likeliest kernel, and of kernels with all lengths shifted."""
    loads, weights = rows[0].equations.loads, rows[0].equations.weights
    low, high = np.array([settings.theta_bounds] * loads + [settings.weight_bounds] * weights).T
    start = np.full(loads + weights, settings.length_prior[0])
    start[loads:] = [0.0] * (weights - 1) + [settings.weight_start]
    bounds = list(zip(low, high, strict=True))
    best, _ = minimised(negative_log_posterior, start, bounds, settings, rows)
    shifts = np.zeros((len(settings.length_shifts), loads + weights))
    shifts[:, :loads] = np.array(settings.length_shifts)[:, None]
    return np.clip(best + shifts, low, high)


def _noise_quantile(
    posteriors: Sequence[Posterior], weight: Floats, index: int, level: float
) -> float:
    """Return the quantile of an output's noise, where D is 1, over all kernels and ratios.

    With few rows it is unclear how much of their differences is noise: the mean of a wide
    posterior, itself uncertain, was a third of the noise of 30 to 60 rows.
    """
    noises = np.concatenate([item.noise[:, index] for item in posteriors])
    order = np.argsort(noises)
    weights = weight[:, :, index].ravel()
    below = np.cumsum(weights[order]) - weights[order] / 2
    return float(np.exp(np.interp(level, below, np.log(noises[order]))))


def variance_of(result: Posterior, index: int, noise: float) -> float:
    """Return the process variance of an output, spreads squared, at a noise where D is 1."""
    rising = np.maximum.accumulate(np.log(result.noise[:, index]))  # ascending except for rounding
    return float(np.exp(np.interp(np.log(noise), rising, np.log(result.variance[:, index]))))


def _answers(
    rows: NoisyRows,
    index: int,
    kernel: Hyperparameters,
    noise: float,
    variance: float,
    points: Floats,
    settings: KrigingSettings,
) -> tuple[Floats, Floats]:
    """Return an output's mean and variance at points, (m,), spreads and spreads squared."""
    equations = rows.equations
    diagonal = np.zeros(equations.known.shape)
    diagonal[equations.known] = rows.parts * noise / variance
    group = OutputGroup(rows.outputs[[index]], np.arange(len(equations)), diagonal[:, 0])
    factor = factorise(equations, kernel, group, settings)
    reduced, remainder = factor.explained_at(points)
    Ty = factor.T @ equations.data[equations.known][:, group.outputs]
    mean = reduced @ Ty + remainder @ factor.coefficients
    deviation = factor.variance_of(reduced, remainder, factor.mean_covariance)
    return mean[:, 0], variance * deviation
