"""Straight direction influence with splines in place of triangulations."""

from __future__ import annotations

import numpy as np

from surrogate.bars.conformal import conformal_factor
from surrogate.bars.errorbar import FEWEST
from surrogate.spline import MOST, Spline
from surrogate.table.axes import AXES, AxisRows, axis_rows
from surrogate.table.compliance import ComplianceFit
from surrogate.table.rows import Floats, LoadRange, Rows

# Order and smoothing of the splines tried; the one with the smallest left-out errors is kept.
TRIED = ((5, 0.0), (3, 0.0), (3, 1e-2), (3, 1e-1))
INNER = 0.9  # of the points' extent: how far out a left-out row is still between others
STEP = 1e-4  # of scaled loads, for the slopes of the composition


class StraightSplines:
    """One spline per axis over its clean rows, composed as DESIGN's axes are.

    Attributes
    ----------
    splines : list of Spline or None, length 3
    orders : list of int, length 3
    bars : ndarray, shape (6,), m and rad
        What 95 % of the errors at rows left out of their axis stay below, of all that is composed.
    """

    def __init__(self, rows: Rows, load_range: LoadRange, fit: ComplianceFit, zero: Floats) -> None:
        """Fit the axes that have clean rows; `zero` is the displacement (6,) at no load."""
        self.zero, self.scale = np.array(zero), load_range.scale
        self.splines: list[Spline | None] = []
        self.orders: list[int] = []
        squares = np.zeros(6)
        for axis in AXES:
            chosen = axis_rows(rows, load_range, axis, fit, "exclude")
            spline = _best(chosen) if len(chosen.points) else None
            self.splines.append(spline)
            self.orders.append(spline.order if spline else 0)
            if spline is not None:
                squares[list(axis.outputs)] += _left_out_bars(spline) ** 2
        # Of each axis two rotations are composed: its own and that of its first moment alone.
        self.bars = np.sqrt(squares * np.repeat([1.0, 2.0], 3))

    def at(self, scaled: Floats) -> Floats:
        """Return displacements (n, 6), m and rad, at scaled wrenches (n, 6)."""
        moved = np.tile(self.zero, (len(scaled), 1))
        for axis, spline in zip(AXES, self.splines, strict=True):
            x = scaled[:, list(axis.inputs)]
            loaded = x.any(axis=1)
            if spline is None or not loaded.any():
                continue
            own = spline.at(x[loaded])
            moved[loaded, axis.outputs[0]] = own[:, 0]
            alone = spline.at(x[loaded] * np.array([0.0, 1.0, 0.0]))
            moved[loaded, 3:] += own[:, 1:] - alone[:, 1:]
        return moved

    def slopes(self, scaled: Floats) -> Floats:
        """Return the derivatives by scaled loads at scaled wrenches (n, 6), shape (n, 6, 6)."""
        slopes = np.empty((len(scaled), 6, 6))
        for load, step in enumerate(STEP * np.eye(6)):
            slopes[:, :, load] = (self.at(scaled + step) - self.at(scaled - step)) / (2 * STEP)
        return slopes


def _left_out_bars(spline: Spline) -> Floats:
    """Return what 95 % of a spline's left-out errors stay below, (q,), but for its outermost rows.

    Those were extrapolated, which no answer is.
    """
    far = np.abs(spline.points).max(axis=1, initial=0.0)
    inner = far <= INNER * far.max(initial=0.0)
    errors = np.abs(spline.left_out[inner] if inner.sum() >= FEWEST else spline.left_out)
    return conformal_factor(errors, np.ones_like(errors))


def _best(chosen: AxisRows) -> Spline:
    """Return the spline with the smallest errors at rows left out, over all four outputs."""
    outputs = list(chosen.axis.outputs)
    points, values = chosen.points, chosen.displacement[:, outputs]
    slopes = chosen.tangent[:, outputs]
    if len(points) > MOST:
        keep = np.random.default_rng(20170726).permutation(len(points))[:MOST]
        points, values, slopes = points[keep], values[keep], slopes[keep]
    if 4 * len(points) > MOST:
        slopes = np.full_like(slopes, np.nan)
    best, least = None, np.inf
    for order, smoothing in TRIED:
        if smoothing and len(points) * 3 > MOST:
            continue
        spline = Spline(points, values, slopes, order, smoothing)
        size = np.sqrt((spline.left_out**2).mean(axis=0))
        total = float(np.log(np.maximum(size, np.finfo(float).tiny)).sum())
        if best is None or total < least:
            best, least = spline, total
    assert best is not None
    return best
