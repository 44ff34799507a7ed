"""The static loop: a scene that stands still, and a component that bends until it fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..errors import CouplingDiverged, MountError
from ..replies import Displacement
from ..wrenches import Vector
from .relaxation import REMEDY, Relaxation, Scale, spectral_radius

HALVINGS = 6  # of a Newton step that leads further away: 1/64 of it still counts as a direction
RUNAWAY = 6  # residuals in a row that grow the same way: no overshoot, and no rest ahead
STEP = 1.0  # tolerances: how far a scene is moved to see its stiffness


@dataclass(frozen=True, eq=False)
class Settled:
    """Where a static loop came to rest.

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
        How far pose and answer were apart, in tolerances, answer by answer.
    spectral_radius : float or None
        G of compliance times the scene's stiffness, where Newton has seen both.
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
        """The number of answers of the component."""
        return len(self.residuals)


@dataclass
class CouplingIteration:
    """Where an iteration stands, and its residual: answer less displacement (6,), m and rad."""

    displacement: Vector  # (6,), m and rad
    wrench: Vector  # (6,), N and N·m
    answer: Displacement
    residual: Vector
    scaled: Vector  # the residual in tolerances
    size: float  # its largest


@dataclass
class Loop:
    """What the static loops have in common."""

    read: Callable[[Vector], Vector]  # the scene: displacement (6,), m and rad, to wrench
    ask: Callable[[Vector], tuple[Displacement, Vector]]  # the component: wrench to answer (6,)
    scale: Scale
    accuracy: float  # tolerances that each output may still be off
    most: int  # answers
    residuals: list[float] = field(default_factory=list)  # in tolerances

    def evaluate(self, displacement: Vector) -> CouplingIteration:
        """Set a displacement, read the scene, and ask; CouplingDiverged after the last answer."""
        if len(self.residuals) >= self.most:
            raise CouplingDiverged(
                f"no rest after {self.most} answers: pose and answer are still "
                f"{self.residuals[-1]:.3g} tolerances apart, {self.accuracy:g} are asked. {REMEDY}",
                self.residuals,
            )
        wrench = self.read(displacement)
        answer, answered = self.ask(wrench)
        self.scale.see(answered)
        residual = answered - displacement
        scaled = self.scale.measure(residual)
        self.residuals.append(float(np.abs(scaled).max()))
        return CouplingIteration(displacement, wrench, answer, residual, scaled, self.residuals[-1])


def by_relaxation(loop: Loop, start: Vector, relaxation: Relaxation) -> CouplingIteration:
    """Settle by following the answers, from a displacement (6,), m and rad.

    CouplingDiverged if scene and component drive each other apart, or do not come to rest.
    """
    relaxation.restart()
    state, runaway = loop.evaluate(start), 0
    while state.size > loop.accuracy:
        try:
            factor = relaxation.follow(state.scaled, driven=False)
        except CouplingDiverged as error:
            raise CouplingDiverged(str(error), loop.residuals) from None
        before, state = state, loop.evaluate(state.displacement + factor * state.residual)
        # Both in the tolerances of now: those derived from answers grow.
        same_way = float(loop.scale.measure(before.residual) @ state.scaled) > 0
        runaway = runaway + 1 if same_way and state.size > before.size else 0
        if runaway == RUNAWAY:
            raise CouplingDiverged(
                "the scene has no equilibrium on this component: each time the pose follows, the "
                f"wrench grows (by now {state.size:.3g} tolerances apart). It tips or buckles: a "
                "stiffer component, less load, or another start.",
                loop.residuals,
            )
    return state


def by_newton(
    loop: Loop, start: Vector, stiffness: Vector | None
) -> tuple[CouplingIteration, float | None]:
    """Settle by Newton, from a displacement (6,), m and rad; return also G.

    The residual U(W(u)) - u has the slope C K - I: C the answer's derivative, K the scene's dw/du
    (6, 6), N/m, N/rad, N·m/m, N·m/rad, given or by differences. CouplingDiverged if no part of a
    step leads nearer, or there is no rest.
    """
    state, radius = loop.evaluate(start), None
    while state.size > loop.accuracy:
        slope = stiffness if stiffness is not None else _differences(loop, state)
        compliance = state.answer.derivative
        if compliance is None:
            raise MountError(
                f"{state.answer.component} tells no derivative under this wrench, and Newton needs "
                "it: settle with relaxation='aitken'"
            )
        product = np.nan_to_num(compliance) @ slope  # NaN: an output that is taken as rigid
        radius = spectral_radius(np.nan_to_num(compliance), slope)
        try:
            step = np.asarray(np.linalg.solve(np.eye(6) - product, state.residual), dtype=float)
        except np.linalg.LinAlgError:
            raise CouplingDiverged(
                "the scene has no equilibrium here: its stiffness just takes the component's away "
                f"(G = {radius:.3g}). {REMEDY}",
                loop.residuals,
                radius,
            ) from None
        state = _nearer(loop, state, step, radius)
    return state, radius


def _nearer(loop: Loop, state: CouplingIteration, step: Vector, radius: float) -> CouplingIteration:
    """Go a Newton step (6,), m and rad, or the part of it that leads nearer."""
    fraction = 1.0
    for _ in range(HALVINGS):
        tried = loop.evaluate(state.displacement + fraction * step)
        if tried.size < state.size or tried.size <= loop.accuracy:
            return tried
        fraction *= 0.5
    raise CouplingDiverged(
        f"Newton finds no way nearer: pose and answer stay {state.size:.3g} tolerances apart "
        f"(G = {radius:.3g}). A contact that opens or closes has no slope: settle with "
        "relaxation='aitken', or start nearer.",
        loop.residuals,
        radius,
    )


def _differences(loop: Loop, state: CouplingIteration) -> Vector:
    """Return the scene's stiffness dw/du (6, 6), N/m to N·m/rad, by small moves of it."""
    sizes = np.where(loop.scale.tolerance > 0.0, STEP * loop.scale.tolerance, 1e-9)
    slope = np.empty((6, 6))
    for column, size in enumerate(sizes):
        displacement = state.displacement.copy()
        displacement[column] += size
        slope[:, column] = (loop.read(displacement) - state.wrench) / size
    loop.read(state.displacement)  # the scene stands again where it stood
    return slope
