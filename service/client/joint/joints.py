"""Many joints of one table in one call of the kernel, for environments that run at once."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.answer import COVERED
from wrenchbook.surrogate.kernel.joint import JointSteps
from wrenchbook.surrogate.kernel.replies import Status

from ..errors import InvalidArgument, JointWarning, warn
from ..wrenches import Vector
from .joint import COVERED_AS, DAMPING, LARGEST_TURN, MAX_RANGES, NOT_YET, Joint

if TYPE_CHECKING:
    from ..table import Table

Array: TypeAlias = Any  # an array of numpy or PyTorch
BEYOND = -1  # status beside the kernel's codes: a pose beyond MAX_RANGES
# Text of each status; the last is that of BEYOND.
_STATUS = np.full(len(Status) + 1, "no wrench at this pose", dtype=object)
_STATUS[[Status.OK, BEYOND, Status.NOT_FINITE]] = "ok", "beyond twice the range", "not finite"
_STATUS[[Status.NO_MASS, Status.INDEFINITE]] = "no inverse mass", "not positive definite"


def status_of(joint: Joint, steps: JointSteps) -> NDArray[np.int32]:
    """Return the codes (n,) of a call's joints; wrenches and forces without OK become NaN."""
    replies = steps.replies
    codes = np.array(steps.replies["status"])
    doubtful = np.flatnonzero(codes == Status.INDEFINITE)
    if len(doubtful):
        least, _ = joint.weakest(replies["stiffness"][doubtful])
        codes[doubtful[~(least < 0.0)]] = Status.OK
    codes[(codes == Status.OK) & ~(replies["ranges"] <= MAX_RANGES)] = BEYOND
    replies["wrench"][codes != Status.OK] = replies["force"][codes != Status.OK] = np.nan
    return codes


