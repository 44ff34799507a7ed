"""Which outputs share one factor: those that the same rows tell, with like noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .equations import OUTPUTS, Equations
from .settings import DEFAULTS, KrigingSettings


class Share(NamedTuple):
    """Outputs that the same rows tell with the same noise.

    Attributes
    ----------
    outputs, rows : ndarray of int, shape (k,) and (r,)
    noise : ndarray, shape (r,), dimensionless
        Variance of the rows' values over the process variance.
    """

    outputs: NDArray[np.intp]
    rows: NDArray[np.intp]
    noise: Floats


def shares_of(
    equations: Equations, variance: Floats, settings: KrigingSettings = DEFAULTS
) -> list[Share]:
    """Return the outputs in groups that one factor answers.

    Parameters
    ----------
    variance : ndarray, shape (6,), dimensionless
        Process variance of each output, spreads squared: noise counts relative to it. Outputs whose
        relative noise differs by more than `like_noise` at some row get a factor each.
    """
    noise = equations.noise / variance
    # Below the nugget noise changes nothing.
    size = np.log(np.maximum(noise, settings.nugget))
    groups: list[list[int]] = []
    for output in range(OUTPUTS):
        for group in groups:
            rows = equations.measured[:, group[0]]
            same = (rows == equations.measured[:, output]).all()
            apart = np.abs(size[rows, output] - size[rows, group[0]])
            if same and (apart <= np.log(settings.like_noise)).all():
                group.append(output)
                break
        else:
            groups.append([output])
    return [_share(equations, noise, np.array(group, dtype=np.intp)) for group in groups]


def _share(equations: Equations, noise: Floats, outputs: NDArray[np.intp]) -> Share:
    rows = np.flatnonzero(equations.measured[:, outputs[0]])
    return Share(outputs, rows, noise[np.ix_(rows, outputs)].mean(axis=1))
