"""How far an envelope's wrenches can move the component, and whether that can be left out."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.recording.store import EnvelopeState
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.answer import COVERED, OUTSIDE
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import Space

Floats = NDArray[np.float64]

EXACT: Final = (
    "bound: of a linear table, max over the box of |u(0) + C w|, at the corner that the signs of "
    "C choose for each output, plus the error bar"
)
ESTIMATE: Final = (
    "estimate: the largest |answer| + error bar of the table at {} corners of the box, its "
    "centre, zero load and the wrenches that reached the extremes"
)

MOST_CORNERS = 4096  # of a box: all of 12 inputs; of more inputs some, chosen at random


@dataclass(frozen=True)
class Bound:
    """The largest displacement over an envelope's box.

    Attributes
    ----------
    displacement : ndarray, shape (m,), m and rad
        NaN where nothing is known.
    kind : str
        ``bound``, ``estimate`` or ``unknown``.
    formula : str
    coverage : str
        The worst of the answers it is made of.
    negligible : bool or None
        Whether it is within the tolerance; None if that is not known.
    reason : str
        Why it is not known, or its basis.
    """

    displacement: Floats
    kind: str
    formula: str
    coverage: str
    negligible: bool | None
    reason: str


def bound_of(table: ServedTable, envelope: EnvelopeState, tolerance: Tolerance | None) -> Bound:
    """Return a bound of how far an envelope's wrenches move the component, by its table."""
    low, high = envelope.box
    unknown = np.full(len(table.load_range.space.outputs), np.nan)
    if np.isnan(low).any():
        return Bound(unknown, "unknown", "", "outside", None, "no wrench has come yet")
    exact = table.linear and table.fit.complete
    corners = _corners(low, high)
    points = np.concatenate([corners, envelope.lowest, envelope.highest])
    answers = table.packed.batch(points)
    coverage = int(answers.coverage.max(initial=COVERED))
    if exact:
        most = _over_box(table.fit.matrix, low, high) + answers.errors.max(axis=0)
        at_rest = table.packed.batch(np.zeros((1, len(low))))
        most = most + np.abs(at_rest.outputs[0])
    else:
        # NaN stays: what is not known at one point is no estimate of the largest.
        most = (np.abs(answers.outputs) + answers.errors).max(axis=0)
    kind = "unknown" if np.isnan(most).any() else "bound" if exact else "estimate"
    negligible, reason = _judged(most, coverage, kind, tolerance, table.load_range.space)
    count = len(corners) - 2
    formula = EXACT if exact else ESTIMATE.format(f"the {count}" if count < MOST_CORNERS else count)
    return Bound(most, kind, formula, COVERAGE[coverage], negligible, reason)


def _corners(low: Floats, high: Floats) -> Floats:
    """Return the corners, the centre and zero load, shape (k, n), N and N·m: 66 of six loads."""
    if 2 ** len(low) <= MOST_CORNERS:
        corners = np.array(list(product(*zip(low, high, strict=True))))
    else:
        chosen = np.random.default_rng(0).random((MOST_CORNERS, len(low))) < 0.5
        corners = np.where(chosen, low, high)
    with np.errstate(over="ignore"):
        centre = low / 2 + high / 2
    return np.concatenate([corners, centre[None], np.zeros((1, len(low)))])


def _over_box(matrix: Floats, low: Floats, high: Floats) -> Floats:
    """Return max |C w| over a box of wrenches, shape (m,), m and rad."""
    ends = np.stack([matrix * low, matrix * high])
    return np.maximum(np.abs(ends.max(axis=0).sum(axis=1)), np.abs(ends.min(axis=0).sum(axis=1)))


def _judged(
    most: Floats, coverage: int, kind: str, tolerance: Tolerance | None, space: Space
) -> tuple[bool | None, str]:
    """Return whether the largest displacement is within the tolerance, and why it is unknown."""
    if tolerance is None:
        return None, "the component has no tolerance: ask with ?translation=...&rotation=..."
    allowed = np.where(space.is_rotation, tolerance.rotation, tolerance.translation)
    if (most > allowed).any():
        return False, ""
    if kind == "unknown":
        return None, "the table does not answer over all of the box; start the envelope's solves"
    if coverage == OUTSIDE and kind != "bound":
        return None, "part of the box is outside the table, where an estimate is no proof"
    return True, "" if kind == "bound" else "an estimate by the table, see formula"
