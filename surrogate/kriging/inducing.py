"""Kriging of many measured rows through a few inducing wrenches (Titsias 2009).

The response at N rows is approximated by its expectation from its values at m of their wrenches, Z.
With K = k(Z, Z) = L L', W = inv(L) k(Z, X) and the noise v_i of row i over the process variance,
the rows enter by sums over all of them:

    A = W D W',   b = W D y,   G = W D F,   H = F' D F,   D = diag(1 / v_i),   B = I + A

and, with beta the mean's coefficients, of variance P, and q = inv(L) k(Z, w),

    mean(w) = q' inv(B) (b - G beta) + f(w)' beta,   cov(beta) = C = inv(H - G' inv(B) G + 1/P)
    var(w) = k(w, w) - q' (I - inv(B)) q + r' C r,   r = f(w) - G' inv(B) q.

That is a kriging of m rows at Z whose readings L inv(A) b have the noise S = L inv(A) L', with the
triangle T of T'T = inv(K + S), and is answered, calibrated and packed as such. As each inducing
wrench is a row's, S is at most the noise of that row.

The mean projected away and the eigenvalues of A for v = 1 give the likelihood of all rows for every
noise. The part of the response that Z does not determine counts as noise in the likelihood, and is
in var(w) too.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from ..table.rows import Floats
from .correlation import Hyperparameters, covariance, mean_terms
from .equations import Equations, evenly
from .factor import (
    ROUNDING_VARIANCE,
    Factor,
    Indices,
    KrigingFactor,
    OutputGroup,
    inverse_factor,
    output_groups,
)
from .noise import Estimate
from .settings import KrigingSettings

# Rows of a block: with 256 inducing wrenches 256 kB of covariances, in a processor's cache.
BLOCK_ROWS = 128
# Decimals of a remaining variance over the prior's: equal ones are a tie; the first row is taken.
TIE_DECIMALS = 9
TINY = 1e-13  # added to the eigenvalues of A, so that none is 0: above their rounding
STEP = 0.1  # of the logarithm of the noise's variance: an error of 5 % at most
# Rows among which inducing wrenches are chosen, evenly: four times the most inducing wrenches.
CANDIDATES = 4000


def spread_points(
    x: Floats,
    kernels: list[Hyperparameters],
    signal_to_noise: Floats,
    count: int,
    settings: KrigingSettings,
) -> tuple[Indices, bool]:
    """Return the rows that best determine the response at the others, and whether they are enough.

    The rows are the pivots of a Cholesky factor of the prior's covariance. They are enough when the
    remaining variance, mean over the rows, is at most that of the answers, which is the noise times
    wrenches over rows: more rows would not improve an answer beyond the noise.

    `x` (n, 6), half ranges: candidates.
    `kernels`, `signal_to_noise`: covariances of outputs, and their process variances over a row's
    noise, (k,).
    `count`: number of all rows.
    """
    known = np.ones((len(x), 1), dtype=bool)
    weighted = list(zip(kernels, signal_to_noise / len(signal_to_noise), strict=True))
    prior = sum(float(kernel.prior(1)[0]) * weight for kernel, weight in weighted)
    remaining = np.full(len(x), prior)
    chosen = list[int]()
    limit = min(settings.inducing, len(x) // 2)  # with more one factor of all rows costs less
    reduced = np.empty((limit, len(x)))
    while (size := len(chosen)) < limit:
        if remaining.mean() <= size / count:
            return np.array(chosen, dtype=np.intp), True
        pivot = int(np.argmax(np.round(remaining / prior, TIE_DECIMALS)))
        if remaining[pivot] <= settings.nugget * prior:
            break
        column = -reduced[:size, pivot] @ reduced[:size]
        for kernel, weight in weighted:
            column += weight * covariance(x[[pivot]], known[:1], x, known, kernel)[0]
        reduced[size] = column / np.sqrt(remaining[pivot])
        remaining = np.maximum(remaining - reduced[size] ** 2, 0.0)
        remaining[pivot] = 0.0
        chosen.append(pivot)
    return np.array(chosen, dtype=np.intp), bool(remaining.mean() <= len(chosen) / count)


def values_between(x: Floats, v: Floats, kernel: Hyperparameters) -> Floats:
    """Return the covariance of values at x (n, 6) and v (m, 6), shape (n, m), by Matern 7/2.

    With s the scaled distance it is (1 + s + 2/5 s^2 + s^3/15) exp(-s), computed in place: a fifth
    of the time of `covariance`. Squared distances are sums of squares and products, which lose
    1e-15 of a squared length.
    """
    out = np.zeros((len(x), len(v)))
    for rates, weight in zip(*kernel.terms, strict=True):
        loads = np.flatnonzero(rates)
        scale = np.sqrt(7 * rates[loads])
        scaled_x, scaled_v = x[:, loads] * scale, v[:, loads] * scale
        squared = scaled_x @ (-2 * scaled_v.T)
        squared += (scaled_x**2).sum(axis=1)[:, None]
        squared += (scaled_v**2).sum(axis=1)
        np.maximum(squared, 0.0, out=squared)
        s = np.sqrt(squared)
        term = s * (1 / 15)
        term += 0.4
        term *= squared
        term += s
        term += 1.0
        np.negative(s, out=s)
        term *= np.exp(s, out=s)
        if weight != 1.0:
            term *= weight
        out += term
    return out


class Sums(NamedTuple):
    """Sums of the module over the rows of k outputs, whose noise is in the same proportions.

    D is of the rows' relative noise.
    """

    outputs: Indices  # (k,)
    prior: Factor  # factor of the inducing wrenches: its T is inv(L)
    A: Floats  # (m, m)
    b: Floats  # (m, k)
    G: Floats  # (m, 7)
    H: Floats  # (7, 7)
    h: Floats  # (7, k): F' D y
    square: Floats  # (k,): y' D y
    rows: int
    repeats: Floats  # (k,): readings at wrenches besides the first of each
    # (k,): their squared differences from their mean, over their relative noise, spreads squared
    scatter: Floats


class LikelyNoise(NamedTuple):
    """The noise that the restricted likelihood of all rows determines, for outputs (k,)."""

    ratios: Floats  # (k,), dimensionless: noise over process variance
    variances: Floats  # (k,), spreads squared: process variances


class Inducing(NamedTuple):
    """The kriging of all rows through inducing wrenches."""

    equations: Equations  # at the inducing wrenches, with the readings that all rows make there
    factors: list[KrigingFactor]
    noise: Floats  # (6,), dimensionless: factor on `Equations.unit_noise`, from all rows


def induced(
    equations: Equations,
    estimate: Estimate,
    settings: KrigingSettings,
    dependence: Floats | float = 1.0,
) -> Inducing | None:
    """Return the kriging of all rows; None if one factor of all rows is better.

    One factor is better if it has room for all rows and inducing wrenches leave more variance than
    the noise, or if no output has noise.

    `equations`: of the values of all rows, sorted by wrench; without the noise of observations.
    `estimate`: hyperparameters and noise from some of the rows.
    `dependence` (6,): see `serial.dependence_of`; 1 for independent readings.
    """
    unit = equations.unit_noise
    typical = np.nanmean(np.where(equations.measured, unit, np.nan), axis=0)
    rows = _inducing_rows(equations, estimate, typical, settings)
    if rows is None:
        return None
    pseudo = _without_readings(equations.take(rows))
    relative = replace(equations, noise=np.maximum(unit, settings.nugget * typical))

    z, known = pseudo.x, pseudo.known

    def summed(group: OutputGroup) -> Sums:
        kernel = estimate.kernels[group.outputs[0]]
        variances = np.tile(kernel.prior(1), len(z))
        matrix = covariance(z, known, z, known, kernel)
        matrix[np.diag_indices_from(matrix)] += settings.nugget * variances
        inverse, nugget = inverse_factor(matrix, settings.nugget, settings.nugget_limit, variances)
        prior = Factor(kernel, nugget, inverse, inverse @ mean_terms(z, known))
        return sums_of(equations, group, z, prior)

    factors = list[KrigingFactor]()
    noise = estimate.noise.copy()
    groups = output_groups(relative, typical, settings, estimate.kernels)
    # The threads give the same bits on any number of processors.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for sums in pool.map(summed, groups):
            outputs, likely = sums.outputs, likely_noise(sums, settings)
            # An output that does not vary has the mean ratio of those that do.
            is_varying = estimate.noise[outputs] > 0
            if is_varying.any():
                likely.ratios[~is_varying] = np.exp(np.log(likely.ratios[is_varying]).mean())
            noise[outputs] = likely.ratios * likely.variances / typical[outputs]
            of_outputs = np.broadcast_to(dependence, noise.shape)[outputs]
            likely = likely._replace(ratios=likely.ratios * of_outputs)
            factors.append(posterior_factor(sums, likely, pseudo, settings))
    return Inducing(pseudo, factors, noise)


def _inducing_rows(
    equations: Equations, estimate: Estimate, typical: Floats, settings: KrigingSettings
) -> Indices | None:
    """Return the rows whose wrenches are inducing, ascending; None if one factor is better.

    `typical` (6,), spreads squared: mean unit noise of the rows.
    """
    count = len(equations)
    variance = estimate.variance
    fits_one_factor = count <= settings.dense_equations
    noisy = np.flatnonzero(estimate.noise * typical > settings.nugget * variance)
    if not len(noisy) and fits_one_factor:
        return None
    noisy = noisy if len(noisy) else np.arange(len(variance))
    ratio = np.maximum(estimate.noise * typical / variance, settings.nugget)
    candidates = evenly(count, CANDIDATES)
    kernels = [estimate.kernels[output] for output in noisy]
    points, are_enough = spread_points(
        equations.x[candidates], kernels, 1 / ratio[noisy], count, settings
    )
    return np.sort(candidates[points]) if are_enough or not fits_one_factor else None


def _without_readings(equations: Equations) -> Equations:
    """Return equations with readings of zero and no noise, with columns for slopes too."""
    shape = equations.measured.shape
    n_derivatives = 1 + equations.loads
    return replace(
        equations,
        known=np.arange(n_derivatives) < equations.known,
        data=np.zeros((len(equations), n_derivatives, shape[1])),
        measured=np.ones(shape, dtype=bool),
        noise=np.zeros(shape),
        observations=np.zeros(shape),
        scatter=np.zeros(shape),
    )


def sums_of(equations: Equations, group: OutputGroup, z: Floats, prior: Factor) -> Sums:
    """Return the sums over the rows of a group; `z` (m, 6), half ranges: inducing wrenches."""
    kernel, loads, outputs = prior.hyperparameters, equations.loads, group.outputs
    A = np.zeros((len(z), len(z)))
    moments = np.zeros((1 + loads, 1 + loads + len(outputs)))
    crossed = np.zeros((len(z), moments.shape[1]))
    square = np.zeros(len(outputs))
    for start in range(0, len(group.rows), BLOCK_ROWS):
        rows = group.rows[start : start + BLOCK_ROWS]
        x = equations.x[rows]
        values = equations.data[rows, 0][:, outputs]
        explained = values_between(x, z, kernel) @ prior.T.T  # W'
        precision = 1 / group.noise[start : start + BLOCK_ROWS]  # D
        terms = np.concatenate((np.ones((len(rows), 1)), x, values), axis=1)
        weighted = explained * np.sqrt(precision)[:, None]
        A += weighted.T @ weighted
        crossed += explained.T @ (precision[:, None] * terms)
        moments += terms[:, : 1 + loads].T @ (precision[:, None] * terms)
        square += precision @ values**2
    readings = equations.observations[np.ix_(group.rows, outputs)]
    repeats = np.maximum(readings - 1, 0.0).sum(axis=0)
    scatter = equations.scatter[np.ix_(group.rows, outputs)].sum(axis=0)
    # Noise of one reading over the mean noise of the rows.
    scatter = scatter / np.mean(group.noise[:, None] * np.maximum(readings, 1.0), axis=0)
    (G, b), (H, h) = (np.split(part, [1 + loads], axis=1) for part in (crossed, moments))
    return Sums(outputs, prior, A, b, G, H, h, square, len(group.rows), repeats, scatter)


def likely_noise(sums: Sums, settings: KrigingSettings) -> LikelyNoise:
    """Return noise and process variance: their posterior means over a grid of noise.

    The posterior is that of the restricted likelihood of all rows.
    """
    # The sums with the mean's coefficients projected away.
    H = sums.H + np.eye(len(sums.H)) / settings.mean_variance
    solved = np.linalg.solve(H, np.concatenate((sums.G.T, sums.h), axis=1))
    of_wrenches, of_data = np.split(solved, [len(sums.A)], axis=1)
    values, vectors = np.linalg.eigh(sums.A - sums.G @ of_wrenches)
    values = np.maximum(values, 0.0)
    squares = (vectors.T @ (sums.b - sums.G @ of_data)) ** 2
    total = sums.square - np.einsum("ak,ak->k", sums.h, of_data)

    # Half the negative logarithm of the likelihood, (grid, k), and the likelihood itself.
    freedom = sums.rows - len(H) + sums.repeats
    logarithms = np.arange(*settings.ratio_bounds, STEP)
    ratios = np.exp(logarithms)[:, None]
    residual = total + sums.scatter - (1 / (values + ratios)) @ squares
    variance = np.maximum(residual / ratios / freedom, ROUNDING_VARIANCE)
    negative = freedom * (np.log(variance) + logarithms[:, None])
    negative = 0.5 * (negative + np.log1p(values / ratios).sum(axis=1)[:, None])
    likelihood = np.exp(negative.min(axis=0) - negative)
    likelihood /= likelihood.sum(axis=0)
    ratio = np.exp(logarithms @ likelihood)
    return LikelyNoise(ratio, np.exp(np.einsum("gk,gk->k", likelihood, np.log(variance))))


def posterior_factor(
    sums: Sums, likely: LikelyNoise, pseudo: Equations, settings: KrigingSettings
) -> KrigingFactor:
    """Return the factor of a group's outputs (k,); their readings are written to `pseudo`."""
    prior = sums.prior
    ratio = float(np.exp(np.log(likely.ratios).mean()))
    A, G, H, b, h = (part / ratio for part in (sums.A, sums.G, sums.H, sums.b, sums.h))
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 0.0)
    inverse = (vectors / (1 + values)) @ vectors.T  # inv(B)

    precision = H - G.T @ inverse @ G + np.eye(len(H)) / settings.mean_variance
    mean_covariance = np.asarray(np.linalg.inv(precision), dtype=float)
    coefficients = mean_covariance @ (h - G.T @ inverse @ b)

    # R'R = I - inv(B), R lower, by a root: rounding may make the matrix itself indefinite.
    root = np.sqrt(values / (1 + values) + TINY)[:, None] * vectors.T
    R = np.asarray(np.linalg.qr(root[:, ::-1], mode="r"))[::-1, ::-1]

    # The readings at the inducing wrenches, L inv(A) b, and the noise of each given the others'.
    lower = solve_triangular(prior.T, np.eye(len(A)), lower=True)
    data = vectors @ ((vectors.T @ b) / (values + TINY)[:, None])
    pseudo.data[:, 0, sums.outputs] = lower @ data
    noise = 1 / np.einsum("ij,ij->j", prior.T, A @ prior.T)
    return KrigingFactor(
        prior.hyperparameters,
        prior.nugget,
        T=np.tril(R @ prior.T),
        TF=solve_triangular(R, inverse @ G, lower=True, trans=1),
        equations=pseudo,
        output_group=OutputGroup(sums.outputs, np.arange(len(A)), noise),
        mean_covariance=mean_covariance,
        coefficients=coefficients,
        weights=prior.T.T @ (inverse @ (b - G @ coefficients)),
        # Outputs of similar noise share one triangle: their variances follow their noise.
        variance=likely.ratios * likely.variances / ratio,
    )
