"""The process that ships a replica and makes scheduled backups.

The supervisor restarts it. It writes its outcomes to ``copies.json``, for health and doctor.
"""

from __future__ import annotations

import logging
import os
import shutil
import signal
import tempfile
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from wrenchbook.service.contract import counted
from wrenchbook.service.files.durable import sync
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.connection import with_remedy
from wrenchbook.service.ops.backup import LEDGER, back_up
from wrenchbook.service.ops.doctor import examine
from wrenchbook.service.ops.replica import COPY, Shipper, read_status, shown, write_status
from wrenchbook.service.ops.restore import restore
from wrenchbook.service.settings import Settings

log = logging.getLogger(__name__)

HOUR = 3600.0  # s
POLL_S = 10.0  # pause between checks whether a backup, whose period is hours, is due
LATE_PERIODS = 1.5  # backup periods without a backup after which health reports it
# Time without a report after which health reports it, and pause before a failed backup is repeated.
SLACK_S = 60.0
_PATTERN = "wrenchbook-*.wbb"  # names of scheduled backups, which have all been tested
_IN_TEST = ".tested-"  # prefix of a folder with a backup that is being tested
_status_lock = threading.Lock()  # this process has two threads that write one file


def run(settings: Settings, started: threading.Event) -> None:
    """Copy until SIGTERM; `started` is set at once, as no request waits for a copy."""
    stop = threading.Event()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    os.umask(0o077)  # only the owner may read copies, like the ledger
    started.set()
    arguments = settings, stop
    backups = threading.Thread(target=make_backups, args=arguments, name="backups", daemon=True)
    if settings.backup_every:
        backups.start()
    if settings.replicate:
        ship(settings, stop)
    stop.wait()
    if settings.backup_every:
        backups.join()  # a backup that has begun is completed


def ship(settings: Settings, stop: threading.Event) -> None:
    """Ship the replica each half interval, and once after `stop`."""
    shipper = None
    again = False
    with closing(Ledger(settings.data / LEDGER, patient=True)) as ledger:
        while True:
            last, begun = stop.is_set(), time.monotonic()
            try:
                shipper = shipper or Shipper(settings, ledger, again=again)
                shipper.round()
                again = True
                facts = {**shipper.facts, "trouble": None, "seconds": time.monotonic() - begun}
            except Exception as error:  # any error of a storage
                shipper = None
                facts = {"trouble": shown(str(error) or repr(error))}
                log.warning("the replica was not written: %s", facts["trouble"])
            _report(settings, "replica", SLACK_S + settings.replicate_interval, facts)
            if last:
                break
            stop.wait(max(0.0, begun + settings.replicate_interval / 2 - time.monotonic()))
    (settings.data / COPY).unlink(missing_ok=True)


def make_backups(settings: Settings, stop: threading.Event) -> None:
    """Make a backup whenever one is due, test it by a restore, and remove old ones."""
    folder = settings.backup_folder or settings.data / "backups"
    period_s = settings.backup_every * HOUR
    pause = 0.0
    for interrupted in folder.glob(f"{_IN_TEST}*"):  # by a kill
        shutil.rmtree(interrupted, ignore_errors=True)
    while not stop.wait(pause):
        pause = POLL_S
        try:
            ages = [time.time() - path.stat().st_mtime for path in folder.glob(_PATTERN)]
            # A backup dated in the future, by a wrong clock, must not postpone the others.
            if not all(abs(age) >= period_s for age in ages):
                continue
            facts = {"trouble": None, **tested_backup(settings.data, folder)}
            newest = folder / facts["file"]
            # Backups dated in the future first, then from the oldest to the newest.
            files = sorted(folder.glob(_PATTERN), key=lambda file: (file <= newest, file))
            for file in files[: -settings.backup_keep]:
                file.unlink(missing_ok=True)
        except Exception as error:
            log.exception("the scheduled backup failed")
            facts = {"trouble": str(error) or repr(error)}
            pause = SLACK_S
        _report(settings, "backup", LATE_PERIODS * period_s + SLACK_S, facts)


def tested_backup(data: Path, folder: Path) -> dict[str, Any]:
    """Write a backup into a folder, once it has been restored into a temporary one without faults.

    A backup that fails the test has another ending; it replaces an earlier failed one.

    Raises BackupError if it cannot be restored, RuntimeError if the restored directory has faults.
    """
    folder.mkdir(0o700, parents=True, exist_ok=True)
    name = f"wrenchbook-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}.wbb"
    with tempfile.TemporaryDirectory(prefix=_IN_TEST, dir=folder) as scratch:
        file, restored = Path(scratch) / name, Path(scratch) / "data"
        back_up(data, file)
        try:
            restore(file, restored)
            faults = [finding.problem for finding in examine(restored) if finding.kind == "fault"]
            if faults:
                raise RuntimeError(
                    f"{name}, restored, has {counted(len(faults), 'fault')}, first: {faults[0]}. "
                    f"Examine the data with: wrenchbook doctor --data {data}"
                )
        except BaseException:
            for former in folder.glob("wrenchbook-*.failed"):
                former.unlink(missing_ok=True)
            file.rename((folder / name).with_suffix(".failed"))
            raise
        file.rename(folder / name)
    sync(folder)
    return {"file": name, "created": time.time(), "tested": True}


def _report(settings: Settings, name: str, patience: float, facts: dict[str, Any]) -> None:
    """Write an outcome that health reports as late after `patience`, s, without another one."""
    with _status_lock:
        part = read_status(settings.data).get(name, {}) | facts
        part |= {"seen": time.time(), "patience": patience}
        try:
            write_status(settings.data, **{name: part})
        except OSError as error:  # a full disk: the next report may have room
            log.warning("the outcome of the %s cannot be noted: %s", name, with_remedy(error))
