"""Weights of rows for whole fields: the kriging's, applied to any number of values at once.

The posterior mean of a kriging is linear in what the rows tell: with the covariance c of the value
at w with all values and slopes of the rows, f(w) = lambda' y with

    lambda = T' (T c + TF M u),   u = (mean's terms at w) - TF' T c,

in the words of `surrogate.kriging.factor`. One lambda serves every vertex of a surface and every
integration point of a body, with the length scales that the table's own outputs have settled.

Bars come from rows left out (Dubrule 1983): a row's error is inv(Q_bb) (Q y)_b, its posterior
variance the corner of inv(Q_bb), with Q = inv(K) - inv(K) F inv(A) F' inv(K).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .kriging.correlation import (
    Hyperparameters,
    covariance,
    mean_terms,
)
from .kriging.equations import DECIMALS, Equations
from .kriging.factor import KrigingFactor, factorise
from .kriging.settings import DEFAULTS, KrigingSettings
from .table.rows import Floats, LoadRange

MIN_LEFT_OUT = 4  # rows left out below which they say nothing of an error's size


@dataclass(frozen=True)
class Weights:
    """What the rows' values and slopes are multiplied by, and how unsure that is.

    Attributes
    ----------
    values : ndarray, shape (k,)
    slopes : ndarray, shape (k, 6), N and N·m
    sigma : float
        Posterior deviation over the process deviation.
    """

    values: Floats
    slopes: Floats
    sigma: float


@dataclass(frozen=True)
class FieldWeights:
    """The weights of some rows that bring fields and their slopes.

    Attributes
    ----------
    wrenches : ndarray, shape (k, 6), N and N·m
    """

    wrenches: Floats
    load_range: LoadRange
    hyperparameters: Hyperparameters
    equations: Equations
    factor: KrigingFactor

    @classmethod
    def of(
        cls,
        wrenches: Floats,
        load_range: LoadRange,
        hyperparameters: Hyperparameters | None = None,
        settings: KrigingSettings = DEFAULTS,
    ) -> FieldWeights:
        """Return the weights of rows at different wrenches, shape (k, 6), N and N·m.

        Parameters
        ----------
        hyperparameters : Hyperparameters, optional
            Of the table's kriging; without one, those that its estimate starts from.

        Raises
        ------
        SingularCovarianceError
            If two rows are at one wrench.
        """
        (count, loads), groups = wrenches.shape, load_range.space.kriging_groups
        if hyperparameters is None:
            start = np.append(np.full(loads, settings.theta_starts[0]), settings.weight_start)
            hyperparameters = Hyperparameters.of_logarithms(start, groups)
        known = np.ones((count, 1 + loads), dtype=bool)
        known[:, 1:] = load_range.high > load_range.low
        blank, none = np.zeros((count, 1 + loads, 1)), np.zeros((count, 1))  # no values, no noise
        x, measured = _scaled(wrenches, load_range), np.ones((count, 1), dtype=bool)
        equations = Equations(x, known, blank, measured, none, none, none, groups)
        one, rows = np.arange(1), np.arange(count)
        factor = factorise(equations, hyperparameters, one, rows, np.zeros(count), settings)
        return cls(np.array(wrenches, dtype=float), load_range, hyperparameters, equations, factor)

    def at(self, wrench: Floats) -> Weights:
        """Return the weights for one wrench (6,), N and N·m."""
        x = _scaled(np.asarray(wrench, dtype=float).reshape(1, -1), self.load_range)
        value = np.zeros((1, self.equations.places), dtype=bool)
        value[:, 0] = True
        own, factor = self.equations, self.factor
        reduced = factor.T @ covariance(own.x, own.known, x, value, self.hyperparameters)[:, 0]
        loose = mean_terms(x, value)[0] - factor.TF.T @ reduced
        by_mean = factor.mean_covariance @ loose
        weights = np.zeros(own.known.shape)
        weights[own.known] = factor.T.T @ (reduced + factor.TF @ by_mean)
        squared = float(self.hyperparameters.prior(1)[0]) - reduced @ reduced + loose @ by_mean
        sigma = float(np.sqrt(max(squared, factor.nugget)))
        return Weights(weights[:, 0], weights[:, 1:] * self.load_range.scale, sigma)

    def left_out(self, column: Callable[[int], Floats], size: int) -> tuple[Floats, Floats]:
        """Return errors of rows left out whole, and their posterior deviations.

        Parameters
        ----------
        column : callable
            Gives of a row, by its place, what it tells: shape (7, size), its values, then their
            change with each load, per N and N·m.
        size : int
            Numbers of a field.

        Returns
        -------
        errors : ndarray, shape (k, size), in the unit of the values
        sigmas : ndarray, shape (k,), over the process deviation
        """
        own, factor = self.equations, self.factor
        shares = factor.TF.T @ factor.T
        whole = factor.T.T @ factor.T - shares.T @ factor.mean_covariance @ shares
        ends = np.cumsum(own.known.sum(axis=1))
        starts = np.append(0, ends[:-1])
        count = len(ends)
        tops, sigmas = np.empty((count, len(whole))), np.empty(count)
        for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
            inverse = np.linalg.inv(whole[start:end, start:end])
            tops[row] = inverse[0] @ whole[start:end]
            sigmas[row] = np.sqrt(max(inverse[0, 0], factor.nugget))
        errors = np.zeros((count, size))
        scale = np.append(1.0, self.load_range.scale)[:, None]
        for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
            data = (column(row) * scale)[own.known[row]]
            errors += tops[:, start:end] @ data
        return errors, sigmas


def nearest_rows(wrenches: Floats, wrench: Floats, load_range: LoadRange, most: int) -> list[int]:
    """Return the places of the rows, (k, 6), nearest to a wrench (6,), N and N·m, ascending."""
    apart = np.linalg.norm((wrenches - wrench) / load_range.scale, axis=1)
    return sorted(np.argsort(apart, kind="stable")[:most].tolist())


def _scaled(wrenches: Floats, load_range: LoadRange) -> Floats:
    """Return wrenches in half ranges from the middle; loads without a range are zero."""
    centre = (load_range.low + load_range.high) / 2
    ranged = load_range.high > load_range.low
    return np.where(ranged, np.round((wrenches - centre) / load_range.scale, DECIMALS), 0.0)
