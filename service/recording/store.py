"""Taking wrenches in: what a recording keeps, how an envelope widens."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import Block, Kept, Kind, Tally, packed, unpacked
from wrenchbook.service.library.component import Component
from wrenchbook.service.recording.net import MOST_OUTSIDE, Net, Taken, scaled_loads, take
from wrenchbook.service.workspace import Workspace

Floats = NDArray[np.float64]

NETS = 32  # recordings whose net is held in memory, some 2 MB each: those written to last


@dataclass(frozen=True)
class Took:
    """What has become of a block.

    Attributes
    ----------
    tally : Tally
        How the recording or the envelope stands now.
    known : bool
        Whether the block was in it already; then nothing has changed.
    outside : int
        Wrenches of the block that are outside the load range.
    """

    tally: Tally
    known: bool
    outside: int


@dataclass(frozen=True)
class Recording:
    """A recording: how it stands, and the wrenches kept, shape (n, 6), N and N·m."""

    tally: Tally
    wrenches: Floats


@dataclass(frozen=True)
class Envelope:
    """An envelope: how it stands, and the wrenches that reached each extreme.

    Attributes
    ----------
    lowest, highest : ndarray, shape (6, 6), N and N·m
        Line i is the whole wrench in which load i was least, largest; no lines if none came.
    """

    tally: Tally
    lowest: Floats
    highest: Floats

    @property
    def box(self) -> tuple[Floats, Floats]:
        """The least and the largest value of each load, shapes (6,), N and N·m; NaN if none."""
        if not len(self.lowest):
            return np.full(6, np.nan), np.full(6, np.nan)
        return self.lowest.diagonal().copy(), self.highest.diagonal().copy()


@dataclass(frozen=True)
class Nets:
    """The wrenches of a recording within the load range, and those outside."""

    inside: Net
    outside: Net


class RecordingStore:
    """Recordings and envelopes of one workspace.

    A recording's net is kept in memory as it was after its last block, with the ledger's number
    of that state: another process's block is seen by another number, and the net is read anew.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._library, self._ledger = workspace.library, workspace.ledger
        self._nets: dict[str, tuple[int, Nets]] = {}
        self._lock = threading.Lock()

    def record(self, name: str, wrenches: Floats, block: Block | None) -> Took:
        """Take wrenches, shape (n, 6), N and N·m, into a component's recording.

        Loads on locked freedoms are left out.

        Raises
        ------
        UnknownComponentError
            If there is no such component.
        BlockKeyError
            If the block's key says nothing.
        """
        component = self._library[name]
        acting, scale = component.acting(wrenches), component.load_range.scale
        points, keys = scaled_loads(acting, scale), packed(acting)
        inside = component.load_range.holds(acting) if len(keys) else np.ones(0, dtype=bool)
        outside = int((~inside).sum())
        nets: list[Nets] = []

        def choose(now: Tally, read: Callable[[], list[bytes]]) -> Kept:
            there = self._nets_of(component, now, read)
            within = _take(there.inside, points, keys, inside)
            beyond = _take(there.outside, points, keys, ~inside)
            nets.append(Nets(within.net, beyond.net))
            after = replace(
                now,
                offered=now.offered + len(keys),
                merged=now.merged + within.merged + beyond.merged,
                thinned=now.thinned + within.thinned + beyond.thinned,
                outside=now.outside + outside,
                reach=within.net.reach,
                within=within.net.within,
                reach_outside=beyond.net.reach,
                within_outside=beyond.net.within,
                scale=_packed_scale(scale),
            )
            came = {key: place for place, key in reversed(list(enumerate(keys)))}
            added = sorted(within.added + beyond.added, key=came.__getitem__)
            return Kept(after, added, within.dropped + beyond.dropped)

        tally, known = self._ledger.record(name, block, choose)
        if nets:  # only now is it on the disk
            self._hold(name, tally.revision, nets[-1])
        return Took(tally, known, outside)

    def widen(self, name: str, wrenches: Floats, block: Block | None) -> Took:
        """Take wrenches, shape (n, 6), N and N·m, into a component's envelope; as `record`."""
        component = self._library[name]
        acting = component.acting(wrenches)
        outside, keys = _outside(component, acting), packed(acting)

        def choose(now: Tally, there: dict[int, bytes]) -> Kept:
            after = replace(now, offered=now.offered + len(keys), outside=now.outside + outside)
            return Kept(after, _wider(acting, keys, there), [])

        return Took(*self._ledger.widen(name, block, choose), outside)

    def recording(self, name: str) -> Recording:
        """Return a component's recording; raises UnknownComponentError."""
        tally, keys = self._ledger.recording(self._library[name].name)
        return Recording(tally, unpacked(keys))

    def envelope(self, name: str) -> Envelope:
        """Return a component's envelope; raises UnknownComponentError."""
        tally, there = self._ledger.envelope(self._library[name].name)
        loads = range(6) if there else ()
        lowest, highest = ([there[at + load] for load in loads] for at in (0, 6))
        return Envelope(tally, unpacked(lowest), unpacked(highest))

    def clear(self, name: str, kind: Kind) -> Tally:
        """Empty a component's recording or envelope, and return how it stood."""
        return self._ledger.clear_recording(self._library[name].name, kind)

    def _nets_of(self, component: Component, now: Tally, read: Callable[[], list[bytes]]) -> Nets:
        """Return the nets of a recording as the ledger has it."""
        scale, held = component.load_range.scale, self._nets.get(component.name)
        same = now.scale is None or now.scale == _packed_scale(scale)
        if held is not None and held[0] == now.revision and same:
            return held[1]
        keys, stretched = read(), 1.0
        if now.scale is not None and not same:
            # The load range was edited since: what is near is told in other measures.
            stretched = max(1.0, float((unpacked([now.scale])[0] / scale).max()))
        wrenches = unpacked(keys)
        points, holds = scaled_loads(wrenches, scale), component.load_range.holds(wrenches)
        inside, outside = np.flatnonzero(holds), np.flatnonzero(~holds)
        own, others = ([keys[one] for one in places.tolist()] for places in (inside, outside))
        return Nets(
            Net(points[inside], own, now.reach, now.within * stretched),
            Net(
                points[outside],
                others,
                now.reach_outside,
                now.within_outside * stretched,
                MOST_OUTSIDE,
            ),
        )

    def _hold(self, name: str, revision: int, nets: Nets) -> None:
        with self._lock:
            self._nets.pop(name, None)
            self._nets[name] = revision, nets
            while len(self._nets) > NETS:
                del self._nets[next(iter(self._nets))]


def _take(net: Net, points: Floats, keys: list[bytes], which: NDArray[np.bool_]) -> Taken:
    """Take some of points, shape (n, 6), dimensionless, into a net."""
    places = np.flatnonzero(which)
    return take(net, points[places], [keys[one] for one in places.tolist()])


def _wider(wrenches: Floats, keys: list[bytes], there: dict[int, bytes]) -> list[tuple[int, bytes]]:
    """Return the extremes that wrenches, shape (n, 6), N and N·m, set anew, with their places."""
    if not keys:
        return []
    found = []
    for place in range(12):
        load, sign = place % 6, -1.0 if place < 6 else 1.0
        best = int(np.argmax(sign * wrenches[:, load]))
        before = there.get(place)
        if before is None or sign * wrenches[best, load] > sign * unpacked([before])[0, load]:
            found.append((place, keys[best]))
    return found


def _outside(component: Component, wrenches: Floats) -> int:
    return int((~component.load_range.holds(wrenches)).sum()) if len(wrenches) else 0


def _packed_scale(scale: Floats) -> bytes:
    return packed(scale[None])[0]
