"""The mount in MuJoCo: reads two sensors, writes a mocap body's pose.

Sensors read the wrench on the component only in some scenes. Each check was tried in MuJoCo 4.0.0;
tests/service/client has a scene for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidArgument, MountWarning, SensorError, warn
from ..mujoco import OBJECT, Data, Model, engine, id_of, name_of, was_reset
from ..wrenches import Vector
from .mount import Mount, from_world, require_weight
from .statics import Settled

if TYPE_CHECKING:
    from .. import Client, Table

_DISABLE = engine.mjtDisableBit
_REMEDY = (
    'attach the rigid system to the mocap body without a joint, <body name="base" mocap="true"> '
    '<body name="mounted"> <site name="mount"/> ... </body> </body>, with <force site="mount"/> '
    'and <torque site="mount"/> sensors'
)
_ROUNDING = 1e-3  # relative: a sync of one step may be written with fewer digits than the step
_NAMED = 5  # bodies in a message: more would hide its remedy


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
        As of `Mount`.
    component : str
        Name of the component.
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
        The mount itself: coverage of the answers, last answer, recorder.
    wrench : numpy.ndarray or None
        The last reading, shape (6,), N and N·m, about the interface point where it then was.
    read_at : float
        Time of the last reading, s.

    Raises
    ------
    SensorError
        If the scene's sensors do not read the wrench on the component; the text says why.
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
        model: Model,
        data: Data,
        mocap: str = "base",
        force: str = "mount_force",
        torque: str = "mount_torque",
        *,
        source: Table | Client,
        component: str,
        R0: ArrayLike | None = None,
        p0: ArrayLike | None = None,
        sync: float | None = None,
        gravcomp: str | None = None,
        **options: Any,
    ) -> None:
        step = float(model.opt.timestep)
        if sync is not None and not sync >= (1.0 - _ROUNDING) * step:
            raise InvalidArgument(f"sync must be at least the step of {step:g} s, not {sync:g} s")
        self._model = model
        self._data = data
        self._sync = sync or 0.0
        cut = _division(model, mocap, force, torque)

        # Views of the arrays that are read and written: MjData's arrays never move.
        self._axes: Vector = data.site_xmat[cut.site].reshape(3, 3)
        self._point: Vector = data.site_xpos[cut.site]
        self._body_axes: Vector = data.xmat[cut.body].reshape(3, 3)
        self._body_point: Vector = data.xpos[cut.body]
        self._force: Vector = data.sensordata[cut.force]
        self._torque: Vector = data.sensordata[cut.torque]
        self._position: Vector = data.mocap_pos[cut.mocap]
        self._quaternion: Vector = data.mocap_quat[cut.mocap]

        unit = self._quaternion.copy()
        matrix = np.empty(9)
        engine.mju_normalize4(unit)
        engine.mju_quat2Mat(matrix, unit)
        axes = matrix.reshape(3, 3)
        point = self._position.copy()
        undeformed = (axes if R0 is None else R0, point if p0 is None else p0)
        self.mount = Mount(source, component, *undeformed, **options)

        R0_, p0_ = self.mount.undeformed
        # The mocap body relative to the interface, and the interface point relative to the mocap
        # body: the two are one rigid piece.
        self._offset = R0_.T @ axes, R0_.T @ (point - p0_)
        self._interface = axes.T @ (p0_ - point)
        self._floating = _floating(model, cut, gravcomp)
        if not model.opt.disableflags & _DISABLE.mjDSBL_GRAVITY:
            mass = float(model.body_subtreemass[cut.mounted])
            weight = -_reaction_at_rest(model, data, cut)
            require_weight(weight @ R0_, mass, model.opt.gravity, R0_)
        self._begin(float(data.time))

    def step(self) -> bool:
        """Read the sensors and set the new pose at each sync; call it after each ``mj_step``.

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
        if now < self._now:  # the user, or MuJoCo after an instability, has reset the scene
            if was_reset(self._data):
                raise SensorError(
                    "MuJoCo has reset the unstable scene. See its warnings; use a smaller "
                    "timestep, a softer contact or a slower mount, then reset and restart()"
                )
            self.restart()
            self._begin(float(now) - 2.0 * self._half_step)  # one step was made since
        if now == self._now:
            return False  # no step since: the sensors have no new reading, or none at all
        if now < self._due:
            self._now = now
            return False
        wrench = self._read()
        self._write(*self.mount.step(wrench))
        self._due += self._sync
        if self._due < now:  # syncs were missed
            self._due = now + self._sync - self._half_step
        self._now = now
        self.wrench = wrench
        self.read_at = now - self._model.opt.timestep
        return True

    def settle(self, accuracy: float = 1e-3, most: int = 50) -> Settled:
        """Hold the time until scene and component agree (with ``solve``: DirectFEA).

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
        self.wrench = settled.wrench
        self.read_at = self._data.time
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
        """Send recorded wrenches that are not sent yet."""
        self.mount.close()

    def _begin(self, time: float) -> None:
        self.wrench: Vector | None = None
        self._now = self.read_at = time
        # Half a step early: times are sums of steps, with rounding.
        self._half_step = 0.5 * float(self._model.opt.timestep)
        self._due = self._now + self._sync - self._half_step

    def _read(self) -> Vector:
        """Return the wrench that the sensors read, shape (6,), N and N·m."""
        axes, point = self._axes, self._point
        force, moment = -(axes @ self._force), -(axes @ self._torque)
        if self._floating is not None:
            lifts = -self._floating[:, None] * self._model.opt.gravity
            force = force + lifts.sum(axis=0)
            moment = moment + np.cross(self._data.xipos - point, lifts).sum(axis=0)
        # At the sensors' time: the mocap body may have been moved since.
        present = self._body_point + self._body_axes @ self._interface
        return from_world(force, moment, point, (self.mount.undeformed[0], present))

    def _write(self, R: Vector, p: Vector) -> None:
        """Give the mocap body the pose that belongs to the interface's, (3, 3) and (3,), m."""
        rotation, offset = self._offset
        quaternion = np.empty(4)
        engine.mju_mat2Quat(quaternion, (R @ rotation).ravel())
        self._position[:], self._quaternion[:] = p + R @ offset, quaternion


