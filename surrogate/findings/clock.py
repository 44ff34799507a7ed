"""The lag between the clocks of a log of loads and one of displacements, and their rates.

Cross-correlations of the two logs on one time grid give first lags. Near them, the least residual
of a polynomial response to the shifted loads gives the lag and the difference of the rates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from ..table.polynomial import RANK, terms_of
from ..table.rows import Floats
from .response import RigFinding

MIN_DISPLACEMENTS = 60  # displacements: with fewer a lag may show by chance
MAX_DISPLACEMENTS = 2_000  # displacements that are fitted, evenly chosen: some 5 ms a fit
MAX_STEPS = 1 << 15  # steps of the time grid: limits the memory of the Fourier transforms
MAX_LAG = 0.25  # largest lag of the search, as a part of the displacements' duration
# Part of the displacements' variance: smaller residuals are the rounding of written digits.
WRITTEN_DIGITS = 1e-9
# Part of the displacements' duration: smaller steps are lost in the clock's digits.
RESOLUTION = 1e-9
# Peaks of the correlation that are fitted: a load shifted by half a period correlates as well.
MAX_PEAKS = 5
MIN_EXPLAINED = 0.5  # part of the displacements' variance: with less the logs are of two tests
# Part of the loads' interval: exact logs of 0.1 to 4 Hz were within 1.1 %.
INTERPOLATION_ERROR = 0.02
INNER_PART = 0.9  # part of a search's width: an optimum beyond it may be the bound of the search
MIN_GAIN = 0.2  # part of the residual's variance at the applied lag that another lag must explain
# Least ratio of residual variances that counts as equal: between two loads interpolation averages
# their noise, so that half the variance shows no better lag.
EQUAL_RATIO = 0.5
# Standard deviations of the error of a lag: residuals that are near in time are not independent.
DEVIATIONS = 4.0
MIN_MISFIT = 0.003  # part of the displacements' deviation: misfits below it need no remark
MAX_TAIL = 0.5  # ranges: largest weight of a displacement beyond the 1st and 99th percentiles
SEARCH_ACCURACY = 0.05  # part of a step of the grid: the parabola of `vertex` then gives the digits
LOAD_RANK = 1e-6  # part of the loads' largest singular value: smaller ones are their noise
TINY = 1e-300  # replaces a variance of zero in a divisor


class Logs(NamedTuple):
    """Two logs of one test."""

    load_time: Floats  # (n,), s, ascending
    wrench: Floats  # (n, 6), N and N·m
    displacement_time: Floats  # (m,), s
    displacement: Floats  # (m, 6), m and rad: NaN where not measured


class Lag(NamedTuple):
    """The lag of the displacements' times behind the clock of the loads."""

    seconds: float  # s
    error: float  # s: `DEVIATIONS` standard deviations
    # Slowness of the displacements' clock over the loads' rate; 0 where the residual shows none.
    rate: float
    misfit: float  # residual of the response over the displacements' deviation at this lag
    misfit_applied: float  # at the applied lag
    misfit_rate: float  # at this lag and rate
    applied_is_wrong: bool  # the applied lag does not fit, and hysteresis does not explain it
    # s: lags that fit as well: periodic loads do not show by how many periods the clocks differ
    others: tuple[float, ...]


