"""The covariance of values and derivatives: a Matern term for each load group and one of all loads.

With scaled loads x and v, inverse squared lengths t and the squared scaled distance over the loads
of a group, q = sum t_a (x_a - v_a)^2, the covariance of values is

    c_x m(q_x) + c_y m(q_y) + c_z m(q_z) + c m(q_all).

m is Matern 7/2, and 9/2 where rows bring second derivatives; without these c_x = c_y = c_z = 1. The
groups are the three axes, or the interfaces and their pairs: see `Space.kriging_groups`.

The covariances of slopes and second derivatives are derivatives of this by x and by v (Morris,
Mitchell and Ylvisaker 1993). Each is a derivative by x - v, times -1 for each derivative by v. So
one list of derivatives, up to the fourth, holds the covariance of any two of a row's value and
derivatives.

Shapes are given for the n = 6 loads of one interface and g = 4 terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import combinations_with_replacement
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from ..table.space import DEFAULT

Mask = NDArray[np.bool_]
Index = tuple[int, ...]
"""The loads of a derivative, ascending: () is the value, (0, 0) twice by the first."""

# The p of Matern p + 1/2 where rows bring slopes at most, and where some bring second derivatives.
# With these, 60 random solves of `plate_thin`, the worst output's error is 0.035, 0.022 and 0.018 %
# of its range with 7/2, 9/2 and 11/2, with 15 solves 0.20, 0.24 and 0.26 %; with slopes alone 7/2
# is best of 15 solves. Responses of solves are smooth: contact and friction are no part of them.
SLOPES_SMOOTHNESS, SECOND_SMOOTHNESS = 3, 4

MAX_COVARIANCES = 4_000_000  # numbers of a covariance block computed at once: 32 MB


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """The quantities that the likelihood determines, for all outputs of a table."""

    # (6,), dimensionless: one over the squared length of each load, in half ranges
    inverse_squares: Floats
    # dimensionless: (1,), the variance of the term of all loads over that of each other term; or
    # (g,), the variances of all terms
    weights: Floats
    # (g, n): 1 for the loads that a term depends on, else 0; the last term depends on all
    groups: Floats = field(default_factory=lambda: DEFAULT.kriging_groups)
    smoothness: int = SLOPES_SMOOTHNESS  # p of Matern p + 1/2

    @classmethod
    def of_logarithms(
        cls,
        logarithms: Floats,
        groups: Floats = DEFAULT.kriging_groups,
        smoothness: int = SLOPES_SMOOTHNESS,
    ) -> Hyperparameters:
        """Return the hyperparameters with these `logarithms`."""
        values = np.exp(np.asarray(logarithms, dtype=float))
        loads = groups.shape[1]
        return cls(values[:loads], values[loads:], groups, smoothness)

    @property
    def logarithms(self) -> Floats:
        """The logarithms of inverse squares and weights, shape (n + 1,) or (n + g,)."""
        return np.log(np.append(self.inverse_squares, self.weights))

    @property
    def terms(self) -> tuple[Floats, Floats]:
        """Each term's inverse squares (g, n), 0 for other loads, and its weight (g,)."""
        weights = np.ones(len(self.groups))
        weights[-len(self.weights) :] = self.weights
        return self.groups * self.inverse_squares, weights

    def prior(self, count: int) -> Floats:
        """Return the variances of a row's value and derivatives, shape (count,), dimensionless."""
        return self._prior[:count]

    @cached_property
    def _prior(self) -> Floats:
        """The prior of a value and its derivatives up to the second, (1 + n + n (n + 1) / 2,).

        From the derivatives of m by q at 0: m of the value, -2 t_a m' of slopes, 4 t_a t_b m'' of
        second derivatives, three times that if a = b.
        """
        (rates, weights), loads = self.terms, self.groups.shape[1]
        at_zero = matern(np.zeros(1), 2, self.smoothness)
        value, once, twice = at_zero[0][0], at_zero[1][0], at_zero[2][0]
        pairs = 4 * twice * (1 + 2 * np.eye(loads)) * ((weights * rates.T) @ rates)
        slopes = -2 * once * weights @ rates
        return np.concatenate(([value * weights.sum()], slopes, pairs[np.triu_indices(loads)]))


def derivative_count(loads: int, order: int) -> int:
    """Return the number of derivatives of a row up to an order, its value included."""
    return sum(1 for _ in indices(loads, order))


def order_of(count: int, loads: int) -> int:
    """Return the highest order of a row's derivatives by their number, the value included."""
    if count == 1:
        return 0
    return 1 if count == 1 + loads else 2


@cache
def indices(loads: int, order: int) -> tuple[Index, ...]:
    """Return the derivatives by `loads` loads up to an order, lower orders first."""
    return tuple(
        index
        for degree in range(order + 1)
        for index in combinations_with_replacement(range(loads), degree)
    )


