"""The process that builds tables and dispatches jobs; it answers no request."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Mapping
from typing import Any

from uvicorn.config import STARTUP_FAILURE

from wrenchbook.service.settings import settings_of_options
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState, Status
from wrenchbook.service.workspace import Workspace

log = logging.getLogger(__name__)

STATUS_S = 0.25  # between two looks at the status that web workers read


class Builder:
    """Builds tables and dispatches jobs until SIGTERM.

    Attributes
    ----------
    started : bool
        Whether the tables are loaded and jobs run.
    """

    def __init__(self, options: Mapping[str, Any]) -> None:
        self._settings = settings_of_options(options, "builder")
        self._state = CoordinatorState(self._settings.folder / FOLDER)
        self._stop = threading.Event()
        self.started = False

    def run(self, sockets: object = None) -> None:
        """Build and dispatch; a data directory with another builder ends the process."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C: the parent ends this process
        signal.signal(signal.SIGTERM, lambda *_: self._stop.set())
        if not self._state.take():
            log.error(
                "another server uses %s; stop it first, or serve another directory with --data",
                self._settings.folder,
            )
            sys.exit(STARTUP_FAILURE)
        workspace = Workspace(self._settings)
        try:
            workspace.start()
            self._write_status(workspace)
            self.started = True
            while not self._stop.wait(STATUS_S):
                self._write_status(workspace)
        finally:
            workspace.close()
            self._state.release()

    def _write_status(self, workspace: Workspace) -> None:
        try:
            faults = workspace.tables.faults()
            self._state.write(Status(workspace.trouble(), faults, os.getpid()))
        except OSError as error:
            log.warning("the builder's status cannot be written for web workers: %s", error)
