"""What must hold of a MuJoCo scene for its sensors to tell the wrench on the component.

Each was tried in MuJoCo 4.0.0; tests/service/client has a scene for each.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InvalidArgument
from .errors import MountWarning, SensorError
from .reading import require_weight

try:
    import mujoco
except ModuleNotFoundError as error:
    raise ImportError(
        "MujocoMount needs the package 'mujoco', which is not installed: "
        "pip install 'wrenchbook[mujoco]'",
        name="mujoco",
    ) from error

engine: Any = mujoco  # compiled: it tells no types
_OBJECT, _DISABLE = engine.mjtObj, engine.mjtDisableBit
_REMEDY = (
    'hang the rigid system on the mocap body without a joint, <body name="base" mocap="true"> '
    '<body name="mounted"> <site name="mount"/> ... </body> </body>, with <force site="mount"/> '
    'and <torque site="mount"/> sensors'
)
GRAVCOMP = ("motors", "float")


@dataclass(frozen=True)
class Division:
    """Where a MuJoCo scene is cut.

    Attributes
    ----------
    mocap : int
        Number of the mocap pose.
    body : int
        The mocap body.
    mounted : int
        The body whose connection to its parent the sensors read.
    site : int
    force, torque : slice
        Of the sensors' numbers.
    """

    mocap: int
    body: int
    mounted: int
    site: int
    force: slice
    torque: slice


def find_division(model: Any, mocap: str, force: str, torque: str) -> Division:
    """Return where a scene is cut, and refuse a cut whose sensors mislead.

    Raises
    ------
    SensorError
        If a name is not there, a sensor is of another kind, filtered or switched off, or the rigid
        system does not hang on the mocap body as it must; the text says how it must.
    """
    body = _named(model, _OBJECT.mjOBJ_BODY, mocap, "body")
    number = int(model.body_mocapid[body])
    if number < 0:
        raise SensorError(f"body {mocap!r} is no mocap body; {_REMEDY}")
    kinds = engine.mjtSensor
    forces, site = _sensor(model, force, kinds.mjSENS_FORCE, "force")
    torques, other = _sensor(model, torque, kinds.mjSENS_TORQUE, "torque")
    if site != other:
        raise SensorError(f"sensors {force!r} and {torque!r} are at two sites; put both at one")
    if model.opt.disableflags & _DISABLE.mjDSBL_SENSOR:
        raise SensorError('sensors are switched off: remove <flag sensor="disable"/>')
    mounted = int(model.site_bodyid[site])
    division = Division(number, body, mounted, site, forces, torques)
    _require_hanging(model, division)
    _require_no_weld(model, division)
    _warn_of_unfelt(model, division)
    return division


def require_weighed(model: Any, data: Any, division: Division, axes: Any) -> None:
    """Refuse sensors that at rest do not read the weight of what hangs on the mount.

    The scene is evaluated aside, at its present position, at rest, without contacts.

    Parameters
    ----------
    model, data : MjModel, MjData
    division : Division
    axes : numpy.ndarray
        R0, shape (3, 3), dimensionless.

    Raises
    ------
    SensorError
        See `require_weight`.
    """
    aside, flags = engine.MjData(model), model.opt.disableflags
    aside.qpos[:], aside.mocap_pos[:], aside.mocap_quat[:] = (
        data.qpos,
        data.mocap_pos,
        data.mocap_quat,
    )
    try:
        model.opt.disableflags |= _DISABLE.mjDSBL_CONSTRAINT
        engine.mj_inverse(model, aside)
    finally:
        model.opt.disableflags = flags
    if flags & _DISABLE.mjDSBL_GRAVITY:
        return
    reaction = aside.site_xmat[division.site].reshape(3, 3) @ aside.sensordata[division.force]
    mass = float(model.body_subtreemass[division.mounted])
    require_weight(-reaction @ axes, mass, model.opt.gravity, axes)


def floating(model: Any, division: Division, gravcomp: str | None) -> Any:
    """Return what gravity compensation takes off each body: kg, shape (bodies,); None if nothing.

    Raises
    ------
    SensorError
        If a body is compensated and `gravcomp` is not given.
    ValueError
        If it is none of its words, or cannot be taken off with this integrator.
    """
    if gravcomp is not None and gravcomp not in GRAVCOMP:
        raise InvalidArgument(f"gravcomp must be 'motors' or 'float', not {gravcomp!r}")
    taken = np.where(_hangs_on(model, division.mounted), model.body_gravcomp * model.body_mass, 0.0)
    if not taken.any() or gravcomp == "motors":
        return None
    if gravcomp is None:
        names = ", ".join(repr(_name(model, body)) for body in np.flatnonzero(taken)[:5].tolist())
        raise SensorError(
            f"gravcomp is set on {names}: the sensors read the full weight all the same. Say what "
            "it stands for: gravcomp='motors' (joints carry the weight, the mount feels it) or "
            "gravcomp='float' (something outside carries it, the mount does not)"
        )
    if model.opt.integrator == engine.mjtIntegrator.mjINT_RK4:
        raise InvalidArgument(
            "gravcomp='float' needs the positions that the sensors saw, which RK4 overwrites: use "
            "another integrator"
        )
    return taken


def _require_hanging(model: Any, division: Division) -> None:
    """Refuse a mounted body that is not the mocap body, nor its one child, without joint."""
    body, mounted = division.body, division.mounted
    if mounted == body:
        return  # the sensors read all that hangs on the mocap body, and its own mass
    name = _name(model, mounted)
    joints = range(
        model.body_jntadr[mounted], model.body_jntadr[mounted] + model.body_jntnum[mounted]
    )
    if any(model.jnt_type[joint] == engine.mjtJoint.mjJNT_FREE for joint in joints):
        raise SensorError(
            f"body {name!r} has a free joint: nothing holds it, and its sensors read 0; {_REMEDY}"
        )
    if model.body_parentid[mounted] != body or model.body_jntnum[mounted]:
        raise SensorError(
            f"body {name!r}, where the sensors are, must be a child of the mocap body "
            f"{_name(model, body)!r} without a joint; {_REMEDY}"
        )
    neighbours = [
        repr(_name(model, child))
        for child in np.flatnonzero(model.body_parentid == body)
        if child != mounted and model.body_subtreemass[child] > 0.0
    ]
    if neighbours:
        raise SensorError(
            f"{', '.join(neighbours)} hang next to {name!r} on the mocap body, and its sensors do "
            "not feel them: put all into one child, or the site on the mocap body itself"
        )


def _require_no_weld(model: Any, division: Division) -> None:
    """Refuse an equality constraint between the mocap body and what moves."""
    kinds = (engine.mjtEq.mjEQ_WELD, engine.mjtEq.mjEQ_CONNECT)
    for number in range(model.neq):
        if not any(model.eq_type[number] == kind for kind in kinds):
            continue
        ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if model.eq_objtype[number] == _OBJECT.mjOBJ_SITE:
            ends = [int(model.site_bodyid[end]) for end in ends]
        if division.body in ends:
            raise SensorError(
                "an equality constraint holds the scene to the mocap body: it gives, and what it "
                f"carries is off by several per cent and more; {_REMEDY}"
            )


def _warn_of_unfelt(model: Any, division: Division) -> None:
    """Warn of forces on the scene that MuJoCo leaves out of its force sensors."""
    hanging, found = _hangs_on(model, division.mounted), []
    for number in range(model.nu):
        kind, target = model.actuator_trntype[number], model.actuator_trnid[number]
        at_site = kind == engine.mjtTrn.mjTRN_SITE and target[1] < 0
        if at_site and hanging[model.site_bodyid[target[0]]]:
            found.append(f"actuator {_name(model, number, _OBJECT.mjOBJ_ACTUATOR)!r} at a site")
    if model.opt.density > 0.0 or model.opt.viscosity > 0.0:
        found.append("the medium's drag (density, viscosity)")
    if found:
        warnings.warn(
            f"MuJoCo leaves these out of its force sensors: {', '.join(found)}. The mount does not "
            "feel them; apply them by xfrc_applied, which it does feel",
            MountWarning,
            stacklevel=4,  # whoever makes the mount
        )


def _hangs_on(model: Any, mounted: int) -> Any:
    """Return which bodies are the mounted one or hang on it: booleans, shape (bodies,)."""
    hanging = np.zeros(model.nbody, dtype=bool)
    hanging[mounted] = True
    for body in range(mounted + 1, model.nbody):  # a parent's number is below its children's
        hanging[body] |= hanging[model.body_parentid[body]]
    return hanging


def _sensor(model: Any, name: str, kind: Any, word: str) -> tuple[slice, int]:
    """Return a sensor's numbers and its site."""
    number = _named(model, _OBJECT.mjOBJ_SENSOR, name, "sensor")
    if model.sensor_type[number] != kind:
        raise SensorError(f"sensor {name!r} is no {word} sensor; {_REMEDY}")
    filters = [
        label
        for label, field in (
            ("cutoff", "sensor_cutoff"),
            ("delay", "sensor_delay"),
            ("interval", "sensor_interval"),
        )
        if np.any(getattr(model, field, np.zeros(number + 1))[number] > 0.0)
    ]
    if filters:
        raise SensorError(
            f"sensor {name!r} has {' and '.join(filters)}: its reading is not the wrench of now; "
            "remove it from the sensor"
        )
    start = int(model.sensor_adr[number])
    return slice(start, start + 3), int(model.sensor_objid[number])


def _named(model: Any, kind: Any, name: str, word: str) -> int:
    """Return the number of a named thing, or say which names there are."""
    number = engine.mj_name2id(model, kind, name)
    if number < 0:
        count = model.nbody if kind == _OBJECT.mjOBJ_BODY else model.nsensor
        names = [found for k in range(count) if (found := engine.mj_id2name(model, kind, k))]
        raise SensorError(
            f"the scene has no {word} {name!r}; it has {', '.join(map(repr, names)) or 'none'}"
        )
    return number


def _name(model: Any, number: Any, kind: Any = _OBJECT.mjOBJ_BODY) -> str:
    return engine.mj_id2name(model, kind, int(number)) or f"#{number}"
