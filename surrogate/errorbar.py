"""Error bars of an axis, calibrated on the table itself.

Rows are held out in turn and predicted from the rest. Linear interpolation errs by curvature times
the bubble b(x) = sum_i lambda_i |v_i - x|^2, which is zero at the vertices; noise and kinks err
alike everywhere. So the bar of a simplex is

    bar(x) = flat + curvature * b(x) + sum_i lambda_i uncertainty_i

with `flat` and `curvature` blended from the held-out errors at the simplex' own vertices and those
of the whole axis. Several blends are tried; each is scaled so that it would have covered 95 % of
the held-out errors (split conformal prediction: Vovk et al. 2005, Lei et al. 2018), and the one
with the narrowest bars is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrogate.interpolant import Indices, Interpolant
from surrogate.rows import Floats

LEVEL = 0.95
# Where errors are alike everywhere they are noise, and a held-out error holds the noise of the
# held-out row besides that of the answer: then this level covers well over 95 % of the answer's.
NOISE_LEVEL = 0.92
FOLDS = 12
LEAVE_ONE_OUT = 48  # up to so many points each is held out alone
FEWEST = 5  # held-out errors below which nothing can be calibrated
CAUTION = 6.0  # a quantile of h errors is enlarged by this over h

# Shares of (own curvature, local curvature, global curvature, local flat, global flat, floor):
# "own" is of a simplex' vertices alone, "local" leans on the whole axis as well, and the floor, the
# median error, keeps a bar from being nothing where two rows happen to agree.
BLENDS = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.1],
        [0.5, 0.0, 0.0, 0.5, 0.0, 0.1],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.1],
        [0.0, 0.5, 0.5, 0.0, 0.0, 0.1],
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.1],
        [0.0, 0.5, 0.0, 0.5, 0.0, 0.1],
        [0.0, 0.5, 0.0, 0.0, 0.5, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.5, 0.0],
        [0.0, 0.25, 0.25, 0.25, 0.25, 0.0],
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.1],
        [0.0, 0.0, 0.0, 0.5, 0.5, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    ]
)
CURVED = 3  # so many of the shares go with the bubble, the others are flat


@dataclass(frozen=True)
class SimplexBars:
    """The calibrated part of the error bars of one interpolant.

    Attributes
    ----------
    flat : ndarray, shape (m, q), in the outputs' units
    curvature : ndarray, shape (m, q), in the outputs' units
        Multiplies the bubble, which is dimensionless because inputs are scaled.
    held_out : int
        How many held-out errors stand behind them; 0 if there were too few to calibrate.
    lean : ndarray, shape (m, q), in the outputs' units
        Held-out error (true less predicted) largest in size at each simplex' vertices.
    """

    flat: Floats
    curvature: Floats
    held_out: int
    lean: Floats


@dataclass(frozen=True)
class HeldOut:
    """Errors at points predicted from the others; only points inside the others' hull.

    Attributes
    ----------
    places : ndarray of int, shape (h,)
    errors : ndarray, shape (h, q)
        True less predicted.
    bubbles : ndarray, shape (h,)
    vertices : ndarray of int, shape (h, dimension + 1)
        The points each was predicted from.
    uncertainty : ndarray, shape (h, q)
        Stored uncertainty of the prediction.
    """

    places: Indices
    errors: Floats
    bubbles: Floats
    vertices: Indices
    uncertainty: Floats


def hold_out(interpolant: Interpolant, values: Floats, uncertainty: Floats) -> HeldOut:
    """Predict each point of `interpolant` from triangulations without it.

    Few points are left out one at a time, many in folds drawn with a fixed seed.
    """
    points, n = interpolant.points, len(interpolant.points)
    folds = n if n <= LEAVE_ONE_OUT else FOLDS
    fold_of = np.random.default_rng(20170726).permutation(n) % max(folds, 1)
    width = interpolant.dimension + 1
    parts: list[tuple[Indices, Floats, Floats, Indices, Floats]] = [
        (
            np.empty(0, dtype=np.intp),
            np.empty((0, values.shape[1])),
            np.empty(0),
            np.empty((0, width), dtype=np.intp),
            np.empty((0, values.shape[1])),
        )
    ]
    for fold in range(folds if n > width else 0):
        rest = np.flatnonzero(fold_of != fold)
        reduced = Interpolant(points[rest])
        if reduced.dimension != interpolant.dimension:
            continue
        places = np.flatnonzero(fold_of == fold)
        found = reduced.locate(points[places])
        places, found = places[found >= 0], found[found >= 0]
        shares = reduced.barycentric(found, points[places])
        vertices = rest[reduced.simplices[found]]
        predicted = np.einsum("ki,kiq->kq", shares, values[vertices])
        doubt = np.einsum("ki,kiq->kq", np.abs(shares), uncertainty[vertices])
        bubbles = np.maximum(reduced.bubbles(found, points[places]), 0.0)
        parts.append((places, values[places] - predicted, bubbles, vertices, doubt))
    return HeldOut(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def calibrate(interpolant: Interpolant, values: Floats, uncertainty: Floats) -> SimplexBars:
    """Return error bars for linear interpolation of vertex values, shape (n, q)."""
    held = hold_out(interpolant, values, uncertainty)
    count = len(held.places)
    if count < FEWEST:
        return _uncalibrated(interpolant, values)
    # What stored uncertainty explains already is not counted twice.
    excess = np.maximum(np.abs(held.errors) - held.uncertainty, 0.0)
    indicators = _Indicators.of(held, excess, len(values))
    parts = indicators.parts(held.vertices)
    parts[:, :CURVED] *= held.bubbles[:, None, None]
    shares, factor = _best_blend(excess, parts)
    deployed = indicators.parts(interpolant.simplices)
    mixed = factor * shares.T * deployed
    lean = _lean(held, interpolant.simplices, len(values))
    return SimplexBars(mixed[:, CURVED:].sum(axis=1), mixed[:, :CURVED].sum(axis=1), count, lean)


def _lean(held: HeldOut, vertices: Indices, n: int) -> Floats:
    """Return the held-out error largest in size, with its sign, at each simplex' vertices."""
    signed = np.zeros((n, held.errors.shape[1]))
    signed[held.places] = held.errors
    corners = signed[vertices]
    low, high = corners.min(axis=1), corners.max(axis=1)
    return np.where(high > -low, high, low)


