"""Recorded wrenches: the subset that a recording keeps, and the extremes of an envelope."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import Block, Kept, Kind, Tally, packed, unpacked
from wrenchbook.service.library.component import Component
from wrenchbook.service.recording.thinning import MOST_OUTSIDE, Subset, Taken, scaled_loads, take
from wrenchbook.service.workspace import Workspace

Floats = NDArray[np.float64]

MOST_SUBSETS = 32  # recordings whose subsets are in memory, some 2 MB each: those written to last


@dataclass(frozen=True)
class Took:
    """The result of adding a block.

    Attributes
    ----------
    tally : Tally
        The counts of the recording or envelope now.
    known : bool
        Whether the block was in it already; then nothing has changed.
    outside : int
        Wrenches of the block that are outside the load range.
    """

    tally: Tally
    known: bool
    outside: int


@dataclass(frozen=True)
class RecordingState:
    """A recording: its counts, and the wrenches kept, shape (n, inputs), N and N·m."""

    tally: Tally
    wrenches: Floats


@dataclass(frozen=True)
class EnvelopeState:
    """An envelope: its counts, and the wrenches that reached each extreme.

    Attributes
    ----------
    lowest, highest : ndarray, shape (n, n), N and N·m
        Line i is the whole wrench in which input i was least, largest; no lines if none came.
    """

    tally: Tally
    lowest: Floats
    highest: Floats

    @property
    def box(self) -> tuple[Floats, Floats]:
        """The least and the largest value of each input, shapes (n,), N and N·m; NaN if none."""
        if not len(self.lowest):
            unknown = np.full(self.lowest.shape[1], np.nan)
            return unknown, unknown.copy()
        return self.lowest.diagonal().copy(), self.highest.diagonal().copy()


@dataclass(frozen=True)
class Subsets:
    """The wrenches of a recording within the load range, and those outside."""

    inside: Subset
    outside: Subset


class RecordingStore:
    """Recordings and envelopes of one workspace.

    The subset of a recording is in memory as it was after its last block, with the ledger's
    revision number. A block of another process changes that number; the subset is then read again.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._library, self._ledger = workspace.library, workspace.ledger
        self._subsets: dict[str, tuple[int, Subsets]] = {}
        self._lock = threading.Lock()

    def record(self, name: str, wrenches: Floats, block: Block | None) -> Took:
        """Add wrenches, shape (n, inputs), N and N·m, to a component's recording.

        Loads on locked freedoms are left out.

        Raises
        ------
        UnknownComponentError
            If there is no such component.
        BlockKeyError
            If the block's key is empty.
        """
        component = self._library[name]
        acting, scale = component.acting(wrenches), component.load_range.scale
        points, keys = scaled_loads(acting, scale), packed(acting)
        inside = component.load_range.holds(acting) if len(keys) else np.ones(0, dtype=bool)
        outside = int((~inside).sum())
        subsets: list[Subsets] = []

        def choose(now: Tally, read: Callable[[], list[bytes]]) -> Kept:
            there = self._subsets_of(component, now, read)
            within = _take(there.inside, points, keys, inside)
            beyond = _take(there.outside, points, keys, ~inside)
            subsets.append(Subsets(within.subset, beyond.subset))
            after = replace(
                now,
                offered=now.offered + len(keys),
                merged=now.merged + within.merged + beyond.merged,
                thinned=now.thinned + within.thinned + beyond.thinned,
                outside=now.outside + outside,
                reach=within.subset.reach,
                within=within.subset.within,
                reach_outside=beyond.subset.reach,
                within_outside=beyond.subset.within,
                scale=_packed_scale(scale),
            )
            came = {key: place for place, key in reversed(list(enumerate(keys)))}
            added = sorted(within.added + beyond.added, key=came.__getitem__)
            return Kept(after, added, within.dropped + beyond.dropped)

        tally, known = self._ledger.record(name, block, choose)
        if subsets:  # only now is it on the disk
            self._keep(name, tally.revision, subsets[-1])
        return Took(tally, known, outside)

    def widen(self, name: str, wrenches: Floats, block: Block | None) -> Took:
        """Add wrenches, shape (n, inputs), to a component's envelope; as `record`."""
        component = self._library[name]
        acting = component.acting(wrenches)
        outside, keys = _outside(component, acting), packed(acting)

        def choose(now: Tally, there: dict[int, bytes]) -> Kept:
            after = replace(now, offered=now.offered + len(keys), outside=now.outside + outside)
            return Kept(after, _wider(acting, keys, there), [])

        return Took(*self._ledger.widen(name, block, choose), outside)

    def recording(self, name: str) -> RecordingState:
        """Return a component's recording; raises UnknownComponentError."""
        component = self._library[name]
        tally, keys = self._ledger.recording(component.name)
        count = len(component.load_range.low)
        return RecordingState(tally, unpacked(_of_width(keys, count), count))

    def envelope(self, name: str) -> EnvelopeState:
        """Return a component's envelope; raises UnknownComponentError."""
        component = self._library[name]
        tally, there = self._ledger.envelope(component.name)
        count = len(component.load_range.low)
        current = _of_width(there.values(), count)
        inputs = range(count) if len(current) == 2 * count else ()
        lowest, highest = ([there[at + one] for one in inputs] for at in (0, count))
        return EnvelopeState(tally, unpacked(lowest, count), unpacked(highest, count))

    def clear(self, name: str, kind: Kind) -> Tally:
        """Empty a component's recording or envelope, and return its counts before."""
        return self._ledger.clear_recording(self._library[name].name, kind)

    def _subsets_of(
        self, component: Component, now: Tally, read: Callable[[], list[bytes]]
    ) -> Subsets:
        """Return the subsets of a recording as the ledger has it."""
        scale, kept = component.load_range.scale, self._subsets.get(component.name)
        same = now.scale is None or now.scale == _packed_scale(scale)
        if kept is not None and kept[0] == now.revision and same:
            return kept[1]
        keys, stretched = _of_width(read(), len(scale)), 1.0
        if now.scale is not None and len(now.scale) == scale.nbytes and not same:
            # The load range was edited since: distances have another scale.
            stretched = max(1.0, float((unpacked([now.scale], len(scale))[0] / scale).max()))
        wrenches = unpacked(keys, len(scale))
        points, holds = scaled_loads(wrenches, scale), component.load_range.holds(wrenches)
        inside, outside = np.flatnonzero(holds), np.flatnonzero(~holds)
        own, others = ([keys[one] for one in places.tolist()] for places in (inside, outside))
        return Subsets(
            Subset(points[inside], own, now.reach, now.within * stretched),
            Subset(
                points[outside],
                others,
                now.reach_outside,
                now.within_outside * stretched,
                MOST_OUTSIDE,
            ),
        )

    def _keep(self, name: str, revision: int, subsets: Subsets) -> None:
        with self._lock:
            self._subsets.pop(name, None)
            self._subsets[name] = revision, subsets
            while len(self._subsets) > MOST_SUBSETS:
                del self._subsets[next(iter(self._subsets))]