class Joints:
    """Many parts of one table, each between two bodies of its own, in one call a step.

    Each has the numbers of a `Joint`, bit by bit; those of k > 1 interfaces are (n, k, 6) for the
    (n, 6) below. A joint without a wrench does not stop the others: its wrench is NaN, `status` has
    the cause, and one `JointWarning` counts them. `count` is the number of joints, n; the other
    parameters and the errors are those of `Joint`.
    """

    joints: Sequence[Any] = ()  # the joints of `MujocoJoints`

    def __init__(
        self,
        table: Table,
        count: int,
        damping: float = DAMPING,
        *,
        interface: str | None = None,
        method: str | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        if not (isinstance(count, int | np.integer) and count > 0):
            raise InvalidArgument(
                f"count, the number of joints, must be a whole number of at least 1, not {count!r}"
            )
        joint = Joint(table, damping, interface=interface, method=method, inputs=inputs)
        self._hold(joint, int(count), None)

    def _hold(self, joint: Joint, count: int, axes: Vector | None) -> None:
        """Store the options of a joint, and make the arrays; `axes` as in `Joint.new_steps`."""
        self._joint = joint
        self._steps = joint.new_steps(count, axes)
        self._warned = False
        self._codes = np.zeros(count, dtype=np.int32)
        Joints.restart(self)

    def __len__(self) -> int:
        return len(self._codes)

    def __copy__(self) -> Joints:
        """Refuse a copy, which would share arrays."""
        raise InvalidArgument(
            "Joints cannot be copied, since copies share states; create new Joints"
        )

    @property
    def inputs(self) -> Mapping[str, float]:
        """The table's further inputs by name, of all joints; assign a mapping to change them."""
        return self._joint.inputs

    @inputs.setter
    def inputs(self, values: Mapping[str, float]) -> None:
        self._joint.inputs = values
        self._steps.inputs[:] = self._joint.new_steps(1, None).inputs
        for joint in self.joints:
            joint.inputs = values

    @property
    def memory(self) -> Vector:
        """The state of the joints between steps, shape (n, k), to read and to write."""
        return self._steps.memory

    @property
    def wrenches(self) -> Vector:
        """Wrenches of the last step, (n, 6), N and N·m, as `Joint.wrench`; NaN if there is none."""
        return np.array(self._steps.replies["wrench"])

    @property
    def displacements(self) -> Vector:
        """Displacements at the beginning of the last step, shape (n, 6), m and rad."""
        return np.array(self._steps.replies["displacement"])

    @property
    def errors(self) -> tuple[Vector, Vector]:
        """Error bars (n, 6) of displacements, m and rad, and of the poses' wrenches, N and N·m."""
        replies = self._steps.replies
        return np.array(replies["pose_error"]), np.array(replies["wrench_error"])

    @property
    def coverage(self) -> NDArray[Any]:
        """The table's coverage of the wrench of each pose, (n,), with several interfaces (n, k).

        A joint without a wrench is outside; all are None before a step.
        """
        return COVERED_AS[self._steps.replies["coverage"]]

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether each joint had no wrench in the last step, (n,)."""
        return self._codes != Status.OK

    @property
    def status(self) -> NDArray[Any]:
        """The status of each joint, (n,): ``ok``, or the cause of a missing wrench."""
        return _STATUS[self._codes]

    def restart(self, which: Any = slice(None)) -> None:
        """Delete the last step of some joints, by a mask or indices; of all by default."""
        for array in (self._steps.memory, self._codes, self._steps.replies):
            array[which] = 0
        for name in ("pose_error", "wrench_error"):
            self._steps.replies[name][which] = np.nan
        self._steps.replies["coverage"][which] = NOT_YET

    def step(
        self, poses: Array, velocities: Array, inverse_masses: Array, dt: float, threads: int = 0
    ) -> Array:
        """Return the wrenches on the parts during a step, (n, 6), N and N·m; see `Joint.step`.

        `poses` (n, 7) are translations, m, and quaternions, w first, of the tips' interface frames
        in their undeformed frames; `velocities` (n, 6); `inverse_masses` (n, 6, 6), or (6, 6) for
        all; with several interfaces (n, k, 7), (n, k, 6) and (n, 6 k, 6 k). `threads` 0 means one
        for each processor. Tensors of PyTorch give a tensor of the poses' type and device, without
        gradients; those of a GPU are copied to the host and back.

        Raises InvalidArgument if a shape is wrong or the step not above zero.
        """
        steps = self._steps
        arrays = poses, velocities, inverse_masses
        inputs = [
            np.asarray(array.detach().cpu() if hasattr(array, "detach") else array)
            for array in arrays
        ]
        shapes = tuple(array.shape for array in inputs)
        buffers = steps.poses, steps.velocities, steps.inverse_masses
        expected = tuple(buffer.shape for buffer in buffers)
        if shapes not in (expected, (*expected[:2], expected[2][1:])):
            raise InvalidArgument(
                "poses, velocities and inverse_masses of {} joints must have shapes {}, {} and {}, "
                "not {}, {} and {}".format(len(self), *expected, *shapes)
            )
        if not (isinstance(dt, Real) and math.isfinite(dt) and dt > 0):
            raise InvalidArgument(f"dt must be a finite number above 0 s, not {dt!r}")

        steps.poses[:], steps.velocities[:], steps.inverse_masses[:] = inputs
        steps.step(dt, self._joint.damping, threads or os.cpu_count() or 1)
        self._check_status()
        wrenches = steps.replies["wrench"]
        return poses.new_tensor(wrenches) if hasattr(poses, "new_tensor") else np.array(wrenches)

    def _check_status(self) -> None:
        """Store the joints' status, and warn once of each kind."""
        self._codes = status_of(self._joint, self._steps)
        replies = self._steps.replies
        within = replies["ranges"] <= 1.0
        failed = self.status[self.failed].tolist()
        if failed and not self._warned:
            self._warned = True
            counts = ", ".join(f"{failed.count(kind)} {kind}" for kind in dict.fromkeys(failed))
            warn(
                f"{self._joint.name}: {len(failed)} of {len(self)} joints have no wrench in this "
                f"step, NaN: {counts}; `status` has each. {self._joint.remedy}. This appears once",
                JointWarning,
            )
        beyond = int((~self.failed & ~within).sum())
        if beyond:
            self._joint.warn_beyond(
                f"{beyond} of {len(self)} poses are outside the load range, or rotate by more than "
                f"{LARGEST_TURN:g} degrees"
            )
        thin = (replies["coverage"].reshape(len(self), -1) > COVERED).any(axis=1)
        uncovered = np.flatnonzero(~self.failed & within & thin)
        if len(uncovered):
            self._joint.warn_uncovered(replies["still"][uncovered[0]])
