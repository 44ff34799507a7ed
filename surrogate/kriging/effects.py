"""Hysteresis, drift, sessions and zero offset of measured rows: effects of known covariates.

Readings are y = f(w) + Z b + e: f is a Gaussian process of the loads with a linear mean and
f(0) = 0, e is noise, and Z has these columns, known of each row: 1 (the zero offset); which session
the row belongs to; the time within it; and the sign of the output's motion since the load before,
times the output's range in the session over that in its widest session. A load that is held keeps
its branch. A scale that drifts, or differs between sessions, is the time or the session times a
polynomial of the loads that stands for f. With the covariance K = U L U' of f, D = 1 / (L + v) and
B = U' (F, Z), F the mean's terms and P the prior variance,

    b = (B' D B + s^2 / P)^-1 B' D U' y,    covariance s^2 (B' D B + s^2 / P)^-1

for every noise v at once. Both are averaged over noises and kernels, smooth and rough ones, with
their restricted likelihood (Patterson and Thompson 1971) as the weight, so that a response that
bends is not taken for an effect. An effect counts where its posterior interval excludes zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri, stdtrit

from ..table.polynomial import RANK, terms_of
from ..table.rows import ZERO_LOAD, Floats, LoadRange, Rows
from ..table.space import Space
from .correlation import (
    covariances_of_values,
    matern,
    squared_differences,
    symmetric,
    weighted_products,
)
from .readings import Indices, Readings
from .settings import DEFAULTS

# Standard deviations of a step of the response beyond which its direction is sure: 1 in 700 errs.
SURE = 3.0
# Rounds of estimating directions and response in turn: the result settles after one or two.
ROUNDS = 3
# Probability that an effect of size zero counts: of six outputs with some four effects each, one
# file in a hundred shows one.
CHANCE = 3e-4
# Misfit, as a part of an output's range, that every kernel is assumed to leave. It counts as far as
# a polynomial of the loads can take the form of the effect: loads that change slowly are a function
# of time.
MISFIT = 3e-4
PRIOR = 0.3  # prior deviation of effects, over the output's spread: a tenth of its range
# Deviation of a session's scale: two differ by 5 % at two deviations. Class 3 of ISO 7500-1 allows
# 3 % of a force, and class 2 of ISO 9513 2 % of a displacement.
SCALE_DEVIATION = 0.0177
# Distance from zero load, half ranges, within which readings show the zero offset, as a response
# may have a kink at zero load. Without such readings, readings on both sides of zero load show it
# where polynomials fit them far better than it is large.
NO_LOAD = 0.01
BLOCK = 65_536  # rows computed at once: some 20 MB
# Part of an effect that rounding may leave outside of the directions that rows determine.
UNDETERMINED = 1e-6
# Readings less any combination of the columns have the same posterior, to rounding. A combination
# that hardly varies, such as the time less a load that rises evenly to its written digits, has a
# large precision by the prior: it is subtracted over 1 + SHORTENED * precision, so that at most
# 1 / (4 SHORTENED) of the readings' square cancels.
SHORTENED = 1e-6
TINY = 1e-24  # spreads squared: the rounding of equal values
RATIOS = np.exp(np.arange(-20.0, 4.6, 0.75))  # noise over process variance: from none to all
# One over the squared length: 0.5 to 4 half ranges.
INVERSE_SQUARES = tuple(np.exp([1.4, 0.0, -1.4, -2.8]).tolist())
# Weights, over that of an axis' term, of the term of all loads and of a response with kinks
# (Matern 3/2 of each load).
JOINT_AND_KINK_WEIGHTS = ((0.05, 0.0), (5.0, 0.0), (0.3, 0.1), (0.3, 2.0))


class Effects(NamedTuple):
    """Effects in n rows of s sessions and m outputs, m and rad; 0 where the interval holds zero."""

    zero: Floats  # (m,): displacement at zero load, at the beginning of sessions
    loop: Floats  # (m,): distance from the unloading to the loading branch
    drift: Floats  # (s, m): of each session from its first row to its last
    session: Floats  # (s, m): of each session off the mean of the sessions
    # (2 s, m): drift and session of the scale, at the largest displacement from that at zero load
    scale: Floats
    # (m,): how far the part may be from rows without these effects, which are in the middle of the
    # loop, of the time and of the sessions: the far ends of the intervals
    bar: Floats
    of_rows: Floats  # (n, m): sum of the effects in each row
    # (m,): the largest loop that rows would not show; infinite where they show nothing of one
    loop_hidden: Floats


class _Estimates(NamedTuple):
    """Posterior of all effects, (2 + 4 s, m) each, m and rad; `_by_kind` names their rows."""

    mean: Floats
    deviation: Floats
    half_width: Floats  # half-width of the interval that an effect must leave to count


class _ByKind(NamedTuple):
    """Effects of s sessions and m outputs by their kind, m and rad: views of one array."""

    zero: Floats  # (m,)
    loop: Floats  # (m,): half the distance of the branches
    drift: Floats  # (s, m)
    session: Floats  # (s, m): offset of the session from the mean of all
    scale_drift: Floats  # (s, m)
    scale: Floats  # (s, m)


def _by_kind(effects: Floats) -> _ByKind:
    """Return views of effects (2 + 4 s, m) by their kind."""
    return _ByKind(effects[0], effects[1], *effects[2:].reshape(4, -1, effects.shape[1]))


def effects_of(rows: Rows, load_range: LoadRange, good: Indices) -> Effects:
    """Return the effects in measured rows (n), in the order of their measurement.

    `good`, (k,): indices of the rows that show them, within the range and without outliers.
    """
    readings = Readings.of(rows, load_range, good)
    moved, good = readings.rows.displacement, readings.good
    measured = np.isfinite(moved[good]).T
    # Of each output the terms of its response with the signs, and its readings.
    signs = np.zeros(moved.shape)
    evidence = dict[int, tuple[Floats, Floats]]()
    for output in np.flatnonzero(measured.any(axis=1)).tolist():
        known = measured[output]
        # The loop itself bends the response that determines the directions: settled after a round.
        for _ in range(ROUNDS):
            terms = np.column_stack((readings.terms[good], signs[good, output]))[known]
            evidence[output] = terms, moved[good, output][known]
            sure = sure_directions(*evidence[output], readings.steps[good])
            signs[good, output] = readings.extent[good, output] * sure
    estimates = _estimates(readings, signs, load_range, measured)
    mean, half_width = estimates.mean, estimates.half_width

    significant = np.where(np.abs(mean) > half_width, mean, 0.0)
    reported = _with_common_kinds(significant, estimates)
    kinds = _by_kind(reported)
    for output in np.flatnonzero(kinds.loop).tolist():
        sure = sure_directions(*evidence[output], readings.steps)
        signs[:, output] = readings.extent[:, output] * sure

    removed = reported.copy()
    _by_kind(removed).scale[:] *= readings.is_identifiable
    bar = _error_bar(removed, estimates, readings)
    # An output without a significant drift of its own keeps its rows, and its error bar includes
    # the drift: the kinks of a response may be taken for a drift.
    _by_kind(removed).drift[:] = _by_kind(significant).drift
    of_time_and_session, of_scale = np.split(removed[2:], 2)
    of_rows = signs * kinds.loop + readings.middle @ of_time_and_session
    of_rows += readings.scaled * (readings.middle @ of_scale)
    loop_width = _by_kind(half_width).loop
    return Effects(
        zero=kinds.zero,
        loop=2 * kinds.loop,
        drift=kinds.drift,
        session=kinds.session,
        scale=np.concatenate((kinds.scale_drift, kinds.scale)),
        bar=bar,
        of_rows=of_rows,
        loop_hidden=np.where(loop_width > 0, 2 * loop_width, np.inf),
    )


def _with_common_kinds(significant: Floats, estimates: _Estimates) -> Floats:
    """Return the significant effects, with all effects of a kind that is significant in any output.

    A rig that drifts in one output, or whose sessions differ in one, does so in all outputs.

    `significant` and result (2 + 4 s, m), m and rad: the mean where it is significant, else 0.
    """
    reported = significant.copy()
    means = _by_kind(estimates.mean)
    # The noise of the outputs is independent, so together they may show a drift of the scale that
    # no output shows alone.
    half_width = _by_kind(estimates.half_width).scale_drift
    deviations = ndtri(CHANCE / 2) * means.scale_drift
    squared = (deviations / np.where(half_width > 0, half_width, np.inf)) ** 2
    limit = chdtri(significant.shape[1], CHANCE)
    drifts_together = bool((squared.sum(axis=1) > limit).any())
    for kind, effects in _by_kind(reported)._asdict().items():
        is_of_sessions = kind not in ("zero", "loop")
        is_shown = effects.any() or (kind == "scale_drift" and drifts_together)
        if is_of_sessions and is_shown:
            effects[:] = getattr(means, kind)
    return reported


def _error_bar(counted: Floats, estimates: _Estimates, readings: Readings) -> Floats:
    """Return `Effects.bar` of the counted effects, (2 + 4 s, m), m and rad."""
    mean, deviation = _by_kind(estimates.mean), _by_kind(estimates.deviation)
    half_width = _by_kind(estimates.half_width)
    upper = _by_kind(np.where(counted != 0, np.abs(counted) + estimates.half_width, 0.0))
    # Half a drift: rows without it are in the middle of the time.
    bar = upper.loop + (
        0.5 * upper.drift.max(axis=0)
        + upper.session.max(axis=0)
        + 0.5 * upper.scale_drift.max(axis=0)
        + upper.scale.max(axis=0)
    )
    # Answers have the scale of the session at their load, and the part may have another's.
    known = np.where(half_width.scale > 0, deviation.scale, np.inf)
    width = np.minimum(known, SCALE_DEVIATION * readings.largest) * DEFAULTS.half_width
    has_sessions = len(readings.is_shared) > 1
    is_open = readings.is_shared & ~readings.is_identifiable & has_sessions
    bar += 2 * np.where(is_open, np.abs(mean.scale) + width, 0.0).max(axis=0)
    # Where sessions differ, what they have in common is no displacement of the part either.
    common = np.abs(mean.zero) + DEFAULTS.half_width * deviation.zero
    return bar + np.where(_by_kind(counted).session.any(axis=0), common, 0.0)


def sure_directions(x: Floats, y: Floats, steps: Floats) -> Floats:
    """Return the sign of an output's change where it is sure, (n,), else 0.

    `x` (k, t + 1): terms of the response at k rows, and the signs of their motion.
    `y` (k,), m or rad: readings of the output at these rows.
    `steps` (n, t): the change of the terms from the row before.
    """
    left, sizes, right = _directions(x)
    along = left.T @ y
    back = right.T / sizes
    residual = y - left @ along
    noise = np.sqrt(residual @ residual / max(len(y) - len(sizes), 1))
    change = steps @ (back @ along)[:-1]
    deviation = np.empty(len(steps))
    for at in range(0, len(steps), BLOCK):
        deviation[at : at + BLOCK] = np.linalg.norm(steps[at : at + BLOCK] @ back[:-1], axis=1)
    deviation *= noise
    return np.where(np.abs(change) > SURE * deviation, np.sign(change), 0.0)


def _directions(matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the singular value decomposition of a matrix, without singular values of rounding."""
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    is_significant = sizes > RANK * sizes[0]
    return left[:, is_significant], sizes[is_significant], right[is_significant]


