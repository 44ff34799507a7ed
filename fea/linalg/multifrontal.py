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
from typing import Any

import numpy as np
from scipy.linalg.blas import get_blas_funcs
from scipy.linalg.lapack import get_lapack_funcs
from threadpoolctl import ThreadpoolController

from wrenchbook.fea.linalg.condensed import (
    Condensed,
    add_leaf,
    add_to_boundary,
    add_to_pivots,
    products,
    route,
)
from wrenchbook.fea.linalg.nested_dissection import Dissection, Substructure

Array = np.ndarray

_like = (np.empty((1, 1), order="F"),)
_trsm, _syrk = get_blas_funcs(("trsm", "syrk"), _like)
_potrf, _getrf, _getrs = get_lapack_funcs(("potrf", "getrf", "getrs"), _like)
_trttf, _tfsm = get_lapack_funcs(("trttf", "tfsm"), _like)


# Fronts of up to 3,500 unknowns take twice the time by two threads of BLAS as by one.
_ONE_THREAD = ThreadpoolController().wrap(limits=1, user_api="blas")

Leaf = Callable[[int], Array]
"""Gives the matrix of a leaf by its number, its unknowns in the order of the substructure's."""


class NotDefinite(ArithmeticError):  # noqa: N818 - a finding about the matrix
    """A pivot block is not positive definite."""


class MultifrontalFactor:
    """A factorised stiffness matrix.

    Parameters
    ----------
    dissection
        The order of elimination.
    leaf
        Gives the matrix of each leaf, N/m; called when the leaf is due, so that few are in memory.

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

    @_ONE_THREAD
    def __init__(self, dissection: Dissection, leaf: Leaf) -> None:
        self._dissection = dissection
        self.unknowns = dissection.unknowns
        try:
            self._fronts, self.diagonal = _eliminate(dissection, leaf, _CholeskyFront)
            self.definite = True
        except NotDefinite:
            self.definite = False
        if not self.definite:  # here, as the exception keeps the fronts done so far
            self._fronts, self.diagonal = _eliminate(dissection, leaf, _LUFront)
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

    @_ONE_THREAD
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

    def __init__(self, A: Array, B: Array) -> None:
        L, info = _potrf(A, lower=1, clean=0, overwrite_a=1)
        if info:
            raise NotDefinite
        self.W = B
        if B.size:
            self.W = _trsm(1.0, L, B, lower=1, overwrite_b=1)
        self.pivots = np.diagonal(L) ** 2
        self.L, _ = _trttf(L, uplo="L")

    def products(self, boundary: int) -> Condensed:
        """Return by how much the boundary is less stiff for what is eliminated here."""
        return products(self.W, self.W, _square)

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


def _square(columns: Array) -> Array:
    return _syrk(1.0, columns, trans=1, lower=1)


class _LUFront:
    """LU of the pivot block and A^-1 B of one substructure."""

    __slots__ = ("A", "B", "W", "lu", "swaps")

    def __init__(self, A: Array, B: Array) -> None:
        self.A = A = np.tril(A) + np.tril(A, -1).T
        self.lu, self.swaps, info = _getrf(A)
        if info > 0:  # exactly singular: the factor is of use for naming the place only
            pivots = np.einsum("ii->i", self.lu)
            pivots[pivots == 0] = np.finfo(float).tiny
        self.B = B
        self.W = _getrs(self.lu, self.swaps, B)[0] if B.size else B

    def products(self, boundary: int) -> Condensed:
        taken = products(self.B, self.W, None)
        del self.B  # of no further use: about a quarter of what the front holds
        return taken

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
    condensed: dict[int, Condensed] = {}
    for number, part in enumerate(dissection.substructures):
        if part.children:
            front, handed_on = _branch(part, condensed, kind)
        else:
            matrix = leaf(number)
            own = np.diagonal(matrix)
            diagonal[part.start : part.stop] += own[: part.eliminated]
            diagonal[part.boundary] += own[part.eliminated :]
            front, handed_on = _leaf(part, matrix, kind)
        fronts.append(front)
        condensed[number] = handed_on
    return fronts, diagonal


class _EmptyFront:
    """Nothing is eliminated here."""

    pivots = np.empty(0)
    negatives = 0

    def products(self, boundary: int) -> Condensed:
        none = np.empty((0, boundary), order="F")
        return products(none, none, None)


_EMPTY = _EmptyFront()


def _leaf(part: Substructure, matrix: Array, kind: type) -> tuple[Any, Condensed]:
    """Return the front of a leaf and what it hands on."""
    own, rest = slice(0, part.eliminated), slice(part.eliminated, None)
    matrix = matrix.T  # symmetric; so its columns lie together as a front's do
    front = _EMPTY
    if part.eliminated:
        front = kind(matrix[own, own].copy(order="F"), matrix[own, rest].copy(order="F"))
    handed_on = front.products(part.boundary.size)
    add_leaf(handed_on, matrix[rest, rest])
    return front, handed_on


def _branch(
    part: Substructure, condensed: dict[int, Condensed], kind: type
) -> tuple[Any, Condensed]:
    """Return the front of a branch and what it hands on; what its parts did is dropped.

    Places ascend, so lower triangles stay lower.
    """
    eliminated, boundary = part.eliminated, part.boundary.size
    ways = [
        route(condensed[child], places, eliminated, boundary)
        for child, places in zip(part.children, part.places, strict=True)
    ]
    front = _EMPTY
    if eliminated:
        A = np.zeros((eliminated, eliminated), order="F")
        B = np.zeros((eliminated, boundary), order="F")
        for child, way in zip(part.children, ways, strict=True):
            add_to_pivots(A, B, condensed[child], way)
        front = kind(A, B)
        del A, B  # the factor has them
    handed_on = front.products(boundary)
    for child, way in zip(part.children, ways, strict=True):
        add_to_boundary(handed_on, condensed.pop(child), way, eliminated)
    return front, handed_on
