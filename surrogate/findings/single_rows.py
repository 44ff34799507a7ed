"""Single wrong rows: sentinels of a data logger, and outliers."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..table.rows import Floats, LoadRange, Rows
from ..table.space import OUTPUTS
from .finding import RigFinding
from .response import NORMAL, RobustFit

NEIGHBOURS = 8  # whose median residual is the local misfit of the response
FEWEST = 12  # rows: with fewer the others do not show what one of them should be
DEVIATIONS = 12.0  # of a normal error one in 1e32 lies so far out; heavy tails of real rigs reach 6
TAIL = 14.0  # times what 90 % of the rows keep: a misfit of the response has no single rows
PART = 0.05  # of the output's range: smaller errors do not spoil a table's error bars
SENTINEL = 3.0  # ranges off: no response jumps so far at one row
NINES = 3  # digits of a logger's "no value": 999, 9999, -99999


def wrong_rows(rows: Rows, load_range: LoadRange, response: RobustFit) -> NDArray[np.bool_]:
    """Return which rows have a reading far from those around them, per output, (n, 6)."""
    if len(rows) < FEWEST:
        return np.zeros((len(rows), 6), dtype=bool)
    local = local_residual(rows.wrench / load_range.scale, response.residual)
    size = np.abs(np.where(np.isfinite(local), local, 0.0))
    usual = np.percentile(size, [50, 90], axis=0) * [[NORMAL * DEVIATIONS], [TAIL]]
    limit = np.maximum(usual.max(axis=0), PART * response.range)
    return np.asarray(size > limit)


def local_residual(scaled: Floats, residual: Floats) -> Floats:
    """Return residuals (n, 6) less the median residual of the nearest other rows."""
    count = min(NEIGHBOURS + 1, len(scaled))
    found = KDTree(scaled).query(scaled, k=count)[1]
    near: NDArray[np.intp] = np.asarray(found, dtype=np.intp).reshape(len(scaled), count)
    around = np.array(residual[near])
    around[near == np.arange(len(scaled)).reshape(-1, 1)] = np.nan  # its own
    around[~np.isfinite(around).any(axis=1, keepdims=True).repeat(count, axis=1)] = 0.0
    return np.asarray(residual - np.nanmedian(around, axis=1))


def single_row_findings(
    rows: Rows, response: RobustFit, wrong: NDArray[np.bool_]
) -> list[RigFinding]:
    """Return a finding of sentinels and one of outliers, where `wrong` (n, 6) has some."""
    missed: Floats = np.abs(np.nan_to_num(response.residual))
    far = np.logical_and(wrong, missed > SENTINEL * response.range)
    sentinels = np.zeros_like(wrong)
    for output in range(6):
        values = rows.displacement[:, output]
        repeats = Counter(values[far[:, output]].tolist())
        marked = [value for value, count in repeats.items() if count > 1 or _is_nines(value)]
        sentinels[:, output] = far[:, output] & np.isin(values, marked)
    outliers = np.logical_and(wrong, ~sentinels.any(axis=1, keepdims=True))
    return [*_sentinels(rows, sentinels), *_outliers(rows, response, outliers)]


def _is_nines(value: float) -> bool:
    """Whether the digits of a reading are nines, in whatever unit of length it was written."""
    digits = f"{abs(value):.6e}".split("e")[0].replace(".", "").rstrip("0")
    return len(digits) >= NINES and set(digits) == {"9"}


def _sentinels(rows: Rows, found: NDArray[np.bool_]) -> list[RigFinding]:
    at = np.flatnonzero(found.any(axis=1))
    if not len(at):
        return []
    output = int(np.argmax(found[at[0]]))
    value = float(rows.displacement[at[0], output])
    message = (
        f"{len(at)} rows hold a value that a logger writes where it has none, such as "
        f"{OUTPUTS[output]} = {value:g}: withdraw these rows, or leave the cells empty in the file"
    )
    return [RigFinding("sentinel", message, tuple(rows.seq[at].tolist()), {"value": value})]


def _outliers(rows: Rows, response: RobustFit, found: NDArray[np.bool_]) -> list[RigFinding]:
    at = np.flatnonzero(found.any(axis=1))
    if not len(at):
        return []
    missed = np.abs(np.nan_to_num(response.residual)) / response.range
    worst = np.where(found, missed, 0.0)
    order = at[np.argsort(-worst[at].max(axis=1), kind="stable")]
    place, output = order[0], int(np.argmax(worst[order[0]]))
    message = (
        f"{len(at)} of {len(rows)} rows are far from those around them; the worst is row "
        f"{rows.seq[place]}: {OUTPUTS[output]} is off by {missed[place, output]:.0%} of its range. "
        "Look at these rows, and withdraw those that are wrong: each widens the error bars "
        "everywhere"
    )
    return [RigFinding("outlier", message, tuple(rows.seq[order].tolist()))]
