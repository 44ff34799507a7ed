"""Rows of an axis predicted from the others: the errors that error bars are calibrated on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surrogate.interpolation.delaunay import Indices, Interpolant
from surrogate.interpolation.slope_recovery import bend_of
from surrogate.table.rows import Floats

# How many folds the points are drawn into, and how many of those are held out, by the number of
# points up to which it holds. What is predicted from two thirds of many points errs by as much,
# for the size of its simplex, as what is predicted from eleven twelfths, and each fold costs a
# triangulation.
FOLDS = ((1000, 12, 12), (5000, 6, 6), (20000, 3, 3), (float("inf"), 6, 1))
LEAVE_ONE_OUT = 24  # up to so many points each is held out alone


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
    shares : ndarray, shape (h, dimension + 1)
        Their barycentric weights.
    uncertainty : ndarray, shape (h, q)
        Stored uncertainty of the prediction.
    bends : ndarray, shape (h, q)
        What the slopes at those points say the error is.
    """

    places: Indices
    errors: Floats
    bubbles: Floats
    vertices: Indices
    shares: Floats
    uncertainty: Floats
    bends: Floats


def hold_out(
    interpolant: Interpolant,
    values: Floats,
    uncertainty: Floats,
    tangent: Floats,
    parts: int | None = None,
) -> HeldOut:
    """Predict each point of `interpolant` from triangulations without it.

    Few points are left out one at a time, many in folds drawn with a fixed seed; `parts` asks for
    another number of folds.
    """
    points, n = interpolant.points, len(interpolant.points)
    folds, done = next((folds, done) for most, folds, done in FOLDS if n <= most)
    if n <= LEAVE_ONE_OUT:
        folds = done = n
    if parts is not None:
        folds = done = parts
    fold_of = np.random.default_rng(20170726).permutation(n) % max(folds, 1)
    width = interpolant.dimension + 1
    found_in: list[tuple[Indices, Floats, Floats, Indices, Floats, Floats, Floats]] = [
        (
            np.empty(0, dtype=np.intp),
            np.empty((0, values.shape[1])),
            np.empty(0),
            np.empty((0, width), dtype=np.intp),
            np.empty((0, width)),
            np.empty((0, values.shape[1])),
            np.empty((0, values.shape[1])),
        )
    ]
    for fold in range(done if n > width else 0):
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
        bends = bend_of(reduced, values[rest], tangent[rest], found, shares)
        found_in.append(
            (places, values[places] - predicted, bubbles, vertices, shares, doubt, bends)
        )
    return HeldOut(*(np.concatenate(part) for part in zip(*found_in, strict=True)))