def _take(subset: Subset, points: Floats, keys: list[bytes], which: NDArray[np.bool_]) -> Taken:
    """Add some of points, shape (n, inputs), dimensionless, to a subset."""
    places = np.flatnonzero(which)
    return take(subset, points[places], [keys[one] for one in places.tolist()])


def _wider(wrenches: Floats, keys: list[bytes], there: dict[int, bytes]) -> list[tuple[int, bytes]]:
    """Return the new extremes of wrenches, shape (n, inputs), N and N·m, with their places."""
    if not keys:
        return []
    found, count = [], wrenches.shape[1]
    for place in range(2 * count):
        one, sign = place % count, -1.0 if place < count else 1.0
        best = int(np.argmax(sign * wrenches[:, one]))
        before = _of_width((there.get(place, b""),), count)
        if not before or sign * wrenches[best, one] > sign * unpacked(before, count)[0, one]:
            found.append((place, keys[best]))
    return found


def _of_width(keys: Iterable[bytes], inputs: int) -> list[bytes]:
    """Return packed wrenches without those of an earlier setup with other inputs."""
    return [key for key in keys if len(key) == 8 * inputs]


def _outside(component: Component, wrenches: Floats) -> int:
    return int((~component.load_range.holds(wrenches)).sum()) if len(wrenches) else 0


def _packed_scale(scale: Floats) -> bytes:
    return packed(scale[None])[0]
