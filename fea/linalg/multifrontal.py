"""Multifrontal Cholesky factorisation over nested substructures.

Each substructure of `fea.linalg.nested_dissection` is one dense front [[A, B], [B^T, C]]:
A = L L^T, W = L^-1 B,
and C - W^T W goes on to the parent. Only lower triangles of A and C are meaningful. A tangent that
is not positive definite (an unstable state, or a step of Newton's method on its way) is factorised
by LU of the pivot blocks instead.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import get_blas_funcs
from scipy.linalg.lapack import get_lapack_funcs

from fea.linalg.nested_dissection import Dissection, Substructure

Array = np.ndarray

_like = (np.empty((1, 1), order="F"),)
_trsm, _syrk = get_blas_funcs(("trsm", "syrk"), _like)
_potrf, _getrf, _getrs = get_lapack_funcs(("potrf", "getrf", "getrs"), _like)
_trttf, _tfsm = get_lapack_funcs(("trttf", "tfsm"), _like)


Leaf = Callable[[int], Array]
"""Gives the matrix of a leaf by its number, its unknowns in the order of the substructure's."""


class NotDefinite(ArithmeticError):  # noqa: N818 - a finding about the matrix
    """A pivot block is not positive definite."""


class Factor:
    """A factorised stiffness matrix.

    Parameters
    ----------
    dissection
        The order of elimination.
    leaf
        Gives the matrix of each leaf, N/m; asked when it is due, so that few are there at a time.

    Attributes
    ----------
    definite
        Whether the matrix is positive definite.
    pivot_ratio
        The least ratio of a pivot to the diagonal entry it came from: what elimination left of the
        stiffness there. Near roundoff it says that some motion has no stiffness. 0 if the matrix
        is not definite.
    weakest
        Position of the unknown with that ratio.
    diagonal
        Shape (unknowns,): that of the matrix.
    """

    def __init__(self, dissection: Dissection, leaf: Leaf) -> None:
        self._dissection = dissection
        self.unknowns = dissection.unknowns
        try:
            self._fronts, self.diagonal = _eliminate(dissection, leaf, _CholeskyFront)
            self.definite = True
        except NotDefinite:
            self._fronts, self.diagonal = _eliminate(dissection, leaf, _LUFront)
            self.definite = False
        self.pivot_ratio, self.weakest = 1.0, -1
        if self.unknowns:
            ratios = np.concatenate([front.pivots for front in self._fronts])
            ratios /= self.diagonal
            self.weakest = int(ratios.argmin())
            self.pivot_ratio = float(ratios[self.weakest]) if self.definite else 0.0

    @cached_property
    def negatives(self) -> int:
        """Number of negative eigenvalues: by Sylvester's law, those of the pivot blocks."""
        return 0 if self.definite else sum(front.negatives for front in self._fronts)

    def solve(self, loads: Array) -> Array:
        """Solve for several load cases.

        Parameters
        ----------
        loads
            Shape (unknowns, k), N, in the order of elimination.

        Returns
        -------
        Array
            Shape (unknowns, k), m, in the same order.
        """
        x = np.array(loads, dtype=float, order="C")
        for part, front in zip(self._dissection.substructures, self._fronts, strict=True):
            if part.eliminated:
                front.forward(x, part)
        for part, front in zip(
            self._dissection.substructures[::-1], self._fronts[::-1], strict=True
        ):
            if part.eliminated:
                front.backward(x, part)
        return x


class _CholeskyFront:
    """L and W of one substructure; L packed into a rectangle of half its square.

    The packed form is LAPACK's (Gustavson, Wasniewski, Dongarra and Langou 2010), which solves with
    blocks as the square does.
    """

    __slots__ = ("L", "W", "pivots")

    def __init__(self, A: Array, B: Array, C: Array) -> None:
        L, info = _potrf(A, lower=1, clean=0, overwrite_a=1)
        if info:
            raise NotDefinite
        self.W = B
        if B.size:
            self.W = _trsm(1.0, L, B, lower=1, overwrite_b=1)
        self.pivots = np.diagonal(L) ** 2
        self.L, _ = _trttf(L, uplo="L")

    def condense(self, C: Array) -> Array:
        """Take from the boundary stiffness what the eliminated unknowns give way."""
        return _syrk(-1.0, self.W, beta=1.0, c=C, trans=1, lower=1, overwrite_c=1)

    def forward(self, x: Array, part: Substructure) -> None:
        own = slice(part.start, part.stop)
        y = _tfsm(1.0, self.L, x[own], uplo="L")
        x[own] = y
        if part.boundary.size:
            x[part.boundary] -= self.W.T @ y

    def backward(self, x: Array, part: Substructure) -> None:
        own = slice(part.start, part.stop)
        y = x[own]
        if part.boundary.size:
            y = y - self.W @ x[part.boundary]
        x[own] = _tfsm(1.0, self.L, y, uplo="L", trans="T")


