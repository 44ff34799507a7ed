"""From rows to equations: scaled, and sorted by wrench."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..table.merging import Observations, close_groups
from ..table.rows import ZERO_LOAD, Floats, LoadRange, RowError, Rows
from ..table.second_derivatives import second_derivatives
from ..table.space import Space
from .correlation import SECOND_SMOOTHNESS, SLOPES_SMOOTHNESS, Mask, derivative_count, indices
from .settings import DEFAULTS, KrigingSettings

DECIMALS = 12  # decimals of scaled loads: a thousandth of the accuracy of error bars
BLOCK = 20_000  # rows whose equations are made at once: 7 MB of values and slopes


class TooFewRowsError(RowError):
    """A table with too few rows in its load range for a kriging."""


@dataclass(frozen=True, eq=False)
class Scaling:
    """Conversion between SI and the dimensionless numbers of a kriging."""

    # centre, half: (6,), N and N·m: middle and half width of each load's range
    centre: Floats
    half: Floats
    active: Mask  # (6,): loads that can occur and that move some output; the others take no part
    # offset, spread: (6,), m and rad: mean and standard deviation of each output over the rows; the
    # spread is 1 for an output that does not vary
    offset: Floats
    spread: Floats
    constant: Mask  # (6,): outputs that vary by rounding only
    space: Space

    def loads(self, wrenches: Floats) -> Floats:
        """Return wrenches (n, 6), N and N·m, in half ranges from the centre; inert loads are 0."""
        return np.where(self.active, (wrenches - self.centre) / self.half, 0.0)

    def wrenches(self, points: Floats) -> Floats:
        """Return wrenches (n, 6), N and N·m, of points in half ranges from the centre."""
        return self.centre + points * self.half


@dataclass(frozen=True, eq=False)
class Equations:
    """Values and derivatives of a table's rows, scaled, row by row: all are dimensionless."""

    x: Floats  # (n, 6), half ranges
    # (n, p): which derivatives a row brings: value, slopes, and second derivatives if any row has
    # them
    known: Mask
    data: Floats  # (n, p, 6), spreads: of the six outputs; zero where not known
    measured: Mask  # (n, 6): which outputs a row brings
    noise: Floats  # (n, 6), spreads squared: variance of the values
    # (n, 6): number of observations of unknown noise whose mean a value is; 0 where noise is known
    observations: Floats
    # (n, 6), spreads squared: sum of these observations' squared differences from their mean
    scatter: Floats
    groups: Floats  # (g, n): which loads each term of the covariance sees: `Space.kriging_groups`

    def __len__(self) -> int:
        return len(self.x)

    @property
    def loads(self) -> int:
        """The number of loads of a wrench."""
        return self.x.shape[1]

    @property
    def n_derivatives(self) -> int:
        """The number of derivatives of an output per row: value, slopes, second derivatives."""
        return self.known.shape[1]

    @property
    def smoothness(self) -> int:
        """The p of the correlation Matern p + 1/2."""
        return SECOND_SMOOTHNESS if self.n_derivatives > 1 + self.loads else SLOPES_SMOOTHNESS

    @property
    def weights(self) -> int:
        """The number of weights among the hyperparameters.

        It is one per term if rows bring second derivatives, else 1.
        """
        return len(self.groups) if self.n_derivatives > 1 + self.loads else 1

    @property
    def count(self) -> int:
        """The number of equations."""
        return int(self.known.sum())

    def take(self, which: NDArray[np.intp]) -> Equations:
        """Return the equations of some rows, whose indices have shape (k,)."""
        names = (field.name for field in fields(self) if field.name != "groups")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    @property
    def typical_noise(self) -> Floats:
        """Median of each output's stated variances, (6,), spreads squared; 1 if none is stated."""
        stated = [column[column > 0] for column in self.noise.T]
        return np.array([np.median(column) if len(column) else 1.0 for column in stated])

    @property
    def unit_noise(self) -> Floats:
        """The variance of values for a noise factor of 1, (n, 6), spreads squared.

        The stated variance; for a mean of k readings of unknown noise, 1/k of the typical variance.
        """
        averaged = self.observations > 0
        unknown = self.typical_noise / np.where(averaged, self.observations, 1.0)
        return np.where(averaged, unknown, self.noise)


def indices_within(rows: Rows, load_range: LoadRange) -> NDArray[np.intp]:
    """Return the indices of the rows inside the load range, shape (k,), sorted by wrench."""
    margin = ZERO_LOAD * load_range.scale
    inside = (rows.wrench >= load_range.low - margin) & (rows.wrench <= load_range.high + margin)
    indices = np.flatnonzero(inside.all(axis=1))
    columns = np.concatenate((rows.wrench[indices], rows.displacement[indices]), axis=1)
    return indices[np.lexsort(columns.T[::-1])]


