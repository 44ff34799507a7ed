"""The covariance of values and slopes: Matern 7/2, one term an axis and one of all loads.

With scaled loads x and v, inverse squared lengths t and the squared scaled distance over the loads
of a group, q = sum t_a (x_a - v_a)^2, the covariance of values is

    m(q_x) + m(q_y) + m(q_z) + c m(q_all).

Slopes are its derivatives by x and by v (Morris, Mitchell and Ylvisaker 1993).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from ..table.space import DEFAULT

Mask = NDArray[np.bool_]

PAIRS = 100_000  # of rows at once: differences by each load within some 5 MB, blocks within 40 MB


@dataclass(frozen=True)
class Hyperparameters:
    """What the likelihood settles, one set for all outputs.

    Attributes
    ----------
    inverse_squares : ndarray, shape (6,), dimensionless
        One over the squared length of each load, in half ranges.
    weight : float
        Variance of the term of all loads over that of one axis.
    groups : ndarray, shape (g, n)
        Which loads each term sees, the last all: see `Space.kriging_groups`.
    """

    inverse_squares: Floats
    weight: float
    groups: Floats = field(default_factory=lambda: DEFAULT.kriging_groups)

    @classmethod
    def of_logarithms(
        cls, logarithms: Floats, groups: Floats = DEFAULT.kriging_groups
    ) -> Hyperparameters:
        """Return the hyperparameters of their logarithms, shape (n + 1,), dimensionless."""
        values = np.exp(np.asarray(logarithms, dtype=float))
        return cls(values[:-1], float(values[-1]), groups)

    @property
    def logarithms(self) -> Floats:
        """The logarithms, shape (n + 1,), dimensionless."""
        return np.log(np.append(self.inverse_squares, self.weight))

    @property
    def terms(self) -> tuple[Floats, Floats]:
        """Each term's inverse squares (4, 6), zero for loads it does not see, and weights (4,).

        Both are dimensionless.
        """
        weights = np.ones(len(self.groups))
        weights[-1] = self.weight
        return self.groups * self.inverse_squares, weights

    @cached_property
    def prior(self) -> Floats:
        """Covariance of one row's value and slopes: its diagonal, it has no other.

        Shape (7,), dimensionless.
        """
        rates, weights = self.terms
        return np.append(weights.sum(), 1.4 * (weights @ rates))


def matern(q: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return Matern 7/2 of the squared scaled distance and its first three derivatives by it.

    All have the shape of `q`, dimensionless.
    """
    a = np.sqrt(7.0 * q)
    decay = np.exp(-a)
    return (
        (1 + a + 0.4 * a**2 + a**3 / 15) * decay,
        -0.7 * (1 + a + a**2 / 3) * decay,
        49 / 60 * (1 + a) * decay,
        -343 / 120 * decay,
    )


def block(
    x: Floats, v: Floats, hyperparameters: Hyperparameters, slopes_x: bool, slopes_v: bool
) -> Floats:
    """Return the covariance of rows at x (n, 6) and v (m, 6), shape (n, 1 or 7, m, 1 or 7)."""
    apart, loads = x[:, None, :] - v[None, :, :], x.shape[1]
    out = np.zeros((len(x), 1 + loads * slopes_x, len(v), 1 + loads * slopes_v))
    for rates, weight in zip(*hyperparameters.terms, strict=True):
        value, first, second, _ = matern(apart**2 @ rates)
        out[:, 0, :, 0] += weight * value
        for a in np.flatnonzero(rates) if slopes_x or slopes_v else ():
            slope = 2 * rates[a] * weight * first * apart[..., a]
            if slopes_x:
                out[:, 1 + a, :, 0] += slope
            if slopes_v:
                out[:, 0, :, 1 + a] -= slope
            if not (slopes_x and slopes_v):
                continue
            out[:, 1 + a, :, 1 + a] -= 2 * rates[a] * weight * first
            for b in np.flatnonzero(rates):
                rate = 4 * rates[a] * rates[b] * weight * second
                out[:, 1 + a, :, 1 + b] -= rate * apart[..., a] * apart[..., b]
    return out


def covariance(
    x: Floats, known_x: Mask, v: Floats, known_v: Mask, hyperparameters: Hyperparameters
) -> Floats:
    """Return the covariance of the equations that rows at x and v bring.

    Parameters
    ----------
    x, v : ndarray, shapes (n, 6) and (m, 6), half ranges
    known_x, known_v : ndarray of bool, shapes (n, 7) and (m, 7)
        Which of value and slopes each row brings; equations count row by row.
    """
    out = np.empty((int(known_x.sum()), int(known_v.sum())))
    first_x, first_v, loads = numbers(known_x), numbers(known_v), x.shape[1]
    for slopes_v in (False, True):
        columns = np.flatnonzero(known_v[:, 1:].any(axis=1) == slopes_v)
        there = known_v[columns, : 1 + loads * slopes_v]
        for slopes_x in (False, True):
            every = np.flatnonzero(known_x[:, 1:].any(axis=1) == slopes_x)
            for rows in np.array_split(every, 1 + len(every) * len(columns) // PAIRS):
                here = known_x[rows, : 1 + loads * slopes_x]
                if not (here.size and there.size):
                    continue
                found = block(x[rows], v[columns], hyperparameters, slopes_x, slopes_v)
                found = found.reshape(here.size, there.size)
                to = first_x[rows, : here.shape[1]][here], first_v[columns, : there.shape[1]][there]
                out[np.ix_(*to)] = found[np.ix_(here.ravel(), there.ravel())]
    return out


def numbers(known: Mask) -> NDArray[np.intp]:
    """Return the index of each place's equation, shape (n, 7); no meaning where not known."""
    return (np.cumsum(known.ravel()) - 1).reshape(known.shape)


def mean_terms(x: Floats, known: Mask) -> Floats:
    """Return the mean's seven terms, constant and linear, at each equation, (e, 7).

    The scaled loads (n, 6) and the terms are dimensionless.
    """
    terms = np.zeros((len(x), *known.shape[1:] * 2))
    terms[:, 0, 0] = 1.0
    terms[:, 0, 1:] = x
    terms[:, 1:, 1:] = np.eye(x.shape[1])
    return terms[known]
