"""What no row of a table may exceed: turns, translations and loads that are mistakes of a unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from service.formats.spelling import DISPLACEMENT, UNCERTAINTY, WRENCH
from surrogate.limits import (
    ROTATION_LIMIT,
    TRANSLATION_LIMIT,
    is_too_far,
    rotation_angles,
)
from surrogate.table.rows import LoadRange

Array = np.ndarray

LOAD_LIMIT = 10.0
"""Times the component's range a load may be: a test goes to a few times the service load, while
taking kN for N, or lbf*in for N*m in a column too far, is off by more."""


@dataclass(frozen=True)
class Excess:
    """A number beyond a limit: the place of its row in the arrays, its column, what to do."""

    at: int
    name: str
    message: str


def excesses(
    wrench: Array,
    displacement: Array,
    load_range: LoadRange | None,
    uncertainty: Array | None = None,
) -> Iterator[Excess]:
    """Yield what is beyond a limit.

    Parameters
    ----------
    wrench : numpy.ndarray
        Shape (n, 6), N and N·m.
    displacement : numpy.ndarray
        Shape (n, 6), m and rad; NaN where not measured.
    load_range : LoadRange or None
        The component's, N and N·m; None checks no load.
    uncertainty : numpy.ndarray, optional
        Shape (n, 6), m and rad; NaN where unknown.
    """
    yield from _turned(displacement)
    yield from _moved(displacement)
    if uncertainty is not None:
        yield from _unsure(uncertainty)
    if load_range is not None:
        yield from _loaded(wrench, load_range)


def largest_loads(load_range: LoadRange) -> Array:
    """Return the largest size each load may have, shape (6,), N and N·m.

    A load without a range of its own (0 to 0) goes by the largest of its kind: a rig's
    cross-loads are a part of its main load. Without any of its kind there is no limit.
    """
    size = np.maximum(np.abs(load_range.low), np.abs(load_range.high)).reshape(2, 3)
    size = np.where(size > 0.0, size, size.max(axis=1, keepdims=True))
    return np.where(size > 0.0, LOAD_LIMIT * size, np.inf).ravel()


def _turned(displacement: Array) -> Iterator[Excess]:
    angle = rotation_angles(displacement)
    for at in np.flatnonzero(is_too_far(angle)).tolist():
        name = DISPLACEMENT[3 + int(np.nanargmax(np.abs(displacement[at, 3:])))]
        message = (
            f"the rotation is {math.degrees(angle[at]):.4g} degrees; a table ends at 20 "
            "(check the unit: rad or deg?)"
        )
        yield Excess(at, name, message)


def _moved(displacement: Array) -> Iterator[Excess]:
    for at, axis in np.argwhere(np.abs(displacement[:, :3]) > TRANSLATION_LIMIT).tolist():
        message = (
            f"the translation is {displacement[at, axis]:.4g} m; a table ends at "
            f"{TRANSLATION_LIMIT:g} m, because within 20 degrees only a part longer than 40 m "
            "moves so far (check the unit: m or mm?)"
        )
        yield Excess(at, DISPLACEMENT[axis], message)


def _unsure(uncertainty: Array) -> Iterator[Excess]:
    limit = np.repeat([TRANSLATION_LIMIT, ROTATION_LIMIT * (1.0 + 1e-12)], 3)
    beyond = np.isfinite(uncertainty) & (uncertainty > limit)  # infinite ones are told as such
    for at, output in np.argwhere(beyond).tolist():
        unit, end = ("m", TRANSLATION_LIMIT) if output < 3 else ("rad", ROTATION_LIMIT)
        message = (
            f"the uncertainty is {uncertainty[at, output]:.4g} {unit}; no displacement of a table "
            f"is beyond {end:.4g} {unit} (check the unit, or leave it out if it is not known)"
        )
        yield Excess(at, UNCERTAINTY[output], message)


def _loaded(wrench: Array, load_range: LoadRange) -> Iterator[Excess]:
    limit = largest_loads(load_range)
    for at, load in np.argwhere(np.abs(wrench) > limit).tolist():
        unit = "N" if load < 3 else "N*m"
        message = (
            f"the load is {wrench[at, load]:.6g} {unit}; the component's range is "
            f"{load_range.low[load]:g} to {load_range.high[load]:g} {unit}, and a table ends at "
            f"{limit[load]:g} (check the unit and the column)"
        )
        yield Excess(at, WRENCH[load], message)
