"""Lock and status of the one process that builds tables, for those that map them.

Both are in a folder of the data directory that the process removes when it ends.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.lock import is_locked, take

FOLDER = "shared"  # in the data directory
LOCK, _STATUS = "lock", "status.json"


@dataclass(frozen=True)
class Status:
    """What is wrong, as far as the building process knows.

    Attributes
    ----------
    trouble : str or None
        Why no job runs.
    faults : dict of str to str
        Why a component's table is not what the ledger says, by its name.
    pid : int
        Of the building process; 0 if it has written none.
    """

    trouble: str | None = None
    faults: dict[str, str] = field(default_factory=dict)
    pid: int = 0


class CoordinatorState:
    """The folder of one data directory.

    Parameters
    ----------
    folder : path
        Made if there is none.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._written: Status | None = None
        self._lock: int | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def take(self) -> bool:
        """Take the lock of the process that builds; False if another process has it."""
        self._lock = take(self._folder / LOCK)
        return self._lock is not None

    def is_taken(self) -> bool:
        """Return whether a process has the lock."""
        return is_locked(self._folder / LOCK)

    def release(self) -> None:
        """Give the lock up and remove the folder."""
        if self._lock is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            os.close(self._lock)
            self._lock = None

    def write(self, status: Status) -> None:
        """Write the status for the other processes if it has changed.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        path = self._folder / _STATUS
        if status != self._written or not path.exists():
            write_whole_bytes(path, json.dumps(asdict(status)).encode(), durable=False)
            self._written = status

    def read(self) -> Status:
        """Return the status written last; nothing is wrong without one."""
        try:
            return Status(**json.loads((self._folder / _STATUS).read_bytes()))
        except (OSError, ValueError, TypeError):
            return Status()
