"""The interpolation of the stored fields of several rows, with its error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.tensors import von_mises
from wrenchbook.service.fields.record import RowFields, SurfaceGeometry
from wrenchbook.surrogate.calibration import LEVEL, conformal_factor
from wrenchbook.surrogate.field_weights import FieldWeights, nearest_rows
from wrenchbook.surrogate.table.rows import Floats

MIN_LEFT_OUT = 4  # rows with a surface: fewer do not show the size of the error
ARRAYS = 7  # arrays of a row: its fields, and their slopes by each of six loads


class BlendedFields(NamedTuple):
    """Interpolated fields at one wrench."""

    displacement: Floats  # (v, 3), m
    error: Floats | None  # (v,), m; None with too few rows
    stress: Floats | None  # (p, 6), Pa
    stress_error: float | None  # Pa, error of the largest von Mises stress


@dataclass(frozen=True, eq=False)
class Blend:
    """An interpolation of the fields of k rows, linear in them.

    `values`, shape (k, 7, d): of each row its fields, then their slopes by each of six loads. The d
    columns are the displacements, 3 of each vertex, then the stresses, 6 of each point.
    """

    geometry: SurfaceGeometry
    weights: FieldWeights
    values: Floats
    rows: tuple[int, ...]  # numbers (`seq`) of the rows
    largest: float  # m: largest displacement in any row
    spread: Floats | None  # (v,), m: ratio of a vertex's error to sigma; None with too few rows
    factor: float  # factor on sigma times spread
    stress_factor: float | None  # Pa: error bar of the largest von Mises stress over sigma

    @classmethod
    def of(
        cls,
        geometry: SurfaceGeometry,
        weights: FieldWeights,
        rows: Sequence[RowFields],
        numbers: tuple[int, ...],
    ) -> Blend:
        """Return the interpolation of rows that share a geometry."""
        values = np.stack([_stacked_fields(row) for row in rows])
        n_displacements = 3 * len(geometry.vertices)
        largest = float(np.abs(values[:, 0, :n_displacements]).max(initial=0.0))
        without_errors = cls(geometry, weights, values, numbers, largest, None, 0.0, None)
        if len(rows) < MIN_LEFT_OUT:
            return without_errors
        errors, sigmas = weights.left_out(values)
        lengths = np.linalg.norm(errors[:, :n_displacements].reshape(len(rows), -1, 3), axis=2)
        ratios = lengths / sigmas[:, None]
        spread = np.sqrt((ratios**2).mean(axis=0))
        relative = ratios / np.where(spread > 0, spread, 1.0)
        factor = float(conformal_factor(np.quantile(relative, LEVEL, axis=1)[:, None])[0])
        stress_factor = None
        if values.shape[2] > n_displacements:
            # The predicted largest stress of each left-out row is compared with its true one.
            predicted = values[:, 0, n_displacements:] - errors[:, n_displacements:]
            predicted = von_mises(predicted.reshape(len(rows), -1, 6)).max(axis=1)
            true = np.array([row.meta["largest"] for row in rows])
            stress_factor = float(conformal_factor((np.abs(predicted - true) / sigmas)[:, None])[0])
        return replace(without_errors, spread=spread, factor=factor, stress_factor=stress_factor)

    def at(self, wrench: Floats) -> BlendedFields:
        """Return the fields at a wrench (6,), N and N·m."""
        weights, sigma = self.weights.at(wrench)
        fields = np.tensordot(weights, self.values, axes=2)
        n_displacements = 3 * len(self.geometry.vertices)
        displacement = fields[:n_displacements].reshape(-1, 3)
        error = None if self.spread is None else self.factor * sigma * self.spread
        stress = fields[n_displacements:].reshape(-1, 6) if len(fields) > n_displacements else None
        factor = self.stress_factor
        stress_error = None if factor is None else factor * sigma
        return BlendedFields(displacement, error, stress, stress_error)

    def nearest(self, wrench: Floats) -> tuple[int, Floats]:
        """Return the number of the row nearest to a wrench (6,), N and N·m, and its slopes.

        The slopes are the change of its vertices with the wrench: shape (v, 3, 6), m/N and m/(N·m).
        """
        index = nearest_rows(self.weights.wrenches, wrench, self.weights.load_range, 1)[0]
        slopes = self.values[index, 1:, : 3 * len(self.geometry.vertices)]
        return self.rows[index], np.moveaxis(slopes.reshape(6, -1, 3), 0, -1)


def _stacked_fields(row: RowFields) -> Floats:
    """Return a row's fields and their slopes, shape (7, d), as in `Blend.values`."""

    def stacked(field: Floats, slopes: Floats) -> Floats:
        with_slopes = np.concatenate((field[..., None], slopes), axis=-1)
        return np.moveaxis(with_slopes, -1, 0).reshape(ARRAYS, -1)

    displacements = stacked(row.displacement, row.displacement_slopes)
    return np.hstack((displacements, stacked(row.stress, row.stress_slopes)))
