"""The factors of the covariance, by which every answer, deviation and left-out row is had.

Kept is T, the inverse of the lower Cholesky factor: the inverse of the covariance is T'T, a new row
borders it, and answers are products. The mean's coefficients have a wide normal prior, of variance
P; with A = F' T'T F + 1/P this is the usual universal kriging where rows settle the mean, and still
defined where they do not.

Rows are left out in groups without factorising anew. With Q = inv(K) - inv(K) F inv(A) F' inv(K)
and b the equations of a group of rows (their values and slopes), the error of an answer that has
not seen them, mean refitted and hyperparameters kept, is inv(Q_bb) (Q y)_b (Dubrule 1983); its
posterior covariance is inv(Q_bb).

Deviations are those of small factors over the nearest rows. A place's neighbours are taken in turn
by each of the four terms of the covariance: nearest over all loads, then over those of axis x, y
and z. By all loads alone a table of clean rows would tell a wrench of six loads by one axis.
Neighbourhoods belong to rows, their anchors, so that the factors are made before any query; a
wrench takes that of its nearest row.
"""

from __future__ import annotations

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

ROUNDING = float(np.finfo(float).eps) ** 2  # variance, spreads squared, of values that are one


class Share(NamedTuple):
    """Outputs that the same rows tell with the same noise.

    Attributes
    ----------
    outputs, rows : ndarray of int, shape (k,) and (r,)
    noise : ndarray, shape (r,), dimensionless
        Variance of the rows' values over the process variance.
    """

    outputs: NDArray[np.intp]
    rows: NDArray[np.intp]
    noise: Floats


def shares_of(
    equations: Equations, variance: Floats, settings: KrigingSettings = DEFAULTS
) -> list[Share]:
    """Return the outputs in groups that one factor answers.

    Parameters
    ----------
    variance : ndarray, shape (6,), dimensionless
        Process variance of each output, spreads squared: noise counts relative to it. Outputs whose
        relative noise differs by more than `like_noise` at some row get a factor each.
    """
    noise = equations.noise / variance
    # Below the nugget noise changes nothing.
    size = np.log(np.maximum(noise, settings.nugget))
    groups: list[list[int]] = []
    for output in range(noise.shape[1]):
        for group in groups:
            rows = equations.measured[:, group[0]]
            same = (rows == equations.measured[:, output]).all()
            apart = np.abs(size[rows, output] - size[rows, group[0]])
            if same and (apart <= np.log(settings.like_noise)).all():
                group.append(output)
                break
        else:
            groups.append([output])
    shares = []
    for group in groups:
        rows = np.flatnonzero(equations.measured[:, group[0]])
        outputs = np.array(group, dtype=np.intp)
        shares.append(Share(outputs, rows, noise[np.ix_(rows, outputs)].mean(axis=1)))
    return shares


class SingularCovarianceError(ArithmeticError):
    """A covariance that is singular even with the largest nugget."""


@dataclass(frozen=True)
class KrigingFactor:
    """The factor of some rows' equations, for the outputs that these rows tell alike.

    All numbers are dimensionless: loads are in half ranges, outputs in spreads.

    Attributes
    ----------
    hyperparameters : Hyperparameters
    outputs : ndarray of int, shape (k,)
        The outputs it answers.
    rows : ndarray of int, shape (r,)
        Which rows of the table take part.
    noise : ndarray, shape (r,)
        Variance of their values over the process variance.
    nugget : float
        What the diagonal was raised by, relative.
    T : ndarray, shape (e, e)
        Inverse of the lower Cholesky factor of the e equations' covariance.
    TF : ndarray, shape (e, 7)
        T times the mean's terms.
    mean_covariance : ndarray, shape (7, 7)
        Posterior covariance of the mean's coefficients, over the process variance.
    coefficients : ndarray, shape (7, k)
        The mean of each output.
    weights : ndarray, shape (e, k)
        What covariances are multiplied by.
    variance : ndarray, shape (k,)
        Process variance of each output, spreads squared.
    """

    hyperparameters: Hyperparameters
    outputs: NDArray[np.intp]
    rows: NDArray[np.intp]
    noise: Floats
    nugget: float
    T: Floats
    TF: Floats
    mean_covariance: Floats
    coefficients: Floats
    weights: Floats
    variance: Floats


