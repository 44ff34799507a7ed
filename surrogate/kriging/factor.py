"""The factors of the covariance: answers, deviations and errors of left-out rows.

With T, the inverse of the lower Cholesky factor, the inverse of the covariance is T'T, a new row
borders it, and answers are products. The mean's coefficients have a wide normal prior, of variance
P; with A = F' T'T F + 1/P this is the usual universal kriging where rows determine the mean, and
still defined where they do not.

Rows are left out in groups without factorising anew. With Q = inv(K) - inv(K) F inv(A) F' inv(K)
and b the equations of a group of rows (their values and slopes), the error of an answer that has
not seen them, mean refitted and hyperparameters unchanged, is inv(Q_bb) (Q y)_b (Dubrule 1983); its
posterior covariance is inv(Q_bb).

Deviations are those of small factors over the nearest rows. A point's neighbours are taken in turn
by each of the four terms of the covariance: nearest over all loads, then over those of axis x, y
and z. By all loads alone a table of clean rows would answer a wrench of six loads by one axis.
Neighbourhoods belong to rows, their anchors, so that the factors are made before any query; a
wrench takes that of its nearest row. Few measured rows are one neighbourhood: with noise all of
them tell the response at a wrench, and the nearest alone would give bars far too wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import get_lapack_funcs
from scipy.spatial import KDTree

from ..table.rows import Floats
from .correlation import Hyperparameters, Mask, covariance, mean_terms, numbers
from .equations import Equations
from .settings import DEFAULTS, KrigingSettings

Indices = NDArray[np.intp]

# Variance, spreads squared, of the rounding of equal values.
ROUNDING_VARIANCE = float(np.finfo(float).eps) ** 2


class OutputGroup(NamedTuple):
    """Outputs of the same rows and the same noise, which share one factor."""

    outputs: Indices  # (k,)
    rows: Indices  # (r,)
    noise: Floats  # (r,), dimensionless: variance of the rows' values over the process variance


def output_groups(
    equations: Equations,
    variance: Floats,
    settings: KrigingSettings = DEFAULTS,
    kernels: Sequence[Hyperparameters] | None = None,
) -> list[OutputGroup]:
    """Return the outputs in groups, each with a factor.

    `variance` (6,), dimensionless: process variance of each output, spreads squared: noise counts
    relative to it. Outputs whose relative noise differs by more than `like_noise` at some row get
    separate factors.
    `kernels`: the kernel of each output; outputs of different kernels get separate factors.
    """
    noise = equations.noise / variance
    # Noise below the nugget changes nothing.
    size = np.log(np.maximum(noise, settings.nugget))
    alike: list[list[int]] = []
    for output in range(noise.shape[1]):
        for members in alike:
            first = members[0]
            rows = equations.measured[:, first]
            same = (rows == equations.measured[:, output]).all()
            same &= kernels is None or kernels[output] is kernels[first]
            difference = np.abs(size[rows, output] - size[rows, first])
            if same and (difference <= np.log(settings.like_noise)).all():
                members.append(output)
                break
        else:
            alike.append([output])

    groups = []
    for members in alike:
        outputs = np.array(members, dtype=np.intp)
        rows = np.flatnonzero(equations.measured[:, outputs[0]])
        groups.append(OutputGroup(outputs, rows, noise[np.ix_(rows, outputs)].mean(axis=1)))
    return groups


class SingularCovarianceError(ArithmeticError):
    """A covariance that is singular even with the largest nugget."""


@dataclass(frozen=True)
class Factor:
    """The inverse factor of some equations' covariance, in dimensionless numbers."""

    hyperparameters: Hyperparameters
    nugget: float  # relative increase of the diagonal
    T: Floats  # (e, e): inverse of the lower Cholesky factor of the e equations' covariance
    TF: Floats  # (e, 7): T times the mean's terms

    @property
    def min_variance(self) -> float:
        """The nugget's part of a value's prior variance: below it sigma squared is rounding."""
        return self.nugget * float(self.hyperparameters.prior(1)[0])

    def explained(self, across: Floats, terms: Floats) -> tuple[Floats, Floats]:
        """Return T times the covariance with points, and the unexplained part of the mean's terms.

        Shapes (m, e) and (m, 7), from `across` (m, e) and `terms` (m, 7) at the points.
        """
        reduced = across @ self.T.T
        return reduced, terms - reduced @ self.TF

    def variance_of(self, reduced: Floats, remainder: Floats, mean_covariance: Floats) -> Floats:
        """Return sigma squared (m,), over the process variance, from the results of `explained`."""
        explained = np.einsum("me,me->m", reduced, reduced)
        trend = np.einsum("ma,ab,mb->m", remainder, mean_covariance, remainder)
        return (
            np.maximum(float(self.hyperparameters.prior(1)[0]) - explained, self.min_variance)
            + trend
        )


