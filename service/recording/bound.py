"""The largest displacement over an envelope's box: a bound of a linear table, else an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.recording.store import EnvelopeState
from wrenchbook.service.recording.thinning import Floats
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.answer import COVERED, OUTSIDE
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import Space

EXACT: Final = (
    "bound: of a linear table, |u(0)| plus the largest |C w| of the box, at the corner that the "
    "signs of C choose for each output, plus the largest error bar"
)
ESTIMATE: Final = (
    "estimate: the largest |answer| + error bar of the table at {} corners of the box, its "
    "centre, zero load and the wrenches that reached the extremes"
)
MAX_CORNERS = 4096  # corners of a box: all of 12 inputs; of more inputs a random choice


@dataclass(frozen=True)
class Bound:
    """The largest displacement over an envelope's box, shape (m,), m and rad; NaN if unknown.

    `kind` is ``bound``, ``estimate`` or ``unknown``, `formula` that of `displacement`, and
    `coverage` the worst of its answers. `negligible`: whether `displacement` is within the
    tolerance (None if unknown); `reason`: why that is unknown, or the basis.
    """

    displacement: Floats
    kind: str
    formula: str
    coverage: str
    negligible: bool | None
    reason: str


def bound_of(table: ServedTable, envelope: EnvelopeState, tolerance: Tolerance | None) -> Bound:
    """Return the largest displacement by an envelope's wrenches, according to the table."""
    low, high = envelope.box
    space = table.load_range.space
    if np.isnan(low).any():
        unknown = np.full(len(space.outputs), np.nan)
        return Bound(unknown, "unknown", "", "outside", None, "no wrench has come yet")

    corners = _corners(low, high)
    with np.errstate(over="ignore"):
        centre = low / 2 + high / 2
    # The error bar of a linear table grows with the size of each input and is largest here.
    outermost = np.where(np.abs(low) > np.abs(high), low, high)
    more = [centre[None], outermost[None], np.zeros((1, len(low)))]
    more += [envelope.lowest, envelope.highest]
    answers = table.packed.batch(np.concatenate([corners, *more]))
    coverage = int(answers.coverage.max(initial=COVERED))

    if table.linear and table.fit.complete:
        largest = _largest_linear(table, low, high) + answers.errors.max(axis=0)
        at_zero = table.packed.batch(np.zeros((1, len(low)))).outputs[0]
        largest = largest + np.abs(at_zero)
        kind = "bound"
        formula = EXACT
    else:
        # NaN stays: with an unknown value at one point the largest is unknown.
        largest = (np.abs(answers.outputs) + answers.errors).max(axis=0)
        number = f"the {len(corners)}" if len(corners) == 2 ** len(low) else len(corners)
        kind = "estimate"
        formula = ESTIMATE.format(number)
    if np.isnan(largest).any():
        kind = "unknown"
    negligible, reason = _negligible(largest, space, tolerance, kind, coverage)
    return Bound(largest, kind, formula, COVERAGE[coverage], negligible, reason)


def _corners(low: Floats, high: Floats) -> Floats:
    """Return the corners of a box, or a random choice of `MAX_CORNERS` of them, (n, inputs)."""
    if 2 ** len(low) <= MAX_CORNERS:
        return np.array(list(product(*zip(low, high, strict=True))))
    is_low = np.random.default_rng(0).random((MAX_CORNERS, len(low))) < 0.5
    return np.where(is_low, low, high)


def _largest_linear(table: ServedTable, low: Floats, high: Floats) -> Floats:
    """Return the largest |C w| of the box of a linear table, shape (outputs,), m and rad."""
    ends = np.stack([table.fit.matrix * low, table.fit.matrix * high])  # (2, outputs, inputs)
    largest, least = ends.max(axis=0).sum(axis=1), ends.min(axis=0).sum(axis=1)
    return np.abs([largest, least]).max(axis=0)


def _negligible(
    largest: Floats, space: Space, tolerance: Tolerance | None, kind: str, coverage: int
) -> tuple[bool | None, str]:
    """Return whether the largest displacement is within the tolerance, and the reason."""
    if tolerance is None:
        return None, "the component has no tolerance; ask with ?translation=...&rotation=..."
    if (largest > np.where(space.is_rotation, tolerance.rotation, tolerance.translation)).any():
        return False, ""
    if kind == "unknown":
        return None, "the table does not answer over all of the box; start the envelope's solves"
    if kind == "bound":
        return True, ""
    if coverage == OUTSIDE:
        return None, "part of the box is outside the table, so fill it for an estimate there"
    return True, "an estimate by the table, see formula"
