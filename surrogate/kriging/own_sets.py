"""Hyperparameters of single outputs, where the likelihood pays for them.

One set for all outputs is a compromise where outputs differ: friction in one direction, a stiff
direction beside a soft one, a rotation that symmetry makes of products of loads. An output has a
set of its own if by it the logarithm of its likelihood rises by enough for each of its equations
(by the logarithm of the geometric mean of the deviations with which each reading is predicted from
those before it), and rows left out are answered far better. A search costs as much as that of all
outputs, so it is made where a first step of Fisher scoring promises enough.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..table.rows import Floats
from .calibration import full_rows
from .correlation import Hyperparameters, covariance
from .equations import Equations, Scaling
from .factor import Share, factorise
from .left_out import left_out
from .likelihood import bounds_of, maximise, profile
from .settings import KrigingSettings

STEP = 1e-6  # of logarithms, for differences of the covariance: half the digits are enough
AT_BOUND = 1e-2  # of logarithms: the estimate's decimals, and some
# Added to the diagonal of the Fisher information, of itself: directions that change nothing.
REGULAR = 1e-3


def own_sets(
    equations: Equations,
    shares: list[Share],
    common: Hyperparameters,
    scaling: Scaling,
    settings: KrigingSettings,
) -> dict[int, Hyperparameters]:
    """Return the hyperparameters of the outputs that have a set of their own.

    Noise counts relative to the process variance, which would change with them: outputs with noise,
    stated or to be found, keep the common set.

    Parameters
    ----------
    equations : Equations
        Those that the common set is estimated on.
    shares : list of Share
        Of the outputs that have a say.
    """
    found = {}
    quick = replace(settings, likelihood_accuracy=settings.own_accuracy)
    for share in shares:
        count = int(equations.known[share.rows].sum())
        few = settings.own_equations * (int(scaling.active.sum()) + equations.weights)
        noisy = (share.noise > settings.nugget).any() or equations.readings.any()
        if noisy or count < few:
            continue
        promised = promised_gains(equations, share, common, settings)
        before, missed = _judged(equations, common, share, settings)
        promising = promised >= settings.own_promise * count
        for place in np.flatnonzero(promising & (missed > settings.own_least)):
            alone = share._replace(outputs=share.outputs[[place]])
            own = maximise(equations, [alone], common, quick)
            after, left = _judged(equations, own, alone, settings)
            gained = before[place] - after[0] >= settings.own_gain * count
            if gained and left[0] <= settings.own_error * missed[place]:
                found[int(share.outputs[place])] = own
    return found


def are_spread(equations: Equations, scaling: Scaling, settings: KrigingSettings) -> bool:
    """Return whether enough rows load several axes at once, at enough values of each load.

    On few levels of a load, or where axes are loaded one at a time, a row left out has copies in
    the loads that a set of one output sees: it is answered however wrong the set is between them.
    """
    full = equations.x[full_rows(equations, scaling)]
    values = [len(np.unique(np.round(one / settings.same))) for one in full.T[scaling.active]]
    return min(values, default=0) >= settings.own_rows


def _judged(
    equations: Equations, held: Hyperparameters, share: Share, settings: KrigingSettings
) -> tuple[Floats, Floats]:
    """Return half the negative log likelihood and the error of rows left out, RMS, (k,) each."""
    found = profile(equations, held, share, settings=settings)
    errors = left_out(equations, found.factor, np.arange(len(share.rows))).errors
    return found.values, np.sqrt((errors**2).mean(axis=0))


def promised_gains(
    equations: Equations, share: Share, common: Hyperparameters, settings: KrigingSettings
) -> Floats:
    """Return by how much one step of Fisher scoring raises each output's log likelihood, (k,).

    With A_i = T dK_i T' and the whitened remainders r of variance s^2, the derivative by parameter
    i is (r' A_i r / s^2 - tr A_i) / 2 and the Fisher information (<A_i, A_j> - tr A_i tr A_j / e)
    / 2, the process variance profiled (Rasmussen and Williams 2006, section 5.4). A parameter
    without information takes no part, nor one at its bound whose derivative points beyond.
    """
    factor, own = factorise(equations, common, *share, settings), equations.take(share.rows)
    place = common.logarithms

    def covariance_at(logarithms: Floats) -> Floats:
        held = Hyperparameters.of_logarithms(logarithms, common.groups, common.smoothness)
        return covariance(own.x, own.known, own.x, own.known, held)

    here = covariance_at(place)
    changes = [(covariance_at(place + STEP * by) - here) / STEP for by in np.eye(len(place))]
    changes = np.array([factor.T @ change @ factor.T.T for change in changes])
    traces = np.einsum("iee->i", changes)
    information = np.einsum("iab,jab->ij", changes, changes) - np.outer(traces, traces) / len(here)
    information[np.diag_indices_from(information)] *= 1 + REGULAR
    remainders = np.linalg.solve(factor.T.T, factor.weights) / np.sqrt(factor.variance)
    squares = np.einsum("ak,iab,bk->ki", remainders, changes, remainders, optimize=True)
    low, high = np.array(bounds_of(equations, settings)).T
    gains = np.zeros(len(share.outputs))
    for output, slope in enumerate((squares - traces) / 2):
        free = np.where(slope > 0, place < high - AT_BOUND, place > low + AT_BOUND)
        free &= np.diag(information) > 0
        chosen = information[np.ix_(free, free)] / 2
        gains[output] = slope[free] @ np.linalg.solve(chosen, slope[free]) / 2
    return gains
