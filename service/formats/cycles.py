"""Cycles of a test at an import: first ones left out, a branch, the mean by place or of cycles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from wrenchbook.service.formats.limits import LOAD_LIMIT, largest_loads
from wrenchbook.service.formats.options import FEA, Array, Options, ParsedTable, ReadReport
from wrenchbook.surrogate.findings.cycles import TURN, Passes, passes_of
from wrenchbook.surrogate.table.rows import joined
from wrenchbook.surrogate.table.space import Space

# Rows, all in memory: 0.4 GB of the child's 1 GB with their intermediate results.
MAX_CYCLE_ROWS = 1_000_000
_BLOCK = 65_536  # rows of a piece, as in a file
# Part of a load's range: repeated cycles of one load differ by less in the others, also with a
# cross-load sensor, and by less in the place of a pass of one row.
_REPEATED = 0.02
_FEW = 0.1  # part of the places: single rows may deviate


class _CycleError(ValueError):
    """The cycles of a file do not permit an option: its name, and a message with the remedy."""


def with_cycles(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows that the cycle options select, from all rows of a file in their order.

    The main load is the one with the largest range, relative to the component's. In this order: the
    first cycles are left out, the other branch is left out, the rows of a pass within one place are
    averaged, and the passes of a branch become their mean.
    """
    if not (options.skip_cycles or options.branch or options.thin or options.mean_cycles):
        yield from pieces
        return
    parts: list[ParsedTable] = []
    try:
        for piece in pieces:
            parts.append(piece)
            if report.read > MAX_CYCLE_ROWS:
                message = f"has more than {MAX_CYCLE_ROWS:,} rows, the limit of cycle options"
                raise _CycleError("file", f"{message}; send it in parts")
        if any(map(len, parts)) and not report.mistakes.is_ruined:
            rows = _retained_rows(_joined(parts), options, report)
            for start in range(0, len(rows), _BLOCK):
                yield rows.take(np.arange(start, min(start + _BLOCK, len(rows))))
    except _CycleError as error:
        report.mistakes.ruin(0, *error.args)


def _joined(parts: list[ParsedTable]) -> ParsedTable:
    note = [note for part in parts for note in part.note]
    return ParsedTable(**vars(joined(parts)) | {"note": note, "time": None})


def _retained_rows(rows: ParsedTable, options: Options, report: ReadReport) -> ParsedTable:
    """Return the rows that the cycle options select; `report` counts the others."""
    solved = (rows.source == FEA) | (rows.fingerprint != "")
    if any(rows.compliance.strides) or solved.any():
        first = f"solves, the first in row {rows.seq[solved][0]}" if solved.any() else "tangents"
        message = (
            f"has {first}, but skip_cycles, branch, thin and mean_cycles need measured rows; leave "
            "these options out"
        )
        raise _CycleError("file", message)

    loads = len(options.columns.loads)
    span = options.load_range
    size = np.abs(rows.wrench).max(axis=0) if span is None else largest_loads(span) / LOAD_LIMIT
    size = np.where(np.isfinite(size) & (size > 0), size, 1.0)  # of each input
    main = int(np.argmax(np.ptp(rows.wrench[:, :loads], axis=0) / size[:loads]))
    name = options.columns.wrench[main]
    load = rows.wrench[:, main]
    passes = all_passes = passes_of(load)

    omitted = report.omitted
    retained = _after_first_cycles(load, passes, options.skip_cycles, name)
    omitted["skipped"] = int((~retained).sum())
    if options.branch:
        retained &= (passes.loading == (options.branch == "loading")) & passes.sure
        omitted["branch"] = int((~retained).sum()) - omitted["skipped"]
        if not retained.any():
            message = f"the main load {name} has no {options.branch} branch; leave branch out"
            raise _CycleError("branch", message)
    rows, passes = rows.take(retained), passes.take(retained)

    count_before_means = len(rows)
    if options.thin is not None:
        rows, passes = _thinned(rows, passes, options.thin * size)
    if options.mean_cycles:
        count = int(passes.number[-1] - passes.number[0]) // 2 + 1
        if count < 2:
            after = f" after skip_cycles={options.skip_cycles}" if options.skip_cycles else ""
            message = f"needs two or more cycles of {name}, but there is only one{after}"
            raise _CycleError("mean_cycles", f"{message}; leave mean_cycles out")
        size[main] = np.ptp(load)
        begins = bool(passes.loading[0])
        first, other = (
            _branch_mean(rows, passes, loading, main, size) for loading in (begins, not begins)
        )
        # In the order of a measured cycle, which begins at the load of the test's first row: from
        # turning point to turning point, a loop and a drift of the readings would look alike.
        direction = _direction(load, all_passes) if len(other) else 0.0
        is_last = direction * (first.wrench[:, main] - load[0]) < 0
        rows = _joined([first.take(~is_last), other, first.take(is_last)])
    omitted["averaged"] = count_before_means - len(rows)
    return rows


def _after_first_cycles(load: Array, passes: Passes, count: int, name: str) -> NDArray[np.bool_]:
    """Return the mask, (n,), of the rows after the first `count` cycles of the main load, (n,)."""
    most = int(passes.number[-1]) // 2
    while most and not _is_after(load, passes, most).any():
        most -= 1
    if count > most:
        message = f"is {count}, but at most {most} cycles of the main load {name} can be left out"
        message = f"{message}; give at most {most}"
        if not most:
            message = f"the file has no cycle of {name} to leave out; leave out skip_cycles"
        raise _CycleError("skip_cycles", message)
    return _is_after(load, passes, count)


