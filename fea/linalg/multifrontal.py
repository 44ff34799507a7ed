"""Multifrontal Cholesky factorisation over nested substructures.

Each substructure of `fea.linalg.nested_dissection` is one dense front [[A, B], [B^T, C]]:
A = L L^T, W = L^-1 B,
and C - W^T W goes on to the parent. Only lower triangles of A and C are meaningful. A tangent that
is not positive definite (an unstable state, or a step of Newton's method on its way) is factorised
by LU of the pivot blocks instead.

The boundary's stiffness that goes on is stored in block columns, each without the rows above it:
five eighths of the square at four columns. It waits until the other half of the cut is done, and
after the factor it is the most of a solve's memory: as a square the peak of a block of 42,500
unknowns is some 30 MB of 335 higher. The sign is reversed, W^T W - C in place of C - W^T W: then
the product comes first and is written once, and the pivot block, gone by then, and this never take
memory together.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.blas import get_blas_funcs
from scipy.linalg.lapack import get_lapack_funcs
from threadpoolctl import ThreadpoolController

from wrenchbook.fea.linalg.nested_dissection import Dissection, Substructure
from wrenchbook.fea.tensors import TINY

_BLAS = ("trsm", "syrk")
_LAPACK = ("potrf", "trttf", "tfsm")
_ROUTINES: dict[Any, Any] = {  # by precision and name
    np.dtype(kind): dict(zip(_BLAS, get_blas_funcs(_BLAS, dtype=kind), strict=True))
    | dict(zip(_LAPACK, get_lapack_funcs(_LAPACK, dtype=kind), strict=True))
    for kind in (np.float32, np.float64)
}
_getrf, _getrs = get_lapack_funcs(("getrf", "getrs"), dtype=np.float64)

# Fronts of up to 3,500 unknowns take twice the time with two threads of BLAS.
_ONE_THREAD = ThreadpoolController().wrap(limits=1, user_api="blas")

Leaf = Callable[[int], np.ndarray]
"""Returns the matrix of a leaf by its index, its unknowns in the order of the substructure's."""

_WIDTH = 256
"""Approximate number of unknowns in a block column: from 192 to 384 BLAS is as fast."""

_ONE_COLUMN = 768
"""Number of unknowns below which a boundary is one block column, a square.

In columns of 256 a flange whose largest boundary has 705 takes 10 % longer, to save 2 MB of 210.
"""


class Condensed(NamedTuple):
    """Minus the condensed stiffness of one boundary, N/m; not above its diagonal."""

    starts: list[int]  # first unknown of each block column, and after the last
    # For each block column from a to b of n unknowns, shape (n - a, b - a), in Fortran's order
    blocks: list[np.ndarray]

    def holding(self, unknown: int) -> tuple[int, np.ndarray]:
        """Return the start of an unknown's block column, and the column: (n - a, b - a), N/m."""
        column = bisect_right(self.starts, unknown) - 1
        return self.starts[column], self.blocks[column]


class _Stretch(NamedTuple):
    """Consecutive unknowns within one block column of the child and one of the parent."""

    low: int  # first unknown of the child
    high: int  # last + 1
    to: int  # index of the first in the parent


class Route(NamedTuple):
    """Destination of a child's condensed stiffness in its parent."""

    # Shape (n,), ascending: of the child's unknowns among the m + b of the parent
    indices: np.ndarray
    pivots: int  # number of these unknowns that the parent eliminates
    stretches: list[_Stretch]  # in ascending order


