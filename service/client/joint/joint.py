"""A flexible part between two rigid bodies, as a force element for any simulator.

With K the part's stiffness, A the inverse effective mass of the relative freedoms and v the
relative velocity that the bodies would have after the step without the part,

    (I + dt C A) w' = w + C v,    C = sum over modes of (dt theta omega^2 + 2 zeta omega),

over the modes of K against A, with theta = clip(1 - 0.5 / (omega dt)^2, 0, 1). Soft modes are
explicit, so that symplectic Euler keeps their energy; stiff ones are implicit and stable for any K.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wrenchbook.surrogate.answer import COVERED, UnknownMethodError
from wrenchbook.surrogate.kernel.joint import FREEDOMS, MAX_INTERFACES, JointSteps, shape_of
from wrenchbook.surrogate.kernel.replies import Status
from wrenchbook.surrogate.table.rows import ROTATION_LIMIT

from ...contract import COVERAGE, LOAD_UNITS, LOADS, OUTPUTS
from ..conventions import quaternion_wxyz as quaternion
from ..errors import InvalidArgument, JointError, JointRangeError, JointWarning, warn
from ..rotation import checked_rotation
from ..wrenches import Vector, floats_of
from .report import JointReport, ReportedJoint, report_of

if TYPE_CHECKING:
    from ..table import Table

# Default damping ratio: of welded steel at working stress, 2 to 3 % (Newmark and Hall 1982).
DAMPING = 0.02
NOT_YET = -2  # coverage before the first step, beside the kernel's codes
# Coverage by these codes, also from the end: -2 is NOT_YET, -1 a step without a wrench.
COVERED_AS = np.array([*COVERAGE, None, COVERAGE[-1]], dtype=object)
LARGEST_TURN = math.degrees(ROTATION_LIMIT)  # of a table's rows
# Ratio to the load range or to LARGEST_TURN: beyond it the pose is not that of the part.
MAX_RANGES = 2.0
ROUNDING = 1e-9  # relative: the difference of two ways to compute a pose's distance from the range
SYMBOLS = ("F_x", "F_y", "F_z", "M_x", "M_y", "M_z")
SHOWN = 0.05  # part of the largest load: messages leave out smaller loads of a direction


class Joint:
    """A part as a force element between the two bodies that it connects.

    The simulator has the relative motion of the tip, the interface's side, against the base, the
    support's side. Each step the joint returns the wrench on the part; the simulator applies its
    negative to the tip at the interface point, and the wrench itself to the base at the same point.
    A part that moves at k interfaces has a tip at each: its numbers have the shapes below with k in
    front, (k, 6) for (6,), in the order of `interfaces`, and its matrices are (6 k, 6 k).

    Parameters
    ----------
    table : Table
        A downloaded or opened table of a part with 1 to 4 interfaces that move.
    damping : float
        Damping ratio of each mode of the part between the two bodies: 1 is critical damping.
    interface : str, optional
        Of several interfaces the one at the tip; all others must be held. If it is not given the
        joint is at all that move.
    method : str, optional
        How the table answers; its own choice otherwise.
    inputs : mapping, optional
        Further inputs of the table by name, all of them, such as ``{"temperature": 80.0}``; units
        of the component.

    Attributes
    ----------
    interfaces : tuple of str
        The names of the interfaces that move, k.
    free : numpy.ndarray of int
        The freedoms of the 6 k that the part does not lock; others have no wrench.
    inputs : mapping of float
        The further inputs; assign a mapping to change them.

    Raises
    ------
    InvalidArgument
        If the table's part does not move, or elsewhere than at `interface` too; if the table has no
        rows, or none that give a stiffness; if a further input is unknown, missing or beyond its
        range; if the damping is negative.

    Warns
    -----
    JointWarning
        If the compliance is not positive definite at some wrenches of the load range; once each if
        a step's wrench is not covered, and if its pose is beyond the range.
    """

    _mass_remedy = "Give every freedom between base and tip a mass"

    def __init__(
        self,
        table: Table,
        damping: float = DAMPING,
        *,
        interface: str | None = None,
        method: str | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        self._table = table
        self.damping = damping
        self._method = method
        self._at, self.free, self.interfaces = moving(table, interface)
        self._packed = table.packed  # fixed version: a refresh of the table does not change it
        self._several, self._size = len(self.interfaces) > 1, FREEDOMS * len(self.interfaces)
        names = [f"{name} " * self._several for name in self.interfaces]
        self._symbols = np.array([name + load for name in names for load in SYMBOLS])
        self.name = table.name
        self._further = further_inputs(table, inputs or {})
        self._warned_beyond = self._warned_uncovered = self._warned_unstable = False
        self.remedy = "Check masses, units and steps (all with the joint), or widen the range"
        try:
            self._begin(None)
            self._require_stiffness()
        except UnknownMethodError as error:
            raise InvalidArgument(f"{self.name}: {error}") from error

    def _require_stiffness(self) -> None:
        """Refuse a table without stiffness; warn of wrenches at which it cannot be inverted."""
        packed, at, method = self._packed, self._at, self._method
        free = at[self.free]  # indices of the table's loads and outputs
        sample = packed.sample(self._inputs(np.zeros(self._size)), free)
        answers = packed.batch(sample, None, method)
        compliances = packed.derivatives(sample, None, method)[:, free][:, :, free]
        rotates_too_far = np.isnan(answers.outputs[:, at]).any(axis=1)  # beyond LARGEST_TURN
        is_nearest_row = (compliances == 0.0).all(axis=(1, 2))  # an answer without a slope
        compliances[rotates_too_far | is_nearest_row] = np.nan
        least, loads = packed.weakest(compliances, packed.load_scale[free])

        known = int(np.isfinite(least).sum())
        is_indefinite = least < 0.0
        if not known:
            raise InvalidArgument(
                f"{self._table.name} has no stiffness, because no row of its table gives a "
                f"derivative; {self._more_rows()}, and download the table again"
            )
        if is_indefinite.any():
            worst = int(np.nanargmin(least))
            is_covered = answers.coverage == COVERED
            self.remedy = f"The compliance is not positive definite: {self._more_rows()}"
            warn(
                f"{self._indefinite(sample[worst][at], loads[worst])}. So it is at "
                f"{is_indefinite.sum()} of {known} wrenches of the load range, "
                f"{(is_indefinite & is_covered).sum()} of them covered",
                JointWarning,
            )

    @property
    def damping(self) -> float:
        """Damping ratio of each mode, 1 for critical damping; assign it to change it."""
        return self._damping

    @damping.setter
    def damping(self, damping: float) -> None:
        if not (isinstance(damping, Real) and 0.0 <= damping < math.inf):
            raise InvalidArgument(f"damping must be 0 or more (1 is critical), not {damping!r}")
        self._damping = float(damping)

    @property
    def inputs(self) -> Mapping[str, float]:
        """The table's further inputs by name, in its units; assign them as a whole."""
        names = [load.name for load in self._table.space.scalars]
        return MappingProxyType(dict(zip(names, self._further, strict=True)))

    @inputs.setter
    def inputs(self, values: Mapping[str, float]) -> None:
        self._further = further_inputs(self._table, values)
        self._steps.inputs[:] = self._inputs(np.zeros(self._size))

    def restart(self) -> None:
        """Delete the state of the last step."""
        self._memory[:] = 0.0
        for name in ("wrench", "displacement"):
            self._reply[name] = 0.0
        for name in ("wrench_error", "pose_error"):
            self._reply[name] = math.nan
        self._reply["coverage"] = NOT_YET

    @property
    def wrench(self) -> Vector:
        """The wrench on the part in the last step, shape (6,), N and N·m.

        It is in the undeformed interface frame, its moment about the displaced interface point.
        """
        return np.array(self._reply["wrench"])

    @property
    def displacement(self) -> Vector:
        """The displacement at the beginning of the last step, shape (6,), m and rad."""
        return np.array(self._reply["displacement"])

    @property
    def error(self) -> Vector:
        """Error bar of the last step's wrench at its pose, (6,), N and N·m; NaN if unknown."""
        return np.array(self._reply["wrench_error"])

    @property
    def displacement_error(self) -> Vector:
        """The table's error bar of the displacement, shape (6,), m and rad; NaN where unknown."""
        return np.array(self._reply["pose_error"])

    def report(self) -> JointReport:
        """Return coverage, largest error bars and stored energy of all steps since `restart`."""
        return self._report()

    def _report(self, began: float = 0.0, energy_drift: float = math.nan) -> JointReport:
        """Return `report_of` this joint, with remedies by its method and its load range."""
        packed, at, names = self._packed, self._at, (OUTPUTS, LOADS)
        if self._several:
            space = self._table.space
            every = space.output_names, space.input_names
            names = tuple(tuple(np.array(each)[at].tolist()) for each in every)
        remedy = self._more_rows()
        if self._method is None and packed.answers_by() == "linear":
            remedy = "more solves do not help a linear part; use a finer mesh or nonlinear = true"
        if self._warned_beyond:
            remedy = f"widen the load range, which a pose of the steps exceeds; {remedy}"
        joint = ReportedJoint(
            self.name,
            self.interfaces,
            self.free,
            *names,
            load_scale=packed.load_scale[at],
            tolerance=packed.arrays["space/tolerance"][at],
            stiffness=self._stiffness,
            remedy=remedy,
        )
        return report_of(joint, self._history, began, energy_drift)

    def _begin(self, axes: Vector | None) -> None:
        """Make the kernel's arrays, with `axes` as in `new_steps`, and delete the last step."""
        self._use(self.new_steps(1, axes), 0)
        self.restart()

    def new_steps(self, count: int, axes: Vector | None) -> JointSteps:
        """Make the kernel's arrays for `count` joints of these options.

        `axes` (3, 3): the interface frame's axes, as columns, in the axes of the tip's body, in
        which the kernel reads rotations and angular velocities; None where these are the frame's.
        """
        steps = self._packed.joints(count, self._method, axes)
        steps.inputs[:] = self._inputs(np.zeros(self._size))
        return steps

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy, with arrays of its own."""
        self.__dict__.update(state)
        self._use(copy.copy(self._steps), self._entry)

    def _use(self, steps: JointSteps, at: int) -> None:
        """Set this joint to the entry `at` of the kernel's arrays; its attributes are views."""
        self._entry = at
        self._steps = steps
        self._reply, self._memory = steps.replies[at], steps.memory[at]
        self._history = steps.history[at]
        names = ("status", "ranges", "coverage")
        replies = steps.replies[at : at + 1]
        self._status, self._ranges, self._coverage = (replies[name].reshape(-1) for name in names)
        self._static_wrench, self._stiffness = self._reply["still"], self._reply["stiffness"]

    @property
    def coverage(self) -> str | dict[str, str | None]:
        """The table's coverage of the wrench: ``covered``, ``thin`` or ``outside``.

        With several interfaces, by their names: the coverage of the wrenches of the last step's
        pose; None before a step. Loads beyond the range are outside for all interfaces.
        """
        if self._several:
            return dict(zip(self.interfaces, COVERED_AS[self._coverage].tolist(), strict=True))
        loads = self._inputs(self.wrench).tolist()
        return str(self._packed.answer(loads, None, self._method).coverage)

    def _more_rows(self) -> str:
        other = "" if self._method is None else f", or leave out method={self._method!r}"
        return f"solve more rows (wrenchbook fill {self._table.name} --for-joint){other}"

    def _indefinite(self, wrench: Vector, direction: Vector) -> str:
        """Return the text on a compliance that is not positive definite at a wrench (6 k,).

        `direction` (f,), in half widths of the load range, is the load against which the part
        moves.
        """
        parts = zip(direction, self._symbols[self.free], strict=True)
        shown = " ".join(f"{part:+.2g} {load}" for part, load in parts if abs(part) >= SHOWN)
        return (
            f"{self.name}, method {self._packed.answers_by(self._method)!r}: at the wrench "
            f"({', '.join(f'{load:.4g}' for load in wrench)}) N, N·m the compliance is not "
            f"positive definite, because the part moves against a load along ({shown}, in "
            f"fractions of the load range); {self._more_rows()}"
        )

    def step(
        self, R: ArrayLike, p: ArrayLike, velocity: ArrayLike, inverse_mass: ArrayLike, dt: float
    ) -> Vector:
        """Return the wrench on the part during a step, shape (6,), N and N·m.

        Parameters
        ----------
        R, p : array_like
            Of each interface: the tip's interface frame in its undeformed frame, which moves with
            the base: shape (3, 3), dimensionless, and shape (3,), m.
        velocity : array_like
            Shape (6,), m/s and rad/s, in the undeformed frame: the relative velocity of interface
            point and frame after the step without the part.
        inverse_mass : array_like
            Shape (6 k, 6 k): the relative accelerations by a unit load on a tip and its reaction on
            the base, 1/kg to 1/(kg·m^2). Tips on a base that moves are coupled by it.
        dt : float
            The step, s.

        Raises
        ------
        JointError
            If the compliance at the pose is not positive definite.
        JointRangeError
            If the pose lies beyond twice the load range or 40 degrees.
        InvalidArgument
            If the inverse mass is not symmetric and positive definite, the step not above zero, R
            no rotation, or a shape wrong or a number not finite.
        """
        k = len(self.interfaces)
        size = self._size
        rotations = floats_of("R", R, (k, 3, 3)) if self._several else [R]
        p = floats_of("p", p, shape_of(k, 3))
        velocity = floats_of("velocity", velocity, shape_of(k, FREEDOMS))
        inverse_mass = floats_of("inverse_mass", inverse_mass, (size, size))
        dt = float(dt) if isinstance(dt, Real) else floats_of("dt", dt, ()).item()
        if not 0.0 < dt < math.inf:
            raise InvalidArgument(f"dt must be a finite number of seconds above 0, not {dt:g} s")

        steps = self._steps
        turned = [quaternion(rotation_vector(matrix)) for matrix in rotations]
        steps.poses[0, ..., :3], steps.poses[0, ..., 3:] = p, np.squeeze(turned)
        steps.velocities[0], steps.inverse_masses[0] = velocity, inverse_mass
        steps.step(dt, self.damping)
        self._check_status()
        return self.wrench

    def state(self, translation: ArrayLike, rotation: ArrayLike) -> tuple[Vector, Vector]:
        """Return the wrench of a displacement, shape (6,), and its stiffness, shape (6 k, 6 k).

        Parameters
        ----------
        translation, rotation : array_like
            Shape (3,), m, and the rotation vector, shape (3,), rad.

        Returns
        -------
        wrench : numpy.ndarray
            N and N·m.
        stiffness : numpy.ndarray
            Its change with the translation and the angle turned about fixed axes, N/m to N·m/rad,
            symmetric: the part that turning the moment adds is antisymmetric and does no work.

        Raises
        ------
        InvalidArgument, JointRangeError
            See `step`.
        """
        last_step = (self._steps, self._entry)
        steps = self.new_steps(1, None)
        each = shape_of(len(self.interfaces), 3)
        translation = floats_of("translation", translation, each)
        rotation = floats_of("rotation", rotation, each)
        turned = [quaternion(vector) for vector in rotation.reshape(-1, 3)]
        steps.poses[0, ..., :3], steps.poses[0, ..., 3:] = translation, np.squeeze(turned)
        steps.memory[0] = self._memory
        steps.state()
        self._memory[:] = steps.memory[0]
        try:
            self._use(steps, 0)
            self._check_status()
            return self._static_wrench.copy(), self._stiffness.copy()
        finally:
            self._use(*last_step)

    def _check_status(self) -> None:
        """Raise or warn according to the kernel's reply."""
        ranges = self._ranges[0]
        if self._status[0] or ranges > 1.0:
            self._refuse(int(self._status[0]), float(ranges))
        elif self._coverage[0] > COVERED or (self._several and self._coverage.max() > COVERED):
            self.warn_uncovered(self._static_wrench)

    def warn_uncovered(self, wrench: Vector) -> None:
        """Warn once of a wrench that the table does not cover."""
        if not self._warned_uncovered:
            self._warned_uncovered = True
            packed = self._packed
            answer = packed.answer(self._inputs(wrench).tolist(), None, self._method)
            warn(
                f"{self.name}: the wrench of a step is {answer.coverage} by the method "
                f"{packed.answers_by(self._method)!r}, so displacement and wrench are estimates "
                f"({answer.reason}); {self._more_rows()}. This warning appears once",
                JointWarning,
            )

    def _refuse(self, status: int, ranges: float) -> None:
        """Raise the error of a status of the kernel, or of a pose `ranges` load ranges out.

        Up to MAX_RANGES a pose only causes a warning.
        """
        if status == Status.INDEFINITE:
            least, loads = self.weakest(self._stiffness[None])
            if least[0] < 0.0:
                raise JointError(self._indefinite(np.ravel(self._static_wrench), loads[0]))
        elif status == Status.NO_MASS:
            matrix = self._steps.inverse_masses[self._entry][np.ix_(self.free, self.free)]
            smallest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
            raise InvalidArgument(
                f"{self.name}: the inverse effective mass must be symmetric and positive "
                f"definite. Its smallest eigenvalue is {smallest:.3g}, and it differs from "
                f"its transpose by {np.abs(matrix - matrix.T).max():.3g}. {self._mass_remedy}"
            )
        elif status == Status.NOT_FINITE:
            pose = self._steps.poses[self._entry]
            if np.isfinite(pose).all() and not pose[..., 3:].any(axis=-1).all():
                raise InvalidArgument(
                    f"{self.name}: the quaternion of the pose is zero, which is no rotation; "
                    "write (1, 0, 0, 0) for the undeformed pose"
                )
            wrong = "inverse mass" if np.isfinite(pose).all() else f"pose {pose.tolist()}"
            raise InvalidArgument(
                f"{self.name}: the {wrong} is not finite, because the simulation has diverged; "
                "restore an earlier state and use a smaller time step"
            )
        elif status:
            moved = ", ".join(f"{number:.4g}" for number in self.displacement.ravel())
            raise JointError(
                f"{self.name}: the compliance has no inverse at the displacement ({moved}) m, "
                f"rad, so the wrench there is undefined; {self._more_rows()}, or lock the freedom "
                "that does not move"
            )

        if ranges > MAX_RANGES:
            raise JointRangeError(f"{self.name}: {self._excess(ranges)}. {self.remedy}")
        if ranges > 1.0:
            self.warn_beyond(self._excess(ranges))

    def _excess(self, ranges: float) -> str:
        """Return a text on the load or displacement that is `ranges` times the range out."""
        rotations = self.displacement.reshape(-1, FREEDOMS)[:, 3:]
        turn = math.degrees(float(np.linalg.norm(rotations, axis=1).max()))
        if turn >= LARGEST_TURN * ranges * (1.0 - ROUNDING):
            return f"the pose rotates by {turn:.6g} degrees, beyond the {LARGEST_TURN:g} of tables"
        low, high = self._packed.load_range[:, self._at]
        loads = self._static_wrench.ravel()
        excess = np.maximum(loads - high, low - loads) / self._packed.load_scale[self._at]
        load = int(excess.argmax())
        more = 100.0 * (ranges - 1.0)
        return (
            f"the pose is outside the load range: it needs {more:.3g} % more than the range, with "
            f"{self._symbols[load]} = {loads[load]:.6g}, beyond {low[load]:g} to {high[load]:g} "
            f"{LOAD_UNITS[load % FREEDOMS]}"
        )

    def warn_beyond(self, excess: str) -> None:
        """Warn once of a pose beyond the range."""
        if not self._warned_beyond:
            self._warned_beyond = True
            warn(
                f"{self.name}: {excess}; the wrench is extrapolated linearly, up to "
                f"{MAX_RANGES:g} times the range. {self.remedy}",
                JointWarning,
            )

    def weakest(self, stiffness: Vector) -> tuple[Vector, Vector]:
        """Return `PackedTable.weakest` of stiffnesses (n, 6 k, 6 k).

        A part with a negative value gives energy.
        """
        packed, free = self._packed, self.free
        compliance = np.asarray(np.linalg.inv(stiffness[:, free][:, :, free]), dtype=float)
        return packed.weakest(compliance, packed.load_scale[self._at][free])

    def _inputs(self, wrench: Vector) -> Vector:
        """Return the table's inputs with a wrench at the tip, shape (n,), SI."""
        loads = np.concatenate([np.zeros(self._packed.inputs - len(self._further)), self._further])
        loads[self._at] = np.ravel(wrench)
        return loads