def _estimates(
    readings: Readings, signs: Floats, load_range: LoadRange, measured: NDArray[np.bool_]
) -> _Estimates:
    """Return the estimates of all outputs.

    `signs` (n, m): direction of the outputs' motion, times their extent.
    `measured` (m, k): which outputs the rows `good` have.
    """
    middle, good = readings.middle, readings.good
    results = np.zeros((3, 2 + 2 * middle.shape[1], len(measured)))
    pending = measured.any(axis=1)
    # A loop is also in rows without a sure direction, on an unknown side: its size is that of the
    # others. So outputs with a loop are estimated again, from rows with a sure direction.
    for _ in range(2):
        for known in np.unique(measured[pending], axis=0):
            outputs = np.flatnonzero(pending & (measured == known).all(axis=1))
            used = good[known]
            # Columns of the effects, (n, c, k): sign; time and session; both of the scale.
            time = np.repeat(middle[used][:, :, None], len(outputs), axis=2)
            signed = signs[used][:, None, outputs]
            gains = time * readings.scaled[used][:, None, outputs]
            columns = np.concatenate((signed, time, gains), axis=1)
            scale = SCALE_DEVIATION * readings.largest[outputs]
            rows = readings.rows.take(used)
            results[:, :, outputs] = _estimated(rows, load_range, outputs, columns, scale)
        estimates = _Estimates(*results)
        pending = np.abs(_by_kind(estimates.mean).loop) > _by_kind(estimates.half_width).loop
        measured = np.where(pending[:, None], measured & (signs[good].T != 0), measured)
    return _Estimates(*results)


