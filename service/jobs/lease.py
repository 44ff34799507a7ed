"""Which dispatchers are alive: each holds the lock of a file that bears its name, and beats."""

import os
import secrets
import time
from pathlib import Path

from wrenchbook.service.files import lock as flock
from wrenchbook.service.ledger import Beat

BEAT_SECONDS = 2.0  # between the heartbeats of a dispatcher that has attempts to look after
# Four beats missed. With a look a second, a lease that is lost is found within ten seconds.
LEASE_SECONDS = 8.0


class Lease:
    """The name under which a dispatcher owns running jobs, for as long as it lives.

    Parameters
    ----------
    folder : path
        Where all dispatchers of a data directory keep their lock files.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name = f"{os.getpid()}-{secrets.token_hex(4)}"
        self._folder = folder
        self._lock = flock.take(self._file(self.name))
        self._seen: dict[str, tuple[int, float]] = {}

    def is_lost(self, owner: str, engine: str, beat: Beat | None) -> bool:
        """Return whether an owner of attempts has died, or does not look after them any more.

        A lock that nobody holds proves it at once. Otherwise the heartbeat tells, by whether it has
        changed while this dispatcher looked on: no clock of another one is trusted.

        Parameters
        ----------
        engine : str
            Of the attempts. All dispatchers of `local` have their lock files here.
        beat : Beat or None
            The owner's last heartbeat; None if it has ended its lease.
        """
        file = self._file(owner)
        there = file.exists()
        if there and not flock.is_held(file):
            return True
        if not there and (engine == "local" or beat is None):
            return True
        now, number = time.monotonic(), -1 if beat is None else beat.beat
        seen = self._seen.get(owner)
        if seen is None or seen[0] != number:
            self._seen[owner] = number, now
            return False
        return now - seen[1] > LEASE_SECONDS

    def remove(self, owner: str) -> None:
        """Remove the lock file of a dispatcher that is dead; one that is merely late keeps it."""
        self._seen.pop(owner, None)
        if not flock.is_held(self._file(owner)):
            self._file(owner).unlink(missing_ok=True)

    def close(self) -> None:
        """Die: whatever is still owned under this name is free to be adopted."""
        if self._lock is not None:
            self._file(self.name).unlink(missing_ok=True)
            os.close(self._lock)
            self._lock = None

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.lock"
