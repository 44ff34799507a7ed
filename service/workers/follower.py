"""The process of a read-only server that follows a replica, in place of the builder.

It replaces the ledger's content in one transaction, then the packed tables, which web workers map
as on the main server.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
import time
from contextlib import closing

from uvicorn.config import STARTUP_FAILURE

from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.schema import VERSION
from wrenchbook.service.ops import replica
from wrenchbook.service.ops.backup import LEDGER, TABLES
from wrenchbook.service.ops.replica import Entry, Manifest, Replica, read_status, shown
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState, Status
from wrenchbook.service.workers.supervisor import IN_USE

log = logging.getLogger(__name__)

POLLS = 4  # polls in an interval of the replica: a new version is read within a quarter of it
RETRY_S = 5.0  # pause before the next poll of a replica that could not be read
# Time without a report, beside the pause, after which health reports it: a machine may be busy.
SLACK_S = 60.0


class Follower:
    """Brings a data directory to the state of a replica's newest manifest."""

    def __init__(self, settings: Settings, ledger: Ledger) -> None:
        self._data = settings.data
        self._ledger = ledger
        self._replica = Replica(settings.read_only or "")
        self._entries: dict[str, Entry] = {}
        self._manifest: Manifest | None = None
        self._name = ""

    def follow(self) -> tuple[Manifest, float]:
        """Apply the newest manifest; return it, and the time up to which it is complete, s.

        Raises ReplicaError if the replica has no manifest.
        """
        content = self._replica.place.get(replica.LATEST)
        if not content:
            raise replica.ReplicaError(
                f"{self._replica.url} has no {replica.LATEST}, so it is no replica yet; start the "
                f"main server with --replicate {self._replica.url}"
            )
        pointer = json.loads(content)
        if self._manifest is None or pointer["manifest"] != self._name:
            self._manifest = self._take(self._replica.manifest(pointer["manifest"]))
            self._name = pointer["manifest"]
        return self._manifest, float(pointer["checked"])

    def _take(self, manifest: Manifest) -> Manifest:
        """Bring the data directory to the state of a manifest, and return it."""
        entries = self._replica.files(manifest)
        is_older = manifest.ledger_schema != VERSION
        if self._entries.get(LEDGER) != entries[LEDGER]:
            self._take_ledger(entries[LEDGER], upgrade=is_older)
        # Bundles first, because a table is mapped only if its component exists. HDF5 files are for
        # builders.
        for name in sorted(entries.keys() - {LEDGER}, key=lambda name: name.startswith(TABLES)):
            if self._entries.get(name) != entries[name] and not name.endswith(".h5"):
                self._take_file(name, entries[name])
        # A packed table stays until the next version of its component's table replaces it.
        packed = (self._data / TABLES).glob("[!.]*.wbt")
        tables = {f"{TABLES}/{path.name}" for path in packed}
        with_new_table = {_component_part(name) for name in entries}
        for name in (tables | self._entries.keys()) - entries.keys():
            if name not in tables or _component_part(name) in with_new_table:
                (self._data / name).unlink(missing_ok=True)
        if is_older:
            del entries[LEDGER]  # the copy was upgraded, so that its blocks are no longer known
        self._entries = entries
        return manifest

    def _take_ledger(self, entry: Entry, *, upgrade: bool) -> None:
        """Write the blocks of the ledger's copy that differ, then the ledger from the copy."""
        path = self._data / replica.COPY
        size, digests = entry
        _, before = self._entries.get(LEDGER, (0, ()))  # the digests of the copy's blocks
        with os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), "r+b") as file:
            for number, digest in enumerate(digests):
                if number >= len(before) or before[number] != digest:
                    file.seek(number * replica.BLOCK)
                    file.write(self._replica.block(digest))
            file.truncate(size)
        if upgrade:
            Ledger(path).close()
        self._ledger.take_over(path)

    def _take_file(self, name: str, entry: Entry) -> None:
        """Write a file of the replica, unless it is a table that exists already."""
        path = self._data / name
        size, digests = entry
        if name.startswith(TABLES) and path.is_file() and path.stat().st_size == size:
            return  # from an earlier start: the name has the version, and the file a checksum
        path.parent.mkdir(0o700, parents=True, exist_ok=True)
        content = b"".join(map(self._replica.block, digests))
        write_atomically(path, content, durable=False, mode=0o600)


def _component_part(name: str) -> str:
    """Return the name of a packed table, ``tables/NAME-VERSION.wbt``, without its version."""
    return name.rpartition("-")[0]


def run(settings: Settings, started: threading.Event) -> None:
    """Follow the replica until SIGTERM; `started` is set once the directory has a state of it."""
    stop = threading.Event()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    state = CoordinatorState(settings.data / FOLDER)
    if not state.take():
        log.error(IN_USE.format(settings.data, "another server"))
        sys.exit(STARTUP_FAILURE)
    follower = None
    status = read_status(settings.data).get("followed", {})
    if status:
        started.set()  # answers come from the last state, and have its age
    try:
        with closing(Ledger(settings.data / LEDGER, patient=True)) as ledger:
            while not stop.is_set():
                pause = RETRY_S
                try:
                    follower = follower or Follower(settings, ledger)
                    manifest, checked = follower.follow()
                    pause = manifest.interval / POLLS
                    status |= {"checked": checked, "manifest": manifest.number, "trouble": None}
                    status |= {"server": manifest.server, "rows": manifest.rows}
                    started.set()
                except Exception as error:  # any error of a storage
                    follower = None
                    status["trouble"] = shown(str(error) or repr(error))
                    log.warning("the replica cannot be read: %s", status["trouble"])
                if started.is_set():
                    status |= {"seen": time.time(), "patience": SLACK_S + pause}
                    replica.write_status(settings.data, followed=status)
                state.write(Status(pid=os.getpid()))
                stop.wait(pause)
    finally:
        state.release()
