"""A dense kriging as the arrays of a packed table.

Rows are innermost and padded to a multiple of `LANES`; rows of the padding weigh nothing and have
no neighbourhood. The inverse factor T of each neighbourhood is stored in panels of `PANEL` rows,
column after column, which a processor's vectors multiply as they lie.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from ..kriging import Kriging
from ..kriging.calibration import Calibration
from ..kriging.factor import Neighbourhoods

LANES, PANEL = 8, 16  # WB_LANES and WB_PANEL of surrogate/kernel/wb_internal.h

Array = NDArray[np.generic]


def kriging_arrays(kriging: Kriging) -> Iterator[tuple[str, Array]]:
    """Yield the names and arrays of a kriging with one factor over all rows."""
    scaling = kriging.scaling
    rows = len(kriging.equations)
    stride = -(-rows // LANES) * LANES
    x = np.pad(kriging.equations.x.T, ((0, 0), (0, stride - rows)))
    weights_by_place = np.zeros((*kriging.weights.shape[:0:-1], stride))
    weights_by_place[:, :, :rows] = kriging.weights.transpose(2, 1, 0)
    yield "x", x
    rates, weights = kriging.hyperparameters.terms
    yield "terms", np.concatenate((rates, weights[:, None]), axis=1)
    yield "rates", kriging.hyperparameters.inverse_squares
    yield "weights", weights_by_place.reshape(len(weights_by_place), -1)
    if kriging.equations.places > 1 + len(x):
        yield "smoothness", np.array([kriging.hyperparameters.smoothness], dtype=np.int32)
    yield "coefficients", kriging.coefficients
    yield "centre", scaling.centre
    yield "rate", np.where(scaling.active, 1 / scaling.half, 0.0)
    yield "offset", scaling.offset
    yield "spread", scaling.spread
    yield "deviation", kriging.deviation * scaling.spread
    yield "lost", kriging.rounding * scaling.spread
    yield "floor", np.array([kriging.settings.error_floor])
    yield "tangent", np.where(scaling.active, 0.0, kriging.tangent)
    yield "span", kriging.span
    yield "span_loads", scaling.wrenches(kriging.span)
    yield "shares", np.array([len(kriging.shares)], dtype=np.int32)
    for number, (share, found) in enumerate(zip(kriging.shares, kriging.calibrations, strict=True)):
        outputs, places = len(kriging.deviation), kriging.equations.places
        arrays = _share_arrays(share, stride, outputs, places), _levels(share, found, outputs)
        for name, array in chain(*arrays):
            yield f"share{number}/{name}", array


def _levels(share: Neighbourhoods, found: Calibration, outputs: int) -> Iterator[tuple[str, Array]]:
    """Yield the calibration of one factor."""
    factors = np.zeros((len(found.sigma), outputs))
    factors[:, share.factor.outputs] = found.factors.reshape(len(found.sigma), -1)
    yield "sigma", found.sigma
    yield "factors", factors
    yield "reach", np.array([found.reach])


def _share_arrays(
    share: Neighbourhoods, stride: int, outputs: int, places_of_row: int
) -> Iterator[tuple[str, Array]]:
    """Yield what gives sigma for the outputs of one factor."""
    count = len(share.around)
    most = max(len(local.places) for local in share.around)
    padded = -(-most // PANEL) * PANEL
    number, least = np.zeros(stride, dtype=np.int32), np.full(stride, np.inf)
    places = np.zeros((count, padded), dtype=np.int32)
    panels = np.zeros((count, PANEL * padded * (padded // PANEL + 1) // 2))
    unsettled = np.zeros((count, share.around[0].TF.shape[1], padded))
    for place, (row, local) in enumerate(zip(share.factor.rows, share.around, strict=True)):
        size = len(local.places)
        at_row, of_row = np.divmod(local.places, places_of_row)
        places[place, :size] = of_row * stride + at_row
        # A lower triangle (e, e), dimensionless, in panels of rows, columns first.
        whole = np.zeros((padded, padded))
        whole[: len(local.T), : len(local.T)] = local.T
        panels[place] = np.concatenate(
            [whole[top : top + PANEL, : top + PANEL].T.ravel() for top in range(0, padded, PANEL)]
        )
        unsettled[place, :, :size] = local.TF.T
        number[row], least[row] = place, local.least
    yield "outputs", np.isin(np.arange(outputs), share.factor.outputs).astype(np.int32)
    yield "number", number
    yield "places", places
    yield "panels", panels
    yield "unsettled", unsettled
    yield "least", least
    yield "penalty", np.where(np.isfinite(least), 0.0, np.inf)
    yield "mean_covariance", share.factor.mean_covariance
