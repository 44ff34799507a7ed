"""What else answers scattered data: SMT's kriging and scipy's radial basis functions."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import warnings

import numpy as np
from scipy.interpolate import RBFInterpolator

from wrenchbook.surrogate.table.rows import Rows

SMT_MISSING = (
    ""
    if importlib.util.find_spec("smt")
    else "SMT is not installed, so it is left out: .venv/bin/python -m pip install smt"
)


def smt_kriging(
    rows: Rows, scale: np.ndarray, asked: np.ndarray, *, gradients: bool = False
) -> np.ndarray:
    """Return SMT's answers at wrenches (n, 6), one kriging for all outputs, shape (n, 6).

    Parameters
    ----------
    scale : ndarray, shape (6,), N and N·m
    gradients : bool
        GEKPLS with the rows' tangents, one an output, instead of KRG without.
    """
    from smt.surrogate_models import GEKPLS, KRG  # pyright: ignore[reportMissingImports]

    x, out = rows.wrench / scale, np.empty((len(asked), 6))
    size = np.maximum(rows.displacement.std(axis=0), np.finfo(float).tiny)
    for output in range(6):
        if gradients:
            limits = np.tile([-1.0, 1.0], (6, 1))
            one = GEKPLS(
                theta0=[1e-2] * 3, xlimits=limits, n_comp=3, extra_points=3, print_global=False
            )
            for load in range(6):
                slope = rows.compliance[:, output, load] * scale[load] / size[output]
                one.set_training_derivatives(x, slope[:, None], load)
        else:
            one = KRG(theta0=[1e-2], corr="matern52", poly="linear", print_global=False)
        one.set_training_values(x, rows.displacement[:, output : output + 1] / size[output])
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it warns of while it searches is its own affair
            one.train()
            out[:, output] = one.predict_values(asked / scale)[:, 0] * size[output]
    return out


def radial(rows: Rows, scale: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Return the answers of one cubic spline in all six loads, shape (n, 6), m and rad."""
    size = np.maximum(np.abs(rows.displacement).max(axis=0), np.finfo(float).tiny)
    spline = RBFInterpolator(rows.wrench / scale, rows.displacement / size, kernel="cubic")
    return spline(asked / scale) * size
