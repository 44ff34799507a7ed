"""The noise of one reading, where nobody stated it."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from ..table.rows import Floats
from .correlation import Hyperparameters, covariance
from .equations import Equations, Scaling
from .factor import SingularCovarianceError, shares_of
from .likelihood import REFUSED, profile
from .settings import KrigingSettings


def reading_noise(
    equations: Equations,
    scaling: Scaling,
    hyperparameters: Hyperparameters,
    before: Floats,
    settings: KrigingSettings,
) -> tuple[Floats, Floats]:
    """Return each output's process variance and that of one of its readings, (6,) each.

    The variance of a reading is the least with which any of several kernels is nearly as likely as
    the most likely one. What may be response and may be noise is taken for response, whose error
    bars are wider; one kernel for all outputs would take for noise what an output alone does.
    Of rows as they lie, near each other too: rows spread widely do not show little noise.

    Parameters
    ----------
    before : ndarray, shape (6,), spreads squared
        Process variances that stated noise is held against.
    """
    ends = np.searchsorted(np.cumsum(equations.known.sum(axis=1)), settings.likelihood_equations)
    count = max(min(int(ends), len(equations)), 1)
    chosen = equations.take(np.linspace(0, len(equations) - 1, count).round().astype(np.intp))
    ratios = np.arange(*settings.ratio_bounds, settings.ratio_step)
    groups = equations.groups
    kernels = [hyperparameters] + [  # and kernels of one length in all loads
        Hyperparameters.of_logarithms(np.array([theta] * groups.shape[1] + [weight]), groups)
        for theta in settings.noise_thetas
        for weight in settings.noise_weights
    ]
    curves = [_curves(chosen, kernel, before, ratios, settings) for kernel in kernels]
    if not chosen.known[:, 1:].any():
        curves += [
            _curves(chosen, hyperparameters, before, ratios, settings, part)
            for part in settings.noise_rough
        ]
    variance, reading = before.copy(), np.zeros_like(before)
    for output in np.flatnonzero(~scaling.silent):
        values = np.array([found[:, output] for found, _ in curves])
        readings = np.array([ratios + found[:, output] for _, found in curves])
        least = _least(values, readings, ratios, settings)
        own = np.maximum.accumulate(readings[0])  # it grows with the ratio but for rounding
        ratio = np.interp(least, own, ratios)
        reading[output], variance[output] = np.exp(least), np.exp(least - ratio)
    return variance, reading


def _curves(
    equations: Equations,
    hyperparameters: Hyperparameters,
    before: Floats,
    ratios: Floats,
    settings: KrigingSettings,
    rough: float = 0.0,
) -> tuple[Floats, Floats]:
    """Return half the negative log likelihood and the log process variance, (r, 6) each.

    By the logarithms (r,) of a reading's variance over the process variance.
    """
    x, known = equations.x, equations.known
    table = covariance(x, known, x, known, hyperparameters)
    if rough:
        table = table + rough * sum(np.exp(-np.abs(one[:, None] - one)) for one in x.T)
    values, variances = np.full((2, len(ratios), len(before)), REFUSED)
    for share in shares_of(equations, before, settings):
        if not len(share.rows):
            continue
        for place, ratio in enumerate(np.exp(ratios).tolist()):
            try:
                found = profile(equations, hyperparameters, share, ratio, settings, table)
            except SingularCovarianceError:
                continue
            values[place, share.outputs] = found.values
            variances[place, share.outputs] = np.log(found.variance)
    return values, variances


def _least(values: Floats, readings: Floats, ratios: Floats, settings: KrigingSettings) -> float:
    """Return the logarithm of the least variance of a reading that is nearly as likely as any.

    Parameters
    ----------
    values, readings : ndarray, shape (k, r)
        Half the negative log likelihood and the logarithm of a reading's variance, of k kernels.
    """
    fine = np.arange(ratios[0], ratios[-1], settings.ratio_accuracy)
    known = (values < REFUSED).all(axis=1)
    curves = np.array([CubicSpline(ratios, one)(fine) for one in values[known]])
    likely = curves <= curves.min() + settings.ratio_caution
    at = np.array([np.interp(fine, ratios, one) for one in readings[known]])
    return float(at[likely].min())
