"""Rows of a table file as SI arrays, and the checks of whole rows: limits, setups.

No row may exceed the limits: such rotations, translations and loads are mistakes of a unit.

Rows of different setups are never mixed. A row with the component's own fingerprint is loaded with
its source and its tangent, so an export of solves comes back as solves. A row with another
fingerprint, or with the source `fea` and no fingerprint, is refused: loaded as measured it would be
a solve of another mesh. The sender can change the source in the file. A row without a fingerprint
is a measurement or a solve from elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.surrogate.limits import (
    ROTATION_LIMIT,
    TRANSLATION_LIMIT,
    is_too_far,
    rotation_angles,
)
from wrenchbook.surrogate.table.rows import LoadRange, Rows, unknown_column
from wrenchbook.surrogate.table.space import PER_INTERFACE

Array = np.ndarray
Problem = tuple[int, str, str]
"""The index of a row in the arrays, its column, and what to do."""

LOAD_LIMIT = 10.0
"""Largest load over the component's range: tests reach a few times the service load; kN read as N,
or a shifted column, is off by more."""


FEA = "fea"  # the source of solves
MEASURED = "measured"  # the source of rows that name none


@dataclass(frozen=True)
class ParsedTable(Rows):
    """Rows of a table file; `seq` are places in the file as of `FileMistake.row`."""

    note: Sequence[str] = ()
    time: Array | None = None  # (n,), s; of logs that are joined by it

    def take(self, which: ArrayLike) -> ParsedTable:
        """Return the rows that an index array or a mask of shape (n,) picks."""
        return type(self)(**picked(vars(self), np.asarray(which)))


def picked(columns: Mapping[str, Any], which: Array) -> dict[str, Any]:
    """Return the columns of a `ParsedTable` for the rows of a mask, (n,), or of indices."""
    columns = dict(columns)
    if which.dtype != bool or not which.all():
        index = np.flatnonzero(which) if which.dtype == bool else which
        for name, column in columns.items():
            if isinstance(column, np.ndarray):
                is_unknown = column.ndim > 1 and not any(column.strides)
                shape = len(index), *column.shape[1:]
                columns[name] = unknown_column(*shape) if is_unknown else column[index]
        columns["note"] = [columns["note"][at] for at in index.tolist()]
    return columns


def number_word(count: int) -> str:
    """Return a number as a message has it: six, 12."""
    return "six" if count == PER_INTERFACE else str(count)


def is_corrected(options: Options) -> bool:
    """Return whether readings are joined or corrected: rows of the interface have limits."""
    return bool(options.zero_rows or options.rig or options.role != "table")


def good_rows(
    columns: Mapping[str, Any], good: Array, options: Options, report: ReadReport
) -> ParsedTable:
    """Return the rows of a mask, (n,), of the columns of a `ParsedTable`, within the limits.

    Readings that are to be corrected have no limits yet.
    """
    if not is_corrected(options):
        good = good & _within_limits(columns, options, report)
    report.mistakes.settle()
    return ParsedTable(**picked(columns, good))


def within_limits(piece: ParsedTable, options: Options, report: ReadReport) -> ParsedTable:
    """Return the rows within all limits; the others become mistakes."""
    good = _within_limits(vars(piece), options, report)
    report.mistakes.settle()
    return piece.take(good)


def _within_limits(columns: Mapping[str, Any], options: Options, report: ReadReport) -> Array:
    good = np.ones(len(columns["seq"]), dtype=bool)
    numbers = (columns[name] for name in ("wrench", "displacement", "uncertainty"))
    for at, name, message in _excesses(*numbers, options):
        good[at] = False
        label = report.label(name, options.columns)
        report.mistakes.add(int(columns["seq"][at]), label, message)
    return good


def largest_loads(load_range: LoadRange) -> Array:
    """Return the largest size of each input that a table may have, shape (n,), N and N·m.

    A load without a range of its own (0 to 0) has the largest of its kind: the cross-loads of a rig
    are a part of its main load. If all of a kind have none there is no limit.
    """
    kinds = np.array([load.kind for load in load_range.space.inputs])
    size = np.maximum(np.abs(load_range.low), np.abs(load_range.high))
    for kind in ("force", "moment"):
        size[(kinds == kind) & (size == 0.0)] = size[kinds == kind].max()
    return np.where(size > 0.0, LOAD_LIMIT * size, np.inf)


def _excesses(
    wrench: Array, displacement: Array, uncertainty: Array, options: Options
) -> Iterator[Problem]:
    """Yield the numbers beyond a limit."""
    columns = options.columns
    is_rotation = columns.space.is_rotation
    for first in range(0, len(columns.displacement), PER_INTERFACE):
        moved = displacement[:, first : first + PER_INTERFACE]
        angle = rotation_angles(moved)
        for at in np.flatnonzero(is_too_far(angle)).tolist():
            name = columns.displacement[first + 3 + int(np.nanargmax(np.abs(moved[at, 3:])))]
            message = (
                f"the rotation is {math.degrees(angle[at]):.4g} degrees; a table ends at 20 "
                "(check the unit: rad or deg?)"
            )
            yield at, name, message
    for at, axis in np.argwhere((np.abs(displacement) > TRANSLATION_LIMIT) & ~is_rotation).tolist():
        message = (
            f"the translation is {displacement[at, axis]:.4g} m; a table ends at "
            f"{TRANSLATION_LIMIT:g} m, because within 20 degrees only a part longer than 40 m "
            "moves so far (check the unit: m or mm?)"
        )
        yield at, columns.displacement[axis], message
    limit = np.where(is_rotation, ROTATION_LIMIT * (1.0 + 1e-12), TRANSLATION_LIMIT)
    known = any(uncertainty.strides)  # infinite ones are other mistakes
    beyond = np.isfinite(uncertainty) & (uncertainty > limit) if known else np.zeros((0, 0))
    for at, output in np.argwhere(beyond).tolist():
        unit, end = ("rad", ROTATION_LIMIT) if is_rotation[output] else ("m", TRANSLATION_LIMIT)
        message = (
            f"the uncertainty is {uncertainty[at, output]:.4g} {unit}; no displacement of a table "
            f"is beyond {end:.4g} {unit} (check the unit, or leave it out if it is not known)"
        )
        yield at, columns.uncertainty[output], message
    load_range = options.load_range
    if load_range is None:
        return
    limit = largest_loads(load_range)
    for at, load in np.argwhere(np.abs(wrench) > limit).tolist():
        column = load_range.space.inputs[load]
        unit, what = column.unit.replace("·", "*"), "input" if column.kind == "scalar" else "load"
        message = (
            f"the {what} is {wrench[at, load]:.6g} {unit}; the component's range is "
            f"{load_range.low[load]:g} to {load_range.high[load]:g} {unit}, and a table ends at "
            f"{limit[load]:g} (check the unit and the column)"
        )
        yield at, column.name, message


def with_own_setup(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows that a table of the setup `options.fingerprint` may hold."""
    own = options.fingerprint
    for piece in pieces:
        if own is None or not (piece.fingerprint.any() or (piece.source == FEA).any()):
            yield piece
            continue
        good = np.ones(len(piece), dtype=bool)
        for at, name, message in _foreign_rows(piece, own):
            good[at] = False
            report.mistakes.add(int(piece.seq[at]), name, message)
        yield piece.take(good)
        if report.is_beyond_limits():
            return


def _foreign_rows(piece: ParsedTable, own: str) -> Iterator[Problem]:
    """Yield the rows that are solves of another setup, or incomplete ones."""
    pairs = zip(piece.fingerprint.tolist(), piece.source.tolist(), strict=True)
    for at, (fingerprint, source) in enumerate(pairs):
        if fingerprint != own and (fingerprint or source == FEA):
            other = (
                f"the setup {fingerprint}" if fingerprint else "a setup that the row does not name"
            )
            message = (
                f"is a solve of {other}, this component's setup is {own}; rows "
                "of different setups are never mixed. Leave the row out, or load it as measured: "
                "an empty fingerprint and another source"
            )
            yield at, "fingerprint", message
        elif source == FEA and np.isnan(piece.displacement[at]).any():
            count = number_word(piece.displacement.shape[1])
            message = f"a solve knows all {count} outputs; write them, or another source than fea"
            yield at, "source", message
