"""Which wrenches ask what the rows of a table do not show."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from wrenchbook.surrogate.build import Group
from wrenchbook.surrogate.kernel.reasons import UNKNOWN_AT_ZERO_LOAD, UNKNOWN_TOGETHER
from wrenchbook.surrogate.methods import ENOUGH_FULL
from wrenchbook.surrogate.table.axes import AXES, single_axis_wrenches
from wrenchbook.surrogate.table.rows import ZERO_LOAD, Floats

Mask = np.ndarray


class DoubtLaw:
    """What a table's rows do not show, at wrenches."""

    def __init__(self, group: Group) -> None:
        self._evidence, self._range = group, group.load_range

    @cached_property
    def none(self) -> bool:
        """Whether no wrench is doubtful, whatever it loads."""
        return self._evidence.knows_interaction and not self._evidence.zero_unknown

    def of_many(self, asked: Floats) -> tuple[Mask, Mask]:
        """Return which wrenches (n, 6), N and N·m, are in doubt, and which at rest, (n,).

        For what loads of several axes do together, and for what the component does without load.
        """
        together = np.zeros(len(asked), dtype=bool)
        at_rest = np.zeros(len(asked), dtype=bool)
        if not self._evidence.knows_interaction:
            together |= np.asarray(~single_axis_wrenches(asked, self._range).any(axis=1))
        if self._evidence.zero_unknown:
            at_rest = np.asarray((np.abs(asked) <= self._least).all(axis=1))
        return together, at_rest

    def of_one(self, wrench: Sequence[float]) -> str:
        """Return why one wrench of six, N and N·m, is in doubt, or an empty text.

        As `of_many`, without arrays.
        """
        loaded = {load for load in range(6) if abs(wrench[load]) > self._least[load]}
        if not loaded and self._evidence.zero_unknown:
            return UNKNOWN_AT_ZERO_LOAD
        if self._evidence.knows_interaction or any(loaded.issubset(axis.inputs) for axis in AXES):
            return ""
        tangents = " and no tangents" if self._evidence.full_needed == ENOUGH_FULL else ""
        return UNKNOWN_TOGETHER.format(
            full=self._evidence.full_wrenches, tangents=tangents, needed=self._evidence.full_needed
        )

    @cached_property
    def _least(self) -> list[float]:
        """Loads up to which there is none, six of them, N and N·m."""
        return (ZERO_LOAD * self._range.scale).tolist()
