"""A process that only solves: it shares a data directory's jobs with the server."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

from wrenchbook.service.workspace import Settings, Workspace


def work(folder: Path, solvers: int) -> None:
    """Solve what is queued in ``folder`` until SIGINT or SIGTERM."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    workspace = Workspace(Settings(folder, solvers))
    try:
        workspace.start_solving()
        print(f"solving for {folder} with {solvers} solvers", flush=True)
        stop.wait()
    finally:
        workspace.close()
