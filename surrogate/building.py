"""From rows to a composition: the axes, and what the full-wrench rows say about them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from surrogate.axes import AXES, CLEAN, OffAxis, axis_rows, clean_rows
from surrogate.axistable import AxisTable
from surrogate.compliance import ComplianceFit
from surrogate.composition import Composition
from surrogate.leftout import LeftOut, across_axes, acting_together
from surrogate.rows import Floats, LoadRange, Rows

FULL_FOLDS = 4
MANY_FULL = 400  # full-wrench rows above which only the first fold is held out


def build_composition(
    rows: Rows, load_range: LoadRange, fit: ComplianceFit, off_axis: OffAxis
) -> Composition:
    """Build the three axes with calibrated error bars, and calibrate what they leave out."""
    composition = _axes(rows, load_range, fit, off_axis)
    left_out = _left_out(composition, rows, load_range, fit, off_axis)
    return Composition(composition.tables, composition.zero, left_out)


def _axes(rows: Rows, load_range: LoadRange, fit: ComplianceFit, off_axis: OffAxis) -> Composition:
    tables = []
    for axis in AXES:
        chosen = axis_rows(rows, load_range, axis, fit, off_axis)
        tables.append(AxisTable(chosen, load_range) if len(chosen.points) else None)
    silent = LeftOut(tuple(load_range.scale.tolist()))
    return Composition(tables, zero_displacement(rows, load_range), silent)


def zero_displacement(rows: Rows, load_range: LoadRange) -> list[float]:
    """Return the mean displacement, m and rad, of the rows at zero load, or zeros."""
    unloaded = (np.abs(rows.wrench) <= CLEAN * load_range.scale).all(axis=1)
    return rows.displacement[unloaded].mean(axis=0).tolist() if unloaded.any() else [0.0] * 6


def _left_out(
    composition: Composition,
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
) -> LeftOut:
    clean = clean_rows(rows, load_range)

    across = across_axes(rows.wrench, rows.displacement, clean, load_range.scale, composition.many)
    left_out = replace(composition.left_out, across=across)
    full = np.flatnonzero(~clean.any(axis=1))
    if not len(full):
        return left_out
    held = _hold_out_full(composition, rows, full, load_range, fit, off_axis)
    if not len(held.shown):
        return left_out
    # What the axes' own bars explain already is not counted twice: the two add in quadrature.
    missed = np.sqrt(np.maximum(held.missed**2 - held.bars**2, 0.0))
    together, power = acting_together(left_out, rows.wrench[held.shown], missed)
    return replace(left_out, together=together, power=power, shown=len(held.shown))


class _Held(NamedTuple):
    """Full-wrench rows predicted without themselves: places (h,), errors and axis bars (h, 6)."""

    shown: np.ndarray
    missed: Floats
    bars: Floats


def _hold_out_full(
    composition: Composition,
    rows: Rows,
    full: np.ndarray,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
) -> _Held:
    """Predict full-wrench rows, in folds, so that none that joined the axes is asked about itself.

    Its own residual would be in the bars around it. Of many rows one fold says enough.
    """
    if off_axis == "exclude":
        return _predicted(composition, rows, full)
    folds = min(FULL_FOLDS, len(full))
    parts = []
    for fold in range(folds if len(full) <= MANY_FULL else 1):
        held = full[fold::folds]
        rest = rows.take(np.setdiff1d(np.arange(len(rows)), held))
        parts.append(_predicted(_axes(rest, load_range, fit, off_axis), rows, held))
    return _Held(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _predicted(composition: Composition, rows: Rows, held: np.ndarray) -> _Held:
    composed = composition.many(rows.wrench[held])
    missed = rows.displacement[held] - composed.displacement
    told = composed.told
    return _Held(held[told], missed[told], composed.error[told])
