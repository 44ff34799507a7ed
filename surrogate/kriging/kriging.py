"""The kriging of a table: wrenches in, displacements with error bars and derivatives out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..table.merging import Observations, merge
from ..table.rows import NEAR, SMALLEST, Floats, LoadRange, Rows
from .calibration import (
    Calibration,
    Kind,
    calibrated,
    kinds_of,
    largest_secondary_loads,
    of_posterior,
    secondary_loads,
    span_of,
)
from .correlation import Hyperparameters, Mask, block, covariance
from .equations import (
    Equations,
    Scaling,
    TooFewRowsError,
    equations_of,
    evenly,
    indices_within,
    scaling_of,
    values_of,
)
from .factor import KrigingFactor, Neighbourhoods, factorise, left_out, output_groups
from .inducing import CANDIDATES, induced
from .likelihood import estimated, limited_to_factor
from .noise import Estimate
from .settings import DEFAULTS, KrigingSettings

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # a simulator's environment may lack it: slower, and other last digits
    ThreadpoolController = None

_BLAS = ThreadpoolController and ThreadpoolController().select(user_api="blas")

# Relative rounding error of one covariance times one weight: some units in the last place for each
# of squared distance, root, exponential and polynomial. The errors have either sign: sums of
# compiled code and of arrays differed by up to 2.1 eps times the sum of magnitudes.
ROUNDING_LOSS = 4 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Kriging:
    """The Gaussian process through a table's n rows and their tangents; never changed once built.

    p is the number of an output's derivatives that a row can bring: value, slopes, second ones.
    """

    settings: KrigingSettings
    scaling: Scaling
    # (6,), spreads squared: variance of an observation of unknown uncertainty.
    observation_variance: Floats
    noise_widening: Floats  # (6,), dimensionless: see `noise.Estimate`
    # (6, 6), SI: mean tangent of the rows: the derivative by loads that take no part; NaN by loads
    # that no row varies where none brings slopes
    tangent: Floats
    equations: Equations
    # (factors,): outputs with the same rows and noise share a factor
    neighbourhoods: tuple[Neighbourhoods, ...]
    calibrations: tuple[Calibration, ...]  # (factors,)
    weights: Floats  # (n, p, 6), spreads
    coefficients: Floats  # (7, 6), spreads
    deviation: Floats  # (6,), spreads: process standard deviation
    # (6,), spreads: rounding error of answers. Long length scales leave the covariance nearly
    # singular, with weights up to 1e8 times their sum.
    rounding: Floats
    # (n, 6), spreads: errors of rows left out, each by itself; NaN where a row lacks the output
    errors: Floats
    # (2, 6), half ranges: ends of the loads that the rows span: beyond them errors are not known
    span: Floats
    # (2,), half ranges: `largest_secondary_loads` of the rows. Beyond them errors are not known
    # either: no row shows the interaction of so large loads.
    secondary_limits: Floats
    detail: str  # the number of rows and equations, in words

    @classmethod
    def build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        settings: KrigingSettings = DEFAULTS,
        observations: Observations | None = None,
        dependence: Floats | float = 1.0,
    ) -> Kriging:
        """Return the kriging of a table's rows inside the load range.

        `observations`: behind each row, of rows of distinct wrenches; without them rows at one
        wrench are merged first.
        `dependence` (6,): see `serial.dependence_of`; 1 for independent readings.
        Raises TooFewRowsError if too few rows lie in the load range, SingularCovarianceError if
        rows contradict each other so that no nugget makes the covariance regular.
        """
        if observations is None:
            rows, _, observations = merge(rows, load_range).usable()
        data = _TrainingData.of(rows, observations, load_range, settings)
        with single_thread():
            return cls._solved(data, _Model.of(data, dependence, settings), settings)

    @classmethod
    def _solved(cls, data: _TrainingData, model: _Model, settings: KrigingSettings) -> Kriging:
        """Solve for the weights of each output group, and calibrate its error bars."""
        equations, known = model.equations, model.equations.known
        n_rows, n_outputs = equations.measured.shape
        is_inducing = bool(model.inducing)
        weights = np.zeros(equations.data.shape)
        coefficients = np.empty((1 + equations.loads, n_outputs))
        deviation, rounding = np.empty((2, n_outputs))
        errors = np.full(equations.measured.shape, np.nan)
        neighbourhoods, calibrations = list[Neighbourhoods](), list[Calibration]()
        for factor, covariances in model.factors(settings):
            rows, outputs = factor.output_group.rows, factor.output_group.outputs
            group_weights = np.zeros((*known.shape, len(outputs)))
            group_weights[known & np.isin(np.arange(n_rows), rows)[:, None]] = factor.weights
            weights[:, :, outputs], coefficients[:, outputs] = group_weights, factor.coefficients
            deviation[outputs] = np.sqrt(factor.variance)
            value_rows = np.abs(covariances[np.nonzero(known)[1] == 0])
            losses = ROUNDING_LOSS * value_rows @ np.abs(group_weights[known])
            rounding[outputs] = losses.max(axis=0)

            leave_one_out = left_out(factor, np.arange(len(rows)))
            errors[np.ix_(rows, outputs)] = leave_one_out.errors
            near = Neighbourhoods(equations, factor, covariances, settings, of_all_rows=is_inducing)
            neighbourhoods.append(near)
            if is_inducing:
                calibration = of_posterior(factor, covariances, settings)
            else:
                widening = model.estimate.widening[outputs]
                calibration = calibrated(near, leave_one_out, data.scaling, data.kinds, widening)
            calibrations.append(calibration)
        return cls(
            settings=settings,
            scaling=data.scaling,
            observation_variance=model.observation_variance,
            noise_widening=model.estimate.noise_widening,
            tangent=data.mean_tangent(),
            equations=equations,
            neighbourhoods=tuple(neighbourhoods),
            calibrations=tuple(calibrations),
            weights=weights,
            coefficients=coefficients,
            deviation=deviation,
            rounding=rounding,
            errors=errors,
            span=data.span,
            secondary_limits=data.secondary_limits,
            detail=model.detail,
        )

    @property
    def hyperparameters(self) -> Hyperparameters:
        """The hyperparameters of the first outputs; with measured rows outputs differ in theirs."""
        return self.neighbourhoods[0].factor.hyperparameters

    @property
    def observation_noise(self) -> Floats:
        """Noise of an observation, 95 %, (6,), m and rad; NaN where stated, zero or unknown."""
        noise = self.settings.half_width * np.sqrt(self.observation_variance) * self.scaling.spread
        return np.where(self.observation_variance > 0, noise, np.nan)

    @property
    def floor(self) -> Floats:
        """The part of all error bars that no row takes away, (6,), m and rad.

        The nugget's part of each output's spread, and the rounding error of answers.
        """
        nugget = np.empty_like(self.rounding)
        for neighbours in self.neighbourhoods:
            nugget[neighbours.factor.output_group.outputs] = neighbours.factor.nugget
        varying = np.where(self.scaling.constant, 0.0, np.sqrt(nugget))
        relative = self.settings.error_floor * np.abs(self.scaling.offset)
        return (varying + self.rounding) * self.scaling.spread + relative + SMALLEST

    def answer_many(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars at wrenches (n, 6), each (n, 6), m and rad."""
        x = self.scaling.loads(wrenches)
        spread, offset = self.scaling.spread, self.scaling.offset
        displacement, error_bars = np.empty((2, len(x), len(spread)))
        with single_thread():
            for part in self._chunks(len(x)):
                values, errors, known = self._scaled_answers(x[part])
                error_bars[part] = np.where(known, np.hypot(errors * spread, self.floor), np.nan)
                displacement[part] = values * spread + offset
        return displacement, error_bars

    def _scaled_answers(self, x: Floats) -> tuple[Floats, Floats, Mask]:
        """Return values, errors, and whether the errors are known, (m, 6) each, at points (m, 6).

        Values and errors are in spreads. Errors are 95 % error bars; where they are not known, some
        answers err by more.
        """
        n_outputs = self.weights.shape[2]
        errors = np.empty((len(x), n_outputs))
        known = np.empty((len(x), n_outputs), dtype=bool)
        values = self.coefficients[0] + (x[:, None] @ self.coefficients[1:])[:, 0]
        weights = self.weights.reshape(-1, n_outputs)
        kernel = None
        across = np.empty((0, 0))  # covariances of the points with all equations, by `kernel`
        for neighbours, calibration in zip(self.neighbourhoods, self.calibrations, strict=True):
            outputs = neighbours.factor.output_group.outputs
            if neighbours.factor.hyperparameters is not kernel:
                kernel = neighbours.factor.hyperparameters
                n_derivatives = self.equations.n_derivatives
                across = block(x, self.equations.x, kernel, 1, n_derivatives).reshape(len(x), -1)
            # Each point separately: weights are up to 1e8 times their sum, and the order of a sum
            # depends on the shape of the matrices.
            values[:, outputs] += (across[:, None] @ weights[:, outputs])[:, 0]
            sigma = neighbours.deviations(x, across)
            errors[:, outputs] = sigma[:, None] * calibration.factors * self.deviation[outputs]
            known[:, outputs] = (sigma <= calibration.max_sigma)[:, None]
        spanned = ((x >= self.span[0]) & (x <= self.span[1])).all(axis=1)
        spanned &= (secondary_loads(x, self.scaling) <= self.secondary_limits).all(axis=1)
        known &= spanned[:, None]
        return values, errors, known

    def _chunks(self, count: int) -> Iterator[slice]:
        """Yield the slices of `count` wrenches that are answered at once."""
        size = self.settings.chunk
        return (slice(start, start + size) for start in range(0, count, size))

    def sigma_with(self, pending: Floats, at: Floats) -> Floats:
        """Return the error bars (n, 6), m and rad, at wrenches once pending ones are solved too.

        The bars are estimates also where errors are not known, since a design goes there. Pending
        solves lower the bars of all outputs in the ratio of the factor over the most rows.

        `pending` (m, 6), N and N·m: wrenches that are being solved, with slopes if rows bring them.
        `at` (n, 6), N and N·m: wrenches of the error bars.
        """
        others, x = self.scaling.loads(pending), self.scaling.loads(at)
        bars = np.empty((len(x), len(self.scaling.spread)))
        with single_thread():
            for part in self._chunks(len(x)):
                bars[part] = self._scaled_answers(x[part])[1] * self.scaling.spread
            if not len(pending):
                return np.hypot(bars, self.floor)
            factors = [neighbours.factor for neighbours in self.neighbourhoods]
            factor = max(factors, key=lambda factor: len(factor.equations))
            hyperparameters, mean_covariance = factor.hyperparameters, factor.mean_covariance

            # The posterior covariance of the pending equations, `within`.
            n_derivatives = self.equations.n_derivatives
            known = np.zeros((len(others), n_derivatives), dtype=bool)
            known[:, 0], known[:, 1:] = True, self.equations.known[:, 1:].any(axis=0)
            new, new_terms = factor.explained_at(others, known)
            within = covariance(others, known, others, known, hyperparameters) - new @ new.T
            within += new_terms @ mean_covariance @ new_terms.T
            prior = np.tile(hyperparameters.prior(n_derivatives), (len(others), 1))[known]
            within[np.diag_indices_from(within)] += factor.nugget * prior

            for part in self._chunks(len(x)):
                explained, here_terms = factor.explained_at(x[part])
                value = np.ones((len(x[part]), 1), dtype=bool)
                between = covariance(x[part], value, others, known, hyperparameters)
                between -= explained @ new.T
                between += here_terms @ mean_covariance @ new_terms.T
                gain = np.einsum("mp,pm->m", between, np.linalg.solve(within, between.T))
                current = factor.variance_of(explained, here_terms, mean_covariance)
                bars[part] *= np.sqrt(np.clip(1 - gain / current, 0.0, 1.0))[:, None]
        return np.hypot(bars, self.floor)

    def left_out(self) -> Floats:
        """Return the errors (n, 6), m and rad, of left-out rows; NaN if a row lacks the output."""
        return self.errors * self.scaling.spread


