"""Error of a table's solves themselves: discretisation, and linearity.

A table's bars say how far its answers are from the solver's. What the solver lacks is the same for
every row, so more rows do not lower it, and no coverage depends on it: it is estimated once a
fingerprint and added to the error bars of answers. It is added, not squared and added: a mesh
errs one way at all wrenches alike, nothing of it averages out.

A mesh that is too coarse is too stiff. With D what it adds to the stiffness at small loads, that is
K dC K of a compliance 1/K that is dC short, a displacement u with the tangent T lacks T D u: dC w
for small w, more where a part softens (a column at 0.8 of its buckling load: 25 times), and
something in outputs of second order. Each answer has a displacement and a tangent, so an error bar
has max(|T D u|, |dC| |w|): the signs of an estimate near zero are not sure, and |T D u| alone holds
96 % of 7,500 errors of 27 parts and 84 % of those at single loads (56 % of an arm's); together with
what all elements of dC can make they are 99.9 and 98.8 % (`make bench NAME=mesh_error`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .table.rows import Floats, Rows
from .table.space import PER_INTERFACE

UNKNOWN = (
    "the discretisation error of the solver's mesh is unknown; the next solve of this component "
    "estimates it"
)


class SolverError:
    """The bars that come of the solver, a function of the wrench alone.

    `values`: ``mesh``: shape (6, 6), m/N, m/(N·m), rad/N, rad/(N·m), or None where it is not known:
    the error over each load's size, without a tangent. ``loads``: (6,), N and N·m, largest of the
    range. ``zero``: (6,), from where inputs count; optional. ``mesh_stiffness``: (6, 6), N/m and so
    on, what the mesh adds to the stiffness; missing of estimates of older versions. Of a linear
    component ``linearity``: (6,), m and rad, at such loads, growing with their square; None where
    it is not known. Further entries are words for people.
    Raises ValueError if it is not of that form.
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
        self.stiffness = None
        if self.mesh is not None and "mesh_stiffness" in values:
            self.stiffness = _shaped(values["mesh_stiffness"], (n, m), "mesh_stiffness")
        self._loads, self._sizes = loads, (n, m)

    @property
    def can_grow(self) -> bool:
        """Whether the discretisation error follows from an answer's tangent, or need not.

        False of what was estimated before ``mesh_stiffness`` was stored.
        """
        return self.mesh is None or "linearity" in self.values or self.stiffness is not None

    @property
    def packed(self) -> dict[str, Floats]:
        """The arrays of `surrogate.packed.arrays` that the kernel computes an error from."""
        n, m = self._sizes
        mesh = np.zeros((m, n)) if self.mesh is None else self.mesh
        arrays = {
            "mesh": mesh,
            "stiffness": np.zeros((n, m)) if self.stiffness is None else self.stiffness,
            "linearity": np.zeros(m) if self.linearity is None else self.linearity,
            "one_over": np.divide(1.0, self._loads, out=np.zeros(n), where=self._loads > 0),
        }
        return arrays | ({"zero": self.zero} if self.zero.any() else {})

    @classmethod
    def read(cls, values: Mapping[str, Any] | None) -> SolverError | None:
        """Return it from what was stored; None of nothing."""
        return None if values is None else cls(values)

    def parts(self, wrench: Sequence[float] | Floats) -> dict[str, list[float] | None]:
        """Return each cause's component of a bar, (6,), m and rad, at a wrench (6,), N and N·m.

        Of ``mesh``, without a tangent, and of a linear component ``linearity``; None where it is
        not known.
        """
        sizes = np.abs(np.array(wrench, dtype=float) - self.zero)
        components = {"mesh": None if self.mesh is None else (self.mesh @ sizes).tolist()}
        if "linearity" in self.values:
            most = np.max(sizes * self.packed["one_over"], initial=0.0)
            of = self.linearity
            components["linearity"] = None if of is None else (of * most**2).tolist()
        return components

    def at_full_range(self) -> dict[str, list[float] | None]:
        """Return `parts` at the largest loads of the range, all at once."""
        return self.parts(self.zero + self._loads)


def _numbers(value: Any, shape: tuple[int, ...], name: str) -> Floats:
    array = _shaped(value, shape, name)
    if not (array >= 0).all():
        index = [int(k) for k in np.unravel_index(array.argmin(), shape)]
        raise ValueError(f"solver error: {name}{index} must be 0 or more, not {array.min():g}")
    return array


def _shaped(value: Any, shape: tuple[int, ...], name: str) -> Floats:
    array = np.array(value, dtype=float)
    if array.shape != shape:
        raise ValueError(f"solver error: {name} must have the shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"solver error: {name}{index} must be finite, not {array[tuple(index)]}")
    return array


def bars_are_complete(rows: Rows, error: SolverError | None) -> bool:
    """Whether error bars have all components: those of solved rows need their solver's error.

    Where the solver's error was never estimated, or is lost, bars are of the table alone.
    """
    if error is not None:
        return error.mesh is not None
    return not bool((rows.source == "fea").any())
