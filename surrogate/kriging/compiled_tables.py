"""What the compiled answer reads: a dense kriging as contiguous arrays, in scaled numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .correlation import PLACES
from .dense import Dense
from .equations import OUTPUTS, Scaling


class Tables(NamedTuple):
    """What the compiled answer reads: contiguous, in scaled numbers.

    Few arrays, since each costs a tenth of a microsecond to hand over.

    Attributes
    ----------
    x : ndarray, shape (6, n)
    terms : ndarray, shape (4, 7)
        The covariance's terms: inverse squared lengths, and the weight.
    weights : ndarray, shape (7 n, 6)
        Of all rows' values, then of all their slopes by the first load, and so on.
    coefficients : ndarray, shape (7, 6)
        The mean.
    number : ndarray of int, shape (n,)
        Which of the k neighbourhoods is each row's.
    places : ndarray of int, shape (k, e)
        Of each neighbourhood: where its equations stand among the 7 n.
    columns : ndarray, shape (k, e, e)
        Its T, column after column; zero beyond its equations.
    unsettled : ndarray, shape (k, e, 7)
        Its TF.
    least : ndarray, shape (n,)
        Smallest sigma squared, but for the mean's; infinite for a row without a neighbourhood.
    mean_covariance : ndarray, shape (7, 7)
    scales : ndarray, shape (6, 6)
        Centre and rate of the loads, which are scaled to (wrench - centre) rate (the rate of a load
        that takes no part is 0); offset, spread, process deviation of the outputs, m and rad, and
        what these lose to rounding.
    sigma : ndarray, shape (k,)
        Process deviations of the calibration, ascending; then the largest with known errors.
    factors : ndarray, shape (k, 6)
        What a deviation of `sigma` is multiplied by.
    span : ndarray, shape (2, 6)
        Ends of the scaled loads between which errors are known.
    floor : float
        Smallest bar, of an answer's size.
    tangent : ndarray, shape (6, 6), SI
        Added to the derivative: the columns of loads that take no part.
    """

    x: Floats
    terms: Floats
    weights: Floats
    coefficients: Floats
    number: NDArray[np.int64]
    places: NDArray[np.int64]
    columns: Floats
    unsettled: Floats
    least: Floats
    mean_covariance: Floats
    scales: Floats
    sigma: Floats
    factors: Floats
    span: Floats
    floor: float
    tangent: Floats


def tables_of(inside: Dense, scaling: Scaling, tangent: Floats, floor: float) -> Tables | None:
    """Return the tables of a dense kriging, or None where its outputs do not share one factor.

    `tangent` has shape (6, 6), SI.
    """
    if len(inside.shares) != 1:
        return None
    share, n = inside.shares[0], len(inside.equations)
    most = max(len(local.places) for local in share.around)
    count, number, least = len(share.around), np.zeros(n, dtype=np.int64), np.full(n, np.inf)
    places = np.zeros((count, most), dtype=np.int64)
    columns, unsettled = np.zeros((count, most, most)), np.zeros((count, most, PLACES))
    for place, (row, local) in enumerate(zip(share.anchors, share.around, strict=True)):
        size = len(local.places)
        at_row, of_row = np.divmod(local.places, PLACES)
        places[place, :size] = of_row * n + at_row
        columns[place, :size, :size], unsettled[place, :size] = local.T.T, local.TF
        number[row], least[row] = place, local.least
    rates, weights = inside.held.terms
    rate = np.where(scaling.active, 1 / scaling.half, 0.0)
    deviation, found = inside.deviation * scaling.spread, inside.calibrations[0]
    factors = np.zeros((len(found.sigma), OUTPUTS))
    factors[:, share.factor.outputs] = found.factors
    lost = inside.rounding * scaling.spread
    return Tables(
        x=np.ascontiguousarray(inside.equations.x.T),
        terms=np.concatenate((rates, weights[:, None]), axis=1),
        weights=inside.weights.transpose(1, 0, 2).reshape(-1, OUTPUTS).copy(),
        coefficients=np.ascontiguousarray(inside.coefficients),
        number=number,
        places=places,
        columns=columns,
        unsettled=unsettled,
        least=least,
        mean_covariance=np.ascontiguousarray(share.factor.mean_covariance),
        scales=np.stack((scaling.centre, rate, scaling.offset, scaling.spread, deviation, lost)),
        sigma=np.append(found.sigma, found.reach),
        factors=factors,
        span=inside.span,
        floor=floor,
        tangent=np.where(scaling.active, 0.0, tangent),
    )
