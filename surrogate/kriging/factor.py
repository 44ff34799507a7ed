"""The dense factor of the covariance, by which every answer and every left-out row is had.

Kept is T, the inverse of the lower Cholesky factor: the inverse of the covariance is T'T, a new row
borders it, and answers are products. The mean's coefficients have a wide normal prior, of variance
P; with A = F' T'T F + 1/P this is the usual universal kriging where rows settle the mean, and still
defined where they do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import get_lapack_funcs

from ..table.rows import Floats
from .correlation import Hyperparameters, covariance, mean_terms, numbers
from .equations import Equations
from .settings import DEFAULTS, KrigingSettings

ROUNDING = float(np.finfo(float).eps) ** 2  # variance, spreads squared, of values that are one


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
    for output in range(noise.shape[1]):
        for group in groups:
            rows = equations.measured[:, group[0]]
            same = (rows == equations.measured[:, output]).all()
            apart = np.abs(size[rows, output] - size[rows, group[0]])
            if same and (apart <= np.log(settings.like_noise)).all():
                group.append(output)
                break
        else:
            groups.append([output])
    shares = []
    for group in groups:
        rows = np.flatnonzero(equations.measured[:, group[0]])
        outputs = np.array(group, dtype=np.intp)
        shares.append(Share(outputs, rows, noise[np.ix_(rows, outputs)].mean(axis=1)))
    return shares


class SingularCovarianceError(ArithmeticError):
    """A covariance that is singular even with the largest nugget."""


@dataclass(frozen=True)
class KrigingFactor:
    """The factor of some rows' equations, for the outputs that these rows tell alike.

    All numbers are dimensionless: loads are in half ranges, outputs in spreads.

    Attributes
    ----------
    hyperparameters : Hyperparameters
    outputs : ndarray of int, shape (k,)
        The outputs it answers.
    rows : ndarray of int, shape (r,)
        Which rows of the table take part.
    noise : ndarray, shape (r,)
        Variance of their values over the process variance.
    nugget : float
        What the diagonal was raised by, relative.
    T : ndarray, shape (e, e)
        Inverse of the lower Cholesky factor of the e equations' covariance.
    TF : ndarray, shape (e, 7)
        T times the mean's terms.
    mean_covariance : ndarray, shape (7, 7)
        Posterior covariance of the mean's coefficients, over the process variance.
    coefficients : ndarray, shape (7, k)
        The mean of each output.
    weights : ndarray, shape (e, k)
        What covariances are multiplied by.
    variance : ndarray, shape (k,)
        Process variance of each output, spreads squared.
    """

    hyperparameters: Hyperparameters
    outputs: NDArray[np.intp]
    rows: NDArray[np.intp]
    noise: Floats
    nugget: float
    T: Floats
    TF: Floats
    mean_covariance: Floats
    coefficients: Floats
    weights: Floats
    variance: Floats


def diagonal_added(
    equations: Equations, noise: Floats, nugget: float, hyperparameters: Hyperparameters
) -> Floats:
    """Return what is added to the covariance's diagonal: nugget and noise.

    Shape (equations,), dimensionless, of noise, shape (rows,), over the process variance.
    """
    added = np.tile(nugget * hyperparameters.prior(equations.places), (len(equations), 1))
    added[:, 0] += noise
    return added[equations.known]


def inverse_factor(
    matrix: Floats, nugget: float, nugget_limit: float, prior: Floats
) -> tuple[Floats, float]:
    """Return the inverse of the lower Cholesky factor, and the nugget it took.

    Parameters
    ----------
    matrix : ndarray, shape (e, e), dimensionless
        With a nugget of `nugget` times `prior` on its diagonal; raised by decades on failure.
    prior : ndarray, shape (e,), dimensionless

    Raises
    ------
    SingularCovarianceError
        If it is singular with the largest nugget.
    """
    size = np.sqrt(prior)
    scaled = matrix / size[:, None] / size
    places = np.diag_indices_from(scaled)
    while True:
        try:
            lower = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError:
            if nugget * 10 > nugget_limit:
                raise SingularCovarianceError(
                    f"the covariance of {len(matrix)} equations is singular with a nugget of "
                    f"{nugget:g}: rows contradict each other; invalidate the wrong ones"
                ) from None
            scaled[places] += 9 * nugget
            nugget *= 10
            continue
        (invert,) = get_lapack_funcs(("trtri",), (lower,))
        inverse, _ = invert(lower, lower=1)  # cannot fail: the diagonal is positive
        return np.tril(inverse) / size, nugget


def factorise(
    equations: Equations,
    hyperparameters: Hyperparameters,
    outputs: NDArray[np.intp],
    rows: NDArray[np.intp],
    noise: Floats,
    settings: KrigingSettings = DEFAULTS,
    table: Floats | None = None,
) -> KrigingFactor:
    """Return the factor of some rows (r,) of a table for some outputs (k,), both indices.

    `noise` (r,) is over the process variance; `table` (a, a), dimensionless, the covariance of all
    a equations of the table, where it is at hand.
    """
    own = equations.take(rows)
    if table is None:
        matrix = covariance(own.x, own.known, own.x, own.known, hyperparameters)
    else:
        places = numbers(equations.known)[rows][own.known]
        matrix = table[np.ix_(places, places)]
    matrix[np.diag_indices_from(matrix)] += diagonal_added(
        own, noise, settings.nugget, hyperparameters
    )
    prior = np.tile(hyperparameters.prior(own.places), (len(own), 1))[own.known]
    T, nugget = inverse_factor(matrix, settings.nugget, settings.nugget_limit, prior)
    TF = T @ mean_terms(own.x, own.known)
    Ty = T @ own.data[own.known][:, outputs]
    precision = TF.T @ TF + np.eye(TF.shape[1]) / settings.mean_variance
    mean_covariance = np.asarray(np.linalg.inv(precision), dtype=float)
    coefficients = mean_covariance @ (TF.T @ Ty)
    remainder = Ty - TF @ coefficients
    return KrigingFactor(
        hyperparameters=hyperparameters,
        outputs=outputs,
        rows=rows,
        noise=noise,
        nugget=nugget,
        T=T,
        TF=TF,
        mean_covariance=mean_covariance,
        coefficients=coefficients,
        weights=T.T @ remainder,
        # Of a response that is linear nothing remains, and rounding may make that negative.
        variance=np.maximum(np.einsum("eq,eq->q", remainder, Ty) / len(T), ROUNDING),
    )
