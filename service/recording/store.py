"""Recordings and envelopes: the wrenches of a simulator's loop, in the ledger's database.

A recording keeps a thinned subset of its wrenches, an envelope the wrench at each extreme. A block
is written in one transaction with its key, so that a block sent twice counts once.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import BlockKeyError, packed, unpacked
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.packing import content_key
from wrenchbook.service.library.component import Component
from wrenchbook.service.recording.thinning import MAX_OUTSIDE, Subset, scaled_loads, take
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.rows import NEAR, Floats

Kind = Literal["recording", "envelope"]
BlockKey = tuple[str, int]  # the client's name, and its number of the block

# Stored keys of a client, which sends its blocks in order, one or a few at a time.
BLOCKS_OF_A_CLIENT = 256
BLOCKS = 100_000  # stored keys in all, 10 MB: the newest
MAX_SUBSETS = 32  # recordings whose subsets are in memory, some 2 MB each: those written last


@dataclass(frozen=True)
class Tally:
    """The counts and distances of a recording or an envelope, in the order of its columns.

    `revision` grows with every change. Of the wrenches `offered` since it was cleared, `merged` are
    within 1e-6 of the range of a kept one, `thinned` are represented by one, `outside` lie outside
    the load range. `radius` is the largest difference of a load, over its scale (beyond the range:
    over the load itself), at which a wrench counts as a kept one; every offered wrench is `within`
    this distance of one. Those outside the load range are thinned separately. `scale` has the
    scales of the loads, packed, N and N·m, the units of the distances.
    """

    revision: int = 0
    offered: int = 0
    merged: int = 0
    thinned: int = 0
    outside: int = 0
    radius: float = NEAR
    within: float = 0.0
    radius_outside: float = NEAR
    within_outside: float = 0.0
    scale: bytes | None = None


@dataclass(frozen=True)
class BlockResult:
    """The counts after a block.

    `known`: whether the block was recorded before (then nothing has changed); `outside`: the number
    of its wrenches outside the load range.
    """

    tally: Tally
    known: bool
    outside: int


@dataclass(frozen=True)
class RecordingState:
    """A recording: its counts, and the kept wrenches, shape (n, inputs), N and N·m."""

    tally: Tally
    wrenches: Floats


@dataclass(frozen=True)
class EnvelopeState:
    """An envelope: its counts, and the wrenches that reached each extreme.

    Row i of `lowest` (n, n) and `highest` (n, n), N and N·m, is the complete wrench in which input
    i was least or largest; there are no rows without any wrench.
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


