"""Cycles of a test at an import: first ones left out, a branch, the mean by place or of cycles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from wrenchbook.service.formats.options import (
    FEA,
    LOAD_LIMIT,
    Array,
    Options,
    ParsedTable,
    ReadReport,
    largest_loads,
)
from wrenchbook.surrogate.findings.cycles import TURN, Passes, passes_of
from wrenchbook.surrogate.table.rows import joined

MAX_CYCLE_ROWS = 1_000_000  # all in memory: 0.4 GB of the child's 1 GB with their intermediates
_BLOCK = 65_536  # rows of a piece, as of a file
# Of a load's range: cycles of one load differ by less in the others, of a cross-load sensor too.
_REPEATED = 0.02
_FEW = 0.1  # of the places: single rows may lie apart


class _CycleError(ValueError):
    """The cycles of a file do not allow an option: its name, and a message with the remedy."""


def with_cycles(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the rows that the cycle options leave, from all rows of a file in their order.

    The main load is the one with the largest range, in parts of the component's. In this order:
    the first cycles are left out, the other branch is, the rows of a pass within one place are
    averaged, and the passes of a branch become their mean.
    """
    if not options.has_cycles:
        yield from pieces
        return
    parts: list[ParsedTable] = []
    try:
        for piece in pieces:
            parts.append(piece)
            if report.read > MAX_CYCLE_ROWS:
                message = f"has more than {MAX_CYCLE_ROWS:,} rows, the limit of cycle options"
                raise _CycleError("file", f"{message}; send it in parts")
        if any(map(len, parts)) and not report.mistakes.of_file:
            rows = _retained_rows(_joined(parts), options, report)
            for start in range(0, len(rows), _BLOCK):
                yield rows.take(np.arange(start, min(start + _BLOCK, len(rows))))
    except _CycleError as error:
        report.mistakes.ruin(0, *error.args)


def _joined(parts: list[ParsedTable]) -> ParsedTable:
    note = [note for part in parts for note in part.note]
    return ParsedTable(**vars(joined(parts)) | {"note": note, "time": None})


