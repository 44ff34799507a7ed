"""What no row of a table shows, whatever the bars say: loads of several axes together, and rest."""

from __future__ import annotations

from dataclasses import dataclass

from .methods.selection import full_needed, knows_interaction
from .table.axes import count_full
from .table.rows import LoadRange, Rows


@dataclass(frozen=True)
class Doubt:
    """Which wrenches ask what the rows of a table do not show.

    Attributes
    ----------
    knows_interaction : bool
        Whether rows show what loads of several axes do together.
    rest_unknown : bool
        Whether nothing tells what the component does without load.
    full_wrenches, needed : int
        How many rows load more than one axis, and how many must for `knows_interaction`.
    """

    knows_interaction: bool
    rest_unknown: bool
    full_wrenches: int
    needed: int


def doubt_of(rows: Rows, load_range: LoadRange, *, linear: bool, rest_unknown: bool) -> Doubt:
    """Return what the rows that answers are made of do not show.

    Loads of a linear component act by themselves.
    """
    knows = linear or knows_interaction(rows, load_range)
    full = count_full(rows, load_range)
    return Doubt(knows, rest_unknown, full, full_needed(rows))
