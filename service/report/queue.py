"""Reports of a data directory: one a component, made in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from wrenchbook.service.files import lock
from wrenchbook.service.files.program import child_command
from wrenchbook.service.jobs.attempt import LOG, PROGRESS, Progress, read_progress, write_json
from wrenchbook.service.library.component import Component, file_stamp

FILES = {"json": "report.json", "md": "report.md", "html": "report.html"}
ORDER, FAILURE, CANCEL = "order.json", "failure.json", "cancel"
_LOCK = "lock"
State = Literal["none", "running", "done", "failed"]
_KILLED = (
    "the process was killed before it wrote the report, for lack of memory or as the server "
    "stopped; make the report again, and if that ends the same, see reports/{}/log.txt in the data "
    "directory"
)


@dataclass(frozen=True)
class ReportState:
    """Progress of a report; `message` is its present step, or why it failed."""

    state: State
    fraction: float = 0.0
    message: str = ""
    wrenches: int | None = None  # number of compared wrenches, while it is made


class Reports:
    """Makes ``<component>/report.json``, ``.md`` and ``.html`` in `folder`, of HDF5 `tables`."""

    def __init__(self, folder: Path, tables: Path) -> None:
        self._folder = folder
        self._tables = tables
        self._lock = threading.Lock()
        self._processes: dict[str, subprocess.Popen[bytes]] = {}  # by component

    def make(self, component: Component, rows: int, wrenches: int, seed: int) -> bool:
        """Start making the report of a component of `rows` rows, unless one is being made.

        The file of its table is complete. Returns whether it was started.

        Raises FileNotFoundError if there are no rows.
        """
        if not rows:
            raise FileNotFoundError(
                f"{component.name!r} has no rows yet, so there is nothing to report. Fill its "
                f"table first: wrenchbook fill {component.name}"
            )

        folder = self._folder / component.name
        with self._lock:
            folder.mkdir(parents=True, exist_ok=True)
            # Locked by the process that makes it, whichever process of the server started that.
            descriptor = None if self._is_alive(component.name) else lock.take(folder / _LOCK)
            if descriptor is None:
                return False

            order = {
                "bundle": str(component.folder),
                "table": str(self._tables / f"{component.name}.h5"),
                "wrenches": wrenches,
                "seed": seed,
            }
            write_json(folder / ORDER, order)
            for file in (FAILURE, CANCEL, PROGRESS):
                (folder / file).unlink(missing_ok=True)
            environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            try:
                with (folder / LOG).open("wb") as log:
                    self._processes[component.name] = subprocess.Popen(
                        child_command("wrenchbook.service.report", str(folder.absolute())),
                        stdin=subprocess.DEVNULL,
                        stdout=log,
                        stderr=subprocess.STDOUT,
                        env=environment,
                        pass_fds=(descriptor,),
                    )
            finally:
                os.close(descriptor)
        return True

    def cancel(self, name: str) -> None:
        """Stop making a component's report; the report before stays.

        The process ends at once if this process started it, else after its current solve.
        """
        with self._lock:
            if self._is_alive(name):
                (self._folder / name / CANCEL).touch()
            if (process := self._processes.pop(name, None)) is not None:
                process.terminate()
                process.wait()

    def state(self, name: str) -> ReportState:
        """Return how far a component's report is."""
        folder = self._folder / name
        with self._lock:  # no report is begun or cancelled while its files are read
            if self._is_alive(name):
                progress = read_progress(folder) or Progress(0.0, "starting")
                order = _read(folder / ORDER) or {}
                wrenches = order.get("wrenches")
                return ReportState("running", progress.fraction, progress.message, wrenches)
            if failure := _read(folder / FAILURE):
                return ReportState("failed", 0.0, failure["message"])
            ordered, written = file_stamp((folder / ORDER, folder / FILES["json"]))
            is_missing = ordered and (not written or written[0] < ordered[0])
            if is_missing and not (folder / CANCEL).exists():
                return ReportState("failed", 0.0, _KILLED.format(name))
        return ReportState("done", 1.0) if written else ReportState("none")

    def file(self, name: str, format: str) -> Path | None:  # noqa: A002 (the contract's word)
        """Return the file of the latest report in a format of `FILES`; None if there is none."""
        path = self._folder / name / FILES[format]
        return path if path.exists() else None

    def close(self) -> None:
        """Stop making reports; the reports before stay."""
        with self._lock:
            for process in self._processes.values():
                process.terminate()
                process.wait()

    def _is_alive(self, name: str) -> bool:
        process = self._processes.get(name)
        if process is not None and process.poll() is None:
            return True
        return lock.is_locked(self._folder / name / _LOCK)


def _read(path: Path) -> dict[str, Any] | None:
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