def conformal_factor(errors: Floats, bars: Floats, level: float = LEVEL) -> Floats:
    """Return, per column, the factor on bars (h, q) that covers a level of the errors (h, q).

    The quantile of their ratios is taken at ceil(level (h + 1)) of h, the largest if h is too
    small for that, and enlarged the more, the fewer there are. It is infinite if too many bars are
    zero where errors are not.
    """
    ratios = np.full(errors.shape, np.inf)
    np.divide(errors, bars, out=ratios, where=bars > 0)
    ratios[errors == 0] = 0.0
    count = len(ratios)
    if not count:
        return np.zeros(errors.shape[1])
    rank = min(math.ceil(level * (count + 1)), count) - 1
    return np.partition(ratios, rank, axis=0)[rank] * (1 + CAUTION / count)


@dataclass(frozen=True)
class _Indicators:
    """Held-out errors and bubbles gathered at the points, ready to be averaged over simplices."""

    known: Floats  # (n,) 1 where the point was predicted
    errors: Floats  # (n, q)
    products: Floats  # (n, q) error times bubble
    squares: Floats  # (n,) bubble squared
    slope: Floats  # (q,) regression of errors on bubbles, whole axis
    typical: Floats  # (q,) root mean square error, whole axis
    median: Floats  # (q,) median error, whole axis
    weight: float  # of the whole axis in the local regression: one typical point

    @classmethod
    def of(cls, held: HeldOut, excess: Floats, n: int) -> _Indicators:
        known, squares = np.zeros(n), np.zeros(n)
        errors, products = np.zeros((n, excess.shape[1])), np.zeros((n, excess.shape[1]))
        known[held.places] = 1.0
        squares[held.places] = held.bubbles**2
        errors[held.places] = excess
        products[held.places] = excess * held.bubbles[:, None]
        weight = float(np.mean(held.bubbles**2))
        slope = products.sum(axis=0) / max(squares.sum(), np.finfo(float).tiny)
        typical = np.sqrt((excess**2).mean(axis=0))
        median = np.median(excess, axis=0)
        return cls(known, errors, products, squares, slope, typical, median, weight)

    def parts(self, vertices: Indices) -> Floats:
        """Return the six indicators over groups of vertices, shape (k, d + 1) -> (k, 6, q)."""
        known = self.known[vertices].sum(axis=1)
        rise, run = self.products[vertices].sum(axis=1), self.squares[vertices].sum(axis=1)
        least = np.finfo(float).tiny
        parts = np.empty((len(vertices), 6, len(self.slope)))
        parts[:, 0] = np.where(run[:, None] > 0, rise / np.maximum(run, least)[:, None], self.slope)
        parts[:, 1] = rise + self.weight * self.slope
        parts[:, 1] /= np.maximum(run + self.weight, least)[:, None]
        parts[:, 2] = self.slope
        parts[:, 3] = (self.errors[vertices].sum(axis=1) + self.typical) / (known + 1)[:, None]
        parts[:, 4] = self.typical
        parts[:, 5] = self.median
        return parts


def _best_blend(excess: Floats, parts: Floats) -> tuple[Floats, Floats]:
    """Return, per output, the shares (q, 6) and the factor (q,) with the narrowest bars."""
    q = excess.shape[1]
    best = np.full(q, np.inf)
    shares, factors = np.tile(BLENDS[-1], (q, 1)), np.zeros(q)
    for blend in BLENDS:
        bars = np.einsum("p,hpq->hq", blend, parts)
        factor = conformal_factor(excess, bars)
        with np.errstate(invalid="ignore"):  # infinite times zero is no candidate either
            width = _middle(factor * bars)
        better = width < best
        best = np.where(better, width, best)
        shares[better] = blend
        if not blend[:CURVED].any():
            factor = conformal_factor(excess, bars, NOISE_LEVEL)
        factors[better] = factor[better]
    return shares, factors


def _middle(bars: Floats) -> Floats:
    """Return the geometric mean of bars, shape (h, q) -> (q,): no few wide ones decide."""
    return np.exp(np.log(np.maximum(bars, np.finfo(float).tiny)).mean(axis=0))


def _uncalibrated(interpolant: Interpolant, values: Floats) -> SimplexBars:
    """Return bars for a table too small to calibrate: what the outputs vary over the simplex.

    Where there is but one point, its own size.
    """
    corners: NDArray[np.float64] = values[interpolant.simplices]
    flat = np.ptp(corners, axis=1) if interpolant.dimension else np.abs(corners[:, 0])
    return SimplexBars(flat, np.zeros_like(flat), 0, np.zeros_like(flat))
