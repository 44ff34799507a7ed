"""Logs of a test: the zero offset, and two logs joined by their times.

Each displacement of two logs is a row; its wrench is the linear interpolation of the loads before
and after its time. A displacement before, after or in a gap of the loads is no row: it is counted
as unmatched. Both logs, seven numbers a sample, are in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.rows import Array, ParsedTable
from wrenchbook.surrogate.findings.clock import Logs, clock_findings, estimate_lag, repeated

GAP_FACTOR = 5.0
"""Times the median interval of the loads: in a longer one samples were lost."""

_CLOCK = 1e6  # s: clock times count from 1900 or 1970, elapsed ones from the beginning of a test


def zeroed(
    pieces: Iterator[ParsedTable], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield rows less the mean of the first `options.zero_rows` good ones, which are left out."""
    if not options.zero_rows:
        yield from pieces
        return
    offset = None
    for piece in pieces:
        if offset is None:
            count = options.zero_rows
            if len(piece) <= count:
                message = f"tare={count}, and only {len(piece)} good rows are there for it"
                report.mistakes.ruin(0, "tare", message)
                return
            moved = piece.displacement[:count]
            known = np.isfinite(moved)  # 0 where nothing was measured
            sums = np.where(known, moved, 0.0).sum(axis=0)
            offset = piece.wrench[:count].mean(axis=0), sums / np.maximum(known.sum(axis=0), 1)
            offset[0][len(options.columns.loads) :] = 0.0  # a temperature has its own zero
            report.zeroed = count
            piece = piece.take(np.arange(len(piece)) >= count)
        wrench, displacement = piece.wrench - offset[0], piece.displacement - offset[1]
        yield replace(piece, wrench=wrench, displacement=displacement)


def joined_loads(pieces: Iterator[ParsedTable], report: ReadReport) -> tuple[Array, Array] | None:
    """Return the times (n,), s, and the wrenches (n, inputs), of a log of loads.

    None if it has a mistake: a missing load is missing for the rows before and after it.
    """
    parts, mistakes = list(pieces), report.mistakes
    if mistakes:
        mistakes.whole = True
        return None
    time = np.concatenate([np.empty(0), *(part.time for part in parts if part.time is not None)])
    steps = np.diff(time)
    if not len(steps) or (steps <= 0.0).any():
        rows = [row for part in parts for row in part.seq.tolist()]
        at = int(np.argmax(steps <= 0.0)) + 1 if len(steps) else 0
        message = "the log of the loads needs times that grow from sample to sample"
        mistakes.ruin(rows[at] if rows else 0, "time", message)
        return None
    return time, np.concatenate([part.wrench for part in parts])


def _applied_lag(
    pieces: Sequence[ParsedTable], time: Array, wrench: Array, options: Options, report: ReadReport
) -> float | None:
    """Return the seconds to add to the displacements' times; None after a mistake.

    The report gets the lag that the logs show, and a finding if it is not the one that is applied.
    """
    if report.mistakes.whole:
        return None
    auto = options.time_offset_s == "auto"
    applied = 0.0 if options.time_offset_s == "auto" else options.time_offset_s
    when = np.concatenate(
        [np.empty(0), *(piece.time for piece in pieces if piece.time is not None)]
    )
    found = None
    if len(when) and options.space.is_default:
        moved = np.concatenate([piece.displacement for piece in pieces])
        found = estimate_lag(Logs(time, wrench, when, moved), applied)
    if auto and (found is None or found.others):
        message = (
            "the logs do not show by how much their clocks differ, so lag=auto cannot be applied"
            f"{f' ({repeated(found)})' if found else ''}; give the seconds to add to the "
            "displacements' times"
        )
        report.mistakes.ruin(0, "time", message)
        return None
    applied = found.seconds if auto and found else applied
    report.clock = {
        "applied_s": applied,
        "lag_s": found and found.seconds,
        "uncertainty_s": found and found.error,
    }
    report.findings += clock_findings(found, applied)
    return applied


def with_loads(
    pieces: Sequence[ParsedTable],
    time: Array,
    wrench: Array,
    options: Options,
    report: ReadReport,
) -> Iterator[ParsedTable]:
    """Yield the displacements whose times lie between two loads, with the interpolated wrench.

    `time` (n,), s, and `wrench` (n, inputs), N and N·m, are the log of the loads.
    """
    longest = options.max_gap_s or GAP_FACTOR * float(np.median(np.diff(time)))
    lag = _applied_lag(pieces, time, wrench, options, report)
    for piece in () if lag is None else pieces:
        assert piece.time is not None
        if len(piece) and (abs(piece.time[0]) > _CLOCK) != (abs(time[0]) > _CLOCK):
            message = (
                "one log has clock times and the other seconds from its beginning; convert one"
            )
            report.mistakes.ruin(int(piece.seq[0]), "time", message)
            return
        when = piece.time + lag
        after = np.clip(np.searchsorted(time, when, side="right"), 1, len(time) - 1)
        start, end = time[after - 1], time[after]
        on_a_sample = (when == start) | (when == end)
        good = (when >= start) & (when <= end) & ((end - start <= longest) | on_a_sample)
        report.unmatched += int((~good).sum())
        share = ((when - start) / (end - start))[:, None]
        between = (1.0 - share) * wrench[after - 1] + share * wrench[after]
        yield replace(piece, wrench=between, time=None).take(good)
    if report.read and report.unmatched == report.read and not report.mistakes:
        message = (
            f"no displacement lies between two loads, whose times are {time[0]:g} to {time[-1]:g} "
            "s; do the clocks differ? lag (time_offset_s, --lag SECONDS) is added to the "
            "displacements' times"
        )
        report.mistakes.ruin(0, "time", message)
