"""What `griddata` and `additive` err by at rows that they are made without."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..composition.axis_table import AxisTable
from ..composition.composition import Composition
from ..table.axes import AXES
from ..table.rows import Floats, Rows

MOST = 6000  # rows composed for this: three times what one axis leaves out


class AxesErrors(NamedTuple):
    """Errors (k, 6), m and rad, of two methods at k rows."""

    griddata: Floats
    additive: Floats


def axes_errors(rows: Rows, composition: Composition) -> AxesErrors:
    """Return the errors at the rows that each axis they belong to was triangulated without.

    Composition is linear in what the axes answer: an answer without a row differs from that with
    it by what its axes then miss at it. A full wrench that is no axis' own is in no answer anyway.
    """
    deviation, member, left = np.zeros((3, len(rows), 6)), *np.zeros((2, 3, len(rows)), dtype=bool)
    for index, table in enumerate(composition.tables):
        if table is not None:
            _put_deviations(table, deviation[index], member[index], left[index])
    known = np.flatnonzero((left | ~member).all(axis=0))
    if len(known) > MOST:
        known = known[np.linspace(0, len(known) - 1, MOST).astype(np.intp)]
    some, deviation, member = rows.take(known), deviation[:, known], member[:, known]
    composed = composition.evaluate(some.wrench)
    clean = np.zeros(len(rows), dtype=bool)
    for table in composition.tables:
        if table is not None:
            clean[[group[0] for group in table.rows.members]] |= table.rows.clean
    # A moment alone belongs to two axes, and both answer it once together.
    often = np.where(clean[known], 1.0 / np.maximum(member.sum(axis=0), 1), 1.0)
    additive = composed.additive - some.displacement + often[:, None] * deviation.sum(axis=0)
    griddata = additive.copy()
    for index, axis in enumerate(AXES):
        own = axis.outputs[0]
        griddata[:, own] = composed.griddata[:, own] - some.displacement[:, own]
        griddata[:, own] += deviation[index, :, own]
    return AxesErrors(griddata, additive)


def _put_deviations(
    table: AxisTable, deviation: Floats, member: NDArray[np.bool_], left: NDArray[np.bool_]
) -> None:
    """Fill, of all rows, what an axis misses them by, (n, 6), and which are its points, (n,)."""
    for group in table.rows.members:
        member[list(group)] = True
    if table.others is not None:  # they are no points of the axis: its answers miss them anyway
        return
    for place, error in zip(table.left_out.places.tolist(), table.left_out.errors, strict=True):
        group = list(table.rows.members[place])
        deviation[group], left[group] = error, True