@cache
def joins(loads: int, here: int, there: int) -> tuple[NDArray[np.intp], Floats]:
    """Return the index in `indices` of each covariance's derivative by x - v, and its sign.

    Shape (here, there): the numbers of derivatives of the two rows; see `derivative_count`.
    """
    order = order_of(here, loads) + order_of(there, loads)
    position = {index: number for number, index in enumerate(indices(loads, order))}
    left = indices(loads, order_of(here, loads))
    right = indices(loads, order_of(there, loads))
    joined = np.array([[position[tuple(sorted(a + b))] for b in right] for a in left])
    sign = np.tile([(-1.0) ** len(b) for b in right], (here, 1))
    joined.flags.writeable = sign.flags.writeable = False  # shared by all callers
    return joined, sign


def matern(q: Floats, order: int = 3, smoothness: int = SLOPES_SMOOTHNESS) -> list[Floats]:
    """Return Matern p + 1/2 of the squared scaled distance and its derivatives by it to an order.

    With a = sqrt((2 p + 1) q) it is B_p(a) exp(-a) / B_p(0), B the reverse Bessel polynomials
    B_n = (2 n - 1) B_(n-1) + a^2 B_(n-2), B_0 = 1, B_1 = 1 + a (Krall and Frink 1949). From
    d/da (B_n exp(-a)) = -a B_(n-1) exp(-a), its derivative by q is -(2 p + 1)/2 B_(n-1) exp(-a).

    All have the shape of `q`, dimensionless. Those beyond p, which grow without bounds towards
    0, are 0 there: in a covariance they stand with powers of the distance that vanish.
    """
    twice = 2.0 * smoothness + 1
    a = np.sqrt(twice * q)
    decay = np.exp(-a)
    bessel = {0: decay, 1: (1 + a) * decay}
    for n in range(2, smoothness + 1):
        bessel[n] = (2 * n - 1) * bessel[n - 1] + a**2 * bessel[n - 2]
    if order > smoothness:
        with np.errstate(divide="ignore"):
            over = np.where(a > 0, 1 / a, 0.0)
        bessel |= {-1: over * decay, -2: (1 + a) * over**3 * decay}
    at_zero = float(prod(range(1, 2 * smoothness, 2)))
    return [(-twice / 2) ** r / at_zero * bessel[smoothness - r] for r in range(order + 1)]


def derivatives_of_term(
    delta: Floats, rates: Floats, order: int, smoothness: int, first: int = 0
) -> list[Floats]:
    """Return the derivatives of one term by the loads it sees, up to an order.

    With s_a = t_a d_a, each follows from lower ones of the next derivative by q: D_(K + a) m(q) = 2
    s_a D_K m'(q) + 2 t_a k_a D_(K - a) m'(q), k_a how often K has a.

    `delta` (l, p): differences of p pairs in the l loads that the term depends on, half ranges.
    `rates` (l,), dimensionless: t of these loads.
    `first`: replaces m by its derivative by q of this order; 0 for m itself. Each derivative has
    the shape (p,); their order is that of `indices`.
    """
    loads = len(rates)
    radial = matern(rates @ delta**2, first + order, smoothness)[first:]
    twice = 2 * rates[:, None] * delta
    derived: dict[tuple[int, Index], Floats] = {(r, ()): radial[r] for r in range(order + 1)}
    for index in indices(loads, order)[1:]:
        lower = index[:-1]
        load = index[-1]
        for r in range(order + 1 - len(index)):
            value = twice[load] * derived[r + 1, lower]
            if load in lower:
                twice_lower = list(lower)
                twice_lower.remove(load)
                value += 2 * rates[load] * lower.count(load) * derived[r + 1, tuple(twice_lower)]
            derived[r, index] = value
    return [derived[0, index] for index in indices(loads, order)]


@cache
def positions_of(loads: int, chosen: Index, order: int) -> tuple[int, ...]:
    """Return the positions of the derivatives by chosen loads among those by all."""
    position = {index: number for number, index in enumerate(indices(loads, order))}
    return tuple(
        position[tuple(chosen[load] for load in index)] for index in indices(len(chosen), order)
    )


def derivatives(delta: Floats, hyperparameters: Hyperparameters, order: int) -> Floats:
    """Return the derivatives of the covariance by x - v up to an order, (p, k), dimensionless.

    `delta` (p, 6), half ranges: the differences of p pairs. The k derivatives are in the order of
    `indices`.
    """
    loads = delta.shape[1]
    out = np.zeros((len(indices(loads, order)), len(delta)))
    for rates, weight in zip(*hyperparameters.terms, strict=True):
        chosen = tuple(np.flatnonzero(rates).tolist())
        columns = np.ascontiguousarray(delta.T[list(chosen)])
        term = derivatives_of_term(columns, rates[list(chosen)], order, hyperparameters.smoothness)
        for position, derivative in zip(positions_of(loads, chosen, order), term, strict=True):
            out[position] += weight * derivative
    return out.T


