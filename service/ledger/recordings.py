"""Recordings and envelopes: the wrenches that a simulator's loop has met.

Which wrenches are kept is decided by the caller, in the transaction that writes them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.connections import Database
from wrenchbook.service.ledger.packing import content_key
from wrenchbook.service.ledger.records import BlockKeyError

Kind = Literal["recording", "envelope"]

MERGE = 1e-6  # of a load's scale: wrenches as near as this to one kept are one
BLOCKS_OF_A_CLIENT = 256  # keys kept: a client sends its blocks in order, one or a few at a time
BLOCKS = 100_000  # keys kept in all, 10 MB: the newest


@dataclass(frozen=True)
class Tally:
    """The counts and distances of a recording or an envelope.

    Attributes
    ----------
    revision : int
        Grows with every change.
    offered : int
        Wrenches offered since it was cleared, each once.
    merged, thinned : int
        Those of them that a kept one represents: within 1e-6 of the range, or by thinning.
    outside : int
        Those of them outside the load range.
    reach : float
        Largest difference of a load, of its scale (beyond the range: of itself), at which a wrench
        counts as one that is kept.
    within : float
        Every wrench offered is as near as this to one kept, in the same measure.
    reach_outside, within_outside : float
        The same of the wrenches outside the load range, which are thinned by themselves.
    scale : bytes or None
        The scales of the loads, packed, N and N·m, that these are measured in.
    """

    revision: int = 0
    offered: int = 0
    merged: int = 0
    thinned: int = 0
    outside: int = 0
    reach: float = MERGE
    within: float = 0.0
    reach_outside: float = MERGE
    within_outside: float = 0.0
    scale: bytes | None = None


class Block(NamedTuple):
    """The key of a block: its client, the client's number of it, and a digest of its wrenches."""

    client: str
    sequence: int
    digest: bytes


class Kept(NamedTuple):
    """The changes of a block: the tally, the packed wrenches added, those dropped.

    Of an envelope `added` holds pairs: the place, 0 to 5 for the least of each load and 6 to 11
    for the largest, and the wrench.
    """

    tally: Tally
    added: list
    dropped: list[bytes]


def block_of(client: str, sequence: int, packed: Iterable[bytes]) -> Block:
    """Return the key of a block of packed wrenches."""
    return Block(client, sequence, content_key(b"".join(packed)))


class Recordings(Database):
    """The recordings and envelopes of the ledger."""

    def record(
        self,
        component: str,
        block: Block | None,
        choose: Callable[[Tally, Callable[[], list[bytes]]], Kept],
    ) -> tuple[Tally, bool]:
        """Take a block of wrenches into a component's recording, once.

        Parameters
        ----------
        block : Block or None
            Its key; without one a block that is sent twice counts twice.
        choose : callable
            Called in the transaction with the recording's tally and a function that reads the
            wrenches kept; returns the changes.

        Returns
        -------
        tally : Tally
            Of the recording, after the block.
        known : bool
            Whether the block was in it already; then nothing has changed.

        Raises
        ------
        BlockKeyError
            If the key was used for other wrenches, or is too old to be known.
        """
        return self._take(
            component,
            "recording",
            block,
            lambda now, db: choose(now, lambda: _recorded(db, component)),
        )

    def widen(
        self,
        component: str,
        block: Block | None,
        choose: Callable[[Tally, dict[int, bytes]], Kept],
    ) -> tuple[Tally, bool]:
        """Take a block of wrenches into a component's envelope, once; as `record`.

        `choose` is given the tally and the extremes by place, as `Kept` numbers them.
        """
        return self._take(
            component,
            "envelope",
            block,
            lambda now, db: choose(now, _extremes(db, component)),
        )

    def recording(self, component: str) -> tuple[Tally, list[bytes]]:
        """Return the tally of a component's recording and the packed wrenches it keeps."""
        with self.reading() as db:
            return _tally(db, component, "recording"), _recorded(db, component)

    def envelope(self, component: str) -> tuple[Tally, dict[int, bytes]]:
        """Return the tally of a component's envelope and its packed extremes by place."""
        with self.reading() as db:
            return _tally(db, component, "envelope"), _extremes(db, component)

    def clear_recording(self, component: str, kind: Kind) -> Tally:
        """Empty a recording or an envelope, and return its tally before.

        A block that was in it is not taken in again when it is sent once more.
        """
        with self.writing() as db:
            before = _tally(db, component, kind)
            table = "recorded" if kind == "recording" else "extremes"
            db.execute(f"DELETE FROM {table} WHERE component = ?", (component,))
            if before.revision:
                _save(db, component, kind, Tally(revision=before.revision + 1))
        return before

    def _take(
        self, component: str, kind: Kind, block: Block | None, choose: Callable
    ) -> tuple[Tally, bool]:
        with self.writing() as db:
            now = _tally(db, component, kind)
            if block is not None:
                if _is_known(db, component, kind, block):
                    return now, True
                _remember(db, component, kind, block)
            return _write(db, component, kind, choose(now, db)), False


