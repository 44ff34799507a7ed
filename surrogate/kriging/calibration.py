"""The factors by which posterior deviations are multiplied to hold 95 % of the errors.

A left-out row shows the errors of answers at the same distance from their rows, but not of answers
farther away. So a row is left out together with its nearest rows (in the metric of the length
scales), as many as make its deviation that of random wrenches of the loads that the rows span. Rows
that were left out with another are not left out again: rows close together, as of a motion, do not
calibrate answers far from them, and do not keep spread rows from doing so. Where most rows are
close together, each left out by itself shows the errors of answers near rows, which may be larger
over their deviation (kinks). The larger of the two factors holds.

Rows of one axis stand for queries of one axis, and rows of several axes for queries of several.
Errors are not known where fewer than six rows are as far from the rest as queries are, nor at
deviations far beyond those of these rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..calibration import LEVEL, common_quantile, widening
from ..table.axes import has_levels
from ..table.rows import NEAR, ZERO_LOAD, Floats, LoadRange
from ..table.spread import spread_wrenches
from .correlation import block
from .equations import DECIMALS, Scaling, evenly, farthest_first
from .factor import Indices, KrigingFactor, LeftOutRows, Neighbourhoods, left_out
from .settings import DEFAULTS, KrigingSettings

# Ratio to the distance within which rows merge: the span's margin on both sides of a load that no
# row varies, and rounding.
FIXED_WIDTH = 2.5
# Part of the loads on one side of zero load: on the other side, smaller ones may be the zero offset
# of a load cell, up to 2 % of its range, in a test that uses half the range.
ONE_SIDED = 0.05


@dataclass(frozen=True)
class Calibration:
    """The factors of the deviations of an output group."""

    # (q,), dimensionless: what a deviation is multiplied by for a 95 % error bar, per output
    factors: Floats
    # Process deviations: errors are unknown beyond it; 0 if they are unknown everywhere.
    max_sigma: float

    @classmethod
    def unknown(cls, outputs: int, settings: KrigingSettings = DEFAULTS) -> Calibration:
        """Return the calibration of rows that do not show how large errors are."""
        return cls(np.full(outputs, settings.half_width), 0.0)


class Errors(NamedTuple):
    """Errors of rows that were left out."""

    errors: Floats  # (k, q), process deviations
    sizes: Floats  # (k, q), dimensionless: see `LeftOutRows`
    sigma: Floats  # process deviations: the deviation of an answer at the row


def factors_of(residuals: Errors, n_derivatives: int, outputs: int) -> Floats:
    """Return the factors (q,) that hold 95 % of errors at the confidence of `widening`.

    The ratios |error| / sigma have a size per output, and a tail of the same shape for all
    outputs. The size comes from slopes as well as from values: `n_derivatives` numbers a row.

    `outputs`: of the table, all of which the confidence is for.
    """
    ratios = np.abs(residuals.errors) / residuals.sigma[:, None]
    square = (residuals.sizes**2).mean(axis=0)
    # The degrees of freedom are those of a chi square whose variance is that of the mean square
    # (Satterthwaite 1946): as many as rows where each brings one normal number, up to seven times
    # that where values and slopes are alike, and few where a few rows make most of the size.
    scatter = (residuals.sizes**4).mean(axis=0) / np.where(square > 0, square, 1.0) ** 2 - 1
    freedom = 2 * len(ratios) / np.maximum(scatter, 2 / n_derivatives)
    size = np.sqrt(square)
    return common_quantile(ratios, size) * size * widening(freedom, outputs)


def errors_of(factor: KrigingFactor, out: LeftOutRows, rows: Indices) -> Errors:
    """Return the errors of some rows (k,) that were left out, without the floor of all bars."""
    noise = factor.output_group.noise[rows]
    variances = out.variances[rows]
    # An observation differs from its answer by its noise and by the error of the mean, and both
    # variances add up to that of its error.
    squared = np.maximum(variances - noise, factor.min_variance)
    errors = out.errors[rows] * np.sqrt(squared / variances)[:, None]
    # The nugget's part of spreads is added to each bar separately.
    above = np.sqrt(np.maximum(errors**2 - factor.nugget, 0.0))
    part = np.divide(above, np.abs(errors), out=np.zeros_like(above), where=above > 0)
    above = above / np.sqrt(factor.variance)

    sigma = np.sqrt(squared)
    sizes = np.where(noise[:, None] > 0, above / sigma[:, None], part * out.sizes[rows])
    finite = np.isfinite(above).all(axis=1)
    return Errors(above[finite], sizes[finite], sigma[finite])


def multi_group_rows(x: Floats, scaling: Scaling) -> NDArray[np.bool_]:
    """Return which rows x (n, k) load more than one load group, shape (n,)."""
    loaded = np.abs(x - scaling.loads(np.zeros((1, x.shape[1])))) > ZERO_LOAD
    _, groups = load_groups(scaling)
    return ~np.any([~loaded[:, ~group].any(axis=1) for group in groups], axis=0)


class Kind(NamedTuple):
    """Rows whose left-out errors stand for the errors of queries of the same kind."""

    rows: NDArray[np.bool_]  # (n,)
    queries: Floats  # (m, 6), half ranges
    secondary_limits: Floats  # (2,), half ranges: `largest_secondary_loads` of these rows


def kinds_of(x: Floats, scaling: Scaling, span: Floats, settings: KrigingSettings) -> list[Kind]:
    """Return the kinds of rows x (n, k): rows that load several axes, and others.

    If few rows load several axes, all rows are one kind, for queries of one axis. If the rows of
    several axes span the loads of all rows, they alone show the errors of all queries.
    """
    full = multi_group_rows(x, scaling)
    if full.sum() < min(settings.full_rows, len(full) / 2):
        kinds = [(full | True, ~full)]
    else:
        kinds = [(full, full | True), (~full, ~full)]
        low, high = span_of(x[full], scaling, settings)
        if (low <= x.min(axis=0)).all() and (high >= x.max(axis=0)).all():
            kinds = kinds[:1]
    shown_kinds = []
    for rows, shown in kinds:
        if shown.any():
            limits = largest_secondary_loads(x[shown], scaling, settings)
            queries = query_points(span, limits, x[rows & shown], scaling, settings.queries)
            shown_kinds.append(Kind(rows, queries, limits))
    return shown_kinds


def span_of(x: Floats, scaling: Scaling, settings: KrigingSettings) -> Floats:
    """Return the ends of the loads that rows span, shape (2, 6), half ranges.

    The span reaches beyond the outermost rows by the largest gap, at the confidence of the
    settings, that evenly spread rows leave there: of n uniform numbers the largest is above the
    part a^(1/n) of their interval with the probability 1 - a. If rows are not evenly spread, n is
    twice the number of rows in the outer half: rows in the middle show nothing of the ends. A load
    that takes no part has no ends.

    Rows of tension show nothing of compression: a part may have play or a contact there. So on the
    side of zero load to which the rows hardly go (`ONE_SIDED`), the span reaches at most as far
    again.
    """
    low, high = x.min(axis=0), x.max(axis=0)
    outer = (np.abs(x - (low + high) / 2) >= (high - low) / 4).sum(axis=0)
    n = np.minimum(2 * outer, len(x))
    margin = (settings.beyond_rows ** (-1 / n) - 1) * (high - low) + NEAR
    zero = scaling.loads(np.zeros((1, x.shape[1])))[0]
    sides = np.stack((zero - low, high - zero))
    is_load = np.arange(x.shape[1]) < x.shape[1] - len(scaling.space.scalars)
    one_sided = is_load & (sides < ONE_SIDED * sides[::-1])
    margins = np.where(one_sided, np.minimum(margin, np.abs(sides) + NEAR), margin)
    ends = np.stack((low - margins[0], high + margins[1]))
    return np.where(scaling.active, ends, [[-np.inf], [np.inf]])


def largest_secondary_loads(x: Floats, scaling: Scaling, settings: KrigingSettings) -> Floats:
    """Return the largest `secondary_loads` of points (n, k), shape (2,), half ranges.

    The margin that the span of as many rows has is added.
    """
    return secondary_loads(x, scaling).max(axis=0) * settings.beyond_rows ** (-1 / len(x)) + NEAR


def query_points(
    span: Floats, secondary_limits: Floats, x: Floats, scaling: Scaling, count: int
) -> Floats:
    """Return `count` points like queries whose errors rows x (n, k) show, (count, k), half ranges.

    They are spread over the span of the rows, (2, k). Each point has the nonzero loads of one of
    the rows, and `secondary_loads` within the limits (2,).
    """
    active = np.isfinite(span[0])
    low, high = np.where(active, np.clip(span, -1.0, 1.0), 0.0)
    # A load that no row varies keeps the rows' value: at other values the mean is not determined.
    fixed = high - low <= FIXED_WIDTH * NEAR
    low, high = np.where(fixed, (low + high) / 2, [low, high])
    queries = spread_wrenches(LoadRange(low, high, scaling.space), count)
    at_rest = scaling.loads(np.zeros((1, queries.shape[1])))
    loaded = np.abs(x - at_rest) > ZERO_LOAD
    loaded = loaded[np.linspace(0, len(loaded) - 1, count).round().astype(np.intp)]
    apart = np.where(loaded | fixed, queries - at_rest, 0.0)
    for groups, limit in zip(load_groups(scaling), secondary_limits, strict=True):
        beside = np.stack([np.where(group, 0.0, np.abs(apart)).max(axis=1) for group in groups])
        main = groups[beside.argmin(axis=0)]
        apart = np.where(main | fixed, apart, np.clip(apart, -limit, limit))
    return at_rest + apart


def load_groups(scaling: Scaling) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks of single loads, (k, k), and of load groups, (g, k): axes, or interfaces."""
    groups = scaling.space.kriging_groups[:-1] > 0  # the last group has all loads
    return np.eye(groups.shape[1], dtype=bool), groups


