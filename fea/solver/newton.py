"""Newton's method for one load step."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.assembly.linearisation import Balance, Linearisation
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling.coupling import largest_rotation

Report = Callable[[int, float], None]
"""Called after each iteration with its number and the norm of the forces out of balance, N."""

CONVERGED = 1e-6
"""Size of a last correction, relative to the displacement; the remaining error is its square."""

CONVERGED_ENERGY = 1e-5
"""Size of a last correction in the energy norm, relative to the state's strain energy.

This is the norm in which Newton's method for an elastic body converges quadratically whatever the
units and the slenderness (Deuflhard, "Newton methods for nonlinear problems", 2004, section 2.3).
A displacement that is right to 1e-6 is not enough: measured on a spring of 2 mm wire, a correction
of 4e-7 of the displacement was 4e-4 in the energy norm, and left 1e-6 of the rotation.
"""

BALANCED = 1e-5
"""Forces out of balance after a last correction, relative to those at supports and interface."""

SAME_STATE = 1e-10
"""Size of a correction in the energy norm below which its tangent counts as unchanged.

For the spring above a tangent changes by 500 times the correction: this leaves 5e-8 of a
compliance.
"""

MAX_ITERATIONS = 16  # iterations of a load step before it is halved
_NEARLY = 1e-3  # relative size of a correction after which tangents are consistent
# Corrections with one tangent: after these a correction that shrinks tenfold is below the accuracy
# of a new tangent.
_MAX_CHORDS = 3
_CHORD_GAIN = 0.1  # ratio of two corrections with one tangent above which the tangent has changed
_MAX_IDLE = 3  # small corrections in a row, none of which halves either norm, that show roundoff
_FAR_ROTATION = 2.0  # rad: a rotation vector is ill-defined near half a turn
_FAR = 1e3  # largest displacement, over the size of the part


class Stuck(Exception):  # noqa: N818 - the caller tries a smaller load step
    """Newton's method found no equilibrium.

    at_roundoff: whether corrections stopped shrinking while small, so that a finer step does not
    help.
    """

    def __init__(self, reason: str, *, at_roundoff: bool = False) -> None:
        super().__init__(reason)
        self.at_roundoff = at_roundoff


class Equilibrium(NamedTuple):
    """A converged state."""

    balance: Balance  # the state with its forces
    # The consistent tangent at this state, to within a correction of `SAME_STATE`
    tangent: Linearisation
    iterations: int  # their number


class Correction(NamedTuple):
    """One correction, and the state after it."""

    balance: Balance  # the new state with its forces
    # The aimed displacement and the change, both linear in the unknowns, shape (n, 3), m
    aim: tuple[np.ndarray, np.ndarray]
    size: float  # largest change over the largest displacement
    # Its size in the energy norm, relative to the new state's: the root of the quotient of the
    # correction's energy and the strain energy.
    energy: float

    @property
    def converged(self) -> bool:
        """Whether a correction with a consistent tangent proves the new state to be in balance."""
        return (
            self.size <= CONVERGED
            and self.energy <= CONVERGED_ENERGY
            and self.balance.norm <= BALANCED * self.balance.scale
        )

    @property
    def nearly(self) -> bool:
        """Whether the correction is small enough to continue with consistent tangents."""
        return self.size <= _NEARLY


def find_equilibrium(
    system: System,
    balance: Balance,
    tangent: Linearisation,
    report: Report,
    max_iterations: int = MAX_ITERATIONS,
) -> Equilibrium:
    """Iterate from a state out of balance.

    The first correction uses `tangent` unchanged. While steps are large, later tangents take the
    stress at which the step aimed (`ElasticBody.tangent`). The last are the consistent tangents at
    the state: only these prove convergence. The older of two tangents is used again while it makes
    progress.

    balance: the initial state, under the required wrench.
    tangent: a linearisation at, or near, that state; its factor is released after the first
    correction.
    report: called after each iteration.

    Raises Stuck if the iteration does not converge.
    """
    consistent = False
    corrections = []
    for iteration in range(1, max_iterations + 1):
        step = correct(system, balance, tangent, *tangent.correction(balance))
        balance = step.balance
        report(iteration, balance.norm)
        if not np.isfinite(balance.norm):
            raise Stuck(f"iteration {iteration} led to forces that are not finite")
        rotation = largest_rotation(balance.state.interface)
        if rotation > _FAR_ROTATION:
            degrees = f"{np.degrees(rotation):.0f} degrees"
            raise Stuck(f"iteration {iteration} rotated the interface by {degrees}")
        if consistent and step.converged:
            return Equilibrium(balance, tangent_after(system, step, tangent), iteration)

        corrections.append((step.size, step.energy))
        recent = np.array(corrections[-_MAX_IDLE:])
        # Before the last iterations one norm may stay while the other shrinks: that is no roundoff.
        idle = (recent.min(axis=0) > 0.5 * recent.max(axis=0)).all()
        if len(recent) == _MAX_IDLE and idle and recent[:, 0].max() < _NEARLY:
            reached = f"{step.size:.0e} of the displacement and {step.energy:.0e} in energy"
            needed = f"{CONVERGED:.0e} and {CONVERGED_ENERGY:.0e}"
            message = f"roundoff keeps the corrections at {reached}, above {needed}"
            raise Stuck(message, at_roundoff=True)

        consistent = step.nearly
        balance = _repeat_correction(system, step, tangent) if consistent else balance
        if iteration == 1:
            # The caller keeps the tangent, and its factor would stay in memory beside each next
            # factor.
            tangent.release()
        tangent = system.linearise(balance, None if consistent else step.aim)
    last = f"the last correction was {corrections[-1][0]:.0e} of the displacement"
    raise Stuck(f"there is no equilibrium after {max_iterations} iterations; {last}")


def correct(
    system: System, balance: Balance, tangent: Linearisation, nodes: np.ndarray, border: np.ndarray
) -> Correction:
    """Apply a correction and measure it.

    balance: the state before, under the wrench of the new state.
    nodes, border: Shapes (n, 3), m, and (border,): the correction of the free nodes and of the
    border.

    Raises Stuck if the correction is not finite, or a thousand times as large as the part.
    """
    change = nodes + tangent.border.constraint @ border
    largest = np.abs(change).max(initial=0.0)
    if not np.isfinite(border).all():
        raise Stuck("the iteration diverged to a displacement that is not finite")
    if not largest < _FAR * system.body.extent:
        raise Stuck(f"the iteration diverged: it moved a node by {largest:.2g} m")
    state = system.coupling.moved(balance.state, nodes, border)
    after = system.balance(state, balance.wrench)
    work = abs(float(np.vdot(balance.nodal, nodes) + balance.border @ border))
    energy = np.sqrt(_quotient(work, 2 * (after.energy + after.thermal[1])))
    size = _quotient(np.abs(change).max(initial=0.0), np.abs(state.nodes).max(initial=0.0))
    return Correction(after, (balance.state.nodes + change, change), size, energy)


def _repeat_correction(system: System, step: Correction, tangent: Linearisation) -> Balance:
    """Return the state after further corrections with the same tangent, while each is much smaller.

    These cost a solve with factors at hand and no new ones (the modified Newton method). They prove
    nothing, but the consistent tangent at a better state needs one correction less.
    """
    for _ in range(_MAX_CHORDS):
        try:
            again = correct(system, step.balance, tangent, *tangent.correction(step.balance))
        except Stuck:
            break
        if not again.energy <= _CHORD_GAIN * step.energy:
            break
        step = again
    return step.balance


def tangent_after(system: System, step: Correction, tangent: Linearisation) -> Linearisation:
    """Return the consistent tangent at the state after a last correction.

    tangent: the consistent tangent at the state before it.
    """
    if step.energy <= SAME_STATE:
        return tangent
    return system.linearise(step.balance)


def _quotient(part: float, total: float) -> float:
    return float(part / total) if total > 0 else 0.0
