"""A simulation's reading as the wrench contract wants it, and whether it can be that."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidArgument
from ..wrenches import one_wrench
from .errors import SensorError

Vector = NDArray[np.float64]

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, z up
CONTRADICTS = 0.5  # of the weight: a reading this far off is not noise nor a slow motion


def checked_reading(force: ArrayLike, moment: ArrayLike | None) -> Vector:
    """Return a reading as a wrench, shape (6,), N and N·m.

    Raises
    ------
    SensorError
        If a number is NaN or infinite.
    ValueError
        If a shape is wrong.
    """
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
    """Return an undeformed pose: axes as columns, shape (3, 3), and point, shape (3,), m.

    Raises
    ------
    ValueError
        If a shape is wrong, a number not finite, or the axes are no right-handed orthogonal ones.
    """
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
    """Return a wrench about the interface point where it is now, in the undeformed frame's axes.

    Parameters
    ----------
    force, moment : numpy.ndarray
        Shape (3,), N and N·m, acting ON the component, in the world's axes, about `point`.
    point : numpy.ndarray
        Shape (3,), m: where the sensor is now, on the deformed component, in the world.
    pose : tuple of numpy.ndarray
        R0, shape (3, 3), the undeformed frame's axes, and p, shape (3,), m, the interface point
        where it is now.

    Returns
    -------
    numpy.ndarray
        Shape (6,), N and N·m: F = R0^T f and M = R0^T (m + (point - p) x f).
    """
    axes, origin = pose
    x, y, z = (point - origin).tolist()
    fx, fy, fz = force.tolist()
    lever = np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
    turned = np.array([force, moment + lever]) @ axes  # rows times R0: R0^T of each
    return turned.reshape(6) + 0.0  # no negative zeros


def require_weight(
    force: ArrayLike, mass: float, gravity: ArrayLike = GRAVITY, axes: Any = None
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
    found = np.asarray(force, dtype=float)
    world = found if axes is None else np.asarray(axes, dtype=float) @ found
    along = float(world @ pull) / weight**2  # 1 is right
    if not abs(along - 1.0) <= CONTRADICTS:
        raise SensorError(_contradiction(along, mass, weight))


def _contradiction(along: float, mass: float, weight: float) -> str:
    """Say what a reading of `along` times the weight, N, of a mass, kg, means."""
    what = f"at rest {mass:.6g} kg weigh {weight:.6g} N, the reading has {along * weight:.6g} N"
    if abs(along + 1.0) <= CONTRADICTS:
        return (
            f"the sign of the wrench is turned round: {what} along gravity. It must act ON the "
            "component; sensors report what the parent does to the child: see conventions "
            "(from_mujoco, from_pybullet, from_drake with component='parent')"
        )
    if abs(along) <= CONTRADICTS:
        return (
            f"the reading does not carry the scene: {what} along gravity. A base with a free joint "
            "reads 0, and so does a sensor that was not evaluated; hang the system as a child "
            "without joint, and evaluate the sensors first"
        )
    return (
        f"the reading contradicts the scene's weight: {what} along gravity. Look at the sensor's "
        "place and axes, at what else holds the scene, and at the units"
    )
