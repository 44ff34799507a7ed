"""Measured rows beside the answers of a table at their wrenches: of earlier rows, or of solves."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from ..calibration import CONFIDENCE
from ..table.rows import Floats
from ..table.space import OUTPUTS
from .response import CONFIDENT, REMARKABLE, RigFinding

MIN_COMPARED_ROWS = 4  # rows: a factor, an offset and two that contradict them
MAX_COMPARED_ROWS = 500  # rows that are compared: they determine a factor to a tenth of their noise

BLOCKS = 20  # blocks of consecutive rows, whose errors may be common: drift, a loop, a wrong model


def differences(moved: Floats, expected: Floats, bars: Floats) -> Floats:
    """Return the factor less one and the offset of each output, (2, 6): dimensionless, m and rad.

    They are those of ``moved = factor * expected + offset``; both are 0 unless one is certain and
    large enough for a finding. Errors of answers are common to all rows, so their error bars count
    in full for any number of rows.

    `moved`, `expected`, `bars` (n, 6), m and rad: measured, the answers of another table, and their
    error bars; NaN where unknown.
    """
    known = np.isfinite(bars)
    size, pair, deviation, _ = _fitted(moved, np.where(known, expected, np.nan))
    is_fitted = size > 0
    differs = np.zeros(len(size), dtype=bool)
    bar = np.nanmedian(np.where(known, bars, np.nan)[:, is_fitted], axis=0)
    least = CONFIDENT * deviation[:, is_fitted] + bar / size[is_fitted]
    is_large = np.abs(pair[:, is_fitted]) > np.maximum(least, REMARKABLE)
    differs[is_fitted] = is_large.any(axis=0)
    return np.where(differs, pair * np.stack((np.ones_like(size), size)), 0.0)


def beyond_noise(moved: Floats, expected: Floats) -> Floats:
    """Return the difference of answers and rows by a factor and an offset, shape (m,), m and rad.

    The difference is that at the ends of each output's range. A factor or offset within its noise,
    at the confidence of error bars in all outputs, counts as 0; the squared noise is subtracted
    from the square of a larger one.

    `moved`, `expected` (n, m), m and rad: measured, and the answers of a table; NaN where unknown.
    """
    size, pair, deviation, freedom = _fitted(moved, expected)
    by_chance = stdtrit(freedom, 1 - (1 - CONFIDENCE) / (2 * pair.size)) * deviation
    return np.sqrt(np.maximum(pair**2 - by_chance**2, 0.0)).sum(axis=0) * size


def scale_factor(
    moved: Floats, expected: Floats, bars: Floats, uncertainty: Floats
) -> tuple[float, float, float]:
    """Return the factor k of moved = k expected, its 95 % half width, and the answers' part of it.

    Least squares through zero, weighted by stated uncertainties where all rows have them. The half
    width is that of independent rows or of blocks of consecutive rows, the larger one, plus the
    error that the answers may have in common; fewer than `MIN_COMPARED_ROWS` have none. NaN where
    unknown.

    `moved`, `expected`, `bars`, `uncertainty` (n,), m or rad: of one output, in the order of the
    measurement; NaN where unknown.
    """
    known = np.isfinite(moved) & np.isfinite(expected)
    y, x, bar, stated = (values[known] for values in (moved, expected, bars, uncertainty))
    if not x.any():
        return np.nan, np.nan, np.nan
    weights = np.ones(len(x))
    if (stated > 0).all():
        weights = (stated.min() / stated) ** 2
    total = weights @ x**2
    factor = weights @ (x * y) / total
    if len(x) < MIN_COMPARED_ROWS:
        return float(factor), np.nan, np.nan
    off = y - factor * x
    blocks = [part.sum() for part in np.array_split(weights * x * off, min(BLOCKS, len(x)))]
    deviations = np.array(
        (
            np.sqrt(weights @ off**2 / (len(x) - 1) / total),
            np.sqrt(np.square(blocks).sum() * len(blocks) / (len(blocks) - 1)) / total,
        )
    )
    freedom = np.array((len(x) - 1, len(blocks) - 1))
    noise = (stdtrit(freedom, (1 + CONFIDENCE) / 2) * deviations).max()
    of_answers = weights @ (np.abs(x) * bar) / total
    return float(factor), float(noise + of_answers), float(of_answers)


def _fitted(moved: Floats, expected: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit factor less one and offset of each output: range, the pair, deviations, freedom.

    Shapes (m,), (2, m), (2, m) and (m,); offsets are over the range. An output with too few rows
    has zeros, and 1 degree of freedom.
    """
    size, freedom = np.zeros(moved.shape[1]), np.ones(moved.shape[1])
    pair, deviation = np.zeros((2, 2, moved.shape[1]))
    for output, (y, x) in enumerate(zip(moved.T, expected.T, strict=True)):
        known = np.isfinite(y) & np.isfinite(x)
        range_of_output = float(np.ptp(x[known])) if known.sum() >= MIN_COMPARED_ROWS else 0.0
        if range_of_output <= 0:
            continue
        terms = np.column_stack((x[known], np.full(known.sum(), range_of_output)))
        off = y[known] - x[known]
        pair[:, output] = np.linalg.lstsq(terms, off, rcond=None)[0]
        residual = off - terms @ pair[:, output]
        size[output], freedom[output] = range_of_output, known.sum() - 2
        noise = np.sqrt(float(residual @ residual) / freedom[output])
        deviation[:, output] = noise * np.sqrt(np.diag(np.linalg.inv(terms.T @ terms)))
    return size, pair, deviation, freedom


def comparison_findings(
    moved: Floats, expected: Floats, bars: Floats, *, solves: bool
) -> list[RigFinding]:
    """Return a finding where rows differ from a table; parameters are those of `differences`.

    `solves`: whether the table has solved rows alone, or measured ones.
    """
    differ = {
        name: {"factor": 1 + float(factor), "offset": float(offset)}
        for name, factor, offset in zip(OUTPUTS, *differences(moved, expected, bars), strict=True)
        if factor or offset
    }
    if not differ:
        return []
    # Like the factor, an offset has three digits of the output's range; a smaller one is rounding.
    least = dict(zip(OUTPUTS, 5e-4 * np.nan_to_num(np.abs(expected)).max(axis=0), strict=True))
    listed = ", ".join(
        f"{name} is {round(pair['factor'], 3) + 0:.4g} times theirs"
        + (
            f" {pair['offset']:+.2g} {'m' if name[0] == 'u' else 'rad'}"
            if abs(pair["offset"]) > least[name]
            else ""
        )
        for name, pair in differ.items()
    )
    others, remedy = (
        ("the solves", "Correct geometry, material or clamping in the model")
        if solves
        else ("the table's rows", "Check rig and part")
    )
    message = (
        f"these rows differ from {others} by more than noise and error bars ({listed}). {remedy}, "
        "or withdraw an import. Until then the error bars cover both"
    )
    return [RigFinding("solves" if solves else "campaign", message, (), {"differ": differ})]
