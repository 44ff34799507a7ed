"""Errors that only the order of the rows shows: drift and hysteresis."""

from __future__ import annotations

import numpy as np

from ..table.rows import OUTPUTS, Floats, LoadRange, Rows
from .finding import RigFinding
from .response import NORMAL, RobustFit

FEWEST = 30  # rows: with fewer an order shows by chance
PART = 0.01  # of the output's range: what is smaller is within a usual tolerance
SHARE = 0.15  # of the residuals' variance that the cause must explain
DEVIATIONS = 8.0  # of the estimate: errors of neighbours in time are not independent
OWN = 0.1  # of the variance of the cause's sign or time that the loads do not explain
STEP = 0.25  # of the largest usual step: smaller steps have no direction


def sequence_findings(rows: Rows, load_range: LoadRange, response: RobustFit) -> list[RigFinding]:
    """Return findings of drift and hysteresis; rows are in the order of measurement."""
    if len(rows) < FEWEST:
        return []
    time = np.linspace(-0.5, 0.5, len(rows))
    drifts, loops = {}, {}
    for output in range(6):
        residual = response.residual[:, output]
        known = np.isfinite(residual)
        if known.sum() < FEWEST or response.range[output] <= 0:
            continue
        sign = directions(response.expected[:, output])
        effects = effects_of(
            response.terms[known], residual[known], np.stack((time, sign), axis=1)[known]
        )
        drift, loop = effects * (1.0, 2.0)  # from first to last; from branch to branch
        size = response.range[output]
        if abs(drift) > PART * size:
            drifts[OUTPUTS[output]] = float(drift)
        if abs(loop) > PART * size:
            loops[OUTPUTS[output]] = float(abs(loop))
    return [*_drift(drifts, response), *_hysteresis(loops, response)]


def directions(expected: Floats) -> Floats:
    """Return the sign of an output's change from the row before, (n,); 0 where it rests."""
    steps = np.diff(expected, prepend=expected[0])
    usual = np.percentile(np.abs(steps), 90)
    return np.where(np.abs(steps) > STEP * usual, np.sign(steps), 0.0)


def effects_of(terms: Floats, residual: Floats, causes: Floats) -> Floats:
    """Return the coefficient of each cause (n, c) in the residuals (n,); 0 where none is sure.

    Each cause counts by what the loads and the other causes do not explain of it.
    """
    found = np.zeros(causes.shape[1])
    clipped = np.clip(residual, -_limit(residual), _limit(residual))
    for place in range(causes.shape[1]):
        others = np.concatenate((terms, np.delete(causes, place, axis=1)), axis=1)
        cause = causes[:, place]
        total = float(((cause - cause.mean()) ** 2).sum())
        own = cause - others @ np.linalg.lstsq(others, cause, rcond=1e-9)[0]
        left = clipped - others @ np.linalg.lstsq(others, clipped, rcond=1e-9)[0]
        square = float(own @ own)
        if total <= 0 or square < OWN * total:
            continue
        slope = float(own @ left) / square
        rest = left - slope * own
        explained = 1.0 - float(rest @ rest) / max(float(left @ left), np.finfo(float).tiny)
        free = max(len(residual) - others.shape[1] - 1, 1)
        error = np.sqrt(float(rest @ rest) / free / square)
        if explained > SHARE and abs(slope) > DEVIATIONS * error:
            found[place] = slope
    return found


def _limit(residual: Floats) -> float:
    """Return six robust deviations: what single wrong rows count at most."""
    return 6.0 * NORMAL * float(np.median(np.abs(residual))) + np.finfo(float).tiny


def _drift(found: dict[str, float], response: RobustFit) -> list[RigFinding]:
    if not found:
        return []
    name, part = _largest(found, response)
    message = (
        f"the displacements drift by {part:.1%} of the range of {name} from the first row to the "
        "last, whatever the load: warm the rig up, or return to zero between runs and import with "
        "a zero offset"
    )
    return [RigFinding("drift", message, (), {"drift": found})]


def _hysteresis(found: dict[str, float], response: RobustFit) -> list[RigFinding]:
    if not found:
        return []
    name, part = _largest(found, response)
    message = (
        f"loading and unloading differ by {part:.1%} of the range of {name}: hysteresis of the rig "
        "(friction, joints), or loads and displacements shifted in time (lag of joined "
        "logs). The error bars may not hold both branches"
    )
    return [RigFinding("hysteresis", message, (), {"loop": found})]


def _largest(found: dict[str, float], response: RobustFit) -> tuple[str, float]:
    parts = {name: abs(size) / response.range[OUTPUTS.index(name)] for name, size in found.items()}
    name = max(parts, key=lambda one: parts[one])
    return name, parts[name]
