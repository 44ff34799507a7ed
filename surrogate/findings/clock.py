"""The clock shift between a log of loads and one of displacements.

Cross-correlations of the two logs on one time grid give the lag to a step of the grid; the least
residual of a polynomial response to the shifted loads refines it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from ..table.rows import Floats
from .finding import RigFinding
from .response import terms_of

FEWEST = 60  # displacements: with fewer a lag shows by chance
MOST = 2_000  # displacements that are fitted, some 5 ms a fit
GRID = 1 << 15  # steps of the time grid, at most
PART = 0.25  # of the displacements' duration: the largest lag that is looked for
EXPLAINED = 0.5  # of the displacements' variance: with less the logs do not belong together
SHARE = 0.2  # of the residual's variance at the applied lag that another lag must explain
DEVIATIONS = 4.0  # of the estimate: residuals that are near in time are not independent
SMALL = 0.003  # of the displacements' deviation: misfits below it need no remark
TAIL = 0.5  # ranges: what a displacement beyond the 1st and 99th percentiles counts at most


class Logs(NamedTuple):
    """Two logs of one test.

    Attributes
    ----------
    time : ndarray, shape (n,), s
        Of the loads; it grows.
    wrench : ndarray, shape (n, 6), N and N·m
    when : ndarray, shape (m,), s
        Of the displacements.
    displacement : ndarray, shape (m, 6), m and rad
        NaN where not measured.
    """

    time: Floats
    wrench: Floats
    when: Floats
    displacement: Floats


class Lag(NamedTuple):
    """What the displacements' times lack to the clock of the loads.

    Attributes
    ----------
    seconds : float, s
    error : float, s
        `DEVIATIONS` standard deviations.
    misfit, misfit_applied : float
        Residual of the response over the displacements' deviation, at this lag and at the applied
        one.
    named : bool
        Whether the applied lag does not fit, and hysteresis does not explain that.
    """

    seconds: float
    error: float
    misfit: float
    misfit_applied: float
    named: bool


def estimate_lag(logs: Logs, applied: float = 0.0) -> Lag | None:
    """Return the lag with which displacements fit loads best; None if the logs do not show one.

    Parameters
    ----------
    logs : Logs
    applied : float, s
        The lag in use, to compare with.
    """
    known = np.isfinite(logs.displacement).sum(axis=0) >= FEWEST
    loads = np.ptp(logs.wrench, axis=0) > 0
    if not known.any() or not loads.any() or np.ptp(logs.when) <= 0:
        return None
    moved = _clipped(logs.displacement[:, known])
    own = Logs(logs.time, logs.wrench[:, loads], logs.when, moved)
    step, start = _correlated(own, applied)
    fit = _Fit(own, (applied, start), step)
    if len(fit.logs.when) < FEWEST:
        return None
    start = min((start, applied), key=lambda lag: fit.residual(lag).sum())
    bounds = (start - 2 * step, start + 2 * step)
    found: Any = minimize_scalar(lambda lag: fit.residual(lag).sum(), bounds=bounds)
    best = float(found.x)
    least, before, loop = fit.residual(best), fit.residual(applied), fit.with_loop(applied)
    if least.mean() > 1 - EXPLAINED:
        return None
    error = fit.error(best, step)
    named = (
        abs(best - applied) > error
        and before.mean() > SMALL**2
        and least.sum() < (1 - SHARE) * before.sum()
        and least.sum() < loop.sum()
    )
    return Lag(best, error, float(least.mean() ** 0.5), float(before.mean() ** 0.5), named)


def clock_findings(lag: Lag | None, applied: float) -> list[RigFinding]:
    """Return a finding where the logs need another lag than the applied one."""
    if lag is None or not lag.named:
        return []
    message = (
        f"loads and displacements are shifted in time: they fit best with {lag.seconds:.4g} "
        f"+- {lag.error:.1g} s added to the displacements' times, and {applied:g} s was added (the "
        f"misfit is {lag.misfit_applied:.1%}, and {lag.misfit:.1%} with it). Withdraw this import "
        f"and import again with lag={lag.seconds:.4g}, or lag=auto"
    )
    return [RigFinding("clock", message, (), {"lag": lag.seconds, "uncertainty": lag.error})]


def _clipped(moved: Floats) -> Floats:
    """Return displacements (m, k) in deviations, NaN at the mean, sentinels near the others."""
    low, high = np.nanpercentile(moved, [1, 99], axis=0)
    tail = TAIL * np.maximum(high - low, np.finfo(float).tiny)
    found = np.clip(moved, low - tail, high + tail)
    found = np.nan_to_num(found - np.nanmean(found, axis=0))
    return found / np.maximum(found.std(axis=0), np.finfo(float).tiny)


def _correlated(logs: Logs, applied: float) -> tuple[float, float]:
    """Return the step of the time grid, s, and the lag of the largest correlation, s.

    The part of the displacements' variance that loads explain is c' inv(G) c, with c their
    cross-correlations and G the covariance of the loads.
    """
    duration = float(np.ptp(logs.when))
    reach = PART * duration
    interval = min(float(np.median(np.diff(one))) for one in (logs.time, np.sort(logs.when)))
    step = max(interval, (duration + 2 * reach) / GRID, duration * 1e-9)
    grid = np.arange(logs.when.min() - reach, logs.when.max() + reach, step)
    order = np.argsort(logs.when, kind="stable")
    x = _on_grid(grid + applied, logs.time, logs.wrench)
    y = _on_grid(grid, logs.when[order], logs.displacement[order])
    size = 2 * len(grid)
    shape = np.fft.rfft(x, size, axis=0), np.conj(np.fft.rfft(y, size, axis=0))
    cross = np.stack([np.fft.irfft(shape[0] * one[:, None], size, axis=0) for one in shape[1].T])
    shifts = np.arange(-int(reach / step), int(reach / step) + 1)
    inverse = np.linalg.pinv(x.T @ x, rcond=1e-6)
    explained = np.einsum("ksi,ij,ksj->s", cross[:, shifts], inverse, cross[:, shifts])
    return step, applied + step * float(shifts[int(np.argmax(explained))])


def _on_grid(grid: Floats, time: Floats, values: Floats) -> Floats:
    """Return columns (n, k) in deviations at the grid's times, zero outside the log."""
    found = np.stack([np.interp(grid, time, one) for one in values.T], axis=1)
    inside = (grid >= time[0]) & (grid <= time[-1])
    found -= found[inside].mean(axis=0) if inside.any() else 0.0
    return np.where(inside[:, None], found, 0.0) / np.maximum(found.std(axis=0), 1e-300)


