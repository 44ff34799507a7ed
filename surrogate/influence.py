"""A polynomial for what straight direction influence leaves out, fitted to rows and tangents.

The composition has no term for loads of different axes acting together, nor for u_i under loads
that are not axis i's. Up to third order those terms are few, and rows tell them three ways: a full
wrench shows all of them; a row clean for another axis shows u_i under that axis' loads; and a
row's tangent shows how u_i changes with the off-axis loads that the row does not have, without any
further solve. Degree and damping are chosen by cross-validation, none at all being the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from surrogate.table.axes import AXES
from surrogate.table.rows import Floats

TERMS = tuple(term for d in (1, 2, 3) for term in combinations_with_replacement(range(6), d))
DEGREES = np.array([len(term) for term in TERMS])
_PAIRS = np.array([term for term in TERMS if len(term) == 2])
_TRIPLES = np.array([term for term in TERMS if len(term) == 3])
_PAIR_OF = {tuple(pair): place for place, pair in enumerate(_PAIRS.tolist())}
_FIRST, _SECOND = _PAIRS.T
_OF_PAIR = np.array([_PAIR_OF[(a, b)] for a, b, _ in _TRIPLES.tolist()])
_THIRD = _TRIPLES[:, 2]

# Terms that the composition has: for u_i those of axis i's loads, for rotations those of any axis.
_INSIDE = np.array([[set(term) <= set(axis.inputs) for term in TERMS] for axis in AXES])
FREE = ~np.concatenate((_INSIDE, np.repeat(_INSIDE.any(axis=0, keepdims=True), 3, axis=0)))

DAMPINGS = (1e-6, 1e-3, 1e-1)
FOLDS = 5
FEWEST = 8  # equations a term needs not to be noise is 2; this many rows at least
BETTER = 0.9  # of the error without any term: what a polynomial must reach in cross-validation
SLOPE_WEIGHT = 0.3  # a slope is told where the row is, and what counts is some way off


@dataclass(frozen=True)
class Shown:
    """What rows show of one output: terms times coefficients is what was missed.

    Attributes
    ----------
    equations : ndarray, shape (e, t)
    missed : ndarray, shape (e,)
    row : ndarray of int, shape (e,)
        Which row each equation comes from.
    """

    equations: Floats
    missed: Floats
    row: np.ndarray


class Influence:
    """The fitted polynomial: coefficients, shape (6, terms), m and rad, on scaled loads."""

    def __init__(self, coefficients: Floats, scale: Sequence[float]) -> None:
        self.coefficients, self.scale = coefficients, np.array(scale)
        self.silent = not coefficients.any()

    def at(self, wrench: Sequence[float]) -> list[float]:
        """Return the six left-out outputs, m and rad, for one wrench of floats."""
        x = np.array(wrench) / self.scale
        pairs = x[_FIRST] * x[_SECOND]
        return self.coefficients.dot(
            np.concatenate((x, pairs, pairs[_OF_PAIR] * x[_THIRD]))
        ).tolist()

    def many(self, wrenches: Floats) -> Floats:
        """Return them for wrenches of shape (n, 6)."""
        if self.silent:
            return np.zeros_like(wrenches)
        return monomials(wrenches / self.scale) @ self.coefficients.T


NO_INFLUENCE = Influence(np.zeros((6, len(TERMS))), (1.0,) * 6)


def monomials(x: Floats) -> Floats:
    """Return all terms up to third order of scaled wrenches (n, 6), shape (n, t)."""
    pairs = x[:, _FIRST] * x[:, _SECOND]
    return np.concatenate((x, pairs, pairs[:, _OF_PAIR] * x[:, _THIRD]), axis=1)


def monomial_slopes(x: Floats, load: int) -> Floats:
    """Return the derivative of all terms by one scaled load, shape (n, t)."""
    slopes = np.zeros((len(x), len(TERMS)))
    for place, term in enumerate(TERMS):
        count = term.count(load)
        if count:
            rest = list(term)
            rest.remove(load)
            slopes[:, place] = count * x[:, rest].prod(axis=1)
    return slopes


def shown_by(output: int, x: Floats, missed: Floats, valued: np.ndarray, tangent: Floats) -> Shown:
    """Return what rows at scaled wrenches (n, 6) show of one output.

    Parameters
    ----------
    missed : ndarray, shape (n,)
        True less composed, where `valued`.
    tangent : ndarray, shape (n, 6)
        Derivative of the output by the scaled loads; NaN where unknown.
    """
    places = np.flatnonzero(valued)
    blocks, targets, rows = [monomials(x[places])], [missed[places]], [places]
    told = np.flatnonzero(np.isfinite(tangent).all(axis=1))
    # Only a translation: the composition of rotations has slopes of its own in every load.
    for load in AXES[output].others if output < 3 else ():
        blocks.append(SLOPE_WEIGHT * monomial_slopes(x[told], load))
        targets.append(SLOPE_WEIGHT * tangent[told, load])
        rows.append(told)
    return Shown(np.concatenate(blocks), np.concatenate(targets), np.concatenate(rows))


def fit_output(output: int, shown: Shown) -> tuple[Floats, Floats]:
    """Return the coefficients (t,) of one output and what cross-validation leaves, shape (e,)."""
    nothing = np.zeros(len(TERMS))
    best, left = nothing, shown.missed
    count = len(np.unique(shown.row))
    if count < FEWEST or not shown.missed.any():
        return best, left
    least = BETTER**2 * float((left**2).sum())
    fold_of = (
        np.random.default_rng(20170726).permutation(int(shown.row.max()) + 1)[shown.row] % FOLDS
    )
    for degree in (1, 2, 3):
        terms = np.flatnonzero(FREE[output] & (degree >= DEGREES))
        if not len(terms):
            continue
        for damping in DAMPINGS:
            held = _held_out(shown, terms, damping, fold_of)
            size = float((held**2).sum())
            if size < least:
                least, left = size, held
                best = nothing.copy()
                best[terms] = _solve(shown.equations[:, terms], shown.missed, damping)
    return best, left


def _held_out(shown: Shown, terms: np.ndarray, damping: float, fold_of: np.ndarray) -> Floats:
    left = np.empty_like(shown.missed)
    equations = shown.equations[:, terms]
    for fold in range(FOLDS):
        held = fold_of == fold
        found = _solve(equations[~held], shown.missed[~held], damping)
        left[held] = shown.missed[held] - equations[held] @ found
    return left


def _solve(equations: Floats, missed: Floats, damping: float) -> Floats:
    """Solve damped least squares; the damping is relative to the mean diagonal."""
    normal = equations.T @ equations
    mean = max(float(np.trace(normal)) / len(normal), np.finfo(float).tiny)
    damped = normal + damping * mean * np.eye(len(normal))
    return np.asarray(np.linalg.solve(damped, equations.T @ missed), dtype=float)
