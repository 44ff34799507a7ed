"""The kriging of a table: wrenches in, displacements with error bars and derivatives out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np

from ..table.merging import Readings, merge
from ..table.rows import Floats, LoadRange, Rows
from .correlation import Hyperparameters
from .dense import Dense, dense
from .equations import (
    Scaling,
    TooFewRowsError,
    TooManyRowsError,
    equations_of,
    places_within,
    scaling_of,
    within,
)
from .estimate import estimated, within_one_factor
from .factor import shares_of
from .settings import DEFAULTS, KrigingSettings

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # it may be missing in a simulator: slower, and other last digits
    ThreadpoolController = None

_BLAS = ThreadpoolController and ThreadpoolController().select(user_api="blas")


@dataclass(frozen=True, eq=False)
class Kriging:
    """The Gaussian process through a table's rows and their tangents; never changed once built.

    Attributes
    ----------
    settings : KrigingSettings
    scaling : Scaling
    hyperparameters : Hyperparameters
        Common to all outputs.
    reading_variance : ndarray, shape (6,), spreads squared
        Of one reading whose uncertainty nobody stated.
    inside : Dense
        What answers, in scaled numbers.
    tangent : ndarray, shape (6, 6), SI
        Mean tangent of the rows: the derivative by loads that take no part.
    """

    settings: KrigingSettings
    scaling: Scaling
    hyperparameters: Hyperparameters
    reading_variance: Floats
    inside: Dense
    tangent: Floats

    @classmethod
    def build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        settings: KrigingSettings = DEFAULTS,
        readings: Readings | None = None,
    ) -> Kriging:
        """Return the kriging of a table's rows inside the load range.

        Parameters
        ----------
        readings : Readings, optional
            Behind each row, of rows of distinct wrenches; else rows at one wrench are merged.

        Raises
        ------
        TooFewRowsError
            If too few rows lie in the load range.
        TooManyRowsError
            If one factor does not hold their equations.
        SingularCovarianceError
            If rows contradict each other so that no nugget makes the covariance regular.
        """
        if readings is None:
            rows, _, readings = merge(rows, load_range).usable()
        with one_thread():
            return cls._build(rows, load_range, settings, readings)

    @classmethod
    def _build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        settings: KrigingSettings,
        readings: Readings,
    ) -> Kriging:
        places = places_within(rows, load_range, settings)
        used, behind = rows.take(places), readings.take(places)
        scaling = scaling_of(used, load_range, settings)
        equations = equations_of(used, scaling, behind, settings)
        equations = within_one_factor(equations, settings)
        if len(equations) < settings.least_rows:
            raise TooFewRowsError(
                f"kriging needs {settings.least_rows} rows at different wrenches; there are "
                f"{len(equations)}: solve or import more"
            )
        tangents = used.compliance[np.isfinite(used.compliance).all(axis=(1, 2))]
        tangent = tangents.mean(axis=0) if len(tangents) else np.zeros(used.compliance.shape[1:])
        if not fits_one_factor(equations.count, settings):
            raise TooManyRowsError(
                f"{len(equations)} rows bring {equations.count} equations, more than the "
                f"{settings.dense_equations} that one factor holds"
            )
        found = estimated(equations, scaling, settings)
        noisy = equations.with_reading_noise(found.reading_variance)
        shares = shares_of(noisy, found.noise_scale, settings)
        inside = dense(noisy, found.hyperparameters, shares, scaling, settings)
        return cls(
            settings, scaling, found.hyperparameters, found.reading_variance, inside, tangent
        )

    @property
    def detail(self) -> str:
        """How it answers, in words."""
        rows, equations = len(self.inside.equations), self.inside.equations.count
        return f"kriging, one factor over {rows} rows ({equations} equations)"

    @property
    def reading(self) -> Floats:
        """Noise of one reading, 95 %, (6,), m and rad; NaN where all noise is stated or none."""
        noise = self.settings.half_width * np.sqrt(self.reading_variance) * self.scaling.spread
        return np.where(self.reading_variance > 0, noise, np.nan)

    @property
    def knows_errors(self) -> bool:
        """Whether left-out rows show how large errors are, of all outputs."""
        return all(one.known for one in self.inside.calibrations)

    def answer_many(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars at wrenches (n, 6), each (n, 6), m and rad."""
        x, spread, offset = self.scaling.loads(wrenches), self.scaling.spread, self.scaling.offset
        displacement, bars = np.empty((2, len(x), len(spread)))
        with one_thread():
            for part in self._chunks(len(x)):
                values, errors, known = self.inside.answers(x[part])
                size = (np.abs(values) + 1) * spread + np.abs(offset)
                # Never below what rounding makes of an answer.
                least = np.maximum(self.settings.error_floor * size, self.inside.rounding * spread)
                bars[part] = np.where(known, np.maximum(errors * spread, least), np.nan)
                displacement[part] = values * spread + offset
        return displacement, bars

    def _chunks(self, count: int) -> Iterator[slice]:
        """Yield the parts of so many wrenches that are answered at once."""
        size = self.settings.chunk
        return (slice(start, start + size) for start in range(0, count, size))

    def sigma_with(self, pending: Floats, at: Floats) -> Floats:
        """Return the error bars (n, 6), m and rad, at wrenches if others were solved too.

        As far as they are known or not: a design goes where they are not.

        Parameters
        ----------
        pending, at : ndarray, shapes (m, 6) and (n, 6), N and N·m
            What is being solved (with slopes, if rows bring them), and where to tell the bars.
        """
        others, places = self.scaling.loads(pending), self.scaling.loads(at)
        spread, bars = self.scaling.spread, np.empty((len(at), len(self.scaling.spread)))
        with one_thread():
            for part in self._chunks(len(at)):
                bars[part] = self.inside.answers(places[part])[1] * spread
                if len(pending):
                    bars[part] *= self.inside.sigmas_with(others, places[part])[:, None]
        return bars

    def left_out(self) -> Floats:
        """Return the errors (n, 6), m and rad, at rows left out; NaN where a row has no output."""
        return self.inside.errors * self.scaling.spread


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs on one thread.

    A product of some hundred rows takes less time than the threads' meeting (0.5 against 37 ms).
    """
    return _BLAS.limit(limits=1) if _BLAS else nullcontext()


def equation_count(rows: Rows, load_range: LoadRange, settings: KrigingSettings = DEFAULTS) -> int:
    """Return how many equations rows of distinct wrenches bring: values, and slopes by loads.

    Raises
    ------
    TooFewRowsError
        If too few rows lie in the load range.
    """
    sloped = np.isfinite(rows.compliance).all(axis=(1, 2))
    loads = rows.wrench.shape[1]
    if len(rows) * (1 + loads) <= settings.dense_equations or not sloped.any():
        return len(rows) + loads * int(sloped.sum())
    inside = within(rows, load_range, settings)
    loads = int(scaling_of(inside, load_range, settings).active.sum())
    return len(inside) + loads * int(np.isfinite(inside.compliance).all(axis=(1, 2)).sum())


def fits_one_factor(equations: int, settings: KrigingSettings = DEFAULTS) -> bool:
    """Return whether one dense factor holds so many equations."""
    return equations <= settings.dense_equations


def too_large_in_words(rows: int, equations: int, settings: KrigingSettings = DEFAULTS) -> str:
    """Return why a table of so many rows and equations has no kriging."""
    return (
        f"no kriging: {rows} rows bring {equations} equations, one factor holds "
        f"{settings.dense_equations}"
    )