def _tally(db: Connection, component: str, kind: Kind) -> Tally:
    found = db.execute(
        "SELECT revision, offered, merged, thinned, outside, reach, within, reach_outside,"
        " within_outside, scale FROM gatherings WHERE component = ? AND kind = ?",
        (component, kind),
    ).fetchone()
    return Tally(*found) if found else Tally()


def _is_known(db: Connection, component: str, kind: Kind, block: Block) -> bool:
    """Return whether a block was taken in already; raises BlockKeyError if that is not known."""
    key = "component = ? AND kind = ? AND client = ?"
    of_client = (component, kind, block.client)
    found = db.execute(
        f"SELECT digest FROM blocks WHERE {key} AND sequence = ?", (*of_client, block.sequence)
    ).fetchone()
    if found:
        if found[0] != block.digest:
            raise BlockKeyError(
                f"block {block.sequence} of client {block.client!r} has been recorded with other "
                "wrenches; give each block a number of its own, or use another client name"
            )
        return True
    last = db.execute(f"SELECT max(sequence) FROM blocks WHERE {key}", of_client).fetchone()[0]
    if last is not None and block.sequence <= last - BLOCKS_OF_A_CLIENT:
        raise BlockKeyError(
            f"block {block.sequence} of client {block.client!r} is more than {BLOCKS_OF_A_CLIENT} "
            f"before its newest, {last}: whether it was recorded is not known any more. Send "
            "blocks in order, or use another client name to record it now"
        )
    return False


def _remember(db: Connection, component: str, kind: Kind, block: Block) -> None:
    """Write a block's key, and forget keys too old to be sent again."""
    of_client = (component, kind, block.client)
    added = db.execute(
        "INSERT INTO blocks (component, kind, client, sequence, digest) VALUES (?, ?, ?, ?, ?)",
        (*of_client, block.sequence, block.digest),
    )
    db.execute(
        "DELETE FROM blocks WHERE component = ? AND kind = ? AND client = ? AND sequence <= ?",
        (*of_client, block.sequence - BLOCKS_OF_A_CLIENT),
    )
    assert added.lastrowid is not None
    db.execute("DELETE FROM blocks WHERE id <= ?", (added.lastrowid - BLOCKS,))


def _recorded(db: Connection, component: str) -> list[bytes]:
    found = db.execute("SELECT wrench FROM recorded WHERE component = ? ORDER BY id", (component,))
    return [wrench for (wrench,) in found]


def _extremes(db: Connection, component: str) -> dict[int, bytes]:
    where = "SELECT place, wrench FROM extremes WHERE component = ? ORDER BY place"
    return dict(db.execute(where, (component,)).fetchall())


def _write(db: Connection, component: str, kind: Kind, kept: Kept) -> Tally:
    """Write the changes of a block; return the tally with its next revision."""
    now = replace(kept.tally, revision=kept.tally.revision + 1)
    if kind == "recording":
        dropped = [(component, wrench) for wrench in kept.dropped]
        db.executemany("DELETE FROM recorded WHERE component = ? AND wrench = ?", dropped)
        added = [(component, wrench) for wrench in kept.added]
        db.executemany("INSERT INTO recorded (component, wrench) VALUES (?, ?)", added)
    else:
        added = [(component, place, wrench) for place, wrench in kept.added]
        db.executemany("INSERT OR REPLACE INTO extremes VALUES (?, ?, ?)", added)
    _save(db, component, kind, now)
    return now


def _save(db: Connection, component: str, kind: Kind, now: Tally) -> None:
    db.execute(
        "INSERT OR REPLACE INTO gatherings VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (component, kind, now.revision, now.offered, now.merged, now.thinned, now.outside,
         now.reach, now.within, now.reach_outside, now.within_outside, now.scale),
    )  # fmt: skip
