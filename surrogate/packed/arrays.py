"""The arrays of a packed table: name, type, shape and meaning, stated only in this module.

`check` compares written arrays with it. `python -m wrenchbook.surrogate.packed.arrays` writes
surrogate/kernel/wb_arrays.h from it, by which wb_open.c checks a file. Numbers are SI: N, N·m, m
and rad; scaled loads, flags and indices have no unit. n inputs and m outputs are data.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernel.format import PackedTableError

HEADER = Path(__file__).resolve().parents[1] / "kernel" / "wb_arrays.h"
TYPES = {"f8": np.float64, "i4": np.int32, "i8": np.int64, "u1": np.uint8}


class Array(NamedTuple):
    """One array: the last part of its name, its type, its shape in symbols, its meaning.

    `optional` arrays may be missing. `member` is the kernel's name of the array: the same name if
    empty; `-` for arrays that only Python reads.
    """

    name: str
    type: str
    shape: str
    meaning: str
    optional: bool = False
    member: str = ""


class Block(NamedTuple):
    """Arrays whose names begin alike.

    `names` is the pattern of the names' beginning, `struct` the kernel's struct of the block.
    """

    names: str
    struct: str
    arrays: tuple[Array, ...]


SYMBOLS = {
    "n": "inputs",
    "m": "outputs",
    "n1": "inputs and one, n + 1",
    "s": "rows of a kriging, padded to a multiple of 8 (WB_LANES)",
    "r": "rows that answer at their own wrench",
    "t": "of these those with a tangent",
    "b": "bounds of buckets: one more than buckets",
    "v": "triples of outputs whose length is limited",
    "k": "neighbourhoods of a kriging, or stretches of a cut",
    "e": "equations of a neighbourhood, padded to a multiple of 16 (WB_PANEL)",
    "d": "numbers of a lower triangle (e, e) in panels of 16 rows",
    "c": "terms of the covariances of all factors",
    "w": "numbers that s rows bring: p s, p of values, slopes and second derivatives",
    "i": "simplices of all axes one after another",
    "p": "points of all axes",
    "p1": "points and one",
    "f": "facets of all hulls",
    "g": "cells of all grids that walks start from",
    "u": "stations of a cut: k + 1, or none",
    "x": "any number",
}
OUTER = 3  # number of symbols that belong to the whole table; the others belong to a block
SHARED = 4  # the same with `s`, which the factors of a kriging share with the kriging

_BOUNDS = (
    Array("bucket", "f8", "2", "frame of buckets over ascending numbers: `buckets_of`"),
    Array("start", "i4", "b", "where each bucket begins among them, and the end"),
)

BLOCKS = {
    "space": Block("space/", "wb_table", (
        Array("sizes", "i4", "3", "n, m and the number of groups of outputs"),
        Array("range", "f8", "2 n", "ends of the load range", member="-"),
        Array("ends", "f8", "2 n", "the same with room for rounding"),
        Array("scale", "f8", "n", "of loads: half the range or the larger end"),
        Array("small", "f8", "n", "up to which a load counts as none"),
        Array("locked", "i4", "n", "which loads act on locked freedoms"),
        Array("tolerance", "f8", "m", "of the total error, NaN without"),
        Array("rig_error", "f8", "m", "hysteresis, drift and sessions of the measured rows", True),
        Array("limit", "f8", "m", "the largest displacement that tables hold"),
        Array("vector_first", "i4", "v", "first of three outputs whose length is limited"),
        Array("vector_limit", "f8", "v", "the largest such length"),
    )),
    "solver": Block("solver/", "wb_solver", (
        Array("flags", "i4", "5", "whether the discretisation error follows from an answer's "
              "tangent, it is known, the component is linear, its linearity error is known, all "
              "parts of the error are known"),
        Array("mesh", "f8", "m n", "its least by the loads: what the mesh lacks of the compliance"),
        Array("stiffness", "f8", "n m", "D, by which it follows from an answer's tangent"),
        Array("linearity", "f8", "m", "linearity error at the largest loads: its square term, or "
              "with `second` the cubic term"),
        Array("saturation", "f8", "m", "b, by which its powers become 1 at large loads, if one is "
              "not 0", True),
        Array("one_over", "f8", "n", "one over these loads"),
        Array("second", "f8", "m n n", "second derivatives that a linear answer lacks", True),
        Array("zero", "f8", "n", "from where inputs count, if one is not 0", True),
    )),
    "scene": Block("scene/", "wb_table", (
        Array("range", "f8", "2 n", "the loads of the scene that the table is cut to", member="-"),
        Array("ends", "f8", "2 n", "the same with room for rounding", member="scene_ends"),
        Array("varying", "i4", "n", "loads of more than one value", member="scene_varying"),
        Array("slopes", "i4", "n", "loads by which derivatives are known", member="scene_slopes"),
    )),
    "group": Block(r"g\d+/", "wb_group", (
        Array("flags", "i4", "4", "default method, whether the fit is exact, whether there are "
              "rows to answer from, whether rows lie in the load range"),
        Array("outputs", "i4", "m", "which outputs the group has"),
        Array("held", "i4", "m", "the same with those that a scene does not read", True),
        Array("allowed", "f8", "m", "the largest interpolation error of a covered answer"),
    )),
    "fit": Block(r"g\d+/fit/", "wb_fit", (
        Array("matrix", "f8", "m n", "the fitted compliance"),
        Array("bar", "f8", "m", "95 % error of its answers"),
        Array("offset", "f8", "m", "displacement at zero load, if one is not 0", True),
        Array("known", "i4", "n", "loads whose influence a row shows"),
        Array("rows", "i8", "x", "numbers of the rows that it comes from", member="-"),
    )),
    "row": Block(r"g\d+/row/", "wb_rows", (
        Array("key", "f8", "r", "weighted sum of the loads, ascending, by which rows are found"),
        *_BOUNDS,
        Array("rates", "f8", "n", "weights of that sum"),
        Array("steepest", "f8", "m", "the most that an output moves over half the range"),
        Array("number", "i4", "r", "index of the row in the table"),
        Array("seq", "i8", "r", "number of the row in the ledger"),
        Array("wrench", "f8", "r n", "where it was solved or measured"),
        Array("moved", "f8", "r m", "its displacement, NaN where not measured"),
        Array("bar", "f8", "r m", "its uncertainty, NaN where not known"),
        Array("tangent_of", "i4", "r", "index of its tangent, -1 without"),
        Array("tangent", "f8", "t m n", "tangents"),
        Array("source", "i4", "r", "number of its sources in the JSON block", member="-"),
    )),
    "axes": Block(r"g\d+/axes/", "wb_composition", (
        Array("simplex", "f8", "i 16", "wb_simplex: four vertices and four neighbours as 32-bit "
              "integers, slopes (3, 3) of all barycentric coordinates but the last, last vertex"),
        Array("degenerate", "u1", "i", "whether the simplex has no volume to speak of"),
        Array("vertex", "f8", "p 9", "wb_vertex: position, outputs"),
        Array("slopes", "f8", "p 6 3", "of the outputs at the points, by the scaled loads"),
        Array("facets", "i4", "f 4", "three vertices of a hull's facet and the simplex behind"),
        Array("point_first", "i4", "4", "first point of each axis, and the end"),
        Array("simplex_first", "i4", "4", "first simplex of each axis, and the end"),
        Array("facet_first", "i4", "4", "first facet of each axis, and the end"),
        Array("floats", "f8", "3 22", "wb_axis_floats: frames, see `axes_arrays`"),
        Array("ints", "i4", "3 5", "wb_axis_ints: dimension, -1 without rows; first cell; cells"),
        Array("grid", "i4", "g", "simplex close to each cell: where walks start"),
        Array("span", "f8", "3 3 2", "smallest and largest of an axis' loads", member="-"),
        Array("zero_load", "f8", "6", "answer at no load"),
        Array("member_first", "i4", "p1", "first of `members` of each point", member="-"),
        Array("members", "i8", "x", "numbers of the rows behind each point", member="-"),
    )),
    "cut": Block(r"g\d+/axes/cut[012][01]/", "wb_cut", (
        Array("state", "i4", "k", "WB_INSIDE, or WB_OFF_HULL where no simplex holds the stretch"),
        Array("stations", "f8", "u", "scaled moments between stretches, ascending"),
        Array("outputs", "f8", "k 2 6", "constant and straight part by the moment in a stretch"),
        *_BOUNDS,
    )),
    "kriging": Block(r"g\d+/kriging/", "wb_kriging", (
        Array("x", "f8", "n s", "scaled loads of the rows"),
        Array("terms", "f8", "c n1", "inverse squared lengths and weight of each term of each "
              "factor's covariance, the last of all loads", member="term"),
        Array("weights", "f8", "m w", "of the rows' values, slopes by one load after another and, "
              "where rows bring them, second derivatives by one pair after another"),
        Array("smoothness", "i4", "1", "of Matern smoothness + 1/2, where rows bring second "
              "derivatives; 3 without", True),
        Array("coefficients", "f8", "n1 m", "the mean"),
        Array("centre", "f8", "n", "of the scaled loads"),
        Array("rate", "f8", "n", "of the scaled loads, 0 for one that takes no part"),
        Array("offset", "f8", "m", "added to answers"),
        Array("spread", "f8", "m", "by which answers are multiplied"),
        Array("deviation", "f8", "m", "of the process"),
        Array("lost", "f8", "m", "what sums lose to rounding: no step of the inverse is better"),
        Array("floor", "f8", "m", "part of all error bars: nugget and rounding"),
        Array("tangent", "f8", "m n", "added to the derivative: by loads that take no part"),
        Array("span", "f8", "2 n", "scaled loads between which errors are known"),
        Array("together", "f8", "2", "the most that rows load besides one load, and besides one "
              "term, scaled: beyond it errors are not known"),
        Array("span_loads", "f8", "2 n", "the same in N and N·m", member="-"),
        Array("factor_count", "i4", "1", "number of factors"),
    )),
    "factor": Block(r"g\d+/kriging/factor\d+/", "wb_factor", (
        Array("outputs", "i4", "m", "outputs of the factor"),
        Array("number", "i4", "s", "neighbourhood of each row"),
        Array("equations", "i4", "k e", "where its equations stand among the w numbers"),
        Array("panels", "f8", "k d", "inverse factor T of each neighbourhood in panels of rows, "
              "columns first"),
        Array("trend", "f8", "k n1 e", "T times the mean's terms"),
        Array("min_variance", "f8", "s", "smallest sigma squared but for the mean's"),
        Array("penalty", "f8", "s", "0; infinite for a row without a neighbourhood"),
        Array("mean_covariance", "f8", "n1 n1", "of the mean's coefficients"),
        Array("scale", "f8", "m", "by which sigma is multiplied for a 95 % error"),
        Array("max_sigma", "f8", "1", "largest sigma with known errors"),
    )),
}  # fmt: skip


def block_of(arrays: Mapping[str, NDArray[Any]], start: str) -> dict[str, NDArray[Any]]:
    """Return the arrays whose names begin with `start`, by the rest of their names."""
    return {name[len(start) :]: array for name, array in arrays.items() if name.startswith(start)}


def named(start: str, block: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a block by their complete names: the inverse of `block_of`."""
    return {start + name: array for name, array in block.items()}