class _LUFront:
    """LU of the pivot block and A^-1 B of one substructure."""

    __slots__ = ("A", "B", "W", "lu", "swaps")

    def __init__(self, A: Array, B: Array, C: Array) -> None:
        self.A = A = np.tril(A) + np.tril(A, -1).T
        self.lu, self.swaps, info = _getrf(A)
        if info > 0:  # exactly singular: the factor is of use for naming the place only
            pivots = np.einsum("ii->i", self.lu)
            pivots[pivots == 0] = np.finfo(float).tiny
        self.B = B
        self.W = _getrs(self.lu, self.swaps, B)[0] if B.size else B

    def condense(self, C: Array) -> Array:
        return C - self.B.T @ self.W

    @property
    def pivots(self) -> Array:
        return np.abs(np.diagonal(self.lu))

    @property
    def negatives(self) -> int:
        return int((np.linalg.eigvalsh(self.A) < 0).sum())

    def forward(self, x: Array, part: Substructure) -> None:
        own = slice(part.start, part.stop)
        if part.boundary.size:
            x[part.boundary] -= self.W.T @ x[own]

    def backward(self, x: Array, part: Substructure) -> None:
        own = slice(part.start, part.stop)
        y = _getrs(self.lu, self.swaps, x[own])[0]
        if part.boundary.size:
            y = y - self.W @ x[part.boundary]
        x[own] = y


def _eliminate(dissection: Dissection, leaf: Leaf, kind: type) -> tuple[list, Array]:
    """Factorise front by front; a condensed part is dropped once its parent has taken it.

    Returns the fronts and the diagonal of the whole matrix.
    """
    diagonal = np.zeros(dissection.unknowns)
    fronts: list = []
    condensed: dict[int, Array] = {}
    for number, part in enumerate(dissection.substructures):
        if part.children:
            A, B, C = _join(part, condensed)
        else:
            matrix = leaf(number)
            own = np.diagonal(matrix)
            diagonal[part.start : part.stop] += own[: part.eliminated]
            diagonal[part.boundary] += own[part.eliminated :]
            A, B, C = _cut_blocks(matrix, part.eliminated)
        if not part.eliminated:
            fronts.append(_EMPTY)
            condensed[number] = C
            continue
        front = kind(A, B, C)
        fronts.append(front)
        condensed[number] = front.condense(C) if C.size else C
    return fronts, diagonal


class _EmptyFront:
    """Nothing is eliminated here."""

    pivots = np.empty(0)
    negatives = 0


_EMPTY = _EmptyFront()


def _cut_blocks(leaf: Array, eliminated: int) -> tuple[Array, Array, Array]:
    own, rest = slice(0, eliminated), slice(eliminated, None)
    return (
        leaf[own, own].copy(order="F"),
        leaf[own, rest].copy(order="F"),
        leaf[rest, rest].copy(order="F"),
    )


def _join(part: Substructure, condensed: dict[int, Array]) -> tuple[Array, Array, Array]:
    """Add the condensed stiffness of two parts.

    Places ascend, so lower triangles stay lower.
    """
    own, rest = part.eliminated, part.boundary.size
    A = np.zeros((own, own), order="F")
    B = np.zeros((own, rest), order="F")
    C = np.zeros((rest, rest), order="F")
    for child, places in zip(part.children, part.places, strict=True):
        S = condensed.pop(child)
        count = int(np.searchsorted(places, own))
        first, second = _runs(places[:count]), _runs(places[count:] - own)
        _add_lower(A, S[:count, :count], places[:count], first)
        _add(B.T, S[count:, :count], second, first)
        _add_lower(C, S[count:, count:], places[count:] - own, second)
    return A, B, C


def _runs(places: Array) -> list[tuple[slice, slice]]:
    """Split ascending places into stretches without gaps: (from, to) slices."""
    if not places.size:
        return []
    ends = np.flatnonzero(np.diff(places) != 1) + 1
    bounds = [0, *ends.tolist(), places.size]
    return [
        (slice(low, high), slice(int(places[low]), int(places[low]) + high - low))
        for low, high in pairwise(bounds)
    ]


def _add_lower(target: Array, part: Array, places: Array, runs: list) -> None:
    """Add a lower triangle at ascending places, a stretch of columns at a time.

    Stretch by stretch in both directions would be thousands of additions of a few numbers each.
    """
    for source, columns in runs:
        target[places[source.start :], columns] += part[source.start :, source]


def _add(target: Array, part: Array, rows: list, columns: list) -> None:
    for source_row, row in rows:
        for source_column, column in columns:
            target[row, column] += part[source_row, source_column]
