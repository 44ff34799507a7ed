"""Errors that only the order of the rows shows: drift and hysteresis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..table.rows import Floats, Rows
from ..table.space import OUTPUTS
from .response import NORMAL, Cause, RigFinding, RobustFit

MIN_ROWS = 30  # rows: with fewer an order shows by chance
PART = 0.01  # of the output's range: what is smaller is within a usual tolerance
MIN_EXPLAINED = 0.15  # of the residuals' variance that the cause must explain
DEVIATIONS = 8.0  # of the estimate: errors of neighbours in time are not independent
# For an error bar, which a wrong guess makes wider and no worse.
PROBABLE_EXPLAINED, PROBABLE_DEVIATIONS = 0.01, 4.0
MIN_INDEPENDENT = 0.1  # of the variance of the cause's sign or time that the loads do not explain
STEP = 0.25  # of the largest usual step: smaller steps have no direction

MESSAGES = {
    "drift": "the displacements drift by {part:.1%} of the range of {name} from the first row to "
    "the last, whatever the load: warm the rig up, or return to zero between runs and import with "
    "a zero offset",
    "loop": "loading and unloading differ by {part:.1%} of the range of {name}: hysteresis of the "
    "rig (friction, joints), or loads and displacements shifted in time (lag of joined logs). The "
    "error bars of answers hold both branches",
}


class SequenceErrors(NamedTuple):
    """Errors that follow the order of the rows, each (6,), m and rad; 0 where none is sure.

    Attributes
    ----------
    drift : ndarray, shape (6,)
        From the first row to the last.
    loop : ndarray, shape (6,)
        From loading to unloading, not negative.
    """

    drift: Floats
    loop: Floats


def sequence_findings(rows: Rows, response: RobustFit) -> list[RigFinding]:
    """Return findings of drift and hysteresis; rows are in the order of measurement."""
    errors, findings = sequence_errors(rows, response), list[RigFinding]()
    causes: tuple[tuple[Cause, str, Floats], ...] = (
        ("drift", "drift", errors.drift),
        ("hysteresis", "loop", errors.loop),
    )
    for cause, entry, sizes in causes:
        over = np.flatnonzero(np.abs(sizes) > PART * response.range)  # worth a remark
        if not len(over):
            continue
        parts = np.abs(sizes[over]) / response.range[over]
        name, part = OUTPUTS[over[parts.argmax()]], parts.max()
        named = {OUTPUTS[output]: float(sizes[output]) for output in over}
        message = MESSAGES[entry].format(part=part, name=name)
        findings.append(RigFinding(cause, message, (), {entry: named}))
    return findings


def sequence_errors(rows: Rows, response: RobustFit, *, probable: bool = False) -> SequenceErrors:
    """Return drift and hysteresis of rows in the order of measurement.

    `probable` causes too, or only those that are sure.
    """
    errors = SequenceErrors(np.zeros(6), np.zeros(6))
    if len(rows) < MIN_ROWS:
        return errors
    time = np.linspace(-0.5, 0.5, len(rows))
    limits = (PROBABLE_EXPLAINED, PROBABLE_DEVIATIONS) if probable else (MIN_EXPLAINED, DEVIATIONS)
    for output in range(6):
        residual = response.residual[:, output]
        known = np.isfinite(residual)
        if known.sum() < MIN_ROWS or response.range[output] <= 0:
            continue
        sign = directions(response.expected[:, output])
        effects = effects_of(
            response.terms[known],
            residual[known],
            np.stack((time, sign), axis=1)[known],
            *limits,
        )
        errors.drift[output], errors.loop[output] = effects[0], abs(2.0 * effects[1])
    return errors


def directions(expected: Floats) -> Floats:
    """Return the sign of an output's change from the row before, (n,); 0 where it rests."""
    steps = np.diff(expected, prepend=expected[0])
    usual = np.percentile(np.abs(steps), 90)
    return np.where(np.abs(steps) > STEP * usual, np.sign(steps), 0.0)


def effects_of(
    terms: Floats, residual: Floats, causes: Floats, fraction: float, deviations: float
) -> Floats:
    """Return the coefficient of each cause (n, c) in the residuals (n,); 0 where none is sure.

    Each cause counts by what the loads and the other causes do not explain of it. It must explain a
    fraction of the residuals' variance, and be so many of its standard deviations.
    """
    effects = np.zeros(causes.shape[1])
    clipped = np.clip(residual, -_limit(residual), _limit(residual))
    for column in range(causes.shape[1]):
        others = np.concatenate((terms, np.delete(causes, column, axis=1)), axis=1)
        cause = causes[:, column]
        total = float(((cause - cause.mean()) ** 2).sum())
        independent = cause - others @ np.linalg.lstsq(others, cause, rcond=1e-9)[0]
        target = clipped - others @ np.linalg.lstsq(others, clipped, rcond=1e-9)[0]
        square = float(independent @ independent)
        if total <= 0 or square < MIN_INDEPENDENT * total:
            continue
        slope = float(independent @ target) / square
        remainder = target - slope * independent
        size = max(float(target @ target), np.finfo(float).tiny)
        explained = 1.0 - float(remainder @ remainder) / size
        free = max(len(residual) - others.shape[1] - 1, 1)
        error = np.sqrt(float(remainder @ remainder) / free / square)
        if explained > fraction and abs(slope) > deviations * error:
            effects[column] = slope
    return effects


def _limit(residual: Floats) -> float:
    """Return six robust deviations: what single wrong rows count at most."""
    return 6.0 * NORMAL * float(np.median(np.abs(residual))) + np.finfo(float).tiny