def scaling_of(rows: Rows, load_range: LoadRange, settings: KrigingSettings = DEFAULTS) -> Scaling:
    """Return the scaling of rows that lie in the load range.

    Raises TooFewRowsError if fewer rows than `min_rows` lie in the range, or fewer measure an
    output.
    """
    counts = np.isfinite(rows.displacement).sum(axis=0)
    if counts.min() < settings.min_rows:
        name = load_range.space.output_names[int(counts.argmin())]
        raise TooFewRowsError(
            f"kriging needs {settings.min_rows} rows of each output in the load range, but {name} "
            f"has {counts.min()}; solve or import more rows"
        )
    centre = (load_range.low + load_range.high) / 2
    offset = np.nanmean(rows.displacement, axis=0)
    spread = np.nanstd(rows.displacement, axis=0)
    largest = load_range.space.largest_of_kind(spread)
    # If no output of a kind varies, the limit follows from the outputs' size instead.
    size = np.maximum(largest, np.abs(offset) * settings.rounding)
    constant = spread <= settings.rounding * size

    # Loads that have a range and, where all rows have slopes, move some output.
    active = load_range.high > load_range.low
    tangents = rows.compliance[_with_slopes(rows)]
    if len(tangents) == len(rows):
        moved = np.abs(tangents).max(axis=0) * load_range.scale
        moved = moved / np.where(constant, np.inf, spread)[:, None]
        active = active & (moved > settings.rounding).any(axis=0)
    return Scaling(
        centre=centre,
        half=load_range.scale,
        active=active,
        offset=offset,
        spread=np.where(spread > 0, spread, 1.0),
        constant=constant,
        space=load_range.space,
    )


def _with_slopes(rows: Rows) -> Mask:
    """Return which rows bring a full finite compliance and all outputs, shape (n,)."""
    return rows.has_tangent & np.isfinite(rows.displacement).all(axis=1)


def equations_of(
    rows: Rows, scaling: Scaling, readings: Observations, settings: KrigingSettings = DEFAULTS
) -> Equations:
    """Return the equations of rows of distinct wrenches, and of the observations behind each."""
    with_slopes = _with_slopes(rows)
    curved = np.isfinite(rows.curvature).all(axis=1) & with_slopes & (rows.curvature.shape[1] > 0)
    measured = np.isfinite(rows.displacement)
    loads, outputs = rows.wrench.shape[1], rows.displacement.shape[1]
    n_derivatives = derivative_count(loads, 2 if curved.any() else 1)
    known = np.zeros((len(rows), n_derivatives), dtype=bool)
    data = np.zeros((len(rows), n_derivatives, outputs))

    known[:, 0] = True
    data[:, 0] = np.where(measured, (rows.displacement - scaling.offset) / scaling.spread, 0.0)
    known[:, 1 : 1 + loads] = with_slopes[:, None] & scaling.active
    slopes = rows.compliance * scaling.half / scaling.spread[:, None]
    data[:, 1 : 1 + loads] = slopes.transpose(0, 2, 1)
    if curved.any():
        first, second = np.array(indices(loads, 2)[1 + loads :]).T
        known[:, 1 + loads :] = curved[:, None] & scaling.active[first] & scaling.active[second]
        part = rows.take(np.flatnonzero(curved))
        derivatives = second_derivatives(
            part.wrench, part.displacement, part.compliance, part.curvature, scaling.space
        )
        scaled = derivatives[:, :, first, second] * (scaling.half[first] * scaling.half[second])
        data[curved, 1 + loads :] = (scaled / scaling.spread[:, None]).transpose(0, 2, 1)
    data[~known] = 0.0

    half_widths = np.nan_to_num(rows.uncertainty) / scaling.spread
    equations = Equations(
        # Rounded, so that another unit's rounding is not blown up by the covariance's condition.
        x=np.round(scaling.loads(rows.wrench), DECIMALS),
        known=known,
        data=data,
        measured=measured,
        noise=np.where(readings.number > 0, 0.0, (half_widths / settings.half_width) ** 2),
        observations=readings.number,
        scatter=readings.scatter / scaling.spread**2,
        groups=scaling.space.kriging_groups,
    )
    if scaling.active.all():
        return equations
    # Rows that differ only in loads without effect are equal.
    return equations.take(np.unique(close_groups(equations.x), return_index=True)[1])


def farthest_first(points: Floats) -> Iterator[int]:
    """Yield the indices of points (n, k): near the origin, then the farthest from those before."""
    row = int(np.argmin(np.round((points**2).sum(axis=1), DECIMALS)))
    distance = np.full(len(points), np.inf)
    for _ in points:
        yield row
        distance = np.minimum(distance, ((points - points[row]) ** 2).sum(axis=1))
        row = int(np.argmax(np.round(distance, DECIMALS)))


def evenly(count: int, limit: int) -> NDArray[np.intp]:
    """Return the indices of at most `limit` of `count` sorted rows, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, limit)).round().astype(np.intp))


def values_of(
    rows: Rows, scaling: Scaling, readings: Observations, settings: KrigingSettings = DEFAULTS
) -> Equations:
    """Return the equations of measured rows, values alone (p = 1), for any number of rows."""
    parts = []
    for start in range(0, len(rows), BLOCK):
        which = np.arange(start, min(start + BLOCK, len(rows)))
        part = equations_of(rows.take(which), scaling, readings.take(which), settings)
        parts.append(replace(part, known=part.known[:, :1], data=part.data[:, :1].copy()))
    names = [field.name for field in fields(Equations) if field.name != "groups"]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    return replace(parts[0], **columns)