def diagonal_added(
    equations: Equations, noise: Floats, nugget: float, hyperparameters: Hyperparameters
) -> Floats:
    """Return what is added to the covariance's diagonal: nugget and noise.

    Shape (equations,), dimensionless, of noise, shape (rows,), over the process variance.
    """
    added = np.tile(nugget * hyperparameters.prior(equations.places), (len(equations), 1))
    added[:, 0] += noise
    return added[equations.known]


def inverse_factor(
    matrix: Floats, nugget: float, nugget_limit: float, prior: Floats
) -> tuple[Floats, float]:
    """Return the inverse of the lower Cholesky factor, and the nugget it took.

    Parameters
    ----------
    matrix : ndarray, shape (e, e), dimensionless
        With a nugget of `nugget` times `prior` on its diagonal; raised by decades on failure.
    prior : ndarray, shape (e,), dimensionless

    Raises
    ------
    SingularCovarianceError
        If it is singular with the largest nugget.
    """
    size = np.sqrt(prior)
    scaled = matrix / size[:, None] / size
    places = np.diag_indices_from(scaled)
    while True:
        try:
            lower = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError:
            if nugget * 10 > nugget_limit:
                raise SingularCovarianceError(
                    f"the covariance of {len(matrix)} equations is singular with a nugget of "
                    f"{nugget:g}: rows contradict each other; invalidate the wrong ones"
                ) from None
            scaled[places] += 9 * nugget
            nugget *= 10
            continue
        (invert,) = get_lapack_funcs(("trtri",), (lower,))
        inverse, _ = invert(lower, lower=1)  # cannot fail: the diagonal is positive
        return np.tril(inverse) / size, nugget


def factorise(
    equations: Equations,
    hyperparameters: Hyperparameters,
    outputs: NDArray[np.intp],
    rows: NDArray[np.intp],
    noise: Floats,
    settings: KrigingSettings = DEFAULTS,
    table: Floats | None = None,
) -> KrigingFactor:
    """Return the factor of some rows (r,) of a table for some outputs (k,), both indices.

    `noise` (r,) is over the process variance; `table` (a, a), dimensionless, the covariance of all
    a equations of the table, where it is at hand.
    """
    own = equations.take(rows)
    if table is None:
        matrix = covariance(own.x, own.known, own.x, own.known, hyperparameters)
    else:
        places = numbers(equations.known)[rows][own.known]
        matrix = table[np.ix_(places, places)]
    matrix[np.diag_indices_from(matrix)] += diagonal_added(
        own, noise, settings.nugget, hyperparameters
    )
    prior = np.tile(hyperparameters.prior(own.places), (len(own), 1))[own.known]
    T, nugget = inverse_factor(matrix, settings.nugget, settings.nugget_limit, prior)
    TF = T @ mean_terms(own.x, own.known)
    Ty = T @ own.data[own.known][:, outputs]
    precision = TF.T @ TF + np.eye(TF.shape[1]) / settings.mean_variance
    mean_covariance = np.asarray(np.linalg.inv(precision), dtype=float)
    coefficients = mean_covariance @ (TF.T @ Ty)
    remainder = Ty - TF @ coefficients
    return KrigingFactor(
        hyperparameters=hyperparameters,
        outputs=outputs,
        rows=rows,
        noise=noise,
        nugget=nugget,
        T=T,
        TF=TF,
        mean_covariance=mean_covariance,
        coefficients=coefficients,
        weights=T.T @ remainder,
        # Of a response that is linear nothing remains, and rounding may make that negative.
        variance=np.maximum(np.einsum("eq,eq->q", remainder, Ty) / len(T), ROUNDING),
    )


