"""Which dispatchers are alive: each holds the lock of a file that bears its name."""

import os
import secrets
from pathlib import Path

from service.files import lock as flock


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

    def is_alive(self, name: str) -> bool:
        """Return whether the dispatcher of that name still lives."""
        return flock.is_held(self._file(name))

    def remove(self, name: str) -> None:
        """Remove the lock file of a dispatcher that is dead."""
        self._file(name).unlink(missing_ok=True)

    def close(self) -> None:
        """Die: whatever is still owned under this name is free to be adopted."""
        if self._lock is not None:
            self.remove(self.name)
            os.close(self._lock)
            self._lock = None

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.lock"
