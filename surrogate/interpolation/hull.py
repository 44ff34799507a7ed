"""The nearest point of a hull's facets: a point, a stretch of a line, or a triangle each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats

CHUNK = 200_000  # pairs of points and facets looked at together: some 50 MB of numbers


def nearest_points(facets: Floats, x: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the nearest point of any facet to each point, (k, 3), and which facet, (k,).

    Parameters
    ----------
    facets : ndarray, shape (f, corners, 3), dimensionless
        One, two or three corners each.
    x : ndarray, shape (k, 3), dimensionless
    """
    place = np.empty_like(x)
    which = np.empty(len(x), dtype=np.intp)
    step = max(CHUNK // len(facets), 1)
    for start in range(0, len(x), step):
        some = slice(start, start + step)
        on_each = _on_facets(facets, x[some])
        apart = ((on_each - x[some, None]) ** 2).sum(axis=2)
        best = apart.argmin(axis=1)
        which[some] = best
        place[some] = on_each[np.arange(len(best)), best]
    return place, which


def _on_facets(facets: Floats, x: Floats) -> Floats:
    """Return the nearest point of each facet to each point, shape (k, f, 3)."""
    corners = facets.shape[1]
    if corners == 1:
        return np.broadcast_to(facets[None, :, 0], (len(x), len(facets), 3))
    if corners == 2:
        return _on_stretch(facets[:, 0], facets[:, 1], x)
    # Take the foot of the perpendicular if the triangle holds it, else the nearest of its edges.
    # The barycentric coordinates of the foot come of the normal equations; a triangle without
    # area has none, and its edges answer.
    a, e, f = facets[:, 0], facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]
    ee, ef, ff = ((u * v).sum(axis=1) for u, v in ((e, e), (e, f), (f, f)))
    area = ee * ff - ef**2
    apart = x[:, None] - a
    pe, pf = np.einsum("kfi,fi->kf", apart, e), np.einsum("kfi,fi->kf", apart, f)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (ff * pe - ef * pf) / area, (ee * pf - ef * pe) / area
        inside = (s >= 0) & (t >= 0) & (s + t <= 1)  # of no area, s and t may be of both infinities
    foot = a + np.where(inside, s, 0.0)[..., None] * e + np.where(inside, t, 0.0)[..., None] * f
    edges = np.stack(
        [_on_stretch(facets[:, i], facets[:, j], x) for i, j in ((0, 1), (1, 2), (2, 0))]
    )
    nearest = ((edges - x[None, :, None]) ** 2).sum(axis=3).argmin(axis=0)
    on_edge = np.take_along_axis(edges, nearest[None, ..., None], axis=0)[0]
    return np.where(inside[..., None], foot, on_edge)


def _on_stretch(a: Floats, b: Floats, x: Floats) -> Floats:
    along = b - a
    length = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    share = np.einsum("kfi,fi->kf", x[:, None] - a, along) / length
    return a + np.clip(share, 0.0, 1.0)[..., None] * along
