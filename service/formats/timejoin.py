"""Two logs of one test, joined by their times: what acted, and what moved.

Each displacement is a row; its wrench is the linear interpolation of the loads' samples on both
sides of its time. What lies before, behind or in a gap of the loads has no wrench and is no row: it
is counted as unmatched. The loads, seven numbers a sample, are in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from service.formats.mistakes import RowError
from service.formats.options import Options, Told
from service.formats.parsed import ParsedTable, joined
from service.formats.reading import columns_of
from service.formats.tare import tared, within_limits

GAP_FACTOR = 5.0
"""Times the median distance of two samples: a longer gap is one where samples were lost."""

_CLOCK = 1e6  # s: clock times are counted from 1900 or 1970, elapsed ones from a test's beginning


def joined_logs(
    loads: Path, displacements: Path, options: Options, told: Told
) -> Iterator[ParsedTable]:
    """Yield rows of two logs; parameters as `reading.read_table_file`, with two files."""
    acted = _loads(loads, options, told)
    if acted is None:
        return
    pieces = _matched(displacements, *acted, options, told)
    if options.tare:
        yield from tared(pieces, options, told)
    else:
        yield from (within_limits(piece, options, told) for piece in pieces)


def _loads(path: Path, options: Options, told: Told) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the times (n,), s, and wrenches (n, 6), N and N·m, of a log; None if it is no such."""
    own = Told(mistakes=told.mistakes)
    said = replace(options, role="loads", tare=0)
    table = joined(list(columns_of(path, said, own)), own.mistakes)
    told.columns, told.ignored, told.above = own.columns, own.ignored, own.above
    if own.mistakes:
        told.mistakes.whole = True  # a load that is missing is missing for rows on both its sides
        return None
    assert table.time is not None
    if len(table) < 2 or (np.diff(table.time) <= 0.0).any():
        at = int(np.argmax(np.diff(table.time) <= 0.0)) + 1 if len(table) > 1 else 0
        message = "the log of the loads needs times that grow from sample to sample"
        told.mistakes.ruin(RowError(int(table.row[at]) if len(table) else 0, "time", message))
        return None
    return table.time, table.wrench


def _matched(
    path: Path, time: np.ndarray, wrench: np.ndarray, options: Options, told: Told
) -> Iterator[ParsedTable]:
    """Yield the displacements whose time lies between two loads, with the wrench there."""
    said = replace(options, role="displacements")
    log = Told(mistakes=told.mistakes)
    longest = options.max_gap_s or GAP_FACTOR * float(np.median(np.diff(time)))
    for piece in columns_of(path, said, log):
        told.read, told.format, told.gzip = log.read, log.format, log.gzip
        if len(piece) and not _same_clock(piece, time, told):
            return
        yield _with_loads(piece, time, wrench, longest, options.time_offset_s, told)
    told.columns, told.ignored = told.columns + log.columns, told.ignored + log.ignored
    told.above = told.above + log.above
    told.read, told.format, told.gzip = log.read, log.format, log.gzip
    if told.read and told.unmatched == told.read and not told.mistakes:
        message = (
            f"no displacement lies between two loads, whose times are {time[0]:g} to {time[-1]:g} "
            "s; do the clocks differ? time_offset_s is added to the displacements' times"
        )
        told.mistakes.ruin(RowError(0, "time", message))


def _same_clock(piece: ParsedTable, time: np.ndarray, told: Told) -> bool:
    assert piece.time is not None
    if (abs(piece.time[0]) > _CLOCK) == (abs(time[0]) > _CLOCK):
        return True
    message = "one log has clock times and the other seconds from its beginning; convert one"
    told.mistakes.ruin(RowError(int(piece.row[0]), "time", message))
    return False


def _with_loads(
    piece: ParsedTable,
    time: np.ndarray,
    wrench: np.ndarray,
    longest: float,
    offset: float,
    told: Told,
) -> ParsedTable:
    assert piece.time is not None
    when = piece.time + offset
    after = np.clip(np.searchsorted(time, when, side="right"), 1, len(time) - 1)
    start, end = time[after - 1], time[after]
    on_a_sample = (when == start) | (when == end)
    good = (when >= start) & (when <= end) & ((end - start <= longest) | on_a_sample)
    told.unmatched += int((~good).sum())
    share = ((when - start) / (end - start))[:, None]
    between = (1.0 - share) * wrench[after - 1] + share * wrench[after]
    return replace(piece, wrench=between, time=None).take(good)
