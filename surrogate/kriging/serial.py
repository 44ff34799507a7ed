"""Serial correlation of readings: consecutive readings whose errors are not independent.

Readings of a held load have the errors of its seating, friction and temperature in common. Rows of
two visits to one place of the loads have the same response, so half their squared differences are
noise alone: correlation of consecutive differences is none of the response or of its interpolation.
"""

from __future__ import annotations

import numpy as np

from ..table.polynomial import RANK, terms_of
from ..table.rows import Floats, LoadRange, Rows
from .readings import PLACE, Indices, positions_of, sessions_of

# Pairs of rows: fewer show no correlation below 0.6.
MIN_PAIRS = 30
# Standard deviations of the correlation of independent readings, 1 / sqrt(pairs): 99.9 %.
SURE = 3.3
# Part of the correlation that differences of consecutive rows of a visit must confirm: between the
# loads of a pair the response differs too, but by no more than from one row to the next.
MIN_CONFIRMED = 0.5


def dependence_of(rows: Rows, load_range: LoadRange) -> Floats:
    """Return the variance of a mean of readings over that of independent ones, (m,); 1 or more.

    The ratio is 1 + 2 sum(rho_k), with the correlation rho_k at a lag of k rows: of holds of n
    readings with a common error alone it is n, of a first-order autoregression
    (1 + rho) / (1 - rho). It is 1 where the correlation of consecutive rows is within that of
    independent readings, or where the loads visit no place twice.

    `rows`: measured rows in the order of their measurement, without outliers.
    """
    result = np.ones(rows.displacement.shape[1])
    loads = rows.wrench / load_range.scale
    session = sessions_of(rows)
    place = positions_of(loads, [np.flatnonzero(session == k) for k in np.unique(session)])
    first, second = _pairs(loads, place)
    if len(first) < MIN_PAIRS:
        return result
    terms = terms_of(loads, len(np.unique(place)))
    for output, moved in enumerate(rows.displacement.T):
        known = np.isfinite(moved)
        both = known[first] & known[second]
        if both.sum() < MIN_PAIRS:
            continue
        fit = np.linalg.lstsq(terms[known], moved[known], rcond=RANK)[0]
        off = moved - terms @ fit
        differences = (off[first] - off[second])[both]
        following = np.append(np.where(np.diff(place) == 0, off[1:], np.nan), np.nan)
        steps = (following - off)[first][both]  # NaN where the next row is of another visit
        result[output] = _dependence(differences, steps)
    return result


def _pairs(loads: Floats, place: Indices) -> tuple[Indices, Indices]:
    """Return pairs of rows at one place in two visits, (p,) each, the first ones ascending.

    A row is the first of one pair at most, and the second of one at most.

    `place` (n,): the first row of each row's visit.
    """
    cell = np.unique(np.round(loads / PLACE), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(cell, kind="stable")
    firsts, seconds = list[Indices](), list[Indices]()
    for rows in np.split(order, np.cumsum(np.bincount(cell))[:-1]):
        # The earlier half of a cell's rows and the later half, each in the order of its loads, so
        # that the loads of a pair are alike.
        half = len(rows) // 2
        for part, pairs in ((rows[:half], firsts), (rows[half : 2 * half], seconds)):
            pairs.append(part[np.argsort(loads[part].sum(axis=1), kind="stable")])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    apart = place[first] != place[second]
    first, second = first[apart], second[apart]
    ascending = np.argsort(first)
    return first[ascending], second[ascending]


def _dependence(differences: Floats, steps: Floats) -> float:
    """Return the ratio of `dependence_of` from the differences of pairs (p,), in order.

    `steps` (p,): change from the first row of each pair to the next; NaN if that is unknown.
    """
    count = len(differences)
    ratio = 1.0
    is_step = np.isfinite(steps)
    total = differences @ differences
    of_pairs = (differences[is_step] ** 2).sum()
    if is_step.sum() < MIN_PAIRS or not of_pairs:
        return ratio
    confirmed = 1 - (steps[is_step] ** 2).sum() / of_pairs
    for lag in range(1, count // 2):
        correlation = float(differences[lag:] @ differences[:-lag] / total)
        # At a lag beyond the correlation's length the estimate is chance.
        if correlation * np.sqrt(count) < (SURE if lag == 1 else 1.0):
            break
        if lag == 1 and confirmed < MIN_CONFIRMED * correlation:
            break
        ratio += 2 * correlation
    return ratio