def secondary_loads(x: Floats, scaling: Scaling) -> Floats:
    """Return the loads of points (n, k) besides the main load, and besides the main group, (n, 2).

    Half ranges. The first is the second largest load. The second is the largest load outside of the
    main load group (an axis, or an interface of several). Both are 0 for a single load, and the
    second is 0 for a wrench of one axis.
    """
    apart = np.abs(x - scaling.loads(np.zeros((1, x.shape[1]))))
    return np.stack(
        [
            np.min([np.where(group, 0.0, apart).max(axis=1) for group in groups], axis=0)
            for groups in load_groups(scaling)
        ],
        axis=1,
    )


def left_out_as_far(
    factor: KrigingFactor,
    leave_one_out: LeftOutRows,
    rows: Indices,
    distant: float,
    settings: KrigingSettings,
) -> tuple[Errors, Errors]:
    """Return the errors of rows (k,) left out at a distance from the rest, and of nearer rows.

    A row is left out together with as many of its nearest rows as the distance takes. Rows are
    taken in turn, each the farthest from those before: spread rows go before others, and rows left
    out with another are passed over. No row takes more than one in `min_left_out` of all rows,
    since then `min_left_out` rows could not be left out.

    `leave_one_out`: the errors of each row left out by itself.
    `distant`: the distance from the rest, process deviations.
    """
    scaled = factor.equations.x * np.sqrt(factor.hyperparameters.inverse_squares)
    count = len(scaled)
    noise = factor.output_group.noise
    near = rows[leave_one_out.variances[rows] - noise[rows] < distant**2]
    largest = count // settings.min_left_out + 1
    passed = np.zeros(count, dtype=np.bool_)
    with_nearest = LeftOutRows(*map(np.copy, leave_one_out))
    far_rows = list[int]()
    for row in rows[list(farthest_first(scaled[rows]))].tolist():
        if passed[row]:
            continue
        squared = ((scaled - scaled[row]) ** 2).sum(axis=1)
        # The row itself is first, before rows that differ only in loads of no influence.
        squared[row] = -1.0
        order = np.argsort(np.round(squared, DECIMALS), kind="stable")
        size, out = 1, leave_one_out
        while out.variances[row] - noise[row] < distant**2 and size < largest:
            size = min(size + (size + 1) // 2, largest)
            labels = np.full(count, -1, dtype=np.intp)
            labels[order[:size]] = 0
            out = left_out(factor, labels)
        passed[order[:size]] = True
        if out.variances[row] - noise[row] >= distant**2:
            far_rows.append(row)
            for old, new in zip(with_nearest, out, strict=True):
                old[row] = new[row]
    far = np.array(far_rows, dtype=np.intp)
    return errors_of(factor, with_nearest, far), errors_of(factor, leave_one_out, near)


def calibrated(
    neighbours: Neighbourhoods,
    leave_one_out: LeftOutRows,
    scaling: Scaling,
    kinds: Sequence[Kind],
    widenings: Floats,
) -> Calibration:
    """Return the factors of a group's deviations for 95 % error bars.

    `leave_one_out`: the errors of each row left out by itself.
    `widenings` (q,), dimensionless: see `Estimate.widening`.
    """
    factor, settings = neighbours.factor, neighbours.settings
    subset = factor.equations
    outputs = len(factor.output_group.outputs)
    n_mean = 1 + scaling.active.sum()
    shows_curvature = subset.known[:, 1:].any() or has_levels(subset.x[:, scaling.active])
    if not shows_curvature or subset.count <= n_mean:  # the mean takes all equations
        return Calibration.unknown(outputs, settings)
    parts = [_of_kind(kind, neighbours, leave_one_out) for kind in kinds]
    max_sigma = max(part.max_sigma for part in parts)
    if not max_sigma:
        return Calibration.unknown(outputs, settings)
    factors = np.max([part.factors for part in parts], axis=0)
    if factor.output_group.noise.any():
        # Noise hides the errors of left-out rows: bars hold the posterior and its uncertainty.
        freedom = max(float(len(subset) - n_mean), 1.0)
        least = widenings * settings.posterior_width
        factors = np.maximum(factors, least * widening(freedom, subset.data.shape[2]))
    return Calibration(factors, max_sigma)


def _of_kind(kind: Kind, neighbours: Neighbourhoods, leave_one_out: LeftOutRows) -> Calibration:
    """Return the factors from left-out rows of one kind; 0 where too few rows show errors."""
    factor, settings, equations = neighbours.factor, neighbours.settings, neighbours.equations
    size_of_table = 1 + equations.loads, equations.data.shape[2]
    # Rows are left out of the complete factor; answers have the deviation of a neighbourhood.
    explained = factor.explained_at(kind.queries)
    complete = np.sqrt(factor.variance_of(*explained, factor.mean_covariance))
    across = block(kind.queries, equations.x, factor.hyperparameters, 1, equations.n_derivatives)
    local = neighbours.deviations(kind.queries, across.reshape(len(kind.queries), -1))
    wider = float(np.quantile(local / complete, settings.neighbourhood_quantile))

    rows = np.flatnonzero(kind.rows[factor.output_group.rows])
    rows = rows[evenly(len(rows), settings.left_out_rows)]
    distant = settings.comparable * float(np.median(complete))  # as far as queries are
    far, near = left_out_as_far(factor, leave_one_out, rows, distant, settings)

    factors = np.zeros(len(factor.output_group.outputs))
    max_sigma = 0.0
    if len(far.sigma) >= settings.min_left_out:
        factors = np.maximum(factors, factors_of(far, *size_of_table) / wider)
        # As far as left-out rows and their neighbourhoods can be, comparable both ways.
        widest = float((local / complete).max())
        max_sigma = float(far.sigma.max()) * widest / settings.comparable
    if len(near.sigma) > max(len(far.sigma), settings.min_left_out):  # few show no tail
        factors = np.maximum(factors, factors_of(near, *size_of_table) / wider)
    return Calibration(factors, max_sigma)


def of_posterior(
    factor: KrigingFactor, covariances: Floats, settings: KrigingSettings
) -> Calibration:
    """Return the factors of a kriging through inducing wrenches: those of a normal distribution.

    The posterior deviation of many noisy rows is itself certain, and left-out rows show little but
    noise. Errors are known where no more of the prior is left than would be at an inducing wrench
    without it.

    `covariances` (m, m), dimensionless, are those of the inducing wrenches.
    """
    x, known = factor.equations.x, factor.equations.known
    nugget = factor.nugget * np.diag(np.diag(covariances))
    without = 1 / np.diag(np.linalg.inv(covariances + nugget))
    at = factor.variance_of(*factor.explained_at(x, known), factor.mean_covariance)
    far = float(np.quantile(np.sqrt(at + without), LEVEL))
    return Calibration(np.full(len(factor.variance), settings.half_width), far)
