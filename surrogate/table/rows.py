"""The input of a surrogate: rows, the load range they are scaled by, and a tolerance.

All quantities are SI: N, N·m, m, rad. A wrench holds the n inputs of a `Space` and a displacement
its m outputs: of the default space six numbers, force then moment, translation then rotation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .space import DEFAULT, Floats, Space

# Parts of the range, for each load. The C kernel has the same numbers in wb_internal.h.
# A smaller load counts as zero; a load this little beyond an end counts as on it (rounding).
ZERO_LOAD = 1e-9
NEAR = 1e-6  # wrenches within this distance are the same wrench
ROUNDING = 1e-12  # part of a number's size: rounding of its computation; no error bar is smaller
SOLVED = "fea"  # the source of a row from a solver
# Error bar of an output that is always zero, m and rad: its square is a normal number.
SMALLEST = 1e-30

# Limits of every displacement of a row and of an estimate. An estimate beyond the rows is
# extrapolated linearly, so it may be any number; beyond these limits the small-deformation contract
# does not hold.

ROTATION_LIMIT = math.radians(20.0)
"""Longest rotation vector a table may hold, rad: beyond it the small-deformation contract ends."""

TRANSLATION_LIMIT = 10.0
"""Largest translation a table may hold, m.

A cantilever's tip moves by 2/3 of its length times its rotation (u = P L^3 / 3EI, r = P L^2 / 2EI),
so within 20 degrees a part has to be 43 m long to move by 10 m: no part of a machine is refused. A
wrong unit is noticed: millimetres read as metres from 10 mm on, micrometres from 10 um on.
"""

LONGEST = ROTATION_LIMIT * (1.0 + ROUNDING)
"""rad: rounding of a conversion from degrees must not refuse exactly 20 degrees."""


class RowError(ValueError):
    """A row, a load range or a tolerance that cannot be used; the message has place and cause."""


@dataclass(frozen=True, eq=False)
class LoadRange:
    """The expected loads of a component.

    Raises RowError if a bound is not finite or `low` exceeds `high`.
    """

    # low, high: (n,), N and N·m: smallest and largest value of each load
    low: Floats
    high: Floats
    space: Space = DEFAULT

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            bound = np.array(getattr(self, name), dtype=float)
            count = len(self.space.inputs)
            if bound.shape != (count,):
                raise RowError(
                    f"load range: {name} needs {count} numbers, one for each input, not an array "
                    f"of shape {bound.shape}"
                )
            if not np.isfinite(bound).all():
                at = int(np.argmin(np.isfinite(bound)))
                load = self.space.input_names[at]
                raise RowError(f"load range: {name} of {load} must be finite, not {bound[at]}")
            object.__setattr__(self, name, bound)
        if (self.low > self.high).any():
            at = int(np.argmax(self.low > self.high))
            ends = f"its high end, {self.low[at]:g} > {self.high[at]:g}; swap the two"
            load = self.space.input_names[at]
            raise RowError(f"load range: the low end of {load} must not be above {ends}")

    @property
    def largest(self) -> Floats:
        """The size of each load at its larger end, shape (n,), N and N·m."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    @cached_property
    def scale(self) -> Floats:
        """Half the width of each load's range, shape (6,), N and N·m.

        A load fixed at one value is scaled by that value, one fixed at zero by 1: a scale is never
        zero.
        """
        half = (self.high - self.low) / 2
        # read-only, since the cached array is shared
        array = np.where(half > 0, half, np.where(self.largest > 0, self.largest, 1.0))
        array.flags.writeable = False
        return array

    @cached_property
    def ends(self) -> Floats:
        """The ends of the range, extended to zero load and by rounding, (2, n)."""
        slack = ZERO_LOAD * self.scale
        zero = self.space.zero
        return np.stack((np.minimum(self.low, zero) - slack, np.maximum(self.high, zero) + slack))

    def exceeded(self, wrenches: ArrayLike) -> NDArray[np.bool_]:
        """Return which loads of wrenches, shape (n, 6), N and N·m, are out of range, (n, 6).

        The range is extended to zero load, the origin of every answer. A load beyond an end by up
        to 1e-9 of the range counts as on it.
        """
        loads, (low, high) = np.asarray(wrenches, dtype=float), self.ends
        return (loads < low) | (loads > high)

    def holds(self, wrenches: ArrayLike) -> NDArray[np.bool_]:
        """Return which wrenches, shape (n, 6), N and N·m, lie within the range, shape (n,)."""
        return np.asarray(~self.exceeded(wrenches).any(axis=-1))


def acting(wrenches: ArrayLike, locked: Sequence[int]) -> Floats:
    """Return wrenches, shape (..., 6), N and N·m, with the loads on locked freedoms set to zero.

    A guide carries these loads, so no displacement depends on them.

    `locked`: indices, in `LOADS`, of the loads on locked freedoms.
    """
    if not len(locked):
        return np.asarray(wrenches, dtype=float)
    copy = np.array(wrenches, dtype=float)
    copy[..., list(locked)] = 0.0
    return copy


