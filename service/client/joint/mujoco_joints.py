"""The joint in many MuJoCo environments of one scene: one call of the kernel a step for all."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InvalidArgument
from .joints import Joints
from .mujoco_joint import Data, Model, MujocoJoint, engine, finish, require_scene

if TYPE_CHECKING:
    from ..table import Table


class MujocoJoints(Joints):
    """A part in each of many MuJoCo environments of one scene, with one call of the kernel a step.

    Each has the bits of a `MujocoJoint`. An environment whose joint has no wrench stays where it
    was: `failed` and `status` name it. Reset its data and call ``restart`` for it.

    Parameters
    ----------
    model : MjModel
    datas : sequence of MjData
        The environments.
    table, base, tip, damping, **options
        Of `MujocoJoint`.

    Attributes
    ----------
    joints : list of MujocoJoint
        That of each environment, for its wrench: its own ``step`` advances it alone.

    Raises
    ------
    InvalidArgument
        If there are no environments, or two are one; see `Joint`.
    JointError
        See `MujocoJoint`.
    """

    def __init__(
        self,
        model: Model,
        datas: Sequence[Data],
        table: Table,
        base: str = "base",
        tip: str = "tip",
        damping: float = 0.02,
        **options: Any,
    ) -> None:
        if not len(datas) or len({id(data) for data in datas}) < len(datas):
            raise InvalidArgument("datas are one MjData an environment: one or more, each once")
        first = MujocoJoint(model, datas[0], table, base, tip, damping, **options)
        self.joints = [first, *(copy.copy(first) for _ in datas[1:])]
        self._model, self._datas = model, list(datas)
        self._pool: ThreadPoolExecutor | None = None
        self._hold(first, len(datas), first._spin_axes)
        for at, (joint, data) in enumerate(zip(self.joints, datas, strict=True)):
            joint._watch(data, self._steps, at)

    @property
    def wrenches(self) -> np.ndarray:
        """Shape (n, 6), N and N·m, of the last step; see `Joint.wrench`. NaN where none."""
        return np.array([joint.wrench for joint in self.joints])

    def restart(self, which: Any = slice(None)) -> None:
        """Forget the last step of some environments, by a mask or indices; of all without."""
        super().restart(which)
        for at in np.atleast_1d(np.arange(len(self))[which]):
            self.joints[at].restart()

    def step(self, *others: MujocoJoints, threads: int | None = None) -> None:  # type: ignore[override]
        """Advance each environment by one time step, in the place of ``mj_step``.

        Parameters
        ----------
        *others : MujocoJoints
            The joints at other tips of the same environments.
        threads : int, optional
            The number of threads; one a processor if it is not given.

        Raises
        ------
        JointError
            If the environments of others are not these; see `step_joints`.
        """
        batches, threads = (self, *others), threads or os.cpu_count() or 1
        if any(len(batch) != len(self) for batch in others):
            raise InvalidArgument("joints of one step have the same environments, in one order")
        scenes = list(zip(*(batch.joints for batch in batches), strict=True))
        for joints in scenes:
            require_scene(joints)
        self._share(self._begin, scenes, threads)
        for batch in batches:
            batch._steps.law(self._model.opt.timestep, batch._joint.damping, threads)
            batch._heed()
        failed = np.any([batch.failed for batch in batches], axis=0)
        for batch in batches:
            for joint in (batch.joints[at] for at in np.flatnonzero(batch.failed)):
                joint._law = np.full(len(joint.free), np.nan), *joint._law[1:]
        advanced = [joints for joints, stays in zip(scenes, failed, strict=True) if not stays]
        self._share(self._end, advanced, threads)

    def _begin(self, scenes: Iterable[Sequence[MujocoJoint]]) -> None:
        for joints in scenes:
            engine.mj_step1(self._model, joints[0]._data)
            for joint in joints:
                joint._read()

    def _end(self, scenes: Iterable[Sequence[MujocoJoint]]) -> None:
        for joints in scenes:
            for joint in joints:
                joint._push()
            finish(joints)

    def _share(self, work: Callable[[Any], None], scenes: Sequence[Any], threads: int) -> None:
        """Do work on all scenes; MuJoCo leaves the interpreter to other threads."""
        if threads == 1:
            return work(scenes)
        self._pool = self._pool or ThreadPoolExecutor(threads)
        for _ in self._pool.map(work, (scenes[k::threads] for k in range(threads))):
            pass
        return None
