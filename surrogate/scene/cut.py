"""A packed table cut to a scene: the same numbers at the scene's wrenches, from a smaller file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..answer import METHODS, allowed_by
from ..kernel.binding import PackedTable
from ..kernel.format import pieces
from ..packed.arrays import check
from ..packed.axes_arrays import DIMENSION, FIRST_CELL, buckets_of
from ..table.axes import AXES
from ..table.rows import Floats
from .plan import Mask, Need

Arrays = dict[str, NDArray[Any]]

# Columns of the array ``flags`` of a group: see `packed.writer`.
_METHOD, _EXACT = 0, 1


def cut(table: PackedTable, need: Need, plan: Mapping[str, Any] | None = None) -> list[bytes]:
    """Return the packed file of a table cut to a scene, as pieces of bytes.

    It answers by the table's default method. Left out are groups whose outputs the scene does not
    read, and rows and axes whose loads cannot occur.

    `plan`: the scene plan that the file carries, JSON-able.
    """
    arrays = {name: array for name, array in table.arrays.items() if name[0] != "g"}
    outputs = list(need.outputs)
    # The solver's error needs all outputs, and their derivative by all loads.
    needs_all = bool(table.arrays["solver/flags"][0])
    read = [
        needs_all or bool(table.arrays[f"g{group}/outputs"][outputs].any())
        for group in range(len(table.meta["groups"]))
    ]
    groups = np.flatnonzero(read).tolist() or [0]  # the first one says that nothing is measured
    slopes = np.ones(table.inputs, dtype=bool)
    for number, group in enumerate(groups):
        prefix = f"g{group}/"
        group_arrays = {
            name.removeprefix(prefix): array
            for name, array in table.arrays.items()
            if name.startswith(prefix)
        }
        group_arrays = _cut_group(group_arrays, need, needs_all, slopes)
        arrays |= {f"g{number}/{name}": array for name, array in group_arrays.items()}
    arrays |= _scene_arrays(table, need, len(groups), slopes)
    meta = {
        **table.meta,
        "groups": [table.meta["groups"][group] for group in groups],
        "scene": {"outputs": need.output_names(), "plan": plan or {}},
    }
    return pieces(check(arrays), meta)


def _scene_arrays(table: PackedTable, need: Need, groups: int, slopes: Mask) -> Arrays:
    ends = np.stack((need.span.low, need.span.high))
    sizes = table.arrays["space/sizes"].copy()
    sizes[2] = groups
    locked = table.arrays["space/locked"].copy()
    locked[list(need.idle)] = 1
    arrays = {
        "space/sizes": sizes,
        "space/locked": locked,
        "scene/range": ends,
        "scene/ends": ends + np.stack((-need.slack, need.slack)),
        "scene/varying": need.varying.astype(np.int32),
        "scene/slopes": slopes.astype(np.int32),
    }
    if need.tolerance is not None:
        arrays["space/tolerance"] = np.array(allowed_by(need.tolerance, need.span.space))
    return arrays


def _cut_group(group: Arrays, need: Need, needs_all: bool, slopes: Mask) -> Arrays:
    """Return a group's arrays; in `slopes` (n,) the loads without derivatives are crossed out."""
    flags = group["flags"]
    method = METHODS[flags[_METHOD]]
    alone = method == "kriging" or (method == "linear" and flags[_EXACT])
    arrays = {name: array for name, array in group.items() if "/" not in name or name[:4] == "fit/"}
    is_read = np.isin(np.arange(len(group["outputs"])), need.outputs)
    if needs_all:
        arrays["held"] = group["outputs"]
    arrays["outputs"] = np.where(is_read, group["outputs"], 0).astype(np.int32)
    arrays |= _cut_rows(group, need)
    if need.tolerance is not None:
        arrays["allowed"] = np.array(allowed_by(need.tolerance, need.span.space))
    if "kriging/x" in group:
        arrays |= _cut_kriging(group, "kriging/", need, needs_all)
    if not alone and "axes/vertex" in group:
        loaded = np.array([need.occurring[list(axis.inputs)].any() for axis in AXES]) | needs_all
        arrays |= _cut_axes(group, loaded)
        for axis, stays in zip(AXES, loaded, strict=True):
            slopes[list(axis.inputs)] &= stays
    arrays["flags"] = flags
    return arrays


def _cut_rows(group: Arrays, need: Need) -> Arrays:
    """Return the rows whose loads can occur."""
    possible = ~(need.beyond(group["row/wrench"]) & ~need.varying).any(axis=1)
    arrays = {name: group[name] for name in ("row/rates", "row/steepest")}
    for name in ("key", "number", "seq", "wrench", "moved", "bar", "source"):
        arrays[f"row/{name}"] = group[f"row/{name}"][possible]
    arrays["row/bucket"], arrays["row/start"] = buckets_of(arrays["row/key"])
    tangent = group["row/tangent_of"][possible]
    known = tangent >= 0
    arrays["row/tangent"] = group["row/tangent"][tangent[known]]
    arrays["row/tangent_of"] = np.where(known, np.cumsum(known) - 1, -1).astype(np.int32)
    return arrays


