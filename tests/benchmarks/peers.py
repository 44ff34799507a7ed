"""What else answers scattered data: kriging of SMT, scikit-learn and OpenTURNS, scipy's splines."""

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


MISSING = ", ".join(
    name for name in ("smt", "sklearn", "openturns") if not importlib.util.find_spec(name)
)
"""Peers that are not installed; they are no dependency of the tests."""

LINEAR_TREND = 7  # rows, of which a linear trend of six loads needs more

HOW = ".venv/bin/python -m pip install smt scikit-learn openturns"


def sklearn_kriging(rows: Rows, scale: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Return scikit-learn's answers, (n, 6): Matern 5/2 with a length a load, an output each."""
    from sklearn.gaussian_process import (  # pyright: ignore[reportMissingImports]
        GaussianProcessRegressor,
    )
    from sklearn.gaussian_process.kernels import (  # pyright: ignore[reportMissingImports]
        ConstantKernel,
        Matern,
    )

    out = np.empty((len(asked), 6))
    for output in range(6):
        kernel = ConstantKernel(1.0, (1e-3, 1e6)) * Matern(np.ones(6), (0.05, 1e3), nu=2.5)
        one = GaussianProcessRegressor(
            kernel, alpha=1e-10, normalize_y=True, n_restarts_optimizer=3, random_state=1
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # lengths at their bounds
            one.fit(rows.wrench / scale, rows.displacement[:, output])
        out[:, output] = one.predict(asked / scale)
    return out


def openturns_kriging(rows: Rows, scale: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Return OpenTURNS' answers, shape (n, 6): Matern 5/2 about a linear trend, an output each."""
    import openturns as ot  # pyright: ignore[reportMissingImports]

    ot.Log.Show(ot.Log.NONE)
    out, x = np.empty((len(asked), 6)), ot.Sample((rows.wrench / scale).tolist())
    for output in range(6):
        size = max(float(rows.displacement[:, output].std()), float(np.finfo(float).tiny))
        y = ot.Sample((rows.displacement[:, output : output + 1] / size).tolist())
        trend = ot.LinearBasisFactory if len(rows) > LINEAR_TREND else ot.ConstantBasisFactory
        basis, kernel = trend(6).build(), ot.MaternModel([1.0] * 6, 2.5)
        fit = ot.GaussianProcessFitter(x, y, kernel, basis)
        fit.run()
        one = ot.GaussianProcessRegression(fit.getResult())
        one.run()
        result = one.getResult().getMetaModel()(ot.Sample((asked / scale).tolist()))
        out[:, output] = np.array(result)[:, 0] * size
    return out


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
            trend = "linear" if len(rows) > LINEAR_TREND else "constant"
            # Of 30 starts: the best of SMT's 10 has four times the error of the best at 30 solves.
            one = KRG(theta0=[1e-2], corr="matern52", poly=trend, n_start=30, print_global=False)
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
