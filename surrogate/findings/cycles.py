"""Cycles of a load: its passes between turning points, and lines of load over displacement."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from ..calibration import LEVEL
from ..kriging.readings import sessions_of
from ..table.rows import Floats, LoadRange, Rows

TURN = 0.1  # part of the load's range: smaller reversals are noise, and no turning points
# Part of the load's range: rows this close behind a turning point, as of a held load with noise,
# have no sure direction.
NEAR_TURN = 0.01
# Part of half a load's range: if another load varies by more, its effect is in a slope.
ALONG = 0.05


class Passes(NamedTuple):
    """The pass of each row, (n,), two a cycle; whether it is loading, and whether the pass is sure.

    A turning point belongs to the pass that led to it. Loading leads away from no load; if the load
    is as large in both directions, loading is the rising one.
    """

    number: NDArray[np.intp]
    loading: NDArray[np.bool_]
    sure: NDArray[np.bool_]

    def take(self, which: NDArray[Any]) -> Passes:
        """Return the passes of the rows that an index array or a mask of shape (n,) picks."""
        return Passes(self.number[which], self.loading[which], self.sure[which])


def passes_of(load: Floats) -> Passes:
    """Return the passes of a load, (n,), in the order of its measurement."""
    # Imported here, as it takes 0.9 s of a server's start.
    from scipy.signal import find_peaks

    span = np.ptp(load)
    number = np.zeros(len(load), dtype=np.intp)
    sure = np.ones(len(load), bool)
    if span == 0.0:
        return Passes(number, sure.copy(), sure)
    peaks, valleys = (find_peaks(signed, prominence=TURN * span)[0] for signed in (load, -load))
    turns = np.sort(np.concatenate((peaks, valleys)))
    for turn, end in pairwise([*turns.tolist(), len(load) - 1]):
        # A held load keeps its branch.
        leaves = turn + 1 + _leading(load[turn + 1 : end + 1] == load[turn])
        number[leaves:] += 1
        near = np.abs(load[leaves : end + 1] - load[turn]) <= NEAR_TURN * span
        sure[leaves : leaves + _leading(near)] = False
    rises = turns[0] in peaks if len(turns) else load[-1] >= load[0]
    falls_away = load.max() + load.min() < -TURN * span
    return Passes(number, (number % 2 == 0) == (rises != falls_away), sure)


def _leading(mask: NDArray[np.bool_]) -> int:
    """Return how many entries of a mask (n,) are true before the first that is false."""
    return int(np.argmin(np.append(mask, False)))


def line_through(displacement: Floats, load: Floats) -> dict[str, float] | None:
    """Return the least-squares line load = slope * displacement + offset, if it has a slope.

    It is None with fewer than three rows too. Displacements, (n,), are in m or rad, loads, (n,), in
    N or N·m. The displacement is x and the load is y, as in
    ``numpy.polyfit(displacement, load, 1)``: noise of the displacement lowers the slope by its part
    of the variance. ``unloaded`` is the displacement at zero load, ``residual`` the standard
    deviation of the load; half widths are of 95 %.
    """
    free = len(load) - 2
    if free < 1 or np.ptp(displacement) == 0.0 or np.ptp(load) == 0.0:
        return None
    (slope, offset), covariance = np.polyfit(displacement, load, 1, cov=True)
    if slope == 0.0:  # no displacement is that at zero load
        return None
    squares = ((load - slope * displacement - offset) ** 2).sum()
    gradient = np.array([offset / slope**2, -1.0 / slope])
    variances = covariance[0, 0], gradient @ covariance @ gradient
    slope_half, unloaded_half = stdtrit(free, (1 + LEVEL) / 2) * np.sqrt(variances)
    return {
        "rows": len(load),
        "slope": float(slope),
        "slope_half_width": float(slope_half),
        "residual": float(np.sqrt(squares / free)),
        "r2": float(1.0 - squares / len(load) / load.var()),
        "unloaded": float(-offset / slope),
        "unloaded_half_width": float(unloaded_half),
    }


def measured_stiffness(
    rows: Rows, load_range: LoadRange, between: tuple[float, float], axis: int, output: int
) -> dict[str, Any]:
    """Return lines of a load over an output through the measured rows between two loads.

    `between`: the two loads, N or N·m; `axis`, `output`: indices of the load and the output.
    ``lines`` are of all these rows, of each branch and of the rows between the opposite loads: see
    `line_through`. ``play`` is the distance of two lines at zero load: of the branches, and of
    positive and negative loads. ``other_loads`` has the other loads that vary in these rows, and
    their range, N and N·m.
    """
    rows = rows.take(~rows.is_solved & np.isfinite(rows.displacement[:, output]))
    load = rows.wrench[:, axis]
    moved = rows.displacement[:, output]
    session = sessions_of(rows)
    loading, sure = np.zeros((2, len(rows)), dtype=bool)
    for number in np.unique(session):
        at = np.flatnonzero(session == number)
        _, loading[at], sure[at] = passes_of(load[at])
    low, high = sorted(between)
    chosen = (load >= low) & (load <= high)
    parts = {
        "all": chosen,
        "loading": chosen & loading & sure,
        "unloading": chosen & ~loading & sure,
    }
    parts["opposite"] = (-load >= low) & (-load <= high) & (low * high > 0)
    lines = {name: line_through(moved[part], load[part]) for name, part in parts.items()}
    play: dict[str, Any] = {}
    signs = ("all", "opposite") if low >= 0 else ("opposite", "all")
    for name, ends in (("branches", ("unloading", "loading")), ("signs", signs)):
        first, second = (lines[end] for end in ends)
        if first and second:
            width = first["unloaded"] - second["unloaded"]
            half = np.hypot(first["unloaded_half_width"], second["unloaded_half_width"])
            width = abs(width) if name == "branches" else width
            play[name] = {"value": width, "half_width": float(half)}
    names = load_range.space.input_names
    loads = rows.wrench[chosen]
    ranges = np.ptp(loads, axis=0) if len(loads) else np.zeros(len(names))
    varied = np.flatnonzero(ranges > ALONG * load_range.scale).tolist()
    other_loads = {names[load]: float(ranges[load]) for load in varied if load != axis}
    return {"lines": lines, "play": play, "other_loads": other_loads}