def estimate_lag(logs: Logs, applied: float = 0.0) -> Lag | None:
    """Return the lag with which displacements fit loads best; None if the logs do not show one.

    `applied`, s: the lag in use, to compare with.
    """
    is_known = np.isfinite(logs.displacement).sum(axis=0) >= MIN_DISPLACEMENTS
    is_varied = np.ptp(logs.wrench, axis=0) > 0
    if not is_known.any() or not is_varied.any() or np.ptp(logs.displacement_time) <= 0:
        return None
    logs = logs._replace(
        wrench=logs.wrench[:, is_varied], displacement=_clipped(logs.displacement[:, is_known])
    )
    duration = float(np.ptp(logs.displacement_time))
    interval = min(
        float(np.median(np.diff(times)))
        for times in (logs.load_time, np.sort(logs.displacement_time))
    )
    step = max(interval, (duration + 2 * MAX_LAG * duration) / MAX_STEPS, duration * RESOLUTION)
    starts = [applied, *_correlated_lags(logs, applied, step)]
    results = [_fitted(logs, (applied, start), step) for start in starts]
    candidates = [result for result in results if result is not None]
    if not candidates:
        return None
    # Of the lags that fit about as well as the best, such as those one period apart with periodic
    # loads, the one nearest to the applied lag is taken.
    variances = [max(float(fit.residual(lag).mean()), MIN_MISFIT**2) for lag, fit in candidates]
    equal = [
        candidate
        for candidate, variance in zip(candidates, variances, strict=True)
        if EQUAL_RATIO * variance <= min(variances)
    ]
    equal.sort(key=lambda candidate: abs(candidate.lag - applied))
    fit = equal[0].fit
    (best, error), *further = (candidate.fit.vertex(candidate.lag) for candidate in equal)
    # Lags whose intervals do not meet that of the best one; an unknown error adds nothing.
    others = tuple(
        lag
        for lag, error_of_lag in further
        if abs(lag - best) > error + step + np.nan_to_num(error_of_lag, posinf=0.0)
    )

    # A lag, a rate and a loop are each taken only if they explain more than the others do.
    at_best, at_applied, loop = fit.residual(best), fit.residual(applied), fit.with_loop(applied)
    rate, with_rate = fit.rate(best) if at_best.mean() > MIN_MISFIT**2 else (0.0, at_best)
    is_drift = abs(rate) * duration >= step
    if not (is_drift and with_rate.sum() < min(EQUAL_RATIO * at_best.sum(), loop.sum())):
        rate, with_rate = 0.0, at_best
    if with_rate.mean() > 1 - MIN_EXPLAINED or not np.isfinite(error):
        return None
    return Lag(
        seconds=best,
        error=error,
        rate=rate,
        misfit=float(at_best.mean() ** 0.5),
        misfit_applied=float(at_applied.mean() ** 0.5),
        misfit_rate=float(with_rate.mean() ** 0.5),
        applied_is_wrong=abs(best - applied) > error
        and at_applied.mean() > MIN_MISFIT**2
        and at_best.sum() < (1 - MIN_GAIN) * at_applied.sum()
        and at_best.sum() < loop.sum(),
        others=others,
    )


class _LagFit(NamedTuple):
    """A lag of least residual, and the fit with this residual."""

    lag: float  # s
    fit: _Fit


def clock_findings(lag: Lag | None, applied: float) -> list[RigFinding]:
    """Return a finding if the logs need another clock rate, or another lag than the applied one."""
    if lag is not None and lag.rate:
        message = (
            f"the clock of the displacement log runs {abs(lag.rate):.3%} "
            f"{'slower' if lag.rate > 0 else 'faster'} than the load log's. In the file, "
            f"multiply the times of the displacements by {1 + lag.rate:.6g} (misfit "
            f"{lag.misfit_rate:.1%} instead of {lag.misfit:.1%}), and import again with lag=auto"
        )
        return [RigFinding("clock", message, (), {"rate": lag.rate})]
    # With lag=auto `applied` is the estimated lag.
    if lag is None or not lag.applied_is_wrong or abs(applied - lag.seconds) <= lag.error:
        return []
    if lag.others:
        message = (
            f"{repeated(lag)}, but not with {applied:g} s (misfit {lag.misfit_applied:.1%} instead "
            f"of {lag.misfit:.1%}). Withdraw this import, and import again with the lag that fits "
            "a load that occurs once"
        )
        return [RigFinding("clock", message, (), {"lags": sorted((lag.seconds, *lag.others))})]
    message = (
        f"the displacement log needs {lag.seconds:.4g} +- {lag.error:.1g} s added to its times, "
        f"not {applied:g} s: the misfit falls from {lag.misfit_applied:.1%} to {lag.misfit:.1%}. "
        f"Withdraw this import, and import again with lag={lag.seconds:.4g} "
        f"(--lag {lag.seconds:.4g})"
    )
    return [RigFinding("clock", message, (), {"lag": lag.seconds, "uncertainty": lag.error})]


def repeated(lag: Lag) -> str:
    """Return a text on the lags that fit as well."""
    others = " and ".join(f"{seconds:.4g}" for seconds in sorted(lag.others))
    return f"the loads repeat, and the logs fit as well with {others} s as with {lag.seconds:.4g} s"