def _estimated(
    rows: Rows, load_range: LoadRange, outputs: Indices, columns: Floats, scale: Floats
) -> _Estimates:
    """Return the estimates of outputs (k,) that all n rows have: (1 + c, k) each.

    `columns` (n, c, k): covariates of the effects except the zero offset: sign of the motion; time
    and session; the same times the response.
    `scale` (k,), m and rad: prior deviation of the effects on the scale, the last columns.
    """
    moved = rows.displacement[:, outputs]
    size, offset = moved.std(axis=0), moved.mean(axis=0)
    n = len(rows)
    y = (moved - offset) / np.where(size > 0, size, 1.0)
    x = (rows.wrench - load_range.space.zero) / load_range.scale
    linear = x[:, np.ptp(x, axis=0) > ZERO_LOAD]
    first = linear.shape[1]
    n_sessions = columns.shape[1] // 4
    contrasts = _contrasts(first, n_sessions)

    free = n - first - 2 - np.count_nonzero(columns[:, 1:].any(axis=(0, 2)))
    if free < 1:
        none = np.zeros((len(contrasts), len(outputs)))
        return _Estimates(none, none, none)
    priors = np.zeros((len(outputs), contrasts.shape[1]))
    priors[:, first + 1 :] = PRIOR**-2
    moves = (size > 0) & (scale > 0)
    priors[moves, -2 * n_sessions :] = (size[moves, None] / scale[moves, None]) ** 2

    spectra = []
    for matrix in _covariances(x, rows.space):
        roots, vectors = np.linalg.eigh(matrix)
        spectra.append((vectors, 1 / (np.maximum(roots, 0.0) + RATIOS[:, None])))
    posteriors = []
    for output in range(len(outputs)):
        all_columns = np.column_stack((linear, np.ones(n), columns[:, :, output]))
        result = _posterior(all_columns, y[:, output], contrasts, priors[output], spectra, free)
        posteriors.append(result)

    # The average over kernels and noises; letters: kernel, ratio, output, effect.
    values, means, second_moments = (
        np.stack(part, axis=2) for part in zip(*posteriors, strict=True)
    )
    weights = np.exp(values.min(axis=(0, 1)) - values)
    weights /= weights.sum(axis=(0, 1))
    mean = np.einsum("kro,kroe->eo", weights, means)
    second_moment = np.einsum("kro,kroe->eo", weights, second_moments)
    deviation = size * np.sqrt(np.maximum(second_moment - mean**2, 0.0))
    mean *= size
    mean[0] += offset

    misfits, of_misfit, is_identified = _by_polynomial(
        moved, terms_of(x)[:, 1:], columns, contrasts[:, first:]
    )
    deviation = np.hypot(deviation, of_misfit)
    freedom = np.full(deviation.shape, float(free))
    # Rows without a sure direction show nothing of a loop.
    freedom[1] = np.maximum(np.count_nonzero(columns[:, 0], axis=0) - n + free, 1)
    quantile = -stdtrit(freedom, CHANCE / 2)
    half_width = np.where(is_identified, quantile * deviation, np.inf)
    if np.abs(x).max(axis=1).min() > NO_LOAD:  # a kink may be hidden where polynomials misfit
        one_sided = max(x.min(axis=0).max(), -x.max(axis=0).min()) > NO_LOAD
        half_width[0] = np.inf if one_sided else np.maximum(half_width[0], SURE * misfits)
    return _Estimates(mean, deviation, half_width)


