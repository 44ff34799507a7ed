"""Hysteresis, drift, sessions and zero offset of measured rows: effects of known covariates.

Readings are y = f(w) + Z b + e: f a Gaussian process with a linear mean, f(0) = 0, e noise, and Z
known of each row: 1 (the zero offset), which session it is of, the time within it, and the sign of
the output's motion since the load before, times the output's range in the session over that in its
widest one: while a load is held it keeps its branch. A scale that drifts, or differs between
sessions, is the time or the session times a polynomial of the loads for f. With the
covariance K = U L U' of f, D = 1 / (L + v) and B = U' (F, Z), F the mean's terms,

    b = (B' D B + s^2 / P)^-1 B' D U' y,    covariance s^2 (B' D B + s^2 / P)^-1

for every noise v at once, P the prior variance. Both are averaged over noises and kernels, smooth
and rough ones, by their restricted likelihood (Patterson and Thompson 1971): what a response may do
is not taken for an effect. An effect counts where its posterior interval leaves zero out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from operator import sub
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit

from ..table.polynomial import terms_of
from ..table.rows import ZERO_LOAD, Floats, LoadRange, Rows
from ..table.space import Space
from .correlation import matern
from .settings import DEFAULTS

Indices = NDArray[np.intp]

SAMPLE = 300  # rows show effects to an eighth of the noise of a reading, in a third of a second
SESSIONS = 8  # with effects of their own, those of the most rows; all others count as one
# Deviations of a step of the response that make it sure: a wrong direction in 700.
SURE = 3.0
ROUNDS = 3  # of directions and response in turn
# Probability that an effect of nothing counts: of six outputs and some four effects each, one file
# in a hundred has one.
CHANCE = 3e-4
# Of an output's range: a response that no kernel describes. It counts as far as a
# polynomial of the loads can do what the effect does: slow loads are a function of time.
MISFIT = 3e-4
PRIOR = 0.3  # deviation of effects, spreads of the output: a tenth of its range
# Deviation of a session's scale: two differ by 5 % at two deviations. Class 3 of ISO 7500-1 allows
# 3 % of a force, and class 2 of ISO 9513 2 % of a displacement.
SCALE = 0.0177
# Of a session's squared response, that no cubic of each load does. With less its scale may be the
# part's response, as of tension in one session and compression in another. A straight line does all
# of it where an axis is in one session alone: there is no other scale to differ from.
SHARED = 0.1
# Half ranges: a response may have a kink at no load. Readings there tell an offset, and else those
# on both sides of it, where polynomials fit them far better than it is large.
NO_LOAD = 0.01
# Half ranges: loads that differ by less are at one place, whose readings tell no direction. Force
# sensors scatter by 1e-4 to 5e-3 of their range.
PLACE = 0.02
BLOCK = 65_536  # rows at once: some 20 MB
RANK = 1e-9  # of the largest: columns that are no other direction
SAME = 1e-6  # of an effect: what rounding may put outside of the directions that rows tell
TINY = 1e-24  # spreads squared: rounding of equal values
RATIOS = np.exp(np.arange(-20.0, 4.6, 0.75))  # noises, process variances: from none to all
THETAS = (1.4, 0.0, -1.4, -2.8)  # logarithms of one over the squared length: 0.5 to 4 half ranges
# Weights of the term of all loads and of a response with kinks (Matern 3/2 of each load), over
# that of an axis.
PARTS = ((0.05, 0.0), (5.0, 0.0), (0.3, 0.1), (0.3, 2.0))


class Effects(NamedTuple):
    """Effects in the rows of a table, m and rad; 0 where the interval of one holds zero."""

    zero: Floats  # (m,): displacement at no load, at the beginning of sessions
    loop: Floats  # (m,): from unloading to loading
    # drift, session: (s, m): of each session from its first row to its last, and off the mean of
    # the sessions
    drift: Floats
    session: Floats
    scale: Floats  # (2 s, m): both of the scale, at the largest displacement from that at no load
    # (m,): how far the part may be from rows without these effects, which are in the middle of the
    # loop, of the time and of the sessions: the far ends of the intervals
    bar: Floats
    of_rows: Floats  # (n, m): sum of the effects in each row
    # (m,): the largest loop that rows would not show; infinite where they tell nothing of one
    loop_hidden: Floats


class _Readings(NamedTuple):
    """Measured rows (n), in the order of their measurement, as effects are estimated from them."""

    rows: Rows  # loads and displacements are the means at the row's place: see `_positions_of`
    good: Indices  # (k,): the rows that show effects, one a place, `SAMPLE` at most
    middle: Floats  # (n, 2 s): time in the session, then session; both about their means
    extent: Floats  # (n, m): see `_extent`
    terms: Floats  # (n, t): terms of a polynomial of the loads
    steps: Floats  # (n, t): their change from the place before; 0 at the first of a session
    # (s, m): the session's response is no cubic of each load, and no straight line
    is_identifiable: NDArray[np.bool_]
    is_shared: NDArray[np.bool_]
    scaled: Floats  # (n, m), dimensionless: the response over its largest value
    largest: Floats  # (m,), m and rad: that value

    @classmethod
    def of(cls, rows: Rows, load_range: LoadRange, good: Indices) -> _Readings:
        """Return the readings of rows; `good` are the indices of those that are not wrong."""
        session = sessions_of(rows)
        count = int(session.max(initial=0)) + 1
        members = [np.flatnonzero(session == number) for number in range(count)]
        middle = np.zeros((len(rows), 2 * count))
        for number, at in enumerate(members):
            middle[at, number] = np.linspace(-0.5, 0.5, len(at))
            middle[at, count + number] = count > 1
        middle[:, count:] -= middle[:, count:].mean(axis=1, keepdims=True)

        loads = rows.wrench / load_range.scale
        place = _positions_of(loads, members)
        good, loads, moved = _means_at_positions(loads, rows.displacement, good, place)
        extent = _extent(moved, good, session)
        if len(good) > SAMPLE:
            good = np.sort(np.random.default_rng(0).choice(good, SAMPLE, replace=False))

        terms = terms_of(loads, len(np.unique(place)))
        scaled, largest = _response(terms, moved, good)
        of_sessions = (session[good] == np.arange(count)[:, None])[:, :, None] * scaled[good]
        cubic, straight = (_is_no_polynomial(of_sessions, loads[good], k) for k in (3, 1))
        steps = terms.copy()
        for at in members:
            first = np.unique(place[at])
            steps[first[1:]] -= steps[first[:-1]]
            steps[first[:1]] = 0.0
        steps = steps[place]  # a load that stays at its place keeps the branch that it came by
        rows = replace(rows, wrench=loads * load_range.scale, displacement=moved)
        return cls(rows, good, middle, extent, terms, steps, cubic, straight, scaled, largest)


class _Estimates(NamedTuple):
    """Zero offset, loop, and each session's drift, offset, drift of scale, scale: (2 + 4 s, m)."""

    mean: Floats  # all are in m and rad
    deviation: Floats
    half_width: Floats  # of the interval that an effect must leave to count