def _retained_rows(rows: ParsedTable, options: Options, report: ReadReport) -> ParsedTable:
    """Return the rows that the cycle options leave; `report` counts the others."""
    if any(rows.compliance.strides) or ((rows.source == FEA) | (rows.fingerprint != "")).any():
        message = "has solves or slopes, but cycles need measured rows; leave the cycle options out"
        raise _CycleError("file", message)
    loads, span = len(options.columns.loads), options.load_range
    size = np.abs(rows.wrench).max(axis=0) if span is None else largest_loads(span) / LOAD_LIMIT
    size = np.where(np.isfinite(size) & (size > 0), size, 1.0)
    main = int(np.argmax(np.ptp(rows.wrench[:, :loads], axis=0) / size[:loads]))
    name, passes = options.columns.wrench[main], passes_of(rows.wrench[:, main])
    if (count := int(passes.number[-1]) // 2) < options.skip_cycles:
        message = (
            f"only {count} cycles of the main load {name} can be skipped; give at most {count}"
        )
        raise _CycleError("skip_cycles", message)
    retained, omitted = passes.number >= 2 * options.skip_cycles, report.omitted
    load = rows.wrench[:, main]
    first, margin = load[0], TURN * np.ptp(load)
    if options.skip_cycles and load.min() + margin < first < load.max() - margin:
        # A test to both sides begins within its range: its cycles end at the load of its first row.
        side = np.sign(load[passes.number == 0][-1] - first)
        retained &= (passes.number > 2 * options.skip_cycles) | (side * (load - first) >= 0)
        if not retained.any():
            most = options.skip_cycles - 1
            message = f"the test has {count} cycles of main load {name}; give at most {most}"
            raise _CycleError("skip_cycles", message)
    omitted["skipped"] = int((~retained).sum())
    if options.branch:
        retained &= (passes.loading == (options.branch == "loading")) & passes.sure
        omitted["branch"] = int((~retained).sum()) - omitted["skipped"]
        if not retained.any():
            message = f"the main load {name} has no {options.branch} branch; leave branch out"
            raise _CycleError("branch", message)
    rows, passes = rows.take(retained), passes.take(retained)
    omitted["averaged"] = len(rows)
    if options.thin is not None:
        rows, passes = _thinned(rows, passes, options.thin * size)
    if options.mean_cycles:
        if passes.number[-1] - passes.number[0] < 2:
            message = "needs two or more cycles, but the file has one; leave mean_cycles out"
            raise _CycleError("mean_cycles", message)
        branches = [_mean(rows, passes, way, main, size) for way in (True, False)]
        branches = sorted((part for part in branches if len(part)), key=lambda part: part.seq[0])
        rows = _joined(branches)
    omitted["averaged"] -= len(rows)
    return rows


def _thinned(rows: ParsedTable, passes: Passes, place: Array) -> tuple[ParsedTable, Passes]:
    """Return the mean of the rows of each pass within one place, as large as `place`, (inputs,)."""
    keys = np.column_stack((passes.number, passes.sure, np.rint(rows.wrench / place)))
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    columns: dict[str, Array] = {}
    for name in ("wrench", "displacement", "uncertainty"):
        values = getattr(rows, name)
        known, (sums, counts) = np.isfinite(values), np.zeros((2, len(first), values.shape[1]))
        np.add.at(sums, group.ravel(), np.where(known, values, 0.0))
        np.add.at(counts, group.ravel(), known)
        columns[name] = (sums / np.where(counts > 0, counts, np.nan))[order]
    return replace(rows.take(first[order]), **columns), passes.take(first[order])


def _mean(rows: ParsedTable, passes: Passes, loading: bool, main: int, size: Array) -> ParsedTable:
    """Return the mean of the passes of a branch at the loads of its widest one.

    Each pass is interpolated along the main load. The 95 % half width of a mean is that of the
    scatter about it, which all loads have in common; a larger stated one stays.
    """
    chosen = np.flatnonzero(passes.sure & (passes.loading == loading))
    number, n = passes.number[chosen], rows.wrench.shape[1]
    some = [at for pass_number in np.unique(number) if len(at := chosen[number == pass_number]) > 1]
    if not some:
        return rows.take(chosen[:0])
    numbers = np.hstack((rows.wrench, rows.displacement))
    widest = max(some, key=lambda at: np.ptp(numbers[at, main]))
    values = np.full((len(some), len(widest), numbers.shape[1]), np.nan)
    for k, at in enumerate(some):
        at = at[np.argsort(numbers[at, main], kind="stable")]
        for column in np.flatnonzero(np.isfinite(numbers[at]).any(axis=0)).tolist():
            x, y = numbers[at[np.isfinite(numbers[at, column])]][:, [main, column]].T
            values[k, :, column] = np.interp(numbers[widest, main], x, y, np.nan, np.nan)
        values[k] = numbers[widest] if some[k] is widest else values[k]
    counts = np.isfinite(values).sum(axis=0)
    mean = np.nansum(values, axis=0) / np.where(counts > 0, counts, np.nan)
    apart = np.nanmax(values[:, :, :n], axis=0) - np.nanmin(values[:, :, :n], axis=0)
    differs = (apart > _REPEATED * size).mean(axis=0)
    if (differs > _FEW).any():
        other = int(differs.argmax())
        message = (
            f"the cycles differ: {rows.space.input_names[other]} changes by up to "
            f"{apart[:, other].max():.4g} between them at the same main load. Leave mean_cycles "
            "out, or send the test of each load as a file of its own"
        )
        raise _CycleError("mean_cycles", message)
    freedom = np.maximum(counts - 1, 0).sum(axis=0)[n:]
    squares = np.nansum((values - mean) ** 2, axis=(0, 1))[n:]
    scatter = np.sqrt(squares / np.where(freedom > 0, freedom, np.nan))
    half = stdtrit(np.maximum(freedom, 1), 0.975) * scatter / np.sqrt(np.maximum(counts[:, n:], 1))
    stated = np.fmax(half, rows.uncertainty[widest])
    rows = rows.take(widest)
    return replace(rows, wrench=mean[:, :n], displacement=mean[:, n:], uncertainty=stated)