def _contrasts(n_loads: int, n_sessions: int) -> Floats:
    """Return the effects by the coefficients of loads, zero offset and columns, (1 + c, l + 1 + c).

    They are the coefficients without those of the loads, with these means subtracted.
    """
    count = n_loads + 2 + 4 * n_sessions
    contrasts = np.eye(count)[n_loads:]
    # Offset and scale of a session: relative to the mean over the sessions.
    for end in (count, count - 2 * n_sessions):
        sessions = slice(end - n_sessions, end)
        contrasts[end - n_loads - n_sessions : end - n_loads, sessions] -= 1 / n_sessions
    # The zero offset is the one at the beginning of sessions.
    contrasts[0, n_loads + 2 : n_loads + 2 + n_sessions] = -0.5 / n_sessions
    return contrasts


class _Posterior(NamedTuple):
    """Posterior of e effects on an output, by k kernels and r noises."""

    negative_log_likelihood: Floats  # (k, r): half of it
    mean: Floats  # (k, r, e), spreads
    second_moment: Floats  # (k, r, e), spreads squared


def _posterior(
    columns: Floats,
    y: Floats,
    contrasts: Floats,
    prior: Floats,
    spectra: list[tuple[Floats, Floats]],
    free: int,
) -> _Posterior:
    """Return the posterior of the effects on an output.

    `columns` (n, c): covariates of one output: linear loads, 1, and those of the effects.
    `y` (n,), spreads: its readings.
    `contrasts` (e, c): the effects by the coefficients of the columns.
    `prior` (c,): prior precision of the coefficients.
    `spectra`: for each kernel U (n, n), and D of each noise (r, n), as in the module's formula.
    `free`: degrees of freedom of the readings less those of the columns.
    """
    # In an orthonormal basis of the columns, the normal equations keep their digits.
    basis, sizes, directions = _directions(columns)
    parts = directions.T / sizes
    back = contrasts @ parts
    pull = parts.T * prior @ parts  # the prior pulls coefficients towards zero
    along = np.linalg.solve(np.eye(len(sizes)) + SHORTENED * pull, basis.T @ y)
    residual_data = y - basis @ along

    shape = len(spectra), len(RATIOS)
    result = _Posterior(np.empty(shape), *np.empty((2, *shape, len(contrasts))))
    for kernel, (vectors, D) in enumerate(spectra):
        B, data = vectors.T @ basis, vectors.T @ residual_data
        normal = weighted_products(B, D)
        moments = D @ (B * data[:, None])
        square = D @ data**2

        # The prior counts relative to the process variance, which follows from it.
        variance = np.ones(len(D))
        posterior, covariances, estimate = normal, normal, moments
        for _ in range(2):
            posterior = normal + variance[:, None, None] * pull
            covariances = np.linalg.inv(posterior)
            moment = moments - variance[:, None] * (pull @ along)
            estimate = np.einsum("rab,rb->ra", covariances, moment)
            residual = square - (estimate * moment).sum(axis=1) + variance * (along @ pull @ along)
            variance = np.maximum(residual, TINY) / free

        logarithms = np.linalg.slogdet(posterior)[1] - np.log(D).sum(axis=1)
        effects = (along + estimate) @ back.T
        spread = np.einsum("ea,rab,eb->re", back, covariances, back)
        result.negative_log_likelihood[kernel] = 0.5 * (free * np.log(variance) + logarithms)
        result.mean[kernel] = effects
        result.second_moment[kernel] = effects**2 + variance[:, None] * spread
    return result


