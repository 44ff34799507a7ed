"""The kriging of a table: wrenches in, displacements with error bars and derivatives out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

import numpy as np

from ..table.merging import Observations, merge
from ..table.rows import NEAR, SMALLEST, Floats, LoadRange, Rows
from .calibration import (
    Calibration,
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
    indices_within,
    scaling_of,
    values_of,
)
from .factor import Neighbourhoods, OutputGroup, factorise, left_out, output_groups
from .inducing import CANDIDATES, evenly, induced
from .likelihood import estimated, limited_to_factor
from .settings import DEFAULTS, KrigingSettings

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # it may be missing in a simulator: slower, and other last digits
    ThreadpoolController = None

_BLAS = ThreadpoolController and ThreadpoolController().select(user_api="blas")


# What one covariance times one weight may lose, relative: its squared distance, root, exponential
# and polynomial some units in the last place each. The errors have either sign: sums of compiled
# code and of arrays differed by up to 2.1 eps times the sum of magnitudes.
ROUNDING_LOSS = 4 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Kriging:
    """The Gaussian process through a table's rows and their tangents; never changed once built."""

    settings: KrigingSettings
    scaling: Scaling
    observation_variance: Floats  # (6,), spreads squared: of an observation of unknown uncertainty
    noise_widening: Floats  # (6,), dimensionless: see `noise.Estimate`
    # (6, 6), SI: mean tangent of the rows: the derivative by loads that take no part; NaN by loads
    # that no row varies where none brings slopes
    tangent: Floats
    equations: Equations
    # one per factor: outputs with the same rows and noise have one factor
    neighbourhoods: tuple[Neighbourhoods, ...]
    calibrations: tuple[Calibration, ...]  # one per item of `neighbourhoods`
    weights: Floats  # (n, p, 6), spreads
    coefficients: Floats  # (7, 6), spreads
    deviation: Floats  # (6,), spreads: process standard deviation
    # (6,), spreads: what answers may lose to it. Long length scales leave the covariance nearly
    # singular, with weights up to 1e8 times their sum.
    rounding: Floats
    # (n, 6), spreads: of rows left out, each by itself; NaN where a row does not bring the output
    errors: Floats
    # (2, 6), half ranges: ends of the loads that the rows span: beyond them errors are not known
    span: Floats
    # (2,), half ranges: `largest_secondary_loads` of the rows. Beyond them errors are not known
    # either: no row shows what so large loads do together.
    together: Floats
    detail: str  # its rows and equations as a text

    @classmethod
    def build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        settings: KrigingSettings = DEFAULTS,
        observations: Observations | None = None,
    ) -> Kriging:
        """Return the kriging of a table's rows inside the load range.

        Parameters
        ----------
        observations : Observations, optional
            Behind each row, of rows of distinct wrenches; else rows at one wrench are merged.

        Raises
        ------
        TooFewRowsError
            If too few rows lie in the load range.
        SingularCovarianceError
            If rows contradict each other so that no nugget makes the covariance regular.
        """
        if observations is None:
            rows, _, observations = merge(rows, load_range).usable()
        indices = indices_within(rows, load_range)
        used = rows.take(indices)
        scaling = scaling_of(used, load_range, settings)
        counted = observations.take(indices)
        equations, total = _usable(used, scaling, counted, settings)
        tangents = used.compliance[np.isfinite(used.compliance).all(axis=(1, 2))]
        tangent = tangents.mean(axis=0) if len(tangents) else np.zeros(used.compliance.shape[1:])
        untold = (np.ptp(equations.x, axis=0) <= NEAR) & (len(tangents) == 0)
        tangent[:, untold] = np.nan
        with single_thread():
            span = span_of(equations.x, scaling, settings)
            kinds = kinds_of(equations.x, scaling, span, settings)
            # Slopes of a few rows show what several axes do together.
            sloped = equations.known[:, 1:].any()
            all_rows_together = largest_secondary_loads(equations.x, scaling, settings)
            together = all_rows_together if sloped else kinds[0].together
            by_values = equations.n_derivatives == 1
            some = equations.take(evenly(len(equations), CANDIDATES)) if by_values else equations
            estimate = estimated(some, scaling, kinds[0].queries, settings)
            through = induced(equations, estimate, settings) if by_values else None
            noise = estimate.noise if through is None else through.noise
            observed = (equations.observations > 0).any(axis=0)
            readings = np.maximum(equations.observations, equations.measured).sum(axis=0)
            observed &= readings > 1 + scaling.active.sum()  # or the mean takes all of them
            observation_variance = np.where(observed, noise * equations.typical_noise, 0.0)
            some_rows = f" of {len(used)}" if equations.count < total else ""
            some_equations = f" of {total}" if equations.count < total else ""
            detail = f"kriging of {len(equations)}{some_rows} rows through "
            if through is not None:
                equations = through.equations
                detail += f"{len(equations)} inducing wrenches"
            else:
                if by_values:
                    equations = equations_of(used, scaling, counted, settings)
                equations = replace(equations, noise=equations.unit_noise * noise)
                detail = f"kriging, one factor over {len(equations)}{some_rows} rows "
                detail += f"({equations.count}{some_equations} equations)"
            x, known = equations.x, equations.known
            weights, n_outputs = np.zeros(equations.data.shape), equations.data.shape[2]
            coefficients = np.empty((1 + x.shape[1], n_outputs))
            deviation, rounding = np.empty((2, n_outputs))
            errors = np.full(equations.measured.shape, np.nan)
            values = np.zeros_like(known)
            values[:, 0] = True
            before: Hyperparameters | None = None
            neighbourhoods: list[Neighbourhoods] = []
            calibrations: list[Calibration] = []
            table, rounding_errors = np.empty((2, 0, 0))
            groups = output_groups(equations, estimate.variance, settings, estimate.kernels)
            for item in groups if through is None else through.factors:
                outputs = (
                    item.outputs if isinstance(item, OutputGroup) else item.output_group.outputs
                )
                kernel = estimate.kernels[outputs[0]]
                if kernel is not before:
                    table, before = covariance(x, known, x, known, kernel), kernel
                    rounding_errors = ROUNDING_LOSS * np.abs(table[values[known]])
                if isinstance(item, OutputGroup):
                    factor = factorise(equations, kernel, item, settings, table)
                    if item.noise.any():  # with it the mean's coefficients are integrated out
                        factor = replace(factor, variance=estimate.variance[outputs])
                else:
                    factor = item
                group = factor.output_group
                # The weights among the values and derivatives of all rows.
                all_rows = np.zeros((*known.shape, len(outputs)))
                all_rows[known & np.isin(np.arange(len(x)), group.rows)[:, None]] = factor.weights
                weights[:, :, outputs], coefficients[:, outputs] = all_rows, factor.coefficients
                deviation[outputs] = np.sqrt(factor.variance)
                rounding[outputs] = (rounding_errors @ np.abs(all_rows[known])).max(axis=0)
                alone = left_out(factor, np.arange(len(group.rows)))
                errors[np.ix_(group.rows, outputs)] = alone.errors
                neighbours = Neighbourhoods(
                    equations, factor, table, settings, of_all_rows=through is not None
                )
                neighbourhoods.append(neighbours)
                rest = scaling, kinds, estimate.widening[outputs], settings
                calibrations.append(
                    calibrated(equations, neighbours, alone, *rest)
                    if through is None
                    else of_posterior(factor, table, settings)
                )
        parts = equations, tuple(neighbourhoods), tuple(calibrations)
        arrays = weights, coefficients, deviation, rounding, errors, span, together
        noises = observation_variance, estimate.noise_widening
        return cls(settings, scaling, *noises, tangent, *parts, *arrays, detail)

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Those of the first outputs: outputs of measured rows have each their own."""
        return self.neighbourhoods[0].factor.hyperparameters

    @property
    def observation_noise(self) -> Floats:
        """Noise of an observation, 95 %, (6,), m and rad; NaN where stated, zero or unknown."""
        noise = self.settings.half_width * np.sqrt(self.observation_variance) * self.scaling.spread
        return np.where(self.observation_variance > 0, noise, np.nan)

    @property
    def floor(self) -> Floats:
        """The part of all error bars that no row takes away, (6,), m and rad.

        What the nugget leaves of each output's spread, and what answers lose to rounding.
        """
        nugget = np.empty_like(self.rounding)
        for neighbours in self.neighbourhoods:
            nugget[neighbours.factor.output_group.outputs] = neighbours.factor.nugget
        varying = np.where(self.scaling.constant, 0.0, np.sqrt(nugget))
        relative = self.settings.error_floor * np.abs(self.scaling.offset)
        return (varying + self.rounding) * self.scaling.spread + relative + SMALLEST

    def answer_many(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars at wrenches (n, 6), each (n, 6), m and rad."""
        x, spread, offset = self.scaling.loads(wrenches), self.scaling.spread, self.scaling.offset
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
        errors, known = np.empty((len(x), n_outputs)), np.empty((len(x), n_outputs), dtype=bool)
        values = self.coefficients[0] + (x[:, None] @ self.coefficients[1:])[:, 0]
        weights, terms = self.weights.reshape(-1, n_outputs), self.equations.n_derivatives
        kernel, across = None, np.empty((0, 0))
        for neighbours, calibration in zip(self.neighbourhoods, self.calibrations, strict=True):
            outputs = neighbours.factor.output_group.outputs
            if neighbours.factor.hyperparameters is not kernel:
                kernel = neighbours.factor.hyperparameters
                across = block(x, self.equations.x, kernel, 1, terms).reshape(len(x), -1)
            # Each point by itself: weights are up to 1e8 times their sum, and the order of a sum
            # depends on the shape of the matrices.
            values[:, outputs] += (across[:, None] @ weights[:, outputs])[:, 0]
            sigma = neighbours.deviations(x, across)
            errors[:, outputs] = sigma[:, None] * calibration.factors * self.deviation[outputs]
            known[:, outputs] = (sigma <= calibration.max_sigma)[:, None]
        spanned = ((x >= self.span[0]) & (x <= self.span[1])).all(axis=1)
        spanned &= (secondary_loads(x, self.scaling) <= self.together).all(axis=1)
        known &= spanned[:, None]
        return values, errors, known

    def _chunks(self, count: int) -> Iterator[slice]:
        """Yield the parts of so many wrenches that are answered at once."""
        size = self.settings.chunk
        return (slice(start, start + size) for start in range(0, count, size))

    def sigma_with(self, pending: Floats, at: Floats) -> Floats:
        """Return the error bars (n, 6), m and rad, at wrenches if others were solved too.

        As far as they are known or not: a design goes where they are not. Pending solves lower all
        bars in the ratio of the factor over the most rows.

        `pending`, `at` (m, 6) and (n, 6), N and N·m: what is being solved (with slopes, if rows
        bring them), and where the bars are wanted.
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
            n_derivatives = self.equations.n_derivatives
            known = np.zeros((len(others), n_derivatives), dtype=bool)
            known[:, 0], known[:, 1:] = True, self.equations.known[:, 1:].any(axis=0)
            new, new_terms = factor.explained_at(others, known)
            within = covariance(others, known, others, known, hyperparameters) - new @ new.T
            within += new_terms @ mean_covariance @ new_terms.T
            prior = np.tile(hyperparameters.prior(n_derivatives), (len(others), 1))[known]
            within[np.diag_indices_from(within)] += factor.nugget * prior
            for part in self._chunks(len(x)):
                value = np.zeros((len(x[part]), n_derivatives), dtype=bool)
                value[:, 0] = True
                explained, here_terms = factor.explained_at(x[part], value)
                between = (
                    covariance(x[part], value, others, known, hyperparameters) - explained @ new.T
                )
                between += here_terms @ mean_covariance @ new_terms.T
                gain = np.einsum("mp,pm->m", between, np.linalg.solve(within, between.T))
                before = factor.variance_of(explained, here_terms, mean_covariance)
                bars[part] *= np.sqrt(np.clip(1 - gain / before, 0.0, 1.0))[:, None]
        return np.hypot(bars, self.floor)

    def left_out(self) -> Floats:
        """Return the errors (n, 6), m and rad, at rows left out; NaN where a row has no output."""
        return self.errors * self.scaling.spread


def single_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs on one thread.

    A product of some hundred rows takes less time than the threads' meeting (0.5 against 37 ms).
    """
    return _BLAS.limit(limits=1) if _BLAS else nullcontext()


def _usable(
    used: Rows, scaling: Scaling, counted: Observations, settings: KrigingSettings
) -> tuple[Equations, int]:
    """Return the equations of rows that one factor holds, and the number that the rows bring.

    Values alone where they are measured and many.

    Raises TooFewRowsError.
    """
    if len(used) > settings.many_rows and not np.isfinite(used.compliance).any():
        chosen = evenly(len(used), settings.most_rows)
        return values_of(used.take(chosen), scaling, counted.take(chosen), settings), len(used)
    equations = equations_of(used, scaling, counted, settings)
    if len(equations) < settings.min_rows:
        raise TooFewRowsError(
            f"kriging needs {settings.min_rows} rows at different wrenches, but there are "
            f"{len(equations)}; solve or import more"
        )
    return limited_to_factor(equations, settings), equations.count
