"""Cycles of a test at an import: first ones left out, a branch, the mean by place or of cycles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

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
from wrenchbook.surrogate.findings.cycles import Passes, passes_of

MAX_CYCLE_ROWS = 1_000_000  # all in memory: 0.4 GB of the child's 1 GB with their intermediates
_TOO_MANY = (
    f"has more than {MAX_CYCLE_ROWS:,} rows, which skip_cycles, branch, thin and mean_cycles take "
    "at once; send it in parts"
)
_NOT_MEASURED = (
    "has solves or slopes, and skip_cycles, branch, thin and mean_cycles are for measured rows; "
    "leave these options out"
)
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
    the first `options.skip_cycles` cycles are left out, the other branch is, the rows of a pass
    within one place are averaged, and the passes of a branch become their mean.
    """
    if not options.has_cycles:
        yield from pieces
        return
    parts: list[ParsedTable] = []
    try:
        for piece in pieces:
            parts.append(piece)
            if report.read > MAX_CYCLE_ROWS:
                raise _CycleError("file", _TOO_MANY)
        if any(map(len, parts)) and not report.mistakes.whole:
            rows = _left_rows(_joined([part for part in parts if len(part)]), options, report)
            for start in range(0, len(rows), _BLOCK):
                yield rows.take(np.arange(start, min(start + _BLOCK, len(rows))))
    except _CycleError as error:
        report.mistakes.ruin(0, *error.args)


def _left_rows(rows: ParsedTable, options: Options, report: ReadReport) -> ParsedTable:
    """Return the rows that the cycle options leave; `report` counts the others."""
    loads, span = len(options.columns.loads), options.load_range
    size = np.abs(rows.wrench).max(axis=0) if span is None else largest_loads(span) / LOAD_LIMIT
    size = np.where(np.isfinite(size) & (size > 0), size, 1.0)
    main = int(np.argmax(np.ptp(rows.wrench[:, :loads], axis=0) / size[:loads]))
    name, passes = options.columns.wrench[main], passes_of(rows.wrench[:, main])
    count = int(passes.number[-1]) // 2
    if count < options.skip_cycles:
        message = (
            f"is {options.skip_cycles}, and the main load {name} comes back to its first branch "
            f"{count} times (its turning points are 10 % of its range apart); give less"
        )
        raise _CycleError("skip_cycles", message)
    kept = passes.number >= 2 * options.skip_cycles
    report.left_out["skipped"] = int((~kept).sum())
    if options.branch:
        kept &= (passes.loading == (options.branch == "loading")) & passes.sure
        report.left_out["branch"] = int((~kept).sum()) - report.left_out["skipped"]
        if not kept.any():
            message = f"the main load {name} has no {options.branch} branch; leave branch out"
            raise _CycleError("branch", message)
    rows, passes = rows.take(kept), passes.take(kept)
    read = len(rows)
    if options.thin is not None:
        rows, passes = _thinned(rows, passes, options.thin * size)
    if options.mean_cycles:
        rows = _mean(rows, passes, main, size)
    report.left_out["averaged"] = read - len(rows)
    return rows


def _joined(parts: list[ParsedTable]) -> ParsedTable:
    """Return the rows of pieces as one."""
    columns: dict[str, Any] = {}
    for name in ("seq", "wrench", "displacement", "uncertainty", "source", "fingerprint"):
        columns[name] = np.concatenate([getattr(part, name) for part in parts])
    slopes = any(any(part.compliance.strides) or part.curvature.size for part in parts)
    if slopes or ((columns["source"] == FEA) | (columns["fingerprint"] != "")).any():
        raise _CycleError("file", _NOT_MEASURED)
    n, notes = len(columns["seq"]), [note for part in parts for note in part.note]
    compliance = np.broadcast_to(np.nan, (n, *parts[0].compliance.shape[1:]))
    blank = {"compliance": compliance, "curvature": np.empty((n, 0)), "session": np.zeros(n)}
    return replace(parts[0], **columns, **blank, note=notes, time=None)


