"""Errors of measured rows that their mean hides: hysteresis, drift, readings in two branches.

More rows do not lower them, and a mean of both branches lies on neither. So error bars have a part
of their own for them, and coverage does not depend on it, as for the discretisation error.
"""

from __future__ import annotations

import math

import numpy as np

from .findings.find import looked_at
from .findings.response import response_of
from .findings.sequence import FEWEST, sequence_errors
from .findings.single_rows import wrong_rows
from .table.merging import repeated
from .table.rows import Floats, LoadRange, Rows

NORMAL = 3.0  # kurtosis of noise; that of two branches is 1, and 1.8 where their distance varies


def rig_error(rows: Rows, load_range: LoadRange) -> Floats:
    """Return how far from an answer the part may be besides, (6,), m and rad.

    A loop of hysteresis and a drift, as the order of the rows shows them, or the distance of two
    branches of readings at one wrench. The whole of each: along a motion answers follow the branch
    that was measured there, and the part may be on the other one.

    Parameters
    ----------
    rows : Rows
        Of one version of a table, in ascending order of `seq`; solved ones show nothing.
    """
    none = np.zeros(rows.displacement.shape[1])
    if not rows.space.is_default:  # the order of rows is looked at for one interface alone
        return none
    measured = (rows.source != "fea") & ~np.isfinite(rows.compliance).all(axis=(1, 2))
    some = rows.take(measured & load_range.holds(rows.wrench))
    if len(some) < FEWEST:
        return none
    some = looked_at(some)
    response = response_of(some, load_range)
    wrong, good = wrong_rows(some, load_range, response).any(axis=1), some
    if wrong.any():
        good = some.take(~wrong)
        if len(good) < FEWEST:
            return none
        response = response_of(good, load_range)
    found = sequence_errors(good, response, probable=True)
    return np.maximum(np.abs(found.drift) + found.loop, 2 * branches(good, load_range))


def error_of_a_reading(error: Floats, interpolation: Floats, noise: Floats) -> Floats:
    """Return the error bars of one more reading at a wrench, (6,), m and rad.

    Parameters
    ----------
    error, interpolation, noise : ndarray, shape (6,), m and rad
        The answer's error, its part by interpolation, and the 95 % noise of one reading.
    """
    return error - interpolation + np.hypot(interpolation, noise)


def branches(rows: Rows, load_range: LoadRange) -> Floats:
    """Return the deviation of readings of one wrench where it is no noise, (6,), m and rad.

    Noise is normal: its kurtosis is 3, and shows to sqrt(24 / n) in n readings besides the first of
    each wrench. Readings in two branches are all as far from their mean.
    """
    outputs = rows.displacement.shape[1]
    groups, found = repeated(rows, load_range), np.zeros(outputs)
    for output in range(outputs):
        moved = rows.displacement[:, output]
        measured = np.isfinite(moved)
        readings = [moved[places][measured[places]] for places in groups]
        several = [own for own in readings if len(own) > 1]
        deviations = np.concatenate([np.empty(0), *(own - own.mean() for own in several)])
        square = float((deviations**2).mean()) if several else 0.0
        if square <= 0:
            continue
        kurtosis = float((deviations**4).mean()) / square**2
        if kurtosis + 2 * math.sqrt(24 / (len(deviations) - len(several))) < NORMAL:
            found[output] = math.sqrt(square)
    return found
