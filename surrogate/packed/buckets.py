"""Where a search among ascending numbers starts: buckets of equal width."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats

PER_NUMBER = 1.0  # buckets: a search then takes one or two steps


def buckets_of(numbers: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Return the frame and the bounds of buckets over ascending numbers, shape (k,).

    A number's bucket is (number - frame[0]) frame[1], as `wb_bucket` of surrogate/kernel computes
    it; those of bucket b have the places start[b] to start[b + 1]. Shapes (2,) and (b + 1,); the
    frame has the numbers' unit and its inverse.
    """
    count = max(int(len(numbers) * PER_NUMBER), 1)
    low, high = (float(numbers[0]), float(numbers[-1])) if len(numbers) else (0.0, 0.0)
    density = count / (high - low) if high > low else 0.0
    if not np.isfinite(density):
        density = 0.0
    places = np.clip((numbers - low) * density, 0, count - 1).astype(np.intp)
    start = np.searchsorted(places, np.arange(count + 1)).astype(np.int32)
    start[-1] = len(numbers)
    return np.array([low, density]), start
