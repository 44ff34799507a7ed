"""A MuJoCo scene with the joints of a part: three slides and a ball, and the part's own mass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import JointError
from .joint import FREEDOMS
from .mujoco_joint import engine

Vector = NDArray[np.float64]

_NAMES = ("ux", "uy", "uz", "rx", "ry", "rz")
_LEAST = 1e-9  # of the largest moment of inertia: MuJoCo takes no body without one


def scene_with_joint(
    scene: str | Path,
    base: str,
    tip: str,
    *,
    locked: Sequence[str] = (),
    site: str | None = None,
    mass: ArrayLike | None = None,
) -> str:
    """Return the XML of a scene in which a part can bend between two bodies.

    Parameters
    ----------
    scene : path
        An MJCF file. The tip is a child of the base, without joints: where the part is undeformed.
    base, tip : str
        The bodies of the support's and of the interface's side.
    locked : sequence of str
        Freedoms that the part locks, of ``ux`` to ``rz``: they get no joint.
    site : str, optional
        A site of the tip that is the interface point and frame; the body's own frame otherwise.
    mass : array_like, optional
        The part's mass condensed to the interface, shape (6, 6), kg to kg·m^2: it is added to the
        tip as a body of that mass, centre and inertia.

    Raises
    ------
    JointError
        If the scene cannot be read, has no such bodies or site, the tip is no child of the base or
        has joints.
    """
    spec = _compiled(lambda: engine.MjSpec.from_file(str(scene)), scene)
    body = _child(spec, base, tip)
    at, axes = _interface(spec, body, site)
    _add_joints(body, tip, at, axes, locked)
    inner = body.add_body(name=f"{tip}_part", pos=at, quat=_quaternion(axes))
    if mass is not None:
        _add_mass(inner, np.asarray(mass, dtype=float))
    return str(_compiled(lambda: spec, scene).to_xml())


def _compiled(read: Callable[[], Any], scene: str | Path) -> Any:
    """Return a scene that MuJoCo compiles."""
    try:
        spec = read()
        spec.compile()
    except (ValueError, OSError) as error:
        raise JointError(f"{scene} is no scene that MuJoCo reads: {error}") from None
    return spec


def _child(spec: Any, base: str, tip: str) -> Any:
    """Return the tip's body, if it hangs on the base without joints."""
    body = spec.body(tip)
    if body is None or spec.body(base) is None:
        names = ", ".join(repr(one.name) for one in spec.bodies if one.name) or "none with a name"
        missing = tip if body is None else base
        raise JointError(f"the scene has no body {missing!r}; it has {names}")
    if body.parent.name != base:
        raise JointError(f"body {tip!r} must be a child of body {base!r}")
    if body.joints:
        raise JointError(
            f"body {tip!r} has joints: put what they move into a child of it, since the part holds "
            "the tip"
        )
    return body


def _interface(spec: Any, body: Any, site: str | None) -> tuple[Vector, Vector]:
    """Return the interface point, m, and axes, as columns, in the tip's body."""
    if site is None:
        return np.zeros(3), np.eye(3)
    if site not in [one.name for one in body.sites]:
        names = ", ".join(repr(one.name) for one in body.sites if one.name) or "none with a name"
        raise JointError(f"body {body.name!r} has no site {site!r}; it has {names}")
    model = spec.compile()
    number = engine.mj_name2id(model, engine.mjtObj.mjOBJ_SITE, site)
    axes = np.zeros(9)
    engine.mju_quat2Mat(axes, model.site_quat[number])
    return model.site_pos[number].copy(), axes.reshape(3, 3)


def _add_joints(body: Any, tip: str, at: Vector, axes: Vector, locked: Sequence[str]) -> None:
    """Add a slide a free translation, then the ball or the hinge of the free rotations."""
    free = [place for place in range(FREEDOMS) if _NAMES[place] not in locked]
    turns = [place for place in free if place >= 3]
    if len(turns) not in (0, 1, 3):
        raise JointError("the part locks one rotation of three or two: no MuJoCo joint does")
    kinds = engine.mjtJoint
    bare = {"stiffness": 0, "damping": 0, "frictionloss": 0, "armature": 0, "limited": 0}
    for place in [one for one in free if one < 3]:
        axis = axes[:, place].tolist()
        _joint(body, f"{tip}_{_NAMES[place]}", kinds.mjJNT_SLIDE, at, axis, bare)
    if len(turns) == 3:
        _joint(body, f"{tip}_r", kinds.mjJNT_BALL, at, [0, 0, 1], bare)
    for place in turns if len(turns) == 1 else ():
        axis = axes[:, place - 3].tolist()
        _joint(body, f"{tip}_{_NAMES[place]}", kinds.mjJNT_HINGE, at, axis, bare)


def _joint(body: Any, name: str, kind: Any, at: Vector, axis: list[float], bare: Any) -> None:
    joint = body.add_joint(name=name, type=kind, pos=at, axis=axis)
    for word, value in bare.items():
        field = getattr(joint, word)
        setattr(joint, word, value if np.ndim(field) == 0 else np.full(np.shape(field), value))


def _add_mass(body: Any, mass: Vector) -> None:
    """Give a body the mass, kg, the centre and the inertia of a mass matrix, (6, 6).

    The mass of a rigid body is the same in all directions: the mean of the three.
    """
    if mass.shape != (FREEDOMS, FREEDOMS) or not np.isfinite(mass).all():
        raise JointError("the condensed mass must be a matrix of 6 x 6 finite numbers")
    whole = float(np.trace(mass[:3, :3])) / 3.0
    if whole <= 0.0:
        return
    cross = -0.5 * (mass[:3, 3:] - mass[:3, 3:].T) / whole
    centre = np.array([cross[2, 1], cross[0, 2], cross[1, 0]])
    arm = np.array(
        [[0, -centre[2], centre[1]], [centre[2], 0, -centre[0]], [-centre[1], centre[0], 0]]
    )
    values, axes = np.linalg.eigh(mass[3:, 3:] + whole * arm @ arm)
    values = np.maximum(values, _LEAST * max(float(values.max()), whole * 1e-6))
    values[2] = min(values[2], values[0] + values[1])  # no rigid body has more
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0
    body.mass, body.ipos, body.inertia = whole, centre, values
    body.iquat, body.explicitinertial = _quaternion(axes), 1


def _quaternion(axes: Vector) -> Vector:
    found = np.zeros(4)
    engine.mju_mat2Quat(found, np.ascontiguousarray(axes).ravel())
    return found
