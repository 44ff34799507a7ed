"""The one-side joint: a wrench from a simulation in, the pose of the interface back."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...contract import OnThin
from ..errors import InvalidArgument
from ..recorder import Recorder
from ..recording import Started
from ..replies import Displacement
from ..rotation import rotation_matrix
from ..wrenches import ON_THIN, tolerance_body
from . import options, reading
from .errors import DisplacementUnknown, MountWarning
from .frequency import warn_if_ringing
from .relaxation import (
    BEYOND,
    CycleWatch,
    Relaxation,
    Scale,
    require_within_limit,
    stable_factor,
    within_limit,
)
from .settling import Loop, Settled, by_newton, by_relaxation
from .source import SolveSource, Source, known, table_source
from .tally import Coverage

Vector = NDArray[np.float64]
Pose = tuple[Vector, Vector]


class Mount:
    """Where a rigid-body simulation stands on a component that bends.

    Parameters
    ----------
    source : Table or Client
        Who answers: a downloaded table, or the server. All modes but ``table`` need the server.
    component : str
    R0, p0 : array_like
        The undeformed interface in the world: axes as columns, shape (3, 3), and point, shape
        (3,), m.
    mode : {"table", "solve", "record", "envelope"}
        ``table`` answers each step from the table; ``solve`` waits for a finite-element solve of
        each (DirectFEA); ``record`` saves the wrenches and lets the component stay rigid
        (LM_direct), ``envelope`` keeps their extremes (LM_max), both until `start` has them solved.
    tolerance : mapping or pair, optional
        ``translation``, m, and ``rotation``, rad; the component's own otherwise.
    relaxation : {"aitken", "newton", "off"} or float
        How far a pose follows its answer: by Aitken's factor, by Newton with the answer's
        derivative and the scene's stiffness, all the way, or by a fixed fraction, 0 to 1.
    on_thin : {"queue", "estimate", "reject", "wait"}
        What the server does where its table is too thin; measured tables are only estimated.
    method : str, optional
        How the table shall answer; the component's own choice otherwise.
    stiffness : array_like, optional
        The scene's dw/du at the interface point where it is now, shape (6, 6), N/m, N/rad, N·m/m,
        N·m/rad. `step` needs it with ``newton``; with ``aitken`` it gives the first factor;
        `settle` finds its own.
    unmeasured : {"refuse", "rigid"}
        What an output does that the table does not hold, or that its scene does not read: raise,
        or not move.
    natural_frequency, ramp_time : float, optional
        The component's first, with what it carries, Hz, and the time in which loads build up, s: a
        warning says when answers at rest will miss the ringing. With a `ramp_time` alone a server
        tells the frequency: the component's own, lowered by what it carries.
    carried : float or array_like, optional
        The rigid system's mass, kg, or its mass matrix about the interface point, shape (6, 6), kg,
        kg·m, kg·m^2, for that frequency.
    beyond_range : bool
        With ``solve``: whether wrenches beyond the load range are solved.
    solve_timeout : float
        With ``solve``: seconds that a solve may take.
    block : int
        With ``record`` and ``envelope``: wrenches a call.

    Attributes
    ----------
    displacement : numpy.ndarray
        Shape (6,), m and rad: that of the pose now.
    coverage : Coverage
        How the answers so far were covered.
    last : Displacement or None
        The last answer, with its error bars.
    recorder : Recorder or None

    Raises
    ------
    ValueError, TypeError
        If an option is none of its words, a pose no pose, or the mode needs a server.
    ProblemError, ServerUnreachable
        If the server has no such component, or does not answer.
    """

    def __init__(
        self,
        source: Any,
        component: str,
        R0: ArrayLike,
        p0: ArrayLike,
        mode: str = "table",
        tolerance: Any = None,
        relaxation: str | float = "aitken",
        *,
        on_thin: OnThin = "queue",
        method: str | None = None,
        stiffness: ArrayLike | None = None,
        unmeasured: str = "refuse",
        natural_frequency: float | None = None,
        ramp_time: float | None = None,
        carried: float | ArrayLike | None = None,
        beyond_range: bool = False,
        solve_timeout: float = 600.0,
        block: int = 256,
    ) -> None:
        options.require_word("mode", mode, options.MODES)
        options.require_word("on_thin", on_thin, ON_THIN)
        options.require_word("unmeasured", unmeasured, ("refuse", "rigid"))
        self.component, self.mode = component, mode
        self._unmeasured, self._newton = unmeasured, relaxation == "newton"
        self._relaxation = Relaxation(options.fixed_factor(relaxation))
        self._stepped = self._warned = False
        self._stiffness, self._primed = options.square(stiffness), False
        self.place(R0, p0)
        limit = None if tolerance is None else tolerance_body(tolerance)
        self.recorder: Recorder | None = None
        self._source: Source | None = None
        if mode in ("record", "envelope"):
            server = options.require_server(source, mode)
            kind = "recording" if mode == "record" else "envelope"
            self.recorder = Recorder(server, component, kind, block)
        elif mode == "solve":
            server = options.require_server(source, mode)
            self._source = SolveSource(server, component, limit, solve_timeout, beyond_range)
        else:
            self._source = table_source(source, component, limit, method, on_thin)
        self._scale = Scale(self._source.tolerance if self._source else limit)
        self.restart()
        warn_if_ringing(source, component, natural_frequency, ramp_time, carried)

    def place(self, R0: ArrayLike, p0: ArrayLike) -> None:
        """Move the undeformed interface: the component's own base has moved.

        Parameters
        ----------
        R0, p0 : array_like
            Axes as columns, shape (3, 3), and point, shape (3,), m, in the world. Wrenches from
            then on are in this frame.

        Raises
        ------
        ValueError
            If it is no pose; the mount is then where it was.
        """
        pose = reading.checked_pose(R0, p0)
        if self._stepped and not self._warned and _is_other(pose, self._undeformed):
            self._warned = True
            warnings.warn(
                f"{self.component}: the base has moved while time passes. A mount is for statics "
                "and slow scenes on a fixed base: the scene does not feel the base's velocity and "
                "acceleration. Use a joint (wrenchbook.MujocoJoint, wrenchbook.Joint)",
                MountWarning,
                stacklevel=2,
            )
        self._undeformed = pose

    def restart(self) -> None:
        """Go back to the undeformed pose, and count anew: another run begins."""
        self.displacement: Vector = np.zeros(6)
        self._stepped, self._beyond, self._cycles = False, 0, CycleWatch()
        self.coverage = Coverage()
        self.last: Displacement | None = None
        self._relaxation.restart()

    @property
    def undeformed(self) -> Pose:
        """R0, shape (3, 3), and p0, shape (3,), m."""
        return self._undeformed

    @property
    def pose(self) -> Pose:
        """R0 exp(r), shape (3, 3), and p0 + R0 t, shape (3,), m."""
        R0, p0 = self._undeformed
        moved = self.displacement
        return R0 @ rotation_matrix(moved[3:]), p0 + R0 @ moved[:3]

    def wrench_of(self, force: ArrayLike, moment: ArrayLike, point: ArrayLike) -> Vector:
        """Return a wrench read in the world as the contract wants it.

        Parameters
        ----------
        force, moment : array_like
            Shape (3,), N and N·m, acting ON the component, in the world's axes, about `point`.
        point : array_like
            Shape (3,), m, in the world: where the sensor is now.

        Returns
        -------
        numpy.ndarray
            Shape (6,), N and N·m, for `step`: about the interface point where it is now, in axes
            fixed to the undeformed interface frame.

        Notes
        -----
        The interface stands in `pose`: as `step` or `place` has left it, and within `settle` as
        the scene is called with it. Read the sensor in that pose.
        """
        vectors = [np.asarray(one, dtype=float).reshape(3) for one in (force, moment, point)]
        present = self._undeformed[0], self.pose[1]
        return reading.from_world(vectors[0], vectors[1], vectors[2], present)

    def step(self, force: ArrayLike, moment: ArrayLike | None = None) -> Pose:
        """Return the pose of the interface under one wrench; a simulation's sync step.

        Parameters
        ----------
        force, moment : array_like
            Shape (3,), N and N·m, acting ON the component about its interface point where it is
            now, in axes fixed to the undeformed interface frame; or the whole wrench as the force
            alone, shape (6,).

        Returns
        -------
        R, p : numpy.ndarray
            Shapes (3, 3) and (3,), m. With ``record`` and ``envelope`` the undeformed pose.

        Raises
        ------
        SensorError
            If a number is not finite.
        CouplingDiverged
            If pose and wrench drive each other apart, or into a cycle.
        DisplacementUnknown
            If the table lacks an output.
        ProblemError, ServerUnreachable, ServerTimeout
            See `Client.displacement` and `Client.solve`. After any error the mount is as before,
            and the step can be made again.
        """
        wrench = reading.checked_reading(force, moment)
        if self._source is None:
            assert self.recorder is not None
            self.recorder.add(wrench)
            return self.pose
        answer, target = self._ask(self._source, wrench)
        if target is not None:
            self._scale.see(target)
            moved = within_limit(self._followed(answer, target))
            self._cycles.see(self._scale.measure(target))
            self._beyond = 0 if within_limit(target) is target else self._beyond + 1
            if self._beyond > BEYOND:
                require_within_limit(target, self.component)
            self.displacement = moved
        self.last, self._stepped = answer, True
        return self.pose

    def settle(
        self,
        scene: Callable[[Vector, Vector], Any],
        accuracy: float = 1e-3,
        most: int = 50,
    ) -> Settled:
        """Find the pose in which a scene that stands still and the component agree.

        Parameters
        ----------
        scene : callable
            Takes a pose, R, shape (3, 3), and p, shape (3,), m, sets it, evaluates the forces
            without letting time go on, and returns the wrench: force and moment, or shape (6,).
        accuracy : float
            Tolerances that each output may still be off its answer.
        most : int
            Answers at most.

        Returns
        -------
        Settled
            The mount, and the scene, stand in its pose.

        Raises
        ------
        CouplingDiverged
            If there is no rest; its text says why and what to do. The mount is then as before.
        DisplacementUnknown
            If the table cannot answer.
        ValueError
            With mode ``record`` or ``envelope``, which let nothing move; or nothing may be asked.
        """
        loop, radius = self._loop(scene, accuracy, most), None
        if self._newton:
            state, radius = by_newton(loop, self.displacement, self._stiffness)
        else:
            state = by_relaxation(loop, self.displacement, self._relaxation)
        require_within_limit(state.displacement, self.component)
        self.displacement, self.last = state.displacement, state.answer
        residuals = tuple(loop.residuals)
        return Settled(
            *self.pose, state.wrench, state.displacement, state.answer, residuals, radius
        )

    def start(self, **options: Any) -> Started:
        """Have all that was saved solved (LM_start): see `Recorder.start`, also for the options.

        Raises
        ------
        ValueError
            If the mode saves nothing.
        """
        if self.recorder is None:
            raise InvalidArgument(
                f"mode {self.mode!r} saves no wrenches; use 'record' or 'envelope'"
            )
        return self.recorder.start(**options)

    def close(self) -> None:
        """Send what is saved and has not been sent."""
        if self.recorder is not None:
            self.recorder.close()

    def _ask(self, source: Source, wrench: Vector) -> tuple[Displacement, Vector | None]:
        """Return the answer to a wrench, shape (6,), N and N·m, counted, and its numbers."""
        unprimed = self._stiffness is not None and not self._primed
        answer = source.ask(wrench, derivatives=self._newton or unprimed)
        target = known(answer, self._unmeasured)
        self.coverage.add(answer, known=target is not None)
        if unprimed and self._stiffness is not None and answer.derivative is not None:
            # Half of what is still stable stops the stiffest direction in one step: 1/(1 + G).
            factor = 0.5 * stable_factor(np.nan_to_num(answer.derivative), self._stiffness)
            self._relaxation.begin_at(factor)
            self._primed = True
        return answer, target

    def _loop(self, scene: Callable[[Vector, Vector], Any], accuracy: float, most: int) -> Loop:
        """Return a static loop of a scene with this component."""
        source = self._source
        if source is None:
            raise InvalidArgument(
                f"mode {self.mode!r} lets nothing move; settle by 'table' or 'solve'"
            )
        if not (accuracy > 0.0 and most >= 1):
            raise InvalidArgument("accuracy must be over 0, in tolerances, and most at least 1")

        def read(displacement: Vector) -> Vector:
            before, self.displacement = self.displacement, within_limit(displacement)
            try:
                return _reading_of(scene(*self.pose))  # `wrench_of` takes moments about this pose
            finally:
                self.displacement = before

        def ask(wrench: Vector) -> tuple[Displacement, Vector]:
            return self._require_answer(source, wrench)

        return Loop(read, ask, self._scale, accuracy, most)

    def _require_answer(self, source: Source, wrench: Vector) -> tuple[Displacement, Vector]:
        """Return the answer to a wrench, which a static loop cannot do without."""
        answer, target = self._ask(source, wrench)
        if target is None:
            raise DisplacementUnknown(
                f"{self.component} cannot answer this wrench ({answer.reason or 'no rows'}); fill "
                "its table, or settle with mode='solve'"
            )
        return answer, target

    def _followed(self, answer: Displacement, target: Vector) -> Vector:
        """Return where the pose goes, shape (6,), m and rad, on its way to the answer."""
        residual = target - self.displacement
        if not self._newton:
            factor = self._relaxation.follow(self._scale.measure(residual), driven=True)
            return self.displacement + factor * residual
        if self._stiffness is None or answer.derivative is None:
            raise InvalidArgument(
                "relaxation='newton' needs the scene's stiffness= in step, and a derivative of the "
                "answer: give it, settle() instead, or step with relaxation='aitken'"
            )
        self._relaxation.follow(self._scale.measure(residual), driven=True)
        product = np.nan_to_num(answer.derivative) @ self._stiffness
        return self.displacement + np.linalg.solve(np.eye(6) - product, residual)


def _is_other(pose: Pose, before: Pose) -> bool:
    return any((one != other).any() for one, other in zip(pose, before, strict=True))


def _reading_of(read: Any) -> Vector:
    """Return what a scene returns, force and moment or all six, as a wrench, shape (6,)."""
    if isinstance(read, tuple) and len(read) == 2:
        return reading.checked_reading(*read)
    return reading.checked_reading(read, None)
