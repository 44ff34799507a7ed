"""A MuJoCo scene with a part's joints, its mass, or springs for a linear part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from wrenchbook.surrogate.kernel.binding import PackedTable

from ...contract import OUTPUTS
from ..errors import JointError
from ..mujoco import engine
from ..wrenches import Vector
from .joint import DAMPING, FREEDOMS
from .linear_part import LinearPart
from .mujoco_scene import refuse_one_locked_rotation

Spec: TypeAlias = Any  # mujoco.MjSpec, and its bodies

ROUNDING = 1e-9  # part of a freedom's largest coefficient: MuJoCo's XML has six digits
# Relative error by which three such numbers may violate the inertia's triangle inequality.
DIGITS = 2e-5
_MIN_INERTIA = 1e-9  # part of the largest moment of inertia: MuJoCo refuses a body without inertia
_MIN_GYRATION = 1e-6  # m^2, a radius of 1 mm: inertia of a mass without inertia


def scene_with_joint(
    scene: str | Path,
    base: str,
    tip: str,
    *,
    locked: Sequence[str] = (),
    site: str | None = None,
    mass: ArrayLike | None = None,
) -> str:
    """Return the XML of a scene in which a part can bend between two bodies, for `MujocoJoint`.

    The scene is an MJCF file. The tip, the interface's side, is a child of the base, the support's
    side, without joints, at the undeformed position. Locked freedoms, of ``ux`` to ``rz``, get no
    joint. `site` of the tip is the interface point and frame; the body's own frame otherwise.
    `mass` (6, 6), kg to kg·m^2, is the part's, condensed to the interface: it is added to the tip
    as a body of that mass, centre and inertia.

    Raises JointError if the scene cannot be read, has no such bodies or site, the tip is no child
    of the base or has joints.
    """
    free = [name for name in OUTPUTS if name not in locked]
    refuse_one_locked_rotation("the part", free)
    return str(_with_freedoms(scene, base, tip, free, site, mass, ball=True).to_xml())


def scene_with_springs(
    scene: str | Path,
    base: str,
    tip: str,
    springs: LinearPart,
    *,
    damping: float = DAMPING,
    site: str | None = None,
    mass: ArrayLike | None = None,
) -> str:
    """Return the XML of a scene in which MuJoCo bends a part between two bodies, linearly.

    Parameters are those of `scene_with_joint`. Rotations are three hinges. A tendon is a mode of
    the part between the two bodies, with the mode's stiffness, and with `damping` as its ratio of
    critical damping in the scene's first pose. The damping also has the term of the joint's law
    that makes a stiff mode stable at the scene's step: keep the step and the integrator, which is
    ``implicitfast`` if the scene names Euler.
    """
    spec = _with_freedoms(scene, base, tip, springs.freedoms, site, mass, ball=False)
    if spec.option.integrator == engine.mjtIntegrator.mjINT_EULER:
        spec.option.integrator = engine.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    data = engine.MjData(model)
    engine.mj_forward(model, data)
    names = [f"{tip}_{name}" for name in springs.freedoms]
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    solved = np.empty((len(dofs), model.nv))
    engine.mj_solveM(model, data, solved, np.eye(model.nv)[dofs])
    inverse_mass = solved[:, dofs]

    # A tendon's length is the mode's coordinate times the root of the mass, kg. Of the modes p of
    # the stiffness K against the effective mass M, with p M p = 1, it has the coefficients M p, the
    # stiffness omega^2 and the damping p C p, with C of the joint's law.
    stiffness = np.array(springs.stiffness)
    rate = PackedTable.joint_rate(stiffness, inverse_mass.copy(), model.opt.timestep, damping)
    root = np.linalg.cholesky(inverse_mass)
    squares, turned = np.linalg.eigh(root.T @ stiffness @ root)
    modes = root @ turned
    lengths = np.linalg.solve(root.T, turned)
    lengths[np.abs(lengths) < ROUNDING * np.abs(lengths).max(axis=1, keepdims=True)] = 0.0

    for k, square in enumerate(squares):
        tendon = spec.add_tendon(name=f"{tip}_mode_{k + 1}", stiffness=[square, 0.0, 0.0])
        tendon.damping = [modes[:, k] @ rate @ modes[:, k], 0.0, 0.0]
        tendon.springlength = np.full(2, lengths[:, k] @ springs.unloaded)
        for name, coefficient in zip(names, lengths[:, k], strict=True):
            if coefficient != 0.0:
                tendon.wrap_joint(name, coefficient)
    _compiled(lambda: spec, scene)
    return str(spec.to_xml()).replace(">", f">\n  <!-- {springs.error} -->", 1)


def _with_freedoms(
    scene: str | Path,
    base: str,
    tip: str,
    free: Sequence[str],
    site: str | None,
    mass: ArrayLike | None,
    *,
    ball: bool,
) -> Spec:
    """Return a scene with the joints of a part's free displacements, and the part's mass."""
    spec = _compiled(lambda: engine.MjSpec.from_file(str(scene)), scene)
    body = _tip_body(spec, base, tip)
    before = spec.compile()
    point, axes = _interface_in(body, site, before)

    kinds = engine.mjtJoint
    joints = [  # a slide for each free translation, then a ball or hinges for free rotations
        (name, kinds.mjJNT_SLIDE if place < 3 else kinds.mjJNT_HINGE, axes[:, place % 3].tolist())
        for place, name in enumerate(OUTPUTS)
        if name in free
    ]
    if ball and len(joints) >= 3 and all(name in free for name in OUTPUTS[3:]):
        joints[-3:] = [("r", kinds.mjJNT_BALL, [0, 0, 1])]
    for name, kind, axis in joints:
        joint = body.add_joint(name=f"{tip}_{name}", type=kind, pos=point, axis=axis)
        # A default class of the scene may set these.
        for word in ("stiffness", "damping", "frictionloss", "armature", "limited", "ref"):
            setattr(joint, word, np.zeros_like(getattr(joint, word)))

    inner = body.add_body(name=f"{tip}_part", pos=point, quat=_quaternion(axes))
    if mass is not None:
        _add_mass(inner, np.asarray(mass, dtype=float))
    return _with_keyframes(_compiled(lambda: spec, scene), tip, before)


def _tip_body(spec: Spec, base: str, tip: str) -> Spec:
    """Return the tip's body; raises JointError unless it is a child of the base without joints."""
    body = spec.body(tip)
    if body is None or spec.body(base) is None:
        missing = tip if body is None else base
        raise JointError(f"the scene has no body {missing!r}; name one of: {_names(spec.bodies)}")
    if body.parent.name != base:
        raise JointError(
            f"body {tip!r} must be a child of body {base!r}, but it is a child of "
            f"{body.parent.name!r}; move it in the scene, or name its parent with --base"
        )
    if body.joints:
        raise JointError(
            f"body {tip!r} has joints of its own, but the part must be all that holds it; move "
            f"these joints to a child body of {tip!r}"
        )
    return body