@dataclass(frozen=True)
class KrigingFactor(Factor):
    """The factor of some rows' equations, for the outputs of one group.

    All numbers are dimensionless: loads are in half ranges, outputs in spreads.
    """

    equations: Equations  # equations of the rows that take part
    output_group: OutputGroup  # the outputs it answers, the rows and their noise
    # (7, 7): posterior covariance of the mean's coefficients, over the process variance
    mean_covariance: Floats
    coefficients: Floats  # (7, k): the mean of each output
    weights: Floats  # (e, k): factors on the covariances in a mean
    variance: Floats  # (k,): process variance of each output, spreads squared

    def explained_at(self, x: Floats, known: Mask | None = None) -> tuple[Floats, Floats]:
        """Return `explained` of the derivatives `known` (m, p), or of values, at points (m, 6)."""
        v, known_v = self.equations.x, self.equations.known
        if known is None:
            known = np.ones((len(x), 1), dtype=bool)
        across = covariance(x, known, v, known_v, self.hyperparameters)
        return self.explained(across, mean_terms(x, known))

    def of_data(self, data: Floats) -> KrigingFactor:
        """Return the factor with as many outputs as the data (e, q) of its equations have."""
        Ty = self.T @ data
        coefficients = self.mean_covariance @ (self.TF.T @ Ty)
        remainder = Ty - self.TF @ coefficients
        # A linear response leaves no remainder, and rounding may make the variance negative.
        variance = np.maximum(np.einsum("eq,eq->q", remainder, Ty) / len(self.T), ROUNDING_VARIANCE)
        weights = self.T.T @ remainder
        return replace(self, coefficients=coefficients, weights=weights, variance=variance)


def inverse_factor(
    matrix: Floats, nugget: float, nugget_limit: float, prior: Floats
) -> tuple[Floats, float]:
    """Return the inverse of the lower Cholesky factor, and the nugget used.

    `matrix` (e, e), dimensionless: with a nugget of `nugget` times `prior` on its diagonal; raised
    by decades on failure.
    `prior` (e,), dimensionless.

    Raises SingularCovarianceError if the matrix is singular with the largest nugget.
    """
    size = np.sqrt(prior)
    scaled = matrix / size[:, None] / size
    diagonal = np.diag_indices_from(scaled)
    while True:
        try:
            lower = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError:
            if nugget * 10 > nugget_limit:
                raise SingularCovarianceError(
                    f"rows contradict each other (the covariance of {len(matrix)} equations is "
                    f"singular with noise of {nugget:g}); withdraw the wrong rows"
                ) from None
            scaled[diagonal] += 9 * nugget
            nugget *= 10
            continue
        (invert,) = get_lapack_funcs(("trtri",), (lower,))
        inverse, _ = invert(lower, lower=1)  # cannot fail: the diagonal is positive
        return np.tril(inverse) / size, nugget


def _factored(
    equations: Equations,
    noise: Floats,
    matrix: Floats,
    hyperparameters: Hyperparameters,
    nugget: float,
    settings: KrigingSettings,
) -> Factor:
    """Return the factor of equations whose covariance is a matrix (e, e), which is overwritten.

    `noise`, shape (rows,), is over the process variance; it and the nugget are added.
    """
    prior = np.tile(hyperparameters.prior(equations.n_derivatives), (len(equations), 1))
    added = nugget * prior
    added[:, 0] += noise
    matrix[np.diag_indices_from(matrix)] += added[equations.known]
    T, nugget = inverse_factor(matrix, nugget, settings.nugget_limit, prior[equations.known])
    return Factor(hyperparameters, nugget, T, T @ mean_terms(equations.x, equations.known))