def check(arrays: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    """Return the arrays of a packed table unchanged.

    Raises PackedTableError if one is missing or unknown, or has another type or shape than stated
    in this module.
    """
    if "space/sizes" not in arrays:
        raise PackedTableError("the array space/sizes is missing; build the table again")
    inputs, outputs, _ = arrays["space/sizes"].tolist()
    table = {"n": inputs, "m": outputs, "n1": inputs + 1}
    blocks: dict[str, set[str]] = {}
    for name in arrays:
        start, _, last = name.rpartition("/")
        blocks.setdefault(f"{start}/", set()).add(last)
    rows: dict[str, int] = {}
    for start, names in blocks.items():
        described = _described(start, names)
        sizes = dict(table)
        # In the order of names, so that the same array is named each time.
        for name in sorted(names):
            array = described[name]
            values = arrays[start + name]
            dimensions = array.shape.split()
            same = values.dtype == TYPES[array.type] and values.ndim == len(dimensions)
            for symbol, size in zip(dimensions, values.shape, strict=False):
                stated = int(symbol) if symbol.isdigit() else sizes.setdefault(symbol, size)
                same &= symbol == "x" or stated == size
            if not same:
                raise PackedTableError(
                    f"array {start}{name} is {values.dtype} of shape {values.shape}, not "
                    f"{array.type} of shape ({array.shape}); build the table again"
                )
        # Factors have as many rows as their kriging.
        kriging = re.sub(r"factor\d+/$", "", start)
        if "s" in sizes and rows.setdefault(kriging, sizes["s"]) != sizes["s"]:
            raise PackedTableError(
                f"{start} has {sizes['s']} rows, other blocks of {kriging} have {rows[kriging]}; "
                "build the table again"
            )
    return arrays


def _described(start: str, names: set[str]) -> dict[str, Array]:
    """Return the descriptions of the arrays of the block `start` by their names.

    Raises PackedTableError if an array is missing or unknown.
    """
    described: dict[str, Array] = {}
    for block in BLOCKS.values():
        if re.fullmatch(block.names, start):
            described = {array.name: array for array in block.arrays}
            break
    lacking = {array.name for array in described.values() if not array.optional} - names
    unknown = names - set(described)
    if lacking:
        raise PackedTableError(f"{start} lacks {', '.join(sorted(lacking))}; build the table again")
    if unknown:
        listed = ", ".join(sorted(unknown))
        raise PackedTableError(f"{start} has unknown arrays: {listed}; build the table again")
    return described


def header() -> str:
    """Return wb_arrays.h: the kernel's members of each block, as tables for wb_open.c."""
    names = [f"WB_OF_{symbol.upper()}" for symbol in SYMBOLS if symbol != "x"]
    lines = [
        "/* The arrays of a packed table. Made by `python -m wrenchbook.surrogate.packed.arrays`;",
        " * surrogate/packed/arrays.py says what each is. MIT license. */",
        "#ifndef WB_ARRAYS_H",
        "#define WB_ARRAYS_H",
        '#include "wb_internal.h"',
        "/* Sizes: of the table, shared by the factors of a kriging, of one block. */",
        *textwrap.wrap(f"enum {{ {', '.join(names)}, WB_SIZES,", 99),
        f"    WB_BLOCK = {names[OUTER]}, WB_FACTOR = {names[SHARED]} }};",
        "typedef struct { /* each dimension is a size or, below zero, a number */",
        "    const char *name;",
        "    int type, optional, dimensions, shape[3];",
        "    size_t member;",
        "} wb_array;",
    ]
    for key, block in BLOCKS.items():
        lines.append(f"static const wb_array WB_{key.upper()}_ARRAYS[] = {{")
        for array in block.arrays:
            if array.member == "-":
                continue
            shape = [
                f"-{size}" if size.isdigit() else f"WB_OF_{size.upper()}"
                for size in array.shape.split()
            ]
            lines.append(
                f'    {{"{array.name}", WB_{array.type.upper()}, {int(array.optional)}, '
                f"{len(shape)}, {{{', '.join(shape)}}}, "
                f"offsetof({block.struct}, {array.member or array.name})}},"
            )
        lines[-1] += "};"
    return "\n".join([*lines, "#endif", ""])


if __name__ == "__main__":
    HEADER.write_text(header())