def columns_of(unknowns: int) -> list[int]:
    """Return the starts of the block columns of a boundary, and its end."""
    count = round(unknowns / _WIDTH) if unknowns >= _ONE_COLUMN else 1
    return [unknowns * i // count for i in range(count + 1)]


def products(
    left: np.ndarray, right: np.ndarray, square: Callable[[np.ndarray], np.ndarray] | None
) -> Condensed:
    """Return the lower triangle of left^T right, which is symmetric.

    left, right: shape (m, n): N^0.5/m^0.5 both, or N/m and dimensionless; in Fortran's order.
    square: computes the lower triangle of X^T X for the columns X of `right` faster than the
    product, if `left` is `right`.
    """
    count = right.shape[1]
    starts = columns_of(count)
    blocks = []
    for a, b in pairwise(starts):
        columns = right[:, a:b]
        diagonal = square(columns) if square and columns.size else left[:, a:b].T @ columns
        if b - a == count:
            blocks.append(diagonal)
            continue
        block = np.empty((b - a, count - a), dtype=right.dtype).T
        block[: b - a] = diagonal
        np.matmul(columns.T, left[:, b:], out=block.T[:, b - a :])
        blocks.append(block)
    return Condensed(starts, blocks)


def add_leaf(target: Condensed, matrix: np.ndarray) -> None:
    """Subtract a leaf's stiffness of its boundary, shape (n, n), N/m, from minus the condensed."""
    for (a, b), block in zip(pairwise(target.starts), target.blocks, strict=True):
        block -= matrix[a:, a:b]


def route(part: Condensed, indices: np.ndarray, eliminated: int, boundary: int) -> Route:
    """Return the route of a child whose unknowns have the `indices`, shape (n,), in its parent.

    `eliminated` and `boundary` are the parent's numbers m and b of unknowns.
    """
    pivots = int(indices.searchsorted(eliminated))
    gaps = np.flatnonzero(indices[1:] - indices[:-1] != 1) + 1
    bounds = {*gaps.tolist(), *part.starts, pivots}
    columns = columns_of(boundary)
    if len(columns) > 2:
        bounds.update(indices.searchsorted([eliminated + column for column in columns]).tolist())
    ordered = sorted(bounds)
    firsts = indices[ordered[:-1]].tolist()
    return Route(indices, pivots, list(map(_Stretch, ordered, ordered[1:], firsts)))


def add_to_pivots(A: np.ndarray, B: np.ndarray, part: Condensed, way: Route) -> None:
    """Add a child's condensed stiffness to the rows of the pivots.

    It is added by stretches of columns, whose rows in A may have gaps: stretches in both directions
    would be thousands of additions of a few numbers each.

    A: shape (m, m), N/m: stiffness of the eliminated unknowns, the lower triangle.
    B: shape (m, b), N/m: the same with the boundary.
    part, way: the child's condensed stiffness and route.
    """
    indices, pivots, stretches = way
    across = [
        (slice(low - pivots, high - pivots), slice(to - len(A), to - len(A) + high - low))
        for low, high, to in stretches
        if low >= pivots
    ]
    for low, high, to in stretches:
        if low >= pivots:
            break
        a, block = part.holding(low)
        target = slice(to, to + high - low)
        update = block[low - a :, low - a : high - a]
        A[indices[low:pivots], target] -= update[: pivots - low]
        below = update[pivots - low :]
        for source, column in across:
            B[target, column] -= below[source].T


def add_to_boundary(total: Condensed, part: Condensed, way: Route, eliminated: int) -> None:
    """Add a child's condensed stiffness to that of its parent."""
    for low, high, to in way.stretches:
        if low < way.pivots:
            continue
        a, block = part.holding(low)
        first, target = total.holding(to - eliminated)
        shift = eliminated + first
        columns = slice(to - shift, to - shift + high - low)
        target[way.indices[low:] - shift, columns] += block[low - a :, low - a : high - a]


_SINGLE_PIVOT = 5e-3
"""Least pivot ratio for single precision: rods of 1:10 have 4e-2, of 1:25 (not refined) 3e-3."""


class NotDefinite(ArithmeticError):  # noqa: N818 - a finding about the matrix
    """A pivot block is not positive definite, or its pivot ratio too small for single precision."""


class MultifrontalFactor:
    """A factorised stiffness matrix.

    dissection: the order of elimination.
    leaf: returns the matrix of each leaf, N/m; called when the leaf is needed, so that few are in
    memory.
    single: in half the memory; solutions need refinement.

    Its attributes:
    definite: whether the matrix is positive definite.
    pivot_ratio: the least ratio of a pivot to the diagonal entry before elimination. Near roundoff
    some motion has no stiffness. 0 if the matrix is not definite.
    weakest: position of the unknown with that ratio.
    diagonal: shape (unknowns,), N/m: diagonal of the matrix.

    Raises NotDefinite if `single` and the matrix is not definite or a pivot ratio is below
    _SINGLE_PIVOT.
    """

    @_ONE_THREAD
    def __init__(self, dissection: Dissection, leaf: Leaf, single: bool = False) -> None:
        self._dissection = dissection
        self._single = single
        self.unknowns = dissection.unknowns
        try:
            self._fronts, self.diagonal = _eliminate(dissection, leaf, _CholeskyFront, single)
            self.definite = True
        except NotDefinite:
            if single:
                raise
            self.definite = False
        if not self.definite:  # in this place, as the exception would keep the fronts in memory
            self._fronts, self.diagonal = _eliminate(dissection, leaf, _LUFront)
        self.pivot_ratio = 1.0
        self.weakest = -1
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
    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Solve for several load cases.

        loads: shape (unknowns, k), N, in the order of elimination.
        Result: shape (unknowns, k), m, in the same order.
        """
        # Single precision has a smaller range of exponents.
        scale = np.abs(loads).max(axis=0, initial=TINY) if self._single else 1.0
        x = np.array(loads / scale, dtype=np.float32 if self._single else float, order="C")
        fronts = list(zip(self._dissection.substructures, self._fronts, strict=True))
        for part, front in fronts:
            front.forward(x, part)
        for part, front in reversed(fronts):
            front.backward(x, part)
        return x * scale


class _Front(ABC):
    """The eliminated unknowns of one substructure, m of them, by its boundary of b."""

    __slots__ = ()
    pivots: np.ndarray  # shape (m,), N/m: sizes of the pivots

    @property
    def negatives(self) -> int:
        """Number of negative eigenvalues of the pivot block."""
        return 0

    @abstractmethod
    def products(self) -> Condensed:
        """Return the change of the boundary's stiffness by the elimination."""

    @abstractmethod
    def forward(self, x: np.ndarray, part: Substructure) -> None:
        """Eliminate the unknowns from loads, shape (unknowns, k), in place."""

    @abstractmethod
    def backward(self, x: np.ndarray, part: Substructure) -> None:
        """Replace the unknowns' loads by displacements, those of the boundary known, in place."""


class _CholeskyFront(_Front):
    """L and W of one substructure; L packed into a rectangle of half its square.

    The packed form is LAPACK's (Gustavson, Wasniewski, Dongarra and Langou 2010), which solves with
    blocks as the square does.
    """

    __slots__ = ("L", "W", "pivots")

    def __init__(self, A: np.ndarray, B: np.ndarray) -> None:
        routines = _ROUTINES[A.dtype]
        L, info = routines["potrf"](A, lower=1, clean=0, overwrite_a=1)
        if info:
            raise NotDefinite
        self.W = B
        if B.size:
            self.W = routines["trsm"](1.0, L, B, lower=1, overwrite_b=1)
        self.pivots = np.diagonal(L) ** 2
        self.L, _ = routines["trttf"](L, uplo="L")

    def products(self) -> Condensed:
        syrk = _ROUTINES[self.W.dtype]["syrk"]
        return products(self.W, self.W, partial(syrk, 1.0, trans=1, lower=1))

    def forward(self, x: np.ndarray, part: Substructure) -> None:
        rows = slice(part.start, part.stop)
        y = _ROUTINES[x.dtype]["tfsm"](1.0, self.L, x[rows], uplo="L")
        x[rows] = y
        if part.boundary.size:
            x[part.boundary] -= self.W.T @ y

    def backward(self, x: np.ndarray, part: Substructure) -> None:
        rows = slice(part.start, part.stop)
        y = x[rows]
        if part.boundary.size:
            y = y - self.W @ x[part.boundary]
        x[rows] = _ROUTINES[x.dtype]["tfsm"](1.0, self.L, y, uplo="L", trans="T")


class _LUFront(_Front):
    """LU of the pivot block and A^-1 B of one substructure."""

    __slots__ = ("A", "B", "W", "lu", "pivots", "swaps")

    def __init__(self, A: np.ndarray, B: np.ndarray) -> None:
        self.A = A = np.tril(A) + np.tril(A, -1).T
        self.lu, self.swaps, info = _getrf(A)
        if info > 0:  # exactly singular: the factor only serves to name the node
            diagonal = np.einsum("ii->i", self.lu)
            # Smaller than any roundoff, but its inverse does not overflow.
            diagonal[diagonal == 0] = np.finfo(float).eps ** 2 * np.abs(A).max()
        self.pivots = np.abs(np.diagonal(self.lu))
        self.B = B
        self.W = _getrs(self.lu, self.swaps, B)[0] if B.size else B

    def products(self) -> Condensed:
        product = products(self.B, self.W, None)
        del self.B  # no longer needed: about a quarter of the front's memory
        return product

    @property
    def negatives(self) -> int:
        return int((np.linalg.eigvalsh(self.A) < 0).sum())

    def forward(self, x: np.ndarray, part: Substructure) -> None:
        rows = slice(part.start, part.stop)
        if part.boundary.size:
            x[part.boundary] -= self.W.T @ x[rows]

    def backward(self, x: np.ndarray, part: Substructure) -> None:
        rows = slice(part.start, part.stop)
        y = _getrs(self.lu, self.swaps, x[rows])[0]
        if part.boundary.size:
            y = y - self.W @ x[part.boundary]
        x[rows] = y


_Kind = type[_CholeskyFront] | type[_LUFront]


class _EmptyFront(_Front):
    """A front without eliminated unknowns."""

    __slots__ = ("_boundary",)
    pivots = np.empty(0)

    def __init__(self, boundary: int) -> None:
        self._boundary = boundary

    def products(self) -> Condensed:
        none = np.empty((0, self._boundary), order="F")
        return products(none, none, None)

    def forward(self, x: np.ndarray, part: Substructure) -> None:
        pass

    def backward(self, x: np.ndarray, part: Substructure) -> None:
        pass


def _eliminate(
    dissection: Dissection, leaf: Leaf, kind: _Kind, single: bool = False
) -> tuple[list[_Front], np.ndarray]:
    """Factorise front by front; return the fronts, and the diagonal of the matrix, (unknowns,)."""
    diagonal = np.zeros(dissection.unknowns)
    dtype = np.float32 if single else np.float64
    fronts: list[_Front] = []
    condensed: dict[int, Condensed] = {}
    for number, part in enumerate(dissection.substructures):
        if part.children:
            front, handed_on = _branch(part, condensed, kind, dtype)
        else:
            matrix = leaf(number)
            diagonal_of_leaf = np.diagonal(matrix)
            diagonal[part.start : part.stop] += diagonal_of_leaf[: part.eliminated]
            diagonal[part.boundary] += diagonal_of_leaf[part.eliminated :]
            front, handed_on = _leaf(part, matrix.astype(dtype, copy=False), kind)
        if single and (front.pivots < _SINGLE_PIVOT * diagonal[part.start : part.stop]).any():
            raise NotDefinite
        fronts.append(front)
        condensed[number] = handed_on
    return fronts, diagonal


def _leaf(part: Substructure, matrix: np.ndarray, kind: _Kind) -> tuple[_Front, Condensed]:
    """Return the front of a leaf and its condensed stiffness."""
    pivots = slice(0, part.eliminated)
    boundary = slice(part.eliminated, None)
    matrix = matrix.T  # symmetric; columns then are contiguous as in a front
    front: _Front = _EmptyFront(part.boundary.size)
    if part.eliminated:
        front = kind(
            matrix[pivots, pivots].copy(order="F"), matrix[pivots, boundary].copy(order="F")
        )
    handed_on = front.products()
    add_leaf(handed_on, matrix[boundary, boundary])
    return front, handed_on


def _branch(
    part: Substructure, condensed: dict[int, Condensed], kind: _Kind, dtype: type[np.floating]
) -> tuple[_Front, Condensed]:
    """Return a branch's front and condensed stiffness; delete those of its children."""
    eliminated, boundary = part.eliminated, part.boundary.size
    ways = [
        route(condensed[child], indices, eliminated, boundary)
        for child, indices in zip(part.children, part.indices, strict=True)
    ]
    front: _Front = _EmptyFront(boundary)
    if eliminated:
        A = np.zeros((eliminated, eliminated), order="F", dtype=dtype)
        B = np.zeros((eliminated, boundary), order="F", dtype=dtype)
        for child, way in zip(part.children, ways, strict=True):
            add_to_pivots(A, B, condensed[child], way)
        front = kind(A, B)
        del A, B  # the factor has them
    handed_on = front.products()
    for child, way in zip(part.children, ways, strict=True):
        add_to_boundary(handed_on, condensed.pop(child), way, eliminated)
    return front, handed_on
