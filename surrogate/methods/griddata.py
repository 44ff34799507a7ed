"""`griddata`: piecewise linear between the rows; `tangent`: with the bends their slopes tell."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..answer import COVERED, OUTSIDE, THIN
from ..composition.composition import OFF_HULL, Composition
from ..composition.fast import UNKNOWN, compose, judge, one
from ..composition.packed import Packed, pack
from ..composition.reasons import why_not
from ..jit import COMPILED, ready
from ..table.rows import Floats
from .method import Estimates, Method
from .reference import BENDS, MISSED, Reference

_NOTHING = np.empty((0, 6)), np.empty((0, 6))


class Griddata(Method):
    """The composition's answer, with bars from the reference.

    Parameters
    ----------
    composition : Composition
    reference : Reference
    bent : bool
        Whether the bends are added to the answer (`tangent`).
    """

    def __init__(self, composition: Composition, reference: Reference, *, bent: bool) -> None:
        self.composition, self.reference, self.bent = composition, reference, bent
        self.name = "tangent" if bent else "griddata"

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        # Another kind of array, such as one that cannot be written, would be compiled for anew.
        asked = np.require(wrenches, float, ("C", "W"))
        count = len(asked)
        moved, bend, squares, state = self._composed(asked)
        if not ready():
            return self._judged(moved, bend, np.sqrt(squares), state, asked)
        best, own = self.reference.told(asked)
        displacement, error = np.empty((count, 6)), np.empty((count, 6))
        coverage = np.empty(count, dtype=np.uint8)
        how = best, own, self.reference.mode, self.bent, OFF_HULL
        judge(moved, bend, squares, state, *how, displacement, error, coverage)
        return Estimates(displacement, error, coverage)

    def single(self, wrench: tuple[float, ...]) -> tuple[float, ...] | None:
        """Answer one wrench (6,), N and N·m: see `Method`."""
        if not ready():
            return None
        mode = self.reference.mode
        best, own = _NOTHING if mode == BENDS else self.reference.told(np.array((wrench,)))
        told = one(self._packed, wrench, best, own, mode, self.bent, OFF_HULL)
        return None if told[12] == UNKNOWN else told

    def _judged(
        self,
        moved: Floats,
        bend: Floats,
        rest: Floats,
        state: NDArray[np.int64],
        asked: Floats,
    ) -> Estimates:
        """Say what `judge` says, by arrays."""
        displacement = moved + bend if self.bent else moved
        best, own = self.reference.told(asked)
        if self.reference.mode == BENDS:
            best, own = moved + bend, rest
        elif self.reference.mode == MISSED:
            best, own = moved + bend + best, np.sqrt(rest**2 + own**2)
        off = (state >= OFF_HULL)[:, None]
        error = np.abs(displacement - best) + own
        error = np.where(off, np.maximum(error, rest), error)
        coverage = np.where(off[:, 0], OUTSIDE, np.where(state > 0, THIN, COVERED))
        return Estimates(displacement, error, coverage.astype(np.uint8))

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m): the slopes of the simplices."""
        return self.composition.derivatives(wrenches, bent=self.bent)

    def reason(self, wrench: Floats) -> str:
        """Return which axis does not hold a wrench (6,), N and N·m, and why."""
        return why_not(self.composition, wrench)

    def _composed(self, asked: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.int64]]:
        """Return outputs, bends and squared rests, (n, 6), and the worst state, (n,).

        By the compiled pass; by the array version what that does not know.
        """
        count = len(asked)
        moved, bend, squares = np.empty((count, 6)), np.empty((count, 6)), np.empty((count, 6))
        state = np.full(count, UNKNOWN)
        if ready():
            compose(asked, self._packed, moved, bend, squares, state)
        if count == 1 and state[0] != UNKNOWN:
            return moved, bend, squares, state
        lost = np.flatnonzero(state == UNKNOWN)
        if len(lost):
            found = self.composition.evaluate(asked[lost])
            moved[lost], bend[lost] = found.displacement, found.bend
            squares[lost], state[lost] = found.rest**2, found.state
        return moved, bend, squares, state

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: with what compiled code reads, so that no copy makes its own."""
        if COMPILED:
            _ = self._packed
        return self.__dict__

    @cached_property
    def _packed(self) -> Packed:
        return pack(self.composition)
