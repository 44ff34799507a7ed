"""The parent process of a server, which keeps one builder and the web workers running.

It holds the listening socket, so that queued connections outlive a web worker, and imports neither
tables nor the ledger. uvicorn's `Multiprocess` has a single kind of process, ends replaced web
workers during an import of minutes, and waits for each answer to a ping.
"""

from __future__ import annotations

import errno
import json
import logging
import multiprocessing
import os
import shutil
import signal
import socket
import threading
import time
from contextlib import suppress
from multiprocessing import forkserver
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Final, NamedTuple

from uvicorn.config import STARTUP_FAILURE
from uvicorn.importer import import_from_string

from wrenchbook.service.files.lock import is_locked, take
from wrenchbook.service.ops.logs import set_up
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED

log = logging.getLogger("wrenchbook.service.workers")


class Kind(NamedTuple):
    """A kind of process."""

    name: str  # in ps and top
    function: str  # ``module:name``, called with settings, the event `started`, and sockets


BUILDER: Final = Kind("wb-builder", "wrenchbook.service.workers.builder:run")
WEB_WORKER: Final = Kind("wb-webworker", "wrenchbook.service.workers.web_worker:run")
FOLLOWER: Final = Kind("wb-follower", "wrenchbook.service.workers.follower:run")
COPIER: Final = Kind("wb-copier", "wrenchbook.service.workers.copier:run")
HEARTBEAT_S: Final = 0.25
# Time without a heartbeat, and for the start of a web worker at SIGHUP, after which the process is
# killed. On a machine with ten times its load a thread waited for 3 s, and a start took 20 s.
HEALTH_S: Final = 30.0
RETIRE: Final = signal.SIGUSR1  # sent to a web worker that is replaced: see `Server.retire`
STOP_S: Final = 30.0  # time to end after SIGTERM, before SIGKILL
POLL_S: Final = 0.1  # pause between checks of signals and heartbeats; the end of a process wakes it
IN_USE: Final = (
    "the data directory {} is in use by {}; call that server with --server, stop it, or name "
    "another directory with --data"
)
_REMEDIES: Final = {  # by the error of a bind
    errno.EADDRINUSE: "stop the program that uses the port, or take a free one with --port 0",
    errno.EADDRNOTAVAIL: "give an address of this machine with --host, or 0.0.0.0 for all",
    errno.EACCES: "give a port above 1023 with --port",
}
_LOCK: Final = "supervisor.lock"  # its content: address and pid of the server
_ENDS: Final = frozenset({signal.SIGINT, signal.SIGTERM})
# Time from SIGTERM until connections are refused: web workers accept the waiting ones within 0.1 s.
REFUSE_AFTER_S: Final = 0.2

# Child processes are forked from a server that has imported their modules, which takes 3 s once.
forks = multiprocessing.get_context("forkserver")


class AddressError(OSError):
    """A server cannot listen on its address."""


class WorkerFailedError(RuntimeError):
    """The server cannot start: one of its processes did not, or another server has its data."""


