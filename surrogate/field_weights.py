"""Weights of rows for whole fields: the kriging's, applied to any number of values at once.

The posterior mean of a kriging is linear in the rows' values and slopes: with the covariance c of
the value at w with all values and slopes of the rows, f(w) = lambda' y with

    lambda = T' (T c + TF M u),   u = (mean's terms at w) - TF' T c,

with the symbols of `surrogate.kriging.factor`. One lambda serves every vertex of a surface and
every integration point of a body, with the length scales of the table's outputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .kriging.correlation import Hyperparameters
from .kriging.equations import DECIMALS, Equations
from .kriging.factor import KrigingFactor, OutputGroup, factorise, left_out
from .kriging.settings import DEFAULTS, KrigingSettings
from .table.rows import Floats, LoadRange

COLUMNS = 4096  # numbers of a field that leaving out rows handles at once: 14 MB with 60 rows


@dataclass(frozen=True)
class FieldWeights:
    """The weights of rows that bring fields and their slopes."""

    wrenches: Floats  # (k, 6), N and N·m
    load_range: LoadRange
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

        `hyperparameters`: those of the table's kriging, or the starting values of its estimate.

        Raises SingularCovarianceError if two rows are at the same wrench.
        """
        (count, loads), groups = wrenches.shape, load_range.space.kriging_groups
        if hyperparameters is None:
            start = np.append(np.full(loads, settings.theta_starts[0]), settings.weight_start)
            hyperparameters = Hyperparameters.of_logarithms(start, groups)
        known = np.ones((count, 1 + loads), dtype=bool)
        known[:, 1:] = load_range.high > load_range.low
        blank = np.zeros((count, 1 + loads, 1))  # no values, no noise
        none = np.zeros((count, 1))
        x = _scaled(wrenches, load_range)
        measured = np.ones((count, 1), dtype=bool)
        equations = Equations(x, known, blank, measured, none, none, none, groups)
        group = OutputGroup(np.arange(1), np.arange(count), np.zeros(count))
        factor = factorise(equations, hyperparameters, group, settings)
        return cls(np.array(wrenches, dtype=float), load_range, factor)

    def at(self, wrench: Floats) -> tuple[Floats, float]:
        """Return the weights of rows' values and slopes for a wrench (6,), N and N·m.

        The weights have shape (k, 7): of values, then of slopes, N and N·m. The second result is
        the posterior deviation over the process deviation.
        """
        factor, known = self.factor, self.factor.equations.known
        x = _scaled(np.asarray(wrench, dtype=float).reshape(1, -1), self.load_range)
        reduced, unexplained = factor.explained_at(x)
        weights = np.zeros(known.shape)
        weights[known] = factor.T.T @ (
            reduced[0] + factor.TF @ factor.mean_covariance @ unexplained[0]
        )
        sigma = np.sqrt(factor.variance_of(reduced, unexplained, factor.mean_covariance)[0])
        return weights * np.append(1.0, self.load_range.scale), float(sigma)

    def left_out(self, values: Floats) -> tuple[Floats, Floats]:
        """Return errors (k, d) of rows left out, and their posterior deviations (k,).

        The errors are in the unit of the values, the deviations over the process deviation.

        `values` (k, 7, d): for each row a field's d numbers, then their slopes by each load, per N
        and N·m.
        """
        count, _, size = values.shape
        scale = np.append(1.0, self.load_range.scale)[:, None]
        errors = np.empty((count, size))
        variances = np.empty(count)
        for start in range(0, max(size, 1), COLUMNS):  # deviations also of fields without numbers
            part = slice(start, start + COLUMNS)
            data = (values[:, :, part] * scale)[self.factor.equations.known]
            left_out_rows = left_out(self.factor.of_data(data), np.arange(count))
            errors[:, part], variances = left_out_rows.errors, left_out_rows.variances
        return errors, np.sqrt(variances)


def nearest_rows(wrenches: Floats, wrench: Floats, load_range: LoadRange, count: int) -> list[int]:
    """Return the indices of the rows, (k, 6), nearest to a wrench (6,), N and N·m, ascending."""
    distances = np.linalg.norm((wrenches - wrench) / load_range.scale, axis=1)
    return sorted(np.argsort(distances, kind="stable")[:count].tolist())


def _scaled(wrenches: Floats, load_range: LoadRange) -> Floats:
    """Return wrenches in half ranges from the middle; loads without a range are zero."""
    centre = (load_range.low + load_range.high) / 2
    ranged = load_range.high > load_range.low
    return np.where(ranged, np.round((wrenches - centre) / load_range.scale, DECIMALS), 0.0)
