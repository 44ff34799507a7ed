"""Queries of MuJoCo's models for joints: bodies by name, the joints of a tip."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...contract import OUTPUTS
from ..errors import JointError, JointWarning, warn
from ..mujoco import OBJECT, Data, Model, engine, id_of, name_of, was_reset
from ..wrenches import Vector

_REMEDY = "make the scene with: wrenchbook joint NAME --base BODY --tip BODY scene.xml"
_JOINT = engine.mjtJoint
_AXES_TOLERANCE = 1e-5  # from unit and orthogonal: MuJoCo's XML has six digits
_OLDEST = (3, 17)  # MuJoCo's version: constraints in 3.3.7 ignore additions to the mass matrix
# A plain int: a comparison with an enumeration takes 0.8 us.
_RK4 = int(engine.mjtIntegrator.mjINT_RK4)


def warn_unstable(data: Data, name: str) -> bool:
    """Warn if MuJoCo has reset a scene because it was unstable; return whether it has."""
    is_unstable = was_reset(data)
    if is_unstable:
        warn(
            f"{name}: MuJoCo has reset the unstable scene, and the simulation goes on from its "
            "first state. Check masses and inputs, or use a smaller time step or softer contacts. "
            "This warning appears once",
            JointWarning,
        )
    return is_unstable


def require_version() -> None:
    """Raise JointError if MuJoCo is older than `_OLDEST`."""
    if tuple(int(number) for number in engine.__version__.split(".")[:2]) < _OLDEST:
        raise JointError(
            f"MujocoJoint needs MuJoCo 3.17 or newer, but version {engine.__version__} is "
            "installed; run: pip install 'mujoco>=3.17'"
        )


def refuse_rk4(model: Model) -> None:
    """Raise JointError if a model is integrated by RK4."""
    if model.opt.integrator == _RK4:
        raise JointError(
            "the integrator RK4 evaluates forces four times a step, but the joint only once; use "
            "Euler, implicit or implicitfast"
        )


def refuse_one_locked_rotation(part: str, free: Collection[str]) -> None:
    """Raise JointError if a part with the displacements `free` locks a single rotation."""
    locked = [name for name in OUTPUTS[3:] if name not in free]
    if len(locked) == 1:
        raise JointError(
            f"{part} locks a single rotation, {locked[0]}, for which MuJoCo has no joint; lock "
            "none, two or three rotations in its component.toml"
        )


def block_positions(model: Model, dofs: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the pairs of consecutive freedoms, (n,), that MuJoCo's mass matrix stores.

    Three arrays, (pairs,): row and column among the n freedoms, and position in ``data.M``.
    """
    entries = []
    for row, dof in enumerate(dofs.tolist()):
        start, count = int(model.M_rowadr[dof]), int(model.M_rownnz[dof])
        columns = model.M_colind[start : start + count] - dofs[0]
        entries += [(row, int(at), start + k) for k, at in enumerate(columns) if at >= 0]
    return list(np.array(entries).T)


def body_number(model: Model, name: str) -> int:
    """Return the number of a named body; raises JointError if there is none."""
    number = id_of(model, OBJECT.mjOBJ_BODY, name)
    if number < 0:
        names = [engine.mj_id2name(model, OBJECT.mjOBJ_BODY, k) for k in range(1, model.nbody)]
        known = ", ".join(repr(text) for text in names if text) or "none with a name"
        raise JointError(f"the scene has no body {name!r}; its bodies: {known}")
    return number


class PoseRun(NamedTuple):
    """Consecutive numbers of a tip's pose, (7,): translation, m, and quaternion."""

    start: int  # index in the pose
    qpos: int  # index in MuJoCo's qpos
    size: int


class Tip(NamedTuple):
    """The joints of a tip's body in MuJoCo's arrays."""

    dof: int  # the first freedom
    runs: list[PoseRun]
    hinge: tuple[Vector, int] | None  # a single free rotation: its axis (3,), index in qpos
    ball_axes: Vector | None  # (3, 3), columns: the interface frame's axes in the tip's body