# Added to the diagonal of a group's precision, of its mean: rows a hair apart leave it singular to
# rounding.
REGULAR = 1e-14


class LeftOutRows(NamedTuple):
    """Errors of rows that were left out with their group, in dimensionless numbers.

    Attributes
    ----------
    errors : ndarray, shape (r, q)
        Of the values of the factor's outputs, spreads; NaN of a row that cannot be left out.
    sizes : ndarray, shape (r, q)
        Root mean square of a row's value and slopes, each over the deviation it should have.
    variances : ndarray, shape (r,), process variances
        That the values' errors should have, the noise of the row itself included.
    mean_covariances : ndarray, shape (r, 7, 7)
        Of the mean's coefficients without the row's group.
    """

    errors: Floats
    sizes: Floats
    variances: Floats
    mean_covariances: Floats


def left_out(equations: Equations, factor: KrigingFactor, labels: NDArray[np.intp]) -> LeftOutRows:
    """Return the errors of a factor's rows, each left out with all rows of its label.

    Parameters
    ----------
    labels : ndarray of int, shape (r,)
        Group of each of the factor's rows.
    """
    own = equations.take(factor.rows)
    sizes = own.known.sum(axis=1)
    ends = np.cumsum(sizes)
    precision = np.asarray(np.linalg.inv(factor.mean_covariance), dtype=float)
    out = LeftOutRows(
        np.full((len(own), len(factor.outputs)), np.nan),
        np.full((len(own), len(factor.outputs)), np.nan),
        np.full(len(own), np.nan),
        np.full((len(own), 1 + own.loads, 1 + own.loads), np.nan),
    )
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        if len(rows) == len(own):
            break
        places = np.concatenate([np.arange(ends[row] - sizes[row], ends[row]) for row in rows])
        # T is triangular: what stands above the group is zero.
        below = factor.T[places[0] :, places]
        block, shares = below.T @ below, below.T @ factor.TF[places[0] :]
        diagonal = np.diag_indices_from(block)
        block[diagonal] += REGULAR * block[diagonal].mean()
        covariance = np.linalg.inv(block - shares @ factor.mean_covariance @ shares.T)
        missed = covariance @ factor.weights[places]
        out.mean_covariances[rows] = np.linalg.inv(
            precision - shares.T @ np.linalg.solve(block, shares)
        )
        start = 0
        for row, size in zip(rows, sizes[rows], strict=True):
            mine = slice(start, start + size)
            out.errors[row], out.variances[row] = missed[mine][0], covariance[start, start]
            # what the row's errors are by the covariance that they should have
            squares = missed[mine] * np.linalg.solve(covariance[mine, mine], missed[mine])
            out.sizes[row] = np.sqrt(np.maximum(squares.sum(axis=0) / size / factor.variance, 0.0))
            start += size
    return out


Places = NDArray[np.intp]

# Of squared scaled distances, which rounding changes by 1e-14: rows that are as near as this are
# equally near, and the first is taken, whoever computes the distance.
TIE = 1e-10


