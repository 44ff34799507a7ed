"""The answer of the 6x6 compliance, for one wrench and in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surrogate.answers import Answer, judged
from surrogate.axes import CLEAN
from surrogate.compliance import ComplianceFit
from surrogate.rows import LOAD_UNITS, LOADS, LoadRange, Tolerance


def answer_linearly(
    fit: ComplianceFit, load_range: LoadRange, wrench: Sequence[float], tolerance: Tolerance | None
) -> Answer:
    """Return the compliance times one wrench, and why it is not covered where it is not."""
    loads = np.array(wrench, dtype=float)
    displacement = tuple((fit.matrix @ loads).tolist())
    unknown = ~fit.known & (np.abs(loads) > CLEAN * load_range.scale)
    if unknown.any():
        reason = f"no row tells the influence of {LOADS[int(np.argmax(unknown))]}"
        return Answer(displacement, None, "outside", reason, "linear")
    error = tuple(fit.bar.tolist())
    beyond = (loads < load_range.low) | (loads > load_range.high)
    if not beyond.any():
        return judged(displacement, error, tolerance, "linear")
    load = int(np.argmax(beyond))
    low, high = load_range.low[load], load_range.high[load]
    reason = (
        f"{LOADS[load]} = {loads[load]:.6g} {LOAD_UNITS[load]} is outside "
        f"the load range, {low:.6g}..{high:.6g} {LOAD_UNITS[load]}"
    )
    return Answer(displacement, error, "outside", reason, "linear")