def effects_of(rows: Rows, load_range: LoadRange, good: Indices) -> Effects:
    """Return the effects in measured rows (n), in the order of their measurement.

    `good`, shape (k,), are the rows that show them: those within the range that are not wrong.
    """
    readings = _Readings.of(rows, load_range, good)
    moved, good = readings.rows.displacement, readings.good
    shown = np.isfinite(moved[good]).T
    signs, evidence = np.zeros(moved.shape), dict[int, tuple[Floats, Floats]]()
    for output in np.flatnonzero(shown.any(axis=1)).tolist():
        known = shown[output]
        # The loop itself bends the response that determines the directions: settled after a round.
        for _ in range(ROUNDS):
            beside = np.column_stack((readings.terms[good], signs[good, output]))[known]
            evidence[output] = beside, moved[good, output][known]
            sure = sure_directions(*evidence[output], readings.steps[good])
            signs[good, output] = readings.extent[good, output] * sure
    estimates = _estimates(readings, signs, load_range, shown)
    mean, half_width = estimates.mean, estimates.half_width

    count = readings.middle.shape[1] // 2
    significant = np.where(np.abs(mean) > half_width, mean, 0.0)
    reported = _with_common_kinds(significant, estimates)
    ends = [1, 2, 2 + count, 2 + 2 * count]
    zero, loop, drift, offset, scale = np.split(reported, ends)
    for output in np.flatnonzero(loop).tolist():
        sure = sure_directions(*evidence[output], readings.steps)
        signs[:, output] = readings.extent[:, output] * sure

    removed = reported.copy()
    removed[-count:] *= readings.is_identifiable
    bar = _error_bar(removed, estimates, readings)
    # Where an output shows no drift of its own, the rows stay as they are and the error bar holds
    # it: the kinks of a response may be taken for a drift.
    removed[2 : 2 + count] = significant[2 : 2 + count]
    of_rows = signs * loop + readings.middle @ removed[2 : 2 + 2 * count]
    of_rows += readings.scaled * (readings.middle @ removed[2 + 2 * count :])
    hidden = np.where(half_width[1] > 0, 2 * half_width[1], np.inf)
    return Effects(zero[0], 2 * loop[0], drift, offset, scale, bar, of_rows, hidden)