@dataclass(frozen=True)
class _Division:
    """The division of a MuJoCo scene between mount and rigid system."""

    mocap: int  # number of the mocap pose
    body: int  # the mocap body
    mounted: int  # the body whose connection to its parent the sensors read
    site: int
    force: slice  # indices of the sensors' numbers
    torque: slice


def _division(model: Model, mocap: str, force: str, torque: str) -> _Division:
    """Return the division of a scene; raises SensorError if its sensors read another wrench."""
    body = _named(model, OBJECT.mjOBJ_BODY, mocap, "body")
    number = int(model.body_mocapid[body])
    if number < 0:
        raise SensorError(f"body {mocap!r} is not a mocap body; {_REMEDY}")
    forces, site = _sensor(model, force, engine.mjtSensor.mjSENS_FORCE, "force")
    torques, other = _sensor(model, torque, engine.mjtSensor.mjSENS_TORQUE, "torque")
    if site != other:
        raise SensorError(
            f"sensors {force!r} and {torque!r} are at different sites, but must read the same "
            "joint; put both at one site"
        )
    if model.opt.disableflags & _DISABLE.mjDSBL_SENSOR:
        raise SensorError(
            'the scene disables its sensors; remove <flag sensor="disable"/> from its XML'
        )
    mounted = int(model.site_bodyid[site])
    if mounted != body:  # on the mocap body sensors read all bodies above it, and its own mass
        _check_mounted(model, body, mounted)
    _check_forces(model, body, mounted)
    return _Division(number, body, mounted, site, forces, torques)


def _check_mounted(model: Model, mocap: int, mounted: int) -> None:
    """Refuse a body that is no child of the mocap body without joints, or not its only child."""
    name, parent = name_of(model, mounted), name_of(model, mocap)
    first = model.body_jntadr[mounted]
    kinds = model.jnt_type[first : first + model.body_jntnum[mounted]]
    if (kinds == engine.mjtJoint.mjJNT_FREE).any():
        raise SensorError(
            f"body {name!r} has a free joint, so nothing holds it and its sensors read 0; {_REMEDY}"
        )
    if model.body_parentid[mounted] != mocap or len(kinds):
        raise SensorError(
            f"body {name!r}, where the sensors are, must be a child of the mocap body {parent!r} "
            f"without a joint; {_REMEDY}"
        )
    children = (model.body_parentid == mocap) & (model.body_subtreemass > 0.0)
    children[mounted] = False
    if children.any():
        raise SensorError(
            f"the mocap body {parent!r} also carries {_names(model, children)}, which the sensors "
            f"on {name!r} do not feel; put all in one child, or move the site to the mocap body"
        )


def _reaction_at_rest(model: Model, data: Data, division: _Division) -> Vector:
    """Return the force that the sensor reads at rest, without contacts, (3,), N, in the world."""
    scratch = engine.MjData(model)  # the scene's own data do not change
    scratch.qpos[:], scratch.mocap_pos[:] = data.qpos, data.mocap_pos
    scratch.mocap_quat[:] = data.mocap_quat
    flags = model.opt.disableflags
    try:
        model.opt.disableflags |= _DISABLE.mjDSBL_CONSTRAINT
        engine.mj_inverse(model, scratch)
    finally:
        model.opt.disableflags = flags
    return scratch.site_xmat[division.site].reshape(3, 3) @ scratch.sensordata[division.force]


