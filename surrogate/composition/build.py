"""From rows to a composition: which rows each axis uses, and the answer at no load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..table.axes import AXES, CLEAN, AxisRows, LoadAxis, OffAxis, axis_rows, clean_rows
from ..table.compliance import ComplianceFit
from ..table.rows import LoadRange, Rows
from ..table.thinning import evenly_chosen
from .axis_table import SOUND, AxisTable, axis_table
from .composition import AtRest, Composition


def build_composition(
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
    before: Composition | None = None,
) -> Composition:
    """Build the three axes over rows within the load range.

    Parameters
    ----------
    before : Composition, optional
        Of another version of the table: an axis whose points have not changed is taken from it, as
        it would be made again to the last bit.
    """
    kept = before.tables if before is not None else (None,) * len(AXES)
    tables = [
        _axis_table(rows, load_range, axis, fit, off_axis, own)
        for axis, own in zip(AXES, kept, strict=True)
    ]
    at_rest = answer_at_rest(rows, load_range, tables)
    return Composition(tables, at_rest, fit, load_range.scale, before)


def _axis_table(
    rows: Rows,
    load_range: LoadRange,
    axis: LoadAxis,
    fit: ComplianceFit,
    off_axis: OffAxis,
    before: AxisTable | None,
) -> AxisTable | None:
    clean = axis_rows(rows, load_range, axis, fit, "exclude")
    table = _thinned(clean, load_range, before) if len(clean.points) else None
    if off_axis == "exclude" or clean_rows(rows, load_range).any(axis=1).all():
        return table
    chosen = axis_rows(rows, load_range, axis, fit, off_axis)
    if off_axis == "correct" and table is not None:
        chosen = _worth_joining(chosen, table)
    if not len(chosen.points):
        return None
    if table is not None and chosen.clean.all():
        return table
    return _thinned(chosen, load_range, before)


def _thinned(rows: AxisRows, load_range: LoadRange, before: AxisTable | None) -> AxisTable:
    """Return the table of an axis' rows, or of an even choice of them where they are many."""
    chosen = evenly_chosen(rows.points)
    if chosen.all():
        return axis_table(rows, load_range, before)
    return axis_table(rows.take(chosen), load_range, before, rows.take(~chosen))


def _worth_joining(joined: AxisRows, table: AxisTable) -> AxisRows:
    """Return the points of an axis without those between its clean rows.

    What is left of a full wrench's displacement after its off-axis part is as uncertain as the
    linear fit. Between clean rows that is far more than their own error, and such a row would only
    put its nonlinear part into all three axes; beyond them it is better than nothing.
    """
    if not table.enough:
        return joined
    found = table.triangulation.locate(joined.points)
    between = (found >= 0) & (table.shape_state[found] == SOUND)
    return joined.take(joined.clean | ~between)


def answer_at_rest(rows: Rows, load_range: LoadRange, tables: Sequence[AxisTable | None]) -> AtRest:
    """Return the row at zero load, or what the axes whose hull holds zero interpolate there.

    Of several axes that is the mean, with half their spread in the bar (measured tables
    have offsets). Without any the answer is zero and not known: its bar is the rows' size.
    """
    unloaded = (np.abs(rows.wrench) <= CLEAN * load_range.scale).all(axis=1)
    if unloaded.any():
        found = rows.displacement[unloaded]
        stored = np.nan_to_num(rows.uncertainty[unloaded]).max(axis=0)
        return AtRest(found.mean(axis=0), np.maximum(np.ptp(found, axis=0) / 2, stored), True)
    readings = [table.read(np.zeros((1, 3))) for table in tables if table is not None]
    inside = [reading for reading in readings if reading.inside[0]]
    if not inside:
        size = np.abs(rows.displacement).max(axis=0, initial=0.0)
        return AtRest(np.zeros(6), size, False)
    outputs = np.concatenate([reading.outputs for reading in inside])
    own = np.concatenate([reading.rest for reading in inside])
    return AtRest(outputs.mean(axis=0), np.ptp(outputs, axis=0) / 2 + own.mean(axis=0), True)
