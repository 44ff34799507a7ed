"""The hyperparameters of a table: on which rows, and what noise counts against."""

from __future__ import annotations

import numpy as np

from ..table.rows import Floats
from .correlation import Hyperparameters
from .equations import OUTPUTS, Equations, Scaling
from .factor import factorise
from .likelihood import maximise
from .settings import KrigingSettings
from .shares import Share, shares_of
from .spread_rows import spread_rows


def estimated(
    equations: Equations,
    scaling: Scaling,
    before: Hyperparameters | None,
    settings: KrigingSettings,
) -> tuple[Hyperparameters, Floats]:
    """Return the hyperparameters, and the process variances (6,) that noise is held against.

    Noise counts relative to the process variance, which the hyperparameters decide: with noise the
    likelihood is maximised a second time, with the variances that the first time found. The
    variances are in spreads squared, dimensionless.
    """
    limits = settings.likelihood_rows, settings.likelihood_equations
    chosen = equations.take(spread_rows(equations, *limits))
    variance = np.ones(OUTPUTS)
    noisy = bool((chosen.noise > settings.nugget).any())
    for _ in range(1 + noisy):
        shares = _telling(shares_of(chosen, variance, settings), scaling)
        before = maximise(chosen, shares, before, settings)
        for share in shares:
            found = factorise(chosen, before, *share, settings)
            variance[share.outputs] = found.variance
    assert before is not None
    return before, variance


def _telling(shares: list[Share], scaling: Scaling) -> list[Share]:
    """Return the shares without the outputs that vary by rounding only, and with enough rows."""
    heard = [
        share._replace(outputs=share.outputs[~scaling.silent[share.outputs]]) for share in shares
    ]
    return [share for share in heard if len(share.outputs) and len(share.rows)]
