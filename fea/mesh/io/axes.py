"""Local axes of decks: coordinate systems, orientations, and nodes that are turned."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from wrenchbook.fea.mesh.io.abaqus import Keyword

Array = np.ndarray


def axes_through(origin: Array, first: Array, second: Array) -> Array:
    """Return right-handed axes in rows: 1 from `origin` to `first`, 2 towards `second`."""
    x = first - origin
    z = np.cross(x, second - origin)
    lengths = np.linalg.norm(x), np.linalg.norm(z)
    if not min(lengths) > 0 or not np.isfinite(lengths).all():
        raise ValueError("its three points are on one line")
    x, z = x / lengths[0], z / lengths[1]
    return np.array([x, np.cross(z, x), z])


def cartesian(kind: str, point: Array) -> Array:
    """Return a point by its coordinates in a system R, C or S, angles in degrees, shape (3,)."""
    radius, (a, b) = point[0], np.radians(point[1:])
    if kind == "C":
        return np.array([radius * np.cos(a), radius * np.sin(a), point[2]])
    if kind == "S":
        return radius * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])
    return point


def radial_axes(axis: Array, out: Array) -> Array:
    """Return the radial, circumferential and axial directions at a point off an axis, in rows."""
    around = np.cross(axis, out)
    return axes_through(np.zeros(3), np.cross(around, axis), around)


def orientation(keyword: Keyword) -> Array:
    """Return axes through points, turned by an angle about one of them, shape (9,).

    Of a cylinder a point and the direction of its axis, shape (6,).
    """
    system = keyword.options.get("SYSTEM", "RECTANGULAR").upper()
    kind = keyword.options.get("DEFINITION", "COORDINATES").upper()
    first, second, origin = keyword.numbers(0, 9).reshape(3, 3)
    number, angle = keyword.numbers(1, 2)
    if kind != "COORDINATES" or system not in ("RECTANGULAR", "CYLINDRICAL"):
        raise ValueError(f"{system} by {kind}; it may be RECTANGULAR or CYLINDRICAL")
    if system == "CYLINDRICAL":
        if angle:
            raise ValueError("a cylinder with an angle")
        return np.append(*_cylinder(keyword, first, second))
    axes = axes_through(origin, first, second)
    if angle:
        i, j = int(number) % 3, (int(number) + 1) % 3
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        axes[[i, j]] = cos * axes[i] + sin * axes[j], cos * axes[j] - sin * axes[i]
    return _turned(keyword, axes).ravel()


def transforms(keyword: Keyword, points: Array) -> tuple[Array, Array]:
    """Return the axes of a *TRANSFORM at points (k, 3), and others that do as well: (k, 3, 3).

    The others hold what is held along or across a cylinder's axis, and are the same everywhere.
    """
    kind = keyword.options.get("TYPE", "R").upper()
    first, second = keyword.numbers(0, 6).reshape(2, 3)
    if kind == "R":
        axes = _turned(keyword, axes_through(np.zeros(3), first, second))
        every = np.tile(axes, (len(points), 1, 1))
        return every, every
    if kind != "C":
        raise ValueError(f"type {kind}; it may be R or C")
    origin, axis = _cylinder(keyword, first, second)
    along = radial_axes(axis, np.eye(3)[np.abs(axis).argmin()])
    around = np.array([radial_axes(axis, point - origin) for point in points]).reshape(-1, 3, 3)
    return around, np.tile(along, (len(points), 1, 1))


def _cylinder(keyword: Keyword, first: Array, second: Array) -> tuple[Array, Array]:
    """Return a point of the axis through two points of a part, and its direction, (3,) each."""
    start, end = (np.array(keyword.frame.transformed(at.tolist())) for at in (first, second))
    if not (length := np.linalg.norm(end - start)) > 0:
        raise ValueError("the two points of its axis are the same")
    return start, (end - start) / length


def _turned(keyword: Keyword, axes: Array) -> Array:
    """Return axes of a part in the assembly."""
    frame = keyword.frame
    return axes @ np.array(frame.rotation).reshape(3, 3).T if frame.rotation else axes
