"""The load path: steps of the load factor from 0 to 1, each a converged equilibrium."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wrenchbook.fea.assembly.linearisation import Balance, Linearisation, contract
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling.coupling import CoupledState, each_interface
from wrenchbook.fea.failure import FailureKind, SolveFailed
from wrenchbook.fea.solution import Iteration, Progress
from wrenchbook.fea.solver.arc_length import ArcPath
from wrenchbook.fea.solver.newton import (
    MAX_ITERATIONS,
    Equilibrium,
    Report,
    Stuck,
    find_equilibrium,
)
from wrenchbook.fea.tensors import rotation, rotation_vector

_WEIGHT_REMEDY = (
    "Correct gravity under [analysis] (m/s^2), or support the part so that it carries its weight."
)
# Failures of a path that ends below the full load, by the kind of its `Ending`.
_GIVES_WAY = {
    "limit": "The part snaps through at {} of {}, where its load has a maximum.",
    "bifurcation": "The part buckles at {} of {}, where its equilibrium becomes unstable.",
}
# Kinds of failures that less load does not cure.
_OF_ANY_LOAD = "mechanism", "ill_conditioned", "locking_material"

FIRST_STEP = 1.0
"""Load factor tried first."""
GROWTH = 2.0
"""How much longer the next step is after a step that converged quickly."""

# Shortest step, over the full load; where it is too long, the path is followed by its length.
_MIN_STEP = 1.0 / 32
_FEW_ITERATIONS = 8  # iterations up to which the next step grows; after one more it is halved
_SECANT_MARGIN = 0.25  # part of a slope by which a secant may lie outside the tangents at its ends
_UNDONE = 0.6  # part of a step that remains after each iteration, for the progress
_SOFTENED = 5.0  # ratio to the initial compliance at which a load limit is near


class _Refused(Exception):  # noqa: N818 - load control gives up; the path's length may do
    """Load control failed; `failure` is the solve's failure if the path's length fails too."""

    def __init__(self, failure: SolveFailed) -> None:
        super().__init__(failure.message)
        self.failure = failure


class LoadPath:
    """Follows one wrench from zero to its full size.

    The first step tries the full load: with the tangents of `fea.solver.newton` most parts converge
    at once. A step is taken back and halved if Newton's method gets stuck, if its state is unstable
    or turned inside out, or if the tangents at both its ends do not explain its length: a load step
    that jumps onto another branch of equilibria moves further than either tangent predicts. Where
    no step is short enough the path is followed by its length (`fea.solver.arc_length`), to the
    full load or to the load at which the part gives way.

    wrench: shape (k,): the inputs, as of `Balance.wrench`; not zero.
    progress: called with the fraction done and a message.
    unloaded: the equilibrium at no wrench, of `equilibrium_under_weight`; None without self-weight.
    load: the name in messages of the load that is stepped.
    history: all iterations, also those of steps taken back.
    work: external work so far, J.
    """

    def __init__(
        self,
        system: System,
        wrench: np.ndarray,
        progress: Progress | None,
        unloaded: Equilibrium | None,
        load: str = "this wrench",
    ) -> None:
        self._system = system
        self._load = load
        self._wrench = wrench
        self._size = float(np.abs(wrench).max())
        self._direction = wrench / self._size  # in its units; its squares do not overflow
        self._progress = progress
        self.history: list[Iteration] = []
        self.work = 0.0
        self._factor = 0.0
        self._step = FIRST_STEP
        self._balance = system.balance_at_rest if unloaded is None else unloaded.balance
        self._tangent = system.undeformed if unloaded is None else unloaded.tangent

    def follow(
        self, check: Callable[[Balance], None], guess: CoupledState | None = None
    ) -> Equilibrium:
        """Step to the full wrench.

        On a failure the caller attaches `history` and `last_state` to it.

        check: called once with each converged balance on the path; raises SolveFailed to stop.
        guess: a state near the equilibrium, such as that of a nearby wrench. Its equilibrium must
        pass the tests of one step from no load to the full load; otherwise the guess is ignored.

        Raises SolveFailed of kind ``not_converged``, ``snap_through``, ``inverted_elements`` or
        ``ill_conditioned`` if the path ends early, ``mechanism`` if the interface moves freely, and
        the errors of `check`.
        """
        try:
            equilibrium = None if guess is None else self._try_guess(guess)
            if equilibrium is not None:  # at the full load
                check(equilibrium.balance)
            while equilibrium is None or self._factor < 1.0:
                equilibrium = self._try_step()
                if equilibrium is not None:
                    check(equilibrium.balance)
            return equilibrium
        except _Refused as refused:
            failure = refused.failure
        # Outside of the block above, where the last attempt would keep its factor in memory.
        return self._follow_length(check, failure)

    def last_state(self) -> tuple[float, np.ndarray]:
        """Return the load factor of the last converged state, and its nodes, shape (n, 3), m."""
        return self._factor, self._balance.state.nodes

    def _try_guess(self, guess: CoupledState) -> Equilibrium | None:
        """Return the equilibrium near a guess at the full load; None if it fails the tests."""
        start = self._system.balance(guess, self._wrench)
        self._tangent.release()  # no correction uses it
        try:
            tangent = self._system.linearise(start)
            equilibrium = find_equilibrium(
                self._system, start, tangent, self._reporter(1.0), _FEW_ITERATIONS
            )
        except (Stuck, SolveFailed):
            return None
        sound = equilibrium.balance.least_stretch > 0 and equilibrium.tangent.stable
        if not (sound and self._explained(equilibrium, 1.0)):
            return None
        self._accept(equilibrium, 1.0)
        return equilibrium

    def _follow_length(self, check: Callable[[Balance], None], refused: SolveFailed) -> Equilibrium:
        """Follow the path by its length from the last state of load control."""

        def accept(equilibrium: Equilibrium, factor: float) -> None:
            check(equilibrium.balance)
            self._accept(equilibrium, factor)

        here = Equilibrium(self._balance, self._tangent, 0)
        path = ArcPath(
            self._system,
            self._direction,
            self._size,
            self._factor,
            here,
            self._step,
            self._reporter,
        )
        ending = path.follow(accept)
        if ending.kind == "reached":
            equilibrium = self._return_to_load(ending.equilibrium)
            if equilibrium is not None:
                check(equilibrium.balance)
                return equilibrium
        if (message := _GIVES_WAY.get(ending.kind)) is None:
            raise refused
        failure = SolveFailed("snap_through", message.format(f"{ending.factor:.3g}", self._load))
        failure.load_factor = ending.factor
        raise failure

    def _return_to_load(self, beyond: Equilibrium) -> Equilibrium | None:
        """Go back from a state just beyond the full load to the full load."""
        start = self._system.reload(beyond.balance, self._wrench)
        try:
            equilibrium = find_equilibrium(self._system, start, beyond.tangent, self._reporter(1.0))
        except Stuck:
            return None
        if equilibrium.balance.least_stretch <= 0 or not equilibrium.tangent.stable:
            return None
        self._accept(equilibrium, 1.0)
        return equilibrium

    def _try_step(self) -> Equilibrium | None:
        """Return the equilibrium of the next step; None after a step was halved."""
        target = min(1.0, self._factor + self._step)
        if target > 1.0 - 0.5 * _MIN_STEP:
            target = 1.0
        try:
            start = self._system.reload(self._balance, target * self._wrench)
            max_iterations = MAX_ITERATIONS if self._factor == 0 else _FEW_ITERATIONS + 1
            equilibrium = find_equilibrium(
                self._system, start, self._tangent, self._reporter(target), max_iterations
            )
        except Stuck as stuck:
            if stuck.at_roundoff:
                message = f"At load factor {target:.3g}, {stuck}."
                raise SolveFailed("ill_conditioned", message) from None
            self._halve(str(stuck))
            return None
        if equilibrium.balance.least_stretch <= 0:
            self._halve("cells are turned inside out", "inverted_elements")
        elif not equilibrium.tangent.stable:
            self._halve("the equilibrium found is unstable", "snap_through")
        elif not self._explained(equilibrium, target):
            self._halve("the part moves further than its stiffness explains", "snap_through")
        else:
            self._accept(equilibrium, target)
            return equilibrium
        return None

    def _explained(self, equilibrium: Equilibrium, target: float) -> bool:
        """Return whether a step's secant lies between the tangents at its ends, about."""
        slopes = self._slope(self._tangent), self._slope(equilibrium.tangent)
        secant = self._advance(equilibrium) / (target - self._factor)
        low, high = min(slopes), max(slopes)
        return low * (1 - _SECANT_MARGIN) <= secant <= high * (1 + _SECANT_MARGIN)

    def _accept(self, equilibrium: Equilibrium, target: float) -> None:
        """Take a converged step over: its load factor, state and work."""
        advance = self._advance(equilibrium)
        start, end = self._slope(self._tangent), self._slope(equilibrium.tangent)
        # The factor as a cubic in the advance, by its values and slopes at both ends, integrated.
        mean = 0.5 * (self._factor + target) + advance * (1 / start - 1 / end) / 12
        self.work += self._size * advance * mean
        self._balance = equilibrium.balance
        self._tangent = equilibrium.tangent
        self._factor = target
        if equilibrium.iterations <= _FEW_ITERATIONS:
            self._step *= GROWTH

    def _halve(self, reason: str, kind: FailureKind | None = None) -> None:
        """Take a step back; raise SolveFailed if it already was the shortest.

        kind: kind of the failure then; None decides between a part that softens and a bad
        convergence.
        """
        self._step = 0.5 * min(self._step, 1.0 - self._factor)
        if self._step >= _MIN_STEP:
            return
        message = f"Beyond load factor {self._factor:.3g}, {reason}."
        if kind is None and self._softened > _SOFTENED:
            kind = "snap_through"
            message += f" There the part is {self._softened:.1f} times as soft as it is unloaded."
        raise _Refused(SolveFailed(kind or "not_converged", message))

    @property
    def _softened(self) -> float:
        return self._slope(self._tangent) / self._slope(self._system.undeformed)

    def _slope(self, tangent: Linearisation) -> float:
        """Rate of `_advance` by the load factor, J."""
        return float(self._direction @ tangent.conjugate_rate(self._wrench))

    def _advance(self, equilibrium: Equilibrium) -> float:
        """Work of the inputs `_direction` in a step, J; see `Linearisation.conjugate_rate`."""
        ends = (self._balance.state.interface, equilibrium.balance.state.interface)
        advance: list[np.ndarray] = []
        for start, end in zip(*map(each_interface, ends), strict=True):
            spin = rotation_vector(rotation(end[3:]) @ rotation(start[3:]).T)
            advance += [(end - start)[:3], spin]
        if self._system.body.expands:
            both = (self._balance, equilibrium.balance)
            body = self._system.body
            middle = 0.5 * sum(self._system.temperature(motion.wrench) for motion in both)
            start, end = (body.thermal_rates(motion.state.nodes, middle)[1] for motion in both)
            advance.append(np.array([start - end]))
        moved = equilibrium.balance.state.nodes - self._balance.state.nodes
        advance.append(contract(self._system.body_force, moved[:, :, None])[:, 0])
        return float(self._direction @ np.concatenate(advance))

    def _reporter(self, target: float) -> Report:
        """Return the function that a balance at the load factor `target` calls per iteration."""

        def report(iteration: int, norm: float) -> None:
            self.history.append(Iteration(target, iteration, norm))
            if self._progress is not None:
                done = self._factor + (min(target, 1.0) - self._factor) * (1 - _UNDONE**iteration)
                self._progress(done, f"load factor {target:.2f}, iteration {iteration}")

        return report


