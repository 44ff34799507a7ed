"""Evenly spread wrenches: an additive recurrence (Roberts 2018, the R sequence)."""

from __future__ import annotations

import numpy as np

from .rows import Floats, LoadRange


def spread_wrenches(span: LoadRange, count: int, start: int = 1) -> Floats:
    """Return `count` evenly spread wrenches of a span, shape (count, 6), N and N·m."""
    vary = np.flatnonzero(span.high > span.low)
    root = 2.0  # the root of x^(d + 1) = x + 1, by which the recurrence steps
    for _ in range(60):
        root = (1 + root) ** (1 / (len(vary) + 1))
    step = root ** -np.arange(1.0, len(vary) + 1)
    fraction = (0.5 + np.arange(start, start + count)[:, None] * step) % 1.0
    wrenches = np.tile(span.low, (count, 1))
    wrenches[:, vary] += fraction * (span.high - span.low)[vary]
    return wrenches