class _Fit:
    """Residuals of the response over the lag, on displacements that all lags have loads for."""

    def __init__(self, logs: Logs, lags: tuple[float, float], step: float) -> None:
        low, high = min(lags) - 3 * step, max(lags) + 3 * step
        inside = (logs.when + low >= logs.time[0]) & (logs.when + high <= logs.time[-1])
        places = np.flatnonzero(inside)
        places = places[:: -(-len(places) // MOST) or 1]
        self.logs = logs._replace(when=logs.when[places], displacement=logs.displacement[places])
        self._scale, self._step = np.abs(logs.wrench).max(axis=0), step

    def _terms(self, lag: float) -> Floats:
        return terms_of(self._loads(lag) / self._scale)

    def _loads(self, lag: float) -> Floats:
        time, when = self.logs.time, self.logs.when + lag
        return np.stack([np.interp(when, time, one) for one in self.logs.wrench.T], axis=1)

    def residual(self, lag: float) -> Floats:
        """Return the mean square that each output's response leaves, (k,), of its variance."""
        return self._left(self._terms(lag), self.logs.displacement)

    def with_loop(self, lag: float) -> Floats:
        """Return `residual` of a response with one more term: the direction of the motion."""
        terms, y = self._terms(lag), self.logs.displacement
        after, before = self._loads(lag + self._step), self._loads(lag - self._step)
        found = np.linalg.lstsq(self._loads(lag), y, rcond=1e-9)[0]
        signs = np.sign((after - before) @ found)
        return np.concatenate(
            [
                self._left(np.column_stack((terms, sign)), one[:, None])
                for sign, one in zip(signs.T, y.T, strict=True)
            ]
        )

    def error(self, lag: float, step: float) -> float:
        """Return the error of the best lag, s, from the curvature of the residual."""
        least = self.residual(lag)
        sides = self.residual(lag - step), self.residual(lag + step)
        curvature = (sides[0] + sides[1] - 2 * least).clip(0.0) / step**2
        free = max(len(self.logs.when) - self._terms(lag).shape[1], 1)
        information = 0.5 * free * float((curvature / np.maximum(least, 1e-9)).sum())
        return float(DEVIATIONS / np.sqrt(information)) if information > 0 else np.inf

    def _left(self, terms: Floats, y: Floats) -> Floats:
        left = y - terms @ np.linalg.lstsq(terms, y, rcond=1e-9)[0]
        return np.asarray((left**2).mean(axis=0) / np.maximum((y**2).mean(axis=0), 1e-300))