def factorise(
    equations: Equations,
    hyperparameters: Hyperparameters,
    group: OutputGroup,
    settings: KrigingSettings = DEFAULTS,
    covariances: Floats | None = None,
) -> KrigingFactor:
    """Return the factor of an output group of a table.

    `covariances` (a, a), dimensionless, are those of all a equations, if the caller has them
    already.
    """
    subset = equations.take(group.rows)
    if covariances is None:
        matrix = covariance(subset.x, subset.known, subset.x, subset.known, hyperparameters)
    else:
        indices = numbers(equations.known)[group.rows][subset.known]
        matrix = covariances[np.ix_(indices, indices)]
    inverse = _factored(subset, group.noise, matrix, hyperparameters, settings.nugget, settings)
    precision = inverse.TF.T @ inverse.TF + np.eye(inverse.TF.shape[1]) / settings.mean_variance
    mean_covariance = np.asarray(np.linalg.inv(precision), dtype=float)
    none = np.empty(0)
    parts = hyperparameters, inverse.nugget, inverse.T, inverse.TF
    blank = KrigingFactor(*parts, subset, group, mean_covariance, none, none, none)
    return blank.of_data(subset.data[subset.known][:, group.outputs])


# Added to the diagonal of the precision of a group's mean: rows at almost the same wrench leave it
# singular to rounding.
REGULAR = 1e-14


class LeftOutRows(NamedTuple):
    """Errors of rows that were left out with their group, in dimensionless numbers."""

    # (r, q): errors of the values of the factor's outputs, spreads; NaN if a row cannot be left out
    errors: Floats
    # (r, q): root mean square of a row's errors of value and slopes, each over its expected
    # deviation
    sizes: Floats
    # (r,), process variances: expected variance of the values' errors, with the row's own noise
    variances: Floats


def left_out(factor: KrigingFactor, labels: Indices) -> LeftOutRows:
    """Return the errors of a factor's rows, each left out with all rows of its label.

    `labels` (r,): group of each of the factor's rows; -1 of rows that stay.
    """
    equations = factor.equations
    sizes = equations.known.sum(axis=1)
    ends = np.cumsum(sizes)
    errors, deviations = np.full((2, len(equations), len(factor.variance)), np.nan)
    out = LeftOutRows(errors, deviations, np.full(len(equations), np.nan))
    for label in np.unique(labels[labels >= 0]):
        rows = np.flatnonzero(labels == label)
        if len(rows) == len(equations):
            break
        indices = np.concatenate([np.arange(ends[row] - sizes[row], ends[row]) for row in rows])
        # T is triangular: its entries above the group are zero.
        below = factor.T[indices[0] :, indices]
        block = below.T @ below
        means = below.T @ factor.TF[indices[0] :]
        diagonal = np.diag_indices_from(block)
        block[diagonal] += REGULAR * block[diagonal].mean()
        covariance = np.linalg.inv(block - means @ factor.mean_covariance @ means.T)  # inv(Q_bb)

        residuals = covariance @ factor.weights[indices]
        start = 0
        for row, size in zip(rows, sizes[rows], strict=True):
            part = slice(start, start + size)
            out.errors[row], out.variances[row] = residuals[start], covariance[start, start]
            # the row's squared errors, by their expected covariance
            squares = residuals[part] * np.linalg.solve(covariance[part, part], residuals[part])
            out.sizes[row] = np.sqrt(np.maximum(squares.sum(axis=0) / size / factor.variance, 0.0))
            start += size
    return out


# Part of squared scaled distances, which rounding changes by 1e-14. Rows within it are equally
# near, and the first is taken, in Python and in the kernel alike.
TIE = 1e-10


@dataclass(frozen=True)
class LocalFactor(Factor):
    """The factor over one neighbourhood, in dimensionless numbers."""

    # (e,): indices of its equations among the values and derivatives, known or not, of all rows
    columns: Indices
    numbers: Indices  # (e,): their indices among the equations of the table


