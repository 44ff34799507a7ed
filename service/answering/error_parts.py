"""What a bar is the sum of: the table's share, and the solver's by cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError

Bars = Sequence[float | None]


def error_parts(
    table: Bars | None,
    solver: SolverError | None,
    shares: Mapping[str, Bars | None],
    *,
    has_fea: bool,
) -> dict[str, Any] | None:
    """Return the shares of a bar as a reply tells them.

    Parameters
    ----------
    table
        The table's own bars, six, m and rad; None where it has none.
    solver
        What the solver may be wrong by; None where nothing has told.
    shares
        What `SolverError.parts` tells, six an entry, m and rad.
    has_fea
        Whether rows come of a solver at all: measured tables have no share of one.

    Returns
    -------
    dict or None
        ``table``, ``mesh`` and of a linear component ``linearity``, each ``{"translation",
        "rotation"}`` like ``error``, or None where it is not known; ``mesh_basis`` in words.
    """
    if table is None:
        return None
    told: dict[str, Any] = {"table": _split(table)}
    if not has_fea:
        return told
    if solver is None:
        return told | {"mesh": None, "mesh_basis": UNKNOWN}
    told |= {cause: _split(share) for cause, share in shares.items()}
    words = {name: said for name, said in solver.values.items() if name.endswith("_basis")}
    return told | words


def _split(bars: Bars | None) -> dict[str, Any] | None:
    return None if bars is None else {"translation": list(bars[:3]), "rotation": list(bars[3:])}