class Child:
    """A child process, which ends with its parent.

    `started`: whether it had started at its last heartbeat.
    `begun`: when it was created, monotonic s.
    """

    def __init__(self, kind: Kind, settings: Settings, *sockets: Any) -> None:
        self._heartbeats, end = forks.Pipe(duplex=False)
        self.process = forks.Process(target=_run, args=(kind, settings, end, *sockets))
        self.process.start()
        end.close()
        self.name = kind.name
        self.started = False
        self.begun = time.monotonic()
        self._last_heartbeat = self.begun

    def is_healthy(self) -> bool:
        """Return whether it runs and has sent a heartbeat within `HEALTH_S`; never blocks."""
        with suppress(OSError, EOFError):
            while self._heartbeats.poll():
                self.started = self._heartbeats.recv()
                self._last_heartbeat = time.monotonic()
        return self.process.is_alive() and time.monotonic() - self._last_heartbeat < HEALTH_S

    def send(self, number: int) -> None:
        """Send a signal to the process, unless it has ended."""
        if self.process.is_alive():
            with suppress(ProcessLookupError):
                os.kill(self.process.pid or 0, number)

    def join(self) -> None:
        """Return once the process has ended; kill it after `STOP_S`."""
        self.process.join(STOP_S)
        if self.process.exitcode is None:
            log.error("pid %s did not end in %g s and is killed", self.process.pid, STOP_S)
            self.kill()

    def kill(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.join()


def _run(kind: Kind, settings: Settings, end: Connection, *sockets: socket.socket) -> None:
    """Run in a child process; end it with its parent, without the solvers."""
    started = threading.Event()

    def heartbeat() -> None:
        parent = multiprocessing.parent_process()
        assert parent is not None
        with suppress(OSError):
            while parent.is_alive():
                end.send(started.is_set())
                parent.join(HEARTBEAT_S)
        os._exit(1)

    threading.Thread(target=heartbeat, name="heartbeat", daemon=True).start()
    with suppress(OSError):  # Linux: the name of the process in ps and top
        Path("/proc/self/comm").write_text(kind.name)
    set_up(settings.log_level, settings.log_format)
    import_from_string(kind.function)(settings, started, *sockets)


class Supervisor:
    """Keeps the builder, web workers and the copier, if any, running until SIGTERM or SIGINT.

    SIGHUP replaces the web workers, each once its successor has started.

    `ready`: printed once the builder and all web workers have started.
    `failed`: why the server ends without a signal; empty as long as it does not.
    """

    def __init__(self, settings: Settings, bound: socket.socket, ready: str) -> None:
        self._settings = settings
        self._bound = bound
        self._ready = ready
        self._signals: list[int] = []
        self._builder = self._start(_builder_kind(settings))
        self._copiers = [self._start(kind) for kind in _copier_kinds(settings)]
        self._web = [self._start(WEB_WORKER) for _ in range(settings.processes)]
        self._to_replace = 0  # number of web workers that a restart has not replaced yet
        self._successor: Child | None = None
        self._retired: list[Child] = []  # replaced web workers that finish their requests
        self.failed = ""

    def run(self) -> None:
        """Run until a signal or a failure ends the server: web workers first, then the builder.

        A second signal ends all processes at once.
        """
        for number in (*_ENDS, signal.SIGHUP):
            signal.signal(number, lambda number, _: self._signals.append(number))
        while not self.failed and _ENDS.isdisjoint(self._signals):
            self.check()
            wait([child.process.sentinel for child in (self._builder, *self._web)], POLL_S)
        for number in _ENDS:
            signal.signal(number, lambda number, _: os._exit(128 + number))
        # Web workers end after their open requests; further connections are refused.
        web = [*self._web, *self._retired, *([self._successor] if self._successor else [])]
        for child in web:
            child.send(signal.SIGTERM)
        time.sleep(REFUSE_AFTER_S)
        with suppress(OSError):  # otherwise new connections would wait in the queue
            self._bound.shutdown(socket.SHUT_RDWR)
        for child in web:
            child.join()
        for child in (self._builder, *self._copiers):  # a copier ships the builder's last rows
            child.send(signal.SIGTERM)
            child.join()

    def check(self) -> None:
        """Print once that the server is ready; from then on restart processes that have ended."""
        children = self._builder, *self._web
        if not self._ready:
            self._retired = [child for child in self._retired if child.process.is_alive()]
            self._builder = self._living(self._builder, _builder_kind(self._settings))
            self._copiers = [self._living(child, COPIER) for child in self._copiers]
            self._web = [self._living(child, WEB_WORKER) for child in self._web]
            self._replace()
        elif not all(child.is_healthy() for child in children):
            self.failed = "a process of the server did not start; its log says why"
        elif all(child.started for child in children):
            print(self._ready, flush=True)
            self._ready = ""

    def _start(self, kind: Kind) -> Child:
        sockets = (self._bound,) if kind == WEB_WORKER else ()
        return Child(kind, self._settings, *sockets)

    def _living(self, child: Child, kind: Kind) -> Child:
        """Return a process, or a new one if it has ended or sends no heartbeat."""
        if child.is_healthy() or self.failed:
            return child
        child.kill()
        if child.process.exitcode == STARTUP_FAILURE:  # a new one would fail too
            self.failed = f"{child.name} could not be started again; its log says why"
            return child
        log.error("%s, pid %s, has ended; it is started again", child.name, child.process.pid)
        return self._start(kind)

    def _replace(self) -> None:
        """Continue a restart, or begin one if a SIGHUP has come; several count as one."""
        if not self._to_replace and signal.SIGHUP in self._signals:
            while signal.SIGHUP in self._signals:
                self._signals.remove(signal.SIGHUP)
            self._to_replace = len(self._web)
        if not self._to_replace:
            return
        new = self._successor = self._successor or self._start(WEB_WORKER)
        if new.is_healthy() and new.started:
            index = len(self._web) - self._to_replace
            self._web[index].send(RETIRE)
            self._retired.append(self._web[index])
            self._web[index] = new
            self._successor = None
            self._to_replace -= 1
        elif not new.is_healthy() or time.monotonic() - new.begun > HEALTH_S:
            new.kill()
            log.error("a new web worker did not start in %d s; the others stay", HEALTH_S)
            self._successor = None
            self._to_replace = 0


def _builder_kind(settings: Settings) -> Kind:
    return FOLLOWER if settings.read_only else BUILDER


def _copier_kinds(settings: Settings) -> list[Kind]:
    return [COPIER] if settings.replicate or settings.backup_every else []


def bind_to(host: str, port: int) -> tuple[socket.socket, str]:
    """Return a socket bound to an address, not listening yet, and its URL; port 0 takes a free one.

    Raises AddressError if the address is in use or not this machine's.
    """
    shown = f"[{host}]" if ":" in host else host
    bound = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        remedy = _REMEDIES.get(error.errno or 0, "give another address with --host and --port")
        raise AddressError(f"{shown}:{port}: {error.strerror}; {remedy}") from error
    return bound, f"http://{shown}:{bound.getsockname()[1]}"


def in_use(data: Path) -> str:
    """Return the message on a data directory that a server uses; empty if none does."""
    path = data / SHARED / _LOCK
    return IN_USE.format(data, path.read_text() or "another server") if is_locked(path) else ""


def supervise(settings: Settings, *, as_json: bool = False) -> None:
    """Serve; the address is printed once the server answers.

    At the first SIGINT or SIGTERM requests are finished and solves wait for the next start. A
    second one ends the processes at once; solvers continue, and the next start adopts them.

    Raises AddressError if the server cannot listen, WorkerFailedError if a process cannot be
    started or another server uses the data directory.
    """
    # First, so that a port in use changes nothing.
    bound, address = bind_to(settings.host, settings.port)
    shared = settings.data / SHARED
    shared.mkdir(exist_ok=True)
    lock = take(shared / _LOCK)  # held until this process ends
    if lock is None:
        raise WorkerFailedError(in_use(settings.data))
    os.truncate(lock, 0)
    os.write(lock, f"the server at {address} (process {os.getpid()})".encode())
    for path in shared.iterdir():  # counts and rates of an earlier server
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
    kinds = [WEB_WORKER, _builder_kind(settings), *_copier_kinds(settings)]
    forks.set_forkserver_preload([kind.function.partition(":")[0] for kind in kinds])
    forkserver.ensure_running()
    set_up(settings.log_level, settings.log_format)
    ready = f"wrenchbook serves {address}"
    if as_json:
        ready = json.dumps({"address": address, "data": str(settings.data), "pid": os.getpid()})
    supervisor = Supervisor(settings, bound, ready)
    supervisor.run()
    if supervisor.failed:
        raise WorkerFailedError(supervisor.failed)
