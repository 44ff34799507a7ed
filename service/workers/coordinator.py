"""The process that builds tables and has jobs run, for those that answer; it takes no request."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading

from wrenchbook.service.ops.logs import set_up
from wrenchbook.service.settings import Settings, settings_of_options
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState, Status
from wrenchbook.service.workers.heartbeat import Heartbeat
from wrenchbook.service.workers.supervisor import REFUSED, end_with_supervisor
from wrenchbook.service.workspace import Workspace

log = logging.getLogger(__name__)

TELL_S = 0.25  # between looks at what has changed that the others cannot see themselves


def coordinate(settings: Settings, heartbeat: Heartbeat, stop: threading.Event) -> None:
    """Tend a data directory until told to stop, and beat once it is tended."""
    state = CoordinatorState(settings.folder / FOLDER)
    if not state.take():
        log.error(
            "another server of several processes is at work on %s; stop it first, or serve "
            "another directory with --data",
            settings.folder,
        )
        sys.exit(REFUSED)
    workspace = Workspace(settings)
    try:
        workspace.start()
        _write(state, workspace)
        heartbeat.beat()
        while not stop.wait(TELL_S):
            _write(state, workspace)
            heartbeat.beat()
    finally:
        workspace.close()
        state.release()


def _write(state: CoordinatorState, workspace: Workspace) -> None:
    try:
        state.write(Status(workspace.trouble(), workspace.tables.faults(), os.getpid()))
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
    end_with_supervisor()
    coordinate(settings_of_options(said, "coordinator"), Heartbeat(ready), stop)


if __name__ == "__main__":
    main()