def _with_common_kinds(significant: Floats, estimates: _Estimates) -> Floats:
    """Return the effects with those of a kind that any output shows, (2 + 4 s, m), m and rad.

    A rig that drifts in one output, or whose sessions differ in one, does so in all.
    """
    shape = 4, -1, significant.shape[1]
    means, reported = estimates.mean[2:].reshape(shape), significant.copy()
    by_kind = reported[2:].reshape(shape)
    is_shown = np.asarray(by_kind.any(axis=(1, 2)))
    # Noise of outputs is independent: all of them show a drift of the scale that none does alone.
    half = estimates.half_width[2:].reshape(shape)[2]
    far = (ndtri(CHANCE / 2) * means[2] / np.where(half > 0, half, np.inf)) ** 2
    is_shown[2] |= (far.sum(axis=1) > chdtri(shape[2], CHANCE)).any()
    by_kind[is_shown] = means[is_shown]
    return reported


def _error_bar(counted: Floats, estimates: _Estimates, readings: _Readings) -> Floats:
    """Return `Effects.bar` of the effects that count, (2 + 4 s, m), m and rad."""
    mean, deviation, half_width = estimates
    count, outputs = readings.is_shared.shape
    upper = np.where(counted != 0, np.abs(counted) + half_width, 0.0)
    kinds = upper[2:].reshape(4, count, outputs).max(axis=1)
    bar = upper[1] + (0.5 * kinds[0] + kinds[1] + 0.5 * kinds[2] + kinds[3])
    # Answers have the scale of the session at their load, and the part may have that of another.
    known = np.where(half_width[-count:] > 0, deviation[-count:], np.inf)
    width = np.minimum(known, SCALE * readings.largest) * DEFAULTS.half_width
    is_open = readings.is_shared & ~readings.is_identifiable & (count > 1)
    bar += 2 * np.where(is_open, np.abs(mean[-count:]) + width, 0.0).max(axis=0)
    # Where sessions differ, what they have in common is no displacement of the part either.
    common = np.abs(mean[0]) + DEFAULTS.half_width * deviation[0]
    return bar + np.where(counted[2 + count : 2 + 2 * count].any(axis=0), common, 0.0)


def _response(terms: Floats, moved: Floats, good: Indices) -> tuple[Floats, Floats]:
    """Return the response without its value at no load, (n, m), over its largest, (m,), m and rad.

    It is a polynomial of `terms`, (n, t), by the rows `good`. An output that does not move has 0.
    """
    response = np.zeros((terms.shape[1], moved.shape[1]))
    for output, known in enumerate(np.isfinite(moved[good]).T):
        fit = np.linalg.lstsq(terms[good][known], moved[good[known], output], rcond=RANK)[0]
        response[1:, output] = fit[1:]
    scaled = terms @ response
    largest = np.abs(scaled[good]).max(axis=0, initial=0.0)
    moves = largest > RANK * np.nanmax(np.abs(moved[good]), axis=0, initial=0.0)
    largest = np.where(moves, largest, 0.0)  # the response of an output that rests is rounding
    return np.where(moves, scaled, 0.0) / np.where(moves, largest, 1.0), largest


def _is_no_polynomial(parts: Floats, loads: Floats, degree: int) -> NDArray[np.bool_]:
    """Return which parts (s, n, m) are no polynomial of each load (n, 6) of this degree, (s, m)."""
    terms = np.column_stack([loads[:, :1] ** 0, *(loads ** (1 + k) for k in range(degree))])
    left, sizes, _ = np.linalg.svd(terms, full_matrices=False)
    basis = left[:, sizes > RANK * sizes.max(initial=0.0)]
    off, square = parts - basis @ (basis.T @ parts), (parts**2).sum(axis=1)
    least = np.minimum(square, square.sum(axis=0) - square)  # a session beside a few other rows
    return np.asarray((off**2).sum(axis=1) > SHARED * least)