def acting_wrench(wrench: Sequence[float], locked: Sequence[int]) -> Sequence[float]:
    """Return `acting` for one wrench (6,), N and N·m, without an array, which is faster."""
    if not locked:
        return wrench
    return [0.0 if load in locked else amount for load, amount in enumerate(wrench)]


@dataclass(frozen=True)
class Tolerance:
    """The largest error bar of a `covered` answer."""

    translation: float  # m
    rotation: float  # rad

    def __post_init__(self) -> None:
        for name, limit, unit in (
            ("translation", self.translation, "m"),
            ("rotation", self.rotation, "rad"),
        ):
            if not limit > 0:
                raise RowError(f"tolerance: {name} must be above 0 {unit}, not {limit:g}")


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of a table as columns.

    Raises RowError if the columns differ in length, a wrench is not finite, a displacement infinite
    or all NaN, or a curvature partly known or infinite.
    """

    seq: NDArray[np.int64]  # (n,): the ledger's number of each row, its id in all modules
    wrench: Floats  # (n, 6), N and N·m
    # (n, 6), m and rad: NaN where an output was not measured; each row holds at least one
    displacement: Floats
    # (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m): tangent d(displacement)/d(wrench) at the row; NaN
    # where unknown
    compliance: Floats
    # (n, p), or (n, 0) where no row brings any: third derivatives of the complementary energy by
    # the loads (F, mu), m or rad over two of their units. They are in the order of
    # `combinations_with_replacement(range(inputs), 3)`, `Space.curvatures` of them; NaN in rows
    # without them.
    curvature: Floats
    # (n, 6), m and rad: 95 % half width of the row's own values; NaN or 0 where unknown
    uncertainty: Floats
    source: NDArray[np.str_]  # (n,)
    fingerprint: NDArray[np.str_]  # (n,)
    space: Space = DEFAULT
    # (n,): when the rows arrived, s since the epoch, the same for all rows of an import; 0 where
    # unknown
    session: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if not self.session.size:
            object.__setattr__(self, "session", np.zeros(len(self.seq)))
        n = len(self.seq)
        inputs = len(self.space.inputs)
        outputs = len(self.space.outputs)
        absent = np.isnan(self.curvature)
        if absent.all():
            object.__setattr__(self, "curvature", np.empty((n, 0)))
        shapes = {
            "wrench": (n, inputs),
            "displacement": (n, outputs),
            "compliance": (n, outputs, inputs),
            "curvature": (n, 0 if absent.all() else self.space.curvatures),
            "uncertainty": (n, outputs),
            "source": (n,),
            "fingerprint": (n,),
            "session": (n,),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise RowError(
                    f"rows: {name} has shape {np.shape(getattr(self, name))}, not {shape}"
                )
        broken = ~np.isfinite(self.curvature).all(axis=1) & ~absent.all(axis=1)
        if broken.any():
            row = int(np.argmax(broken))
            finite = int(np.isfinite(self.curvature[row]).sum())
            raise RowError(
                f"row {self.seq[row]}: curvature must be {absent.shape[1]} finite numbers, or all "
                f"NaN; {finite} of them are finite"
            )
        unmeasured = np.isnan(self.displacement)
        self._refuse(~np.isfinite(self.wrench), self.wrench, self.space.input_names)
        self._refuse(np.isinf(self.displacement), self.displacement, self.space.output_names)
        if unmeasured.all(axis=1).any():
            row = int(np.argmax(unmeasured.all(axis=1)))
            raise RowError(f"row {self.seq[row]}: no displacement is finite; leave the row out")

    def _refuse(self, wrong: NDArray[np.bool_], values: Floats, names: tuple[str, ...]) -> None:
        """Raise RowError for the first wrong entry.

        `values` and `wrong` have shape (n, k), `names` (k,).
        """
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            value = values[row, column]
            raise RowError(
                f"row {self.seq[row]}: {names[column]} must be finite, not {value}; correct it, or "
                "leave the row out"
            )

    @property
    def has_tangent(self) -> NDArray[np.bool_]:
        """Which rows have a complete tangent, shape (n,)."""
        return np.asarray(np.isfinite(self.compliance).all(axis=(1, 2)))

    @property
    def is_solved(self) -> NDArray[np.bool_]:
        """Which rows are solves, whose displacements repeat exactly, shape (n,)."""
        return np.asarray(self.source == SOLVED)

    @property
    def partial(self) -> bool:
        """Whether some row lacks an output."""
        return bool(np.isnan(self.displacement).any())

    def __len__(self) -> int:
        return len(self.seq)

    def __add__(self, other: Rows) -> Rows:
        """Return the rows of both, in this order."""
        return joined((self, other))

    def take(self, which: ArrayLike) -> Rows:
        """Return the rows that an index array or a mask of shape (n,) picks."""
        index = np.asarray(which)
        count = int(index.sum()) if index.dtype == bool else len(index)
        columns: dict[str, NDArray[Any]] = {}
        for name in _COLUMNS:
            column = getattr(self, name)
            # A column of NaN takes no memory, so its part must not either.
            unknown = is_unknown(column)
            columns[name] = unknown_column(count, *column.shape[1:]) if unknown else column[index]
        return Rows(**columns, space=self.space)

    @classmethod
    def empty(cls, space: Space = DEFAULT) -> Rows:
        """Return a table of no rows."""
        return cls.of((), (), space)

    @classmethod
    def of(
        cls, wrench: ArrayLike, displacement: ArrayLike, space: Space = DEFAULT, **columns: Any
    ) -> Rows:
        """Return rows of wrenches (n, 6) and displacements (n, 6); other columns are optional.

        Wrenches are in N and N·m, displacements in m and rad.

        Without `seq` the rows are numbered from 1; unknown numbers are NaN, unknown words empty.
        """
        inputs, outputs = len(space.inputs), len(space.outputs)
        wrenches = np.array(wrench, dtype=float).reshape(-1, inputs)
        n = len(wrenches)
        unknown: dict[str, tuple[Any, Any]] = {
            "seq": (np.arange(1, n + 1), np.int64),
            "compliance": (unknown_column(n, outputs, inputs), float),
            "curvature": (np.empty((n, 0)), float),
            "uncertainty": (unknown_column(n, outputs), float),
            "source": (np.full(n, ""), str),
            "fingerprint": (np.full(n, ""), str),
            "session": (np.zeros(n), float),
        }
        filled = {
            name: np.array(columns[name]).astype(kind, copy=False) if name in columns else blank
            for name, (blank, kind) in unknown.items()
        }
        moved = np.array(displacement, dtype=float).reshape(-1, outputs)
        return cls(wrench=wrenches, displacement=moved, space=space, **filled)


def rotation_angles(displacements: Floats) -> Floats:
    """Return the rotation angles of displacements (n, 6), m and rad: (n,), rad; NaN counts as 0."""
    with np.errstate(over="ignore"):
        return np.sqrt(np.nansum(displacements[:, 3:] ** 2, axis=1))


_COLUMNS = tuple(column.name for column in fields(Rows) if column.name != "space")


def unknown_column(count: int, *shape: int) -> Floats:
    """Return a column of NaN, read-only, that takes no memory for any number of rows.

    Shape (count, *shape); it stands for values in SI.
    """
    return np.broadcast_to(np.nan, (count, *shape))


def is_unknown(column: NDArray[Any]) -> bool:
    """Return whether a column is one of `unknown_column`."""
    is_one_number = column.ndim > 1 and not any(column.strides) and column.size > 0
    return is_one_number and bool(np.isnan(column.flat[0]))


def joined(parts: Sequence[Rows]) -> Rows:
    """Return the rows of several tables in this order.

    Raises RowError if there is no table, or if tables with rows differ in inputs or outputs.
    """
    if not parts:
        raise RowError("joined rows need at least one table; give an empty one for no rows")
    filled = [part for part in parts if len(part)]
    names = [(part.space.input_names, part.space.output_names) for part in filled]
    for other in names[1:]:
        if other != names[0]:
            raise RowError(
                f"rows of inputs and outputs {other} cannot be joined with rows of {names[0]}; "
                "join only tables of the same inputs and outputs"
            )
    if len(filled) < 2:
        return filled[0] if filled else parts[0]
    merged: dict[str, NDArray[Any]] = {}
    for name in _COLUMNS:
        columns = [getattr(part, name) for part in filled]
        # NaN fills the curvature, (n, p), of tables without one, (n, 0).
        width = max(column.shape[1:] for column in columns)
        if all(map(is_unknown, columns)):
            merged[name] = unknown_column(sum(map(len, columns)), *width)
            continue
        merged[name] = np.concatenate(
            [
                column if column.shape[1:] == width else unknown_column(len(column), *width)
                for column in columns
            ]
        )
    return Rows(**merged, space=filled[0].space)


def nulls(values: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON, which has no NaN: None in its place."""
    return [None if math.isnan(value) else value for value in values]


def why_beyond(load_range: LoadRange, wrench: Floats) -> str:
    """Return a text on the loads of a wrench (6,), N and N·m, that lie outside the load range."""
    sentences = []
    for load in np.flatnonzero(load_range.exceeded(wrench)).tolist():
        low, high = load_range.low[load], load_range.high[load]
        name, unit = load_range.space.inputs[load].name, load_range.space.inputs[load].unit
        amount = f"{name} = {wrench[load]:.10g} {unit}"
        sentences.append(f"{amount} is outside the load range, {low:.6g}..{high:.6g} {unit}")
    return "; ".join(sentences)
