"""The one-sided joint: the wrench of a simulation in, the pose of the interface out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ...contract import OUTPUTS
from ..errors import DisplacementUnknown, InvalidArgument, MountWarning, SensorError, warn
from ..recorder import Recorder
from ..recording import Started
from ..replies import Displacement
from ..rotation import checked_pose, rotation_matrix
from ..wrenches import (
    ON_THIN,
    OnThin,
    Tolerance,
    Vector,
    floats_of,
    require_one_of,
    single_wrench,
    tolerance_body,
)
from .coupling import (
    MAX_BEYOND,
    CycleWatch,
    Relaxation,
    Scale,
    require_within_limit,
    stable_factor,
    within_limit,
    without_answers,
)
from .ringing import warn_if_ringing
from .sources import Ask, from_server, from_solves, from_table, require_server
from .statics import Loop, Settled, by_newton, by_relaxation, newton_step

if TYPE_CHECKING:
    from .. import Client, Table

Pose = tuple[Vector, Vector]

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, z up
MAX_WEIGHT_ERROR = 0.5  # part of the weight: a larger one is neither noise nor a slow motion

MODES = ("table", "solve", "record", "envelope")
_MEANS = {
    "thin": "the table has few rows here, so answers are estimates with wide bars",
    "outside": "the wrench is outside table or range, so answers are estimates",
    "unknown": "the table cannot answer, so the pose stays; fill the table",
}


@dataclass(frozen=True)
class First:
    """The first answer of a kind: its number from 1, wrench (6,), N and N·m, and the reason."""

    step: int
    wrench: Vector = field(repr=False)
    reason: str


@dataclass
class Coverage:
    """Numbers of answers of a run that were covered, thin, outside, or unknown.

    Attributes
    ----------
    covered, thin, outside, unknown : int
        ``unknown``: the table had no answer, and the pose stayed.
    first : dict of str to First
        The first answer of each kind but covered.
    widest : numpy.ndarray
        Shape (6,), m and rad: the widest error bar of each output so far; NaN without any.
    """

    covered: int = 0
    thin: int = 0
    outside: int = 0
    unknown: int = 0
    first: dict[str, First] = field(default_factory=dict)
    widest: Vector = field(default_factory=lambda: np.full(6, np.nan))

    @property
    def answers(self) -> int:
        """The number of answers."""
        return self.covered + self.thin + self.outside + self.unknown

    def add(self, answer: Displacement, *, known: bool) -> None:
        """Count an answer; warn at the first of its kind."""
        kind = answer.coverage if known else "unknown"
        setattr(self, kind, getattr(self, kind) + 1)
        bars = answer.error_vector
        if bars is not None:
            np.fmax(self.widest, bars, out=self.widest)  # NaN where a table lacks the output
        if kind != "covered" and kind not in self.first:
            self.first[kind] = First(self.answers, answer.wrench, answer.reason)
            reason = f" ({answer.reason})" if answer.reason else ""
            warn(
                f"{answer.component}, answer {self.answers}: {_MEANS[kind]}{reason}. This warning "
                "appears once; the mount's coverage counts all",
                MountWarning,
            )

    def __str__(self) -> str:
        counts = ", ".join(f"{getattr(self, k)} {k}" for k in ("covered", *_MEANS))
        first = [
            f"\n  first {kind}: answer {answer.step}, {answer.reason}"
            for kind, answer in self.first.items()
        ]
        return f"{self.answers} answers: {counts}{''.join(first)}"


class Mount:
    """Takes the wrench at an interface and returns its deformed pose.

    Parameters
    ----------
    source : Table or Client
        A downloaded table or the server, which answers; all modes but ``table`` need the server.
    component : str
        Name of the component.
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
        Fraction of an answer that a pose follows: by Aitken's factor, by Newton with the answer's
        derivative and the scene's stiffness, all the way, or by a fixed fraction, 0 to 1.
    on_thin : {"queue", "estimate", "reject", "wait"}
        Behaviour of the server where its table is thin; measured tables only estimate.
    method : str, optional
        The table's method; the component's own choice otherwise.
    stiffness : array_like, optional
        The scene's dw/du at the interface point where it is now, shape (6, 6), N/m, N/rad, N·m/m,
        N·m/rad. `step` needs it with ``newton``; with ``aitken`` it gives the first factor;
        `settle` finds its own.
    unmeasured : {"refuse", "rigid"}
        Behaviour of an output that the table lacks, or that its scene does not read: raise an
        error, or stay at zero.
    natural_frequency, ramp_time : float, optional
        The component's first, with the carried mass, Hz, and the time in which loads build up, s: a
        warning says when answers at rest will miss the ringing. With a `ramp_time` alone a server
        gives the frequency: the component's, lowered by the carried mass.
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
        Displacement of the present pose, shape (6,), m and rad.
    coverage : Coverage
        Counts of covered, thin, outside and unknown answers so far.
    last : Displacement or None
        The last answer, with its error bars.
    recorder : Recorder or None
        Sends the wrenches of the modes ``record`` and ``envelope``.

    Raises
    ------
    ValueError, TypeError
        If an option or a pose is not valid, or the mode needs a server.
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
        require_one_of("mode", mode, MODES)
        require_one_of("on_thin", on_thin, ON_THIN)
        require_one_of("unmeasured", unmeasured, ("refuse", "rigid"))
        self.component = component
        self.mode = mode
        self._unmeasured = unmeasured
        self._newton = relaxation == "newton"
        self._relaxation = Relaxation(relaxation)
        self._stepped = self._warned = self._primed = False
        self._stiffness = None if stiffness is None else floats_of("stiffness", stiffness, (6, 6))
        self.place(R0, p0)

        limit = None if tolerance is None else tolerance_body(tolerance)
        self.recorder: Recorder | None = None
        self._ask: Ask | None = None
        if mode == "table" and hasattr(source, "answer"):
            limit, self._ask = from_table(cast("Table", source), component, limit, method)
        elif mode == "table":
            server = require_server(source, mode)
            limit, self._ask = from_server(server, component, limit, method, on_thin)
        elif mode == "solve":
            server = require_server(source, mode)
            limit, self._ask = from_solves(server, component, limit, solve_timeout, beyond_range)
        else:
            kind = "recording" if mode == "record" else "envelope"
            self.recorder = Recorder(require_server(source, mode), component, kind, block)

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
        pose = checked_pose(R0, p0)
        if (
            self._stepped
            and not self._warned
            and not all(map(np.array_equal, pose, self._undeformed))
        ):
            self._warned = True
            warn(
                f"{self.component}: the base has moved, but a mount is for statics and slow scenes "
                "on a fixed base, without its velocity and acceleration. Use a joint "
                "(wrenchbook.MujocoJoint, wrenchbook.Joint)",
                MountWarning,
            )
        self._undeformed = pose

    def restart(self) -> None:
        """Go back to the undeformed pose and reset the counts, for another run."""
        self.displacement: Vector = np.zeros(6)
        self._stepped = False
        self._beyond = self._lost = 0
        self._extrapolated = False
        self._cycles = CycleWatch()
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
        """Convert a force and moment in world axes at `point` to a wrench at the interface.

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
        vectors = [np.asarray(vector, dtype=float) for vector in (force, moment, point)]
        for name, vector in zip(("force", "moment", "point"), vectors, strict=True):
            if vector.size != 3:
                raise InvalidArgument(
                    f"{name} must be three numbers (x, y, z), but has the shape {vector.shape}"
                )
        f, m, s = (vector.reshape(3) for vector in vectors)
        return from_world(f, m, s, (self._undeformed[0], self.pose[1]))

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
        wrench = checked_reading(force, moment)
        if self.recorder is not None:
            self.recorder.add(wrench)
            return self.pose
        answer, target = self._answer(wrench)
        if target is not None:
            self._scale.update(target)
            residual = target - self.displacement
            slopes = self._newton_slopes(answer) if self._newton else None
            factor = self._relaxation.next_factor(self._scale.measure(residual), driven=True)
            change = factor * residual if slopes is None else newton_step(*slopes, residual)
            moved = within_limit(self.displacement + change)

            self._cycles.record(self._scale.measure(target))
            self._beyond = 0 if within_limit(target) is target else self._beyond + 1
            if self._beyond > MAX_BEYOND:
                require_within_limit(target, self.component)
            self.displacement = moved
            self._extrapolated = answer.coverage == "outside"
        self._lost = self._lost + 1 if target is None and self._extrapolated else 0
        if self._lost > MAX_BEYOND:
            raise without_answers(self._lost, self.component)

        self.last = answer
        self._stepped = True
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
                f"mode {self.mode!r} does not move the component, so settle has no effect; create "
                "the mount with mode 'table' or 'solve'"
            )
        if not (accuracy > 0.0 and most >= 1):
            raise InvalidArgument(
                f"accuracy must be above 0, and most at least 1, but they are {accuracy} and {most}"
            )

        def read(displacement: Vector) -> Vector:
            before = self.displacement
            self.displacement = within_limit(displacement)
            try:
                wrench = scene(*self.pose)  # `wrench_of` takes moments about this pose
            finally:
                self.displacement = before
            pair = wrench if isinstance(wrench, tuple) and len(wrench) == 2 else (wrench, None)
            return checked_reading(*pair)

        def ask(wrench: Vector) -> tuple[Displacement, Vector]:
            answer, target = self._answer(wrench)
            if target is None:
                raise DisplacementUnknown(
                    f"{self.component} has no answer for this wrench "
                    f"({answer.reason or 'no rows'}); run wrenchbook fill {self.component}, or "
                    "create the mount with mode='solve'"
                )
            return answer, target

        loop = Loop(read, ask, self._scale, accuracy, max_answers=most)
        radius = None
        if self._newton:
            state, radius = by_newton(loop, self.displacement, self._stiffness)
        else:
            state = by_relaxation(loop, self.displacement, self._relaxation)

        require_within_limit(state.displacement, self.component)
        self.displacement = state.displacement
        self.last = state.answer
        residuals = tuple(loop.residuals)
        return Settled(
            *self.pose, state.wrench, state.displacement, state.answer, residuals, radius
        )

    def start(self, **options: Any) -> Started:
        """Queue the solves of the saved wrenches (LM_start); options as in `Recorder.start`.

        Raises
        ------
        ValueError
            If the mode saves nothing.
        """
        if self.recorder is None:
            raise InvalidArgument(
                f"mode {self.mode!r} does not save wrenches; create the mount with mode 'record' "
                "or 'envelope'"
            )
        return self.recorder.start(**options)

    def close(self) -> None:
        """Send the saved wrenches that are not sent yet."""
        if self.recorder is not None:
            self.recorder.close()

    def _newton_slopes(self, answer: Displacement) -> tuple[Vector, Vector]:
        """Return the answer's compliance and the scene's stiffness, (6, 6) each, SI.

        Raises InvalidArgument if one of them is unknown.
        """
        if self._stiffness is None:
            raise InvalidArgument(
                "a step with relaxation='newton' needs the scene's stiffness; create the mount "
                "with stiffness=, call settle() instead, or use relaxation='aitken'"
            )
        if answer.derivative is None:
            raise InvalidArgument(
                f"{self.component} has no derivative at this wrench, which relaxation='newton' "
                f"needs; run wrenchbook fill {self.component}, or use relaxation='aitken'"
            )
        return answer.derivative, self._stiffness

    def _answer(self, wrench: Vector) -> tuple[Displacement, Vector | None]:
        """Count and return the answer to a wrench (6,), N and N·m, and its numbers (6,), if any.

        Raises DisplacementUnknown if the table lacks an output that does not count as rigid.
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
                    f"the table of {answer.component} has no value of {names} at this wrench. Load "
                    "a table with them, add them to the scene's outputs, or create the mount with "
                    "unmeasured='rigid', which sets them to 0"
                )
            target = np.where(missing, 0.0, target)
        self.coverage.add(answer, known=target is not None)
        if unprimed and self._stiffness is not None and answer.derivative is not None:
            # Half of the stability limit stops the stiffest direction in one step: 1/(1 + G).
            factor = 0.5 * stable_factor(np.nan_to_num(answer.derivative), self._stiffness)
            self._relaxation.restart_at(factor)
            self._primed = True
        return answer, target


