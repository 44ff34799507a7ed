"""The mount in MuJoCo: reads two sensors, writes a mocap body's pose."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidArgument
from .errors import SensorError
from .mount import Mount
from .mujoco_checks import Division, engine, find_division, floating, require_weighed
from .reading import from_world
from .settling import Settled

Vector = NDArray[np.float64]

_UNSTABLE = (
    engine.mjtWarning.mjWARN_BADQPOS,
    engine.mjtWarning.mjWARN_BADQVEL,
    engine.mjtWarning.mjWARN_BADQACC,
)


class MujocoMount:
    """A MuJoCo scene that stands on a component that bends.

    The rigid system is a child, without joint, of a mocap body at the division point; a ``force``
    and a ``torque`` sensor sit on a site of that child. They report what the parent does to the
    child, about the site, in its axes: negated, turned and moved to the interface point where it
    is now, that is the wrench on the component. The mocap body is given the deformed pose.

    Parameters
    ----------
    model, data : MjModel, MjData
        Make the mount before the first step, with the mocap body undeformed.
    mocap, force, torque : str
        Names of the mocap body and the two sensors.
    source : Table or Client
    component : str
    R0, p0 : array_like, optional
        The undeformed interface in the world: axes as columns, shape (3, 3), and point, shape
        (3,), m; the mocap body's pose if not given. The two keep their distance.
    sync : float, optional
        Seconds of simulated time from one answer to the next; each step if not given.
    gravcomp : {"motors", "float"}, optional
        What MuJoCo's ``gravcomp`` stands for, where a body of the scene has it: motors that carry
        the weight, which the mount then feels, or something outside.
    **options
        Of `Mount`: mode, tolerance, relaxation and more.

    Attributes
    ----------
    mount : Mount
        With the coverage of the answers, the last one, and the recorder.
    wrench : numpy.ndarray or None
        The last reading, shape (6,), N and N·m, about the interface point where it then was.
    read_at : float
        The time that it describes, s.

    Raises
    ------
    SensorError
        If the scene's sensors do not tell the wrench on the component; the text says why.
    ValueError, TypeError, ProblemError
        See `Mount`.

    Notes
    -----
    MuJoCo evaluates sensors before it integrates: after ``mj_step`` they describe the state at the
    start of that step. Bodies without joints, the mounted one among them, do not collide with what
    is fixed to the world.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        mocap: str = "base",
        force: str = "mount_force",
        torque: str = "mount_torque",
        *,
        source: Any,
        component: str,
        R0: ArrayLike | None = None,
        p0: ArrayLike | None = None,
        sync: float | None = None,
        gravcomp: str | None = None,
        **options: Any,
    ) -> None:
        step = float(model.opt.timestep)
        if sync is not None and not sync >= 0.999 * step:
            raise InvalidArgument(f"sync, {sync:g} s, must not be shorter than a step, {step:g} s")
        self._model, self._data, self._sync = model, data, sync or 0.0
        cut = find_division(model, mocap, force, torque)
        self._look_at(cut)
        axes, point = _matrix(self._quaternion), self._position.copy()
        undeformed = (axes if R0 is None else R0, point if p0 is None else p0)
        self.mount = Mount(source, component, *undeformed, **options)
        R0_, p0_ = self.mount.undeformed
        # The mocap body as seen from the interface, and the interface point as seen from the mocap
        # body: the two are one rigid piece.
        self._offset = R0_.T @ axes, R0_.T @ (point - p0_)
        self._interface = axes.T @ (p0_ - point)
        self._floating = floating(model, cut, gravcomp)
        require_weighed(model, data, cut, R0_)
        self._begin(float(data.time))

    def step(self) -> bool:
        """Read, ask and set the new pose, if it is time to; call it after each ``mj_step``.

        Returns
        -------
        bool
            Whether it was time.

        Raises
        ------
        SensorError
            If MuJoCo has found the scene unstable, or a reading is not finite.
        MountError, ProblemError, ServerUnreachable, ServerTimeout
            See `Mount.step`: nothing has moved then, and the step can be made again.
        """
        now = self._data.time
        if now < self._now:
            self._go_back()
        if now == self._now:
            return False  # no step since: the sensors have nothing new to tell, or nothing at all
        if now < self._due:
            self._now = now
            return False
        wrench = self._read()
        pose = self.mount.step(wrench)
        self._write(*pose)
        self._due += self._sync
        if self._due < now:  # syncs were missed
            self._due = now + self._sync - self._half_step
        self._now, self.wrench = now, wrench
        self.read_at = now - self._model.opt.timestep
        return True

    def settle(self, accuracy: float = 1e-3, most: int = 50) -> Settled:
        """Let time stand still until scene and component agree (with ``solve``: DirectFEA).

        Positions, velocities and controls stay as they are; only the mocap body moves.

        Parameters and errors are those of `Mount.settle`.
        """

        def scene(R: Vector, p: Vector) -> Vector:
            self._write(R, p)
            engine.mj_forward(self._model, self._data)
            return self._read()

        before = self.mount.pose
        try:
            settled = self.mount.settle(scene, accuracy, most)
        except BaseException:
            self._write(*before)
            engine.mj_forward(self._model, self._data)
            raise
        self.wrench, self.read_at = settled.wrench, self._data.time
        return settled

    def place(self, R0: ArrayLike, p0: ArrayLike) -> None:
        """Move the undeformed interface, shapes (3, 3) and (3,), m; see `Mount.place`."""
        self.mount.place(R0, p0)
        self._write(*self.mount.pose)

    def restart(self) -> None:
        """Go back to the undeformed pose, after the scene was set to another state."""
        self.mount.restart()
        self._write(*self.mount.pose)
        self._begin(float(self._data.time))

    def close(self) -> None:
        """Send what is recorded and has not been sent."""
        self.mount.close()

    def _begin(self, time: float) -> None:
        self.wrench: Vector | None = None
        self._now = self.read_at = time
        # Half a step early: times are sums of steps, and not to the last digit.
        self._half_step = 0.5 * float(self._model.opt.timestep)
        self._due = self._now + self._sync - self._half_step

    def _look_at(self, cut: Division) -> None:
        """Keep views of what is read and written: MjData's arrays stay where they are."""
        data = self._data
        self._axes: Vector = data.site_xmat[cut.site].reshape(3, 3)
        self._point: Vector = data.site_xpos[cut.site]
        self._body_axes: Vector = data.xmat[cut.body].reshape(3, 3)
        self._body_point: Vector = data.xpos[cut.body]
        self._force: Vector = data.sensordata[cut.force]
        self._torque: Vector = data.sensordata[cut.torque]
        self._position: Vector = data.mocap_pos[cut.mocap]
        self._quaternion: Vector = data.mocap_quat[cut.mocap]

    def _go_back(self) -> None:
        """Time has gone back: the user has reset the scene, or MuJoCo has, as it was unstable."""
        if any(self._data.warning[kind].number for kind in _UNSTABLE):
            raise SensorError(
                "MuJoCo has found the scene unstable and has reset it: look at its warnings; a "
                "smaller timestep, a softer contact or a slower mount. Then reset and restart()"
            )
        self.restart()
        self._begin(float(self._data.time) - 2.0 * self._half_step)  # one step has been made since

    def _read(self) -> Vector:
        """Return the wrench that the sensors tell, shape (6,), N and N·m."""
        axes, point = self._axes, self._point
        force, moment = -(axes @ self._force), -(axes @ self._torque)
        if self._floating is not None:
            lifts = -self._floating[:, None] * self._model.opt.gravity
            force = force + lifts.sum(axis=0)
            moment = moment + np.cross(self._data.xipos - point, lifts).sum(axis=0)
        # As the sensors saw it: the mocap body may have been moved since.
        present = self._body_point + self._body_axes @ self._interface
        return from_world(force, moment, point, (self.mount.undeformed[0], present))

    def _write(self, R: Vector, p: Vector) -> None:
        """Give the mocap body the pose that goes with the interface's, (3, 3) and (3,), m."""
        rotation, away = self._offset
        quaternion = np.empty(4)
        engine.mju_mat2Quat(quaternion, (R @ rotation).ravel())
        self._position[:], self._quaternion[:] = p + R @ away, quaternion


def _matrix(quaternion: Vector) -> Vector:
    """Return the rotation, shape (3, 3), of a quaternion (w, x, y, z), which need not be a unit."""
    unit, matrix = quaternion.copy(), np.empty(9)
    engine.mju_normalize4(unit)
    engine.mju_quat2Mat(matrix, unit)
    return matrix.reshape(3, 3)
