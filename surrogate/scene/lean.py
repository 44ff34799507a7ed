"""A kriging without what a scene's answers do not read.

Every row has its say in every answer, by its weight, so all weights stay, of the outputs that are
read: 56 numbers a row at most. What goes is what only made them (covariances, the factor over all
rows, the rows left out) and the neighbourhoods, of up to 140 x 140 numbers each, of rows that no
wrench of the scene is nearest to. What stays is untouched: the answers are the same digits.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import compress

import numpy as np

from ..kriging import Kriging
from ..kriging.dense import Dense, Spread
from ..kriging.equations import Scaling
from ..table.rows import Floats
from .need import Need
from .reach import nearest_anywhere


def lean_kriging(kriging: Kriging, need: Need) -> Kriging:
    """Return what answers as a kriging does at a scene's wrenches."""
    inside = kriging.inside
    low, high = _box(need, kriging.scaling)
    read = [np.isin(share.factor.outputs, need.outputs).any() for share in inside.shares]
    shares = tuple(
        _lean_spread(inside, share, low, high) for share in compress(inside.shares, read)
    )
    unread = np.setdiff1d(np.arange(6), need.outputs)
    weights = inside.weights.copy()
    weights[:, :, unread] = 0.0
    n = len(inside.equations)
    equations = replace(  # what the rows said is in their weights
        inside.equations,
        told=np.zeros((n, 0, 0)),
        measured=np.zeros((n, 0), dtype=bool),
        noise=np.zeros((n, 0)),
    )
    lean = replace(
        inside,
        equations=equations,
        shares=shares,
        weights=weights,
        errors=inside.errors[:0],
        calibrations=tuple(compress(inside.calibrations, read)),
    )
    return replace(kriging, inside=lean)


def _box(need: Need, scaling: Scaling) -> tuple[Floats, Floats]:
    """Return the scene's ends in half ranges, (6,) each, with room for rounding."""
    ends = np.stack((need.span.low - need.slack, need.span.high + need.slack))
    ends = np.where(need.varying, ends, np.stack((need.span.low, need.span.high)))
    low, high = scaling.loads(ends)
    return low, high


def _lean_spread(inside: Dense, share: Spread, low: Floats, high: Floats) -> Spread:
    """Return what tells sigma within a box of scaled loads."""
    held, factor, finder = inside.held, share.factor, share.finder
    kept = nearest_anywhere(inside.equations.x[share.anchors], held.inverse_squares, low, high)
    return Spread(
        replace(
            factor,
            noise=factor.noise[:0],
            T=np.zeros((0, 0)),
            TF=np.zeros((0, 7)),
            weights=np.zeros((0, 0)),
        ),
        finder,  # whole, a few numbers a row, so that rows that tie for nearest tie as they did
        tuple(share.around[place] for place in np.flatnonzero(kept)),
        share.anchors[kept],
    )
