"""A simulation's reading as the wrench contract wants it, and whether it can be that."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InvalidArgument, SensorError
from ..wrenches import Vector, one_wrench

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, z up
CONTRADICTS = 0.5  # of the weight: a reading this far off is not noise nor a slow motion


def checked_reading(force: ArrayLike, moment: ArrayLike | None) -> Vector:
    """Return a reading as a wrench (6,), N and N·m; SensorError if a number is not finite."""
    try:
        return one_wrench(force, moment)
    except ValueError as error:
        if "not finite" not in str(error):
            raise
        raise SensorError(
            f"the reading is no wrench: {error}. The simulation has diverged before this step; "
            "no displacement was requested and no pose was set. Go back to a state before it, "
            "with a smaller time step."
        ) from error


def checked_pose(R0: ArrayLike, p0: ArrayLike) -> tuple[Vector, Vector]:
    """Return a pose, axes as columns (3, 3) and point (3,), m; InvalidArgument if it is none."""
    axes, point = np.array(R0, dtype=float), np.array(p0, dtype=float)
    if axes.shape != (3, 3) or point.shape != (3,):
        raise InvalidArgument(
            f"R0 must have shape (3, 3) and p0 (3,), not {axes.shape} and {point.shape}"
        )
    if not (np.isfinite(axes).all() and np.isfinite(point).all()):
        raise InvalidArgument("R0 and p0 must be finite")
    # 1e-6 rad is a pose in single precision; the displacement is exact to the square of it.
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-6) or np.linalg.det(axes) < 0.0:
        raise InvalidArgument(
            "R0 must be a rotation: the undeformed interface frame's axes as columns, orthogonal "
            "and right-handed"
        )
    return axes, point


def from_world(force: Vector, moment: Vector, point: Vector, pose: tuple[Vector, Vector]) -> Vector:
    """Return a wrench (6,), N and N·m, about the interface point in the undeformed frame's axes.

    Force and moment (3,) act ON the component at a point (3,), m, where it is now, all in the
    world. `pose` is R0 (3, 3) of the undeformed frame, and p (3,), m, the interface point where it
    is now: F = R0^T f and M = R0^T (m + (point - p) x f).
    """
    axes, origin = pose
    x, y, z = (point - origin).tolist()
    fx, fy, fz = force.tolist()
    lever = np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
    turned = np.array([force, moment + lever]) @ axes  # rows times R0: R0^T of each
    return turned.reshape(6) + 0.0  # no negative zeros


def require_weight(
    force: ArrayLike, mass: float, gravity: ArrayLike = GRAVITY, axes: ArrayLike | None = None
) -> None:
    """Refuse a reading that a scene at rest contradicts: its component carries its weight.

    Parameters
    ----------
    force : array_like
        Shape (3,), N, on the component, in the undeformed interface frame, of a scene at rest that
        nothing else holds.
    mass : float
        Of all that hangs on the mount, kg.
    gravity : array_like
        Shape (3,), m/s^2, in the world.
    axes : array_like, optional
        R0, shape (3, 3); the world's axes if not given.

    Raises
    ------
    SensorError
        If the force along gravity is turned round, missing, or off by more than half the weight.
    """
    pull = float(mass) * np.asarray(gravity, dtype=float)
    weight = float(np.linalg.norm(pull))
    if weight == 0.0:
        return
    local = np.asarray(force, dtype=float)
    world = local if axes is None else np.asarray(axes, dtype=float) @ local
    along = float(world @ pull) / weight**2  # 1 is right
    if abs(along - 1.0) <= CONTRADICTS:
        return
    what = f"at rest {mass:.6g} kg weigh {weight:.6g} N, the reading has {along * weight:.6g} N"
    if abs(along + 1.0) <= CONTRADICTS:
        raise SensorError(
            f"the sign of the wrench is turned round: {what} along gravity. It must act ON the "
            "component; sensors report what the parent does to the child: see conventions "
            "(from_mujoco, from_pybullet, from_drake with component='parent')"
        )
    if abs(along) <= CONTRADICTS:
        raise SensorError(
            f"the reading does not carry the scene: {what} along gravity. A base with a free joint "
            "reads 0, and so does a sensor that was not evaluated; hang the system as a child "
            "without joint, and evaluate the sensors first"
        )
    raise SensorError(
        f"the reading contradicts the scene's weight: {what} along gravity. Look at the sensor's "
        "place and axes, at what else holds the scene, and at the units"
    )
