"""Use every compiled function once, so that no request waits for one to be loaded."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np

from surrogate.build import build
from surrogate.table.axes import AXES
from surrogate.table.rows import LoadRange, Rows


@cache  # what is loaded stays so, for all servers of a process
def use_compiled_code() -> None:
    """Build a small table of clean rows with tangents, and ask its kriging."""
    # Corners and the middle: three points a load would take three times as long.
    places = [*product((-1.0, 1.0), repeat=3), (0.1, 0.2, 0.3)]
    wrenches = np.zeros((len(AXES) * len(places), 6))
    for axis, part in zip(AXES, np.split(wrenches, len(AXES)), strict=True):
        part[:, axis.inputs] = places
    tangents = np.tile(np.eye(6), (len(wrenches), 1, 1))
    rows = Rows.of(wrenches, np.tanh(wrenches), compliance=tangents)
    kriging = build(rows, LoadRange(-np.ones(6), np.ones(6))).kriging
    assert kriging is not None
    asked = (0.1, 0.2, 0.3, 0.2, 0.1, 0.3)
    kriging.answer_one(asked)
    kriging.answer_many(np.array([asked]))
    kriging.derivatives(np.array([asked]))
