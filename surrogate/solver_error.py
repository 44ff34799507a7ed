"""The error of the solves themselves: discretisation, and linearity.

A table's error bars compare its answers with the solver's. The solver's error is common to all
rows, so more rows do not lower it and no coverage depends on it. It is estimated once a fingerprint
and added to the error bars of answers: linearly, since a mesh errs one way at all wrenches.

A mesh that is too coarse is too stiff. Let D be the stiffness that it adds at small loads: K dC K
for a compliance 1/K that is dC too small. A displacement u with the tangent T then lacks T D u.
That is dC w for small w, more where a part softens (25 times in a column at 0.8 of its buckling
load), and it acts on outputs of second order too. Each answer has a displacement and a tangent, so
its error bar is max(|T D u|, |dC| |w|), as the signs of an estimate near zero are not sure: |T D u|
alone holds 96 % of 7,500 errors of 27 parts, and 84 % of those at single loads (56 % of an arm's);
both together hold 99.9 and 98.8 % (`make bench NAME=mesh_error`).
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
    """The components of an answer's error bar that the solver causes.

    `values` are those of the estimate; further entries are texts for people:
    ``loads`` (6,), N and N·m: the largest loads of the range.
    ``zero`` (6,), optional: the inputs that have no effect, from which loads count.
    ``mesh`` (6, 6), m/N, m/(N·m), rad/N, rad/(N·m), None if unknown: |dC|, error over load.
    ``mesh_stiffness`` (6, 6), N/m and so on, absent in estimates of older versions: D.
    ``linearity`` (6,), m and rad, of a linear component alone, None if unknown: the error at the
    largest loads. It grows with the square of the largest load over its range. With
    ``second_derivatives`` (6, 6, 6), m and rad over the units of two inputs, symmetric in these, it
    is half of their product with the wrench twice, and ``linearity_remainder`` (6,), m and rad,
    which grows with the cube. ``linearity_saturation`` (6,), absent in estimates of older versions:
    b, by which these powers become 1 at large loads (`fea.accuracy.estimate`).

    Raises ValueError if `values` is not of that form.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = dict(values)
        n = len(values.get("loads") or ())
        # A component has fewer than six further inputs.
        m = PER_INTERFACE * max(n // PER_INTERFACE, 1)
        loads = _numbers(values.get("loads"), (n,), "loads")
        self.mesh = None if values.get("mesh") is None else _numbers(values["mesh"], (m, n), "mesh")
        self.zero = _shaped(values.get("zero", [0.0] * n), (n,), "zero")
        linearity = values.get("linearity")
        self.linearity = None if linearity is None else _numbers(linearity, (m,), "linearity")
        self.second = None
        self._remainder = self.linearity
        if self.linearity is not None and "second_derivatives" in values:
            of = values["second_derivatives"]
            self.second = _shaped(of, (m, n, n), "second_derivatives")
            self._remainder = _numbers(
                values.get("linearity_remainder"), (m,), "linearity_remainder"
            )
        self.saturation = _numbers(
            values.get("linearity_saturation", [0.0] * m), (m,), "linearity_saturation"
        )
        self.stiffness = None
        if self.mesh is not None and "mesh_stiffness" in values:
            self.stiffness = _shaped(values["mesh_stiffness"], (n, m), "mesh_stiffness")
        self._loads = loads
        self._sizes = (n, m)

    @property
    def can_grow(self) -> bool:
        """Whether the discretisation error follows from an answer's tangent, or is zero.

        False for estimates made before ``mesh_stiffness`` was stored.
        """
        return self.mesh is None or "linearity" in self.values or self.stiffness is not None

    @property
    def packed(self) -> dict[str, Floats]:
        """The arrays of `surrogate.packed.arrays` from which the kernel computes an error."""
        n, m = self._sizes
        mesh = np.zeros((m, n)) if self.mesh is None else self.mesh
        arrays = {
            "mesh": mesh,
            "stiffness": np.zeros((n, m)) if self.stiffness is None else self.stiffness,
            "linearity": np.zeros(m) if self._remainder is None else self._remainder,
            "one_over": np.divide(1.0, self._loads, out=np.zeros(n), where=self._loads > 0),
        }
        optional = {} if self.second is None else {"second": self.second}
        if self.saturation.any():
            optional["saturation"] = self.saturation
        return arrays | optional | ({"zero": self.zero} if self.zero.any() else {})

    @classmethod
    def read(cls, values: Mapping[str, Any] | None) -> SolverError | None:
        """Return the error of a stored estimate; None without an estimate."""
        return None if values is None else cls(values)

    def parts(self, wrench: Sequence[float] | Floats) -> dict[str, list[float] | None]:
        """Return each cause's part of an error bar, (6,), m and rad, at a wrench (6,), N and N·m.

        The tangent is not used for ``mesh``. A linear component has ``linearity`` too. A part is
        None if unknown.
        """
        acting = np.array(wrench, dtype=float) - self.zero
        sizes = np.abs(acting)
        components = {"mesh": None if self.mesh is None else (self.mesh @ sizes).tolist()}
        if "linearity" in self.values:
            components["linearity"] = None
        if self._remainder is not None:
            part_of_range = np.max(sizes * self.packed["one_over"], initial=0.0)
            power = part_of_range if self.second is None else part_of_range**2
            growth = (1 + self.saturation) / (1 + self.saturation * power)
            linearity = self._remainder * part_of_range * power * growth
            if self.second is not None:
                linearity += 0.5 * np.abs(self.second @ acting @ acting)
            components["linearity"] = linearity.tolist()
        return components

    def at_full_range(self) -> dict[str, list[float] | None]:
        """Return `parts` with all loads at the ends of the range, with the worst signs."""
        at_largest = self.parts(self.zero + self._loads)
        if self.linearity is not None:
            at_largest["linearity"] = self.linearity.tolist()
        return at_largest


def _numbers(value: Any, shape: tuple[int, ...], name: str) -> Floats:
    array = _shaped(value, shape, name)
    if not (array >= 0).all():
        index = [int(k) for k in np.unravel_index(array.argmin(), shape)]
        raise ValueError(f"solver error: {name}{index} must be 0 or more, not {array.min():g}")
    return array


def _shaped(value: Any, shape: tuple[int, ...], name: str) -> Floats:
    """Return a nested list as an array of the given shape; raise ValueError for another shape."""
    array = np.array(value, dtype=float)
    if array.shape != shape:
        raise ValueError(f"solver error: {name} must have the shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"solver error: {name}{index} must be finite, not {array[tuple(index)]}")
    return array


def bars_are_complete(rows: Rows, error: SolverError | None) -> bool:
    """Return whether error bars have all components: bars of solved rows need their solver's error.

    False where the solver's error was never estimated, or is lost, or has a part that is unknown:
    bars then lack it.
    """
    if error is not None:
        return error.mesh is not None and error.values.get("linearity", ()) is not None
    return not rows.is_solved.any()
