"""Newton's method for one load step."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fea.assembly.system import Balance, Linearisation, System
from fea.coupling import State

Array = np.ndarray

Report = Callable[[int, float], None]
"""Called after each iteration with its number and the norm of what is out of balance, N."""

CONVERGED = 1e-6
"""Size of a last correction, relative to the displacement; what is left after it is its square."""

BALANCED = 1e-5
"""Forces out of balance after it, relative to the nodal forces at supports and interface."""

MOST_ITERATIONS = 16

_NEARLY = 1e-3
_MOST_IDLE = 3
_FAR_ROTATION = 2.0  # rad: a rotation vector is of no use near half a turn
_FAR = 1e3  # times the size of the part


class Stuck(Exception):  # noqa: N818 - the caller tries a smaller load step
    """Newton's method found no equilibrium.

    Attributes
    ----------
    at_roundoff
        Whether corrections stopped shrinking while small: a finer step will not help.
    """

    def __init__(self, reason: str, *, at_roundoff: bool = False) -> None:
        super().__init__(reason)
        self.at_roundoff = at_roundoff


class Equilibrium(NamedTuple):
    """A converged state.

    Attributes
    ----------
    balance
        The state with its forces.
    tangent
        The tangent proper, taken within `CONVERGED` of the state.
    iterations
        How many it took.
    """

    balance: Balance
    tangent: Linearisation
    iterations: int


def find_equilibrium(
    system: System,
    balance: Balance,
    tangent: Linearisation,
    report: Report,
    most: int = MOST_ITERATIONS,
) -> Equilibrium:
    """Iterate from a state out of balance.

    The first correction uses `tangent` as it is. While steps are large the tangents after it take
    the stress that the step aimed at (`Body.tangent`); the last is the tangent proper at the state
    itself, and only its correction counts as proof of convergence. It serves as the tangent
    compliance, too.

    Parameters
    ----------
    balance
        Where to start, under the wrench wanted.
    tangent
        A linearisation at, or near, that state.
    report
        Called after each iteration.
    most
        Iterations after which to give up.

    Raises
    ------
    Stuck
        If it does not converge.
    """
    proper, sizes = False, []
    for iteration in range(1, most + 1):
        nodes, border = tangent.correction(balance)
        change = nodes + tangent.border.ties @ border
        _require_near(change, border, system.body.extent)
        state = system.coupling.moved(balance.state, nodes, border)
        size = _relative_size(change, state)
        aim = (balance.state.nodes + change, change)
        balance = system.balance(state, balance.wrench)
        report(iteration, balance.norm)
        _require_sane(balance)
        if proper and size <= CONVERGED and balance.norm <= BALANCED * balance.scale:
            return Equilibrium(balance, tangent, iteration)
        sizes.append(size)
        _require_progress(sizes)
        proper = size <= _NEARLY
        reuse = tangent if iteration > 1 else None
        tangent = system.linearise(balance, None if proper else aim, reuse)
    raise Stuck(f"no equilibrium after {most} iterations")


def _relative_size(change: Array, state: State) -> float:
    whole = float(np.abs(state.nodes).max(initial=0.0))
    step = float(np.abs(change).max(initial=0.0))
    return step / whole if whole > 0 else 0.0


def _require_near(change: Array, border: Array, extent: float) -> None:
    largest = np.abs(change).max(initial=0.0)
    if not (np.isfinite(border).all() and largest < _FAR * extent):
        raise Stuck("the iteration ran away")


def _require_sane(balance: Balance) -> None:
    if not np.isfinite(balance.norm):
        raise Stuck("the iteration ran away to forces that are not finite")
    if np.linalg.norm(balance.state.interface[3:]) > _FAR_ROTATION:
        raise Stuck("the iteration turned the interface by more than 115 degrees")


def _require_progress(sizes: list[float]) -> None:
    recent = sizes[-_MOST_IDLE:]
    if len(recent) == _MOST_IDLE and max(recent) < _NEARLY and min(recent) > 0.5 * max(recent):
        raise Stuck(
            f"corrections stay at {recent[-1]:.0e} of the displacement: roundoff", at_roundoff=True
        )