def checked_reading(force: ArrayLike, moment: ArrayLike | None) -> Vector:
    """Return a reading as a wrench (6,), N and N·m; raises SensorError unless it is finite."""
    try:
        return single_wrench(force, moment)
    except ValueError as error:
        if "must be finite" not in str(error):
            raise
        raise SensorError(
            f"the sensor reading is not a wrench: {error}. The simulation diverged before this "
            "step, and no pose was set. Go back to an earlier state and use a smaller time step."
        ) from error


def from_world(force: Vector, moment: Vector, point: Vector, pose: tuple[Vector, Vector]) -> Vector:
    """Return a wrench (6,), N and N·m, about the interface point in the undeformed frame's axes.

    Force and moment (3,) act ON the component at a displaced point (3,), m, all in the world.
    `pose` is R0 (3, 3) of the undeformed frame, and p (3,), m, the displaced interface point: F =
    R0^T f and M = R0^T (m + (point - p) x f).
    """
    axes, origin = pose
    x, y, z = (point - origin).tolist()
    fx, fy, fz = force.tolist()
    lever = np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
    turned = np.array([force, moment + lever]) @ axes  # rows times R0: R0^T of each
    return turned.reshape(6) + 0.0  # no negative zeros


def require_weight(
    force: ArrayLike, mass: float, gravity: ArrayLike = GRAVITY, axes: ArrayLike | None = None
) -> None:
    """Refuse a reading that a scene at rest contradicts: its component carries its weight.

    Parameters
    ----------
    force : array_like
        Shape (3,), N, on the component, in the undeformed interface frame, of a scene at rest that
        nothing else holds.
    mass : float
        Of all that hangs on the mount, kg.
    gravity : array_like
        Shape (3,), m/s^2, in the world.
    axes : array_like, optional
        R0, shape (3, 3); the world's axes if not given.

    Raises
    ------
    SensorError
        If the force along gravity is reversed, missing, or off by more than half the weight.
    """
    pull = float(mass) * np.asarray(gravity, dtype=float)
    weight = float(np.linalg.norm(pull))
    if weight == 0.0:
        return
    local = np.asarray(force, dtype=float)
    world = local if axes is None else np.asarray(axes, dtype=float) @ local
    along = float(world @ pull) / weight**2  # the right value is 1
    if abs(along - 1.0) <= MAX_WEIGHT_ERROR:
        return
    text = f"at rest {mass:.6g} kg weigh {weight:.6g} N, but the reading has {along * weight:.6g} N"
    if abs(along + 1.0) <= MAX_WEIGHT_ERROR:
        raise SensorError(
            f"the wrench has the opposite sign: {text} along gravity. It must act ON the "
            "component, but sensors report the action of the parent on the child; convert with "
            "from_mujoco, from_pybullet or from_drake with component='parent'"
        )
    if abs(along) <= MAX_WEIGHT_ERROR:
        raise SensorError(
            f"the reading does not contain the scene's weight: {text} along gravity. Attach the "
            "system as a child without a joint (a free joint reads 0), and evaluate the sensors "
            "first"
        )
    raise SensorError(
        f"the reading contradicts the scene's weight: {text} along gravity. Check the sensor's "
        "place and axes, what else supports the scene, and the units"
    )
