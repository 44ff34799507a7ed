"""The discretisation error and the linearity error of an answer, in numpy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Floats


def widened(
    own: SolverError,
    error: Sequence[float | None] | None,
    wrench: Sequence[float],
    moved: Floats | None = None,
    tangent: Floats | None = None,
) -> tuple[float, ...] | None:
    """Return error bars (6,), m and rad, with the solver's share at a wrench (6,), N and N·m.

    None stays, as a whole and in one place.

    Parameters
    ----------
    moved, tangent : ndarray, shapes (6,), m and rad, and (6, 6), SI, optional
        The displacement there and its tangent, NaN where unknown: they tell the discretisation
        error where it has grown, for which the square of the load stands without them.
    """
    if error is None:
        return None
    state = (None if one is None else one[None] for one in (moved, tangent))
    told = widened_many(own, np.array([error], dtype=float), np.array([wrench]), *state)[0]
    return tuple(None if np.isnan(bar) else bar for bar in told.tolist())  # pyright: ignore[reportReturnType]


def widened_many(
    own: SolverError,
    errors: Floats,
    wrenches: Floats,
    moved: Floats | None = None,
    tangents: Floats | None = None,
) -> Floats:
    """Return `widened` of error bars (n, 6), m and rad, at wrenches (n, 6), N and N·m.

    Displacements (n, 6), m and rad, and tangents (n, 6, 6), SI, are as there.
    """
    return errors + np.sum(shares(own, wrenches, moved, tangents), axis=0)


def parts(
    own: SolverError,
    wrench: Sequence[float],
    moved: Floats | None = None,
    tangent: Floats | None = None,
) -> dict[str, list[float] | None]:
    """Return `SolverError.parts` at a wrench whose displacement and tangent are known."""
    state = (None if one is None else one[None] for one in (moved, tangent))
    small, more = (share[0] for share in shares(own, np.array([wrench], dtype=float), *state))
    if "linearity" not in own.values:
        return {"mesh": None if own.mesh is None else (small + more).tolist()}
    return own.parts(wrench)


def shares(
    own: SolverError, wrenches: Floats, moved: Floats | None, tangents: Floats | None
) -> tuple[Floats, Floats]:
    """Return the share at small loads and what larger ones add, (n, 6) each, m and rad."""
    matrix, square, one_over, stiffness, _ = own.packed
    sizes = np.abs(wrenches)
    small = _product(matrix[None], sizes)
    most = (sizes * one_over).max(axis=1, initial=0.0)
    more = square * (most * most)[:, None]
    if own.stiffness is None or moved is None or tangents is None:
        return small, more
    lacking = np.abs(_product(tangents, _product(stiffness[None], moved)))
    # A tangent of zeros is that of a method that has none.
    known = np.isfinite(lacking).all(axis=1) & (tangents != 0.0).any(axis=(1, 2))
    return small, np.where(known[:, None], np.maximum(lacking - small, 0.0), more)


def _product(matrices: Floats, vectors: Floats) -> Floats:
    """Return matrices (n or 1, 6, 6) times vectors (n, 6), summed in one order for any n."""
    found = np.zeros((max(len(matrices), len(vectors)), 6))
    for column in range(6):
        found += matrices[:, :, column] * vectors[:, column, None]
    return found
