"""The factors by which posterior deviations are multiplied to hold 95 % of the errors.

A left-out row shows the errors of answers at the same distance from their rows, and nothing of
answers further away. So rows are left out in groups (complete linkage in the metric
of the length scales): at first each by itself, then with their neighbours, until the deviations at
what is left out are as large as those at random wrenches of the loads that the rows span. Each
level of grouping gives a deviation and a factor for it; in between the factor is interpolated.
Beyond the deviations of left-out rows, and where no three groups reach half of what random wrenches
have (rows along a motion), errors are not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist

from ..calibration import common_quantile, widening
from ..table.axes import ZERO_LOAD, has_levels
from ..table.rows import NEAR, Floats, LoadRange
from ..table.spread import spread_wrenches
from .correlation import block, numbers
from .equations import Equations, Scaling
from .factor import KrigingFactor, Neighbourhoods, left_out
from .settings import DEFAULTS, KrigingSettings

Labels = NDArray[np.intp]

# Levels whose deviations differ by less are merged: where deviations are those of the nugget,
# groups do not change them, and the largest factor is theirs.
LEVEL_RATIO = 1.05

QUERIES = 256  # random wrenches in place of queries: their median is known to a tenth of its size
# Of the distance within which rows merge: what the span leaves on both sides of a load that no
# row varies, and rounding.
FIXED_WIDTH = 2.5


@dataclass(frozen=True)
class Calibration:
    """The factors of the deviations of an output group.

    Attributes
    ----------
    sigma : ndarray, shape (k,), process deviations
        Ascending; none where errors are not known.
    factors : ndarray, shape (k, q), dimensionless
        What a deviation of `sigma` is multiplied by for a 95 % error bar, per output.
    max_sigma : float, process deviations
        Beyond it errors are not known; 0 if they are nowhere.
    """

    sigma: Floats
    factors: Floats
    max_sigma: float

    @classmethod
    def unknown(cls, outputs: int, settings: KrigingSettings = DEFAULTS) -> Calibration:
        """Return the calibration of rows that do not show how large errors are."""
        return cls(np.ones(1), np.full((1, outputs), settings.half_width), 0.0)

    @property
    def known(self) -> bool:
        """Whether left-out rows show how large errors are."""
        return self.max_sigma > 0

    def at(self, sigma: Floats) -> Floats:
        """Return the factors (m, q) of deviations (m,), process deviations, known or not."""
        columns = [np.interp(sigma, self.sigma, column) for column in self.factors.T]
        return np.stack(columns, axis=1)


class Level(NamedTuple):
    """Rows left out in groups of one size: dimensionless.

    Attributes
    ----------
    groups : ndarray of int, shape (k,)
        Group of each row left out.
    errors : ndarray, shape (k, q), process deviations
    sizes : ndarray, shape (k, q)
        See `LeftOutRows`.
    sigma : ndarray, shape (k,), process deviations
        As an answer at the row would have it.
    n_derivatives : int
        Values and slopes of a row.
    outputs : int
        Of the table, all of which the confidence is for.
    """

    groups: Labels
    errors: Floats
    sizes: Floats
    sigma: Floats
    n_derivatives: int = 7
    outputs: int = 6


def groupings(points: Floats, settings: KrigingSettings = DEFAULTS) -> Iterator[Labels]:
    """Yield groups of points (n, 6), scaled by length scales: each alone, then fewer and larger."""
    count = len(points)
    tree = linkage(pdist(points), "complete") if count > 1 else np.empty((0, 4))
    n_groups, n_before = count, count + 1
    while n_groups >= settings.min_groups:
        labels = fcluster(tree, n_groups, "maxclust") if len(tree) else np.ones(count, dtype=int)
        if labels.max() < n_before:
            n_before = int(labels.max())
            yield np.asarray(labels, dtype=np.intp)
        n_groups = min(int(n_groups / settings.group_growth), n_groups - 1)


def calibrate(
    levels: Iterator[Level],
    outputs: int,
    sigma_of_queries: Floats,
    coefficients: float,
    settings: KrigingSettings = DEFAULTS,
) -> Calibration:
    """Return the factors that levels of ever larger groups show.

    Parameters
    ----------
    levels : iterator of Level
        Taken for as long as left-out rows are nearer to the others than queries are to rows.
    outputs : int
        Number of outputs of a level.
    sigma_of_queries : ndarray, shape (m,), process deviations
        At random wrenches of the loads that the rows span.
    coefficients : float
        Of the mean, which single rows determine too.
    """
    typical_sigma = np.median(sigma_of_queries)
    far_sigma = np.quantile(sigma_of_queries, settings.query_quantile)
    sigma, factors, max_sigma, comparable = [], [], 0.0, False
    factors_so_far, min_factor = np.zeros(1), settings.half_width
    for level in levels:
        median = float(np.median(level.sigma))
        if median >= settings.comparable * typical_sigma:
            min_factor = 0.0  # rows at the distance of queries: their errors decide
        new = _factors(level, coefficients if not sigma else 0.0, settings, sure=not comparable)
        if new is None:
            break
        comparable |= median >= settings.comparable * typical_sigma
        factors_so_far = np.maximum(factors_so_far, np.maximum(new, min_factor))
        max_sigma = max(max_sigma, float(np.quantile(level.sigma, settings.max_sigma_quantile)))
        if sigma and median <= LEVEL_RATIO * sigma[-1]:
            factors[-1] = factors_so_far
        else:
            sigma.append(median)
            factors.append(factors_so_far)
        if max_sigma >= far_sigma and comparable:
            break
    if not sigma or sigma[-1] < settings.barely_comparable * typical_sigma:
        return Calibration.unknown(outputs, settings)
    return Calibration(np.array(sigma), np.array(factors), max_sigma)


def _factors(
    level: Level, coefficients: float, settings: KrigingSettings, *, sure: bool
) -> Floats | None:
    """Return the factors (q,) that hold 95 % of a level's errors; None if it shows no size.

    The ratios |error| / sigma have a size per output, and a tail of the same shape for all
    outputs. The size comes from slopes as well as from values: seven numbers a row. Groups count
    alike, however many rows they have.

    Parameters
    ----------
    sure : bool
        Whether sizes are widened for the small number of groups.
    """
    group = np.unique(level.groups, return_inverse=True)[1]
    count = int(group.max()) + 1
    weights = 1.0 / np.bincount(group)[group]
    ratios = np.abs(level.errors) / level.sigma[:, None]
    squares = np.stack(
        [np.bincount(group, weights * column**2, count) for column in level.sizes.T], axis=1
    )
    square = squares.mean(axis=0)
    tail = common_quantile(ratios, np.sqrt(square), weights)
    size = np.sqrt(np.where(square > 0, square, 1.0))
    scatter = (squares**2).mean(axis=0) / size**4 - 1
    # Values and slopes of a row are up to seven independent numbers; rows of one group are alike.
    scatter = np.maximum(scatter, 2 / level.n_derivatives if count == len(group) else 2.0)
    degrees = np.maximum(count - coefficients, 1.0)
    # The factor by which sizes may exceed those of the groups, (q,), in any output of the table.
    # The degrees of freedom are those of a chi square whose variance is that of the mean square
    # (Satterthwaite 1946): as many as groups where each brings one normal number, up to seven times
    # that where values and slopes of single rows are alike, and few where a few groups make most of
    # the size.
    widenings = widening(2 * degrees / scatter, level.outputs)
    factors = tail * size * (widenings if sure else 1.0)
    inside = (weights[:, None] * (ratios <= factors)).sum(axis=0) / count
    # Below the deviation that the nugget allows errors are rounding, whose size means nothing.
    matter = (np.abs(level.errors) > np.sqrt(settings.nugget)).any(axis=0)
    bad = (widenings > settings.max_widening) | (inside < settings.min_inside)
    return None if (matter & bad).any() else factors


def full_rows(equations: Equations, scaling: Scaling) -> NDArray[np.bool_]:
    """Return which rows load more than one load group, shape (n,)."""
    at_rest = scaling.loads(np.zeros((1, equations.loads)))
    loaded = np.abs(equations.x - at_rest) > ZERO_LOAD
    groups = equations.groups[:-1] > 0  # the last sees all loads
    return ~np.any([~loaded[:, ~group].any(axis=1) for group in groups], axis=0)


def query_points(
    equations: Equations, scaling: Scaling, span: Floats, settings: KrigingSettings
) -> Floats:
    """Return points like those of queries, spread over the span of rows, (m, 6), half ranges.

    Where nearly all rows load one axis each, these have the loads at once that rows have.
    """
    active = np.isfinite(span[0])
    low, high = np.where(active, np.clip(span, -1.0, 1.0), 0.0)
    # A load that no row varies stays as the rows have it: off that the mean is not determined.
    fixed = high - low <= FIXED_WIDTH * NEAR
    low, high = np.where(fixed, (low + high) / 2, [low, high])
    queries = spread_wrenches(LoadRange(low, high, scaling.space), QUERIES)
    full = full_rows(equations, scaling)
    if full.sum() < min(settings.full_rows, len(full) / 2):
        at_rest = scaling.loads(np.zeros((1, equations.loads)))
        loaded = np.abs(equations.x - at_rest) > ZERO_LOAD
        loaded = loaded[np.linspace(0, len(loaded) - 1, QUERIES).round().astype(np.intp)]
        queries = np.where(loaded, queries, at_rest)
    return queries


def calibrated(
    equations: Equations,
    neighbours: Neighbourhoods,
    table: Floats,
    scaling: Scaling,
    queries: Floats,
    widenings: Floats,
    settings: KrigingSettings,
) -> Calibration:
    """Return the factors of a group's deviations for 95 % error bars.

    Parameters
    ----------
    queries : ndarray, shape (m, 6), half ranges
    widenings : ndarray, shape (q,), dimensionless
        See `Estimate.widening`.
    """
    subset, outputs = (
        neighbours.factor.equations,
        len(neighbours.factor.output_group.outputs),
    )
    if not subset.known[:, 1:].any() and not has_levels(subset.x[:, scaling.active]):
        return Calibration.unknown(outputs, settings)
    full = full_rows(subset, scaling)
    # Queries load all axes too, and rows at the corners of one axis err more.
    rows = np.flatnonzero(full) if full.sum() >= settings.full_rows else np.arange(len(subset))
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), settings.left_out_rows))
    rows = rows[np.unique(chosen.round().astype(np.intp))]
    hyperparameters = neighbours.factor.hyperparameters
    levels = (
        level
        for labels in groupings(subset.x * np.sqrt(hyperparameters.inverse_squares), settings)
        if (level := _level(equations, neighbours, table, labels, rows)) is not None
    )
    across = block(queries, equations.x, hyperparameters, 1, equations.n_derivatives)
    sigma = neighbours.deviations(queries, across.reshape(len(queries), -1))
    # The mean's coefficients, which all rows determine: these in proportion.
    coefficients = (1 + scaling.active.sum()) * len(rows) / len(subset)
    found = calibrate(levels, outputs, sigma, coefficients, settings)
    if neighbours.factor.output_group.noise.any():
        # Noise hides the errors of left-out rows: bars hold the posterior, and what it leaves open.
        freedom = max(float(len(subset)) - coefficients, 1.0)
        least = widenings * settings.posterior_width
        least *= widening(freedom, equations.data.shape[2])
        # Left-out rows lie a row's distance from the others, wrenches between: sigma is that of the
        # posterior, which holds as far as that.
        far = found.max_sigma / settings.comparable
        found = replace(found, factors=np.maximum(found.factors, least), max_sigma=far)
    return found


def of_posterior(factor: KrigingFactor, table: Floats, settings: KrigingSettings) -> Calibration:
    """Return the factors of a kriging through inducing wrenches: the normal ones.

    So many noisy rows tell the deviation itself; left-out ones show little but noise. Errors are
    known where no more of the prior is left than would be at an inducing wrench without it.
    `table` (m, m), dimensionless, is the covariance of the inducing wrenches.
    """
    x, known = factor.equations.x, factor.equations.known
    nugget = factor.nugget * np.diag(np.diag(table))
    without = 1 / np.diag(np.linalg.inv(table + nugget))
    at = factor.variance_of(*factor.explained_at(x, known), factor.mean_covariance)
    far = float(np.quantile(np.sqrt(at + without), settings.max_sigma_quantile))
    return Calibration(np.ones(1), np.full((1, len(factor.variance)), settings.half_width), far)


def _level(
    equations: Equations,
    neighbours: Neighbourhoods,
    table: Floats,
    labels: NDArray[np.intp],
    rows: NDArray[np.intp],
) -> Level | None:
    """Return errors and deviations of a factor's rows left out in groups; None without any.

    Errors are of the full factor; sigma, as in answers, of the nearest row's neighbourhood.
    """
    factor, subset = neighbours.factor, neighbours.factor.equations
    if len(np.unique(labels)) < 2:
        return None
    out = left_out(factor, labels)
    # Of all other rows, if answers are: what their errors should have without the row's noise.
    squared = out.variances[rows] - factor.output_group.noise[rows]
    value_numbers = numbers(equations.known)[factor.output_group.rows, 0]
    lists: list[Labels] = []
    if not neighbours.whole:
        anchors = neighbours.nearest_others(rows, labels)
        lists = neighbours.members(subset.x[anchors], labels, labels[rows])
    for index, (row, near) in enumerate(zip(rows, lists, strict=False)):
        local = neighbours.local_factor(near, table)
        across, terms = (
            table[value_numbers[row], local.numbers],
            np.append(1.0, subset.x[row]),
        )
        variance = local.squared_deviation(across[None], terms[None], out.mean_covariances[row])
        squared[index] = variance[0] + factor.min_variance
    # With hardly more rows than the mean has terms, rounding leaves no variance to speak of.
    finite = np.isfinite(out.errors[rows]).all(axis=1)
    known = np.flatnonzero((squared > 0) & finite)
    if not len(known):
        return None
    sigma, known_rows = np.sqrt(squared[known]), rows[known]
    noise = factor.output_group.noise[known_rows]
    errors = out.errors[known_rows] / np.sqrt(factor.variance)
    # An observation differs from its answer by its noise and by the error of the mean, and both
    # variances add up to that of its error: variances and noise have shape (k,), process
    # variances.
    variances = out.variances[known_rows]
    errors = errors * np.sqrt(np.maximum(variances - noise, 0.0) / variances)[:, None]
    by_value = np.abs(errors) / sigma[:, None]
    sizes = np.where((noise > 0)[:, None], by_value, out.sizes[known_rows])
    outputs = equations.data.shape[2]
    return Level(labels[known_rows], errors, sizes, sigma, 1 + equations.loads, outputs)
