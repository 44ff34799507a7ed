"""The largest displacement over an envelope's box: a bound of a linear table, else an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final, Literal

import numpy as np

from wrenchbook.service.contract import COVERAGE, Coverage
from wrenchbook.service.recording.store import EnvelopeState
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.answer import COVERED, OUTSIDE
from wrenchbook.surrogate.table.rows import Floats, Tolerance
from wrenchbook.surrogate.table.space import Space

EXACT: Final = (
    "bound: of a linear table, |u(0)| plus the largest |C w| of the box, at the corner that the "
    "signs of C choose for each output, plus the largest error bar"
)
ESTIMATE: Final = (
    "estimate: the largest |answer| + error bar of the table at {} corners of the box, its "
    "centre, zero load and the wrenches that reached the extremes"
)
Kind = Literal["bound", "estimate", "unknown"]
MAX_CORNERS = 4096  # corners of a box: all of 12 inputs; of more inputs a random choice


@dataclass(frozen=True)
class Bound:
    """The largest displacement over an envelope's box, shape (m,), m and rad; NaN if unknown.

    `formula` is that of `displacement`, `coverage` the worst of its answers. `negligible`: whether
    `displacement` is within the tolerance (None if unknown); `reason`: why that is unknown, or the
    basis.
    """

    displacement: Floats
    kind: Kind
    formula: str
    coverage: Coverage
    negligible: bool | None
    reason: str


def bound_of(table: ServedTable, envelope: EnvelopeState, tolerance: Tolerance | None) -> Bound:
    """Return the largest displacement by an envelope's wrenches, according to the table."""
    low, high = envelope.box
    space = table.load_range.space
    if np.isnan(low).any():
        unknown = np.full(len(space.outputs), np.nan)
        return Bound(unknown, "unknown", "", "outside", None, "no wrench has come yet")

    if 2 ** len(low) <= MAX_CORNERS:
        corners = np.array(list(product(*zip(low, high, strict=True))))
    else:
        is_low = np.random.default_rng(0).random((MAX_CORNERS, len(low))) < 0.5
        corners = np.where(is_low, low, high)
    with np.errstate(over="ignore"):
        centre = low / 2 + high / 2
    # Zero load: a further input such as a temperature has its reference there, not the number 0.
    zero = space.zero
    from_zero = low - zero, high - zero
    # The error bar of a linear table grows with the distance from it and is largest here.
    outermost = np.where(np.abs(from_zero[0]) > np.abs(from_zero[1]), low, high)
    more = [centre[None], outermost[None], zero[None]]
    more += [envelope.lowest, envelope.highest]
    answers = table.packed.batch(np.concatenate([corners, *more]))
    coverage = int(answers.coverage.max(initial=COVERED))

    if table.linear and table.fit.complete:
        ends = np.stack([table.fit.matrix * end for end in from_zero])  # (2, outputs, inputs)
        sums = [ends.max(axis=0).sum(axis=1), ends.min(axis=0).sum(axis=1)]
        largest = np.abs(sums).max(axis=0) + answers.errors.max(axis=0)
        largest = largest + np.abs(table.packed.batch(zero[None]).outputs[0])
        kind: Kind = "bound"
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


def _negligible(
    largest: Floats, space: Space, tolerance: Tolerance | None, kind: Kind, coverage: int
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
