"""Starts the processes of a server, starts again what ends, and ends all at a signal.

It holds the listening socket, so that a connection that nobody has taken yet outlives whoever would
have, and nothing else: neither tables nor the ledger, so that nothing it does can fail it.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from wrenchbook.service.files.program import child_command
from wrenchbook.service.http.listen import bind_to
from wrenchbook.service.ops.logs import set_up
from wrenchbook.service.workers.heartbeat import READY_S, SILENT_S, HeartbeatWatch

log = logging.getLogger(__name__)

REFUSED = 3  # status of a coordinator that finds another one at work
STOP_S = 30.0
QUICK_S = 10.0  # who lives for less is started again later each time
LONGEST_PAUSE_S = 30.0
BACKLOG = 2048  # connections that wait to be taken, as uvicorn has it


class WorkerFailedError(RuntimeError):
    """A process of the server could not be started; its log says why."""


class Worker:
    """One process, started again whenever it ends by itself.

    Parameters
    ----------
    name : str
        For the log.
    command : list of str
        Is given, besides, the number of a pipe to write to once it is ready, and then each second.
    passed : sequence of int
        Descriptors that it inherits.
    """

    def __init__(self, name: str, command: list[str], passed: Sequence[int] = ()) -> None:
        self.name = name
        self._command, self._passed = command, tuple(passed)
        self._child: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._settled = threading.Event()
        self._ready = False
        self._thread = threading.Thread(target=self._keep, name=name, daemon=True)

    @property
    def pid(self) -> int | None:
        """The process' number; None before its first start."""
        child = self._child
        return child.pid if child is not None else None

    def start(self) -> None:
        """Start it, without waiting for it."""
        self._thread.start()

    def wait_until_ready(self, ended: threading.Event) -> None:
        """Return once it works, or all are to end.

        Raises
        ------
        WorkerFailedError
            If it ends before, or does not in `READY_S`.
        """
        deadline = time.monotonic() + READY_S
        # In steps: a signal is heeded between them.
        while not (ended.is_set() or self._settled.wait(0.1)) and time.monotonic() < deadline:
            pass
        if not (self._ready or ended.is_set()):
            raise WorkerFailedError(f"{self.name} did not start; its log says why")

    def terminate(self) -> None:
        """Ask it to end, and start it no more."""
        self._stopping.set()
        with self._lock:
            if self._child is not None and self._child.poll() is None:
                self._child.terminate()

    def wait(self, seconds: float) -> None:
        """Return once it has ended, which is brought about after so many seconds."""
        if self._thread.ident is None:
            return  # it was never started
        self._thread.join(seconds)
        with self._lock:
            if self._child is not None and self._child.poll() is None:
                log.error("%s did not end in %g s and is killed", self.name, seconds)
                self._child.kill()
        self._thread.join()

    def _keep(self) -> None:
        quick = 0
        while not self._stopping.is_set():
            began = time.monotonic()
            status = self._run_once()
            if self._stopping.is_set() or not self._ready:
                break
            quick = quick + 1 if time.monotonic() - began < QUICK_S else 0
            pause = min(0.1 * 2**quick - 0.1, LONGEST_PAUSE_S)
            log.error("%s ended with status %d; it is started again", self.name, status)
            self._stopping.wait(pause)
        self._settled.set()

    def _run_once(self) -> int:
        """Run it until it ends; return how it ended, minus the signal if one ended it."""
        heard, beaten = os.pipe()
        with self._lock:
            if self._stopping.is_set():
                os.close(heard)
                os.close(beaten)
                return 0
            # A session of its own: Ctrl-C reaches it through `terminate` alone, once. Its input
            # ends with this process, however that ends: see `end_with_supervisor`.
            self._child = subprocess.Popen(
                [*self._command, str(beaten)],
                stdin=subprocess.PIPE,
                pass_fds=(*self._passed, beaten),
                start_new_session=True,
            )
        os.close(beaten)
        try:
            self._follow(self._child, HeartbeatWatch(self._child, heard))
        finally:
            os.close(heard)
        status = self._child.wait()
        if self._child.stdin:
            self._child.stdin.close()
        return status

    def _follow(self, child: subprocess.Popen[bytes], watched: HeartbeatWatch) -> None:
        """Return once a process ends, or is killed for standing still."""
        if watched.heard(READY_S):
            log.info("%s is ready, pid %d", self.name, child.pid)
            self._ready = True
            self._settled.set()
            silent, why = watched.stands_still(), f"stood still for {SILENT_S:g} s"
        else:
            silent, why = child.poll() is None, f"was not ready in {READY_S:g} s"
        if silent and not self._stopping.is_set():
            log.error("%s, pid %d, %s and is killed", self.name, child.pid, why)
            child.kill()


def supervise(said: Mapping[str, Any]) -> None:
    """Serve by several processes until a signal ends them; the address is printed once all work.

    Parameters
    ----------
    said : mapping
        The options of `serve`.

    Raises
    ------
    WorkerFailedError
        If one of them cannot be started, or another server tends the data directory.
    OSError
        If the address is taken or not this machine's.
    """
    bound, address = bind_to(said["host"], said["port"])
    set_up(said["log_level"], said["log_format"])
    bound.listen(BACKLOG)
    workers = _workers(said, bound.fileno())
    ended = threading.Event()
    _heed_signals(ended, workers)
    try:
        for part in (workers[:1], workers[1:]):  # where the first is refused, nobody else begins
            for worker in part:
                worker.start()
            for worker in part:
                worker.wait_until_ready(ended)
        if not ended.is_set():
            print(f"wrenchbook serves {address}", flush=True)
        ended.wait()
    finally:
        _end(workers, bound)


def end_with_supervisor() -> None:
    """End this process, as at a signal, once the one that has started it is gone."""

    def read() -> None:
        while os.read(0, 4096):  # without Python's buffer, whose lock the interpreter's end needs
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=read, name="supervisor", daemon=True).start()


def _workers(said: Mapping[str, Any], listening: int) -> list[Worker]:
    told = json.dumps(dict(said), default=str)
    first = child_command("wrenchbook.service.workers.coordinator", told)
    workers = [Worker("the coordinator", first)]
    for number in range(1, said["processes"] + 1):
        words = child_command(
            "wrenchbook.service.workers.web_worker", told, str(number), str(listening)
        )
        workers.append(Worker(f"answering process {number}", words, [listening]))
    return workers


def _heed_signals(ended: threading.Event, workers: list[Worker]) -> None:
    """End all at the first signal, at once at a second one."""

    def heed(number: int, _: object) -> None:
        if ended.is_set():
            for worker in workers:
                worker.terminate()
            os._exit(128 + number)
        ended.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, heed)


def _end(workers: list[Worker], bound: socket.socket) -> None:
    """End those who answer, then the one who builds and solves."""
    for part in (workers[1:], workers[:1]):
        for worker in part:
            worker.terminate()
        # Who comes now is refused at once and can go elsewhere: in the queue of a socket that
        # nobody takes from they would wait for as long as all this ends.
        with contextlib.suppress(OSError):
            bound.shutdown(socket.SHUT_RDWR)
        for worker in part:
            worker.wait(STOP_S)
