"""From rows to a composition: the axes, and what the other rows say about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrogate.composition.axis_table import AxisTable
from surrogate.composition.composition import AtRest, Composition
from surrogate.influence import Influence, fit_output, monomials, shown_by
from surrogate.leftout import LeftOut, across_axes, acting_together
from surrogate.table.axes import AXES, CLEAN, AxisRows, OffAxis, axis_rows, clean_rows
from surrogate.table.compliance import LEAST, SMALLEST, ComplianceFit
from surrogate.table.rows import Floats, LoadRange, Rows

FULL_FOLDS = 4
ROUNDING = 1e-9  # of displacements
ON_KINK = 2.0  # times the bend, what may be missing of it on a kink
MANY_FULL = 400  # full-wrench rows above which only the first fold is held out
MOST_SHOWN = 900  # rows that the polynomial of what is left out is fitted to


def build_composition(
    rows: Rows, load_range: LoadRange, fit: ComplianceFit, off_axis: OffAxis
) -> Composition:
    """Build the three axes with calibrated error bars, and calibrate what they leave out."""
    composition = axes_of(rows, load_range, fit, off_axis)
    left_out = _left_out(composition, rows, load_range, fit, off_axis)
    return Composition(composition.tables, composition.rest, left_out)


def axes_of(
    rows: Rows, load_range: LoadRange, fit: ComplianceFit, off_axis: OffAxis
) -> Composition:
    """Build the three axes, without what they leave out."""
    repeatable = bool(len(rows)) and bool((rows.source == "fea").all())
    tables = []
    for axis in AXES:
        chosen = axis_rows(rows, load_range, axis, fit, off_axis)
        if off_axis == "correct" and not chosen.clean.all():
            alone = axis_rows(rows, load_range, axis, fit, "exclude")
            chosen = _worth_joining(chosen, alone, load_range, fit)
        table = AxisTable(chosen, load_range, repeatable=repeatable) if len(chosen.points) else None
        tables.append(table)
    silent = LeftOut(tuple(load_range.scale.tolist()))
    return Composition(tables, at_rest(rows, load_range, tables), silent)


def _worth_joining(
    joined: AxisRows, alone: AxisRows, load_range: LoadRange, fit: ComplianceFit
) -> AxisRows:
    """Return the points of an axis without those that its clean rows know better.

    What is left of a full wrench's displacement after its off-axis part is as uncertain as the
    linear fit. On a nonlinear component that is far more than the error between clean rows, and
    such a row would only put its own nonlinear part into all three axes.
    """
    if len(alone.points) < 2:
        return joined
    table = AxisTable(alone, load_range)
    if not table.sound:
        return joined
    found = table.interpolant.locate(joined.points)
    sound = (found >= 0) & (table.weak_at[found] == 0)
    bars = table.read(np.maximum(found, 0), joined.points).bars
    outputs = list(joined.axis.outputs)
    rounding = ROUNDING * (np.abs(fit.matrix) @ load_range.scale)[outputs]
    better = sound & (fit.bar[outputs] > bars + rounding).any(axis=1)
    return joined.take(joined.clean | ~better)


def at_rest(rows: Rows, load_range: LoadRange, tables: Sequence[AxisTable | None]) -> AtRest:
    """Return what the component does without load, as the rows or else the axes tell it.

    Measured tables have offsets, and not all have a row at zero load. Where nothing tells it, it is
    taken to be zero, and may be as wrong as the rows' displacements are large.
    """
    none = (0.0,) * 6
    if not len(rows):
        return AtRest(none, none, none, none, known=False)
    largest = np.abs(rows.displacement).max(axis=0)
    kinds = np.repeat([largest[:3].max(), largest[3:].max()], 3)
    rounding = tuple(np.maximum(LEAST * kinds, SMALLEST).tolist())
    unloaded = (np.abs(rows.wrench) <= CLEAN * load_range.scale).all(axis=1)
    if unloaded.any():
        moved = rows.displacement[unloaded].mean(axis=0)
        doubt = np.nan_to_num(rows.uncertainty[unloaded]).max(axis=0)
        return AtRest(tuple(moved.tolist()), tuple(doubt.tolist()), none, rounding, known=True)
    read = [found for table in tables if table is not None for found in _read_at_zero(table)]
    if not read:
        return AtRest(none, tuple(largest.tolist()), none, rounding, known=False)
    moved, bars, bends = (np.array(each) for each in zip(*read, strict=True))
    spread = np.maximum(np.ptp(moved, axis=0) / 2, bars.mean(axis=0))
    return AtRest(
        tuple(moved.mean(axis=0).tolist()),
        tuple(spread.tolist()),
        tuple(bends.mean(axis=0).tolist()),
        rounding,
        known=True,
    )


def _read_at_zero(table: AxisTable) -> list[tuple[Floats, Floats, Floats]]:
    """Return outputs, bars and bends, (6,) each, at zero load, or nothing outside the hull."""
    origin = np.zeros((1, 3))
    found = table.interpolant.locate(origin)
    if found[0] < 0:
        return []
    moved, bars, bends = table.read_six(found, origin)
    # Zero is on the line of one moment alone, and errs to the side that this line does.
    bars[0, 3:] = np.hypot(bars[0, 3:], table.lean)
    return [(moved[0], bars[0], bends[0])]


def _left_out(
    composition: Composition,
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
) -> LeftOut:
    if not len(rows):
        return composition.left_out
    clean = clean_rows(rows, load_range)
    full = ~clean.any(axis=1)
    held = _predicted(composition, rows, np.arange(len(rows)))
    if full.any() and off_axis != "exclude":
        held = _hold_out_full(held, rows, np.flatnonzero(full), load_range, fit, off_axis)
    influence, missed = _fit_influence(held, rows, clean, load_range)
    # What the axes' own bars and the rows' noise explain is not counted twice: they add in
    # quadrature.
    explained = held.rest**2 + row_noise(composition) ** 2
    beyond = np.sqrt(np.maximum(missed**2 - explained, 0.0))
    # These rows lie where the axis' force is zero, and on a kink there bends are too small.
    off_kink = np.sqrt(np.maximum(missed**2 - explained - (ON_KINK * held.bend) ** 2, 0.0))
    across = across_axes(rows.wrench, off_kink, clean, load_range.scale)
    left_out = replace(composition.left_out, across=across, influence=influence)
    shown = full & held.told
    if not shown.any():
        return left_out
    together, power = acting_together(left_out, rows.wrench[shown], beyond[shown])
    return replace(left_out, together=together, power=power, shown=int(shown.sum()))


def row_noise(composition: Composition) -> Floats:
    """Return the 95 % half width of a row's own noise, shape (6,), as the axes show it."""
    noise = np.zeros(6)
    for axis, table in zip(AXES, composition.tables, strict=True):
        if table is not None:
            outputs = list(axis.outputs)
            noise[outputs] = np.maximum(noise[outputs], table.bars.noise)
    return noise


