"""The equilibrium of a component and a scene that stands still: by relaxation or Newton's steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..errors import CouplingDiverged, MountError
from ..replies import Displacement
from ..wrenches import Vector
from .coupling import REMEDY, Relaxation, Scale, spectral_radius

MAX_ATTEMPTS = 6  # with a Newton step, each with half of the last: from the whole to 1/32
MAX_RUNAWAY = 6  # residuals in a row that grow in the same direction: no equilibrium ahead
STEP = 1.0  # tolerances: motion of a scene for its stiffness by differences
STEP_WITHOUT_TOLERANCE = 1e-9  # m or rad: the same, and a tolerance, before answers give one


@dataclass(frozen=True, eq=False)
class Settled:
    """The equilibrium of a static loop.

    Attributes
    ----------
    R, p : numpy.ndarray
        The pose of the interface, shape (3, 3) and shape (3,), m.
    wrench : numpy.ndarray
        Shape (6,), N and N·m, there.
    displacement : numpy.ndarray
        Shape (6,), m and rad, there.
    answer : Displacement
        The component's last answer, with its error bars and coverage.
    residuals : tuple of float
        Distance of pose and answer, in tolerances, for each answer.
    spectral_radius : float or None
        Spectral radius of compliance times stiffness at the last Newton step; None without one.
    """

    R: Vector
    p: Vector
    wrench: Vector
    displacement: Vector
    answer: Displacement
    residuals: tuple[float, ...]
    spectral_radius: float | None = None

    @property
    def iterations(self) -> int:
        """The number of the component's answers."""
        return len(self.residuals)


@dataclass
class CouplingIteration:
    """The state of an iteration, with its residual: answer less displacement (6,), m and rad."""

    displacement: Vector  # (6,), m and rad
    wrench: Vector  # (6,), N and N·m
    answer: Displacement
    residual: Vector
    scaled: Vector  # the residual in tolerances
    size: float  # the largest of the scaled residual


@dataclass
class Loop:
    """A scene that stands still and a component: a limited number of answers, each recorded."""

    read: Callable[[Vector], Vector]  # the scene: displacement (6,), m and rad, to wrench
    ask: Callable[[Vector], tuple[Displacement, Vector]]  # the component: wrench to answer (6,)
    scale: Scale
    accuracy: float  # tolerances by which each output may still be off
    max_answers: int
    residuals: list[float] = field(default_factory=list)  # in tolerances

    def measure(self, residual: Vector) -> Vector:
        """Return a residual (6,), m and rad, in tolerances.

        Outputs without a tolerance are measured in `STEP_WITHOUT_TOLERANCE`.
        """
        without = self.scale.tolerance == 0.0  # all answers so far are 0, which settles nothing
        return self.scale.measure(residual) + without * residual / STEP_WITHOUT_TOLERANCE

    def size(self, residual: Vector) -> float:
        """Return the largest of a residual (6,), m and rad, in the present tolerances.

        Those derived from answers grow: only sizes in the same tolerances can be compared.
        """
        return float(np.abs(self.measure(residual)).max())

    def evaluate(self, displacement: Vector) -> CouplingIteration:
        """Evaluate scene and component at a displacement (6,); raises CouplingDiverged."""
        if len(self.residuals) >= self.max_answers:
            raise CouplingDiverged(
                f"the coupling has not settled after {self.max_answers} answers: pose and answer "
                f"are {self.residuals[-1]:.3g} tolerances apart, above {self.accuracy:g}. If they "
                f"still approach, raise most=. {REMEDY}",
                self.residuals,
            )
        wrench = self.read(displacement)
        answer, answered = self.ask(wrench)
        self.scale.update(answered)
        residual = answered - displacement
        scaled = self.measure(residual)
        self.residuals.append(self.size(residual))
        return CouplingIteration(displacement, wrench, answer, residual, scaled, self.residuals[-1])