def _is_after(load: Array, passes: Passes, count: int) -> NDArray[np.bool_]:
    """Return whether a row is after the first `count` cycles of the main load, (n,)."""
    is_later = passes.number > 2 * count
    is_beyond = _direction(load, passes) * (load - load[0]) >= 0
    return (passes.number >= 2 * count) & (is_later | is_beyond | (count == 0))


def _direction(load: Array, passes: Passes) -> float:
    """Return the sign of the first pass of a test whose cycles end at the load of its first row.

    Such a test, to both sides, begins within its range; 0 for one that begins at an end of it.
    """
    margin = TURN * np.ptp(load)
    is_within = load.min() + margin < load[0] < load.max() - margin
    return float(np.sign(load[passes.number == 0][-1] - load[0])) if is_within else 0.0


def _thinned(rows: ParsedTable, passes: Passes, place: Array) -> tuple[ParsedTable, Passes]:
    """Return the mean of the rows of each pass within one place, as large as `place`, (inputs,)."""
    keys = np.column_stack((passes.number, passes.sure, np.rint(rows.wrench / place)))
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # order of the groups, as they were measured
    columns: dict[str, Array] = {}
    for name in ("wrench", "displacement", "uncertainty"):
        values = getattr(rows, name)
        known = np.isfinite(values)
        sums, counts = np.zeros((2, len(first), values.shape[1]))
        np.add.at(sums, group.ravel(), np.where(known, values, 0.0))
        np.add.at(counts, group.ravel(), known)
        columns[name] = (sums / np.where(counts > 0, counts, np.nan))[order]
    return replace(rows.take(first[order]), **columns), passes.take(first[order])


def _branch_mean(
    rows: ParsedTable, passes: Passes, loading: bool, main: int, size: Array
) -> ParsedTable:
    """Return the mean of the passes of a branch at the main loads of its widest pass.

    The 95 % half width of a mean is that of the scatter about it, which all loads share; a larger
    stated one stays. `size` is that of each input, (inputs,). Raises _CycleError if the passes
    differ in another load, or have no main load in common.
    """
    chosen = np.flatnonzero(passes.sure & (passes.loading == loading))
    number = passes.number[chosen]
    inputs = rows.wrench.shape[1]
    by_pass = [chosen[number == pass_number] for pass_number in np.unique(number)]
    if not by_pass:
        return rows.take(chosen[:0])
    widest = max(by_pass, key=lambda indices: np.ptp(rows.wrench[indices, main]))

    columns = np.hstack((rows.wrench, rows.displacement))
    # (passes, rows of the widest, inputs and outputs)
    reach = _REPEATED * size[main]
    values = np.stack([_interpolated(columns[at], columns[widest], main, reach) for at in by_pass])
    values[[at is widest for at in by_pass]] = columns[widest]
    counts = np.isfinite(values).sum(axis=0)
    if len(by_pass) > 1 and counts[:, main].max() < 2:
        branch, load = "loading" if loading else "unloading", rows.space.inputs[main]
        spread = np.ptp(rows.wrench[[at[0] for at in by_pass], main])
        message = (
            f"the {len(by_pass)} {branch} passes of {load.name} have no load in common: their "
            f"first rows differ by up to {spread:.4g} {load.unit}. Leave mean_cycles out"
        )
        raise _CycleError("mean_cycles", message)
    mean = np.nansum(values, axis=0) / np.where(counts > 0, counts, np.nan)
    _require_same_loads(values[:, :, :inputs], size, rows.space)

    # The half width of Student's t distribution.
    freedom = np.maximum(counts - 1, 0).sum(axis=0)[inputs:]
    squares = np.nansum((values - mean) ** 2, axis=(0, 1))[inputs:]
    scatter = np.sqrt(squares / np.where(freedom > 0, freedom, np.nan))
    half_width = stdtrit(np.maximum(freedom, 1), 0.975) * scatter
    half_width = half_width / np.sqrt(np.maximum(counts[:, inputs:], 1))
    return replace(
        rows.take(widest),
        wrench=mean[:, :inputs],
        displacement=mean[:, inputs:],
        uncertainty=np.fmax(half_width, rows.uncertainty[widest]),
    )


def _interpolated(columns: Array, at: Array, main: int, reach: float) -> Array:
    """Return the columns of a pass, (n, c), at the main loads of another, (m, c); NaN beyond.

    A pass of one row is at the nearest main load, if that is within `reach`.
    """
    values = np.full(at.shape, np.nan)
    if len(columns) == 1:
        distance = np.abs(at[:, main] - columns[0, main])
        nearest = distance.argmin()
        values[nearest] = columns[0] if distance[nearest] <= reach else np.nan
        return values
    columns = columns[np.argsort(columns[:, main], kind="stable")]
    for column in range(columns.shape[1]):
        known = columns[np.isfinite(columns[:, column])]
        if len(known):
            x, y = known[:, main], known[:, column]
            values[:, column] = np.interp(at[:, main], x, y, np.nan, np.nan)
    return values


def _require_same_loads(wrenches: Array, size: Array, space: Space) -> None:
    """Raise _CycleError if passes (passes, n, inputs) differ in a load besides the main one."""
    spread = np.nanmax(wrenches, axis=0) - np.nanmin(wrenches, axis=0)
    differing = (spread > _REPEATED * size).mean(axis=0)
    if (differing > _FEW).any():
        other = int(differing.argmax())
        load = space.inputs[other]
        message = (
            f"the cycles differ: {load.name} changes by up to {spread[:, other].max():.4g} "
            f"{load.unit} between them at the same main load. Leave mean_cycles out, or send the "
            "test of each load as a file of its own"
        )
        raise _CycleError("mean_cycles", message)
