"""Joints in plain ``mj_step``, through MuJoCo's callbacks of the whole process."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from weakref import WeakSet

import numpy as np

from ..errors import JointError
from ..mujoco import Data, Model, engine
from .mujoco_joint import joints_of, pull, warn_bare

_NO_CONTROL = int(engine.mjtDisableBit.mjDSBL_ACTUATION)


@contextmanager
def joints_in_mj_step() -> Iterator[None]:
    """Let ``mj_step`` itself step the joints of each scene that has some, within a ``with``.

    The step has the bits of `step_joints`. It is MuJoCo's control callback, of the whole process:
    threads take turns. A `JointWarning` names a scene without joints, if another of its model has
    some. With actuation, springs and dampers all disabled MuJoCo calls none, and no
    joint pulls. A `report` counts ``mj_forward`` as a step.

    Raises
    ------
    JointError
        If MuJoCo has another callback, or had at the end of the ``with``; see `Joint.step`. In
        threads of ``mujoco.rollout`` an error ends a scene's motion, and the ``with`` raises it.
    """
    errors: list[Exception] = []
    bare: WeakSet[Data] = WeakSet()  # scenes without joints

    def pull_scene(model: Model, data: Data, passive: bool = False) -> None:
        joints = joints_of(data)
        disabled = bool(model.opt.disableflags & _NO_CONTROL)
        if disabled != passive or (data in bare and not joints):
            return
        try:
            if not joints:
                bare.add(data)
                warn_bare(model)
                return
            if passive:  # this callback comes before the bias forces
                engine.mj_rne(model, data, False, data.qfrc_bias)
            pull(joints)
        except Exception as error:
            if sys._getframe().f_back is not None:  # a frame of Python called `mj_step`
                raise
            errors.append(error)  # an exception in a thread of C++ would end the process
            data.qfrc_applied[:] = np.nan

    present = [kind for kind in ("control", "passive") if getattr(engine, f"get_mjcb_{kind}")()]
    if present:
        raise JointError(
            f"MuJoCo already has a {present[0]} callback, so joints_in_mj_step cannot set one; "
            f"remove it with mujoco.set_mjcb_{present[0]}(None), or call step_joints instead of "
            "mj_step"
        )

    # MuJoCo calls the control callback only with actuation; without it the passive callback does
    # its work.
    callbacks = pull_scene, partial(pull_scene, passive=True)
    engine.set_mjcb_control(callbacks[0])
    engine.set_mjcb_passive(callbacks[1])
    try:
        yield
        exchanged = (engine.get_mjcb_control(), engine.get_mjcb_passive()) != callbacks
    finally:
        engine.set_mjcb_control(None)
        engine.set_mjcb_passive(None)

    if errors:
        raise errors[0]
    if exchanged:
        raise JointError(
            "another control or passive callback was set within joints_in_mj_step, which stops "
            "the joints; do not set it, or call step_joints instead of mj_step"
        )