def _by_polynomial(
    moved: Floats, terms: Floats, columns: Floats, contrasts: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return misfits, their part of each effect, and which effects the rows identify.

    A misfit is the root mean square of an output that a polynomial of the loads and the columns do
    not explain, (k,), m and rad. Its part of an effect, (1 + c, k), m and rad, is that of `MISFIT`
    if it has the form that the effect takes for its own. The last result has shape (1 + c, k).

    `moved` (n, k), m and rad; `terms` (n, t): the polynomial's terms but 1.
    `contrasts` (1 + c, 1 + c): the effects by the coefficients of 1 and the columns (n, c, k).
    """
    n, outputs = moved.shape
    misfits = np.empty(outputs)
    of_misfit = np.empty((len(contrasts), outputs))
    is_identified = np.empty((len(contrasts), outputs), dtype=bool)
    for output in range(outputs):
        all_columns = np.column_stack((terms, np.ones(n), columns[:, :, output]))
        effects = np.eye(all_columns.shape[1])[terms.shape[1] :]  # by all coefficients
        effects[:, -contrasts.shape[1] :] = contrasts
        left, sizes, right = _directions(all_columns)
        along = effects @ right.T
        residual = moved[:, output] - left @ (left.T @ moved[:, output])
        misfits[output] = np.linalg.norm(residual) / np.sqrt(max(n - len(sizes), 1))
        worst = np.sqrt(n) * np.linalg.norm(along / sizes, axis=1)
        of_misfit[:, output] = MISFIT * np.ptp(moved[:, output]) * worst
        # A grid in the order of its loads is a straight function of time: no drift is identifiable.
        outside = np.linalg.norm(effects - along @ right, axis=1)
        is_identified[:, output] = outside < UNDETERMINED
    return misfits, of_misfit, is_identified


def _covariances(x: Floats, space: Space) -> Iterator[Floats]:
    """Yield the covariance (n, n) of a response that is zero at zero load, for each kernel.

    `x` (n, 6): loads, half ranges.
    """
    points = np.concatenate((x, np.zeros((1, x.shape[1]))))
    kinks = symmetric(matern(squared_differences(points), 0, 1)[0].sum(axis=1), len(points))
    for axes, joint in covariances_of_values(points, space.kriging_groups, INVERSE_SQUARES):
        for joint_weight, kink_weight in JOINT_AND_KINK_WEIGHTS:
            matrix = axes + joint_weight * joint + kink_weight * kinks
            across, at_zero = matrix[:-1, -1], matrix[-1, -1]
            yield (matrix[:-1, :-1] - np.outer(across, across) / at_zero) / at_zero
