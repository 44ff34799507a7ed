"""SQL of recordings and envelopes. Each function takes a connection inside a transaction.

What is kept of the wrenches that a loop meets is decided elsewhere; here it is written.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from wrenchbook.service.ledger.errors import BlockKeyError
from wrenchbook.service.ledger.records import content_key
from wrenchbook.service.ledger.schema import Connection

Kind = Literal["recording", "envelope"]

MERGE = 1e-6  # of a load's scale: wrenches as near as this to one kept are one
BLOCKS_OF_A_CLIENT = 256  # keys kept: a client sends its blocks in order, one or a few at a time
BLOCKS = 100_000  # keys kept in all, 10 MB: the newest


@dataclass(frozen=True)
class Tally:
    """How a recording or an envelope stands.

    Attributes
    ----------
    revision : int
        Grows with every change.
    offered : int
        Wrenches taken in since it was cleared, each once.
    merged, thinned : int
        Those of them that one kept stands for: within 1e-6 of the range, or by thinning.
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
    """The key of a block: who sent it, the number they gave it, and a digest of its wrenches."""

    client: str
    sequence: int
    digest: bytes


class Kept(NamedTuple):
    """What a block changes: the tally, the packed wrenches that are added, those dropped.

    Of an envelope `added` holds pairs: the place, 0 to 5 for the least of each load and 6 to 11
    for the largest, and the wrench.
    """

    tally: Tally
    added: list
    dropped: list[bytes]


def block_of(client: str, sequence: int, packed: Iterable[bytes]) -> Block:
    """Return the key of a block of packed wrenches."""
    return Block(client, sequence, content_key(b"".join(packed)))


def tally(db: Connection, component: str, kind: Kind) -> Tally:
    """Return how a component's recording or envelope stands."""
    found = db.execute(
        "SELECT revision, offered, merged, thinned, outside, reach, within, reach_outside,"
        " within_outside, scale FROM gatherings WHERE component = ? AND kind = ?",
        (component, kind),
    ).fetchone()
    return Tally(*found) if found else Tally()


def is_known(db: Connection, component: str, kind: Kind, block: Block) -> bool:
    """Return whether a block was taken in already; raises BlockKeyError if that cannot be told."""
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


def remember(db: Connection, component: str, kind: Kind, block: Block) -> None:
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


def recorded(db: Connection, component: str) -> list[bytes]:
    """Return the packed wrenches a component's recording keeps, in the order they came."""
    found = db.execute("SELECT wrench FROM recorded WHERE component = ? ORDER BY id", (component,))
    return [wrench for (wrench,) in found]


def extremes(db: Connection, component: str) -> dict[int, bytes]:
    """Return the packed wrenches of a component's envelope, by place as in `Kept`."""
    where = "SELECT place, wrench FROM extremes WHERE component = ? ORDER BY place"
    return dict(db.execute(where, (component,)).fetchall())


def write(db: Connection, component: str, kind: Kind, kept: Kept) -> Tally:
    """Write what a block has changed, and return the tally with its next revision."""
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


def clear(db: Connection, component: str, kind: Kind) -> Tally:
    """Empty a recording or an envelope; return how it stood. Blocks taken in stay known."""
    before = tally(db, component, kind)
    table = "recorded" if kind == "recording" else "extremes"
    db.execute(f"DELETE FROM {table} WHERE component = ?", (component,))
    if before.revision:
        _save(db, component, kind, Tally(revision=before.revision + 1))
    return before


def _save(db: Connection, component: str, kind: Kind, now: Tally) -> None:
    db.execute(
        "INSERT OR REPLACE INTO gatherings VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (component, kind, now.revision, now.offered, now.merged, now.thinned, now.outside,
         now.reach, now.within, now.reach_outside, now.within_outside, now.scale),
    )  # fmt: skip