def _cut_kriging(group: Arrays, name: str, need: Need, needs_all: bool) -> Arrays:
    """Return a kriging; unless all are needed, without factors of outputs that are not read."""
    arrays = {
        key: array for key, array in group.items() if key.startswith(name) and "/factor" not in key
    }
    count = int(group[f"{name}factor_count"][0])
    numbers = [
        number
        for number in range(count)
        if needs_all or group[f"{name}factor{number}/outputs"][list(need.outputs)].any()
    ] or [0]
    arrays[f"{name}factor_count"] = np.array([len(numbers)], dtype=np.int32)
    arrays[f"{name}terms"] = np.concatenate(
        [np.split(group[f"{name}terms"], count)[number] for number in numbers]
    )
    for number, before in enumerate(numbers):
        factor = f"{name}factor{before}/"
        arrays |= {
            f"{name}factor{number}/{key[len(factor) :]}": array
            for key, array in group.items()
            if key.startswith(factor)
        }
    return arrays


def _cut_axes(group: Arrays, loaded: Mask) -> Arrays:
    """Return the axes that the scene loads; the triangulation of each stays complete."""
    axes = {key[5:]: array for key, array in group.items() if key.startswith("axes/")}
    point, simplex = axes["point_first"], axes["simplex_first"]
    points, simplices = _selected(point, loaded), _selected(simplex, loaded)
    facets, cells = _selected(axes["facet_first"], loaded), _selected(_cells(axes), loaded)
    members = _selected(axes["member_first"], points)
    arrays = axes | {name: axes[name][points] for name in ("vertex", "slopes")}
    fewer_points, fewer_simplices = _fewer(point, loaded), _fewer(simplex, loaded)
    arrays["degenerate"] = axes["degenerate"][simplices]
    arrays["simplex"] = _renumbered(axes, simplices, fewer_points, fewer_simplices)
    corners = axes["facets"][facets]
    axis_of = np.repeat(np.arange(3), np.diff(axes["facet_first"]))[facets]
    corners[:, :3] -= fewer_points[axis_of, None]
    corners[:, 3] -= fewer_simplices[axis_of]
    cell_axis = np.repeat(np.arange(3), np.diff(_cells(axes)))[cells]
    arrays["facets"], arrays["grid"] = corners, axes["grid"][cells] - fewer_simplices[cell_axis]
    ints = axes["ints"].copy()
    ints[:, FIRST_CELL] -= _fewer(_cells(axes), loaded)
    ints[~loaded], ints[~loaded, DIMENSION] = 0, -1
    arrays["ints"] = ints
    for name in ("point_first", "simplex_first", "facet_first"):
        arrays[name] = _first(np.diff(axes[name]) * loaded)
    arrays["member_first"] = _first(np.diff(axes["member_first"])[points])
    arrays["members"] = axes["members"][members]
    for axis in np.flatnonzero(~loaded).tolist():
        for gone in (f"cut{(axis + 1) % 3}0/", f"cut{(axis + 2) % 3}1/"):
            arrays = {name: array for name, array in arrays.items() if not name.startswith(gone)}
    return {f"axes/{name}": np.asarray(array, axes[name].dtype) for name, array in arrays.items()}


def _renumbered(
    axes: Arrays, simplices: Mask, fewer_points: NDArray[Any], fewer_simplices: NDArray[Any]
) -> Floats:
    """Return the selected simplices (s, 16) with new numbers of points and neighbours."""
    axis_of = np.repeat(np.arange(3), np.diff(axes["simplex_first"]))[simplices]
    simplex_rows = axes["simplex"][simplices]
    ints = np.ascontiguousarray(simplex_rows[:, :4]).view(np.int32)
    dimension = axes["ints"][axis_of, DIMENSION]
    corner = np.arange(4) <= dimension[:, None]
    ints[:, :4] -= np.where(corner, fewer_points[axis_of, None], 0).astype(np.int32)
    inner = ints[:, 4:] >= 0
    ints[:, 4:] -= np.where(inner, fewer_simplices[axis_of, None], 0).astype(np.int32)
    simplex_rows[:, :4] = ints.view(np.float64)
    return simplex_rows


def _cells(axes: Arrays) -> NDArray[np.intp]:
    """Return where each axis' cells begin, and the end, shape (4,)."""
    has_triangulation = axes["ints"][:, DIMENSION] >= 0
    return _first(np.where(has_triangulation, axes["ints"][:, FIRST_CELL + 1 :].prod(axis=1), 0))


def _first(counts: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate(([0], np.cumsum(counts)))


def _selected(first: NDArray[Any], selected: Mask) -> Mask:
    """Return which entries belong to a selected part; part k has first[k] to first[k+1]."""
    return np.repeat(selected, np.diff(first))


def _fewer(first: NDArray[Any], selected: Mask) -> NDArray[Any]:
    """Return how many entries before each part are left out."""
    return _first(np.where(selected, 0, np.diff(first)))[:-1]
