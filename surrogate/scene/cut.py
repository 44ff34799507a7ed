"""Cuts a packed table to a scene: the same answers at the scene's wrenches from a smaller file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..answer import METHODS, allowed_by
from ..kernel.binding import PackedTable
from ..kernel.format import GROUP_EXACT, GROUP_METHOD, SOLVER_BY_TANGENT, pieces
from ..packed.arrays import block_of, check, named
from ..packed.axes_arrays import CELLS, DIMENSION, FIRST_CELL, AxesArrays, buckets_of
from ..table.axes import AXES
from ..table.rows import Floats
from .plan import Mask, Need

Arrays = dict[str, NDArray[Any]]
GROUPS = 2  # entry of space/sizes: number of groups of outputs


def cut(table: PackedTable, need: Need, plan: Mapping[str, Any] | None = None) -> list[bytes]:
    """Return the packed file of a table cut to a scene, as pieces of bytes.

    It answers by the table's default method. Groups whose outputs the scene does not read are left
    out, and rows and axes whose loads cannot occur.

    `plan`: the scene plan that the file carries, JSON-able.
    """
    # The names of the groups' arrays begin with g0/, g1/ and so on.
    arrays = {name: array for name, array in table.arrays.items() if name[0] != "g"}
    outputs = list(need.outputs)
    # The solver's error needs all outputs, and their derivatives by all loads.
    needs_all = bool(table.arrays["solver/flags"][SOLVER_BY_TANGENT])
    read = [
        needs_all or bool(table.arrays[f"g{group}/outputs"][outputs].any())
        for group in range(len(table.meta["groups"]))
    ]
    # Without a group that is read the first stays, which states that nothing is measured.
    groups = np.flatnonzero(read).tolist() or [0]
    slopes = np.ones(table.inputs, dtype=bool)
    for number, group in enumerate(groups):
        uncut = block_of(table.arrays, f"g{group}/")
        group_arrays, has_slopes = _cut_group(uncut, need, needs_all)
        arrays |= named(f"g{number}/", group_arrays)
        slopes &= has_slopes

    ends = np.stack((need.span.low, need.span.high))
    sizes = table.arrays["space/sizes"].copy()
    sizes[GROUPS] = len(groups)
    locked = table.arrays["space/locked"].copy()
    locked[list(need.idle)] = 1
    arrays |= {
        "space/sizes": sizes,
        "space/locked": locked,
        "scene/range": ends,
        "scene/ends": ends + np.stack((-need.slack, need.slack)),
        "scene/varying": need.varying.astype(np.int32),
        "scene/slopes": slopes.astype(np.int32),
    }
    if need.tolerance is not None:
        arrays["space/tolerance"] = np.array(allowed_by(need.tolerance, need.span.space))
    meta = {
        **table.meta,
        "groups": [table.meta["groups"][group] for group in groups],
        "scene": {"outputs": need.output_names(), "plan": plan or {}},
    }
    return pieces(check(arrays), meta)


def _cut_group(group: Arrays, need: Need, needs_all: bool) -> tuple[Arrays, Mask]:
    """Return a group's arrays, and the loads (n,) whose derivatives it still has."""
    flags = group["flags"]
    method = METHODS[flags[GROUP_METHOD]]
    # Kriging, and a linear fit that is exact, have values and error bars without the axes.
    needs_axes = not (method == "kriging" or (method == "linear" and flags[GROUP_EXACT]))
    arrays = {name: array for name, array in group.items() if "/" not in name or name[:4] == "fit/"}
    is_read = np.isin(np.arange(len(group["outputs"])), need.outputs)
    if needs_all:
        arrays["held"] = group["outputs"]
    arrays["outputs"] = np.where(is_read, group["outputs"], 0).astype(np.int32)
    arrays |= named("row/", _cut_rows(block_of(group, "row/"), need))
    if need.tolerance is not None:
        arrays["allowed"] = np.array(allowed_by(need.tolerance, need.span.space))
    if "kriging/x" in group:
        arrays |= named("kriging/", _cut_kriging(block_of(group, "kriging/"), need, needs_all))
    slopes = np.ones(len(need.occurring), dtype=bool)
    if needs_axes and "axes/vertex" in group:
        loaded = np.array([need.occurring[list(axis.inputs)].any() for axis in AXES]) | needs_all
        arrays |= named("axes/", _cut_axes(block_of(group, "axes/"), loaded))
        for axis, is_loaded in zip(AXES, loaded, strict=True):
            slopes[list(axis.inputs)] &= is_loaded
    return arrays, slopes


def _cut_rows(rows: Arrays, need: Need) -> Arrays:
    """Return the rows whose loads can occur."""
    possible = ~(need.beyond(rows["wrench"]) & ~need.varying).any(axis=1)
    arrays = {name: rows[name] for name in ("rates", "steepest")}
    for name in ("key", "number", "seq", "wrench", "moved", "bar", "source"):
        arrays[name] = rows[name][possible]
    arrays["bucket"], arrays["start"] = buckets_of(arrays["key"])
    tangent = rows["tangent_of"][possible]
    known = tangent >= 0
    arrays["tangent"] = rows["tangent"][tangent[known]]
    arrays["tangent_of"] = np.where(known, np.cumsum(known) - 1, -1).astype(np.int32)
    return arrays