def _correlated_lags(logs: Logs, applied: float, step: float) -> list[float]:
    """Return the lags of the `MAX_PEAKS` largest correlations of two logs on a grid of times, s.

    The part of the displacements' variance that loads explain is c' inv(G) c, with c their
    cross-correlations and G the covariance of the loads.
    """
    longest = MAX_LAG * float(np.ptp(logs.displacement_time))
    grid = np.arange(
        logs.displacement_time.min() - longest, logs.displacement_time.max() + longest, step
    )
    order = np.argsort(logs.displacement_time, kind="stable")
    x = _on_grid(grid + applied, logs.load_time, logs.wrench)
    y = _on_grid(grid, logs.displacement_time[order], logs.displacement[order])

    size = 2 * len(grid)
    of_loads = np.fft.rfft(x, size, axis=0)
    of_displacements = np.conj(np.fft.rfft(y, size, axis=0))
    products = (of_loads * spectrum[:, None] for spectrum in of_displacements.T)
    cross = np.stack([np.fft.irfft(product, size, axis=0) for product in products])
    shifts = np.arange(-int(longest / step), int(longest / step) + 1)
    inverse = np.linalg.pinv(x.T @ x, rcond=LOAD_RANK)
    explained = np.einsum("ksi,ij,ksj->s", cross[:, shifts], inverse, cross[:, shifts])

    inner = explained[1:-1]
    peaks = 1 + np.flatnonzero((inner >= explained[:-2]) & (inner >= explained[2:]))
    peaks = peaks[np.argsort(-explained[peaks])[:MAX_PEAKS]]
    return (applied + step * shifts[peaks]).tolist()


def _clipped(displacements: Floats) -> Floats:
    """Return displacements (m, k) over their deviations: NaN is 0, and far values are clipped."""
    low, high = np.nanpercentile(displacements, [1, 99], axis=0)
    tail = MAX_TAIL * np.maximum(high - low, np.finfo(float).tiny)
    clipped = np.clip(displacements, low - tail, high + tail)
    clipped = np.nan_to_num(clipped - np.nanmean(clipped, axis=0))
    return clipped / np.maximum(clipped.std(axis=0), np.finfo(float).tiny)


def _fitted(logs: Logs, lags: tuple[float, float], step: float) -> _LagFit | None:
    """Return the lag of least residual and its fit; None if there is none.

    `lags`, s: the applied one, and the one near which the search starts. The fit has the
    displacements with loads at both. A search that ends at its bound starts again there, with twice
    the width.
    """
    applied, start = lags
    width = 2 * step
    max_width = MAX_LAG * float(np.ptp(logs.displacement_time))
    while width < max_width:
        fit = _Fit(logs, (applied, start), step, width + step)
        if len(fit.logs.displacement_time) < MIN_DISPLACEMENTS:
            return None
        result: Any = minimize_scalar(
            fit.size,
            bounds=(start - width, start + width),
            options={"xatol": SEARCH_ACCURACY * step},
        )
        if abs(result.x - start) < INNER_PART * width:
            return _LagFit(float(result.x), fit)
        start = float(result.x)
        width = 2 * width
    return None


def _on_grid(grid: Floats, time: Floats, values: Floats) -> Floats:
    """Return columns (n, k) at the grid's times, over their deviations, zero outside the log."""
    sampled = np.stack([np.interp(grid, time, column) for column in values.T], axis=1)
    inside = (grid >= time[0]) & (grid <= time[-1])
    sampled -= sampled[inside].mean(axis=0) if inside.any() else 0.0
    return np.where(inside[:, None], sampled, 0.0) / np.maximum(sampled.std(axis=0), TINY)