def _extent(moved: Floats, good: Indices, session: Indices) -> Floats:
    """Return the range of each output in a row's session, (n, m), over that of its widest session.

    A loop is a part of it: friction of a test with a force along one axis moves an output by as
    much less as the force does, than that of a test along another.
    """
    ranges = np.zeros((session.max(initial=0) + 1, moved.shape[1]))
    for number in np.unique(session[good]):
        these = np.ma.masked_invalid(moved[good[session[good] == number]])
        ranges[number] = np.ma.filled(np.ma.ptp(these, axis=0), 0.0)
    widest = ranges.max(axis=0)
    return (ranges / np.where(widest > 0.0, widest, 1.0))[session]


def _positions_of(loads: Floats, sessions: list[Indices]) -> Indices:
    """Return the first row at the place of each row's load, (n,): loads (n, 6), scaled, in order.

    A load leaves its place where it is farther than `PLACE` from the first there. `sessions` are
    the rows of each.
    """
    place = np.arange(len(loads))
    for rows in sessions:
        moved_on = np.abs(np.diff(loads[rows], axis=0)).max(axis=1, initial=0.0) > 2 * PLACE
        points, first = loads[rows].tolist(), 0
        for at, is_far in enumerate(moved_on.tolist(), 1):
            if is_far or max(map(abs, map(sub, points[at], points[first]))) > PLACE:
                first = at
            place[rows[at]] = rows[first]
    return place


def _means_at_positions(
    loads: Floats, moved: Floats, good: Indices, place: Indices
) -> tuple[Indices, Floats, Floats]:
    """Return the first row of each place, and loads (n, 6) and displacements (n, m), there means.

    Readings at a place tell of the noise alone; as rows of their own, effects seem surer. `place`
    is the first row of each row's, `good` those that the means are of.
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


def sessions_of(rows: Rows) -> Indices:
    """Return the session of each row, (n,): one of an import and source each, of several rows."""
    session = np.unique(rows.session, return_inverse=True)[1]
    if len(rows) and (rows.source != rows.source[0]).any():
        source = np.unique(rows.source, return_inverse=True)[1]
        session = session * (source.max() + 1) + source
    _, index, counts = np.unique(session, return_inverse=True, return_counts=True)
    largest = np.argsort(-counts, kind="stable")[:SESSIONS]
    number = np.full(len(counts), -1)
    number[largest[counts[largest] > 1]] = largest[counts[largest] > 1]
    return np.unique(number[index], return_inverse=True)[1]


def sure_directions(x: Floats, y: Floats, steps: Floats) -> Floats:
    """Return the sign of an output's change where it is sure, (n,), else 0.

    `x`, `y` (k, t + 1) and (k,): terms of the response and signs of rows, and their readings.
    `steps` (n, t): the change of the terms from the row before.
    """
    left, sizes, right = _directions(x)
    along, back = left.T @ y, right.T / sizes
    rest = y - left @ along
    noise = np.sqrt(rest @ rest / max(len(y) - len(sizes), 1))
    change, deviation = steps @ (back @ along)[:-1], np.empty(len(steps))
    for at in range(0, len(steps), BLOCK):
        deviation[at : at + BLOCK] = np.linalg.norm(steps[at : at + BLOCK] @ back[:-1], axis=1)
    deviation *= noise
    return np.where(np.abs(change) > SURE * deviation, np.sign(change), 0.0)


def _directions(matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the singular value decomposition of a matrix, without values that are rounding."""
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    few = sizes > RANK * sizes[0]
    return left[:, few], sizes[few], right[few]


def _estimates(
    readings: _Readings, signs: Floats, load_range: LoadRange, shown: NDArray[np.bool_]
) -> _Estimates:
    """Return the estimates of all outputs.

    `signs` (n, m): of the outputs' motion, times their extent.
    `shown` (m, k): which outputs the rows `good` have.
    """
    middle, good = readings.middle, readings.good
    results = np.zeros((3, 2 + 2 * middle.shape[1], len(shown)))
    pending = shown.any(axis=1)
    # A loop is in rows without a sure direction too, on a side that is not known: its size is that
    # of the others. So outputs with a loop are estimated again, by rows with a sure direction.
    for _ in range(2):
        for known in np.unique(shown[pending], axis=0):
            outputs, used = np.flatnonzero(pending & (shown == known).all(axis=1)), good[known]
            # Columns of the effects, (n, c, k): sign; time and session; both of the scale.
            time = np.repeat(middle[used][:, :, None], len(outputs), axis=2)
            signed = signs[used][:, None, outputs]
            gains = time * readings.scaled[used][:, None, outputs]
            columns = np.concatenate((signed, time, gains), axis=1)
            scale = SCALE * readings.largest[outputs]
            some = readings.rows.take(used)
            results[:, :, outputs] = _estimated(some, load_range, outputs, columns, scale)
        pending = np.abs(results[0, 1]) > results[2, 1]
        shown = np.where(pending[:, None], shown & (signs[good].T != 0), shown)
    return _Estimates(*results)


