"""Two logs of a test, one of loads and one of displacements, to rows: joined by their times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.formats.columns import TIME_COLUMN
from wrenchbook.service.formats.options import Array, Options, ParsedTable, ReadReport
from wrenchbook.surrogate.findings.clock import Logs, clock_findings, estimate_lag, repeated

GAP_FACTOR = 5.0  # over the median interval of the loads: in a longer one samples were lost
_CLOCK = 1e6  # s: clock times count from 1900 or 1970, elapsed ones from the beginning of a test


def joined_loads(pieces: Iterator[ParsedTable], report: ReadReport) -> tuple[Array, Array] | None:
    """Return times (n,), s, and wrenches of a log of loads; None if it has a mistake."""
    parts = list(pieces)
    mistakes = report.mistakes
    if mistakes:
        mistakes.is_ruined = True
        return None
    time = np.concatenate([np.empty(0), *(part.time for part in parts if part.time is not None)])
    steps = np.diff(time)
    if not len(steps) or (steps <= 0.0).any():
        rows = [row for part in parts for row in part.seq.tolist()]
        at = int(np.argmax(steps <= 0.0)) + 1 if len(steps) else 0
        message = "the log of the loads needs two or more samples; send a longer one"
        if at:
            message = (
                f"{time[at]:.10g} s is not after the sample before, {time[at - 1]:.10g} s; sort "
                "the loads by time, remove repeated times, and write dates if the log passes "
                "midnight"
            )
        mistakes.ruin(rows[at] if rows else 0, "time", message)
        return None
    return time, np.concatenate([part.wrench for part in parts])


def _applied_lag(
    pieces: Sequence[ParsedTable], time: Array, wrench: Array, options: Options, report: ReadReport
) -> float | None:
    """Return the seconds to add to the displacements' times; None after a mistake."""
    if report.mistakes.is_ruined:
        return None
    is_auto = options.time_offset_s == "auto"
    applied = 0.0 if options.time_offset_s == "auto" else options.time_offset_s
    when = np.concatenate(
        [np.empty(0), *(piece.time for piece in pieces if piece.time is not None)]
    )
    lag = None
    if len(when) and options.space.is_default:
        moved = np.concatenate([piece.displacement for piece in pieces])
        lag = estimate_lag(Logs(time, wrench, when, moved), applied)
    if is_auto and (lag is None or lag.others):
        cause = f" ({repeated(lag)})" if lag else ""
        message = (
            f"lag=auto cannot find the difference of the clocks{cause}; give as lag the seconds to "
            "add to the displacements' times"
        )
        report.mistakes.ruin(0, "time", message)
        return None

    applied = lag.seconds if is_auto and lag else applied
    shown = lag if lag and not lag.others else None
    report.clock = {
        "applied_s": applied,
        "lag_s": shown and shown.seconds,
        "uncertainty_s": shown and shown.error,
    }
    report.findings += clock_findings(lag, applied)
    return applied


def loads_between(time: Array, wrench: Array, when: Array, after: NDArray[np.intp]) -> Array:
    """Return the loads (k, n) at times `when` (k,) before the samples `after` (k,), from two on.

    A straight line between two samples cuts off the peak of an oscillating load, always towards
    zero load. The curve has modified Akima slopes, which do not overshoot where a load steps (Akima
    1970). Beside either end of the log it is straight.
    """
    length = (time[after] - time[after - 1])[:, None]
    part = (when - time[after - 1])[:, None] / length
    line = (1.0 - part) * wrench[after - 1] + part * wrench[after]
    inner = np.flatnonzero((after >= 3) & (after < len(time) - 2))
    at = after[inner] + np.arange(-3, 3)[:, None]  # three samples on either side
    slopes = np.diff(wrench[at], axis=0) / np.diff(time[at], axis=0)[:, :, None]
    turns = np.abs(np.diff(slopes, axis=0)) + np.abs(slopes[1:] + slopes[:-1]) / 2
    weight = turns[2:] + turns[:2]
    at_samples = turns[2:] * slopes[1:3] + turns[:2] * slopes[2:4]
    at_samples = np.divide(at_samples, weight, out=np.zeros_like(weight), where=weight > 0)
    bend = at_samples - slopes[2]
    part = part[inner]
    line[inner] += length[inner] * part * (1 - part) * ((1 - part) * bend[0] - part * bend[1])
    return line


def with_loads(
    pieces: Sequence[ParsedTable], time: Array, wrench: Array, options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the displacements between two loads, with the interpolated wrench."""
    longest = options.max_gap_s or GAP_FACTOR * float(np.median(np.diff(time)))
    lag = _applied_lag(pieces, time, wrench, options, report)
    in_gaps = 0  # rows between two loads that are further apart than `longest`
    for piece in () if lag is None else pieces:
        assert piece.time is not None
        if len(piece) and (abs(piece.time[0]) > _CLOCK) != (abs(time[0]) > _CLOCK):
            message = (
                f"this log begins at {piece.time[0]:.10g} s, the loads' at {time[0]:.10g} s: one "
                "has clock times, the other seconds from its start; convert one of them"
            )
            report.mistakes.ruin(int(piece.seq[0]), "time", message)
            return

        when = piece.time + lag
        after = np.clip(np.searchsorted(time, when, side="right"), 1, len(time) - 1)
        start = time[after - 1]
        end = time[after]
        on_a_sample = (when == start) | (when == end)
        within = (when >= start) & (when <= end)
        good = within & ((end - start <= longest) | on_a_sample)
        in_gaps += int((within & ~good).sum())
        report.unmatched += int((~good).sum())
        loads = loads_between(time, wrench, when[good], after[good])
        yield replace(piece.take(good), wrench=loads, time=None)

    if report.read and report.unmatched == report.read and not report.mistakes:
        when = np.concatenate([piece.time for piece in pieces if piece.time is not None])
        dated = {unit for _, name, unit in report.columns if name == TIME_COLUMN} == {""}
        message = (
            f"no displacement lies within the times of the loads, {_span(time, dated)}; the "
            f"displacements' are {_span(when, dated)}. If the clocks differ, give --lag SECONDS "
            "(lag), which is added to the displacements' times"
        )
        if in_gaps:
            message = f"no displacement has a load near it: {in_gaps} lie between two loads more "
            message += f"than {longest:g} s apart; send a denser log, or set max_gap_s"
        report.mistakes.ruin(0, "time", message)


def _span(time: Array, dated: bool) -> str:
    """Return the first and the last of times (n,), s; as dates if the logs have dates."""
    first, last = float(time.min()), float(time.max())
    if not dated:
        return f"{first:g} to {last:g} s"
    form = "%Y-%m-%d %H:%M:%S"
    dates = (datetime.fromtimestamp(end, UTC).strftime(form) for end in (first, last))
    return " to ".join(dates)
