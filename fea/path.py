"""The load path: steps of the load factor from 0 to 1, each a converged equilibrium."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fea.failure import (
    SolveFailed,
    ill_conditioned,
    inverted_elements,
    not_converged,
    snap_through,
)
from fea.newton import MOST_ITERATIONS, Equilibrium, Stuck, find_equilibrium
from fea.rotation import rotation, rotation_vector
from fea.solution import Iteration, Progress
from fea.system import Balance, Linearisation, System

Array = np.ndarray

FIRST_STEP = 1.0
"""Load factor tried first."""
GROWTH = 2.0
"""How much longer the next step is after one that converged quickly."""

_LEAST_STEP = 1.0 / 512
_FEW_ITERATIONS = 8
_SECANT_MARGIN = 0.25
_SOFTENED = 5.0  # times the compliance it started with: a load limit is near,
_NEAR_LIMIT = 8  # and that many least steps are fine enough to say so


class LoadPath:
    """Follows one wrench from nothing to its full size.

    The first step tries the whole load: with the tangents of `fea.newton` most parts converge at
    once. A step is taken back and halved if Newton's method gets stuck, if the state it finds is
    unstable or turned inside out, or if the tangents at both its ends do not explain how far it
    went: a load step that jumps onto another branch of equilibria moves further than either
    tangent says.

    Attributes
    ----------
    history
        All iterations, those of steps taken back as well.
    work
        External work so far, J.
    """

    def __init__(self, system: System, wrench: Array, progress: Progress | None = None) -> None:
        self._system = system
        self._wrench = wrench
        self._size = float(np.abs(wrench).max())
        self._direction = wrench / self._size  # its squares do not overflow
        self._progress = progress
        self.history: list[Iteration] = []
        self.work = 0.0
        self._factor = 0.0
        self._step = FIRST_STEP
        self._balance = system.balance_at_rest
        self._tangent = system.undeformed

    def follow(self, check: Callable[[Balance], None]) -> Equilibrium:
        """Step to the full wrench.

        Parameters
        ----------
        check
            Called with each converged balance; raises SolveFailed to stop.

        Raises
        ------
        SolveFailed
            ``not_converged``, ``snap_through`` or ``ill_conditioned``, or what `check` raises;
            with the history.
        """
        try:
            while True:
                found = self._try_step()
                if found is None:
                    continue
                check(found.balance)
                if self._factor >= 1.0:
                    return found
        except SolveFailed as failure:
            failure.history = tuple(self.history)
            raise

    def _try_step(self) -> Equilibrium | None:
        target = min(1.0, self._factor + self._step)
        if target > 1.0 - 0.5 * _LEAST_STEP:
            target = 1.0
        try:
            found = self._iterate(target)
        except Stuck as stuck:
            if stuck.at_roundoff:
                raise ill_conditioned(f"At load factor {target:.3g} {stuck}.") from None
            self._halve(str(stuck), self._stuck)
            return None
        if found.balance.least_stretch <= 0:
            self._halve("cells are turned inside out", inverted_elements)
        elif not found.tangent.stable:
            self._halve("the equilibrium found is unstable", snap_through)
        elif not self._explained(found, target):
            self._halve("the part moves on faster than its stiffness explains", snap_through)
        else:
            self._accept(found, target)
            return found
        return None

    def _iterate(self, target: float) -> Equilibrium:
        start = self._system.reload(self._balance, target * self._wrench)
        most = MOST_ITERATIONS if self._factor == 0 else _FEW_ITERATIONS + 1

        def report(iteration: int, norm: float) -> None:
            self._report(target, iteration, norm)

        return find_equilibrium(self._system, start, self._tangent, report, most)

    def _explained(self, found: Equilibrium, target: float) -> bool:
        """Whether a step's secant lies between the tangents at its ends, more or less."""
        slopes = self._slope(self._tangent), self._slope(found.tangent)
        secant = self._advance(found) / (target - self._factor)
        low, high = min(slopes), max(slopes)
        return low * (1 - _SECANT_MARGIN) <= secant <= high * (1 + _SECANT_MARGIN)

    def _accept(self, found: Equilibrium, target: float) -> None:
        advance = self._advance(found)
        start, end = self._slope(self._tangent), self._slope(found.tangent)
        # The factor as a cubic in the advance, by its values and slopes at both ends, integrated.
        mean = 0.5 * (self._factor + target) + advance * (1 / start - 1 / end) / 12
        self.work += self._size * advance * mean
        self._balance, self._tangent, self._factor = found.balance, found.tangent, target
        if found.iterations <= _FEW_ITERATIONS:
            self._step *= GROWTH

    def _halve(self, reason: str, failure: Callable[[str], SolveFailed]) -> None:
        """Take a step back; give up with `failure` when it was as small as can be."""
        self._step = 0.5 * min(self._step, 1.0 - self._factor)
        softened = self._softened > _SOFTENED
        if self._step < _LEAST_STEP * (_NEAR_LIMIT if softened else 1):
            raise failure(f"Beyond load factor {self._factor:.3g} {reason}.")

    def _stuck(self, message: str) -> SolveFailed:
        if self._softened > _SOFTENED:
            times = f"{self._softened:.1f} times as soft as unloaded"
            return snap_through(f"{message} There the part is {times}.")
        return not_converged(message)

    @property
    def _softened(self) -> float:
        return self._slope(self._tangent) / self._slope(self._system.undeformed)

    def _slope(self, tangent: Linearisation) -> float:
        """Advance of the interface along the wrench's direction per unit of the load factor."""
        response = tangent.border_response @ self._wrench
        return float(self._direction @ (tangent.wrench_columns.T @ response))

    def _advance(self, found: Equilibrium) -> float:
        """Advance in a step, conjugate to the wrench: translation and spin along its direction."""
        before, after = self._balance.state.interface, found.balance.state.interface
        spin = rotation_vector(rotation(after[3:]) @ rotation(before[3:]).T)
        return float(self._direction @ np.concatenate([(after - before)[:3], spin]))

    def _report(self, target: float, iteration: int, norm: float) -> None:
        self.history.append(Iteration(target, iteration, norm))
        if self._progress is not None:
            done = self._factor + (target - self._factor) * (1 - 0.6**iteration)
            self._progress(done, f"load factor {target:.2f}, iteration {iteration}")