def equilibrium_under_weight(
    system: System,
    check: Callable[[Balance], None],
    start: CoupledState | None = None,
    cause: str = "self-weight",
    load: str = "its weight",
    remedy: str = _WEIGHT_REMEDY,
) -> Equilibrium:
    """Return the equilibrium under self-weight and no wrench.

    system: with its weight.
    check: as of `LoadPath.follow`.
    start: the state after bolts are tightened, without the weight; None without bolts.
    cause, load: the weight's names in messages.
    remedy: of failures that less load cures.

    Raises SolveFailed as `LoadPath.follow` does, for the weight instead of the wrench; it has
    `last`.
    """
    assert system.weight is not None
    further = system.weight[:, :, None]
    growing = System(system.body, system.coupling, body_force=further, preload=system.preload)
    unloaded = None if start is None else equilibrium_at(growing, start)
    path = LoadPath(growing, np.eye(growing.n_inputs)[-1], None, unloaded, load)
    try:
        equilibrium = path.follow(check)
    except SolveFailed as failure:
        text = failure.message[0].lower() + failure.message[1:]
        message = f"Under {cause} alone, before any wrench, {text}"
        if failure.kind in _OF_ANY_LOAD:
            remedy = failure.remedy
        other = SolveFailed(failure.kind, message, remedy)
        other.last = path.last_state()
        raise other from None
    balance = system.balance(equilibrium.balance.state, np.zeros(system.n_inputs))
    stiffness = equilibrium.tangent.tangent
    tangent = Linearisation(system.body, system.coupling, balance, stiffness, system.body_force)
    return Equilibrium(balance, tangent, equilibrium.iterations)


def equilibrium_at(system: System, state: CoupledState) -> Equilibrium:
    """Return the equilibrium of no inputs from its state."""
    balance = system.balance(state, np.zeros(system.n_inputs))
    return Equilibrium(balance, system.linearise(balance), 0)
