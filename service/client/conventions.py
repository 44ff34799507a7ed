"""Wrenches and poses of other programs, to and from the wrench contract.

The wrench contract: force then moment, N and N·m, acting ON the deformable component, about its
displaced interface point (it moves with the section), in axes fixed to the undeformed interface
frame. Three things differ in other programs, and each converter states them:

* order: Drake puts torque first;
* sign: joint sensors of MuJoCo, PyBullet and Drake report the action of the *parent* on the
  *child*. A component that is the parent (a robot stands on a plate) feels the opposite: state its
  side;
* point and frame: a sensor's point or axes are seldom the interface's; see `moved`.

Sources, and the check of the signs: a 2 kg arm standing on a fixed parent under 10 m/s^2, its
centre of mass 0.1 m along x. MuJoCo 4.0.0 reads force (0, 0, 20), torque (0, -2, 0); PyBullet 3.2.7
the same with JOINT_FEEDBACK_IN_JOINT_FRAME. Both are the parent holding the child up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .errors import InvalidArgument
from .rotation import checked_rotation, sinc
from .wrenches import Vector, floats_of, single_wrench

Message: TypeAlias = Any  # an object of another program
Side = Literal["parent", "child"]


def moved(
    wrench: ArrayLike, *, rotation: ArrayLike | None = None, point: ArrayLike | None = None
) -> Vector:
    """Express a wrench in another frame and about another point.

    Parameters
    ----------
    wrench : array_like
        Shape (6,), N and N·m, about the sensor's point, in the sensor's axes.
    rotation : array_like, optional
        Shape (3, 3): the sensor's axes as they are now, as columns, in the undeformed interface
        frame; the same if not given.
    point : array_like, optional
        Shape (3,), m: the sensor's point less the interface point, both where they are now, in the
        undeformed interface frame; not given for a sensor at the interface point, which moves with
        it. A sensor on the ground at the undeformed point is at minus the translation.

    Returns
    -------
    numpy.ndarray
        Shape (6,): F = R f and M = R m + p x F.

    Raises
    ------
    InvalidArgument
        If a shape is wrong, a number is not finite, or the axes are no right-handed rotation: a
        mirror changes the sign of moments.
    """
    checked = single_wrench(wrench)
    force = checked[:3]
    moment = checked[3:]
    if rotation is not None:
        axes = checked_rotation("rotation", rotation)
        force, moment = axes @ force, axes @ moment
    if point is not None:
        moment = moment + np.cross(floats_of("point", point, (3,)), force)
    return np.concatenate([force, moment])


def from_ros(message: Message) -> Vector:
    """Return the wrench of a ROS ``geometry_msgs/Wrench`` or ``WrenchStamped``.

    Parameters
    ----------
    message : object or mapping
        With ``force`` and ``torque``, each with ``x``, ``y``, ``z``. ROS fixes the order, not who
        acts on whom, nor the point: it must act on the component, at the interface point where
        it is now.
        (docs.ros.org, geometry_msgs/Wrench: force and torque "separated into its linear and
        angular parts"; the frame is that of the stamped header.)

    Returns
    -------
    numpy.ndarray
        Shape (6,), N and N·m.

    Raises
    ------
    ValueError
        If a member is missing or no finite number.
    """
    inner = _field(message, "wrench")
    message = message if inner is None else inner
    return single_wrench(
        [_number(message, name, axis) for name in ("force", "torque") for axis in "xyz"]
    )


def to_ros(wrench: ArrayLike) -> dict[str, dict[str, float]]:
    """Return a wrench, shape (6,), N and N·m, as the fields of a ROS ``geometry_msgs/Wrench``."""
    numbers = single_wrench(wrench).tolist()
    return {
        "force": dict(zip("xyz", numbers[:3], strict=True)),
        "torque": dict(zip("xyz", numbers[3:], strict=True)),
    }


def from_drake(spatial_force: Message, component: Side | None = None) -> Vector:
    """Return the wrench of a Drake ``SpatialForce``.

    Parameters
    ----------
    spatial_force : object or array_like
        With ``rotational()`` and ``translational()``, or its six numbers, torque first
        (drake/multibody/math/spatial_force.h).
    component : {"parent", "child"}, optional
        For a joint's reaction (``MultibodyPlant.get_reaction_forces_output_port``: applied on the
        joint's child body, at the joint's child frame Jc, expressed in Jc), which side of the joint
        the component is. Not given for a spatial force that acts on the component already.

    Returns
    -------
    numpy.ndarray
        Shape (6,), force then moment, N and N·m.
    """
    if hasattr(spatial_force, "rotational"):
        spatial_force = np.concatenate(
            [np.ravel(spatial_force.rotational()), np.ravel(spatial_force.translational())]
        )
    swapped = single_wrench(np.ravel(spatial_force))
    wrench = np.concatenate([swapped[3:], swapped[:3]])
    return wrench if component is None else _on(component, wrench)


def to_drake(wrench: ArrayLike) -> Vector:
    """Return a wrench in Drake's order, shape (6,): torque, N·m, then force, N."""
    checked = single_wrench(wrench)
    return np.concatenate([checked[3:], checked[:3]])