def _floating(model: Model, division: _Division, gravcomp: str | None) -> Vector | None:
    """Return the mass of bodies that gravity compensation carries, kg, (bodies,); None if nothing.

    Raises SensorError if a body is compensated and `gravcomp` is not given; InvalidArgument if it
    is not valid, or the compensation cannot be subtracted with this integrator.
    """
    if gravcomp is not None and gravcomp not in ("motors", "float"):
        raise InvalidArgument(f"gravcomp must be 'motors' or 'float', not {gravcomp!r}")
    hanging = _hangs_on(model, division.mounted)
    masses = model.body_gravcomp * model.body_mass * hanging
    if not masses.any() or gravcomp == "motors":
        return None
    if gravcomp is None:
        raise SensorError(
            f"gravcomp is set on {_names(model, masses)}, but the sensors read the full weight. "
            "Write gravcomp='motors' if joints carry the weight and the mount feels it, or "
            "gravcomp='float' if something outside carries it"
        )
    if model.opt.integrator == engine.mjtIntegrator.mjINT_RK4:
        raise InvalidArgument(
            "gravcomp='float' needs the positions at the sensor reading, which RK4 overwrites; use "
            "the integrator Euler, implicit or implicitfast"
        )
    return masses


def _check_forces(model: Model, body: int, mounted: int) -> None:
    """Refuse equality constraints at the mocap body; warn of forces that no sensor reads."""
    holding = [int(kind) for kind in (engine.mjtEq.mjEQ_WELD, engine.mjtEq.mjEQ_CONNECT)]
    for number in np.flatnonzero(np.isin(model.eq_type, holding)).tolist():
        name = name_of(model, number, OBJECT.mjOBJ_EQUALITY)
        ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if model.eq_objtype[number] == OBJECT.mjOBJ_SITE:
            ends = [int(model.site_bodyid[end]) for end in ends]
        if body in ends:
            raise SensorError(
                f"the equality constraint {name!r} holds the scene to the mocap body, but it "
                f"yields, and its load is wrong by several per cent or more; {_REMEDY}"
            )

    hanging = _hangs_on(model, mounted)
    unfelt = []
    for number in range(model.nu):
        kind, target = model.actuator_trntype[number], model.actuator_trnid[number]
        at_site = kind == engine.mjtTrn.mjTRN_SITE and target[1] < 0
        if at_site and hanging[model.site_bodyid[target[0]]]:
            unfelt.append(f"actuator {name_of(model, number, OBJECT.mjOBJ_ACTUATOR)!r} at a site")
    if model.opt.density > 0.0 or model.opt.viscosity > 0.0:
        unfelt.append("the medium's drag (density, viscosity)")
    if unfelt:
        warn(
            f"MuJoCo leaves these out of its force sensors: {', '.join(unfelt)}. The mount does "
            "not feel them; apply them by xfrc_applied, which it feels",
            MountWarning,
        )


def _hangs_on(model: Model, mounted: int) -> NDArray[np.bool_]:
    """Return which bodies are the mounted one or its descendants: booleans, shape (bodies,)."""
    hanging = np.zeros(model.nbody, dtype=bool)
    hanging[mounted] = True
    for body in range(mounted + 1, model.nbody):  # a parent's number is below its children's
        hanging[body] |= hanging[model.body_parentid[body]]
    return hanging


def _sensor(model: Model, name: str, kind: int, word: str) -> tuple[slice, int]:
    """Return a sensor's numbers and its site."""
    number = _named(model, OBJECT.mjOBJ_SENSOR, name, "sensor")
    if model.sensor_type[number] != kind:
        raise SensorError(f"sensor {name!r} must be a {word} sensor; {_REMEDY}")
    filters = [
        word
        for word in ("cutoff", "delay", "interval")
        if np.any(getattr(model, f"sensor_{word}", np.zeros(number + 1))[number] > 0.0)
    ]
    if filters:
        raise SensorError(
            f"sensor {name!r} has {' and '.join(filters)}, so its reading is not the present "
            "wrench; remove this attribute from the sensor"
        )
    start = int(model.sensor_adr[number])
    return slice(start, start + 3), int(model.sensor_objid[number])


def _named(model: Model, kind: int, name: str, word: str) -> int:
    """Return the number of a named object; raises SensorError with the existing names."""
    number = id_of(model, kind, name)
    if number < 0:
        count = model.nbody if kind == OBJECT.mjOBJ_BODY else model.nsensor
        names = [text for k in range(count) if (text := engine.mj_id2name(model, kind, k))]
        raise SensorError(
            f"the scene has no {word} {name!r}; it has {', '.join(map(repr, names)) or 'none'}; "
            "correct the name"
        )
    return number


def _names(model: Model, bodies: Vector | NDArray[np.bool_]) -> str:
    """Return the names of the first bodies of a mask, (bodies,)."""
    return ", ".join(repr(name_of(model, body)) for body in np.flatnonzero(bodies)[:_NAMED])
