"""Reader of a temperature field that varies over the part, from a CSV file of points.

A thermal analysis gives temperatures at points. Their rise over the reference, as a part of the
largest, is the shape of the field; the input is the temperature where the rise is the largest.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from wrenchbook.fea.spec.problems import BundleError, BundleProblem

_COLUMNS = 4  # x, y, z, m, and the temperature
# A name of the header and its unit in brackets, such as "x [m]".
_NAME = re.compile(r"\s*\"?\s*(?P<name>\w*)[^[(]*(?:[\[(]\s*(?P<unit>[^])]*?)\s*[\])])?")
_ENCODING = "utf-8-sig"  # spreadsheets write a mark of the encoding before the first name
# Part of the size: a node this near to a point has its temperature, and points this near to a plane
# or line lie in it. Files of six digits are rounded to this part.
_SAME_POINT = 1e-6
_MAX_QUOTED = 60  # characters of a line in a message
_KEY = "inputs.temperature.field"


def shape_on(nodes: np.ndarray, field: Path, reference: float) -> np.ndarray:
    """Return the rise of the temperature at nodes as a part of the largest, shape (n,).

    A node at a point of the file has its rise, others that of linear interpolation between points,
    or of the nearest point outside of them. Points of one plane or line are interpolated in it.

    nodes: shape (n, 3), m.
    field: a CSV file with one line of names, then x, y, z (m, in the mesh's axes) and the
    temperature.
    reference: the temperature without strain, in the file's unit of temperature.

    Raises BundleError if the file has a line without four finite numbers below the header, has two
    temperatures for a point, lies far from the part, or equals the reference everywhere.
    """
    table = _table(field)
    points = table[:, :3]
    rise = table[:, 3] - reference
    largest = float(rise[np.abs(rise).argmax()])
    if largest == 0.0:
        raise _wrong(
            f"equals reference, {reference:g}, everywhere, so it has no effect; correct one"
        )

    order = np.lexsort(points.T)
    ordered = points[order]
    repeated = (ordered[1:] == ordered[:-1]).all(axis=1)
    contradicts = repeated & (np.diff(rise[order]) != 0.0)
    if contradicts.any():
        x, y, z = ordered[1:][contradicts][0].tolist()
        raise _wrong(f"has the point ({x:g}, {y:g}, {z:g}) twice, with two temperatures; keep one")

    values = rise / largest
    distance, nearest = KDTree(points).query(nodes)
    shape = values[nearest]
    size = np.ptp(nodes, axis=0).max()
    if np.median(distance) > size:
        raise _wrong(
            f"its points are {np.median(distance):.3g} m from the part, which is {size:.3g} m "
            "long; write them in m, in the mesh's axes"
        )

    between = distance > _SAME_POINT * size
    if between.any() and not repeated.all():  # more than one point
        inside = _interpolate(points, values, nodes[between])
        shape[between] = np.where(np.isnan(inside), shape[between], inside)
    return shape


def _interpolate(points: np.ndarray, values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Interpolate values (p,) linearly in the space, plane or line of points (p, 3).

    The result has shape (n,) for nodes (n, 3); it is NaN outside the points.
    """
    centre = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - centre, full_matrices=False)
    axes = axes[sizes > _SAME_POINT * sizes[0]]
    known = (points - centre) @ axes.T
    wanted = (nodes - centre) @ axes.T
    if len(axes) == 1:
        order = np.argsort(known[:, 0])
        return np.interp(wanted[:, 0], known[order, 0], values[order], np.nan, np.nan)
    # Imported here, as it takes 20 ms of a solve's start.
    from scipy.interpolate import LinearNDInterpolator

    return np.asarray(LinearNDInterpolator(known, values)(wanted))


def _table(field: Path) -> np.ndarray:
    """Return x, y, z and temperature of each point, (p, 4); raise BundleError for a wrong file."""
    with field.open(encoding=_ENCODING, errors="replace") as file:
        header = file.readline().strip()
    columns = [match for name in header.split(",")[:3] if (match := _NAME.match(name))]
    if [column["name"].lower()[:1] for column in columns] != ["x", "y", "z"]:
        example = "such as x,y,z,temperature"
        begin = header[:_MAX_QUOTED]
        raise _wrong(f'must begin with a line of names, {example}, but begins with "{begin}"')
    if units := [column["unit"] for column in columns if column["unit"] not in (None, "m")]:
        raise _wrong(f"its first line has {units[0]} as the unit of a point; write x, y and z in m")
    try:
        table = np.loadtxt(field, delimiter=",", skiprows=1, ndmin=2, encoding=_ENCODING)
        is_complete = table.shape[1:] == (_COLUMNS,) and table.size and np.isfinite(table).all()
    except (ValueError, UnicodeDecodeError):
        table = np.empty(0)
        is_complete = False
    if not is_complete:
        with field.open(encoding=_ENCODING, errors="replace") as file:
            bad = ((n, line) for n, line in enumerate(file, 1) if n > 1 and _is_bad(line))
            number, line = next(bad, (0, ""))
        wrong = f'"{line.strip()[:_MAX_QUOTED]}" in line {number}' if number else "no such line"
        raise _wrong(f"must have four finite numbers a line, x, y, z (m) and T, but has {wrong}")
    return table


def _is_bad(line: str) -> bool:
    """Return whether a line, less its comment, has text other than four finite numbers."""
    text = line.partition("#")[0].strip()
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        return bool(text)
    return len(numbers) != _COLUMNS or not np.isfinite(numbers).all()


def _wrong(message: str) -> BundleError:
    return BundleError([BundleProblem(_KEY, message)])
