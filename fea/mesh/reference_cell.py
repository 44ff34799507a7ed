"""Reference elements: shape functions and quadrature, in VTK node order.

The shape functions and points are scikit-fem's. They are tabulated once for each kind and rule, in
the node order of `fea.mesh.mesh`; the map to the real cell is then the isoparametric map of the
cell's nodes (`fea.mesh.mapping`), which sets neither the sign of a determinant nor the position
of a midside node by convention.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import skfem
from scipy.special import roots_jacobi
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet, RefTri

from wrenchbook.fea.mesh.facets import EDGES

Array = np.ndarray

_HEX_CORNERS = "000 100 110 010 001 101 111 011"
_HEX_EDGES = "500 150 510 050 501 151 511 051 005 105 115 015"
_WEDGE_CORNERS = "000 100 010 001 101 011"
_PYRAMID_CORNERS = "000 100 110 010 001"  # any other apex is an affine map away
_QUAD_CORNERS = "00 10 11 01"
_QUAD_EDGES = "50 15 51 05"
_TRI_EDGES = "50 55 05"

# Reference coordinates of the nodes in VTK order; the digit 5 stands for one half.
_COORDINATES = {
    "hex8": _HEX_CORNERS,
    "hex20": f"{_HEX_CORNERS} {_HEX_EDGES}",
    "hex27": f"{_HEX_CORNERS} {_HEX_EDGES} 055 155 505 515 550 551 555",
    "tet4": "000 100 010 001",
    "tet10": "000 100 010 001 500 550 050 005 505 055",
    "wedge6": _WEDGE_CORNERS,
    "wedge15": f"{_WEDGE_CORNERS} 500 550 050 501 551 051 005 105 015",
    "pyramid5": _PYRAMID_CORNERS,
    "pyramid13": f"{_PYRAMID_CORNERS} 500 150 510 050 005 505 555 055",
    "quad4": _QUAD_CORNERS,
    "quad8": f"{_QUAD_CORNERS} {_QUAD_EDGES}",
    "quad9": f"{_QUAD_CORNERS} {_QUAD_EDGES} 55",
    "tri3": "00 10 01",
    "tri6": f"00 10 01 {_TRI_EDGES}",
}

_SKFEM_NAMES = {
    "hex8": "ElementHex1",
    "hex20": "ElementHexS2",
    "hex27": "ElementHex2",
    "tet4": "ElementTetP1",
    "tet10": "ElementTetP2",
    "wedge6": "ElementWedge1",
    "quad4": "ElementQuad1",
    "quad8": "ElementQuadS2",
    "quad9": "ElementQuad2",
    "tri3": "ElementTriP1",
    "tri6": "ElementTriP2",
}

# Gauss points along each direction of a hexahedron or quadrilateral.
_GAUSS_POINTS = {"hex8": 2, "hex20": 3, "hex27": 3, "quad4": 2, "quad8": 3, "quad9": 3}
# Degree that the points of a simplex integrate; 2 is the four-point rule of a tetrahedron.
_SIMPLEX_DEGREES = {"tet4": 1, "tet10": 2, "tri3": 2, "tri6": 4}
# Degree in the triangle, points along the axis of a wedge.
_WEDGE_RULES = {"wedge6": (2, 2), "wedge15": (2, 3)}
# The same for "mass": products of two shape functions, of twice their degree.
_MASS_SIMPLEX_DEGREES = {**_SIMPLEX_DEGREES, "tet4": 2, "tet10": 4}
_MASS_WEDGE_RULES = {"wedge6": (2, 2), "wedge15": (4, 3)}


@dataclass(frozen=True, eq=False)
class ReferenceElement:
    """Shape functions tabulated at quadrature points, all dimensionless."""

    kind: str  # a kind of cell or facet of `fea.mesh.mesh`
    values: Array  # shape (points, nodes): N_a at each point
    slopes: Array  # shape (points, nodes, dimension): dN_a/dxi at each point
    weights: Array  # shape (points,): quadrature weights; their sum is the reference volume


@cache
def reference_element(kind: str, integration: str = "full") -> ReferenceElement:
    """Tabulate one kind of cell or facet.

    kind: a key of `fea.mesh.mesh.NODES_PER_CELL` or `fea.mesh.mesh.NODES_PER_FACET`.
    integration: ``"reduced"`` gives hex20 its 2x2x2 points; ``"mass"`` is fine enough for products
    of two shape functions; every other kind has one rule.
    Raises KeyError if the kind is unknown.
    """
    if kind in _GAUSS_POINTS:
        count = 2 if (kind == "hex20" and integration == "reduced") else _GAUSS_POINTS[kind]
        dimension = node_coordinates(kind).shape[1]
        positions, weight = _gauss(count)
        grid = np.stack(np.meshgrid(*[positions] * dimension, indexing="ij"), axis=-1)
        products = np.stack(np.meshgrid(*[weight] * dimension, indexing="ij"), axis=-1)
        points, weights = grid.reshape(-1, dimension), products.prod(axis=-1).ravel()
    else:
        mass = integration == "mass"
        if kind in _SIMPLEX_DEGREES:
            degrees = _MASS_SIMPLEX_DEGREES if mass else _SIMPLEX_DEGREES
            points, weights = _simplex(node_coordinates(kind).shape[1], degrees[kind])
        elif kind.startswith("pyramid"):
            # A cube of 3x3x3 points whose upper face is one point; (1 - z)^2 is in the weights.
            (across, weight), (up, weight_up) = _gauss(3), roots_jacobi(3, 2, 0)
            a, b, z = np.meshgrid(across, across, (1 + up) / 2, indexing="ij")
            points = np.stack([a * (1 - z), b * (1 - z), z], axis=-1).reshape(-1, 3)
            weights = np.einsum("i,j,k", weight, weight, weight_up / 8).ravel()
        else:
            points, weights = _wedge(*(_MASS_WEDGE_RULES if mass else _WEDGE_RULES)[kind])
    values, slopes = tabulate(kind, points)
    return ReferenceElement(kind, values, slopes, weights)


def node_coordinates(kind: str) -> Array:
    """Return the reference coordinates of the nodes in VTK order.

    Shape (nodes, dimension), dimensionless.
    """
    digits = [[int(digit) for digit in node] for node in _COORDINATES[kind].split()]
    coordinates = np.array(digits, dtype=float)
    coordinates[coordinates == 5] = 0.5
    return coordinates


def tabulate(kind: str, points: Array) -> tuple[Array, Array]:
    """Return shape functions (points, nodes) and slopes (points, nodes, dimension) at points.

    The points are reference coordinates, shape (points, dimension); all are dimensionless.
    """
    if kind == "wedge15":
        # Serendipity wedge (not in scikit-fem), after Zienkiewicz and Taylor, volume 1, section
        # 4.10. With barycentric L_c and z = 2 zeta - 1 in -1..1: corner
        # L (2L - 1) (1 +- z)/2 - L (1 - z^2)/2, midside of a triangle edge 2 L_c L_d (1 +- z),
        # midside of an upright edge L (1 - z^2).
        x, y, z = points[:, 0], points[:, 1], 2 * points[:, 2] - 1
        L = np.stack([1 - x - y, x, y])
        dL = np.array([[-1.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])[:, None, :]
        both = [
            *(_wedge_corner(L[c], dL[c], z, side) for side in (-1, 1) for c in range(3)),
            *(
                _wedge_edge(L[c], dL[c], L[d], dL[d], z, side)
                for side in (-1, 1)
                for c, d in ((0, 1), (1, 2), (2, 0))
            ),
            *(_wedge_upright(L[c], dL[c], z) for c in range(3)),
        ]
        values, slopes = zip(*both, strict=True)
        return np.stack(values, axis=1), np.stack(slopes, axis=1)
    if kind.startswith("pyramid"):
        return _pyramid(points, kind)
    element = getattr(skfem, _SKFEM_NAMES[kind])()
    # Find for each node in VTK order the number scikit-fem gives it.
    coordinates = node_coordinates(kind)
    distance = np.abs(coordinates[:, None, :] - np.asarray(element.doflocs)[None, :, :]).max(axis=2)
    order = distance.argmin(axis=1)
    if distance.min(axis=1).max() > 1e-12 or len(set(order.tolist())) != len(coordinates):
        raise AssertionError("scikit-fem moved the nodes of a reference element")
    values, slopes = zip(*(element.lbasis(points.T, int(i)) for i in order), strict=True)
    return np.stack(values, axis=1), np.moveaxis(np.stack(slopes), (0, 1, 2), (1, 2, 0)).copy()


_PYRAMID = ("qv", "pv", "pu", "qu", "pqvc", "puvc", "pquc", "quvc", "zqv", "zpv", "zpu", "zqu")


def _pyramid(points: Array, kind: str) -> tuple[Array, Array]:
    """Rational functions of a pyramid, after Bedrosian 1992: its faces are as of hex20 and tet10.

    With c = 1 - z, p = x/c, q = 1 - p, u = y/c and v = 1 - u they are c times products of these and
    z; at the apex, where all p and u meet, slopes are those on the axis.
    """
    x, y, z = points.T
    c = 1 - z
    p, u = (np.divide(each, c, out=np.full_like(c, 0.5), where=c > 1e-12) for each in (x, y))
    factors = {"p": p, "q": 1 - p, "u": u, "v": 1 - u, "z": z, "c": c}
    ways = {"p": (0, 1), "q": (0, -1), "u": (1, 1), "v": (1, -1), "z": (2, 1), "c": (2, -1)}
    values, slopes = [], []
    for word in _PYRAMID:
        by = np.zeros((3, len(points)))
        for i, letter in enumerate(word):
            way, sign = ways[letter]
            by[way] += sign * np.prod([factors[each] for each in word[:i] + word[i + 1 :]], axis=0)
        product = np.prod([factors[each] for each in word], axis=0)
        values.append(c * product)
        slopes.append([by[0], by[1], p * by[0] + u * by[1] + c * by[2] - product])
    apex = np.stack([np.zeros_like(z), np.zeros_like(z), np.ones_like(z)])
    corners, corner_slopes = np.array([*values[:4], z]), np.array([*slopes[:4], apex])
    if kind == "pyramid5":
        return corners.T, corner_slopes.transpose(2, 0, 1)
    middles, middle_slopes = 4 * np.array(values[4:]), 4 * np.array(slopes[4:])
    for edge, value, slope in zip(EDGES[kind], middles, middle_slopes, strict=True):
        corners[[*edge]] -= value / 2
        corner_slopes[[*edge]] -= slope / 2
    return np.vstack([corners, middles]).T, np.vstack([corner_slopes, middle_slopes]).transpose(
        2, 0, 1
    )


def _gauss(count: int) -> tuple[Array, Array]:
    """Gauss points and weights on [0, 1]."""
    positions, weight = np.polynomial.legendre.leggauss(count)
    return (positions + 1) / 2, weight / 2


def _simplex(dimension: int, degree: int) -> tuple[Array, Array]:
    points, weights = get_quadrature(RefTet if dimension == 3 else RefTri, degree)
    return np.ascontiguousarray(points.T), np.asarray(weights)


def _wedge(degree: int, count: int) -> tuple[Array, Array]:
    flat, flat_weights = _simplex(2, degree)
    positions, weight = _gauss(count)
    points = [[*point, height] for height in positions for point in flat]
    return np.array(points), (weight[:, None] * flat_weights[None, :]).ravel()


_UP = np.array([0.0, 0.0, 2.0])  # dz/dzeta


def _wedge_corner(L: Array, dL: Array, z: Array, side: int) -> tuple[Array, Array]:
    value = L * (2 * L - 1) * (1 + side * z) / 2 - L * (1 - z**2) / 2
    flat = ((4 * L - 1) * (1 + side * z) - (1 - z**2)) / 2
    return value, flat[:, None] * dL + (L * (2 * L - 1) * side / 2 + L * z)[:, None] * _UP


def _wedge_edge(
    L: Array, dL: Array, M: Array, dM: Array, z: Array, side: int
) -> tuple[Array, Array]:
    slope = L[:, None] * dM + M[:, None] * dL
    height = (1 + side * z)[:, None]
    return 2 * L * M * (1 + side * z), 2 * slope * height + (2 * side * L * M)[:, None] * _UP


def _wedge_upright(L: Array, dL: Array, z: Array) -> tuple[Array, Array]:
    return L * (1 - z**2), (1 - z**2)[:, None] * dL - (2 * z * L)[:, None] * _UP
