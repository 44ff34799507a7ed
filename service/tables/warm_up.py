"""Use every compiled function once, so that no request waits for one to be loaded."""

from __future__ import annotations

from itertools import product

import numpy as np

from surrogate.build import build
from surrogate.table.axes import AXES
from surrogate.table.rows import LoadRange, Rows

METHODS = ("griddata", "kriging")  # the two that are compiled


def use_compiled_code() -> None:
    """Build a small table of clean rows with tangents, and ask it by each compiled method."""
    wrenches = np.zeros((len(AXES) * 27, 6))
    for number, axis in enumerate(AXES):
        grid = list(product((-1.0, 0.0, 1.0), repeat=3))
        wrenches[27 * number : 27 * (number + 1), axis.inputs] = grid
    tangents = np.tile(np.eye(6), (len(wrenches), 1, 1))
    rows = Rows.of(wrenches, np.tanh(wrenches), compliance=tangents)
    table = build(rows, LoadRange(-np.ones(6), np.ones(6)))
    for method in METHODS:
        table.answer([0.1, 0.2, 0.3, 0.2, 0.1, 0.3], method=method)
        table.derivatives([[0.1, 0.2, 0.3, 0.2, 0.1, 0.3]], method=method)
