"""Errors of measurement that rows show: findings of an import, and `without_effects`.

Hysteresis, drift and sessions do not average out: more rows do not lower them, and a mean of both
branches lies on neither. So their effects are removed from the rows, error bars have a separate
part for them, and coverage does not depend on it, as for the discretisation error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..kriging.effects import Effects, effects_of
from ..kriging.readings import Indices
from ..kriging.serial import dependence_of
from ..table.rows import Floats, LoadRange, Rows
from ..table.space import OUTPUTS
from .channels import channel_findings, dead_channels
from .contract import (
    clearance_findings,
    fit_of,
    range_findings,
    sign_findings,
    size_findings,
    symmetry_findings,
    turned_findings,
    unit_findings,
)
from .origin import slopes_at_zero
from .response import REMARKABLE, Cause, RigFinding, response_of, single_row_findings, wrong_rows

MIN_FIT_ROWS = 7  # rows of a linear response: six loads and a constant
# Factor on error bars: of normal errors, bars without it hold 90 % instead of 95 %.
MIN_FACTOR = 1.2
MAX_ROWS = 5_000  # rows examined, some 0.5 s: of more rows every k-th
# Effects that show only in the order of the rows.
EFFECTS: dict[Cause, str] = {
    "hysteresis": "loading and unloading differ by {part:.1%} of the range of {name} (friction, "
    "play, or logs shifted in time). Answers are the middle of both branches; for one branch, "
    "import again with branch=loading (--branch loading)",
    "drift": "at one load, {name} changes by {part:.1%} of its range from the first row to the "
    "last. Let the rig warm up, or import each run with tare=N (--tare N), for N rows without load",
    "session": "at one load, {name} of a session (an import) is up to {part:.1%} of its range from "
    "the mean. Begin each session with N rows without load, and import with tare=N (--tare N)",
    "scale": "the displacement per load changes with time or between sessions (imports), by up to "
    "{part:.1%} of the range of {name}. Calibrate the sensors before each session, and look for "
    "play in the rig",
    "zero": "{name} is {part:.1%} of its range at no load. Import again with tare=N (--tare N), "
    "for N rows without load; leave tare out for a preload, play or another reference",
}


def find(
    rows: Rows, load_range: LoadRange, solved: Floats | None = None, *, linear: bool = True
) -> list[RigFinding]:
    """Return the probable systematic errors of measured rows, in the order of their measurement.

    `rows`: measured rows in the order in which they were measured.
    `load_range`, N and N·m.
    `solved` (6, 6), SI: compliance of the component's solves: expected size and sign of
    displacements. Columns of zeros are not known.
    """
    if len(rows) < MIN_FIT_ROWS:
        return range_findings(rows, load_range) if len(rows) else []
    moves = np.eye(6) if solved is None else solved
    still = np.asarray(moves.any(axis=0) & ~moves.any(axis=1))
    rows, findings = channel_findings(rows.take(_examined(len(rows))), load_range, still)
    if len(rows) < MIN_FIT_ROWS:
        return findings
    response = response_of(rows, load_range)
    wrong = wrong_rows(rows, load_range, response)
    findings += single_row_findings(rows, response, wrong)
    good = rows.take(~wrong.any(axis=1))
    if len(good) < MIN_FIT_ROWS:
        return findings
    if wrong.any():
        response = response_of(good, load_range)
    slopes = slopes_at_zero(good, load_range, response)
    fit = fit_of(slopes.matrix, slopes.covariance, load_range)
    known = None if solved is None else fit_of(solved, np.zeros((6, 6, 6)), load_range)
    skew = symmetry_findings(fit, load_range)
    # A wrong unit, frame or sign shows in several checks: the first that finds an error explains
    # the others. A lever comes before signs, since it can make a load's work negative.
    checks: tuple[Callable[[], list[RigFinding]], ...] = (
        lambda: [*range_findings(good, load_range), *size_findings(response)],
        lambda: unit_findings(fit, known, linear=linear),
        lambda: turned_findings(fit, known),
        lambda: [finding for finding in skew if finding.cause == "lever"],
        lambda: sign_findings(fit),
        lambda: skew,
    )
    findings += next((found for check in checks if (found := check())), [])
    findings += clearance_findings(slopes, response)
    is_good = ~wrong.any(axis=1)
    effects = effects_of(rows, load_range, np.flatnonzero(is_good))
    findings += effect_findings(effects, good.displacement)
    of_part = replace(good, displacement=good.displacement - effects.of_rows[is_good])
    return findings + correlation_findings(dependence_of(of_part, load_range))


def _examined(count: int) -> Indices:
    """Return the positions of the examined ones of `count` rows, at least one, ascending."""
    return np.arange(0, count, -(-count // MAX_ROWS))


def without_effects(rows: Rows, load_range: LoadRange) -> tuple[Rows, Floats]:
    """Return rows without hysteresis, drift and sessions, and the part's distance from them.

    `rows`: of one version of a table, in ascending order of `seq`; solved ones stay as they are.

    The distance (6,), m and rad, is from the middle of both branches, of the time and of the
    sessions to the farthest of each. It is NaN for a dead channel, which measured nothing.
    """
    indices, effects = _effects(rows, load_range)
    dead = np.where(dead_channels(rows, load_range), np.nan, 0.0)
    if effects is None or not effects.bar.any():
        return rows, dead
    displacement = rows.displacement.copy()
    displacement[indices] -= effects.of_rows
    return replace(rows, displacement=displacement), effects.bar + dead


def loop_of(rows: Rows, load_range: LoadRange) -> tuple[Floats, Floats]:
    """Return the loop from unloading to loading, and the largest loop that rows would not show.

    Shapes (m,) each, m and rad: the first is 0 where rows show no loop. Solves have none; the
    second is infinite where measured rows show nothing of a loop.
    """
    nothing = np.zeros(rows.displacement.shape[1])
    effects = _effects(rows, load_range)[1]
    if effects is not None:
        return effects.loop, effects.loop_hidden
    return nothing, nothing + (0.0 if rows.is_solved.all() else np.inf)


def _effects(rows: Rows, load_range: LoadRange) -> tuple[Indices, Effects | None]:
    """Return which rows of a table are readings, and the effects in them; None if too few are."""
    indices = np.flatnonzero(~rows.is_solved & ~rows.has_tangent & load_range.holds(rows.wrench))
    readings = rows.take(indices)
    if len(readings) < MIN_FIT_ROWS:
        return indices, None
    positions = _examined(len(readings))
    shown = readings.take(positions)
    wrong = wrong_rows(shown, load_range, response_of(shown, load_range)).any(axis=1)
    return indices, effects_of(readings, load_range, positions[~wrong])


def effect_findings(effects: Effects, displacement: Floats) -> list[RigFinding]:
    """Return a finding of each remarkable effect in rows with displacements (n, 6), m and rad."""
    ranges = np.fmax.reduce(displacement) - np.fmin.reduce(displacement)  # NaN: not measured
    findings = list[RigFinding]()
    causes: tuple[tuple[Cause, str, Floats], ...] = (
        ("hysteresis", "loop", np.abs(effects.loop)[None]),
        ("drift", "drift", effects.drift),
        ("session", "offset", effects.session),
        ("scale", "scale", effects.scale),
        ("zero", "offset", effects.zero[None]),
    )
    for cause, entry, sizes in causes:
        largest = sizes[np.abs(sizes).argmax(axis=0), np.arange(len(ranges))]
        # A channel at one value has no range to compare with.
        remarkable = np.flatnonzero((np.abs(largest) > REMARKABLE * ranges) & (ranges > 0))
        if not len(remarkable):
            continue
        parts = np.abs(largest[remarkable]) / ranges[remarkable]
        name = OUTPUTS[remarkable[parts.argmax()]]
        part = parts.max()
        numbers = {entry: {OUTPUTS[output]: float(largest[output]) for output in remarkable}}
        findings.append(RigFinding(cause, EFFECTS[cause].format(part=part, name=name), (), numbers))
    return findings


def correlation_findings(dependence: Floats) -> list[RigFinding]:
    """Return a finding if errors of consecutive rows are alike; (m,): see `dependence_of`."""
    factor = np.sqrt(dependence)
    remarkable = np.flatnonzero(factor > MIN_FACTOR)
    if not len(remarkable):
        return []
    worst = remarkable[factor[remarkable].argmax()]
    message = (
        f"consecutive readings of {OUTPUTS[worst]} have common errors, as of one hold of a load. "
        f"{dependence[worst]:.2g} of them count as one, so error bars are about "
        f"{factor[worst]:.2g} times as large as of independent readings. Import the mean of "
        "each hold with its standard uncertainty (a column such as uz_std), or import again with "
        "thin=0.02 (--thin 0.02)"
    )
    factors = {OUTPUTS[output]: float(factor[output]) for output in remarkable}
    return [RigFinding("correlated", message, (), {"factors": factors})]


def error_of_a_reading(error: Floats, interpolation: Floats, noise: Floats) -> Floats:
    """Return the error bars of one more observation at a wrench, (6,), m and rad.

    `error`, `interpolation`, `noise` (6,), m and rad: the answer's error, its part by
    interpolation, and the 95 % noise of one observation.
    """
    return error - interpolation + np.hypot(interpolation, noise)