def single_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs on one thread.

    A product of some hundred rows takes less time than the synchronisation of threads (0.5 against
    37 ms).
    """
    return _BLAS.limit(limits=1) if _BLAS else nullcontext()


class _TrainingData(NamedTuple):
    """The rows of a kriging, and the equations of them that fit into one factor."""

    rows: Rows  # those within the load range, sorted by wrench
    observations: Observations  # behind each row
    scaling: Scaling
    equations: Equations  # of values alone, evenly chosen, if there are many measured rows
    total: int  # number of equations of all rows
    kinds: list[Kind]
    span: Floats  # see `Kriging`
    secondary_limits: Floats  # see `Kriging`

    @classmethod
    def of(
        cls,
        rows: Rows,
        observations: Observations,
        load_range: LoadRange,
        settings: KrigingSettings,
    ) -> _TrainingData:
        """Choose the rows within the load range, and the equations.

        Raises TooFewRowsError as `scaling_of`.
        """
        indices = indices_within(rows, load_range)
        rows, observations = rows.take(indices), observations.take(indices)
        scaling = scaling_of(rows, load_range, settings)
        if len(rows) > settings.many_rows and not np.isfinite(rows.compliance).any():
            chosen = evenly(len(rows), settings.most_rows)
            few, behind = rows.take(chosen), observations.take(chosen)
            equations = values_of(few, scaling, behind, settings)
            total = len(rows)
        else:
            equations = equations_of(rows, scaling, observations, settings)
            if len(equations) < settings.min_rows:
                raise TooFewRowsError(
                    f"kriging needs {settings.min_rows} rows at different wrenches, but there are "
                    f"{len(equations)}; solve or import more rows"
                )
            equations, total = limited_to_factor(equations, settings), equations.count
        x = equations.x
        span = span_of(x, scaling, settings)
        kinds = kinds_of(x, scaling, span, settings)
        limits = kinds[0].secondary_limits
        if equations.known[:, 1:].any():  # slopes of a few rows show interactions of axes
            limits = largest_secondary_loads(x, scaling, settings)
        return cls(rows, observations, scaling, equations, total, kinds, span, limits)

    def mean_tangent(self) -> Floats:
        """Return the mean tangent of the rows, (6, 6), SI: see `Kriging.tangent`."""
        compliance = self.rows.compliance
        tangents = compliance[self.rows.has_tangent]
        if len(tangents):
            return tangents.mean(axis=0)
        is_varied = np.ptp(self.equations.x, axis=0) > NEAR
        return np.where(is_varied, np.zeros(compliance.shape[1:]), np.nan)


class _Model(NamedTuple):
    """The covariances and the noise of the outputs, and the equations of the factors."""

    estimate: Estimate
    equations: Equations
    inducing: list[KrigingFactor]  # the factors through inducing wrenches, if these are used
    observation_variance: Floats  # (6,), spreads squared: see `Kriging`
    detail: str  # see `Kriging`

    @classmethod
    def of(
        cls, data: _TrainingData, dependence: Floats | float, settings: KrigingSettings
    ) -> _Model:
        """Estimate covariances and noise; `dependence`: see `Kriging.build`."""
        equations, scaling, queries = data.equations, data.scaling, data.kinds[0].queries
        values_alone = equations.n_derivatives == 1
        if values_alone:
            sample = equations.take(evenly(len(equations), CANDIDATES))
            estimate = estimated(sample, scaling, queries, settings)
            by_inducing = induced(equations, estimate, settings, dependence)
        else:
            estimate, by_inducing = estimated(equations, scaling, queries, settings), None
        noise = estimate.noise if by_inducing is None else by_inducing.noise

        observed = (equations.observations > 0).any(axis=0)
        readings = np.maximum(equations.observations, equations.measured).sum(axis=0)
        # With fewer readings the mean takes all degrees of freedom.
        observed &= readings > 1 + scaling.active.sum()
        observation_variance = np.where(observed, noise * equations.typical_noise, 0.0)

        is_part = equations.count < data.total
        of_rows = f" of {len(data.rows)}" if is_part else ""
        if by_inducing is not None:
            detail = f"kriging of {len(equations)}{of_rows} rows through "
            detail += f"{len(by_inducing.equations)} inducing wrenches"
            equations, inducing = by_inducing.equations, by_inducing.factors
        else:
            if values_alone:
                equations = equations_of(data.rows, scaling, data.observations, settings)
            equations = replace(equations, noise=equations.unit_noise * noise * dependence)
            inducing = []
            of_equations = f" of {data.total}" if is_part else ""
            detail = f"kriging, one factor over {len(equations)}{of_rows} rows "
            detail += f"({equations.count}{of_equations} equations)"
        return cls(estimate, equations, inducing, observation_variance, detail)

    def factors(self, settings: KrigingSettings) -> Iterator[tuple[KrigingFactor, Floats]]:
        """Yield the factor of each output group, and the covariance (a, a) of all a equations."""
        equations, estimate = self.equations, self.estimate
        x, known = equations.x, equations.known
        groups = [factor.output_group for factor in self.inducing]
        groups = groups or output_groups(equations, estimate.variance, settings, estimate.kernels)
        previous: Hyperparameters | None = None
        covariances = np.empty((0, 0))
        for number, group in enumerate(groups):
            kernel = estimate.kernels[group.outputs[0]]
            if kernel is not previous:
                covariances = covariance(x, known, x, known, kernel)
                previous = kernel
            if self.inducing:
                yield self.inducing[number], covariances
                continue
            factor = factorise(equations, kernel, group, settings, covariances)
            if group.noise.any():  # with it the mean's coefficients are integrated out
                factor = replace(factor, variance=estimate.variance[group.outputs])
            yield factor, covariances