def _cut_kriging(kriging: Arrays, need: Need, needs_all: bool) -> Arrays:
    """Return a kriging with the factors of the outputs that are read, or of all if needed."""
    count = int(kriging["factor_count"][0])
    outputs = list(need.outputs)
    factors = [block_of(kriging, f"factor{number}/") for number in range(count)]
    used = [
        number
        for number, factor in enumerate(factors)
        if needs_all or factor["outputs"][outputs].any()
    ] or [0]
    terms = np.split(kriging["terms"], count)
    arrays = {name: array for name, array in kriging.items() if "/" not in name}
    arrays["factor_count"] = np.array([len(used)], dtype=np.int32)
    arrays["terms"] = np.concatenate([terms[number] for number in used])
    for new_number, number in enumerate(used):
        arrays |= named(f"factor{new_number}/", factors[number])
    return arrays


class _Selected(NamedTuple):
    """The entries of an array that belong to selected parts: axes, or points of axes.

    Part k has the entries first[k] to first[k + 1] of the array.
    """

    entries: Mask  # (n,): which entries are selected
    part: NDArray[np.intp]  # (s,): the part of each selected entry
    removed: NDArray[np.intp]  # (p,): number of entries before each part that are not selected
    first: NDArray[np.intp]  # (p + 1,): `first` of the selected entries; other parts are empty

    @classmethod
    def of(cls, first: NDArray[np.integer], parts: Mask) -> _Selected:
        """Select the entries of the `parts` (p,)."""
        counts = np.diff(first)
        entries = np.repeat(parts, counts)
        part = np.repeat(np.arange(len(parts)), counts)[entries]
        removed = np.cumsum(np.where(parts, 0, counts)) - np.where(parts, 0, counts)
        return cls(entries, part, removed, np.append(0, np.cumsum(counts * parts)))


def _cut_axes(block: Arrays, loaded: Mask) -> Arrays:
    """Return the axes that the scene loads; the triangulation of each stays complete."""
    axes = AxesArrays(**{name: block[name] for name in AxesArrays._fields})
    points, simplices, facets = (
        _Selected.of(first, loaded)
        for first in (axes.point_first, axes.simplex_first, axes.facet_first)
    )
    has_triangulation = axes.ints[:, DIMENSION] >= 0
    counts = np.where(has_triangulation, axes.ints[:, CELLS:].prod(axis=1), 0)
    cells = _Selected.of(np.append(0, np.cumsum(counts)), loaded)
    members = _Selected.of(axes.member_first, points.entries)

    corners = axes.facets[facets.entries]
    corners[:, :3] -= points.removed[facets.part, None].astype(np.int32)
    corners[:, 3] -= simplices.removed[facets.part].astype(np.int32)
    ints = axes.ints.copy()
    ints[:, FIRST_CELL] -= cells.removed.astype(np.int32)
    ints[~loaded], ints[~loaded, DIMENSION] = 0, -1
    remaining = axes._replace(
        simplex=_renumbered(axes, points, simplices),
        degenerate=axes.degenerate[simplices.entries],
        vertex=axes.vertex[points.entries],
        slopes=axes.slopes[points.entries],
        facets=corners,
        point_first=points.first,
        simplex_first=simplices.first,
        facet_first=facets.first,
        ints=ints,
        grid=axes.grid[cells.entries] - simplices.removed[cells.part],
        member_first=members.first[np.append(True, points.entries)],
        members=axes.members[members.entries],
    )
    arrays = {
        name: np.asarray(array, block[name].dtype) for name, array in remaining._asdict().items()
    }
    # cut{m}{side} is along moment m, of the axis (m - side - 1) % 3: a moment enters two axes.
    unloaded = np.flatnonzero(~loaded).tolist()
    removed = [f"cut{(axis + step) % 3}{step - 1}" for axis in unloaded for step in (1, 2)]
    cuts = {name: array for name, array in block.items() if "/" in name}
    return arrays | {name: cuts[name] for name in cuts if name.partition("/")[0] not in removed}


def _renumbered(axes: AxesArrays, points: _Selected, simplices: _Selected) -> Floats:
    """Return the selected simplices (s, 16) with new numbers of points and neighbours."""
    simplex_rows = axes.simplex[simplices.entries]
    axis = simplices.part
    ints = np.ascontiguousarray(simplex_rows[:, :4]).view(np.int32)
    corner = np.arange(4) <= axes.ints[axis, DIMENSION][:, None]
    ints[:, :4] -= np.where(corner, points.removed[axis, None], 0).astype(np.int32)
    inner = ints[:, 4:] >= 0
    ints[:, 4:] -= np.where(inner, simplices.removed[axis, None], 0).astype(np.int32)
    simplex_rows[:, :4] = ints.view(np.float64)
    return simplex_rows
