"""Channels that do not measure: dead, stuck, at the end of their range, noise.

The work of a load on its own displacement is positive on every elastic part. So a channel whose own
load varies and which does not move, or moves by noise alone, is broken. A load cell is at the end
of its range, or stuck, where displacements change while its reading stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kriging.readings import PLACE
from ..table.polynomial import RANK, terms_of
from ..table.rows import ROUNDING, ZERO_LOAD, Floats, LoadRange, Rows
from ..table.space import LOADS, OUTPUTS
from .response import CONFIDENT, NORMAL, REMARKABLE, Cause, RigFinding, fitted, is_nines

MIN_CHANNEL_ROWS = 12  # readings: fewer do not show the channel's normal behaviour
MIN_EQUAL = 3  # rows of one value: two may be equal by rounding of the written digits
DIGITS = 3  # values of a channel at rest: its converter may alternate between neighbouring digits
TAIL = 5  # per cent of the rows at either end that count as the end, as single rows may be wrong
MAX_BY_CHANCE = 0.5  # part of the variance: a channel with half of it by its loads follows them
ROWS_A_TERM = 2  # rows for each term of the response that must remain beside the suspected rows


class Fault(NamedTuple):
    """Readings of a channel that are no measurement."""

    cause: Cause
    rows: NDArray[np.intp]  # (k,): indices among the readings that were examined
    value: float  # the constant value of these rows, or the deviation of noise
    # Part of the range: largest deviation of these rows from the prediction by the others.
    off: float


MESSAGES: dict[Cause, str] = {
    "dead": "{name} reads {value:.6g} {unit} in all rows while {load} varies, and so would its "
    "answers. Check the channel; if {name} was not measured, leave its cells empty",
    "noise": "{name} does not follow the loads, though {load} varies: its readings are noise of "
    "{value:.3g} {unit}. Check the channel; if {name} was not measured, leave its cells empty",
    "clipped": "{name} stops at {value:.6g} {unit} in {count} rows, up to {off:.0%} of its range "
    "short of the other rows: the channel was at its limit. Withdraw these rows, or leave the "
    "cells empty",
    "stuck": "{name} stays at {value:.6g} {unit} in {count} rows, up to {off:.0%} of its range "
    "away from the other rows: the channel was stuck. Withdraw these rows, or leave the cells "
    "empty",
}
OF_LOADS = (
    "{load} stays at {value:.6g} {unit} in {count} rows, where {name} goes on by up to {off:.0%} "
    "of its range: the load cell was {cause}. Withdraw these rows, because their load is wrong"
)


def channel_findings(
    rows: Rows, load_range: LoadRange, still: NDArray[np.bool_]
) -> tuple[Rows, list[RigFinding]]:
    """Return the rows without the readings of broken channels, and the findings.

    `rows`: in the order of their measurement.
    `still` (6,): outputs that do not move, by the component's solves.
    """
    findings: list[RigFinding] = []
    terms = terms_of(rows.wrench / load_range.scale)
    moved = rows.displacement.copy()
    varies = np.ptp(rows.wrench, axis=0) > ZERO_LOAD * load_range.scale
    for output in np.flatnonzero(varies & ~still).tolist():
        # A logger's mark for "no value" is no reading of the channel.
        read = [value == value and not is_nines(value) for value in moved[:, output].tolist()]
        known = np.flatnonzero(read)
        unit = "m" if output < 3 else "rad"
        names = {"name": OUTPUTS[output], "load": LOADS[output]}
        for fault in _output_faults(terms[known], moved[known, output]):
            at = known[fault.rows]
            fields = {**names, **fault._asdict(), "unit": unit, "count": len(at)}
            message = MESSAGES[fault.cause].format(**fields)
            listed = () if len(at) == len(known) else tuple(rows.seq[at].tolist())
            findings.append(RigFinding(fault.cause, message, listed, {"output": OUTPUTS[output]}))
            moved[at, output] = np.nan
        load = rows.wrench[known, output]
        unit = "N" if output < 3 else "N*m"
        for fault in _load_faults(load, terms[known], moved[known, output]):
            at = known[fault.rows]
            fields = {**names, **fault._asdict(), "unit": unit, "count": len(at)}
            listed = tuple(rows.seq[at].tolist())
            numbers = {"load": LOADS[output]}
            findings.append(RigFinding(fault.cause, OF_LOADS.format(**fields), listed, numbers))
            moved[at] = np.nan
    kept = np.isfinite(moved).any(axis=1)
    sound = Rows.of(rows.wrench[kept], moved[kept], seq=rows.seq[kept], source=rows.source[kept])
    return sound, findings


def dead_channels(rows: Rows, load_range: LoadRange) -> NDArray[np.bool_]:
    """Return which outputs (m,) of measured rows stay at one value while their own load varies.

    A change of one digit up or down is the converter's, if the loads do not explain it. A planar
    test may record zeros for the other outputs: there the own load does not vary either, but for
    its sensor's noise.
    """
    moved = rows.displacement
    if len(rows) < MIN_CHANNEL_ROWS or not rows.space.is_default or rows.is_solved.any():
        return np.zeros(moved.shape[1], dtype=bool)
    low, high = np.fmin.reduce(moved), np.fmax.reduce(moved)
    is_equal = high - low <= ROUNDING * np.fmax(np.abs(low), np.abs(high))
    known = np.isfinite(moved)
    loads = rows.wrench / load_range.scale
    levels = np.array([len(np.unique(moved[at, k])) for k, at in enumerate(known.T)])
    for output in np.flatnonzero((levels <= DIGITS) & ~is_equal & known.any(axis=0)):
        at = known[:, output]
        is_equal[output] = not _is_explained(terms_of(loads[at]), moved[at, output])
    # Over the rows that measured the output.
    highest, lowest = (
        end(np.where(known, loads, np.nan), axis=0) for end in (np.fmax.reduce, np.fmin.reduce)
    )
    varies = highest - lowest > 2 * PLACE
    return (known.sum(axis=0) >= MIN_CHANNEL_ROWS) & is_equal & varies


def _output_faults(terms: Floats, y: Floats) -> list[Fault]:
    """Return the faults of an output's readings (n,), with the response's terms (n, t)."""
    all_rows = np.arange(len(y))
    if len(y) < MIN_CHANNEL_ROWS:
        return []
    size = float(np.ptp(y))
    equal = ROUNDING * float(np.abs(y).max())
    if size <= equal:
        return [Fault("dead", all_rows, float(y[0]), 0.0)]
    if not _is_explained(terms, y):
        return [Fault("noise", all_rows, float(y.std()), 0.0)]

    high, low, run = _constant_rows(y, equal)
    steps = np.diff(np.sort(y))
    # Of the readings; between dense readings all steps may be rounding.
    step = float(np.median(steps[steps > equal])) if steps.max() > equal else equal
    faults = list[Fault]()
    for end, suspects in ((1.0, high), (-1.0, low), (0.0, run)):  # 0: at neither end
        others = np.delete(all_rows, suspects)
        if not end and (np.isin(run[0], high) or np.isin(run[0], low)):
            continue
        if len(suspects) < MIN_EQUAL or len(others) < ROWS_A_TERM * terms.shape[1]:
            continue
        without = y.copy()
        without[suspects] = np.nan
        off = fitted(terms, without) - y
        # Readings are rounded to steps: a uniform error, whose deviation is step / sqrt(12).
        deviation = np.hypot(NORMAL * float(np.median(np.abs(off[others]))), step / np.sqrt(12))
        # Clipped rows should be beyond their end, on average. How sure the other rows' prediction
        # is depends on the place of each row.
        weights = terms[suspects] @ np.linalg.pinv(terms[others], rcond=RANK)
        sure_off = off[suspects] / np.sqrt(1 + (weights**2).sum(axis=1))
        far = end * sure_off.mean() if end else np.sqrt((sure_off**2).mean())
        sure = CONFIDENT * deviation / (np.sqrt(len(suspects)) if end else 1.0)
        if far > max(sure, REMARKABLE * size):
            worst = np.abs(off[suspects]).max() / size
            cause = "clipped" if end else "stuck"
            faults.append(Fault(cause, suspects, float(y[suspects[0]]), worst))
    return faults


def _load_faults(load: Floats, terms: Floats, y: Floats) -> list[Fault]:
    """Return the rows where a load (n,) keeps a value while its own displacement (n,) changes.

    A test may reach one load often without a fault. Displacements at this load then scatter about
    the response of all rows as elsewhere, or all deviate by the same amount, where the response is
    no polynomial. A load of few other values, as in a factorial test, has set values, which show
    nothing of a load cell.
    """
    known = np.isfinite(y)
    faults = list[Fault]()
    equal = ROUNDING * float(np.abs(load).max(initial=0.0))
    if known.sum() < MIN_CHANNEL_ROWS or np.ptp(load) <= equal:
        return []
    high, low, run = _constant_rows(load, equal)
    run = np.setdiff1d(run, np.concatenate((high, low)))
    if max(len(high), len(low), len(run)) < MIN_EQUAL:
        return []  # the fits below take most of the time
    off = y - fitted(terms, y)
    size = float(np.ptp(y[known]))
    moving = y.copy()
    moving[np.concatenate((high, low, run))] = np.nan
    is_enough = np.isfinite(moving).sum() >= ROWS_A_TERM * terms.shape[1]
    off_moving = moving - fitted(terms, moving) if is_enough else off

    for is_end, constant in ((True, high), (True, low), (False, run)):
        suspects = constant[known[constant]]
        others = np.setdiff1d(np.flatnonzero(known), constant)
        if len(np.unique(load[others])) < MIN_CHANNEL_ROWS:
            continue
        if len(suspects) < MIN_EQUAL or len(others) < ROWS_A_TERM * terms.shape[1]:
            continue
        spread = np.median(np.abs(off[suspects] - np.median(off[suspects])))
        # Many rows of one wrench whose load is wrong bend the fit of all rows.
        is_one_wrench = np.ptp(terms[suspects], axis=0).max() < PLACE
        of_others = (off_moving if is_one_wrench else off)[others]
        usual = np.nanmedian(np.abs(of_others - np.nanmedian(of_others)))
        if spread > max(CONFIDENT * usual, REMARKABLE * size):
            worst = np.abs(off[suspects]).max() / size
            cause = "clipped" if is_end else "stuck"
            faults.append(Fault(cause, suspects, float(load[suspects[0]]), worst))
    return faults


def _constant_rows(values: Floats, equal: float) -> list[NDArray[np.intp]]:
    """Return the rows at the highest value, those at the lowest, and the longest run of equal ones.

    Values that differ by `equal` at most are equal.
    """
    runs = np.split(np.arange(len(values)), 1 + np.flatnonzero(np.abs(np.diff(values)) > equal))
    ends = values.max(), values.min()
    return [*(np.flatnonzero(np.abs(values - end) <= equal) for end in ends), max(runs, key=len)]


def _is_explained(terms: Floats, y: Floats) -> bool:
    """Return whether the terms (n, t) explain more of the variance of y (n,) than of pure noise.

    True as well where the rows are too few to show it. The ends of y are clipped against single
    wrong rows, or kept, since the response to a load of few rows lies in them alone.
    """
    free = terms.shape[1] - 1
    by_chance = (free + CONFIDENT * np.sqrt(2 * free)) / len(y)
    both = np.column_stack((y, y.clip(*np.percentile(y, [TAIL, 100 - TAIL]))))
    both -= both.mean(axis=0)
    residual = both - terms @ np.linalg.lstsq(terms, both, rcond=RANK)[0]
    is_explained = (residual**2).sum(axis=0) < (1 - by_chance) * (both**2).sum(axis=0)
    return bool(is_explained.any()) or by_chance > MAX_BY_CHANCE
