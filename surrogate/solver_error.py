"""Error of a table's solves themselves: discretisation, and linearity.

A table's bars say how far its answers are from the solver's. What the solver lacks is the same for
every row, so more rows do not lower it, and no coverage depends on it: it is estimated once a
fingerprint and added to the error bars of answers. It is added, not squared and added: a mesh
errs one way at all wrenches alike, nothing of it averages out.

A mesh that is too coarse is too stiff. With D what it adds to the stiffness at small loads, that is
K0 dC K0 of a compliance 1/K0 that is dC short, a displacement u with the tangent T lacks T D u:
dC w for small w, more where a part softens (a column at 0.8 of its buckling load: 25 times), and
something in outputs of second order. Every solved row brings T and u, so rows show by how much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .table.rows import Floats, LoadRange, Rows
from .table.space import PER_INTERFACE

_MAX_BY_SQUARE = 1.0
"""Of the error at small loads, at the full range: up to it growth follows the load's square,
which at most doubles a bar and needs nothing else; beyond it by each answer's tangent."""

_NEGLIGIBLE = 1e-6
"""Of a bar at full load, below which a load's part of it is left out: an estimate has 1 digit."""

UNKNOWN = (
    "the discretisation error of the solver's mesh is not known; the next solve of this component "
    "estimates it"
)


