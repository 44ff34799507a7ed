"""The von Mises stress. Numpy only: whoever has stresses may import it, a web process too."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def von_mises(stress: Array) -> Array:
    """Return the von Mises stress, shape (...), Pa, of stresses, shape (..., 6), Pa.

    The six are xx, yy, zz, xy, xz, yz; any other unit goes through as it is.
    """
    xx, yy, zz, xy, xz, yz = np.moveaxis(stress, -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(0.5 * normal + 3.0 * (xy**2 + xz**2 + yz**2)))
