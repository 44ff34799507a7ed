"""What no row of a table shows, whatever the bars say: loads of several axes together, and rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .methods.selection import ENOUGH_FULL, full_needed, knows_interaction
from .table.axes import AXES, clean_rows, clean_wrenches
from .table.rows import CLEAN, Floats, LoadRange, Rows

UNKNOWN_AT_REST = (
    "no row is at zero load and the rows of no axis surround it: what the component does without "
    "load is not known"
)
UNKNOWN_TOGETHER = (
    "{full} full wrenches{tangents}: at least {needed} full wrenches are needed to tell what loads "
    "of several axes do together"
)

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Doubt:
    """Which wrenches ask what the rows of a table do not show.

    Attributes
    ----------
    load_range : LoadRange
    knows_interaction : bool
        Whether rows show what loads of several axes do together.
    rest_unknown : bool
        Whether nothing tells what the component does without load.
    full_wrenches, needed : int
        How many rows load more than one axis, and how many must for `knows_interaction`.
    """

    load_range: LoadRange
    knows_interaction: bool
    rest_unknown: bool
    full_wrenches: int
    needed: int

    @cached_property
    def none(self) -> bool:
        """Whether no wrench is doubtful, whatever it loads."""
        return self.knows_interaction and not self.rest_unknown

    def of_many(self, asked: Floats) -> tuple[Mask, Mask]:
        """Return which wrenches (n, 6), N and N·m, are in doubt, and which at rest, (n,).

        For what loads of several axes do together, and for what the component does without load.
        """
        together = np.zeros(len(asked), dtype=bool)
        at_rest = np.zeros(len(asked), dtype=bool)
        if not self.knows_interaction:
            together |= np.asarray(~clean_wrenches(asked, self.load_range).any(axis=1))
        if self.rest_unknown:
            at_rest = np.asarray((np.abs(asked) <= self._least).all(axis=1))
        return together, at_rest

    def of_one(self, wrench: Sequence[float]) -> str:
        """Return why one wrench of six, N and N·m, is in doubt, or an empty text.

        As `of_many`, without arrays.
        """
        loaded = {load for load in range(6) if abs(wrench[load]) > self._least[load]}
        if not loaded and self.rest_unknown:
            return UNKNOWN_AT_REST
        if self.knows_interaction or any(loaded.issubset(axis.inputs) for axis in AXES):
            return ""
        tangents = " and no tangents" if self.needed == ENOUGH_FULL else ""
        return UNKNOWN_TOGETHER.format(
            full=self.full_wrenches, tangents=tangents, needed=self.needed
        )

    @cached_property
    def _least(self) -> list[float]:
        """Loads up to which there is none, six of them, N and N·m."""
        return (CLEAN * self.load_range.scale).tolist()


def doubt_of(rows: Rows, load_range: LoadRange, *, linear: bool, rest_unknown: bool) -> Doubt:
    """Return what the rows that answers are made of do not show.

    Loads of a linear component act by themselves.
    """
    knows = linear or knows_interaction(rows, load_range)
    full = int((~clean_rows(rows, load_range).any(axis=1)).sum())
    return Doubt(load_range, knows, rest_unknown, full, full_needed(rows))