class SolverError:
    """The bars that come of the solver, a function of the wrench alone.

    Parameters
    ----------
    values : mapping
        ``mesh``: shape (6, 6), m/N, m/(N·m), rad/N, rad/(N·m), or None where it is not known;
        ``loads``: (6,), N and N·m, largest of the range. ``zero``: (6,), from where inputs count;
        optional. ``mesh_stiffness``: (6, 6), N/m and so on,
        what the mesh adds to the stiffness; optional. Of a linear component ``linearity``: (6,), m
        and rad, at such loads, growing with their square; None where it is not known. Of any other
        ``mesh_growth``: (6,), of the same form, see `grown`. Further entries are words for people.

    Raises
    ------
    ValueError
        If it is not of that form.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = dict(values)
        n = len(values.get("loads") or ())
        m = PER_INTERFACE * max(n // PER_INTERFACE, 1)  # further inputs are fewer than six
        loads = _numbers(values.get("loads"), (n,), "loads")
        self.mesh = None if values.get("mesh") is None else _numbers(values["mesh"], (m, n), "mesh")
        self.zero = _shaped(values.get("zero", [0.0] * n), (n,), "zero")
        linearity = values.get("linearity")
        self.linearity = None if linearity is None else _numbers(linearity, (m,), "linearity")
        self.growth = _numbers(values.get("mesh_growth", [0.0] * m), (m,), "mesh_growth")
        self.stiffness = None
        if "mesh_stiffness" in values:
            stiffness = _shaped(values["mesh_stiffness"], (n, m), "mesh_stiffness")
            self.stiffness = None if "linearity" in values else stiffness
        matrix = np.zeros((m, n)) if self.mesh is None else self.mesh
        components = matrix * loads
        small = components <= _NEGLIGIBLE * components.sum(axis=1, keepdims=True)
        self._matrix = np.where(small, 0.0, matrix)
        self._square = self.growth + (0.0 if self.linearity is None else self.linearity)
        self._loads = np.where(loads > 0, loads, np.inf)
        self.needs_tangent = self.stiffness is not None and bool(
            (self.growth > _MAX_BY_SQUARE * (self._matrix @ loads)).any()
        )
        self._inverse_loads = 1.0 / self._loads

    @property
    def can_grow(self) -> bool:
        """Whether rows can show how the discretisation error grows, or need not.

        False of what was estimated before ``mesh_stiffness`` was stored.
        """
        return self.mesh is None or "linearity" in self.values or "mesh_stiffness" in self.values

    @property
    def packed(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """The arrays from which the kernel computes the solver's error of an answer.

        Shape (6, 6), SI; (6,), m and rad; the inverse largest loads (6,), 1/N and 1/(N·m); what
        the mesh adds to the stiffness (6, 6), N/m and so on; whether answers' tangents are needed
        (1,): 2 always, 1 of rows beyond the range, 0 never.
        """
        asks = 0.0 if self.stiffness is None else 1.0 + self.needs_tangent
        none = np.zeros(self._matrix.T.shape)
        stiffness = none if self.stiffness is None else self.stiffness
        return self._matrix, self._square, self._inverse_loads, stiffness, np.array([asks])

    @classmethod
    def read(cls, values: Mapping[str, Any] | None) -> SolverError | None:
        """Return it from what was stored; None of nothing."""
        return None if values is None else cls(values)

    def grown(self, rows: Rows, load_range: LoadRange | None = None) -> SolverError:
        """Return this with the growth of the discretisation error that solved rows show.

        ``mesh_growth`` is the least that, growing with the square of the largest load over its
        range, makes the error at each row T D u or more. The square is the first term that linear
        answers lack. Where it more than doubles bars (`needs_tangent`) it stands only for what has
        no tangent: it would be hundreds of times the truth at loads that do not push.

        Parameters
        ----------
        rows : Rows
            Of one version of a table; those without tangents or outputs, measured ones and those
            beyond the range have no effect.
        load_range : LoadRange, optional
            The table's. Without it a row is beyond the range where a load is larger than the
            largest of either sign.
        """
        if self.mesh is None or self.linearity is not None or "mesh_stiffness" not in self.values:
            return self
        # Wrenches (n, 6), displacements (n, 6) and tangents (n, 6, 6) of complete solves.
        complete = (
            (rows.source == "fea")
            & np.isfinite(rows.displacement).all(axis=1)
            & np.isfinite(rows.compliance).all(axis=(1, 2))
        )
        wrench, moved, tangent = (
            rows.wrench[complete],
            rows.displacement[complete],
            rows.compliance[complete],
        )
        inverse_loads = self._inverse_loads
        size = np.abs(wrench - self.zero)
        part = (size * inverse_loads).max(axis=1, initial=0.0)
        inside = (part > 0.0) & (part <= 1.0 + _NEGLIGIBLE)
        if load_range is not None:
            inside &= ~load_range.exceeded(wrench).any(axis=1)
        wrench, moved, tangent, size, part = (
            of[inside] for of in (wrench, moved, tangent, size, part)
        )
        pushed = moved @ np.array(self.values["mesh_stiffness"]).T
        lacking = np.abs((tangent @ pushed[:, :, None])[:, :, 0])
        beyond = np.maximum(lacking - size @ self.mesh.T, 0.0)
        growth = (beyond / (part * part)[:, None]).max(axis=0, initial=0.0)
        growth = np.maximum(growth, self.growth)
        return SolverError({**self.values, "mesh_growth": growth.tolist()})

    def total(self, wrench: Floats) -> Floats:
        """Return the solver's error at a wrench (6,), N and N·m: (6,), m and rad."""
        return np.sum(self._components(wrench), axis=0)

    def parts(self, wrench: Sequence[float]) -> dict[str, list[float] | None]:
        """Return each cause's component of a bar, (6,), m and rad, at a wrench (6,), N and N·m.

        Of ``mesh``, and of a linear component ``linearity``; None where it is not known.
        """
        small, more = self._components(np.array(wrench, dtype=float))
        if "linearity" not in self.values:
            return {"mesh": None if self.mesh is None else (small + more).tolist()}
        return {
            "mesh": None if self.mesh is None else small.tolist(),
            "linearity": None if self.linearity is None else more.tolist(),
        }

    def _components(self, wrench: Floats) -> tuple[Floats, Floats]:
        """Return what grows with the loads, and with the square of the largest of them."""
        sizes = np.abs(wrench - self.zero)
        most = (sizes * self._inverse_loads).max(initial=0.0)
        return self._matrix @ sizes, self._square * (most * most)

    def at_full_range(self) -> dict[str, list[float] | None]:
        """Return `parts` at the largest loads of the range, all at once."""
        loads = np.where(np.isfinite(self._loads), self._loads, 0.0)
        return self.parts((self.zero + loads).tolist())


def _numbers(value: Any, shape: tuple[int, ...], name: str) -> Floats:
    array = _shaped(value, shape, name)
    if not (array >= 0).all():
        raise ValueError(f"{name} of a solver's error must not be negative")
    return array


def _shaped(value: Any, shape: tuple[int, ...], name: str) -> Floats:
    array = np.array(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name} of a solver's error must be of shape {shape}, finite")
    return array


def bars_are_complete(rows: Rows, error: SolverError | None) -> bool:
    """Whether error bars have all components: those of solved rows need their solver's error.

    Where the solver's error was never estimated, or is lost, bars are of the table alone.
    """
    if error is not None:
        return error.mesh is not None
    return not bool((rows.source == "fea").any())
