"""Measured rows prepared to estimate their effects: sessions, places of loads, and the response."""

from __future__ import annotations

from dataclasses import replace
from operator import sub
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.polynomial import RANK, terms_of
from ..table.rows import Floats, LoadRange, Rows

Indices = NDArray[np.intp]

# 300 rows show effects to an eighth of the noise of a reading, in a third of a second.
MAX_ROWS = 300
# Sessions with effects of their own, those with the most rows; all others count as one session.
MAX_SESSIONS = 8
# Part of a session's squared response that no cubic of each load may explain. With a smaller part,
# the scale may be the part's own response, as of tension in one session and compression in another.
# A straight line explains the whole response where a single session loads an axis: no other session
# has a scale to compare.
MIN_UNEXPLAINED = 0.1
# Half ranges: loads that differ by less are one place, and readings at one place show no direction.
# Force sensors scatter by 1e-4 to 5e-3 of their range.
PLACE = 0.02


class Readings(NamedTuple):
    """Measured rows (n), in the order of their measurement, prepared to estimate effects."""

    rows: Rows  # loads and displacements are the means at the row's place: see `positions_of`
    good: Indices  # (k,): the rows that show effects, one for each place, `MAX_ROWS` at most
    middle: Floats  # (n, 2 s): time in the session, then session; both about their means
    extent: Floats  # (n, m): see `_extent`
    terms: Floats  # (n, t): terms of a polynomial of the loads
    steps: Floats  # (n, t): their change from the place before; 0 at the first of a session
    # (s, m): whether the session's response is no cubic of each load, and no straight line: its
    # scale can then be separated from the part's response, and other sessions load the same
    is_identifiable: NDArray[np.bool_]
    is_shared: NDArray[np.bool_]
    scaled: Floats  # (n, m), dimensionless: the response over its largest value
    largest: Floats  # (m,), m and rad: that value

    @classmethod
    def of(cls, rows: Rows, load_range: LoadRange, good: Indices) -> Readings:
        """Return the readings of rows; `good` are the indices of rows without outliers."""
        session = sessions_of(rows)
        count = int(session.max(initial=0)) + 1
        members = [np.flatnonzero(session == number) for number in range(count)]
        middle = np.zeros((len(rows), 2 * count))
        for number, of_session in enumerate(members):
            middle[of_session, number] = np.linspace(-0.5, 0.5, len(of_session))
            middle[of_session, count + number] = count > 1
        middle[:, count:] -= middle[:, count:].mean(axis=1, keepdims=True)

        loads = rows.wrench / load_range.scale
        place = positions_of(loads, members)
        good, loads, moved = _means_at_positions(loads, rows.displacement, good, place)
        extent = _extent(moved, good, session)
        if len(good) > MAX_ROWS:
            good = np.sort(np.random.default_rng(0).choice(good, MAX_ROWS, replace=False))

        terms = terms_of(loads, len(np.unique(place)))
        scaled, largest = _response(terms, moved, good)
        of_sessions = (session[good] == np.arange(count)[:, None])[:, :, None] * scaled[good]
        cubic = _is_no_polynomial(of_sessions, loads[good], 3)
        straight = _is_no_polynomial(of_sessions, loads[good], 1)
        steps = terms.copy()
        for of_session in members:
            first = np.unique(place[of_session])
            steps[first[1:]] -= steps[first[:-1]]
            steps[first[:1]] = 0.0
        steps = steps[place]  # a load that stays at its place keeps its branch
        rows = replace(rows, wrench=loads * load_range.scale, displacement=moved)
        return cls(rows, good, middle, extent, terms, steps, cubic, straight, scaled, largest)


def sessions_of(rows: Rows) -> Indices:
    """Return the number of each row's session, (n,): the rows of one import and one source.

    The sessions of the most rows, up to `MAX_SESSIONS`, have a number of their own; all other rows,
    and sessions of a single row, share one.
    """
    session = np.unique(rows.session, return_inverse=True)[1]
    if len(rows) and (rows.source != rows.source[0]).any():
        source = np.unique(rows.source, return_inverse=True)[1]
        session = session * (source.max() + 1) + source
    _, index, counts = np.unique(session, return_inverse=True, return_counts=True)
    largest = np.argsort(-counts, kind="stable")[:MAX_SESSIONS]
    number = np.full(len(counts), -1)
    number[largest[counts[largest] > 1]] = largest[counts[largest] > 1]
    return np.unique(number[index], return_inverse=True)[1]