def rotation_vector(R: ArrayLike) -> Vector:
    """Return the rotation vector (3,), rad, of a matrix; raises InvalidArgument for half a turn."""
    matrix = checked_rotation("R", R)
    sine = 0.5 * np.array(
        [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    )
    size = math.sqrt(float(sine @ sine))
    angle = math.atan2(size, 0.5 * (float(np.trace(matrix)) - 1.0))
    if size == 0.0 and angle > 1.0:
        raise InvalidArgument("R rotates by 180 degrees, so its axis is ambiguous; rotate by less")
    return sine * (angle / size if size > 0.0 else 1.0)


def further_inputs(table: Table, by_name: Mapping[str, float]) -> tuple[float, ...]:
    """Return a table's further inputs, by their names, in its order; raises InvalidArgument."""
    space = table.space
    count = len(table.space.scalars)
    if not isinstance(by_name, Mapping):
        raise InvalidArgument(
            f"inputs must map names to numbers, such as {{'temperature': 80.0}}, not {by_name!r}"
        )
    try:
        values = space.vector({}, by_name)[len(space.inputs) - count :]
    except ValueError as error:
        raise InvalidArgument(f"{table.name}: {error}") from None
    ends = table.packed.load_range[:, len(space.inputs) - count :].T
    for load, value, (low, high) in zip(space.scalars, values, ends, strict=True):
        if not (isinstance(value, Real) and low <= value <= high):
            raise InvalidArgument(
                f"{table.name}: {load.name} must be {low:g} to {high:g} {load.unit}, not {value}"
            )
    return tuple(map(float, values))


def moving(
    table: Table, interface: str | None, several: bool = True
) -> tuple[NDArray[np.intp], NDArray[np.intp], tuple[str, ...]]:
    """Return the freedoms of the k interfaces of a table's part that move.

    They are the indices of the table's loads and outputs, (6 k,), the indices among these of the
    freedoms that the part does not lock, (f,), and the names; ("",) for a single interface.

    Raises InvalidArgument if no interface moves, or if interfaces other than `interface` move;
    without `interface` more than one must not move, unless `several` are allowed.
    """
    if not hasattr(table, "packed"):
        raise InvalidArgument(
            f"a joint needs a Table, not {table!r}; get a Table from client.download(name) or "
            "Table.open(path)"
        )
    indices = np.arange(FREEDOMS * len(table.space.interfaces)).reshape(-1, FREEDOMS)
    free = ~table.packed.locked[indices]
    moves = free.any(axis=1)
    names = tuple(np.array(table.space.interfaces)[moves].tolist())

    if not names:
        raise InvalidArgument(
            f"{table.name} is rigid, because all its freedoms are locked; weld the bodies instead"
        )
    listed = ", ".join(map(repr, names))
    if interface not in (None, *names):
        if names == ("",):
            raise InvalidArgument(
                f"{table.name} has a single interface, which has no name; leave "
                f"interface={interface!r} out"
            )
        raise InvalidArgument(
            f"{table.name} has no interface {interface!r} that moves; set interface to one of: "
            f"{listed}"
        )

    if len(names) > 1 and (interface is not None or not several):
        wanted = "springs need" if interface is None else f"interface={interface!r} needs"
        remedy = "" if interface is None else ", or leave out interface for a joint at all"
        raise InvalidArgument(
            f"{wanted} a part that moves at one interface only, but {table.name} moves at "
            f"{listed}; in component.toml write held = true in the [[interface]] of all but "
            f"one{remedy}"
        )
    if len(names) > MAX_INTERFACES:
        raise InvalidArgument(
            f"{table.name} moves at {len(names)} interfaces ({listed}), but a joint takes at most "
            f"{MAX_INTERFACES}; divide the part into several components"
        )
    return indices[moves].ravel(), np.flatnonzero(free[moves]), names
