"""Reading three directions: of the interface, or of a material."""

from __future__ import annotations

import math

import numpy as np

from wrenchbook.fea.spec.toml_table import Keys


def read_axes(keys: Keys) -> np.ndarray | None:
    """Return ``axes`` exactly orthonormal, shape (3, 3), dimensionless; by default the mesh's."""
    rows = keys.raw("axes", list, required=False)
    if rows is None:
        return np.eye(3)
    if len(rows) != 3:
        keys.wrong("axes", "must be three directions, the frame's x, y and z")
        return None
    read = [keys.as_numbers(f"axes[{i}]", row, 3, "no unit") for i, row in enumerate(rows)]
    if None in read:
        return None
    axes = np.array(read)
    # A direction that is far from a unit's length would overflow in the product.
    if np.abs(axes).max() > 2.0 or np.abs(axes @ axes.T - np.eye(3)).max() > 1e-6:
        keys.wrong("axes", "must be three unit directions square to each other (to 1e-6)")
    elif np.linalg.det(axes) < 0.0:
        keys.wrong("axes", "must be right-handed; turn one direction round")
    else:
        return _orthonormal(axes.tolist())
    return None


def _orthonormal(axes: list[list[float]]) -> np.ndarray:
    """Return directions written to a few digits as an exact frame with the same x.

    In plain floats: the digits go into the fingerprint, so they must not depend on a machine's
    linear algebra library.
    """
    x = _unit(axes[0])
    z = _unit(_cross(x, axes[1]))
    return np.array([x, _unit(_cross(z, x)), z])


def _unit(v: list[float]) -> list[float]:
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return [each / length for each in v]


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]
