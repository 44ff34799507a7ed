"""The kriging of a table: wrenches in, displacements with error bars and derivatives out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..table.rows import Floats, LoadRange, Rows
from .correlation import LOADS, Hyperparameters
from .dense import Dense, dense
from .equations import (
    OUTPUTS,
    Equations,
    Scaling,
    TooFewRowsError,
    TooManyRowsError,
    equations_of,
    later_order,
    places_within,
    scaling_of,
)
from .estimate import estimated
from .readings import Readings, readings_of
from .settings import DEFAULTS, KrigingSettings
from .shares import Share, shares_of
from .size import fits_one_factor
from .threads import one_thread


@dataclass(frozen=True, eq=False)
class Kriging:
    """The Gaussian process through a table's rows and their tangents; never changed once built.

    Attributes
    ----------
    load_range : LoadRange
    settings : KrigingSettings
    scaling : Scaling
    hyperparameters : Hyperparameters
    noise_scale : ndarray, shape (6,), spreads squared
        Process variances that the rows' uncertainties were held against.
    reading_variance : ndarray, shape (6,), spreads squared
        Of one reading whose uncertainty nobody stated.
    estimated_rows : int
        Rows of the table when the hyperparameters were estimated.
    inside : Dense
        What answers, in scaled numbers.
    tangent : ndarray, shape (6, 6), SI
        Mean tangent of the rows: the derivative by loads that take no part.
    detail : str
        How it answers, in words.
    """

    load_range: LoadRange
    settings: KrigingSettings
    scaling: Scaling
    hyperparameters: Hyperparameters
    noise_scale: Floats
    reading_variance: Floats
    estimated_rows: int
    inside: Dense
    tangent: Floats
    detail: str

    @classmethod
    def build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        previous: Kriging | None = None,
        settings: KrigingSettings = DEFAULTS,
        readings: Readings | None = None,
    ) -> Kriging:
        """Return the kriging of a table's rows inside the load range.

        Parameters
        ----------
        readings : Readings, optional
            What is behind each row where several were merged to one; else each stands for itself.
        previous : Kriging, optional
            Of an earlier version of the table: its hyperparameters are kept until the table has
            grown by a quarter, and start the estimate then; its factor is bordered by new rows.

        Raises
        ------
        TooFewRowsError
            If too few rows lie in the load range.
        TooManyRowsError
            If one factor does not hold their equations.
        SingularCovarianceError
            If rows contradict each other so that no nugget makes the covariance regular.
        """
        with one_thread():
            return cls._build(rows, load_range, previous, settings, readings or readings_of(rows))

    @classmethod
    def _build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        previous: Kriging | None,
        settings: KrigingSettings,
        readings: Readings,
    ) -> Kriging:
        places = places_within(rows, load_range, settings)
        inside, behind = rows.take(places), readings.take(places)
        scaling = scaling_of(inside, load_range, settings)
        equations = equations_of(inside, scaling, settings, behind)
        if len(equations) < settings.least_rows:
            raise TooFewRowsError(
                f"kriging needs {settings.least_rows} rows at different wrenches; there are "
                f"{len(equations)}: solve or import more"
            )
        tangents = inside.compliance[np.isfinite(inside.compliance).all(axis=(1, 2))]
        tangent = tangents.mean(axis=0) if len(tangents) else np.zeros((OUTPUTS, LOADS))
        if not fits_one_factor(equations.count, settings):
            raise TooManyRowsError(
                f"{len(equations)} rows bring {equations.count} equations, more than the "
                f"{settings.dense_equations} that one factor holds"
            )
        usable = previous is not None and previous.settings == settings
        follows = _follows(previous, load_range, scaling) if usable else None
        if follows is not None and len(equations) < settings.growth * follows.estimated_rows:
            return follows._extended(inside, behind, tangent)
        before = follows.hyperparameters if follows is not None else None
        held, noise_scale, variance = estimated(equations, scaling, before, settings)
        noisy = equations.with_reading_noise(variance)
        fresh = _built(noisy, held, noise_scale, scaling, None, settings)
        return cls(
            load_range=load_range,
            settings=settings,
            scaling=scaling,
            hyperparameters=held,
            noise_scale=noise_scale,
            reading_variance=variance,
            estimated_rows=len(equations),
            inside=fresh,
            tangent=tangent,
            detail=_in_words(fresh),
        )

    @property
    def knows_errors(self) -> bool:
        """Whether left-out rows show how large errors are, of all outputs."""
        return all(one.known for one in self.inside.calibrations)

    def answer_many(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and 95 % error bars at wrenches (n, 6), each (n, 6), m and rad."""
        x, spread, offset = self.scaling.loads(wrenches), self.scaling.spread, self.scaling.offset
        displacement, bars = np.empty((len(x), OUTPUTS)), np.empty((len(x), OUTPUTS))
        with one_thread():
            for part in self._chunks(len(x)):
                values, errors, known = self.inside.answers(x[part])
                size = (np.abs(values) + 1) * spread + np.abs(offset)
                # Never below what rounding makes of an answer.
                least = np.maximum(self.settings.bar_floor * size, self.inside.rounding * spread)
                bars[part] = np.where(known, np.maximum(errors * spread, least), np.nan)
                displacement[part] = values * spread + offset
        return displacement, bars

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return du/dw (n, 6, 6) at wrenches (n, 6): m/N, m/(N·m), rad/N, rad/(N·m).

        Exact of the interpolant. By a load that takes no part it is the rows' mean tangent.
        """
        x = self.scaling.loads(wrenches)
        out, rate = np.empty((len(x), OUTPUTS, LOADS)), self.scaling.spread[:, None]
        with one_thread():
            for part in self._chunks(len(x)):
                by_load = self.inside.slopes(x[part]) * rate / self.scaling.half
                out[part] = np.where(self.scaling.active, by_load, self.tangent)
        return out

    def _chunks(self, count: int) -> Iterator[slice]:
        """Yield the parts of so many wrenches that are told at once."""
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
        spread, bars = self.scaling.spread, np.empty((len(at), OUTPUTS))
        with one_thread():
            for part in self._chunks(len(at)):
                bars[part] = self.inside.answers(places[part])[1] * spread
                if len(pending):
                    bars[part] *= self.inside.sigmas_with(others, places[part])[:, None]
        return bars

    def left_out(self) -> Floats:
        """Return the errors (n, 6), m and rad, at rows left out; NaN where a row has no output."""
        return self.inside.errors * self.scaling.spread

    def _extended(self, inside: Rows, behind: Readings, tangent: Floats) -> Kriging:
        """Return the kriging of a later version of the table, with these hyperparameters."""
        equations = equations_of(inside, self.scaling, self.settings, behind)
        equations = equations.with_reading_noise(self.reading_variance)
        order = later_order(self.inside.equations, equations)
        before = self.inside if order is not None else None
        equations = equations if order is None else equations.take(order)
        later = _built(
            equations, self.hyperparameters, self.noise_scale, self.scaling, before, self.settings
        )
        return replace(self, inside=later, tangent=tangent, detail=_in_words(later))


def _follows(previous: Kriging | None, load_range: LoadRange, scaling: Scaling) -> Kriging | None:
    """Return the previous kriging if its scaled numbers mean the same, else None."""
    if previous is None:
        return None
    same = (
        np.array_equal(previous.load_range.low, load_range.low)
        and np.array_equal(previous.load_range.high, load_range.high)
        and np.array_equal(previous.scaling.active, scaling.active)
        and np.array_equal(previous.scaling.silent, scaling.silent)
    )
    return previous if same else None


def _built(
    equations: Equations,
    held: Hyperparameters,
    noise_scale: Floats,
    scaling: Scaling,
    before: Dense | None,
    settings: KrigingSettings,
) -> Dense:
    """Return what answers: one factor, or one for each kind of output."""
    shares = shares_of(equations, noise_scale, settings)
    known = before if before is not None and _bordered(before, shares) else None
    return dense(equations, held, shares, scaling, known, settings)


def _bordered(before: Dense, shares: list[Share]) -> bool:
    """Whether each share is that of an earlier factor and further rows."""
    if len(before.shares) != len(shares):
        return False
    pairs = [(own.factor, share) for own, share in zip(before.shares, shares, strict=True)]
    return all(
        np.array_equal(factor.outputs, share.outputs)
        and np.array_equal(factor.rows, share.rows[: len(factor.rows)])
        and np.array_equal(factor.noise, share.noise[: len(factor.rows)])
        for factor, share in pairs
    )


def _in_words(inside: Dense) -> str:
    rows, equations = len(inside.equations), inside.equations.count
    return f"kriging, one factor over {rows} rows ({equations} equations)"
