"""Files in which the process that builds tables and those that map them publish their state.

They are in one folder of the data directory: the builder's lock and status, and a file of each
other process. The lock file stays when the builder ends: a process that waits for a removed file
would lock it beside the holder of a new one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

from wrenchbook.service.files.durable import is_running, write_atomically
from wrenchbook.service.files.lock import is_locked, take

FOLDER = "shared"  # name of the folder in the data directory
LOCK, _STATUS = "lock", "status.json"  # files in this folder


class PublishedTable(NamedTuple):
    """A table from which a process answers: its version, and the setup that it is built from."""

    version: int
    setup: str


@dataclass(frozen=True)
class Status:
    """The builder's problems, by component where they are of one."""

    trouble: str | None = None  # why no job runs
    faults: dict[str, str] = field(default_factory=dict)  # why a table differs from the ledger
    pid: int = 0  # the builder's; 0 if it has written no status
    # The ledger's newest change of a component when its table could not be built.
    failed: dict[str, int] = field(default_factory=dict)


class CoordinatorState:
    """The folder of the published state; it is created on first use."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._mapped = folder / f"{os.getpid()}-{id(self)}.mapped"
        self._written: Status | None = None
        self._lock: int | None = None
        with suppress(OSError):  # a web worker also answers on a read-only disk
            folder.mkdir(parents=True, exist_ok=True)

    def take(self) -> bool:
        """Take the builder's lock; return False if another process has it."""
        self._lock = take(self._folder / LOCK)
        if self._lock is None:
            return False
        # A killed process left its file; a running one writes it again.
        for path in self._folder.glob("*.mapped"):
            path.unlink(missing_ok=True)
        return True

    def is_locked_by_builder(self) -> bool:
        """Return whether a process has the lock."""
        return is_locked(self._folder / LOCK)

    def release(self) -> None:
        """Remove the status and release the lock."""
        if self._lock is not None:
            with suppress(OSError):
                (self._folder / _STATUS).unlink()
            os.close(self._lock)
            self._lock = None

    def write(self, status: Status) -> None:
        """Write the status for the other processes if it has changed.

        Raises OSError if it cannot be written.
        """
        path = self._folder / _STATUS
        if status != self._written or not path.exists():
            write_atomically(path, json.dumps(asdict(status)).encode(), durable=False)
            self._written = status

    def read(self) -> Status:
        """Return the last written status; one without problems if there is none."""
        try:
            return Status(**json.loads((self._folder / _STATUS).read_bytes()))
        except (OSError, ValueError, TypeError):
            return Status()

    def stamp(self) -> tuple[int, int]:
        """Return a value that changes when the status is written, in a tenth of `read`'s time."""
        try:
            status = os.stat(self._folder / _STATUS)  # noqa: PTH116 (fifty times a second)
        except OSError:
            return (0, 0)
        return status.st_mtime_ns, status.st_ino

    def publish(self, mapped: dict[str, PublishedTable]) -> None:
        """Write the tables from which this process answers, by component."""
        write_atomically(self._mapped, json.dumps(mapped).encode(), durable=False)

    def unpublish(self) -> None:
        """Remove this process's published tables."""
        self._mapped.unlink(missing_ok=True)

    def others(self) -> Iterator[dict[str, PublishedTable]]:
        """Yield the tables, by component, from which each other running process answers."""
        for path in self._folder.glob("*.mapped"):
            # That process has just ended, or a power failure cut the file off.
            with suppress(OSError, ValueError):
                if path != self._mapped and is_running(int(path.name.partition("-")[0])):
                    mapped = json.loads(path.read_bytes())
                    yield {name: PublishedTable(*table) for name, table in mapped.items()}