class _Held(NamedTuple):
    """All rows predicted by the axes, full wrenches by axes that they did not join.

    `missed` is true less composed less bend, (n, 6), zero where not told; `rest` the bars' rest.
    """

    missed: Floats
    bend: Floats
    rest: Floats
    told: NDArray[np.bool_]


def _predicted(composition: Composition, rows: Rows, places: np.ndarray) -> _Held:
    composed = composition.many(rows.wrench[places])
    missed = rows.displacement[places] - composed.displacement - composed.bend
    missed[~composed.told] = 0.0
    return _Held(missed, composed.bend, composed.rest, composed.told)


def _hold_out_full(
    held: _Held,
    rows: Rows,
    full: np.ndarray,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
) -> _Held:
    """Predict full-wrench rows, in folds, so that none that joined the axes is asked about itself.

    Its own residual would be in the bars around it. Of many rows one fold says enough.
    """
    held.told[full] = False
    held.missed[full] = 0.0
    folds = min(FULL_FOLDS, len(full))
    for fold in range(folds if len(full) <= MANY_FULL else 1):
        places = full[fold::folds]
        rest = rows.take(np.setdiff1d(np.arange(len(rows)), places))
        found = _predicted(axes_of(rest, load_range, fit, off_axis), rows, places)
        for whole, part in zip(held, found, strict=True):
            whole[places] = part
    return held


def _fit_influence(
    held: _Held, rows: Rows, clean: NDArray[np.bool_], load_range: LoadRange
) -> tuple[Influence, Floats]:
    """Fit the polynomial of what is left out; return it and what it misses, (n, 6), at the rows.

    What it misses at a row it was fitted to is what cross-validation misses there.
    """
    coefficients, missed = [], held.missed.copy()
    chosen = np.zeros(len(rows), dtype=bool)
    chosen[np.random.default_rng(20170726).permutation(len(rows))[:MOST_SHOWN]] = True
    x, tangent = rows.wrench / load_range.scale, rows.compliance * load_range.scale
    for output in range(6):
        own = clean[:, output] if output < 3 else clean.any(axis=1)
        valued = chosen & held.told & ~own
        slopes = np.where(chosen[:, None], tangent[:, output], np.nan)
        shown = shown_by(output, x, held.missed[:, output], valued, slopes)
        found, left = fit_output(output, shown)
        coefficients.append(found)
        places = np.flatnonzero(valued)
        missed[:, output] -= monomials(x) @ found
        missed[places, output] = left[: len(places)]
    influence = Influence(np.array(coefficients), load_range.scale.tolist())
    return influence, np.where(held.told[:, None], missed, 0.0)
