"""A robust reference response of measured rows, the single rows far from it, and `RigFinding`.

A polynomial of third degree in each load, with products of two loads where the rows are enough for
them, fitted by iteratively reweighted least squares with Tukey's biweight (Beaton and Tukey 1974):
single wrong rows do not change it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..table.polynomial import RANK, terms_of
from ..table.rows import Floats, LoadRange, Rows
from ..table.space import OUTPUTS

# Standard deviations: a cause is reported if its interval of this half width excludes zero.
CONFIDENT = 8.0
REMARKABLE = 0.01  # part of an output's range: smaller effects are within a usual tolerance

ROUNDS = 30  # rounds of reweighting: the weights settle after 10 to 20
BIWEIGHT = 4.685  # deviations: 95 % efficient for normal errors (Holland and Welsch 1977)
NORMAL = 1.4826  # deviation over median absolute deviation, of normal errors
EXACT = 1e-4  # part of an output's range: residuals below it are no error worth a remark

NEIGHBOURS = 8  # rows whose median residual is the local misfit of the response
MIN_ROWS_TO_JUDGE = 12  # rows: with fewer the others do not show the expected value of a row
# Deviations of an outlier: of normal errors 1 in 1e32 lies so far out; heavy tails of real rigs
# reach 6.
DEVIATIONS = 12.0
# Ratio to the residual of 90 % of the rows: beyond it an outlier is a misfit of the response.
TAIL = 14.0
MIN_OUTLIER = 0.05  # part of the output's range: smaller errors do not spoil a table's error bars
SENTINEL = 3.0  # ranges of deviation: no response jumps so far at one row
NINES = 3  # nines of a logger's "no value": 999, 9999, -99999

Cause = Literal[
    "dead",
    "noise",
    "clipped",
    "stuck",
    "sentinel",
    "outlier",
    "sign",
    "unit",
    "lever",
    "asymmetry",
    "clearance",
    "campaign",
    "solves",
    "drift",
    "hysteresis",
    "clock",
    "session",
    "scale",
    "zero",
    "correlated",
    "twice",
]
MAX_LISTED_ROWS = 500  # rows listed with a finding, for a page's list; `count` has their number


@dataclass(frozen=True)
class RigFinding:
    """One probable systematic error."""

    cause: Cause
    message: str  # what is wrong, by how much, and what to do
    # numbers (`seq`) of the rows to withdraw, worst first; empty if all rows are concerned
    rows: tuple[int, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)  # the figures of the message, SI

    def body(self) -> dict[str, Any]:
        """Return the finding as JSON-able values."""
        return {
            "cause": self.cause,
            "message": self.message,
            "rows": list(self.rows[:MAX_LISTED_ROWS]),
            "count": len(self.rows),
            **self.numbers,
        }


class RobustFit(NamedTuple):
    """The fitted response at the rows."""

    expected: Floats  # (n, 6), m and rad
    # (n, 6), m and rad: measured less expected; NaN where an output was not measured
    residual: Floats
    deviation: Floats  # (6,), m and rad: robust standard deviation of the residuals
    range: Floats  # (6,), m and rad: between the 2nd and 98th percentile of each expected output
    terms: Floats  # (n, t): the polynomial's terms at the rows, dimensionless


def response_of(rows: Rows, load_range: LoadRange) -> RobustFit:
    """Return the robust response of rows with at least two wrenches."""
    terms = terms_of(rows.wrench / load_range.scale)
    moved = rows.displacement
    expected = np.stack([fitted(terms, column) for column in moved.T], axis=1)
    residual = moved - expected
    known = [column[np.isfinite(column)] for column in expected.T]
    ends = np.array(
        [np.percentile(values, [2, 98]) if len(values) else (0.0, 0.0) for values in known]
    ).T
    size = np.maximum(ends[1] - ends[0], np.finfo(float).tiny)
    deviation = EXACT * size
    for output, column in enumerate(residual.T):
        off = column[np.isfinite(column)]
        if len(off):
            usual = NORMAL * float(np.median(np.abs(off - np.median(off))))
            deviation[output] = max(usual, deviation[output])
    return RobustFit(expected, residual, deviation, size, terms)


def fitted(terms: Floats, moved: Floats) -> Floats:
    """Return the robust fit of values (n,), NaN where unknown, at all rows, (n,).

    The result is NaN everywhere if fewer than two values are known.
    """
    known = np.isfinite(moved)
    if known.sum() < 2:
        return np.full(len(moved), np.nan)
    _, sizes, axes = np.linalg.svd(terms[known], full_matrices=False)
    spanned = sizes > RANK * sizes[0]
    basis = terms @ (axes[spanned].T / sizes[spanned]) * np.sqrt(known.sum())
    x, y = basis[known], moved[known]
    floor = EXACT * max(float(np.ptp(y)), np.finfo(float).tiny)
    coefficients = _solved(x, y, np.ones(len(y)))
    # Start from least absolute deviations: from plain least squares, wrong rows keep their weight.
    for round_ in range(ROUNDS):
        residual = np.abs(y - x @ coefficients)
        scale = max(NORMAL * float(np.median(residual)), floor)
        if round_ < ROUNDS // 2:
            weights = scale / np.maximum(residual, scale / 10)
        else:
            weights = np.clip(1.0 - (residual / (BIWEIGHT * scale)) ** 2, 0.0, None) ** 2
        coefficients = _solved(x, y, weights)
    return basis @ coefficients


def _solved(x: Floats, y: Floats, weights: Floats) -> Floats:
    """Return weighted least squares (t,) on a basis (n, t) of columns of length sqrt(n)."""
    weighted = x * weights[:, None]
    normal = x.T @ weighted + RANK * max(float(weights.sum()), 1.0) * np.eye(x.shape[1])
    return np.asarray(np.linalg.solve(normal, weighted.T @ y), dtype=float)


def wrong_rows(rows: Rows, load_range: LoadRange, response: RobustFit) -> NDArray[np.bool_]:
    """Return which outputs of which rows deviate far from the rows around them, (n, 6)."""
    if len(rows) < MIN_ROWS_TO_JUDGE:
        return np.zeros(rows.displacement.shape, dtype=bool)
    local = local_residual(rows.wrench / load_range.scale, response.residual)
    size = np.abs(np.where(np.isfinite(local), local, 0.0))
    usual = np.percentile(size, [50, 90], axis=0) * [[NORMAL * DEVIATIONS], [TAIL]]
    limit = np.maximum(usual.max(axis=0), MIN_OUTLIER * response.range)
    return np.asarray(size > limit)


def local_residual(scaled: Floats, residual: Floats) -> Floats:
    """Return residuals (n, 6) less the median residual of the nearest other rows."""
    count = min(NEIGHBOURS + 1, len(scaled))
    neighbours = KDTree(scaled).query(scaled, k=count)[1]
    near: NDArray[np.intp] = np.asarray(neighbours, dtype=np.intp).reshape(len(scaled), count)
    around = np.array(residual[near])
    around[near == np.arange(len(scaled)).reshape(-1, 1)] = np.nan  # the row itself
    around[~np.isfinite(around).any(axis=1, keepdims=True).repeat(count, axis=1)] = 0.0
    return np.asarray(residual - np.nanmedian(around, axis=1))


def single_row_findings(
    rows: Rows, response: RobustFit, wrong: NDArray[np.bool_]
) -> list[RigFinding]:
    """Return a finding of sentinels and one of outliers, where `wrong` (n, 6) has some."""
    residual: Floats = np.abs(np.nan_to_num(response.residual))
    far = np.logical_and(wrong, residual > SENTINEL * response.range)
    sentinels = np.zeros_like(wrong)
    for output in range(6):
        values = rows.displacement[:, output]
        repeats = Counter(values[far[:, output]].tolist())
        marked = [value for value, count in repeats.items() if count > 1 or is_nines(value)]
        sentinels[:, output] = far[:, output] & np.isin(values, marked)
    outliers = np.logical_and(wrong, ~sentinels.any(axis=1, keepdims=True))
    return [*_sentinels(rows, sentinels), *_outliers(rows, response, outliers)]


def is_nines(value: float) -> bool:
    """Return whether the digits of an observation are nines, in any unit of length."""
    digits = f"{abs(value):.6e}".split("e")[0].replace(".", "").rstrip("0")
    return len(digits) >= NINES and set(digits) == {"9"}


def _sentinels(rows: Rows, flagged: NDArray[np.bool_]) -> list[RigFinding]:
    """Return the finding of flagged outputs (n, 6) that hold a logger's mark for "no value"."""
    at = np.flatnonzero(flagged.any(axis=1))
    if not len(at):
        return []
    output = int(np.argmax(flagged[at[0]]))
    value = float(rows.displacement[at[0], output])
    rows_have = "1 row has" if len(at) == 1 else f"{len(at)} rows have"
    message = (
        f"{rows_have} a value that a logger writes for a missing reading, such as "
        f"{OUTPUTS[output]} = {value:g}; withdraw these rows, or leave the cells empty in the file"
    )
    return [RigFinding("sentinel", message, tuple(rows.seq[at].tolist()), {"value": value})]


def _outliers(rows: Rows, response: RobustFit, flagged: NDArray[np.bool_]) -> list[RigFinding]:
    """Return the finding of flagged outputs (n, 6) that are outliers, worst first."""
    at = np.flatnonzero(flagged.any(axis=1))
    if not len(at):
        return []
    residual = np.abs(np.nan_to_num(response.residual)) / response.range
    worst = np.where(flagged, residual, 0.0)
    order = at[np.argsort(-worst[at].max(axis=1), kind="stable")]
    row = order[0]
    output = int(np.argmax(worst[order[0]]))
    ratio = float(residual[row, output])
    off = f"{ratio:.1%} of its range" if ratio < 10 else f"{ratio:,.0f} times its range"
    message = (
        f"{len(at)} of {len(rows)} rows differ from those around them; the worst is row "
        f"{rows.seq[row]}, whose {OUTPUTS[output]} is off by {off}. "
        "Check these rows, and withdraw the wrong ones"
    )
    return [RigFinding("outlier", message, tuple(rows.seq[order].tolist()))]