def block(x: Floats, v: Floats, hyperparameters: Hyperparameters, here: int, there: int) -> Floats:
    """Return the covariance (n, here, m, there) of rows at x (n, 6) and v (m, 6), half ranges.

    `here` and `there`: how many derivatives a row has at x and at v; see `derivative_count`.
    """
    loads = x.shape[1]
    order = order_of(here, loads) + order_of(there, loads)
    delta = (x[:, None] - v).reshape(-1, loads)
    joined, sign = joins(loads, here, there)
    values = derivatives(delta, hyperparameters, order)[:, joined] * sign
    return values.reshape(len(x), len(v), here, there).swapaxes(1, 2)


def covariances_of_values(
    x: Floats, groups: Floats, inverse_squares: Iterable[float]
) -> Iterator[tuple[Floats, Floats]]:
    """Yield the covariance (n, n) of values by the load groups, and that by the term of all loads.

    There is a pair for each inverse square, which all loads have in common. The variance of each
    term is 1, and `smoothness` 3.

    `x` (n, l), half ranges; `groups` (g, l): see `Hyperparameters`.
    """
    apart = squared_differences(x)
    squares = [apart @ group for group in groups]
    for inverse_square in inverse_squares:
        *axes, joint = (matern(inverse_square * square, 0)[0] for square in squares)
        yield symmetric(np.sum(axes, axis=0), len(x)), symmetric(joint, len(x))


def squared_differences(x: Floats) -> Floats:
    """Return the squared differences of all pairs of rows at x (n, l), a row with itself included.

    Shape (n (n + 1) / 2, l): each pair once, which halves the cost; see `symmetric`.
    """
    first, second = np.triu_indices(len(x))
    return np.asarray((x[first] - x[second]) ** 2)


def symmetric(values: Floats, n: int) -> Floats:
    """Return the symmetric matrix (n, n) with these values (n (n + 1) / 2,) of all pairs."""
    first, second = np.triu_indices(n)
    matrix = np.empty((n, n))
    matrix[first, second] = matrix[second, first] = values
    return matrix


def weighted_products(columns: Floats, weights: Floats) -> Floats:
    """Return B' D B, (r, c, c), of columns B (n, c) for each diagonal D of weights (r, n)."""
    count = columns.shape[1]
    first, second = np.triu_indices(count)
    rows = np.ascontiguousarray(columns.T)
    products = weights @ (rows[first] * rows[second]).T
    matrices = np.empty((len(weights), count, count))
    matrices[:, first, second] = matrices[:, second, first] = products
    return matrices


def covariance(
    x: Floats, known_x: Mask, v: Floats, known_v: Mask, hyperparameters: Hyperparameters
) -> Floats:
    """Return the covariance (e, f) of the e equations of rows at x and the f of rows at v.

    `x`, `v` (n, 6) and (m, 6), half ranges.
    `known_x`, `known_v` (n, p) and (m, p): which derivatives each row brings; their true entries,
    row by row, are the equations.
    """
    out = np.empty((int(known_x.sum()), int(known_v.sum())))
    first_x, first_v = numbers(known_x), numbers(known_v)
    for there, columns in _rows_by_order(known_v, x.shape[1]):
        wanted_v = known_v[columns, :there]
        for here, every_row in _rows_by_order(known_x, x.shape[1]):
            size = len(every_row) * len(columns) * here * there
            for rows in np.array_split(every_row, 1 + size // MAX_COVARIANCES):
                wanted_x = known_x[rows, :here]
                values = block(x[rows], v[columns], hyperparameters, here, there)
                values = values.reshape(wanted_x.size, wanted_v.size)
                target = first_x[rows, :here][wanted_x], first_v[columns, :there][wanted_v]
                out[np.ix_(*target)] = values[np.ix_(wanted_x.ravel(), wanted_v.ravel())]
    return out


def _rows_by_order(known: Mask, loads: int) -> list[tuple[int, NDArray[np.intp]]]:
    """Return the number of derivatives and the rows that bring these, for each order."""
    counts = np.full(len(known), 1)
    for order in (1, 2):
        count = derivative_count(loads, order)
        counts[known[:, derivative_count(loads, order - 1) : count].any(axis=1)] = count
    return [(int(count), np.flatnonzero(counts == count)) for count in np.unique(counts)]


def numbers(known: Mask) -> NDArray[np.intp]:
    """Return the index of each derivative's equation, shape (n, p); no meaning where not known."""
    return (np.cumsum(known.ravel()) - 1).reshape(known.shape)


def mean_terms(x: Floats, known: Mask) -> Floats:
    """Return the mean's terms, 1 and the loads, or their derivatives, at each equation, (e, 7).

    `x` (n, 6), half ranges; `known` (n, p): see `covariance`. Those of second derivatives are 0.
    """
    n, loads = x.shape
    terms = np.zeros((n, known.shape[1], 1 + loads))
    terms[:, 0, 0] = 1.0
    terms[:, 0, 1:] = x
    slopes = terms[:, 1 : 1 + loads, 1:]
    slopes[:] = np.eye(loads)[: slopes.shape[1]]
    return terms[known]
