"""The table of an axis: triangulation, values and slopes at its points, and the law of its errors.

Its error bars come from points left out of its triangulation. A left-out point shows the
errors of answers in simplices as large as that around it, and nothing about larger simplices: of
two points side by side each is answered by the other. So with a left-out point all points
within a radius of it are left out (buffered leave-one-out: Le Rest et al. 2014, "Spatial leave-one-
out cross-validation"), and one point stands for all within a cell of that size. At a point whose
neighbours are farther than r the unit error is at least r^2 / 2, so the radius for a typical unit
error S of the table is sqrt(2 PART S).

The error of piecewise linear interpolation grows with the size of a simplex. Linear interpolation
of a function with second derivatives H errs by half the barycentric mean of (x - x_v)' H (x - x_v)
over the vertices x_v. Of the function |x|^2 / 2, whose H is one, that is the *unit error* S(x) =
1/2 sum_v l_v |x - x_v|^2. So the error of any response is taken for noise of variance A and
curvature of variance C:

    95 % error bar = sqrt(A + C S^2)

A and C come from points left out of the interpolation. Such an error has the noise of the point
besides that of the vertices, which barycentric coordinates l_v weigh: squared errors are fitted by
a (1 + sum_v l_v^2) + c S^2, and a and c multiplied so that the bars hold 95 % of the errors. An
answer has the noise a sum_v l_v^2, at most a.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..calibration import common_quantile, conformal_factor, widening
from ..table.axes import MIN_STEP, AxisRows, has_levels, hashes
from ..table.rows import ROUNDING, SMALLEST, Floats, LoadRange
from .triangulation import Indices, Triangulation, recovered_slopes

# The largest fraction of the load range, by dimension, that one simplex may take before it is
# `thin`: half a range along a line, a fifth of a rectangle, a tenth of a box is no table.
LARGEST = {0: 1.0, 1: 0.4, 2: 0.2, 3: 0.1}

# Largest over smallest unit error (80 % of them) below which left-out errors do not separate noise
# from curvature, which grows by the square: rows of regular sweeps have equal unit errors.
ALIKE = 4.0

SOUND, WEAK, DEGENERATE = 0, 1, 2  # a simplex without volume is degenerate

# Of the median unit error over the load range. With a half, rows in twins, clusters and along
# motions have error bars that hold 90 to 96 % or none, and evenly spread rows lose a tenth of the
# points left out; with a quarter, motions had bars that held 48 %.
PART = 0.5
FOLDS = 4  # of evenly spread points, a quarter each: errors are those of 3/4 of the rows
MAX_LEFT_OUT = 2000  # points left out of a fold: their 95 % quantile is known to 1 %
# Points left out one at a time, or a few, where there are few: 60 are left out in ten folds.
FEW = 600
WORK = 8000  # points triangulated in all folds, if there is more than one: an axis of 2000 has four
# So that the same loads in other units, which differ by rounding, are left out in the same folds:
DECIMALS = 7  # of the range: points closer than 1e-6 merge
ASIDE = 0.382  # of a cell: rows of a grid lie on no border

# Of the error law:
FEWEST = 5  # left-out errors; the conformal factor of five is already 2.2 times the largest ratio
ROUNDS = 10  # of reweighting: the fit changes by less than a part in 100 after five
MIN_WEIGHT = 1e-6  # of the largest variance: what rounding leaves of small ones fits nothing
SINGULAR = 1e-12  # of its largest value, a determinant that does not separate A from C


@dataclass(frozen=True)
class ErrorLaw:
    """The error bars sqrt(A + C S^2) of several outputs.

    Attributes
    ----------
    noise_variance, curvature_variance : ndarray, shape (q,), m² and rad²
        A and C, NaN where errors are unknown. They are of 95 % error bars, not of deviations.
    """

    noise_variance: Floats
    curvature_variance: Floats

    @classmethod
    def unknown(cls, outputs: int = 6) -> ErrorLaw:
        """Return the law of outputs whose errors are not known."""
        return cls(np.full(outputs, np.nan), np.full(outputs, np.nan))

    @property
    def known(self) -> bool:
        """Whether the errors of all outputs are known."""
        return bool(np.isfinite(self.noise_variance).all())

    def bars(self, unit_error: Floats) -> Floats:
        """Return error bars (k, q), m and rad, at unit errors (k,), dimensionless."""
        return np.sqrt(self.noise_variance + self.curvature_variance * unit_error[:, None] ** 2)


class LeftOutErrors(NamedTuple):
    """Errors at k left-out points within the hull of the others, of q outputs.

    Attributes
    ----------
    size, uncertainty : ndarray, shape (k, q), m and rad
        Absolute errors, and the known uncertainty that every error bar has besides.
    unit_errors, noise_factors : ndarray, shape (k,), dimensionless
        S, and sum_v l_v^2.
    """

    size: Floats
    uncertainty: Floats
    unit_errors: Floats
    noise_factors: Floats


def error_law(errors: LeftOutErrors, min_bar: Floats) -> ErrorLaw:
    """Return the law that holds 95 % of left-out errors, unknown where they are too few.

    Parameters
    ----------
    min_bar : ndarray, shape (q,), m and rad
        The smallest error bar: rounding.
    """
    if len(errors.size) < FEWEST:
        return ErrorLaw.unknown(errors.size.shape[1])
    noise, growth = 1.0 + errors.noise_factors[:, None], errors.unit_errors[:, None] ** 2
    a, c = _variances(errors.size**2, noise, growth)
    bars = np.maximum(np.sqrt(a * noise + c * growth), min_bar)
    ratios = np.maximum(errors.size - errors.uncertainty, 0.0) / np.maximum(
        bars, np.finfo(float).tiny
    )
    # Each output by itself, or, where that is more, with the quantile that all have in common.
    sizes = np.sqrt((ratios**2).mean(axis=0))
    common = sizes * common_quantile(ratios, sizes) * widening(len(ratios))
    factor = np.maximum(conformal_factor(ratios), common) ** 2
    return ErrorLaw(np.maximum(factor * a, min_bar**2), factor * c)


def _variances(squares: Floats, noise: Floats, growth: Floats) -> tuple[Floats, Floats]:
    """Fit squared errors (k, q) by a noise + c growth, (k, 1) each, a and c not below zero.

    Least squares, weighted by the inverse square of the variance that the round before fitted:
    squared errors scatter in proportion to their mean. Unweighted, a few large simplices decide for
    all (measured: error bars 1.3 times as wide at 1,000 points).
    """
    size = growth.max()
    if not size > 0:
        return squares.mean(axis=0) / noise.mean(), np.zeros(squares.shape[1])
    t = growth / size
    model = np.tile(squares.mean(axis=0), (len(t), 1))
    a = c = np.zeros(squares.shape[1])
    for _ in range(ROUNDS):
        top = np.maximum(model.max(axis=0), np.finfo(float).tiny)
        weight = (top / np.maximum(model, MIN_WEIGHT * top)) ** 2
        n0, n1, n2 = (np.sum(weight * column, axis=0) for column in (noise**2, noise * t, t**2))
        y0, y1 = np.sum(weight * noise * squares, axis=0), np.sum(weight * t * squares, axis=0)
        determinant = n0 * n2 - n1**2
        separable = determinant > SINGULAR * n0 * n2
        over = 1.0 / np.where(separable, determinant, 1.0)
        a, c = (n2 * y0 - n1 * y1) * over, (n0 * y1 - n1 * y0) * over
        noiseless, constant = ~separable | (a < 0), separable & (c < 0)
        a = np.where(noiseless, 0.0, np.where(constant, y0 / n0, a))
        c = np.where(noiseless, y1 / n2, np.where(constant, 0.0, c))
        model = a * noise + c * t
    return a, c / size


class LeftOut(NamedTuple):
    """Errors at k points of an axis that were left out of a triangulation.

    Attributes
    ----------
    indices : ndarray of int, shape (k,)
        Of the axis' points, or of those that were not chosen.
    errors : ndarray, shape (k, 6), m and rad
        Interpolated less given displacement.
    unit_errors : ndarray, shape (k,), dimensionless
        Of the function |x|^2 / 2 (`error_law`).
    noise_factors : ndarray, shape (k,), dimensionless
        Sum of the squares of the barycentric coordinates.
    uncertainty : ndarray, shape (k, 6), m and rad
        Known uncertainty of the rows, interpolated.
    inside : ndarray of bool, shape (k,)
        Whether the hull of the other points holds the point.
    """

    indices: Indices
    errors: Floats
    unit_errors: Floats
    noise_factors: Floats
    uncertainty: Floats
    inside: NDArray[np.bool_]

    @property
    def inside_errors(self) -> LeftOutErrors:
        """The errors inside the hull."""
        columns = np.abs(self.errors), self.uncertainty, self.unit_errors, self.noise_factors
        return LeftOutErrors(*(column[self.inside] for column in columns))


def concatenated(parts: Sequence[LeftOut]) -> LeftOut:
    """Return the left-out points of all folds; none if there are no folds."""
    six, no_values = np.empty((0, 6)), np.empty(0)
    empty = LeftOut(
        no_values.astype(np.intp), six, no_values, no_values, six, no_values.astype(bool)
    )
    return LeftOut(*(np.concatenate(column) for column in zip(empty, *parts, strict=True)))


def folds(triangulation: Triangulation) -> list[tuple[Indices, NDArray[np.bool_]]]:
    """Return, per fold, the points left out, (k,), and which of all remain, (n,)."""
    points, count = triangulation.points, len(triangulation.points)
    radius = float(np.sqrt(2 * PART * typical_unit_error(triangulation)))
    if not radius > 0:
        return []
    # One point of each cell of a grid, (k,), in an order that no pattern of rows follows. By a
    # hash of each point alone: every fourth row of a grid would be a face of it.
    order = np.argsort(hashes(points.round(DECIMALS)), kind="stable")
    cells = np.floor(points[order] / radius + ASIDE)
    by_cell = np.lexsort(cells.T)  # stable: the first of a cell is the first of the order
    new = np.ones(len(order), dtype=bool)
    new[1:] = (cells[by_cell][1:] != cells[by_cell][:-1]).any(axis=1)
    chosen = order[np.sort(by_cell[new])]
    n_folds = max(min(FEW // len(chosen), len(chosen)), FOLDS)
    divided = []
    for out in np.array_split(chosen, n_folds)[: max(WORK // count, 1)]:
        if not len(out):
            continue
        distance = np.asarray(KDTree(points[out[:MAX_LEFT_OUT]]).query(points)[0])
        remaining = distance > radius
        if remaining.any():
            divided.append((out[:MAX_LEFT_OUT], remaining))
    return divided


def typical_unit_error(triangulation: Triangulation) -> float:
    """Return the median unit error over what the points span, dimensionless.

    Of each simplex that is the mean over its volume: half the sum of its squared edges over
    (d + 1)(d + 2).
    """
    corners, dimension = triangulation.points[triangulation.simplices], triangulation.dimension
    from_middle = corners - corners.mean(axis=1, keepdims=True)
    edges = (dimension + 1) * (from_middle**2).sum(axis=(1, 2))
    unit = 0.5 * edges / ((dimension + 1) * (dimension + 2))
    order = np.argsort(unit)
    volume = np.cumsum(triangulation.volumes[order])
    return float(unit[order][np.searchsorted(volume, 0.5 * volume[-1])])


@dataclass(frozen=True)
class AxisResult:
    """An axis' answers at k points: all six outputs.

    Attributes
    ----------
    outputs, error : ndarray, shape (k, 6), m and rad
        Barycentric outputs and their error bars, NaN where they are unknown.
    stepped : ndarray, shape (k, 6), m and rad
        The part of the outputs from the step off the hull; 0 inside.
    unit_errors : ndarray, shape (k,), dimensionless
        1/2 sum_v l_v |x - x_v|^2, from which the error bars follow.
    noise_factors : ndarray, shape (k,), dimensionless
        sum_v l_v^2: noise variance of the outputs over that of the rows.
    uncertainty : ndarray, shape (k, 6), m and rad
        Uncertainty of the rows, interpolated: the other part of the error bars.
    simplices : ndarray of int, shape (k,)
        Where the points, or the nearest points of the hull, lie.
    inside : ndarray of bool, shape (k,)
        Whether the hull holds the point. Elsewhere the outputs are those at the hull's nearest
        point and the step from there.
    at : ndarray, shape (k, 3), dimensionless
        The points, or those of the hull.
    """

    outputs: Floats
    error: Floats
    stepped: Floats
    unit_errors: Floats
    noise_factors: Floats
    uncertainty: Floats
    simplices: Indices
    inside: NDArray[np.bool_]
    at: Floats


class AxisTable:
    """The rows of an axis, triangulated.

    Attributes
    ----------
    rows : AxisRows
    others : AxisRows or None
        Points that an even choice left out of the triangulation.
    triangulation : Triangulation
        Over the scaled inputs.
    scale : ndarray, shape (3,), N and N·m
        What the inputs are divided by.
    values, uncertainty : ndarray, shape (n, 6), m and rad
        Displacements at the points, and the known uncertainty of the rows.
    slopes : ndarray, shape (n, 6, 3), m and rad
        Derivative by the scaled inputs: stored tangents, else recovered from neighbours.
    min_points : int
        Points that the axis needs not to be thin.
    """

    def __init__(self, rows: AxisRows, load_range: LoadRange, law: ErrorLaw | None = None) -> None:
        """Triangulate the rows, at least one.

        Parameters
        ----------
        law : ErrorLaw, optional
            If it is known already; else from points left out.
        """
        self.rows, self.axis = rows, rows.axis
        self.others: AxisRows | None = None
        self.scale = load_range.scale[list(rows.axis.inputs)]
        self.triangulation = Triangulation(rows.points)
        self.values, self.uncertainty = rows.displacement, rows.uncertainty
        self.min_points = 2 * (self.triangulation.dimension + 1)
        self.slopes = self._slopes()
        if law is not None:
            self.law = law

    @cached_property
    def left_out(self) -> LeftOut:
        """Errors at points that were left out; at `others`, if there are any."""
        if self.others is not None:
            chosen = np.linspace(0, len(self.others.points) - 1, MAX_LEFT_OUT).astype(np.intp)
            blind = copy(self)
            blind.law = ErrorLaw.unknown()
            return _errors_at(blind, self.others, np.unique(chosen))
        parts = [
            _errors_at(self._without(remaining), self.rows, out)
            for out, remaining in folds(self.triangulation)
        ]
        return concatenated(parts)

    @cached_property
    def n_multi_load(self) -> int:
        """The number of points with several loads at once."""
        return int(((np.abs(self.rows.points) > MIN_STEP).sum(axis=1) > 1).sum())

    @property
    def shows_multi_load(self) -> bool:
        """Whether rows show the effect of several loads at once."""
        return self.n_multi_load >= FEWEST

    @property
    def errors_shown(self) -> int:
        """The number of left-out points that show errors between the points."""
        return len(self.left_out.inside_errors.size) if has_levels(self.rows.points) else 0

    @cached_property
    def law(self) -> ErrorLaw:
        """Growth of error bars with the simplices; unknown where too few points can be left out.

        Unknown too where rows have few levels of a load: they show nothing between these.
        """
        if not has_levels(self.rows.points):
            return ErrorLaw.unknown()
        min_bar = np.maximum(ROUNDING * np.abs(self.values).max(axis=0), SMALLEST)
        errors = self.left_out.inside_errors
        if len(errors.size) >= FEWEST and _are_alike(errors.unit_errors):
            # Errors at left-out points whose neighbours remain: those show noise.
            all_points = np.ones(len(self.rows.points), dtype=bool)
            parts = []
            for out, _ in folds(self.triangulation) if self.others is None else ():
                remaining = all_points.copy()
                remaining[out] = False
                parts.append(_errors_at(self._without(remaining), self.rows, out))
            errors = concatenated([self.left_out, *parts]).inside_errors
        return error_law(errors, min_bar)

    @property
    def typical_error(self) -> Floats:
        """The median error bar at left-out points within the hull, (6,), m and rad; NaN if none."""
        if not self.law.known:
            return np.full(6, np.nan)
        errors = self.left_out.inside_errors
        return np.median(self.law.bars(errors.unit_errors) + errors.uncertainty, axis=0)

    @cached_property
    def state(self) -> NDArray[np.int32]:
        """`SOUND`, `WEAK` or `DEGENERATE`, of each simplex, shape (m,)."""
        return self.shape_state if self.law.known else np.maximum(self.shape_state, WEAK)

    @property
    def shape_state(self) -> NDArray[np.int32]:
        """The same, shape (m,), whether or not errors are known."""
        large = self.fractions() > LARGEST[self.triangulation.dimension]
        state = np.where(large | (not self.enough), WEAK, SOUND)
        state[self.triangulation.degenerate] = DEGENERATE
        return state.astype(np.int32)

    @property
    def enough(self) -> bool:
        """Whether there are points enough for what they span."""
        return len(self.values) >= self.min_points

    @property
    def n_candidates(self) -> int:
        """Points before the choice: more than n where the table was thinned."""
        return len(self.values) + (0 if self.others is None else len(self.others.points))

    def is_made_like(self, other: AxisTable) -> bool:
        """Return whether the other has the same triangulation, with the same simplices sound."""
        same = self.triangulation is other.triangulation
        return same and np.array_equal(self.state, other.state)

    def of(self, rows: AxisRows, others: AxisRows | None) -> AxisTable:
        """Return this table for rows of the same numbers, which may have other indices."""
        table = copy(self)
        table.rows, table.others = rows, others
        if others is not None or self.others is not None:
            for name in ("left_out", "law", "state"):
                vars(table).pop(name, None)
        return table

    def fractions(self) -> Floats:
        """Return the fraction of the load range that each simplex takes, shape (m,)."""
        dimension = self.triangulation.dimension
        if dimension == 0:
            return np.zeros(1)
        return self.triangulation.volumes / 2.0**dimension

    def read(self, x: Floats) -> AxisResult:
        """Return the axis' answers at scaled inputs, inside its hull or not.

        The inputs have shape (k, 3), dimensionless.
        """
        simplices = self.triangulation.locate(x)
        inside = simplices >= 0
        if inside.all():
            return self.read_in(simplices, x)
        at = x.copy()
        at[~inside], simplices[~inside] = self.triangulation.nearest_on_hull(x[~inside])
        result = self.read_in(simplices, at)
        # Slopes blended from the vertices are continuous along the hull; those of simplices jump.
        weights = self.triangulation.barycentric(simplices[~inside], at[~inside])
        corners = self.slopes[self.triangulation.simplices[simplices[~inside]]]
        slopes = self.along_span(np.einsum("kv,kvqi->kqi", weights, corners))
        result.stepped[~inside] = np.einsum("kqi,ki->kq", slopes, (x - at)[~inside])
        result.outputs[~inside] += result.stepped[~inside]
        return replace(result, inside=inside)

    def along_span(self, slopes: Floats) -> Floats:
        """Return slopes (k, 6, 3) by the scaled loads, projected on the span of the points."""
        basis = self.triangulation.basis
        return slopes if len(basis) == 3 else slopes @ basis.T @ basis

    def read_in(self, simplices: Indices, x: Floats) -> AxisResult:
        """Return the same at points of the simplices that they lie in.

        Shapes (k, 3), dimensionless, and (k,).
        """
        shape, vertices = self.triangulation, self.triangulation.simplices[simplices]
        weights = shape.barycentric(simplices, x)
        outputs = np.einsum("kv,kvq->kq", weights, self.values[vertices])
        delta = x[:, None] - shape.points[vertices]
        unit = np.maximum(0.5 * np.einsum("kv,kvi,kvi->k", weights, delta, delta), 0.0)
        uncertainty = np.einsum("kv,kvq->kq", weights, self.uncertainty[vertices])
        return AxisResult(
            outputs=outputs,
            error=self.law.bars(unit) + uncertainty,
            stepped=np.zeros_like(outputs),
            unit_errors=unit,
            noise_factors=(weights**2).sum(axis=1),
            uncertainty=uncertainty,
            simplices=simplices,
            inside=np.ones(len(x), dtype=bool),
            at=x,
        )

    def in_middles(self) -> tuple[Floats, Floats]:
        """Return the middles of the simplices and the error bars there, but not the outputs.

        Shapes (s, 3), dimensionless, and (s, 6), m and rad.
        """
        shape = self.triangulation
        corners = shape.points[shape.simplices]
        middle = corners.mean(axis=1)
        unit = 0.5 * ((middle[:, None] - corners) ** 2).sum(axis=2).mean(axis=1)
        return middle, self.law.bars(unit) + self.uncertainty[shape.simplices].mean(axis=1)

    def _slopes(self) -> Floats:
        """Return the rows' tangents, else slopes recovered from neighbours."""
        stored = np.isfinite(self.rows.tangent)
        if stored.all():
            return self.rows.tangent
        recovered = recovered_slopes(self.triangulation, self.values)
        return np.where(stored, self.rows.tangent, recovered)

    def _without(self, remaining: NDArray[np.bool_]) -> AxisTable:
        """Return a table of some points alone, of unknown errors, with the same slopes."""
        part = copy(self)
        part.triangulation = Triangulation(self.rows.points[remaining])
        part.values, part.slopes = self.values[remaining], self.slopes[remaining]
        part.uncertainty, part.law = self.uncertainty[remaining], ErrorLaw.unknown()
        return part


