"""Many joints of one table in one call of the kernel, for environments that run at once."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.kernel.joint import (
    FREEDOMS,
    INDEFINITE,
    NO_MASS,
    NOT_FINITE,
    OK,
    JointSteps,
)

from ...contract import COVERAGE
from ..errors import InvalidArgument, JointWarning, warn
from ..wrenches import Vector
from .joint import MAX_RANGES, Joint

if TYPE_CHECKING:
    from ..table import Table

Array: TypeAlias = Any  # of numpy or PyTorch
BEYOND = -1  # beside the kernel's codes: a pose beyond MAX_RANGES
STATUS = {
    OK: "ok",
    BEYOND: "beyond twice the range",
    NOT_FINITE: "not finite",
    NO_MASS: "no inverse mass",
    INDEFINITE: "not positive definite",
}
NO_INVERSE = "no wrench at this pose"  # of the kernel's other codes


def status_of(joint: Joint, steps: JointSteps) -> NDArray[np.int32]:
    """Return the codes (n,) of a call's joints; NaN becomes the wrench of each that is not OK."""
    replies = steps.replies
    codes = np.array(replies["status"])
    doubtful = np.flatnonzero(codes == INDEFINITE)
    if len(doubtful):
        least, _ = joint._weakest(replies["stiffness"][doubtful])
        codes[doubtful[~(least < 0.0)]] = OK
    codes[(codes == OK) & ~(replies["ranges"] <= MAX_RANGES)] = BEYOND
    replies["wrench"][codes != OK] = np.nan
    return codes


