"""Temperatures that differ from place to place, from a file of points.

A thermal analysis gives temperatures at points. Their rise over the reference, as a part of the
largest, is the shape of the field; the input is the temperature where the rise is the largest.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import KDTree, QhullError

from wrenchbook.fea.spec.problems import BundleError, BundleProblem

Array = np.ndarray

_COLUMNS = 4  # x, y, z, m, and the temperature
_SAME = 1e-6  # of the mesh's size: a node so near to a point of the file has its temperature
_KEY = "inputs.temperature.field"


def shape_on(nodes: Array, field: Path, reference: float) -> Array:
    """Return the rise of the temperature at nodes as a part of the largest, shape (n,).

    A node at a point of the file has its rise, others that of linear interpolation between points,
    or of the nearest point outside of them.

    Parameters
    ----------
    nodes
        Shape (n, 3), m.
    field
        A CSV file with one line of names, then x, y, z (m, in the mesh's axes) and the temperature.
    reference
        The temperature without strain, in the unit of the file's.

    Raises
    ------
    BundleError
        If the file has not four finite numbers a line, or nothing is heated.
    """
    try:
        table = np.loadtxt(field, delimiter=",", skiprows=1, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise _wrong(f"cannot be read: {error}") from None
    if table.shape[1:] != (_COLUMNS,) or not table.size or not np.isfinite(table).all():
        raise _wrong("must have four finite numbers a line: x, y, z (m) and the temperature")
    points, rise = table[:, :3], table[:, 3] - reference
    most = float(rise[np.abs(rise).argmax()])
    if most == 0.0:
        raise _wrong("is at the reference everywhere: nothing is heated")
    return _interpolated(points, rise / most, nodes)


def _interpolated(points: Array, values: Array, nodes: Array) -> Array:
    distance, nearest = KDTree(points).query(nodes)
    found = values[nearest]
    between = distance > _SAME * np.ptp(nodes, axis=0).max()
    if between.any():
        try:
            inside = LinearNDInterpolator(points, values)(nodes[between])
        except QhullError:  # fewer than five points, or all in one plane
            return found
        found[between] = np.where(np.isnan(inside), found[between], inside)
    return found


def _wrong(message: str) -> BundleError:
    return BundleError([BundleProblem(_KEY, message)])