def from_mujoco(force: ArrayLike, torque: ArrayLike, component: Side) -> Vector:
    """Return the wrench on the component from MuJoCo's ``force`` and ``torque`` sensors.

    Parameters
    ----------
    force, torque : array_like
        Shape (3,), N and N·m: the readings of two sensors at one site, about the site, in its axes.
    component : {"parent", "child"}
        Which of the site's body (the child) and its parent is the deformable component.

    Notes
    -----
    The MuJoCo XML reference (sensor/force) puts the site on the child and calls the force one that
    "points from the child towards the parent"; what is measured is the parent holding the child.
    """
    return _on(component, single_wrench(force, torque))


def to_mujoco(wrench: ArrayLike, component: Side) -> tuple[Vector, Vector]:
    """Return the readings of MuJoCo's ``force`` and ``torque`` sensors for a wrench.

    The wrench has shape (6,), the readings shape (3,) each, N and N·m.
    """
    reading = _on(component, single_wrench(wrench))
    return reading[:3], reading[3:]


def from_pybullet(reaction: ArrayLike, component: Side) -> Vector:
    """Return the wrench on the component from PyBullet's joint reaction.

    Parameters
    ----------
    reaction : array_like
        Shape (6,), N and N·m: ``getJointState(...)[2]``, force then moment, of a joint with
        ``enableJointForceTorqueSensor``.
    component : {"parent", "child"}
        Which side of the joint the deformable component is.

    Notes
    -----
    With ``jointFeedbackMode=JOINT_FEEDBACK_IN_JOINT_FRAME`` moments are about the joint. In the
    default mode and in JOINT_FEEDBACK_IN_WORLD_SPACE alone they are about the child's centre of
    mass (measured: zero for the arm above): give that point to `moved`. Axes are the child's, or
    the world's with JOINT_FEEDBACK_IN_WORLD_SPACE.
    """
    return _on(component, single_wrench(reaction))


def to_pybullet(wrench: ArrayLike, component: Side) -> Vector:
    """Return PyBullet's joint reaction for a wrench, both of shape (6,), N and N·m."""
    return _on(component, single_wrench(wrench))


def quaternion_wxyz(rotation: ArrayLike) -> Vector:
    """Return a rotation vector, shape (3,), rad, as MuJoCo and Drake write it: (w, x, y, z).

    The unit quaternion has shape (4,) and is dimensionless. Raises InvalidArgument for another
    shape, and for numbers that are not finite.
    """
    vector = floats_of("rotation", rotation, (3,))
    angle = math.sqrt(float(vector @ vector))
    return np.concatenate([[math.cos(0.5 * angle)], 0.5 * sinc(0.5 * angle) * vector])


def quaternion_xyzw(rotation: ArrayLike) -> Vector:
    """Return a rotation vector, shape (3,), rad, as ROS and PyBullet write it: (x, y, z, w).

    The unit quaternion has shape (4,) and is dimensionless.
    """
    return np.roll(quaternion_wxyz(rotation), -1)


def _on(component: Side, parent_to_child: Vector) -> Vector:
    """Convert a wrench of the parent on the child to the wrench on the component, and back."""
    if component not in ("parent", "child"):
        raise InvalidArgument(f"component must be 'parent' or 'child', not {component!r}")
    # Adding zero turns the -0.0 of an unloaded direction into 0.0.
    return (-parent_to_child if component == "parent" else parent_to_child) + 0.0


def _field(message: Message, name: str) -> Message:
    """Return a message's member, an attribute or a key; None without it."""
    return message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)


def _number(message: Message, name: str, axis: str) -> float:
    """Return a component of a message's force or torque; raises InvalidArgument if it is none."""
    vector = _field(message, name)
    member = None if vector is None else _field(vector, axis)
    if member is None:
        missing = name if vector is None else f"{name}.{axis}"
        raise InvalidArgument(
            f"the message has no {missing!r}; give a message with force and torque, each with x, "
            "y and z"
        )
    try:
        return float(member)
    except (TypeError, ValueError):
        raise InvalidArgument(f"{name}.{axis} must be a float, like 1.5, not {member!r}") from None
