"""The process that builds tables and has jobs run, for those that answer; it takes no request."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading

from service.crew.pulse import Pulse
from service.crew.supervisor import REFUSED, follow_supervisor
from service.settings import Settings, settings_of_options
from service.tables.shelf import FOLDER, Shelf, Told
from service.telemetry.logs import set_up
from service.workspace import Workspace

log = logging.getLogger(__name__)

TELL_S = 0.25  # between looks at what has changed that the others cannot see themselves


def coordinate(settings: Settings, pulse: Pulse, stop: threading.Event) -> None:
    """Tend a data directory until told to stop, and beat once it is tended."""
    shelf = Shelf(settings.folder / FOLDER)
    if not shelf.take():
        log.error(
            "another server of several processes is at work on %s; stop it first, or serve "
            "another directory with --data",
            settings.folder,
        )
        sys.exit(REFUSED)
    workspace = Workspace(settings)
    try:
        workspace.start()
        _tell(shelf, workspace)
        pulse.beat()
        while not stop.wait(TELL_S):
            _tell(shelf, workspace)
            pulse.beat()
    finally:
        workspace.close()
        shelf.leave()


def _tell(shelf: Shelf, workspace: Workspace) -> None:
    try:
        shelf.tell(Told(workspace.trouble(), workspace.tables.faults()))
    except OSError as error:
        log.warning("what is wrong cannot be told to the others: %s", error)


def main() -> None:
    """Run as a process of the supervisor's."""
    said, ready = json.loads(sys.argv[1]), int(sys.argv[2])
    set_up(said["log_level"], said["log_format"])
    stop = threading.Event()

    def heed(number: int, _: object) -> None:
        if stop.is_set():
            os._exit(128 + number)  # solvers go on, and are found at the next start
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, heed)
    follow_supervisor()
    coordinate(settings_of_options(said, "coordinator"), Pulse(ready), stop)


if __name__ == "__main__":
    main()