def positions_of(loads: Floats, sessions: list[Indices]) -> Indices:
    """Return, for each row, the first row at the place of its load, (n,).

    A load leaves its place where it is farther than `PLACE` from the first load there.

    `loads` (n, 6), half ranges, in the order of the measurement.
    `sessions`: the indices of each session's rows.
    """
    place = np.arange(len(loads))
    for rows in sessions:
        moved_on = np.abs(np.diff(loads[rows], axis=0)).max(axis=1, initial=0.0) > 2 * PLACE
        points = loads[rows].tolist()
        first = 0
        for at, is_far in enumerate(moved_on.tolist(), 1):
            if is_far or max(map(abs, map(sub, points[at], points[first]))) > PLACE:
                first = at
            place[rows[at]] = rows[first]
    return place


def _means_at_positions(
    loads: Floats, moved: Floats, good: Indices, place: Indices
) -> tuple[Indices, Floats, Floats]:
    """Return the first row of each place with good rows, loads (n, 6) and displacements (n, m).

    At these rows, good or not, loads and displacements are the mean over the good rows of the
    place; all other rows are unchanged. Further readings at a place show the noise alone; counted
    as rows of their own they would make effects seem surer.

    `good` (k,): indices of the rows that the means are made of.
    `place` (n,): see `positions_of`.
    """
    number = np.unique(place[good], return_inverse=True)[1]
    first = np.unique(place[good])
    means = []
    for values in (loads, moved):
        known = np.isfinite(values[good])
        sums, counts = np.zeros((2, len(first), values.shape[1]))
        np.add.at(sums, number, np.where(known, values[good], 0.0))
        np.add.at(counts, number, known)
        mean = values.copy()
        mean[first] = np.where(counts > 0, sums / np.maximum(counts, 1.0), np.nan)
        means.append(mean)
    return first, means[0], means[1]


def _extent(moved: Floats, good: Indices, session: Indices) -> Floats:
    """Return the range of each output in a row's session, (n, m), over that of its widest session.

    A loop is in proportion to it: in a test along an axis that moves an output little, friction
    moves the output little too.
    """
    ranges = np.zeros((session.max(initial=0) + 1, moved.shape[1]))
    for number in np.unique(session[good]):
        of_session = np.ma.masked_invalid(moved[good[session[good] == number]])
        ranges[number] = np.ma.filled(np.ma.ptp(of_session, axis=0), 0.0)
    widest = ranges.max(axis=0)
    return (ranges / np.where(widest > 0.0, widest, 1.0))[session]


def _response(terms: Floats, moved: Floats, good: Indices) -> tuple[Floats, Floats]:
    """Return the response without its value at zero load, scaled, and its largest value.

    The response is a polynomial of `terms`, (n, t), fitted to the displacements `moved`, (n, m), m
    and rad, of the rows `good`. It has the shape (n, m), dimensionless: over its largest value,
    (m,), m and rad. Both are 0 for an output that does not move.
    """
    response = np.zeros((terms.shape[1], moved.shape[1]))
    for output, known in enumerate(np.isfinite(moved[good]).T):
        fit = np.linalg.lstsq(terms[good][known], moved[good[known], output], rcond=RANK)[0]
        response[1:, output] = fit[1:]
    scaled = terms @ response
    largest = np.abs(scaled[good]).max(axis=0, initial=0.0)
    # The response of an output that does not move is rounding.
    moves = largest > RANK * np.nanmax(np.abs(moved[good]), axis=0, initial=0.0)
    largest = np.where(moves, largest, 0.0)
    return np.where(moves, scaled, 0.0) / np.where(moves, largest, 1.0), largest


def _is_no_polynomial(parts: Floats, loads: Floats, degree: int) -> NDArray[np.bool_]:
    """Return which parts (s, n, m) are no polynomial of each load (n, 6) of this degree, (s, m)."""
    terms = np.column_stack([loads[:, :1] ** 0, *(loads ** (1 + k) for k in range(degree))])
    left, sizes, _ = np.linalg.svd(terms, full_matrices=False)
    basis = left[:, sizes > RANK * sizes.max(initial=0.0)]
    unexplained = parts - basis @ (basis.T @ parts)
    square = (parts**2).sum(axis=1)
    # Against the smaller of the session and all others: a session may be most of the rows.
    smaller = np.minimum(square, square.sum(axis=0) - square)
    return np.asarray((unexplained**2).sum(axis=1) > MIN_UNEXPLAINED * smaller)
