"""The third part of the ledger: recordings and envelopes, what a simulator's loop has met."""

from collections.abc import Callable

from wrenchbook.service.ledger import recorded
from wrenchbook.service.ledger.connections import Connections
from wrenchbook.service.ledger.recorded import Block, Kept, Kind, Tally


class LedgerRecordings:
    """What `Ledger` does with recordings and envelopes."""

    _db: Connections

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
            Its key; without one nothing tells a block that is sent twice.
        choose : callable
            Given how the recording stands and what reads the wrenches kept, it returns what
            changes. It runs in the transaction: what it has seen is what is changed.

        Returns
        -------
        tally : Tally
            How the recording stands now.
        known : bool
            Whether the block was in it already; then nothing has changed.

        Raises
        ------
        BlockKeyError
            If the key was used for other wrenches, or is too old to be told.
        """
        return self._take(
            component,
            "recording",
            block,
            lambda now, db: choose(now, lambda: recorded.recorded(db, component)),
        )

    def widen(
        self,
        component: str,
        block: Block | None,
        choose: Callable[[Tally, dict[int, bytes]], Kept],
    ) -> tuple[Tally, bool]:
        """Take a block of wrenches into a component's envelope, once; as `record`.

        `choose` is given the tally and the extremes by place, as `recorded.Kept` numbers them.
        """
        return self._take(
            component,
            "envelope",
            block,
            lambda now, db: choose(now, recorded.extremes(db, component)),
        )

    def recording(self, component: str) -> tuple[Tally, list[bytes]]:
        """Return how a component's recording stands and the packed wrenches it keeps."""
        with self._db.reading() as db:
            return recorded.tally(db, component, "recording"), recorded.recorded(db, component)

    def envelope(self, component: str) -> tuple[Tally, dict[int, bytes]]:
        """Return how a component's envelope stands and its packed extremes by place."""
        with self._db.reading() as db:
            return recorded.tally(db, component, "envelope"), recorded.extremes(db, component)

    def clear_recording(self, component: str, kind: Kind) -> Tally:
        """Empty a recording or an envelope, and return how it stood.

        A block that was in it is not taken in again when it is sent once more.
        """
        with self._db.writing() as db:
            return recorded.clear(db, component, kind)

    def _take(
        self, component: str, kind: Kind, block: Block | None, choose: Callable
    ) -> tuple[Tally, bool]:
        with self._db.writing() as db:
            now = recorded.tally(db, component, kind)
            if block is not None:
                if recorded.is_known(db, component, kind, block):
                    return now, True
                recorded.remember(db, component, kind, block)
            return recorded.write(db, component, kind, choose(now, db)), False