def by_relaxation(loop: Loop, start: Vector, relaxation: Relaxation) -> CouplingIteration:
    """Find the equilibrium by relaxation from a displacement (6,); raises CouplingDiverged."""
    relaxation.restart()
    state = loop.evaluate(start)
    runaway = 0
    while state.size > loop.accuracy:
        try:
            factor = relaxation.next_factor(state.scaled, driven=False)
        except CouplingDiverged as error:
            raise CouplingDiverged(str(error), loop.residuals) from None
        before = state
        state = loop.evaluate(state.displacement + factor * state.residual)
        same_way = float(loop.measure(before.residual) @ state.scaled) > 0
        runaway = runaway + 1 if same_way and state.size > loop.size(before.residual) else 0
        if runaway == MAX_RUNAWAY:
            raise CouplingDiverged(
                "the scene has no equilibrium on this component: it tips or buckles, and pose and "
                f"answer are {state.size:.3g} tolerances apart. Use a stiffer component, a smaller "
                "load, or another start.",
                loop.residuals,
            )
    return state


def newton_step(compliance: Vector, stiffness: Vector, residual: Vector) -> Vector:
    """Return the change of displacement (6,), m and rad, by which a residual (6,) becomes zero.

    It is (I - C K)^-1 r with the compliance C and the scene's stiffness K (6, 6), SI. Outputs whose
    compliance is NaN count as rigid.
    """
    matrix = np.eye(6) - np.nan_to_num(compliance) @ stiffness
    return np.asarray(np.linalg.solve(matrix, residual), dtype=float)


def _stiffness_of_scene(loop: Loop, state: CouplingIteration) -> Vector:
    """Return the scene's dw/du (6, 6), SI, by small motions from a state, to which it returns."""
    stiffness = np.empty((6, 6))
    tolerance = loop.scale.tolerance
    sizes = np.where(tolerance > 0.0, STEP * tolerance, STEP_WITHOUT_TOLERANCE)
    for column, size in enumerate(sizes):
        displacement = state.displacement.copy()
        displacement[column] += size
        stiffness[:, column] = (loop.read(displacement) - state.wrench) / size
    loop.read(state.displacement)
    return stiffness


def by_newton(
    loop: Loop, start: Vector, stiffness: Vector | None
) -> tuple[CouplingIteration, float | None]:
    """Find the equilibrium by Newton's method, from a displacement (6,), m and rad; return also G.

    The residual U(W(u)) - u has the slope C K - I: C the answer's derivative, K the scene's dw/du
    (6, 6), N/m, N/rad, N·m/m, N·m/rad, given or by differences.

    Raises CouplingDiverged if no part of a step leads nearer, or there is no equilibrium.
    """
    state = loop.evaluate(start)
    radius = None
    while state.size > loop.accuracy:
        slope = _stiffness_of_scene(loop, state) if stiffness is None else stiffness
        compliance = state.answer.derivative
        if compliance is None:
            raise MountError(
                f"{state.answer.component} has no derivative at this wrench, which Newton needs; "
                "settle with relaxation='aitken'"
            )
        if not np.isfinite(np.nan_to_num(compliance) @ slope).all():
            raise CouplingDiverged(
                f"the scene's stiffness is not finite at {state.displacement} m and rad, so Newton "
                "has no step: its wrench jumps there. Settle with relaxation='aitken', or give "
                "stiffness=.",
                loop.residuals,
            )
        radius = spectral_radius(np.nan_to_num(compliance), slope)
        try:
            step = newton_step(compliance, slope, state.residual)
        except np.linalg.LinAlgError:
            raise CouplingDiverged(
                "the scene has no stable equilibrium here: its negative stiffness cancels the "
                f"component's (G = {radius:.3g}). {REMEDY}",
                loop.residuals,
                radius,
            ) from None

        fraction = 1.0  # the part of the step that leads nearer
        before = state
        for _ in range(MAX_ATTEMPTS):
            state = loop.evaluate(before.displacement + fraction * step)
            if state.size < loop.size(before.residual) or state.size <= loop.accuracy:
                break
            fraction *= 0.5
        else:
            raise CouplingDiverged(
                f"Newton does not converge: pose and answer stay {loop.size(before.residual):.3g} "
                f"tolerances apart (G = {radius:.3g}), for example because a contact opens or "
                "closes. Settle with relaxation='aitken', or start nearer.",
                loop.residuals,
                radius,
            )
    return state, radius
