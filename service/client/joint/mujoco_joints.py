"""The joint in many MuJoCo environments of one scene: one call of the kernel a step."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InvalidArgument
from ..mujoco import Data, Model, engine
from .joint import DAMPING
from .joints import Joints
from .mujoco_joint import MujocoJoint, advance, push, require_scene

if TYPE_CHECKING:
    from ..table import Table


class MujocoJoints(Joints):
    """A part in each of many MuJoCo environments of one scene, with one call of the kernel a step.

    Each has the bits of a `MujocoJoint`. An environment whose joint has no wrench stays where it
    was: `failed` and `status` name it. Reset its data and call ``restart`` for it. `datas` are the
    MjData of the environments; `joints` has the `MujocoJoint` of each, to read. The other
    parameters and the errors are those of `MujocoJoint`.
    """

    def __init__(
        self,
        model: Model,
        datas: Sequence[Data],
        table: Table,
        base: str = "base",
        tip: str = "tip",
        damping: float = DAMPING,
        *,
        bodies: Mapping[str, str] | None = None,
        interface: str | None = None,
        method: str | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        if isinstance(datas, engine.MjData) or not len(datas):
            raise InvalidArgument(
                "datas must be a list of one or more MjData, such as [mujoco.MjData(model)]"
            )
        if len({id(data) for data in datas}) < len(datas):
            raise InvalidArgument(
                f"datas has {len(datas)} entries, but two are the same MjData; create one for "
                "each environment"
            )
        options: Any = {"interface": interface, "method": method, "inputs": inputs}
        first = MujocoJoint(model, datas[0], table, base, tip, damping, bodies=bodies, **options)
        self.joints = [first, *(copy.copy(first) for _ in datas[1:])]
        self._model = model
        self._pool = ThreadPoolExecutor()
        self._hold(first, len(datas), first.spin_axes)
        for at, (joint, data) in enumerate(zip(self.joints, datas, strict=True)):
            joint.attach(data, self._steps, at)

    @property
    def wrenches(self) -> np.ndarray:
        """Wrenches of the last step, (n, 6), N and N·m, as `Joint.wrench`; NaN if there is none."""
        return np.array([joint.wrench for joint in self.joints])

    def restart(self, which: Any = slice(None)) -> None:
        """Delete the last step of some environments, by a mask or indices; of all by default."""
        super().restart(which)
        for at in np.atleast_1d(np.arange(len(self))[which]).tolist():
            self.joints[at].restart()

    def step(self, *others: MujocoJoints, threads: int = 0) -> None:  # type: ignore[override]
        """Advance each environment by one time step, in the place of ``mj_step``.

        `others` are the joints at other tips of the same environments; `threads` 0 means one for
        each processor. Errors are those of `step_joints`.
        """
        batches = (self, *others)
        threads = max(threads, 0) or os.cpu_count() or 1
        for batch in others:
            if len(batch) != len(self):
                raise InvalidArgument(
                    f"a step of {len(self)} environments cannot take joints of {len(batch)}; "
                    "create all MujocoJoints of a step with the same list of MjData"
                )

        scenes = list(zip(*(batch.joints for batch in batches), strict=True))
        for joints in scenes:
            require_scene(joints)
        self._in_threads(self._begin, scenes, threads)
        for batch in batches:
            batch._steps.law(self._model.opt.timestep, batch._joint.damping, threads)
            batch._check_status()

        failed = np.any([batch.failed for batch in batches], axis=0)
        for batch in batches:
            for at in np.flatnonzero(batch.failed).tolist():
                batch.joints[at].lose_wrench()
        advanced = [joints for joints, stays in zip(scenes, failed, strict=True) if not stays]
        self._in_threads(self._end, advanced, threads)

    def _begin(self, joints: Sequence[MujocoJoint]) -> None:
        engine.mj_step1(self._model, joints[0]._data)
        for joint in joints:
            joint.read_scene()

    def _end(self, joints: Sequence[MujocoJoint]) -> None:
        push(joints)
        advance(joints)

    def _in_threads(self, work: Callable[[Any], None], scenes: Sequence[Any], threads: int) -> None:
        """Run `work` on all scenes; MuJoCo releases the interpreter lock."""
        parts = [scenes[k::threads] for k in range(threads)]
        list(self._pool.map(lambda part: [work(joints) for joints in part], parts))
