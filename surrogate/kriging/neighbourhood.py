"""The nearest rows of a place, and the small factors over them.

A place's neighbours are taken in turn by each of the four terms of the covariance: nearest over all
loads, then over those of axis x, y and z. By all loads alone a table of clean rows would tell a
wrench of six loads by one axis. Neighbourhoods belong to rows, their anchors, so that the factors
are made before any query; a wrench takes that of its nearest row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..table.rows import Floats
from .correlation import (
    Hyperparameters,
    Mask,
    mean_terms,
    numbers,
)
from .equations import Equations
from .factor import KrigingFactor, diagonal_added, inverse_factor
from .settings import DEFAULTS, KrigingSettings

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