def _interface_in(body: Spec, site: str | None, model: Any) -> tuple[Vector, Vector]:
    """Return point (3,), m, and axes (3, 3) of a body's site or frame; raises JointError."""
    if site is None:
        return np.zeros(3), np.eye(3)
    if site not in [item.name for item in body.sites]:
        names = _names(body.sites)
        raise JointError(f"body {body.name!r} has no site {site!r}; name one of: {names}")
    matrix = np.zeros(9)
    number = engine.mj_name2id(model, engine.mjtObj.mjOBJ_SITE, site)
    engine.mju_quat2Mat(matrix, model.site_quat[number])
    return model.site_pos[number].copy(), matrix.reshape(3, 3)


def _with_keyframes(spec: Spec, tip: str, before: Any) -> Spec:
    """Insert a tip's new freedoms at their place in keyframes; MuJoCo appends them at the end."""
    after = spec.compile()
    first = after.body_jntadr[after.body(tip).id]
    q, v = int(after.jnt_qposadr[first]), int(after.jnt_dofadr[first])
    for key, qpos, qvel in zip(spec.keys, before.key_qpos, before.key_qvel, strict=True):
        key.qpos = np.insert(qpos, q, after.qpos0[q : q + after.nq - before.nq])
        key.qvel = np.insert(qvel, v, [0.0] * (after.nv - before.nv))
    return spec


def _compiled(read: Callable[[], Spec], scene: str | Path) -> Spec:
    """Return a scene's spec; raises JointError if the scene cannot be read or compiled."""
    try:
        spec = read()
        spec.compile()
    except (ValueError, OSError) as error:
        raise JointError(
            f"MuJoCo cannot compile the scene {scene}: {error}; correct this in the scene"
        ) from None
    return spec


def _add_mass(body: Spec, mass: Vector) -> None:
    """Give a body the mass, kg, the centre and the inertia of a mass matrix (6, 6), kg to kg·m^2.

    The mass of a rigid body is the same in all directions: the mean of the three. Its inertia about
    the centre is given as principal moments, kg·m^2, and principal axes. A zero mass is left out.
    """
    if mass.shape != (FREEDOMS, FREEDOMS) or not np.isfinite(mass).all():
        raise JointError(
            "the condensed mass must be a 6 x 6 matrix of finite numbers, not "
            f"{mass.tolist() if mass.shape == (FREEDOMS, FREEDOMS) else mass.shape}"
        )
    total = float(np.trace(mass[:3, :3])) / 3.0
    if total <= 0.0:
        return

    cross = -0.5 * (mass[:3, 3:] - mass[:3, 3:].T) / total  # the centre's cross-product matrix
    x, y, z = centre = np.array([cross[2, 1], cross[0, 2], cross[1, 0]])
    arm = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    moments, axes = np.linalg.eigh(mass[3:, 3:] + total * arm @ arm)
    moments = np.maximum(moments, _MIN_INERTIA * max(float(moments.max()), total * _MIN_GYRATION))
    # No rigid body has a moment above the sum of the other two.
    moments[2] = min(moments[2], (1.0 - DIGITS) * (moments[0] + moments[1]))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0

    body.mass = total
    body.ipos = centre
    body.inertia = moments
    body.iquat = _quaternion(axes)
    body.explicitinertial = 1


def _names(items: list[Spec]) -> str:
    return ", ".join(repr(item.name) for item in items if item.name) or "none with a name"


def _quaternion(axes: Vector) -> Vector:
    quaternion = np.zeros(4)
    engine.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    return quaternion
