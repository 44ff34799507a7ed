"""What rows show of the errors of their measurement: findings of an import, and `rig_error`.

Hysteresis, drift and observations in two branches are hidden by their mean. More rows do not lower
them, and a mean of both branches lies on neither. So error bars have a separate part for them,
and coverage does not depend on it, as for the discretisation error.
"""

from __future__ import annotations

import math

import numpy as np

from ..table.merging import repeated
from ..table.rows import Floats, LoadRange, Rows
from .channels import channel_findings
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
from .response import RigFinding, response_of, single_row_findings, wrong_rows
from .sequence import MIN_ROWS as MIN_ROWS_IN_ORDER
from .sequence import sequence_errors, sequence_findings

MIN_ROWS = 7  # rows: six loads and a constant
MAX_ROWS = 5_000  # rows that are looked at, some 0.5 s: every k-th of more
NORMAL = 3.0  # kurtosis of noise; that of two branches is 1, and 1.8 where their distance varies


def find(
    rows: Rows, load_range: LoadRange, solved: Floats | None = None, *, linear: bool = True
) -> list[RigFinding]:
    """Return the probable systematic errors of measured rows, in the order of their measurement.

    Parameters
    ----------
    rows : Rows
        Measured rows in the order in which they were measured.
    load_range : LoadRange, N and N·m
    solved : ndarray, shape (6, 6), SI, optional
        Compliance of the component's solves: size and sign that displacements should have. Columns
        of zeros are not known.
    linear : bool
        Whether the component is.
    """
    if len(rows) < MIN_ROWS:
        return range_findings(rows, load_range) if len(rows) else []
    moves = np.eye(6) if solved is None else solved
    still = np.asarray(moves.any(axis=0) & ~moves.any(axis=1))
    rows, findings = channel_findings(sampled(rows), load_range, still)
    if len(rows) < MIN_ROWS:
        return findings
    response = response_of(rows, load_range)
    wrong = wrong_rows(rows, load_range, response)
    findings += single_row_findings(rows, response, wrong)
    good = rows.take(~wrong.any(axis=1))
    if len(good) < MIN_ROWS:
        return findings
    response = response_of(good, load_range)
    slopes = slopes_at_zero(good, load_range, response)
    fit = fit_of(slopes.matrix, slopes.covariance, load_range)
    units = [*range_findings(good, load_range), *size_findings(good, response)]
    known = None if solved is None else fit_of(solved, np.zeros((6, 6, 6)), load_range)
    units = units or unit_findings(fit, known, linear=linear)
    # A lever can make a load's work negative; a wrong sign or unit is no lever.
    skew = symmetry_findings(fit, load_range)
    levers = [one for one in skew if one.cause == "lever"]
    contract = units or turned_findings(fit, known) or levers or sign_findings(fit) or skew
    findings += [*contract, *clearance_findings(slopes, response)]
    return [*findings, *sequence_findings(good, response)]


def sampled(rows: Rows) -> Rows:
    """Return the rows that are looked at, in their order."""
    return rows.take(np.arange(0, len(rows), -(-len(rows) // MAX_ROWS)))


def rig_error(rows: Rows, load_range: LoadRange) -> Floats:
    """Return how far from an answer the part may be besides, (6,), m and rad.

    A loop of hysteresis and a drift, as the order of the rows shows them, or the distance of two
    branches of observations at one wrench. All of each: along a motion answers follow the branch
    that was measured there, and the part may be on the other one.

    Parameters
    ----------
    rows : Rows
        Of one version of a table, in ascending order of `seq`; solved ones show nothing.
    """
    none = np.zeros(rows.displacement.shape[1])
    if not rows.space.is_default:  # the order of rows is looked at for one interface alone
        return none
    measured = (rows.source != "fea") & ~np.isfinite(rows.compliance).all(axis=(1, 2))
    some = rows.take(measured & load_range.holds(rows.wrench))
    if len(some) < MIN_ROWS_IN_ORDER:
        return none
    some = sampled(some)
    response = response_of(some, load_range)
    wrong, good = wrong_rows(some, load_range, response).any(axis=1), some
    if wrong.any():
        good = some.take(~wrong)
        if len(good) < MIN_ROWS_IN_ORDER:
            return none
        response = response_of(good, load_range)
    errors = sequence_errors(good, response, probable=True)
    return np.maximum(np.abs(errors.drift) + errors.loop, 2 * branches(good, load_range))


def error_of_a_reading(error: Floats, interpolation: Floats, noise: Floats) -> Floats:
    """Return the error bars of one more observation at a wrench, (6,), m and rad.

    Parameters
    ----------
    error, interpolation, noise : ndarray, shape (6,), m and rad
        The answer's error, its part by interpolation, and the 95 % noise of one observation.
    """
    return error - interpolation + np.hypot(interpolation, noise)


def branches(rows: Rows, load_range: LoadRange) -> Floats:
    """Return the deviation of observations at one wrench where it is no noise, (6,), m and rad.

    Noise is normal: its kurtosis is 3, and shows to sqrt(24 / n) in n values besides the first of
    each wrench. Observations in two branches are all as far from their mean.
    """
    outputs = rows.displacement.shape[1]
    groups, half_widths = repeated(rows, load_range), np.zeros(outputs)
    for output in range(outputs):
        moved = rows.displacement[:, output]
        measured = np.isfinite(moved)
        groups_of_values = [moved[indices][measured[indices]] for indices in groups]
        several = [values for values in groups_of_values if len(values) > 1]
        deviations = np.concatenate([np.empty(0), *(values - values.mean() for values in several)])
        square = float((deviations**2).mean()) if several else 0.0
        if square <= 0:
            continue
        kurtosis = float((deviations**4).mean()) / square**2
        if kurtosis + 2 * math.sqrt(24 / (len(deviations) - len(several))) < NORMAL:
            half_widths[output] = math.sqrt(square)
    return half_widths