class RecordingStore:
    """Recordings and envelopes of one workspace.

    The subset of a recording is in memory in its state after the last block, with the revision of
    its tally and the component. A block of another process changes that number, and an edit the
    component; the subset is then read again.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._library = workspace.library
        self._ledger = workspace.ledger
        self._subsets: dict[str, tuple[int, Component, tuple[Subset, Subset]]] = {}
        self._lock = threading.Lock()

    def record(self, name: str, wrenches: Floats, block: BlockKey | None) -> BlockResult:
        """Add wrenches, shape (n, inputs), N and N·m, to a component's recording.

        Loads on locked freedoms are left out. Without a key a block sent twice counts twice.

        Raises UnknownComponentError if there is no such component, and BlockKeyError if the key was
        used for other wrenches or is too old to be known.
        """
        component = self._library[name]
        acting = component.acting(wrenches)
        scale = component.load_range.scale
        points = scaled_loads(acting, scale)
        keys = packed(acting)
        inside = component.load_range.holds(acting)
        outside = int((~inside).sum())

        with self._ledger.writing() as db:
            before = _read_tally(db, name, "recording")
            if block is not None and not _claim_block(db, name, "recording", block, wrenches):
                return BlockResult(before, known=True, outside=outside)

            subset_within, subset_beyond = self._subsets_of(component, before, db)
            within = take(subset_within, *_select(points, keys, inside))
            beyond = take(subset_beyond, *_select(points, keys, ~inside))
            after = Tally(
                revision=before.revision + 1,
                offered=before.offered + len(keys),
                merged=before.merged + within.merged + beyond.merged,
                thinned=before.thinned + within.thinned + beyond.thinned,
                outside=before.outside + outside,
                radius=within.subset.radius,
                within=within.subset.within,
                radius_outside=beyond.subset.radius,
                within_outside=beyond.subset.within,
                scale=_packed_scale(scale),
            )

            first_index = {key: index for index, key in reversed(list(enumerate(keys)))}
            added = sorted(within.added + beyond.added, key=first_index.__getitem__)
            db.executemany(
                "DELETE FROM recorded WHERE component = ? AND wrench = ?",
                [(name, key) for key in within.dropped + beyond.dropped],
            )
            db.executemany(
                "INSERT INTO recorded (component, wrench) VALUES (?, ?)",
                [(name, key) for key in added],
            )
            _write_tally(db, name, "recording", after)

        # The block is on the disk from now on; the oldest cached subsets are dropped.
        with self._lock:
            self._subsets.pop(name, None)
            self._subsets[name] = after.revision, component, (within.subset, beyond.subset)
            while len(self._subsets) > MAX_SUBSETS:
                del self._subsets[next(iter(self._subsets))]
        return BlockResult(after, known=False, outside=outside)

    def widen(
        self, name: str, wrenches: Floats, block: BlockKey | None
    ) -> tuple[BlockResult, EnvelopeState]:
        """Add wrenches, shape (n, inputs), to a component's envelope and return it; as `record`."""
        component = self._library[name]
        acting = component.acting(wrenches)
        keys = packed(acting)
        outside = int((~component.load_range.holds(acting)).sum())
        with self._ledger.writing() as db:
            before = _read_tally(db, name, "envelope")
            if block is not None and not _claim_block(db, name, "envelope", block, wrenches):
                known = BlockResult(before, known=True, outside=outside)
                return known, _envelope(db, component)
            after = replace(
                before,
                revision=before.revision + 1,
                offered=before.offered + len(keys),
                outside=before.outside + outside,
            )
            db.executemany(
                "INSERT OR REPLACE INTO extremes VALUES (?, ?, ?)",
                [(name, *extreme) for extreme in _new_extremes(acting, keys, _extremes(db, name))],
            )
            _write_tally(db, name, "envelope", after)
            envelope = _envelope(db, component)
        return BlockResult(after, known=False, outside=outside), envelope

    def recording(self, name: str) -> RecordingState:
        """Return a component's recording; raises UnknownComponentError if there is none."""
        count = len(self._library[name].load_range.low)
        with self._ledger.reading() as db:
            tally = _read_tally(db, name, "recording")
            keys = _read_recorded(db, name, count)
        return RecordingState(tally, unpacked(keys, count))

    def envelope(self, name: str) -> EnvelopeState:
        """Return a component's envelope; raises UnknownComponentError if there is none."""
        component = self._library[name]
        with self._ledger.reading() as db:
            return _envelope(db, component)

    def clear(self, name: str, kind: Kind) -> Tally:
        """Empty a component's recording or envelope, and return its earlier counts.

        A block that was in it is not recorded again if it is sent once more.
        """
        component = self._library[name].name
        with self._ledger.writing() as db:
            before = _read_tally(db, component, kind)
            table = "recorded" if kind == "recording" else "extremes"
            db.execute(f"DELETE FROM {table} WHERE component = ?", (component,))
            if before.revision:
                _write_tally(db, component, kind, Tally(revision=before.revision + 1))
                note(db, f"{kind}.clear", component, component, before={"offered": before.offered})
        return before

    def _subsets_of(
        self, component: Component, tally: Tally, db: Connection
    ) -> tuple[Subset, Subset]:
        """Return the ledger's subsets within the load range and outside."""
        scale = component.load_range.scale
        cached = self._subsets.get(component.name)
        if cached and cached[0] == tally.revision and cached[1] is component:
            return cached[2]
        same = tally.scale is None or tally.scale == _packed_scale(scale)
        stretched = 1.0  # largest old scale of a load over the new one
        if tally.scale is not None and len(tally.scale) == scale.nbytes and not same:
            # The load range was edited since: distances have another scale.
            stretched = max(1.0, float((unpacked([tally.scale], len(scale))[0] / scale).max()))

        keys = _read_recorded(db, component.name, len(scale))
        wrenches = unpacked(keys, len(scale))
        points = scaled_loads(wrenches, scale)
        inside = component.load_range.holds(wrenches)
        within = Subset(*_select(points, keys, inside), tally.radius, tally.within * stretched)
        beyond = tally.radius_outside, tally.within_outside * stretched, MAX_OUTSIDE
        return within, Subset(*_select(points, keys, ~inside), *beyond)


def _select(
    points: Floats, keys: list[bytes], mask: NDArray[np.bool_]
) -> tuple[Floats, list[bytes]]:
    """Return the points (n, inputs) and keys of a mask, shape (n,)."""
    indices = np.flatnonzero(mask)
    return points[indices], [keys[index] for index in indices.tolist()]