def _errors_at(table: AxisTable, rows: AxisRows, indices: Indices) -> LeftOut:
    """Return a table's errors at some rows that were left out of it."""
    result = table.read(rows.points[indices])
    errors = result.outputs - rows.displacement[indices]
    units, factors = result.unit_errors, result.noise_factors
    return LeftOut(indices, errors, units, factors, result.uncertainty, result.inside)


def axis_table(
    rows: AxisRows,
    load_range: LoadRange,
    before: AxisTable | None,
    others: AxisRows | None = None,
) -> AxisTable:
    """Return the table of an axis' rows, at least one.

    Parameters
    ----------
    before : AxisTable or None
        Of another version: taken over where it was made of the same numbers, the only
        input.
    others : AxisRows, optional
        Points that were not chosen.
    """
    scale = load_range.scale[list(rows.axis.inputs)]
    usable = before is not None and np.array_equal(before.scale, scale)
    if before is None or not usable or not rows.equals(before.rows):
        before = AxisTable(rows, load_range)
    return before.of(rows, others)


def _are_alike(unit_errors: Floats) -> bool:
    """Return whether unit errors (k,), dimensionless, hardly differ."""
    low, high = np.quantile(unit_errors, (0.1, 0.9))
    return bool(high <= ALIKE * low)
