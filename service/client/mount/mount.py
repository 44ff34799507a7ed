"""The one-side joint: a wrench from a simulation in, the pose of the interface back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...contract import OUTPUTS
from ..errors import DisplacementUnknown, InvalidArgument, MountWarning, warn
from ..recorder import Recorder
from ..recording import Started
from ..replies import Displacement
from ..rotation import rotation_matrix
from ..wrenches import ON_THIN, OnThin, Tolerance, Vector, tolerance_body
from . import reading
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
from .source import Ask, from_server, from_solves, from_table, is_table, require_server

if TYPE_CHECKING:
    from .. import Client, Table

Pose = tuple[Vector, Vector]

MODES = ("table", "solve", "record", "envelope")
RELAXATIONS = ("aitken", "newton", "off")
_MEANS = {
    "thin": "the table is too thin here: answers are estimates, with wider error bars",
    "outside": "the wrench is outside the table or the load range: answers are flagged estimates",
    "unknown": "the table cannot answer: the pose of before is kept",
}


@dataclass(frozen=True)
class First:
    """The first answer of a kind: its number from 1, wrench (6,), N and N·m, why not covered."""

    step: int
    wrench: Vector = field(repr=False)
    reason: str


@dataclass
class Coverage:
    """How many answers of a run were covered, thin, outside, or unknown.

    Attributes
    ----------
    covered, thin, outside, unknown : int
        ``unknown``: the table had nothing to say, and the pose of before was kept.
    first : dict of str to First
        The first answer of each kind but covered.
    widest : numpy.ndarray
        Shape (6,), m and rad: the widest error bar of each output so far.
    """

    covered: int = 0
    thin: int = 0
    outside: int = 0
    unknown: int = 0
    first: dict[str, First] = field(default_factory=dict)
    widest: Vector = field(default_factory=lambda: np.zeros(6))

    @property
    def answers(self) -> int:
        """How many answers there were."""
        return self.covered + self.thin + self.outside + self.unknown

    def add(self, answer: Displacement, *, known: bool) -> None:
        """Count an answer; warn at the first of its kind."""
        kind = answer.coverage if known else "unknown"
        setattr(self, kind, getattr(self, kind) + 1)
        bars = answer.error_vector
        if bars is not None:
            np.fmax(self.widest, bars, out=self.widest)  # NaN where a table does not measure
        if kind != "covered" and kind not in self.first:
            self.first[kind] = First(self.answers, answer.wrench, answer.reason)
            reason = f" ({answer.reason})" if answer.reason else ""
            warn(
                f"{answer.component}, answer {self.answers}: {_MEANS[kind]}{reason}. This is said "
                "once; the mount's coverage counts them",
                MountWarning,
            )

    def __str__(self) -> str:
        lines = [
            f"{self.answers} answers: {self.covered} covered, {self.thin} thin, "
            f"{self.outside} outside, {self.unknown} unknown"
        ]
        lines += [
            f"  first {kind}: answer {first.step}, {first.reason}"
            for kind, first in self.first.items()
        ]
        return "\n".join(lines)


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
        source: Table | Client,
        component: str,
        R0: ArrayLike,
        p0: ArrayLike,
        mode: str = "table",
        tolerance: Tolerance | None = None,
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
        _require_word("mode", mode, MODES)
        _require_word("on_thin", on_thin, ON_THIN)
        _require_word("unmeasured", unmeasured, ("refuse", "rigid"))
        self.component, self.mode = component, mode
        self._unmeasured, self._newton = unmeasured, relaxation == "newton"
        self._relaxation = Relaxation(_fixed_factor(relaxation))
        self._stepped = self._warned = self._primed = False
        self._stiffness = None if stiffness is None else np.array(stiffness, dtype=float)
        if self._stiffness is not None and not (
            self._stiffness.shape == (6, 6) and np.isfinite(self._stiffness).all()
        ):
            shape = self._stiffness.shape
            raise InvalidArgument(f"stiffness must be finite, of shape (6, 6), not {shape}")
        self.place(R0, p0)
        limit = None if tolerance is None else tolerance_body(tolerance)
        self.recorder: Recorder | None = None
        self._ask: Ask | None = None
        if mode in ("record", "envelope"):
            server = require_server(source, mode)
            kind = "recording" if mode == "record" else "envelope"
            self.recorder = Recorder(server, component, kind, block)
        elif mode == "solve":
            server = require_server(source, mode)
            limit, self._ask = from_solves(server, component, limit, solve_timeout, beyond_range)
        elif is_table(source):
            limit, self._ask = from_table(source, component, limit, method)
        else:
            server = require_server(source, mode)
            limit, self._ask = from_server(server, component, limit, method, on_thin)
        self._scale = Scale(limit)
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
        if (
            self._stepped
            and not self._warned
            and not all(map(np.array_equal, pose, self._undeformed))
        ):
            self._warned = True
            warn(
                f"{self.component}: the base has moved while time passes. A mount is for statics "
                "and slow scenes on a fixed base: the scene does not feel the base's velocity and "
                "acceleration. Use a joint (wrenchbook.MujocoJoint, wrenchbook.Joint)",
                MountWarning,
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
        if self.recorder is not None:
            self.recorder.add(wrench)
            return self.pose
        answer, target = self._answer(wrench)
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
        scene: Callable[[Vector, Vector], ArrayLike | tuple[ArrayLike, ArrayLike]],
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
        if self._ask is None:
            raise InvalidArgument(
                f"mode {self.mode!r} lets nothing move; settle by 'table' or 'solve'"
            )
        if not (accuracy > 0.0 and most >= 1):
            raise InvalidArgument("accuracy must be over 0, in tolerances, and most at least 1")

        def read(displacement: Vector) -> Vector:
            before, self.displacement = self.displacement, within_limit(displacement)
            try:
                wrench = scene(*self.pose)  # `wrench_of` takes moments about this pose
            finally:
                self.displacement = before
            pair = wrench if isinstance(wrench, tuple) and len(wrench) == 2 else (wrench, None)
            return reading.checked_reading(*pair)

        def ask(wrench: Vector) -> tuple[Displacement, Vector]:
            answer, target = self._answer(wrench)
            if target is None:
                raise DisplacementUnknown(
                    f"{self.component} cannot answer this wrench ({answer.reason or 'no rows'}); "
                    "fill its table, or settle with mode='solve'"
                )
            return answer, target

        loop, radius = Loop(read, ask, self._scale, accuracy, most), None
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

    def _answer(self, wrench: Vector) -> tuple[Displacement, Vector | None]:
        """Return the answer to a wrench (6,), N and N·m, counted, and its numbers (6,), if any.

        DisplacementUnknown if an output is not in the table and is not taken as rigid.
        """
        assert self._ask is not None
        unprimed = self._stiffness is not None and not self._primed
        answer = self._ask(wrench, self._newton or unprimed)
        target = answer.vector
        if target is not None and math.isnan(float(target.sum())):
            missing = np.isnan(target)
            if self._unmeasured == "refuse":
                names = ", ".join(np.array(OUTPUTS)[missing])
                raise DisplacementUnknown(
                    f"the table of {answer.component} does not say {names} under this wrench, and "
                    "a pose needs all six: load a table that has them, name them among the scene's "
                    "outputs if it was cut to one, or make the mount with unmeasured='rigid', "
                    "which takes 0 for them"
                )
            target = np.where(missing, 0.0, target)
        self.coverage.add(answer, known=target is not None)
        if unprimed and self._stiffness is not None and answer.derivative is not None:
            # Half of what is still stable stops the stiffest direction in one step: 1/(1 + G).
            factor = 0.5 * stable_factor(np.nan_to_num(answer.derivative), self._stiffness)
            self._relaxation.begin_at(factor)
            self._primed = True
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


def _require_word(name: str, word: str, words: tuple[str, ...]) -> None:
    if word not in words:
        raise InvalidArgument(f"{name} must be one of {', '.join(words)}, not {word!r}")


def _fixed_factor(relaxation: str | float) -> float | None:
    """Return the fixed factor of a relaxation, or None for Aitken's."""
    if isinstance(relaxation, str):
        _require_word("relaxation", relaxation, RELAXATIONS)
        return None if relaxation == "aitken" else 1.0
    if not isinstance(relaxation, Real) or not 0.0 < relaxation <= 1.0:
        raise InvalidArgument(
            f"relaxation must be one of {', '.join(RELAXATIONS)}, or a fixed factor over 0 and at "
            f"most 1, not {relaxation!r}"
        )
    return float(relaxation)
