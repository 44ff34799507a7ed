"""The compliance of a table: stored by a linear solve, or fitted to its rows.

Shapes are those of m outputs and k inputs: six of each for one interface, six more for each further
one, and one input for a temperature or an acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from ..calibration import LEVEL, conformal_factor
from .polynomial import RANK
from .rows import SMALLEST, Floats, LoadRange, Rows

# Squared length of a load's unit vector outside the span of the rows' wrenches: rounding.
OFF_SPAN = 1e-6
MIN_FREE = 1e-6  # one less a row's leverage: below it the other rows do not determine the row
# Part of the largest displacement of its kind: the smallest error bar of any answer.
MIN_ERROR = 1e-15
# Largest gap of a linear deck's solves to its compliance: fea/deck/solving.py refuses larger ones.
SAME_LINE = 1e-5
# Part of the largest displacement: assumed error of measured rows without a residual.
UNCHECKED = 0.1


@dataclass(frozen=True)
class ComplianceFit:
    """A linear map from wrench to displacement."""

    # (m, k), m/N, m/(N·m), rad/N, rad/(N·m): a column is zero where the rows do not determine the
    # load's influence
    matrix: Floats
    known: NDArray[np.bool_]  # (k,): which loads' columns the rows determine
    error: Floats  # (m,), m and rad: 95 % error bar of `offset + matrix @ wrench` at full loads
    # "stored": mean of the rows' compliances. "fitted": least squares of their displacements.
    # "none": no row is loaded. In the last two, columns of loads that no row determines come from
    # the mean of the stored tangents, if there are any.
    origin: str
    # (m,), m and rad, or () for none: the displacement where all inputs are 0. It is the
    # displacement by the component's weight, if a linear solve stored it, and by a reference
    # temperature that is not 0.
    offset: Floats = field(default_factory=lambda: np.zeros(()))

    @property
    def complete(self) -> bool:
        """Whether all six columns are known."""
        return bool(self.known.all())


def fit_compliance(rows: Rows, load_range: LoadRange, *, linear: bool) -> ComplianceFit:
    """Return the compliance of the rows, whose displacements are all known (no NaN).

    A linear component's stored compliances determine it. A nonlinear one has another
    tangent at each row, and common to its rows is the least-squares secant; tangents only fill
    the columns of loads which no row determines.
    """
    fit = _fit(rows, load_range, linear=linear)
    if not len(rows):
        return fit
    # Rounding has an error too: no bar is 0.
    by_fit = np.abs(fit.matrix) @ load_range.largest
    moved = np.maximum(np.abs(rows.displacement).max(axis=0), by_fit)
    kinds = load_range.space.largest_of_kind(moved)
    least = np.maximum(MIN_ERROR * kinds, SMALLEST)
    return replace(fit, error=np.maximum(fit.error, least))


def _fit(rows: Rows, load_range: LoadRange, *, linear: bool) -> ComplianceFit:
    """Return the compliance of the rows, whose error bar may be 0."""
    with_tangent = rows.take(rows.has_tangent)
    if linear and len(with_tangent):
        return _stored(with_tangent, load_range)
    fit = _from_displacements(rows, load_range, linear=linear)
    if fit.complete or not len(with_tangent):
        return fit
    matrix = np.where(fit.known, fit.matrix, with_tangent.compliance.mean(axis=0))
    offset = 0.0 - matrix @ load_range.space.zero
    return replace(fit, matrix=matrix, known=np.ones_like(fit.known), offset=offset)


def _stored(rows: Rows, load_range: LoadRange) -> ComplianceFit:
    """Return the rows' mean compliance; its error bar is half their spread at full loads."""
    # The displacement at zero load, (m,), is taken from the row whose loads move it least. Values
    # within `SAME_LINE` of the row's motion are its rounding.
    moved = (rows.compliance @ rows.wrench[:, :, None])[:, :, 0]
    sizes = (np.abs(rows.compliance) @ np.abs(rows.wrench)[:, :, None])[:, :, 0]
    row = int(sizes.max(axis=1).argmin())
    offset = rows.displacement[row] - moved[row]
    # Translations and rotations, (2, 3), of each interface.
    of_kinds = offset.reshape(-1, 3)
    sizes_of_kinds = sizes[row].reshape(-1, 3)
    is_rounding = np.abs(of_kinds).max(axis=1) <= SAME_LINE * sizes_of_kinds.max(axis=1)
    error = np.ptp(rows.compliance, axis=0) / 2 @ load_range.largest
    return ComplianceFit(
        matrix=rows.compliance.mean(axis=0),
        known=np.ones(len(load_range.low), dtype=bool),
        error=error,
        origin="stored",
        offset=np.zeros_like(offset) if is_rounding.all() else offset,
    )


def _from_displacements(rows: Rows, load_range: LoadRange, *, linear: bool) -> ComplianceFit:
    """Fit the columns that the rows determine: least squares on scaled loads from their zeros."""
    zero = load_range.space.zero
    scaled = (rows.wrench - zero) / load_range.scale
    if not scaled.any():
        shape = rows.compliance.shape[1:]
        none = np.zeros(shape[1], dtype=bool)
        return ComplianceFit(np.zeros(shape), none, np.zeros(shape[0]), "none")

    basis, sizes, directions = np.linalg.svd(scaled, full_matrices=False)
    basis = basis[:, sizes > RANK * sizes[0]]
    spanned = directions[sizes > RANK * sizes[0]]
    # A load is determined if its unit vector lies in the span of the rows' wrenches.
    known = (spanned**2).sum(axis=0) > 1 - OFF_SPAN
    columns, *_ = np.linalg.lstsq(scaled, rows.displacement, rcond=RANK)
    residual = rows.displacement - scaled @ columns
    matrix = np.where(known, columns.T / load_range.scale, 0.0)
    offset = 0.0 - matrix @ zero  # no -0.0

    stored = np.nan_to_num(rows.uncertainty).max(axis=0)
    spare = len(rows) - len(spanned)
    # With as many rows as unknowns there is no residual. An FEA solve is repeatable and then needs
    # no bar; for measured rows a tenth of the largest displacement is assumed.
    if linear and spare > 0:
        # The interval of a further reading at full loads, the mean over their signs: the noise of
        # the reading and of the columns (Student's t). A part that is not quite linear is in it.
        full = np.maximum(np.abs(load_range.low - zero), np.abs(load_range.high - zero))
        inverse = spanned / sizes[: len(spanned), None]
        leverage = ((inverse * full / load_range.scale) ** 2).sum()
        deviation = np.sqrt((residual**2).sum(axis=0) / spare * (1.0 + leverage))
        error = stdtrit(spare, (1 + LEVEL) / 2) * deviation + stored
    elif linear and (rows.is_solved.all() or stored.any()):
        error = stored
    elif linear:
        error = UNCHECKED * np.abs(rows.displacement).max(axis=0)
    else:
        error = _secant_error(rows.displacement, residual, basis) + stored
    return ComplianceFit(matrix, known, error, "fitted", offset)


def _secant_error(displacement: Floats, residual: Floats, basis: Floats) -> Floats:
    """Return the error bar of a nonlinear table's secant, (m,), m and rad.

    The bar holds 95 % of the rows (n, m), each predicted from the others (PRESS residuals: Allen
    1974) by the orthonormal `basis` (n, rank). A row outside the span of the others has no such
    residual: its bar is its displacement.
    """
    free = 1.0 - (basis**2).sum(axis=1)[:, None]
    alone = free < MIN_FREE
    deleted = np.where(alone, displacement, residual / np.where(alone, 1.0, free))
    return conformal_factor(np.abs(deleted))
