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

from wrenchbook.fea.mesh.facets import EDGES, corners_of_cell

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

# Gauss points along each direction of a hexahedron or quadrilateral: exact for its stiffness.
_GAUSS_POINTS = {"hex8": 2, "hex20": 3, "hex27": 3, "quad4": 2, "quad8": 3, "quad9": 3}
# Degree up to which a simplex' points integrate exactly; 2 is the four-point rule of a tetrahedron.
_SIMPLEX_DEGREES = {"tet4": 1, "tet10": 2, "tri3": 2, "tri6": 4}
# Degree in the triangle, points along the axis of a wedge.
_WEDGE_RULES = {"wedge6": (2, 2), "wedge15": (2, 3)}
# The same for "mass", of twice the degree: products of two shape functions.
_MASS_SIMPLEX_DEGREES = {**_SIMPLEX_DEGREES, "tet4": 2, "tet10": 4}
_MASS_WEDGE_RULES = {"wedge6": (2, 2), "wedge15": (4, 3)}

_SAME_NODE = 1e-12  # roundoff of reference coordinates, which are 0, 1/2 and 1
_MIN_HEIGHT = 1e-30  # replaces a height of 0 below a pyramid's apex in a divisor


@dataclass(frozen=True, eq=False)
class ReferenceElement:
    """Shape functions tabulated at quadrature points, all dimensionless."""

    kind: str  # a kind of cell or facet of `fea.mesh.mesh`
    values: np.ndarray  # shape (points, nodes): N_a at each point
    slopes: np.ndarray  # shape (points, nodes, dimension): dN_a/dxi at each point
    weights: np.ndarray  # shape (points,): quadrature weights; their sum is the reference volume


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
        points = grid.reshape(-1, dimension)
        weights = products.prod(axis=-1).ravel()
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


def node_coordinates(kind: str) -> np.ndarray:
    """Return the reference coordinates of the nodes in VTK order, shape (nodes, dimension)."""
    digits = [[int(digit) for digit in node] for node in _COORDINATES[kind].split()]
    coordinates = np.array(digits, dtype=float)
    coordinates[coordinates == 5] = 0.5
    return coordinates


def tabulate(kind: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return shape functions (points, nodes) and slopes (points, nodes, dimension) at points.

    The points are reference coordinates, shape (points, dimension); all are dimensionless.
    """
    if kind in _PRODUCTS:
        return _products(kind, points)
    element = getattr(skfem, _SKFEM_NAMES[kind])()
    # Find for each node in VTK order the number scikit-fem gives it.
    coordinates = node_coordinates(kind)
    distance = np.abs(coordinates[:, None, :] - np.asarray(element.doflocs)[None, :, :]).max(axis=2)
    order = distance.argmin(axis=1)
    if distance.min(axis=1).max() > _SAME_NODE or len(set(order.tolist())) != len(coordinates):
        raise AssertionError("scikit-fem moved the nodes of a reference element")
    values, slopes = zip(*(element.lbasis(points.T, int(i)) for i in order), strict=True)
    return np.stack(values, axis=1), np.moveaxis(np.stack(slopes), (0, 1, 2), (1, 2, 0)).copy()


# Shape functions that scikit-fem lacks, written as products of letters, the factors of
# `_wedge_factors` or `_pyramid_factors`. Corner functions come first. The functions of the edges'
# middles are four times their products.
_PYRAMID = "dqs dps dpr dqr h"
_PRODUCTS = {
    "wedge15": "ad bd cd ah bh ch abd bcd cad abh bch cah adh bdh cdh",
    "pyramid5": _PYRAMID,
    "pyramid13": f"{_PYRAMID} ddpqs ddprs ddpqr ddqrs dhqs dhps dhpr dhqr",
}


def _products(kind: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values and slopes of the shape functions of `_PRODUCTS` at points; see `tabulate`."""
    factors_at = _wedge_factors if kind == "wedge15" else _pyramid_factors
    factors, slopes = factors_at(*points.T)
    products = _PRODUCTS[kind].split()
    ones = np.ones(len(points))
    N = np.zeros((len(products), len(points)))
    dN = np.zeros((len(products), len(points), 3))
    for product, value, slope in zip(products, N, dN, strict=True):
        value[:] = np.prod([factors[letter] for letter in product], axis=0)
        for i, letter in enumerate(product):
            others = product[:i] + product[i + 1 :]
            cofactor = np.prod([ones, *(factors[other] for other in others)], axis=0)
            slope += cofactor[:, None] * np.stack(np.broadcast_arrays(*slopes[letter]), axis=1)
    corners = min(len(products), corners_of_cell(kind))
    # A midside function is four times its product; corner functions lose half of their neighbours.
    for table in (N, dN):
        table[corners:] *= 4
        for edge, middle in zip(EDGES[kind], table[corners:], strict=False):
            table[[*edge]] -= middle / 2
    return N.T, dN.swapaxes(0, 1)


def _wedge_factors(
    x: np.ndarray, y: np.ndarray, h: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, tuple]]:
    """Serendipity wedge (Zienkiewicz and Taylor, volume 1): factors and their slopes by letter.

    h is the height and d = 1 - h; a, b and c are barycentric in a triangle.
    """
    ones = np.ones_like(h)
    factors = {"a": 1 - x - y, "b": x, "c": y, "d": 1 - h, "h": h}
    slopes = {"a": (-ones, -ones, 0), "b": (ones, 0, 0), "c": (0, ones, 0)}
    return factors, slopes | {"d": (0, 0, -ones), "h": (0, 0, ones)}


def _pyramid_factors(
    x: np.ndarray, y: np.ndarray, h: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, tuple]]:
    """Rational pyramid (Bedrosian 1992): factors and their slopes by letter.

    h is the height and d = 1 - h; p = x/d, q = 1 - p, r = y/d and s = 1 - r, so that the faces are
    those of hexahedra and tetrahedra. At the apex slopes are those on the line p = r = 1/2.
    """
    ones = np.ones_like(h)
    d = np.maximum(1 - h, _MIN_HEIGHT)
    p, r = (np.where(h < 1, each / d, 0.5) for each in (x, y))
    factors = {"d": d, "h": h, "p": p, "q": 1 - p, "r": r, "s": 1 - r}
    slopes = {"d": (0, 0, -ones), "h": (0, 0, ones)}
    slopes |= {"p": (1 / d, 0, p / d), "q": (-1 / d, 0, -p / d)}
    slopes |= {"r": (0, 1 / d, r / d), "s": (0, -1 / d, -r / d)}
    return factors, slopes


def _gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points and weights on [0, 1]."""
    positions, weight = np.polynomial.legendre.leggauss(count)
    return (positions + 1) / 2, weight / 2


def _simplex(dimension: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (q, dimension) and weights (q,) of a triangle or tetrahedron, exact to a degree."""
    points, weights = get_quadrature(RefTet if dimension == 3 else RefTri, degree)
    return np.ascontiguousarray(points.T), np.asarray(weights)


def _wedge(degree: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (q, 3) and weights (q,): a triangle's of a degree at `count` heights of a wedge."""
    flat, flat_weights = _simplex(2, degree)
    positions, weight = _gauss(count)
    points = [[*point, height] for height in positions for point in flat]
    return np.array(points), (weight[:, None] * flat_weights[None, :]).ravel()
