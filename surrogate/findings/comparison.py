"""Measured rows against what a table answers at their wrenches: rows of before, or solves."""

from __future__ import annotations

import numpy as np

from ..table.rows import Floats
from ..table.space import OUTPUTS
from .response import CONFIDENT, REMARKABLE, RigFinding

MIN_ROWS = 4  # rows: a factor, an offset and two that contradict them
MAX_ROWS = 500  # rows that are compared: a factor is then known to a tenth of their noise


def differences(moved: Floats, expected: Floats, bars: Floats) -> Floats:
    """Return by which factor and offset each output differs, shape (2, 6): -, m and rad.

    A factor is that of the expected displacement that is measured besides. Both are 0 where neither
    is sure and worth a remark. Error bars of answers err together: no number of rows lowers them.

    Parameters
    ----------
    moved, expected, bars : ndarray, shape (n, 6), m and rad
        What was measured, what another table answers, and its error bars; NaN where unknown.
    """
    found = np.zeros((2, moved.shape[1]))
    for output, (y, x, bar) in enumerate(zip(moved.T, expected.T, bars.T, strict=True)):
        known = np.isfinite(y) & np.isfinite(x) & np.isfinite(bar)
        size = float(np.ptp(x[known])) if known.sum() >= MIN_ROWS else 0.0
        if size <= 0:
            continue
        terms = np.column_stack((x[known], np.full(known.sum(), size)))
        off = y[known] - x[known]
        pair = np.linalg.lstsq(terms, off, rcond=None)[0]
        rest = off - terms @ pair
        noise = np.sqrt(float(rest @ rest) / (known.sum() - 2))
        deviation = noise * np.sqrt(np.diag(np.linalg.inv(terms.T @ terms)))
        least = CONFIDENT * deviation + np.median(bar[known]) / size
        if (np.abs(pair) > np.maximum(least, REMARKABLE)).any():
            found[:, output] = pair[0], pair[1] * size
    return found


def comparison_findings(
    moved: Floats, expected: Floats, bars: Floats, *, solves: bool
) -> list[RigFinding]:
    """Return a finding where rows differ from a table; parameters as of `differences`.

    `solves`: the table has solved rows alone, and else measured ones.
    """
    found = differences(moved, expected, bars)
    differ = {
        name: {"factor": 1 + float(factor), "offset": float(offset)}
        for name, factor, offset in zip(OUTPUTS, *found, strict=True)
        if factor or offset
    }
    if not differ:
        return []
    words = ", ".join(
        f"{name} is {one['factor']:.3g} times theirs {one['offset']:+.2g} "
        f"{'m' if name[0] == 'u' else 'rad'}"
        for name, one in differ.items()
    )
    others, remedy = (
        ("the solves", "the part, its material or its clamping are not those of the model")
        if solves
        else ("the rows of the table", "one of the two is wrong, or the part has changed")
    )
    message = (
        f"these rows differ from {others} by more than noise and error bars ({words}): {remedy}. "
        "Answers of a table with both have bars that hold both"
    )
    return [RigFinding("solves" if solves else "campaign", message, (), {"differ": differ})]
