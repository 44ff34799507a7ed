"""From rows to a composition: the axes, and what the full-wrench rows say about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from surrogate.axes import AXES, CLEAN, OffAxis, axis_rows, clean_rows
from surrogate.axistable import AxisTable
from surrogate.compliance import ComplianceFit
from surrogate.composition import Composition
from surrogate.leftout import LeftOut, across_axes, acting_together
from surrogate.rows import Floats, LoadRange, Rows

FULL_FOLDS = 4


def build_composition(
    rows: Rows, load_range: LoadRange, fit: ComplianceFit, off_axis: OffAxis
) -> Composition:
    """Build the three axes with calibrated error bars, and calibrate what they leave out."""
    composition = _axes(rows, load_range, fit, off_axis, bars=True)
    left_out = _left_out(composition, rows, load_range, fit, off_axis)
    return Composition(composition.tables, composition.zero, left_out)


def _axes(
    rows: Rows, load_range: LoadRange, fit: ComplianceFit, off_axis: OffAxis, *, bars: bool
) -> Composition:
    tables = []
    for axis in AXES:
        chosen = axis_rows(rows, load_range, axis, fit, off_axis)
        tables.append(AxisTable(chosen, load_range, bars=bars) if len(chosen.points) else None)
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
    shown, missed = _missed(rows, full, load_range, fit, off_axis)
    if not len(shown):
        return left_out
    # What the axes' own bars explain already is not counted twice: the two add in quadrature.
    explained = composition.many(rows.wrench[shown]).error
    missed = np.sqrt(np.maximum(missed**2 - explained**2, 0.0))
    together, power = acting_together(left_out, rows.wrench[shown], missed)
    return replace(left_out, together=together, power=power, shown=len(shown))


def _missed(
    rows: Rows,
    full: np.ndarray,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
) -> tuple[np.ndarray, Floats]:
    """Return which full-wrench rows could be predicted without themselves, and the errors (h, 6).

    They are held out in folds, so that a row that joined the axes is not asked about itself.
    """
    folds = 1 if off_axis == "exclude" else min(FULL_FOLDS, len(full))
    shown, missed = [np.empty(0, dtype=np.intp)], [np.empty((0, 6))]
    for fold in range(folds):
        held = full[fold::folds]
        rest = np.setdiff1d(np.arange(len(rows)), held)
        composed = _axes(rows.take(rest), load_range, fit, off_axis, bars=False).many(
            rows.wrench[held]
        )
        shown.append(held[composed.told])
        missed.append((rows.displacement[held] - composed.displacement)[composed.told])
    return np.concatenate(shown), np.concatenate(missed)
