"""Error bars of an axis, calibrated on the table itself.

Rows are held out in turn and predicted from the rest. The slopes at the rows say what error to
expect, with its sign: the bend (slopes.py), of which each output takes the share that explains its
held-out errors best. For the rest, linear interpolation errs by curvature times the bubble
b(x) = sum_i lambda_i |v_i - x|^2, which is zero at the vertices; noise errs alike everywhere, and
a kink where the bend is large. So the bar is

    |bend(x)| + flat(x) + curvature(x) * b(x) + bending * |bend(x)| + sum_i lambda_i uncertainty_i

with `flat` and `curvature` given at the rows, linear between them, and blended from the held-out
errors at each row, around it, and of the whole axis. Several blends are tried; each is scaled so
that it would have covered 95 % of the held-out errors (split conformal prediction: Vovk et al.
2005, Lei et al. 2018), and the one with the narrowest bars is kept.

Where the bend explains nothing and the rows are not repeatable solves, the held-out errors are the
rows' own noise. Then they hold the noise of the held-out row besides that of the answer, and the
bar of the answer is the smaller for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surrogate.bars.conformal import conformal_factor
from surrogate.bars.heldout import HeldOut, hold_out
from surrogate.interpolation.delaunay import Indices, Interpolant
from surrogate.table.rows import Floats

# Noise of unit variance in each row leaves a variance of sum_i lambda_i^2 in an answer, and one
# more in a held-out error. `NOISY` is the part of their variance that the bend leaves unexplained,
# from where on they start to be taken for noise and where they are.
NOISY = (0.75, 0.9)
MARGIN = 1.08  # an answer reads parts of several simplices, whose errors go together a little
CARE = 1.05  # what is taken for noise may be a little of curvature
NEARLY = 0.2
BENT = (0.3, 1.3)  # below which share a bend explains nothing, and the most that is taken of it
FEWEST = 5  # held-out errors below which nothing can be calibrated
TINY = np.finfo(float).tiny

# Shares of six indicators: curvature at the row, around it, of the whole axis; flat error at the
# row, of the whole axis; and the median error, a floor that keeps a bar from being nothing where
# two rows happen to agree.
AT_ROWS = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.1],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.1],
        [0.0, 0.5, 0.5, 0.0, 0.0, 0.1],
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.1],
        [0.5, 0.0, 0.0, 0.5, 0.0, 0.1],
        [0.0, 0.5, 0.0, 0.5, 0.0, 0.1],
        [0.0, 0.5, 0.0, 0.0, 0.5, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.5, 0.0],
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.1],
        [0.0, 0.0, 0.0, 0.5, 0.5, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    ]
)
# A seventh, the size of the bend itself, is tried with each of them.
BLENDS = np.concatenate([np.insert(AT_ROWS, 6, bend, axis=1) for bend in (0.0, 0.3, 1.0, 3.0)])
CURVED = 3  # so many of the shares go with the bubble, the next are flat
ROWS_OWN = 6


@dataclass(frozen=True)
class RowBars:
    """The calibrated part of the error bars of one interpolant, at its n points.

    Attributes
    ----------
    flat : ndarray, shape (n, q), in the outputs' units
    curvature : ndarray, shape (n, q), in the outputs' units
        Multiplies the bubble, which is dimensionless because inputs are scaled.
    held_out : int
        How many held-out errors stand behind them; 0 if there were too few to calibrate.
    signed : ndarray, shape (n, q), in the outputs' units
        Held-out error, true less predicted, that the bend leaves; 0 where a point could not be
        predicted.
    bend : ndarray, shape (q,)
        The share of the bend that is taken for the error; 0 where it explains none of it.
    bending : ndarray, shape (q,)
        The bar's part per size of that share.
    noise : ndarray, shape (q,), in the outputs' units
        95 % half width of the rows' own noise, as far as the rows show it.
    missing : ndarray, shape (q,)
        The part of held-out errors, root mean square, that the bend leaves; 0 if that is noise.
    """

    flat: Floats
    curvature: Floats
    held_out: int
    signed: Floats
    bend: Floats
    bending: Floats
    noise: Floats
    missing: Floats


def calibrate(
    interpolant: Interpolant,
    values: Floats,
    uncertainty: Floats,
    tangent: Floats,
    *,
    repeatable: bool = False,
) -> RowBars:
    """Return error bars for linear interpolation of vertex values, shape (n, q).

    Parameters
    ----------
    tangent : ndarray, shape (n, q, 3)
        Slopes stored with the rows; NaN where unknown.
    repeatable : bool
        Whether the rows are solves, which have no noise.
    """
    held = hold_out(interpolant, values, uncertainty, tangent)
    if len(held.places) < FEWEST:
        return _uncalibrated(interpolant, values)
    stored = bool(np.isfinite(tangent).any())
    bend, unexplained = _bend_share(held, exact=stored)
    errors = held.errors - bend * held.bends
    # What stored uncertainty explains already is not counted twice.
    excess = np.maximum(np.abs(errors) - held.uncertainty, 0.0)
    indicators = _indicators(interpolant.simplices, held, excess, len(values))
    parts = np.einsum("hi,hipq->hpq", held.shares, indicators[held.vertices])
    parts[:, :CURVED] *= held.bubbles[:, None, None]
    parts = np.concatenate((parts, np.abs(bend * held.bends)[:, None]), axis=1)
    shares, factor = _best_blend(excess, parts)
    noise = np.zeros(len(bend))
    if not repeatable:
        left, noise = _noise(held, unexplained)
        factor = factor * left
    factor = factor * MARGIN
    mixed = factor * shares[:, :ROWS_OWN].T * indicators
    signed = np.zeros_like(values)
    signed[held.places] = errors
    flat, curvature = mixed[:, CURVED:].sum(axis=1), mixed[:, :CURVED].sum(axis=1)
    bending = factor * shares[:, ROWS_OWN]
    missing = np.where((noise > 0) | (bend == 0), 0.0, np.sqrt(unexplained))
    signed[:, noise > 0] = 0.0
    return RowBars(flat, curvature, len(held.places), signed, bend, bending, noise, missing)


def _bend_share(held: HeldOut, *, exact: bool) -> tuple[Floats, Floats]:
    """Return, per output, the share of the bend to take, and the unexplained part of variance.

    Of exact slopes all of it is taken if it nearly is: the least-squares share, some per cent off,
    would leave as much of the second-order error.
    """
    size = (held.bends**2).sum(axis=0)
    share = (held.errors * held.bends).sum(axis=0) / np.maximum(size, TINY)
    share = np.where(share < BENT[0], 0.0, np.minimum(share, BENT[1]))
    share[size < TINY] = 0.0
    if exact:
        share[np.abs(share - 1.0) < NEARLY] = 1.0
    left = ((held.errors - share * held.bends) ** 2).sum(axis=0)
    return share, left / np.maximum((held.errors**2).sum(axis=0), TINY)


def _noise(held: HeldOut, unexplained: Floats) -> tuple[Floats, Floats]:
    """Return, per output, what of a held-out error an answer's error has, and the rows' noise."""
    if not held.bends.any():  # no slopes, so that nothing tells noise from curvature
        return np.ones(len(unexplained)), np.zeros(len(unexplained))
    answer = float((held.shares**2).sum(axis=1).mean())
    part = np.clip((unexplained - NOISY[0]) / (NOISY[1] - NOISY[0]), 0.0, 1.0)
    size = np.sqrt((held.errors**2).mean(axis=0) / (1.0 + answer))
    left = CARE * math.sqrt(answer / (1.0 + answer))
    return 1.0 - part * (1.0 - left), 2.0 * part * size


def _indicators(simplices: Indices, held: HeldOut, excess: Floats, n: int) -> Floats:
    """Return the six indicators of the held-out errors (h, q) at all n points, shape (n, 6, q).

    A curvature is the regression of errors on bubbles: at a point, leaning on one typical point of
    the whole axis; around it, over all simplices that meet there; over the whole axis.
    """
    q = excess.shape[1]
    products, squares, errors, known = np.zeros((n, q)), np.zeros(n), np.zeros((n, q)), np.zeros(n)
    products[held.places] = excess * held.bubbles[:, None]
    squares[held.places] = held.bubbles**2
    errors[held.places], known[held.places] = excess, 1.0
    weight = max(float(np.mean(held.bubbles**2)), TINY)
    slope = products.sum(axis=0) / max(squares.sum(), TINY)
    typical = np.sqrt((excess**2).mean(axis=0))
    around = _around(simplices, np.column_stack((products, squares)))
    parts = np.empty((n, 6, q))
    parts[:, 0] = (products + weight * slope) / (squares + weight)[:, None]
    parts[:, 1] = (around[:, :q] + weight * slope) / (around[:, q:] + weight)
    parts[:, 2] = slope
    parts[:, 3] = (errors + typical) / (known + 1)[:, None]
    parts[:, 4] = typical
    parts[:, 5] = np.median(excess, axis=0)
    return parts


def _around(simplices: Indices, values: Floats) -> Floats:
    """Return the sum of vertex values (n, p) over the simplices that meet at each vertex."""
    sums = values[simplices].sum(axis=1)
    total = np.zeros_like(values)
    for corner in simplices.T:
        np.add.at(total, corner, sums)
    return total


def _best_blend(excess: Floats, parts: Floats) -> tuple[Floats, Floats]:
    """Return, per output, the shares (q, 7) and the factor (q,) with the narrowest bars."""
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
        factors[better] = factor[better]
    return shares, factors


def _middle(bars: Floats) -> Floats:
    """Return the geometric mean of bars, shape (h, q) -> (q,): no few wide ones decide."""
    return np.exp(np.log(np.maximum(bars, TINY)).mean(axis=0))


def _uncalibrated(interpolant: Interpolant, values: Floats) -> RowBars:
    """Return bars for a table too small to calibrate: what the outputs vary over its simplices.

    Where there is but one point, its own size.
    """
    flat = np.abs(values) if interpolant.dimension == 0 else np.zeros_like(values)
    spread = np.ptp(values[interpolant.simplices], axis=1)
    for corner in interpolant.simplices.T:
        np.maximum.at(flat, corner, spread)
    none = np.zeros(values.shape[1])
    return RowBars(flat, np.zeros_like(flat), 0, np.zeros_like(flat), none, none, none, none)
