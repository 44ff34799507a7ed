"""What a scene needs of one component: which loads can occur, and which outputs it reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..table.axes import AXES
from ..table.rows import CLEAN, Floats, LoadRange, Tolerance
from ..table.space import LOADS

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Need:
    """What a scene needs of one component.

    Attributes
    ----------
    span : LoadRange
        The loads that can occur, N and N·m; a load on a locked freedom is held at 0.
    outputs : tuple of int
        The outputs it reads, ascending.
    tolerance : Tolerance or None, m and rad
        The scene's own, else the component's.
    idle : tuple of int
        Loads on locked freedoms: whatever they are, nothing depends on them.
    slack : ndarray, shape (n,), N and N·m
        What rounding may add to an end: 1e-9 of the component's range.
    """

    span: LoadRange
    outputs: tuple[int, ...]
    tolerance: Tolerance | None
    idle: tuple[int, ...]
    slack: Floats

    @property
    def occurring(self) -> Mask:
        """Which loads, N and N·m, can be other than zero, shape (n,)."""
        return (self.span.low != 0) | (self.span.high != 0)

    @property
    def varying(self) -> Mask:
        """Which loads, N and N·m, can have more than one value: the dimensions, shape (n,)."""
        return self.span.high > self.span.low

    @property
    def loads(self) -> list[str]:
        """The names of the loads that can occur."""
        return [self.span.space.input_names[load] for load in np.flatnonzero(self.occurring)]

    def beyond(self, wrenches: Floats) -> Mask:
        """Return which loads of wrenches (k, n), N and N·m, the scene has not, shape (k, n)."""
        return (wrenches < self.span.low - self.slack) | (wrenches > self.span.high + self.slack)

    def axes(self) -> dict[str, dict[str, object]]:
        """Return the axes that are composed: their inputs that can occur, and their dimensions.

        An axis is composed if some of its loads can occur and one of its outputs is read. Tables
        of several interfaces or further inputs compose none.
        """
        found: dict[str, dict[str, object]] = {}
        for axis in AXES if self.span.space.is_default else ():
            inputs = [load for load in axis.inputs if self.occurring[load]]
            if inputs and set(axis.outputs) & set(self.outputs):
                names = [LOADS[load] for load in inputs]
                dimensions = int(self.varying[list(axis.inputs)].sum())
                found[axis.name] = {"inputs": names, "dimensions": dimensions}
        return found

    def output_names(self) -> list[str]:
        """Return the names of the outputs that are read."""
        return [self.span.space.output_names[output] for output in self.outputs]


class NeedError(ValueError):
    """A scene's loads that cannot be: each mistake by the place of its load.

    Attributes
    ----------
    mistakes : list of (int, str)
        Place of the load among the inputs, and what is wrong with its ends.
    """

    def __init__(self, mistakes: list[tuple[int, str]]) -> None:
        super().__init__("; ".join(message for _, message in mistakes))
        self.mistakes = mistakes


def need_of(
    whole: LoadRange,
    bounds: Floats | None = None,
    outputs: Sequence[int] | None = None,
    tolerance: Tolerance | None = None,
    idle: Sequence[int] = (),
) -> Need:
    """Return what a scene needs of a component.

    Parameters
    ----------
    whole : LoadRange
        The component's load range, N and N·m; it is stretched to hold zero.
    bounds : ndarray, shape (n, 2), optional, N and N·m
        Low and high end of each load; the component's own by default.
    outputs : sequence of int, optional
        Those that are read; all by default.
    idle : sequence of int
        Loads on locked freedoms.

    Raises
    ------
    NeedError
        If an end lies outside the component's load range, or the ends are the wrong way round.
    """
    ends = np.column_stack((whole.low, whole.high)) if bounds is None else np.array(bounds, float)
    slack = CLEAN * whole.scale
    mistakes = []
    for load, (low, high) in enumerate(ends.tolist()):
        one = whole.space.inputs[load]
        least, most = min(whole.low[load], one.zero), max(whole.high[load], one.zero)
        if low > high:
            message = f"the low end of {one.name}, {low:g}, is above the high end, {high:g}"
            mistakes.append((load, message))
        elif load not in idle and (low < least - slack[load] or high > most + slack[load]):
            within = f"{least:g} to {most:g} {one.unit}, the load range"
            message = f"{one.name} must lie within {within}"
            mistakes.append((load, message))
    if mistakes:
        raise NeedError(mistakes)
    ends[list(idle)] = 0.0
    ends += 0.0  # no minus zero
    read = tuple(sorted(set(range(len(whole.space.outputs)) if outputs is None else outputs)))
    span = LoadRange(ends[:, 0], ends[:, 1], whole.space)
    return Need(span, read, tolerance, tuple(idle), slack)
