"""A straight line through points, with the standard error of its slope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Line:
    """A line by least squares, y = slope x + intercept.

    Attributes
    ----------
    slope, intercept : float
        In the units of y/x and y.
    error : float
        The slope's standard error: what scatter about the line, and bend, leave open.
    points : int
    """

    slope: float
    intercept: float
    error: float
    points: int


def line_through(x: ArrayLike, y: ArrayLike) -> Line:
    """Return the line through points by ordinary least squares, dimensionless or of any unit.

    Parameters
    ----------
    x, y : array_like
        Shape (n,), three points or more.

    Returns
    -------
    Line
        With error = sqrt(sum of squared residuals / (n - 2) / sum of (x - mean x)^2) (Draper and
        Smith, Applied Regression Analysis, section 1.4).

    Raises
    ------
    ValueError
        If there are fewer than three points, a number is not finite, or all x are the same.
    """
    across, up = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if across.shape != up.shape or across.ndim != 1 or len(across) < 3:
        raise ValueError("a line with a standard error needs three points (x, y) or more")
    if not (np.isfinite(across).all() and np.isfinite(up).all()):
        raise ValueError("the points of a line must be finite")
    centred = across - across.mean()
    spread = float(centred @ centred)
    if spread == 0.0:
        raise ValueError("all points of the line have the same x")
    slope = float(centred @ (up - up.mean())) / spread
    intercept = float(up.mean() - slope * across.mean())
    residual = up - slope * across - intercept
    scatter = float(residual @ residual) / (len(across) - 2)
    return Line(slope, intercept, float(np.sqrt(scatter / spread)), len(across))