def _thinned(rows: ParsedTable, passes: Passes, place: Array) -> tuple[ParsedTable, Passes]:
    """Return the mean of the rows of each pass within one place, as large as `place`, (inputs,)."""
    cells = np.rint(rows.wrench / place)
    keys = np.column_stack((passes.number, passes.sure, cells))
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    group = np.argsort(order)[group.ravel()]
    columns: dict[str, Array] = {}
    for name in ("wrench", "displacement", "uncertainty"):
        values = getattr(rows, name)
        known = np.isfinite(values)
        sums, counts = np.zeros((2, len(first), values.shape[1]))
        np.add.at(sums, group, np.where(known, values, 0.0))
        np.add.at(counts, group, known)
        columns[name] = np.where(counts > 0, sums / np.maximum(counts, 1.0), np.nan)
    at = first[order]
    return replace(rows.take(at), **columns), passes.take(at)


def _mean(rows: ParsedTable, passes: Passes, main: int, size: Array) -> ParsedTable:
    """Return the mean of the passes of each branch at the places of its widest one.

    Each pass is interpolated along the main load. The 95 % half width of a mean is that of the
    scatter about it, which the places of a branch have in common; a larger stated one stays.
    """
    if passes.number.max() - passes.number.min() < 2:
        message = "needs two cycles or more, and the file has one; leave it out"
        raise _CycleError("mean_cycles", message)
    n = rows.wrench.shape[1]
    numbers = np.hstack((rows.wrench, rows.displacement))
    means: list[ParsedTable] = []
    for loading in (True, False):
        of_branch = np.flatnonzero(passes.sure & (passes.loading == loading))
        numbered = passes.number[of_branch]
        some = [of_branch[numbered == number] for number in np.unique(numbered)]
        some = [at for at in some if len(at) > 1]
        if not some:
            continue
        widest = max(some, key=lambda at: np.ptp(numbers[at, main]))
        places = numbers[widest, main]
        values = np.full((len(some), len(places), numbers.shape[1]), np.nan)
        for k, at in enumerate(some):
            at = at[np.argsort(numbers[at, main], kind="stable")]
            for column in range(numbers.shape[1]):
                known = at[np.isfinite(numbers[at, column])]
                if len(known):
                    x, y = numbers[known, main], numbers[known, column]
                    values[k, :, column] = np.interp(places, x, y, np.nan, np.nan)
        values[some.index(widest)] = numbers[widest]
        counts = np.isfinite(values).sum(axis=0)
        mean = np.nansum(values, axis=0) / np.where(counts > 0, counts, np.nan)
        apart = np.nanmax(values[:, :, :n], axis=0) - np.nanmin(values[:, :, :n], axis=0)
        differs = (apart > _REPEATED * size).mean(axis=0)
        if (differs > _FEW).any():
            other = rows.space.input_names[int(differs.argmax())]
            message = (
                f"the cycles do not repeat: {other} differs between them by up to "
                f"{apart[:, differs.argmax()].max():.4g} at the same main load, and mean_cycles is "
                "for repeated cycles of one load. Leave it out, or send each load's test by itself"
            )
            raise _CycleError("mean_cycles", message)
        freedom = np.maximum(counts - 1, 0).sum(axis=0)[n:]
        squares = np.nansum((values - mean) ** 2, axis=(0, 1))[n:]
        scatter = np.sqrt(squares / np.where(freedom > 0, freedom, np.nan))
        half = (
            stdtrit(np.maximum(freedom, 1), 0.975) * scatter / np.sqrt(np.maximum(counts, 1))[:, n:]
        )
        uncertainty = np.fmax(half, rows.uncertainty[widest])
        columns = {"wrench": mean[:, :n], "displacement": mean[:, n:], "uncertainty": uncertainty}
        means.append(replace(rows.take(widest), **columns))
    means.sort(key=lambda part: part.seq[0])
    return _joined(means)