class _Fit:
    """Residuals of the response over the lag, on displacements that have loads at all lags."""

    def __init__(self, logs: Logs, lags: tuple[float, float], step: float, width: float) -> None:
        """Choose the displacements that have loads within `width`, s, of both `lags`, s."""
        low = min(lags) - width
        high = max(lags) + width
        inside = (logs.displacement_time + low >= logs.load_time[0]) & (
            logs.displacement_time + high <= logs.load_time[-1]
        )
        indices = np.flatnonzero(inside)
        indices = indices[:: max(-(-len(indices) // MAX_DISPLACEMENTS), 1)]
        self.logs = logs._replace(
            displacement_time=logs.displacement_time[indices],
            displacement=logs.displacement[indices],
        )
        self._scale = np.abs(logs.wrench).max(axis=0)
        self._step = step

    def _terms(self, lag: float | Floats) -> Floats:
        """Return the terms of the response at the displacements' times, shape (n, t)."""
        return terms_of(self._loads(lag) / self._scale)

    def _loads(self, lag: float | Floats) -> Floats:
        """Return the loads at the displacements' times, shape (n, l), N and N·m."""
        logs = self.logs
        times = logs.displacement_time + lag
        return np.stack([np.interp(times, logs.load_time, load) for load in logs.wrench.T], axis=1)

    def residual(self, lag: float | Floats) -> Floats:
        """Return the unexplained mean square of each output, (k,), over its variance."""
        return self._unexplained(self._terms(lag), self.logs.displacement)

    def size(self, lag: float) -> float:
        """Return the sum of `residual` over the outputs."""
        return float(self.residual(lag).sum())

    def with_loop(self, lag: float) -> Floats:
        """Return `residual` of a response with one more term: the direction of the motion."""
        terms = self._terms(lag)
        y = self.logs.displacement
        after = self._loads(lag + self._step)
        before = self._loads(lag - self._step)
        coefficients = np.linalg.lstsq(self._loads(lag), y, rcond=RANK)[0]
        signs = np.sign((after - before) @ coefficients)
        return np.concatenate(
            [
                self._unexplained(np.column_stack((terms, sign)), column[:, None])
                for sign, column in zip(signs.T, y.T, strict=True)
            ]
        )

    def vertex(self, lag: float) -> tuple[float, float]:
        """Return the lag of the least residual near a lag, and its error, s.

        The vertex is that of a parabola through lags one interval of the loads apart: between two
        loads interpolation averages their noise, which bends the residual at smaller steps.
        """
        step = float(np.median(np.diff(self.logs.load_time)))
        least, curvature = np.empty(0), np.empty(0)
        for _ in range(3):
            least = self.residual(lag)
            low = self.residual(lag - step)
            high = self.residual(lag + step)
            curvature = (low + high - 2 * least).clip(0.0)
            if not curvature.sum() > 0:
                return lag, np.inf
            lag += step * float(np.clip((low - high).sum() / curvature.sum() / 2, -1, 1))

        terms = self._terms(lag)
        y = self.logs.displacement
        residual = y - terms @ np.linalg.lstsq(terms, y, rcond=RANK)[0]
        # The correlation of neighbours in time leaves fewer degrees of freedom.
        products = (residual[1:] * residual[:-1]).sum(axis=0)
        correlation = products / np.maximum((residual**2).sum(axis=0), TINY)
        correlation = correlation.clip(0.0, 1 - 1 / len(y))
        free = max(len(y) - terms.shape[1], 1) * (1 - correlation) / (1 + correlation)
        # The errors of the outputs add up, as the noise of the loads is in all of them.
        errors = np.sqrt(2 * np.maximum(least, WRITTEN_DIGITS) * curvature / free)
        error = float(errors.sum() / curvature.sum())
        return lag, step * (DEVIATIONS * error + INTERPOLATION_ERROR)

    def rate(self, lag: float) -> tuple[float, Floats]:
        """Return the rate that, with a lag near `lag`, fits best, and its residual, (k,)."""
        middle = self.logs.displacement_time.mean()
        unit = self._step / float(np.ptp(self.logs.displacement_time))

        def residual(x: Floats) -> Floats:
            shifted = lag + x[0] * self._step + x[1] * unit * (self.logs.displacement_time - middle)
            return self.residual(shifted)

        result: Any = minimize(
            lambda x: residual(x).sum(),
            np.zeros(2),
            method="Nelder-Mead",
            options={"initial_simplex": [[0, 0], [1, 0], [0, 2]], "xatol": 0.1, "fatol": 1e-3},
        )
        return float(result.x[1]) * unit, residual(result.x)

    def _unexplained(self, terms: Floats, y: Floats) -> Floats:
        """Return the unexplained part of each output's variance, (k,).

        `terms` (n, t): terms of the response; `y` (n, k): outputs.
        """
        residual = y - terms @ np.linalg.lstsq(terms, y, rcond=RANK)[0]
        return np.asarray((residual**2).mean(axis=0) / np.maximum((y**2).mean(axis=0), TINY))