def _estimated(
    rows: Rows, load_range: LoadRange, outputs: Indices, columns: Floats, scale: Floats
) -> _Estimates:
    """Return the estimates of outputs (k,) that all rows have, (1 + c, k) each.

    The zero offset, and the effects of columns (n, c, k): signs, and two halves, the second of a
    deviation `scale`, (k,), m and rad.
    """
    moved = rows.displacement[:, outputs]
    size, offset = moved.std(axis=0), moved.mean(axis=0)
    n, y = len(rows), (moved - offset) / np.where(size > 0, size, 1.0)
    x = (rows.wrench - load_range.space.zero) / load_range.scale
    linear = x[:, np.ptp(x, axis=0) > ZERO_LOAD]
    # Coefficients are those of the loads, of the zero offset and of the columns. Effects are the
    # contrasts of all but the loads' ones.
    first, sessions = linear.shape[1], columns.shape[1] // 4
    count = first + 1 + columns.shape[1]
    contrasts = np.eye(count)[first:]
    for end in (count, count - 2 * sessions):  # a session's offset and scale: off their mean
        contrasts[end - first - sessions : end - first, end - sessions : end] -= 1 / sessions
    contrasts[0, first + 2 : first + 2 + sessions] = -0.5 / sessions  # zero: as sessions begin
    free = n - first - 2 - np.count_nonzero(columns[:, 1:].any(axis=(0, 2)))
    if free < 1:
        none = np.zeros((len(contrasts), len(outputs)))
        return _Estimates(none, none, none)
    priors = np.zeros((len(outputs), count))
    priors[:, first + 1 :] = PRIOR**-2
    some = (size > 0) & (scale > 0)
    priors[some, -2 * sessions :] = (size[some, None] / scale[some, None]) ** 2
    spectra = []
    for matrix in _covariances(x, rows.space):
        roots, vectors = np.linalg.eigh(matrix)
        spectra.append((vectors, 1 / (np.maximum(roots, 0.0) + RATIOS[:, None])))
    shape = len(spectra), len(RATIOS), len(outputs)
    values, means, squares = np.empty(shape), *np.empty((2, *shape, len(contrasts)))
    for output in range(len(outputs)):
        all_columns = np.column_stack((linear, np.ones(n), columns[:, :, output]))
        values[:, :, output], means[:, :, output], squares[:, :, output] = _posterior(
            all_columns, y[:, output], contrasts, priors[output], spectra, free
        )
    # The average over kernels and noises, by their likelihood.
    weights = np.exp(values.min(axis=(0, 1)) - values)
    weights /= weights.sum(axis=(0, 1))
    mean = np.einsum("kro,kroe->eo", weights, means)
    square = np.einsum("kro,kroe->eo", weights, squares)
    deviation = size * np.sqrt(np.maximum(square - mean**2, 0.0))
    mean *= size
    mean[0] += offset

    half_width, misfits = _half_widths(
        moved, terms_of(x)[:, 1:], columns, contrasts[:, first:], deviation, free
    )
    if np.abs(x).max(axis=1).min() > NO_LOAD:  # a kink may be hidden where polynomials misfit
        one_sided = max(x.min(axis=0).max(), -x.max(axis=0).min()) > NO_LOAD
        half_width[0] = np.inf if one_sided else np.maximum(half_width[0], SURE * misfits)
    return _Estimates(mean, deviation, half_width)


