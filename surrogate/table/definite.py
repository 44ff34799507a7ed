"""Whether a part's compliance is positive definite, and the wrenches of a load range to ask it at.

A joint inverts the compliance: where that is not positive definite by an error of interpolation,
the part pulls the bodies apart instead of back. The design and the packed table both ask it here.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from .rows import Floats

INSIDE = 448  # wrenches inside the range: with its 64 corners they are answered in 5 ms
# Steps of an additive sequence that spreads points over a cube of six dimensions evenly: powers of
# the root of g^7 = g + 1 (Roberts 2018, the generalised golden ratio).
STEPS = 1.1127756842787055 ** -np.arange(1.0, 7.0)
# Of the largest diagonal element: a freedom with less is as stiff as one that is locked.
STIFFEST = 1e-12
# Of a compliance with a unit diagonal: an eigenvalue nearer to zero is rounding.
ROUNDING = 1e-9


def sample_of(ends: Floats, centre: Floats, places: NDArray[np.intp]) -> Floats:
    """Return the corners of a load range, shape (2, n), and wrenches within it, shape (m, n).

    Inputs at other places are those of `centre`, shape (n,).
    """
    (low, high), count = ends, len(places)
    corners = np.array(list(product((0.0, 1.0), repeat=count)))
    inside = np.mod(0.5 + np.outer(np.arange(INSIDE), STEPS[:count]), 1.0)
    loads = np.tile(centre, (len(corners) + INSIDE, 1))
    loads[:, places] = low[places] + np.vstack([corners, inside]) * (high - low)[places]
    return loads


def weakest(compliances: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return the least eigenvalue of each compliance, (k,), and its loads, (k, n), over `scale`.

    It is of the symmetric part with a unit diagonal: below zero the part moves against these loads,
    of which the largest is 1. NaN where a compliance, shape (n, n), is not known.
    """
    energy = compliances * np.outer(scale, scale)
    energy = 0.5 * (energy + energy.transpose(0, 2, 1))
    least = np.full(len(energy), np.nan)
    loads = np.full(energy.shape[:2], np.nan)
    known = np.isfinite(energy).all(axis=(1, 2))
    diagonal = np.abs(np.diagonal(energy[known], axis1=1, axis2=2))
    largest = np.maximum(diagonal.max(axis=1, keepdims=True, initial=0.0), np.finfo(float).tiny)
    size = np.sqrt(np.maximum(diagonal, STIFFEST * largest))
    values, vectors = np.linalg.eigh(energy[known] / (size[:, :, None] * size[:, None, :]))
    least[known] = np.where(np.abs(values[:, 0]) > ROUNDING, values[:, 0], 0.0)
    own = vectors[:, :, 0] / size
    top = np.take_along_axis(own, np.abs(own).argmax(axis=1)[:, None], axis=1)
    loads[known] = own / top
    return least, loads