class Finder:
    """Finds the nearest rows of any place.

    Parameters
    ----------
    equations : Equations
    rows : ndarray of int
        The rows among which it looks.
    hyperparameters : Hyperparameters
    limits : tuple of int
        What a neighbourhood may hold: rows, equations, and rows with their second derivatives.
    """

    def __init__(
        self,
        equations: Equations,
        rows: Places,
        hyperparameters: Hyperparameters,
        limits: tuple[int, int, int],
    ) -> None:
        self.rows = rows
        self.size = equations.known[rows].sum(axis=1)
        self.plain_size = equations.known[rows, : 1 + equations.loads].sum(axis=1)
        self.most_rows, self.most_equations, self.most_bent = limits
        all_first = np.roll(hyperparameters.groups, 1, axis=0)
        self.roots = np.sqrt(hyperparameters.inverse_squares) * all_first
        self.trees = [KDTree(equations.x[rows] * root) for root in self.roots]

    def nearest(self, x: Floats) -> Places:
        """Return the row nearest to each place (m, 6) over all loads, shape (m,), indices.

        Of rows that are equally near the first.
        """
        places = x * self.roots[0]
        distance = np.asarray(self.trees[0].query(places)[0], dtype=float)
        # Which of its rows are within a distance (m,) of places (m, 6), ascending.
        radius = np.sqrt(distance**2 + TIE)
        return self.rows[
            [near[0] for near in self.trees[0].query_ball_point(places, radius, return_sorted=True)]
        ]

    def nearest_others(self, rows: Places, x: Floats, labels: Places) -> Places:
        """Return the row nearest to each of some of its own rows that has another label.

        Parameters
        ----------
        rows : ndarray of int, shape (k,)
            Places among its rows.
        x : ndarray, shape (n, 6), dimensionless
            Of all rows of the table.
        labels : ndarray of int, shape (r,)
            Group of each of its rows, of which there are two or more.
        """
        places = x[self.rows] * self.roots[0]
        apart = ((places[rows][:, None] - places) ** 2).sum(axis=2)
        apart[labels[rows][:, None] == labels] = np.inf
        near = apart <= apart.min(axis=1, keepdims=True) + TIE
        return self.rows[near.argmax(axis=1)]

    def members(
        self, x: Floats, labels: Places | None = None, without: Places | None = None
    ) -> list[Places]:
        """Return the neighbours of each place (m, 6), nearest first.

        Parameters
        ----------
        labels : ndarray of int, shape (r,), optional
            Group of each of its rows.
        without : ndarray of int, shape (m,), optional
            For each place the label of the group that is left out.
        """
        largest = 0 if labels is None else int(np.bincount(labels).max())
        count = min(self.most_rows + largest, len(self.rows))
        found = [
            np.asarray(tree.query(x * root, k=count)[1]).reshape(len(x), count)
            for tree, root in zip(self.trees, self.roots, strict=True)
        ]
        interleaved = np.stack(found, axis=2).reshape(len(x), -1)
        lists = [np.array(list(dict.fromkeys(row)), dtype=np.intp) for row in interleaved.tolist()]
        if labels is not None and without is not None:
            lists = [
                near[labels[near] != label] for near, label in zip(lists, without, strict=True)
            ]
        return [self._first(near) for near in lists]

    def _first(self, near: Places) -> Places:
        """Return the rows of a list of places, each once, that the limits allow."""
        near = near[: self.most_rows]
        size = np.append(self.size[near[: self.most_bent]], self.plain_size[near[self.most_bent :]])
        return self.rows[near[np.cumsum(size) <= self.most_equations]]


def neighbours_known(equations: Equations, members: Places, most_bent: int) -> Mask:
    """Return which readings count of the rows of a neighbourhood, nearest first, shape (k, p)."""
    known = equations.known[members]
    known[most_bent:, 1 + equations.loads :] = False
    return known


@dataclass(frozen=True)
class LocalFactor:
    """The factor over one neighbourhood, in dimensionless numbers.

    Attributes
    ----------
    members : ndarray of int, shape (k,)
        Rows of the table.
    places : ndarray of int, shape (e,)
        Its equations: the readings of all rows before, and which one of the row.
    T : ndarray, shape (e, e)
        Inverse of the lower Cholesky factor.
    TF : ndarray, shape (e, 7)
        T times the mean's terms.
    least : float
        The nugget's share of the prior variance: below it sigma squared is rounding.
    """

    members: Places
    places: Places
    T: Floats
    TF: Floats
    least: float

    def squared_deviation(
        self, across: Floats, terms: Floats, prior: float, mean_covariance: Floats
    ) -> Floats:
        """Return sigma squared, over the process variance, at places (m).

        Parameters
        ----------
        across : ndarray, shape (m, e)
            Covariance of the values there with the equations.
        terms : ndarray, shape (m, 7)
            The mean's terms there.
        """
        reduced = row_by_row(across, self.T.T)
        unsettled = terms - row_by_row(reduced, self.TF)
        spent = np.einsum("me,me->m", reduced, reduced)
        loose = np.einsum("ma,ab,mb->m", unsettled, mean_covariance, unsettled)
        return np.maximum(prior - spent, self.least) + loose


