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
        The displacement there and its tangent, NaN where unknown: without them the compliance at
        small loads tells the discretisation error.
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
    mesh = shares(own, np.array([wrench], dtype=float), *state)[0][0]
    return own.parts(wrench) | ({} if own.mesh is None else {"mesh": mesh.tolist()})


def shares(
    own: SolverError, wrenches: Floats, moved: Floats | None, tangents: Floats | None
) -> tuple[Floats, Floats]:
    """Return the discretisation error and the linearity error, (n, 6) each, m and rad."""
    arrays, sizes = own.packed, np.abs(wrenches)
    mesh = _product(arrays["mesh"][None], sizes)
    most = (sizes * arrays["one_over"]).max(axis=1, initial=0.0)
    linearity = arrays["linearity"] * (most * most)[:, None]
    if own.stiffness is None or moved is None or tangents is None:
        return mesh, linearity
    pushed = _product(own.stiffness[None], moved)
    return np.fmax(np.abs(_product(tangents, pushed)), mesh), linearity


def _product(matrices: Floats, vectors: Floats) -> Floats:
    """Return matrices (n or 1, 6, 6) times vectors (n, 6), summed in one order for any n."""
    found = np.zeros((max(len(matrices), len(vectors)), 6))
    for column in range(6):
        found += matrices[:, :, column] * vectors[:, column, None]
    return found