class Neighbourhoods:
    """The nearest rows of any point among those of a factor, and the small factors over them.

    Rows are indices of the factor's rows.

    `local_factors`: one factor of all rows, or the neighbourhood of each of the factor's rows.
    `number` (r,): index in `local_factors` of the neighbourhood of each row as an anchor.
    `size`, `plain_size` (r,): number of equations of each row, with second derivatives and without.
    `roots` (g, 6), dimensionless: scales of the loads in the distances of each term, first all.
    """

    def __init__(
        self,
        equations: Equations,
        factor: KrigingFactor,
        covariances: Floats,
        settings: KrigingSettings = DEFAULTS,
        *,
        of_all_rows: bool = False,
    ) -> None:
        """Take the table's equations, and `covariances` (a, a), those of all a of them.

        `of_all_rows`: sigma is that of all rows, however many.
        """
        x, known = factor.equations.x, factor.equations.known
        self.equations = equations
        self.factor = factor
        self.settings = settings
        self.size = known.sum(axis=1)
        self.plain_size = known[:, : 1 + x.shape[1]].sum(axis=1)
        all_first = np.roll(factor.hyperparameters.groups, 1, axis=0)
        self.roots = np.sqrt(factor.hyperparameters.inverse_squares) * all_first
        self.trees = [KDTree(x * root) for root in self.roots]
        self._numbers = numbers(equations.known)[factor.output_group.rows]
        self.number = np.arange(len(x))
        self.local_factors: tuple[LocalFactor, ...]
        if of_all_rows or (len(x) <= settings.global_rows and not known[:, 1:].any()):
            self.number = np.zeros(len(x), dtype=np.intp)
            columns = factor.output_group.rows * known.shape[1]
            parts = factor.hyperparameters, factor.nugget, factor.T, factor.TF
            self.local_factors = (LocalFactor(*parts, columns, self._numbers[:, 0]),)
        else:
            self.local_factors = tuple(
                self.local_factor(near, covariances) for near in self.members(x)
            )

    @property
    def is_global(self) -> bool:
        """Whether deviations are computed from all rows."""
        return len(self.local_factors) == 1

    def nearest(self, x: Floats) -> Indices:
        """Return the row nearest to each point (m, 6) over all loads, shape (m,).

        The first of equally near rows counts.
        """
        scaled = x * self.roots[0]
        radius = np.sqrt(np.asarray(self.trees[0].query(scaled)[0], dtype=float) ** 2 + TIE)
        near = self.trees[0].query_ball_point(scaled, radius, return_sorted=True)
        return np.array([rows[0] for rows in near], dtype=np.intp)

    def members(self, x: Floats) -> list[Indices]:
        """Return the neighbours of each point (m, 6), nearest first, up to the settings' number."""
        max_rows, n_curved = self.settings.deviation_rows, self.settings.deviation_curved
        max_equations = self.settings.deviation_solves * (1 + self.factor.equations.loads)
        count = min(max_rows, len(self.size))
        nearest = [
            np.asarray(tree.query(x * root, k=count)[1]).reshape(len(x), count)
            for tree, root in zip(self.trees, self.roots, strict=True)
        ]
        lists = []
        for neighbours in np.stack(nearest, axis=2).reshape(len(x), -1).tolist():
            near = np.array(list(dict.fromkeys(neighbours)), dtype=np.intp)[:max_rows]
            size = np.append(self.size[near[:n_curved]], self.plain_size[near[n_curved:]])
            lists.append(near[np.cumsum(size) <= max_equations])
        return lists

    def local_factor(self, near: Indices, covariances: Floats) -> LocalFactor:
        """Return the factor over some rows (k,), nearest first.

        `covariances` (a, a), dimensionless, are those of all a equations of the table.
        """
        factor = self.factor
        subset = factor.equations.take(near)
        known = subset.known
        known[self.settings.deviation_curved :, 1 + subset.loads :] = False
        columns = (
            factor.output_group.rows[near][:, None] * subset.n_derivatives
            + np.arange(subset.n_derivatives)
        )[known]
        number = self._numbers[near][known]
        noise = factor.output_group.noise[near]
        within = covariances[np.ix_(number, number)]
        model = factor.hyperparameters
        inverse = _factored(subset, noise, within, model, factor.nugget, self.settings)
        return LocalFactor(model, inverse.nugget, inverse.T, inverse.TF, columns, number)

    def deviations(self, x: Floats, across: Floats) -> Floats:
        """Return the posterior deviation (m,), process deviations, at points (m, 6).

        `across` (m, 7 n) is the covariance of their values with the values and derivatives
        of all rows, known or not.
        """
        terms = np.concatenate((np.ones((len(x), 1)), x), axis=1)
        squared = np.empty(len(x))
        number = np.zeros(len(x), dtype=np.intp) if self.is_global else self.number[self.nearest(x)]
        for anchor in np.unique(number).tolist():
            queries = np.flatnonzero(number == anchor)
            local = self.local_factors[anchor]
            # Each point separately, so that its digits do not depend on the other points.
            near = across[np.ix_(queries, local.columns)]
            mean = terms[queries]
            reduced, unexplained = (
                part[:, 0] for part in local.explained(near[:, None], mean[:, None])
            )
            squared[queries] = local.variance_of(reduced, unexplained, self.factor.mean_covariance)
        return np.sqrt(squared)
