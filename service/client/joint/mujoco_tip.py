"""The tip of a joint in a MuJoCo scene: its joints are checked, and located in the model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import JointError
from ..wrenches import Vector
from .mujoco_scene import Model, body_number, engine

REMEDY = "make the scene with: wrenchbook joint NAME --base BODY --tip BODY scene.xml"
_JOINT = engine.mjtJoint
_SQUARE = 1e-5  # the axes of the slides are unit and orthogonal to the six digits of MuJoCo's XML


class Tip(NamedTuple):
    """The joints of a tip's body in MuJoCo's arrays."""

    dof: int  # the first freedom
    runs: list[tuple[int, int, int]]  # of numbers: place in the pose, (7,), place in qpos, count
    hinge: tuple[Vector, int] | None  # of a single free rotation: axis (3,), place in qpos
    ball_axes: Vector | None  # (3, 3), columns: the interface frame's axes in the tip's body


def find_tip(model: Model, body: str, free: NDArray[np.intp], part: str) -> Tip:
    """Return the joints of a tip's body, of a part whose displacements `free`, of 0 to 5, are free.

    JointError if the body has other joints, or joints with forces or axes of their own.
    """
    number = body_number(model, body)
    first = int(model.body_jntadr[number])
    joints = list(range(first, first + int(model.body_jntnum[number])))
    slides, turns = free[free < 3], free[free >= 3]
    has_ball = len(turns) == 3
    if len(turns) == 2:
        raise JointError(f"{part} locks one rotation, which MuJoCo cannot do; lock none or two")
    turning = [] if not len(turns) else [_JOINT.mjJNT_BALL if has_ball else _JOINT.mjJNT_HINGE]
    expected = [int(kind) for kind in [_JOINT.mjJNT_SLIDE] * len(slides) + turning]
    if [int(model.jnt_type[joint]) for joint in joints] != expected:
        also = {0: "", 1: " and a hinge", 3: " and a ball"}[len(turns)]
        raise JointError(
            f"body {body!r} must have {len(slides)} slides{also}, in this order; {REMEDY}"
        )
    for joint in joints:
        _refuse_forces(model, body, joint)
    axes = _interface_axes(model.jnt_axis[joints], body, free)
    places = model.jnt_qposadr[joints].tolist()
    runs = [(slide, place, 1) for slide, place in zip(slides.tolist(), places, strict=False)]
    if len(slides) == 3:  # one behind the other
        runs = [(0, places[0], 3)]
    if has_ball:
        runs.append((3, places[-1], 4))
    hinge = (np.eye(3)[turns[0] - 3], places[-1]) if len(turns) == 1 else None
    return Tip(int(model.jnt_dofadr[first]), runs, hinge, axes if has_ball else None)


def _refuse_forces(model: Model, body: str, joint: int) -> None:
    """Raise JointError if a joint has a force of its own, or a reference beside zero."""
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
        raise JointError(
            f"a joint of body {body!r} has {present[0]}, which would add to that of the "
            "part; remove it (a default class may set it)"
        )


def _interface_axes(joint_axes: Vector, body: str, free: NDArray[np.intp]) -> Vector:
    """Return the interface frame's axes in the tip's body, (3, 3); JointError of other axes.

    They are those of three slides, else the body's. `joint_axes` are (joints, 3).
    """
    axis_of = dict(zip(free.tolist(), joint_axes, strict=False))  # a ball is one of three rotations
    slides = [axis for place, axis in axis_of.items() if place < 3]
    # The nearest orthogonal matrix, by the polar decomposition.
    left, _, right = np.linalg.svd(np.array(slides).T if len(slides) == 3 else np.eye(3))
    axes = left @ right
    has_ball = int((free >= 3).sum()) == 3
    along = [place for place in axis_of if place < 3 or not has_ball]
    off = [np.abs(axis_of[place] - axes[:, place % 3]).max() for place in along]
    if max(off, default=0.0) > _SQUARE or np.linalg.det(axes) < 0:
        raise JointError(
            f"the joints of body {body!r} must have the axes x, y, z of the interface frame "
            f"(with locked freedoms: of the body), unit, orthogonal and right-handed; {REMEDY}"
        )
    return axes