def _posterior(
    columns: Floats,
    y: Floats,
    contrasts: Floats,
    prior: Floats,
    spectra: list[tuple[Floats, Floats]],
    free: int,
) -> tuple[Floats, Floats, Floats]:
    """Return half the negative log likelihood of kernels and noises, effects, and their squares.

    Shapes (k, r), (k, r, e) and (k, r, e), spreads and spreads squared; squares are means.

    `columns` (n, c), `y` (n,), spreads: of one output, and its readings.
    `contrasts` (e, c), `prior` (c,): effects by the coefficients; precision of these.
    `spectra`: of each kernel the eigenvectors (n, n), and one over eigenvalues with noise (r, n).
    """
    # Directions of the columns, and what data are along them: normal equations then keep their
    # digits.
    basis, sizes, right = _directions(columns)
    parts = right.T / sizes
    back, along = contrasts @ parts, basis.T @ y
    pull = parts.T * prior @ parts  # of the prior, towards coefficients of zero
    off = y - basis @ along
    results: list[tuple[Floats, Floats, Floats]] = []
    for vectors, inverse in spectra:
        b, data = vectors.T @ basis, vectors.T @ off
        products = b[:, :, None] * b[:, None]
        normal = (inverse @ products.reshape(len(b), -1)).reshape(len(inverse), *[b.shape[1]] * 2)
        right, square = inverse @ (b * data[:, None]), inverse @ data**2
        # The prior counts relative to the process variance, which follows from it.
        variance, posterior, covariances, estimate = np.ones(len(inverse)), *(normal,) * 2, right
        for _ in range(2):
            posterior = normal + variance[:, None, None] * pull
            covariances = np.linalg.inv(posterior)
            moment = right - variance[:, None] * (pull @ along)
            estimate = np.einsum("rab,rb->ra", covariances, moment)
            residual = square - (estimate * moment).sum(axis=1) + variance * (along @ pull @ along)
            variance = np.maximum(residual, TINY) / free
        logarithms = np.linalg.slogdet(posterior)[1] - np.log(inverse).sum(axis=1)
        effects = (along + estimate) @ back.T
        spread = np.einsum("ea,rab,eb->re", back, covariances, back)
        values = 0.5 * (free * np.log(variance) + logarithms)
        results.append((values, effects, effects**2 + variance[:, None] * spread))
    values, effects, squares = map(np.array, zip(*results, strict=True))
    return values, effects, squares


def _half_widths(
    moved: Floats, terms: Floats, columns: Floats, contrasts: Floats, deviation: Floats, free: int
) -> tuple[Floats, Floats]:
    """Return half the interval to count by, (1 + c, k), and residuals, (k,), m and rad.

    Adds to each `deviation`, (1 + c, k), what a misfit of a polynomial of `terms`, (n, t), can do
    as an effect. `contrasts` are those of the columns (n, c, k); `free` are degrees of freedom.
    """
    n, outputs = moved.shape
    half_width, freedom = np.empty_like(deviation), np.full(len(deviation), float(free))
    misfits = np.empty(outputs)
    for output in range(outputs):
        b = np.column_stack((terms, np.ones(n), columns[:, :, output]))
        off_mean = np.eye(b.shape[1])[terms.shape[1] :]
        off_mean[:, -contrasts.shape[1] :] = contrasts
        left, sizes, right = _directions(b)
        along = off_mean @ right.T
        off = moved[:, output] - left @ (left.T @ moved[:, output])
        misfits[output] = np.linalg.norm(off) / np.sqrt(max(n - len(sizes), 1))
        worst = np.sqrt(n) * np.linalg.norm(along / sizes, axis=1)
        # A grid in the order of its loads is a straight function of time: no drift is identifiable.
        shown = np.linalg.norm(off_mean - along @ right, axis=1) < SAME
        misfit = MISFIT * np.ptp(moved[:, output]) * worst
        deviation[:, output] = np.hypot(deviation[:, output], misfit)
        # Rows at rest tell nothing of a loop.
        freedom[1] = max(np.count_nonzero(columns[:, 0, output]) - n + free, 1)
        half_width[:, output] = np.where(
            shown, -stdtrit(freedom, CHANCE / 2) * deviation[:, output], np.inf
        )
    return half_width, misfits


def _covariances(x: Floats, space: Space) -> Iterator[Floats]:
    """Yield the covariance (n, n) of responses at loads (n, 6) that are zero at no load."""
    points = np.concatenate((x, np.zeros((1, x.shape[1]))))
    apart = np.abs(points[:, None] - points)
    squares = [apart**2 @ group for group in space.kriging_groups]
    kinks = matern(apart**2, 0, 1)[0].sum(axis=2)
    for theta in THETAS:
        *axes, joint = (matern(np.exp(theta) * square, 0)[0] for square in squares)
        for weight, rough in PARTS:
            matrix = sum(axes) + weight * joint + rough * kinks
            across = matrix[:-1, -1]
            yield (matrix[:-1, :-1] - np.outer(across, across) / matrix[-1, -1]) / matrix[-1, -1]
