"""Rows within the limits of a table, and rows of the current setup.

A row beyond the limits has a wrong unit. Rows of different setups are never mixed: a solve with
another fingerprint, or with none, would be a solve of another mesh. The sender can change the
source.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np

from wrenchbook.service.formats.columns import Columns
from wrenchbook.service.formats.options import FEA, Array, Options, ParsedTable, Problem, ReadReport
from wrenchbook.surrogate.table.rows import (
    LONGEST,
    ROTATION_LIMIT,
    TRANSLATION_LIMIT,
    LoadRange,
    rotation_angles,
)
from wrenchbook.surrogate.table.space import PER_INTERFACE

# Largest load over the component's range: tests reach a few times the service load; newtons read as
# kilonewtons are larger.
LOAD_LIMIT = 10.0


def within_limits(piece: ParsedTable, options: Options, report: ReadReport) -> ParsedTable:
    """Return the rows within all limits; the others become mistakes."""
    good = check_limits(vars(piece), options, report)
    report.mistakes.trim()
    return piece.take(good)


def check_limits(columns: Mapping[str, Any], options: Options, report: ReadReport) -> Array:
    """Return which rows of a `ParsedTable`'s columns are within all limits, (n,); report others."""
    good = np.ones(len(columns["seq"]), dtype=bool)
    problems = chain(
        _excess_displacements(columns["displacement"], options.columns),
        _excess_uncertainties(columns["uncertainty"], options.columns),
        _excess_loads(columns["wrench"], options.load_range),
    )
    for at, name, message in problems:
        good[at] = False
        label = report.labels.get(name or "", name or "")
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


def _excess_displacements(displacement: Array, columns: Columns) -> Iterator[Problem]:
    """Yield the displacements (n, outputs), m and rad, beyond a limit."""
    is_rotation = columns.space.is_rotation
    for first in range(0, len(columns.displacement), PER_INTERFACE):
        moved = displacement[:, first : first + PER_INTERFACE]
        angle = rotation_angles(moved)
        for at in np.flatnonzero(angle > LONGEST).tolist():
            name = columns.displacement[first + 3 + int(np.nanargmax(np.abs(moved[at, 3:])))]
            message = (
                f"the rotation is {math.degrees(angle[at]):.4g} degrees, but a table ends at "
                f"{math.degrees(ROTATION_LIMIT):g}; check the unit (rad or deg)"
            )
            yield at, name, message
    too_far = (np.abs(displacement) > TRANSLATION_LIMIT) & ~is_rotation
    for at, output in np.argwhere(too_far).tolist():
        message = (
            f"the translation is {displacement[at, output]:.4g} m, but a table ends at "
            f"{TRANSLATION_LIMIT:g} m; check the unit (m or mm)"
        )
        yield at, columns.displacement[output], message


def _excess_uncertainties(uncertainty: Array, columns: Columns) -> Iterator[Problem]:
    """Yield the uncertainties (n, outputs), m and rad, beyond a limit."""
    if not any(uncertainty.strides):  # one value stands for all: no uncertainty is known
        return
    is_rotation = columns.space.is_rotation
    limit = np.where(is_rotation, LONGEST, TRANSLATION_LIMIT)
    # An infinite uncertainty is another mistake.
    beyond = np.isfinite(uncertainty) & (uncertainty > limit)
    for at, output in np.argwhere(beyond).tolist():
        unit, end = ("rad", ROTATION_LIMIT) if is_rotation[output] else ("m", TRANSLATION_LIMIT)
        message = (
            f"the uncertainty is {uncertainty[at, output]:.4g} {unit}, but no displacement of a "
            f"table exceeds {end:.4g} {unit}; check the unit, or leave it out if unknown"
        )
        yield at, columns.uncertainty[output], message


def _excess_loads(wrench: Array, load_range: LoadRange | None) -> Iterator[Problem]:
    """Yield the loads (n, inputs) beyond a limit."""
    if load_range is None:
        return
    limit = largest_loads(load_range)
    for at, load in np.argwhere(np.abs(wrench) > limit).tolist():
        column = load_range.space.inputs[load]
        unit = column.unit.replace("·", "*")
        kind = "input" if column.kind == "scalar" else "load"
        message = (
            f"the {kind} is {wrench[at, load]:.6g} {unit}, but the component's range is "
            f"{load_range.low[load]:g} to {load_range.high[load]:g} {unit} and its table ends at "
            f"{limit[load]:g}; check the unit and the column"
        )
        yield at, column.name, message


def of_current_setup(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows that a table of the setup `options.fingerprint` may hold."""
    setup = options.fingerprint
    for piece in pieces:
        is_solve = (piece.fingerprint != "") | (piece.source == FEA)
        if setup is None or not is_solve.any():
            yield piece
            continue
        good = np.ones(len(piece), dtype=bool)
        for at, name, message in _foreign_rows(piece, setup):
            good[at] = False
            report.mistakes.add(int(piece.seq[at]), name, message)
        yield piece.take(good)
        if report.is_beyond_limits():
            return


def _foreign_rows(piece: ParsedTable, setup: str) -> Iterator[Problem]:
    """Yield the rows that are solves of another setup, or incomplete solves."""
    pairs = zip(piece.fingerprint.tolist(), piece.source.tolist(), strict=True)
    for at, (fingerprint, source) in enumerate(pairs):
        if fingerprint != setup and (fingerprint or source == FEA):
            solved = f"the setup {fingerprint}" if fingerprint else "a setup without a name"
            message = (
                f"is a solve of {solved}, but this component has the setup {setup}. Leave the row "
                "out, or load it as a measured row, with an empty fingerprint and a source other "
                "than fea"
            )
            yield at, "fingerprint", message
        elif source == FEA and np.isnan(piece.displacement[at]).any():
            count = piece.displacement.shape[1]
            message = f"a solve must have all {count} outputs; write them, or change source"
            yield at, "source", message