def row_by_row(left: Floats, right: Floats) -> Floats:
    """Return the product of matrices (m, k) and (k, n), each row of it by itself.

    So a row's digits do not depend on which others there are: weights are up to 1e8 times their
    sum, and the order of a sum depends on the shape of the matrices.
    """
    return (left[:, None] @ right)[:, 0]


def local_factor(
    equations: Equations,
    whole: KrigingFactor,
    members: Places,
    table: Floats,
    settings: KrigingSettings = DEFAULTS,
) -> LocalFactor:
    """Return the factor over some rows of a whole factor.

    Parameters
    ----------
    members : ndarray of int, shape (k,)
    table : ndarray, shape (a, a), dimensionless
        The covariance of all a equations of the table.
    """
    known = neighbours_known(equations, members, settings.deviation_bent)
    own = replace(equations.take(members), known=known)
    places = (members[:, None] * own.places + np.arange(own.places))[own.known]
    equation = numbers(equations.known)[members][own.known]
    matrix = table[np.ix_(equation, equation)]
    hyperparameters, nugget = whole.hyperparameters, whole.nugget
    matrix[np.diag_indices_from(matrix)] += diagonal_added(
        own, noise_of(equations, whole)[members], nugget, hyperparameters
    )
    prior = np.tile(hyperparameters.prior(own.places), (len(own), 1))[own.known]
    T, used = inverse_factor(matrix, nugget, settings.nugget_limit, prior)
    TF = T @ mean_terms(own.x, own.known)
    return LocalFactor(members, places, T, TF, used * float(prior[0]))


@dataclass(frozen=True)
class Neighbourhoods:
    """What gives sigma of the outputs of one factor; loads and variances are dimensionless.

    Attributes
    ----------
    factor : KrigingFactor
    finder : Finder
    around : tuple of LocalFactor
        The neighbourhood of each of the factor's rows.
    """

    factor: KrigingFactor
    finder: Finder
    around: tuple[LocalFactor, ...]


def deviations(x: Floats, across: Floats, share: Neighbourhoods) -> Floats:
    """Return the posterior deviation (m,), process deviations, at places (m, 6), of one factor.

    `across` (m, 7 n) is the covariance of their values with all places of all rows.
    """
    terms = np.concatenate((np.ones((len(x), 1)), x), axis=1)
    squared, prior = np.empty(len(x)), float(share.factor.hyperparameters.prior(1)[0])
    place = np.searchsorted(share.factor.rows, share.finder.nearest(x))
    for anchor in np.unique(place):
        queries, local = np.flatnonzero(place == anchor), share.around[anchor]
        squared[queries] = local.squared_deviation(
            across[np.ix_(queries, local.places)],
            terms[queries],
            prior,
            share.factor.mean_covariance,
        )
    return np.sqrt(squared)


def neighbourhoods_of(
    equations: Equations, factor: KrigingFactor, table: Floats, settings: KrigingSettings
) -> Neighbourhoods:
    """Return the neighbourhoods of a factor's rows."""
    equations_most = settings.deviation_solves * (1 + equations.loads)
    limits = settings.deviation_rows, equations_most, settings.deviation_bent
    finder = Finder(equations, factor.rows, factor.hyperparameters, limits)
    around = tuple(
        local_factor(equations, factor, members, table, settings)
        for members in finder.members(equations.x[factor.rows])
    )
    return Neighbourhoods(factor, finder, around)


def noise_of(equations: Equations, factor: KrigingFactor) -> Floats:
    """Return the noise of every row of the table, zero where the factor has none."""
    noise = np.zeros(len(equations))
    noise[factor.rows] = factor.noise
    return noise
