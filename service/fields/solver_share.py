"""What the solver itself may be wrong by at each vertex of a surface.

Known is what it is off at the interface (`surrogate.solver_error`). A part too stiff by its mesh
moves its interface too little, and the rest of the body follows the interface: of a small motion q
of the interface, six numbers, a vertex moves by F q. A solve tells F: the change of the vertex with
the wrench, times the inverse of the interface's own change with the wrench (Guyan's modes, 1965).
So a vertex is off by |F| times what the interface is off: that of the interface as a rigid body,
t + r x (x - p), and nothing at a support. A fraction of the vertex's own displacement, as energies
suggest, held 46 to 92 % of vertices: where one stands nearly still, between two that do not, its
error is no part of what it moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError

Floats = NDArray[np.float64]

LOCAL = 0.1
"""Of the mesh's largest share on the surface, what a free vertex may be off besides: cells deform
wrongly on their own too, by clamps and edges. On six parts 9 of 10 vertices are 3 to 18 % of the
largest share off what follows the interface; without this 77 to 99 % of vertices are held, with it
97 % and more (`make bench NAME=surface_error`)."""

_SINGULAR = 1e-9
"""Of the scaled compliance's largest singular value: below it are locked freedoms and roundoff."""

NOT_FOLLOWED = (
    "no row tells how the surface follows its interface; the next solve of this component does"
)


class ErrorParts(NamedTuple):
    """What the bars of a surface are the sum of.

    Attributes
    ----------
    shares
        By cause, ``table``, ``mesh`` and of a linear component ``linearity``: shape (v,), m; None
        where it is not known.
    words
        ``mesh_basis`` and the like: where an estimate is from, or why there is none.
    """

    shares: dict[str, Floats | None]
    words: dict[str, str]

    @property
    def total(self) -> Floats:
        """The bars, shape (v,), m: all shares that are known."""
        return np.sum([share for share in self.shares.values() if share is not None], axis=0)

    @property
    def are_whole(self) -> bool:
        """Whether the mesh's share is known: without it bars are of the table alone."""
        return self.shares.get("mesh") is not None

    def largest(self) -> dict[str, float | str | None]:
        """Return the largest of each share, m, and the words."""
        largest = {
            cause: None if share is None else float(share.max(initial=0.0))
            for cause, share in self.shares.items()
        }
        return largest | self.words


def following(slopes: Floats, compliance: Floats) -> Floats | None:
    """Return how the vertices follow the interface, shape (v, 3, 6), m/m and m/rad.

    Parameters
    ----------
    slopes
        Shape (v, 3, 6), m/N and m/(N·m): change of the vertices with the wrench.
    compliance
        Shape (6, 6), SI: the same of the interface; None is returned where it is not known.
    """
    if not np.isfinite(compliance).all():
        return None
    size = np.sqrt(np.abs(np.diagonal(compliance)))
    unit = 1.0 / np.where(size > 0, size, 1.0)  # a locked freedom's row and column are zero
    inverse = np.linalg.pinv(compliance * np.outer(unit, unit), rcond=_SINGULAR)
    return slopes @ (inverse * np.outer(unit, unit))


def error_parts(
    table: Floats,
    follows: Floats | None,
    solver: SolverError | None,
    wrench: Floats,
    shares: Mapping[str, Sequence[float] | None] | None = None,
) -> ErrorParts:
    """Return the shares of a surface's bars.

    Parameters
    ----------
    table
        Shape (v,), m: the table's own bars.
    follows
        As `following` has it, shape (v, 3, 6), m/m and m/rad.
    solver
        What the solver may be wrong by; None where nothing has told.
    wrench
        Shape (6,), N and N·m.
    shares
        The interface's, six an entry, m and rad; those at small loads without.
    """
    found: dict[str, Floats | None] = {"table": table, "mesh": None}
    if solver is None:
        return ErrorParts(found, {"mesh_basis": UNKNOWN})
    words = {name: str(said) for name, said in solver.values.items() if name.endswith("_basis")}
    if follows is None:
        return ErrorParts(found, words | {"mesh_basis": NOT_FOLLOWED})
    for cause, bars in (shares or solver.parts(wrench.tolist())).items():
        found[cause] = None if bars is None else _carried(follows, np.array(bars))
    mesh = found["mesh"]
    if mesh is not None:
        free = follows.any(axis=(1, 2))
        found["mesh"] = mesh + LOCAL * mesh.max(initial=0.0) * free
    return ErrorParts(found, words)


def _carried(follows: Floats, bars: Floats) -> Floats:
    """Return the vertices' bars (v,), m, of the interface's six, m and rad, of unknown signs."""
    return np.linalg.norm(np.abs(follows) @ bars, axis=1)
