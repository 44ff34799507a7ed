"""Fields between rows: the kriging's weights on the fields and slopes of some rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.service.fields.record import RowFields, SurfaceGeometry
from wrenchbook.surrogate.field_weights import LEAST_LEFT_OUT, FieldWeights

Floats = NDArray[np.float64]

LEVEL = 0.95
"""Share of a row's vertices, and of rows, that an error bar covers."""

WIDENING = 5.0
"""Error bars widen by this over the number of rows left out: few show a tail badly (as tables')."""


class BlendedFields(NamedTuple):
    """Fields at one wrench.

    Attributes
    ----------
    displacement, error
        Shapes (v, 3) and (v,), m; None where too few rows give an error.
    stress, stress_error
        Shape (p, 6), Pa, and the error bar of its largest von Mises stress; None where not known.
    """

    displacement: Floats
    error: Floats | None
    stress: Floats | None
    stress_error: float | None


@dataclass(frozen=True, eq=False)
class Blend:
    """An interpolation of whole fields.

    Attributes
    ----------
    geometry
    weights
    values
        Shape (k, 7, d): of each row its fields, then their slopes by each load; displacements
        first, then stresses.
    rows
        Their numbers.
    largest
        The largest displacement in any row, m.
    spread
        Shape (v,), m: of a vertex's error over sigma; None where too few rows give it.
    factor
        What sigma times spread is multiplied by.
    stress_factor
        Pa: the error bar of the largest von Mises stress over sigma.
    """

    geometry: SurfaceGeometry
    weights: FieldWeights
    values: Floats
    rows: tuple[int, ...]
    largest: float
    spread: Floats | None
    factor: float
    stress_factor: float | None

    @classmethod
    def of(
        cls,
        geometry: SurfaceGeometry,
        weights: FieldWeights,
        rows: Sequence[RowFields],
        numbers: tuple[int, ...],
    ) -> Blend:
        """Return the interpolation of rows that share a geometry."""
        values = np.stack([_columns(row) for row in rows])
        moved = 3 * len(geometry.vertices)
        largest = float(np.abs(values[:, 0, :moved]).max(initial=0.0))
        blank = cls(geometry, weights, values, numbers, largest, None, 0.0, None)
        if len(rows) < LEAST_LEFT_OUT:
            return blank
        errors, sigmas = weights.left_out(values.__getitem__, values.shape[2])
        lengths = np.linalg.norm(errors[:, :moved].reshape(len(rows), -1, 3), axis=2)
        ratios = lengths / sigmas[:, None]
        spread = np.sqrt((ratios**2).mean(axis=0))
        relative = ratios / np.where(spread > 0, spread, 1.0)
        factor = _conformal(np.quantile(relative, LEVEL, axis=1))
        stresses = _stress_factor(values[:, 0, moved:], errors[:, moved:], rows, sigmas)
        return cls(geometry, weights, values, numbers, largest, spread, factor, stresses)

    def at(self, wrench: Floats) -> BlendedFields:
        """Return the fields at a wrench (6,), N and N·m."""
        found = self.weights.at(wrench)
        lambdas = np.concatenate((found.values[:, None], found.slopes), axis=1)
        fields = np.tensordot(lambdas, self.values, axes=2)
        moved = 3 * len(self.geometry.vertices)
        displacement = fields[:moved].reshape(-1, 3)
        error = None if self.spread is None else self.factor * found.sigma * self.spread
        stress = fields[moved:].reshape(-1, 6) if len(fields) > moved else None
        factor = self.stress_factor
        stress_error = None if factor is None else factor * found.sigma
        return BlendedFields(displacement, error, stress, stress_error)

    def nearest(self, wrench: Floats) -> tuple[int, Floats]:
        """Return the row nearest to a wrench (6,), N and N·m, and its slopes.

        Its number, and the change of its vertices with the wrench: shape (v, 3, 6), m/N and
        m/(N·m).
        """
        apart = (self.weights.wrenches - wrench) / self.weights.load_range.scale
        place = int(np.linalg.norm(apart, axis=1).argmin())
        moved = self.values[place, 1:, : 3 * len(self.geometry.vertices)]
        return self.rows[place], np.moveaxis(moved.reshape(6, -1, 3), 0, -1)


def _columns(row: RowFields) -> Floats:
    """Return a row's fields and slopes, shape (7, d)."""
    parts: list[Any] = []
    for field, slopes in (
        (row.displacement, row.displacement_slopes),
        (row.stress, row.stress_slopes),
    ):
        whole = np.concatenate((field[..., None], slopes), axis=-1)
        parts.append(np.moveaxis(whole, -1, 0).reshape(7, -1))
    return np.concatenate(parts, axis=1)


def _stress_factor(
    stress: Floats, errors: Floats, rows: Sequence[RowFields], sigmas: Floats
) -> float | None:
    """Return the error bar of the largest von Mises stress over sigma, Pa; None without stresses.

    Of each row left out the predicted largest is compared with its own largest.
    """
    if not stress.shape[1]:
        return None
    largest = von_mises((stress - errors).reshape(len(rows), -1, 6)).max(axis=1)
    true = np.array([row.meta["largest"] for row in rows])
    return _conformal(np.abs(largest - true) / sigmas)


def _conformal(ratios: Floats) -> float:
    """Return the ratio that 95 % of one more row are below, widened for few rows."""
    rank = int(np.ceil(LEVEL * (len(ratios) + 1)))
    found = float(np.sort(ratios)[min(rank, len(ratios)) - 1])
    return found * (1 + WIDENING / len(ratios))