class Joints:
    """Many parts of one table, each between two bodies of its own, in one call a step.

    Each has the numbers of a `Joint`, bit by bit. A joint without a wrench does not stop the
    others: its wrench is NaN, `status` says why, and one `JointWarning` counts them.

    Parameters
    ----------
    table : Table
    count : int
        The number of joints, n.
    damping : float
        Share of critical damping of each mode of the part between the two bodies.
    **options
        Of `Joint`.

    Raises
    ------
    InvalidArgument
        If the count is below 1, and as of `Joint`.
    """

    def __init__(self, table: Table, count: int, damping: float = 0.02, **options: Any) -> None:
        if not (isinstance(count, int | np.integer) and count > 0):
            raise InvalidArgument(f"count is the number of joints, 1 or more, not {count!r}")
        self._hold(Joint(table, damping, **options), int(count), None)

    def _hold(self, joint: Joint, count: int, axes: Vector | None) -> None:
        """Keep the options of a joint, and make the kernel's arrays."""
        self._joint, self._steps, self._warned = joint, joint.new_steps(count, axes), False
        self._codes = np.zeros(count, dtype=np.int32)

    def __len__(self) -> int:
        return len(self._codes)

    @property
    def inputs(self) -> dict[str, float]:
        """The table's further inputs by name, of all joints; assign a mapping to change them."""
        return self._joint.inputs

    @inputs.setter
    def inputs(self, values: Mapping[str, float]) -> None:
        self._joint.inputs = values
        self._steps.inputs[:] = self._joint._steps.inputs

    @property
    def wrenches(self) -> Vector:
        """Shape (n, 6), N and N·m, of the last step; see `Joint.wrench`. NaN where none."""
        return np.array(self._steps.replies["wrench"])

    @property
    def displacements(self) -> Vector:
        """Shape (n, 6), m and rad, at the beginning of the last step."""
        return np.array(self._steps.replies["displacement"])

    @property
    def errors(self) -> tuple[Vector, Vector]:
        """Error bars (n, 6) of displacements, m and rad, and of the poses' wrenches, N and N·m."""
        replies = self._steps.replies
        return np.array(replies["pose_error"]), np.array(replies["wrench_error"])

    @property
    def coverage(self) -> NDArray[np.str_]:
        """How the table covers the wrench of each pose, (n,): outside too where there is none."""
        return np.array(COVERAGE)[self._steps.replies["coverage"]]

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Which joints had no wrench in the last step, (n,)."""
        return self._codes != OK

    @property
    def status(self) -> NDArray[np.str_]:
        """Of each joint, (n,): ``ok``, or why it has no wrench."""
        names = [STATUS.get(code, NO_INVERSE) for code in range(BEYOND, NO_MASS + 1)]
        return np.array(names)[self._codes - BEYOND]

    def restart(self, which: Any = slice(None)) -> None:
        """Forget the last step of some joints, by a mask or indices; of all if none are given."""
        at = np.arange(len(self))[which]
        self._steps.memory[at] = self._codes[at] = 0
        for name in ("wrench", "displacement"):
            self._steps.replies[name][at] = 0.0

    def step(
        self,
        poses: Array,
        velocities: Array,
        inverse_masses: Array,
        dt: float,
        threads: int | None = None,
    ) -> Array:
        """Return the wrenches on the parts during a step, (n, 6), N and N·m; see `Joint.step`.

        Tensors of PyTorch give a tensor of the poses' type and device, without gradients: those of
        a GPU are copied to the host and back. The kernel computes in float64.

        Parameters
        ----------
        poses : array_like
            Shape (n, 7): of the tip's interface frame in its undeformed frame the translation, m,
            and the quaternion, w first.
        velocities : array_like
            Shape (n, 6), m/s and rad/s.
        inverse_masses : array_like
            Shape (n, 6, 6), or (6, 6) for all, 1/kg to 1/(kg·m^2).
        dt : float
            The step, s.
        threads : int, optional
            The number of threads; one a processor if it is not given.

        Raises
        ------
        InvalidArgument
            If a shape is wrong or the step not above zero.
        """
        steps, count = self._steps, len(self)
        given = [_on_host(array) for array in (poses, velocities, inverse_masses)]
        shapes = [array.shape for array in given]
        square = (FREEDOMS, FREEDOMS)
        if shapes[:2] != [(count, 7), (count, FREEDOMS)] or shapes[2] not in (
            square,
            (count, *square),
        ):
            raise InvalidArgument(
                f"poses, velocities and inverse_masses of {count} joints have shapes ({count}, 7), "
                "({0}, 6) and ({0}, 6, 6), not {1}, {2} and {3}".format(count, *shapes)
            )
        steps.poses[:], steps.velocities[:], steps.inverse_masses[:] = given
        steps.step(step_of(dt), self._joint.damping, threads or os.cpu_count() or 1)
        self._heed()
        found = steps.replies["wrench"]
        return poses.new_tensor(found) if hasattr(poses, "new_tensor") else np.array(found)

    def _heed(self) -> None:
        """Keep the joints' status, and warn once of each kind."""
        self._codes, replies = status_of(self._joint, self._steps), self._steps.replies
        failed, ok = self._codes[self._codes != OK], self._codes == OK
        if len(failed) and not self._warned:
            self._warned = True
            kinds = [STATUS.get(int(code), NO_INVERSE) for code in failed]
            counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
            warn(
                f"{self._joint._name}: {len(failed)} of {len(self)} joints have no wrench in this "
                f"step, NaN: {counts}; `status` has each. {self._joint._remedy}. This is said once",
                JointWarning,
            )
        if (ok & (replies["ranges"] > 1.0)).any():
            self._joint._warn_beyond()
        uncovered = np.flatnonzero(ok & (replies["ranges"] <= 1.0) & (replies["coverage"] > 0))
        if len(uncovered):
            self._joint._warn_uncovered(replies["still"][uncovered[0]])


def step_of(dt: float) -> float:
    """Return a time step, s; InvalidArgument if it is not above zero."""
    if not (math.isfinite(dt) and dt > 0):
        raise InvalidArgument(f"a step is above zero, not {dt} s")
    return float(dt)


def _on_host(array: Array) -> Vector:
    """Return an array of numpy; that of a tensor of PyTorch is its own memory if on the host."""
    return array.detach().cpu().numpy() if hasattr(array, "detach") else np.asarray(array, float)