def find_tip(model: Model, body: str, free: NDArray[np.intp], part: str) -> Tip:
    """Return the joints of a tip's body; `free`: the part's free displacements, of 0 to 5.

    Raises JointError if the body has other joints, or joints with forces or axes of their own.
    """
    number = body_number(model, body)
    first = int(model.body_jntadr[number])
    joints = list(range(first, first + int(model.body_jntnum[number])))
    slides = free[free < 3]
    turns = free[free >= 3]
    has_ball = len(turns) == 3
    refuse_one_locked_rotation(part, [OUTPUTS[freedom] for freedom in free])
    turning = [] if not len(turns) else [_JOINT.mjJNT_BALL if has_ball else _JOINT.mjJNT_HINGE]
    expected = [int(kind) for kind in [_JOINT.mjJNT_SLIDE] * len(slides) + turning]
    present = [int(model.jnt_type[joint]) for joint in joints]
    if present != expected:
        also = {0: "", 1: " and a hinge", 3: " and a ball"}[len(turns)]  # 2: refused above
        actual = ", ".join(_JOINT(kind).name[6:].lower() for kind in present) or "no joint"
        raise JointError(
            f"body {body!r} must have {len(slides)} slides{also}, in this order, but it has "
            f"{actual}; {_REMEDY}"
        )
    for joint in joints:
        _refuse_forces(model, body, joint)

    axes = _interface_axes(model.jnt_axis[joints], body, free)
    qpos = model.jnt_qposadr[joints].tolist()
    runs = [PoseRun(slide, qpos[k], 1) for k, slide in enumerate(slides.tolist())]
    if len(slides) == 3:  # all three in the order x, y, z
        runs = [PoseRun(0, qpos[0], 3)]
    if has_ball:
        runs.append(PoseRun(3, qpos[-1], 4))
    hinge = (np.eye(3)[turns[0] - 3], qpos[-1]) if len(turns) == 1 else None
    return Tip(int(model.jnt_dofadr[first]), runs, hinge, axes if has_ball else None)


def _refuse_forces(model: Model, body: str, joint: int) -> None:
    """Raise JointError if a joint has a force of its own, or a reference other than zero."""
    dof = int(model.jnt_dofadr[joint])
    forces = {
        "stiffness": model.jnt_stiffness[joint],
        "damping": model.dof_damping[dof],
        "frictionloss": model.dof_frictionloss[dof],
        "armature": model.dof_armature[dof],
        "a limited range": model.jnt_limited[joint],
    }
    if model.jnt_type[joint] != _JOINT.mjJNT_BALL:
        forces["a reference (ref)"] = model.qpos0[model.jnt_qposadr[joint]]
    present = [name for name, value in forces.items() if np.any(value)]
    if present:
        name = name_of(model, joint, OBJECT.mjOBJ_JOINT)
        raise JointError(
            f"joint {name!r} of body {body!r} has {' and '.join(present)}, which would add to the "
            "part's own; remove it (a default class may set it)"
        )


def _interface_axes(joint_axes: Vector, body: str, free: NDArray[np.intp]) -> Vector:
    """Return the interface frame's axes in the tip's body, (3, 3).

    They are the axes of three slides, else the body's. `joint_axes` has the shape (joints, 3).

    Raises JointError if the slides have other axes.
    """
    # A ball, the last joint, stands for three rotations, and its axis has no meaning.
    axis_of = dict(zip(free.tolist()[: len(joint_axes)], joint_axes, strict=True))
    slides = [axis for freedom, axis in axis_of.items() if freedom < 3]
    # The nearest orthogonal matrix, by the polar decomposition.
    left, _, right = np.linalg.svd(np.array(slides).T if len(slides) == 3 else np.eye(3))
    axes = left @ right
    has_ball = int((free >= 3).sum()) == 3
    along = [freedom for freedom in axis_of if freedom < 3 or not has_ball]
    deviations = [np.abs(axis_of[k] - axes[:, k % 3]).max() for k in along]
    if max(deviations, default=0.0) > _AXES_TOLERANCE or np.linalg.det(axes) < 0:
        raise JointError(
            f"the joints of body {body!r} must have the axes x, y, z of the interface frame "
            "(with locked freedoms: of the body), unit, orthogonal and right-handed, not "
            f"{joint_axes.round(6).tolist()}; {_REMEDY}"
        )
    return axes
