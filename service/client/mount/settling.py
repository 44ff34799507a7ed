"""The static loop: a scene that stands still, and a component that bends until it fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..replies import Displacement
from .errors import CouplingDiverged, MountError
from .relaxation import REMEDY, Relaxation, Scale, spectral_radius

Vector = NDArray[np.float64]
# The scene: a displacement, shape (6,), m and rad, to its wrench, shape (6,), N and N·m.
Reading = Callable[[Vector], Vector]
# The component: a wrench to its answer, and that as numbers, shape (6,), m and rad.
Asking = Callable[[Vector], tuple[Displacement, Vector]]

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
    """One iteration: where it stands and how far off it is.

    Attributes
    ----------
    displacement, wrench, answered : numpy.ndarray
        Shape (6,), m and rad; N and N·m; m and rad.
    answer : Displacement
    size : float
        Of the residual, in tolerances.
    """

    displacement: Vector
    wrench: Vector
    answer: Displacement
    answered: Vector
    size: float = np.inf

    @property
    def residual(self) -> Vector:
        """Answer less displacement, shape (6,), m and rad."""
        return self.answered - self.displacement


@dataclass
class Loop:
    """What the static loops have in common.

    Attributes
    ----------
    read, ask : callable
        The scene and the component.
    scale : Scale
    accuracy : float
        Tolerances that each output may still be off.
    most : int
        Answers at most.
    residuals : list of float
        In tolerances.
    """

    read: Reading
    ask: Asking
    scale: Scale
    accuracy: float
    most: int
    residuals: list[float] = field(default_factory=list)

    def evaluate(self, displacement: Vector) -> CouplingIteration:
        """Set a displacement, shape (6,), m and rad, read the scene, and ask.

        Raises
        ------
        CouplingDiverged
            If the component has given the most answers allowed.
        """
        if len(self.residuals) >= self.most:
            raise CouplingDiverged(
                f"no rest after {self.most} answers: pose and answer are still "
                f"{self.residuals[-1]:.3g} tolerances apart, {self.accuracy:g} are asked. {REMEDY}",
                self.residuals,
            )
        wrench = self.read(displacement)
        answer, answered = self.ask(wrench)
        self.scale.see(answered)
        state = CouplingIteration(displacement, wrench, answer, answered)
        state.size = float(np.abs(self.scale.measure(state.residual)).max())
        self.residuals.append(state.size)
        return state


def by_relaxation(loop: Loop, start: Vector, relaxation: Relaxation) -> CouplingIteration:
    """Settle by following the answers, from a displacement, shape (6,), m and rad.

    Raises
    ------
    CouplingDiverged
        If scene and component drive each other apart, or do not come to rest.
    """
    relaxation.restart()
    state, runaway = loop.evaluate(start), 0
    while state.size > loop.accuracy:
        try:
            factor = relaxation.follow(loop.scale.measure(state.residual), driven=False)
        except CouplingDiverged as error:
            raise CouplingDiverged(str(error), loop.residuals) from None
        before, state = state, loop.evaluate(state.displacement + factor * state.residual)
        same_way = (
            float(loop.scale.measure(before.residual) @ loop.scale.measure(state.residual)) > 0
        )
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
    """Settle by Newton, from a displacement, shape (6,), m and rad; return also G.

    The residual U(W(u)) - u has the slope C K - I: C the answer's derivative, K the scene's dw/du,
    shape (6, 6), N/m, N/rad, N·m/m, N·m/rad, given or by differences.

    Raises
    ------
    CouplingDiverged
        If no part of a step leads nearer, or there is no rest.
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
    """Go a Newton step, shape (6,), m and rad, or the part of it that leads nearer."""
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
    """Return the scene's stiffness dw/du, shape (6, 6), N/m to N·m/rad, by small moves of it."""
    sizes = np.where(loop.scale.tolerance > 0.0, STEP * loop.scale.tolerance, 1e-9)
    slope = np.empty((6, 6))
    for column, size in enumerate(sizes):
        displacement = state.displacement.copy()
        displacement[column] += size
        slope[:, column] = (loop.read(displacement) - state.wrench) / size
    loop.read(state.displacement)  # the scene stands again where it stood
    return slope