def _read_tally(db: Connection, component: str, kind: Kind) -> Tally:
    row = db.execute(
        "SELECT revision, offered, merged, thinned, outside, reach, within, reach_outside,"
        " within_outside, scale FROM gatherings WHERE component = ? AND kind = ?",
        (component, kind),
    ).fetchone()
    return Tally(*row) if row else Tally()


def _write_tally(db: Connection, component: str, kind: Kind, tally: Tally) -> None:
    db.execute(
        "INSERT OR REPLACE INTO gatherings VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (component, kind, *astuple(tally)),
    )


def _claim_block(
    db: Connection, component: str, kind: Kind, block: BlockKey, wrenches: Floats
) -> bool:
    """Write a block's key, delete old ones; return False if it is known. Raises BlockKeyError."""
    client, sequence = block
    digest = content_key(b"".join(packed(wrenches)))
    key = "component = ? AND kind = ? AND client = ?"
    of_client = (component, kind, client)
    before = db.execute(
        f"SELECT digest FROM blocks WHERE {key} AND sequence = ?", (*of_client, sequence)
    ).fetchone()
    if before:
        if before[0] != digest:
            raise BlockKeyError(
                f"block {sequence} of client {client!r} was already recorded with other wrenches; "
                "give each block its own number, or use another client name"
            )
        return False

    last = db.execute(f"SELECT max(sequence) FROM blocks WHERE {key}", of_client).fetchone()[0]
    if last is not None and sequence <= last - BLOCKS_OF_A_CLIENT:
        raise BlockKeyError(
            f"block {sequence} of client {client!r} is {last - sequence} before its newest, "
            f"{last}; only the last {BLOCKS_OF_A_CLIENT} are remembered, so it is unknown whether "
            "it was recorded. Send blocks in order, or use another client name to record it now"
        )

    added = db.execute(
        "INSERT INTO blocks (component, kind, client, sequence, digest) VALUES (?, ?, ?, ?, ?)",
        (*of_client, sequence, digest),
    )
    assert added.lastrowid is not None
    db.execute(
        f"DELETE FROM blocks WHERE {key} AND sequence <= ?",
        (*of_client, sequence - BLOCKS_OF_A_CLIENT),
    )
    db.execute("DELETE FROM blocks WHERE id <= ?", (added.lastrowid - BLOCKS,))
    return True


def _read_recorded(db: Connection, component: str, inputs: int) -> list[bytes]:
    rows = db.execute("SELECT wrench FROM recorded WHERE component = ? ORDER BY id", (component,))
    return _with_inputs((wrench for (wrench,) in rows), inputs)


def _envelope(db: Connection, component: Component) -> EnvelopeState:
    count = len(component.load_range.low)
    tally = _read_tally(db, component.name, "envelope")
    extremes = _extremes(db, component.name)
    current = _with_inputs(extremes.values(), count)
    if len(current) != 2 * count:
        return EnvelopeState(tally, unpacked([], count), unpacked([], count))
    lowest = unpacked([extremes[load] for load in range(count)], count)
    highest = unpacked([extremes[count + load] for load in range(count)], count)
    return EnvelopeState(tally, lowest, highest)


def _extremes(db: Connection, component: str) -> dict[int, bytes]:
    """Return packed extremes by index: for n inputs 0 to n - 1 are the least, then the largest."""
    where = "SELECT place, wrench FROM extremes WHERE component = ? ORDER BY place"
    return dict(db.execute(where, (component,)).fetchall())


def _new_extremes(
    wrenches: Floats, keys: list[bytes], extremes: dict[int, bytes]
) -> list[tuple[int, bytes]]:
    """Return the new extremes of wrenches, shape (n, inputs), N and N·m, with their indices."""
    if not keys:
        return []
    wider = []
    count = wrenches.shape[1]
    for index in range(2 * count):
        load = index % count
        sign = -1.0 if index < count else 1.0
        best = int(np.argmax(sign * wrenches[:, load]))
        before = _with_inputs((extremes.get(index, b""),), count)
        if not before or sign * wrenches[best, load] > sign * unpacked(before, count)[0, load]:
            wider.append((index, keys[best]))
    return wider


def _with_inputs(keys: Iterable[bytes], inputs: int) -> list[bytes]:
    """Return packed wrenches without those of an earlier setup with another number of inputs."""
    return [key for key in keys if len(key) == 8 * inputs]


def _packed_scale(scale: Floats) -> bytes:
    return packed(scale[None])[0]
