"""Cycles of a load: its passes between turning points, and lines of load over displacement.

Imports thin, average and separate rows by these passes, and the measured stiffness has its
branches from them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.special import stdtrit

from ..kriging.effects import sessions_of
from ..table.rows import Floats, LoadRange, Rows

TURN = 0.1  # of the load's range: smaller reversals are noise, and no turning points
# Of the load's range: rows behind a turning point that are so near to it, as of a load that is held
# with noise, have no sure direction.
NEAR_TURN = 0.01
ALONG = 0.05  # of half a load's range: where another load varies by more, its effect is in a slope
MIN_ROWS = 3  # of a line with a residual


class Passes(NamedTuple):
    """The passes of a load between its turning points, in the order of rows (n,).

    Attributes
    ----------
    number : ndarray of int, shape (n,)
        The pass of each row; a turning point is of the pass that led to it. Two are a cycle.
    loading : ndarray of bool, shape (n,)
        Whether the pass leads away from no load; of a load that is as large in both directions,
        whether it rises.
    sure : ndarray of bool, shape (n,)
        False of rows behind a turning point that are as near to it as noise.
    """

    number: NDArray[np.intp]
    loading: NDArray[np.bool_]
    sure: NDArray[np.bool_]

    def take(self, which: NDArray[Any]) -> Passes:
        """Return the passes of the rows that an index array or a mask of shape (n,) picks."""
        return Passes(self.number[which], self.loading[which], self.sure[which])


def passes_of(load: Floats) -> Passes:
    """Return the passes of a load, (n,), in the order of its measurement."""
    n, span = len(load), float(np.ptp(load)) if len(load) else 0.0
    number, sure = np.zeros(n, dtype=np.intp), np.ones(n, dtype=bool)
    if span == 0.0:
        return Passes(number, np.ones(n, dtype=bool), sure)
    peaks, valleys = (find_peaks(way, prominence=TURN * span)[0] for way in (load, -load))
    turns = np.sort(np.concatenate((peaks, valleys)))
    ends = [*turns.tolist(), n - 1]
    for turn, end in pairwise(ends):
        behind = load[turn + 1 : end + 1]
        held = turn + 1 + int(np.argmin(np.append(behind == load[turn], False)))
        number[held:] += 1  # a load that is held keeps the branch that it came by
        near = np.abs(load[held : end + 1] - load[turn]) <= NEAR_TURN * span
        sure[held : held + int(np.argmin(np.append(near, False)))] = False
    rises = turns[0] in peaks if len(turns) else load[-1] >= load[0]
    falls_away = load.max() + load.min() < -TURN * span
    return Passes(number, (number % 2 == 0) == (rises != falls_away), sure)


class Line(NamedTuple):
    """A straight line load = slope * displacement + offset through n rows, SI."""

    rows: int
    slope: float
    slope_half_width: float  # 95 %
    residual: float  # standard deviation of the load about the line
    r2: float
    unloaded: float  # displacement of the line at no load
    unloaded_half_width: float  # 95 %


def line_through(displacement: Floats, load: Floats) -> Line | None:
    """Return the line of least squares of load over displacement, (n,) each; None of too few rows.

    The displacement is x and the load is y, as in ``numpy.polyfit(displacement, load, 1)``: noise
    is taken to be the load's. That of the displacement lowers the slope by its part of the
    variance.
    """
    if len(load) < MIN_ROWS or np.ptp(displacement) == 0.0:
        return None
    (slope, offset), covariance = np.polyfit(displacement, load, 1, cov=True)
    rest = load - (slope * displacement + offset)
    squares, total = float(rest @ rest), float(((load - load.mean()) ** 2).sum())
    factor = stdtrit(len(load) - 2, 0.975)
    unloaded = along = np.nan
    if slope != 0.0:
        gradient = np.array([offset / slope**2, -1.0 / slope])
        unloaded, along = -offset / slope, factor * np.sqrt(gradient @ covariance @ gradient)
    return Line(
        len(load),
        float(slope),
        float(factor * np.sqrt(covariance[0, 0])),
        float(np.sqrt(squares / (len(load) - 2))),
        1.0 - squares / total if total else np.nan,
        float(unloaded),
        float(along),
    )


def measured_stiffness(
    rows: Rows, load_range: LoadRange, between: tuple[float, float], axis: int, output: int
) -> dict[str, Any]:
    """Return lines of a load over an output through the measured rows between two loads.

    ``lines`` are of all of them, ``loading``, ``unloading`` and, if the loads are of one sign, of
    the rows ``opposite`` between the negative loads. ``play`` is the distance of two lines at no
    load with its 95 % half width, m or rad: of ``branches``, and of ``signs``, the displacement at
    no load of positive loads less that of negative ones. ``other_loads`` vary in these rows by the
    given number, N and N·m.
    """
    rows = rows.take((rows.source != "fea") & np.isfinite(rows.displacement[:, output]))
    load, moved = rows.wrench[:, axis], rows.displacement[:, output]
    loading, sure, session = *np.zeros((2, len(rows)), dtype=bool), sessions_of(rows)
    for number in np.unique(session):
        at = np.flatnonzero(session == number)
        _, loading[at], sure[at] = passes_of(load[at])
    low, high = sorted(between)
    chosen = (load >= low) & (load <= high)
    parts = {"all": chosen, "loading": chosen & loading & sure}
    parts["unloading"] = chosen & ~loading & sure
    parts["opposite"] = (-load >= low) & (-load <= high) & (low * high > 0)
    lines = {name: line_through(moved[part], load[part]) for name, part in parts.items()}
    forth, back = lines["loading"], lines["unloading"]
    plus, minus = (lines[name] for name in ("all", "opposite")[:: 1 if low >= 0 else -1])
    play: dict[str, Any] = {"branches": None, "signs": None}
    for name, first, second in (("branches", back, forth), ("signs", plus, minus)):
        if first is not None and second is not None:
            width = first.unloaded - second.unloaded
            width = abs(width) if name == "branches" else width
            half = np.hypot(first.unloaded_half_width, second.unloaded_half_width)
            play[name] = {"value": float(width), "half_width": float(half)}
    varied = np.ptp(rows.wrench[chosen], axis=0) if chosen.any() else np.zeros(rows.wrench.shape[1])
    varied[axis] = 0.0
    names = load_range.space.input_names
    many = np.flatnonzero(varied > ALONG * load_range.scale).tolist()
    others = {names[k]: float(varied[k]) for k in many}
    shown = {name: line and line._asdict() for name, line in lines.items()}
    return {"lines": shown, "play": play, "other_loads": others}
