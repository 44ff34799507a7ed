"""The parent process of a server: uvicorn's supervisor of web workers, and of one builder.

It holds the listening socket, so that connections in its queue outlive a web worker, and imports
neither tables nor the ledger.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import signal
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from multiprocessing import forkserver
from multiprocessing.connection import wait
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from uvicorn import Config
from uvicorn.config import STARTUP_FAILURE
from uvicorn.importer import import_from_string
from uvicorn.supervisors import multiprocess

from wrenchbook.service.ops.logs import set_up
from wrenchbook.service.workers.listen import bind_to

log = logging.getLogger("wrenchbook.service.workers")

BUILDER: Final = "wrenchbook.service.workers.builder:Builder"
WEB_WORKER: Final = "wrenchbook.service.workers.web_worker:WebWorker"
# For an answer to a ping, and for the start of a web worker at SIGHUP: on a machine with ten times
# the work it can do, a thread waited for 3 s and a start took 20 s.
HEALTH_S: Final = 30
RETIRE: Final = signal.SIGUSR1  # to a web worker that is replaced: see `Server.retire`
STOP_S: Final = 30.0  # for a process to end after SIGTERM
LOOK_S: Final = 0.05  # between two looks at processes that start
_ENDS: Final = frozenset({signal.SIGINT, signal.SIGTERM})
# From SIGTERM until connections are refused: web workers take those that wait within 0.1 s.
REFUSE_AFTER_S: Final = 0.2


# Child processes are forked from one that has imported their modules: three seconds, once.
forks = multiprocessing.get_context("forkserver")


class WorkerFailedError(RuntimeError):
    """A process of the server could not start; its log says why."""


class Worker(multiprocess.Process):
    """A child process, which runs what `config.app` makes: `run(sockets)`, `started`.

    It ends at once with its parent, whatever ends that.
    """

    def __init__(self, config: Config, sockets: list[socket.socket]) -> None:
        super().__init__(config, sockets)
        self.process: Any = forks.Process(target=self.target, args=(sockets,))
        self._pinged_at: float | None = None  # while the answer to a ping of `is_alive` is due

    def target(self, sockets: list[socket.socket] | None = None) -> None:
        """Run in the child."""
        threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
        make: Any = self.config.app
        self._server = make()
        super().target(sockets)

    def is_alive(self, timeout: float = HEALTH_S) -> bool:
        """Return whether it runs, and has answered the last ping or has `timeout` left for that.

        Waits for nothing: a build can keep the builder from an answer for half a minute, and
        signals and ends of other processes cannot wait for that.
        """
        if not self.process.is_alive():
            return False
        with suppress(OSError, EOFError):
            while self.parent_conn.poll():
                self.parent_conn.recv()
                self._pinged_at = None
            if self._pinged_at is None:
                self.parent_conn.send(b"ping")
                self._pinged_at = time.monotonic()
            return time.monotonic() - self._pinged_at < timeout
        return False

    def _healthcheck(self, timeout: float) -> bool | None:
        """Return whether it has started; None if it does not answer a ping, or ends meanwhile."""
        with suppress(OSError, EOFError):
            self.parent_conn.send(b"ping")
            if self.parent_conn in wait([self.parent_conn, self.process.sentinel], timeout):
                return self.parent_conn.recv()
        return None


def _wait_for_end(worker: multiprocess.Process) -> None:
    """Return once a process has ended; kill it after `STOP_S`."""
    worker.process.join(STOP_S)
    if worker.exitcode is None:
        log.error("pid %s did not end in %g s and is killed", worker.pid, STOP_S)
        worker.process.kill()
        worker.process.join()


class Supervisor(multiprocess.Multiprocess):
    """Keeps the builder and the web workers running until SIGTERM or SIGINT.

    SIGHUP restarts the web workers one after the other.

    Parameters
    ----------
    builder, web : Config
        Of the two kinds of process.
    bound : socket
    ready : str
        The line that is printed once all processes have started.

    Attributes
    ----------
    failed : str
        Why the server ends without a signal; empty while it does not.
    """

    def __init__(self, builder: Config, web: Config, bound: socket.socket, ready: str) -> None:
        super().__init__(web, [bound])
        self._builder_config, self._ready = builder, ready
        self._builder = Worker(builder, [])
        self._retired: list[multiprocess.Process] = []  # replaced, and finishing their requests
        self.failed = ""

    def init_processes(self) -> None:
        """Start all processes, and print the address once all have started."""
        self._builder.start()
        super().init_processes()
        waiting = [self._builder, *self.processes]
        while waiting and not self.signal_queue:
            if any(not one.process.is_alive() for one in waiting):
                self._fail("a process of the server did not start; its log says why")
                return
            waiting = [one for one in waiting if not one.is_ready(LOOK_S)]
            time.sleep(LOOK_S)
        if not waiting:
            print(self._ready, flush=True)

    def keep_subprocess_alive(self) -> None:
        """Replace processes that have ended or do not answer a ping."""
        if self.should_exit.is_set():
            return
        self._retired = [worker for worker in self._retired if worker.process.is_alive()]
        super().keep_subprocess_alive()
        if self.should_exit.is_set():
            self._fail("a web worker could not be started again; its log says why")
        elif not self._builder.is_alive(HEALTH_S):
            self._builder.kill()
            self._builder.join()
            if self._builder.exitcode == STARTUP_FAILURE:
                self._fail("the builder could not be started again; its log says why")
                return
            log.error("the builder, pid %s, has ended; it is started again", self._builder.pid)
            self._builder = Worker(self._builder_config, [])
            self._builder.start()

    def handle_signals(self) -> None:
        """Handle each kind of signal once, however often it came, and an end before restarts."""
        count = len(self.signal_queue)
        signals = set(self.signal_queue[:count])
        del self.signal_queue[:count]  # handlers may append meanwhile
        if ends := signals & _ENDS:
            signals = ends
        self.signal_queue[:0] = signals
        super().handle_signals()

    def restart_all(self) -> None:
        """Replace the web workers; those before them finish their requests meanwhile."""
        ends: Any = SimpleNamespace(is_set=lambda: not _ENDS.isdisjoint(self.signal_queue))
        for index, worker in enumerate(self.processes):
            successor = Worker(self.config, self.sockets)
            successor.start()
            if not successor.wait_until_ready(HEALTH_S, ends):
                successor.kill()
                successor.join()
                if not ends.is_set():
                    log.error("a new web worker did not start in %d s; the rest stays", HEALTH_S)
                return
            self.processes[index] = successor
            assert worker.pid is not None
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.kill(worker.pid, RETIRE)
            self._retired.append(worker)

    def terminate_all(self) -> None:
        """End the web workers; a further signal ends all processes at once."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda number, _: os._exit(128 + number))
        super().terminate_all()
        for worker in self._retired:
            worker.terminate()
        time.sleep(REFUSE_AFTER_S)
        with suppress(OSError):  # a connection is refused, rather than left to wait for the end
            self.sockets[0].shutdown(socket.SHUT_RDWR)

    def join_all(self) -> None:
        """Return once the web workers, then the builder have ended."""
        for process in (*self.processes, *self._retired):
            _wait_for_end(process)
        self._builder.terminate()
        _wait_for_end(self._builder)

    def _fail(self, why: str) -> None:
        self.failed = why
        self.should_exit.set()


# uvicorn's supervisor has no parameter for the class of its processes.
multiprocess.Process = Worker


def supervise(options: Mapping[str, Any]) -> None:
    """Serve until SIGINT or SIGTERM; the address is printed once the server answers.

    At the first signal requests are finished and solves wait for the next start. A second one ends
    the processes at once, and leaves solvers running for the next start to find.

    Parameters
    ----------
    options : mapping
        Of `serve`.

    Raises
    ------
    WorkerFailedError
        If a process cannot be started, or another server uses the data directory.
    AddressError
        If the address is taken or not this machine's.
    """
    bound, address = bind_to(options["host"], options["port"])
    forks.set_forkserver_preload([name.split(":")[0] for name in (BUILDER, WEB_WORKER)])
    forkserver.ensure_running()
    level = options["log_level"]
    set_up(level, options["log_format"])
    builder, web = (
        Config(
            partial(_made, name, dict(options)),
            workers=options["processes"],
            timeout_worker_healthcheck=HEALTH_S,
            log_config=None,
            log_level=level,
        )
        for name in (BUILDER, WEB_WORKER)
    )
    ready = f"wrenchbook serves {address}"
    if options.get("as_json"):
        about = {"address": address, "data": str(options["data"]), "pid": os.getpid()}
        ready = json.dumps(about)
    supervisor = Supervisor(builder, web, bound, ready)
    supervisor.run()
    if supervisor.failed:
        raise WorkerFailedError(supervisor.failed)


def _made(name: str, options: Mapping[str, Any]) -> Any:
    """Return the server of a child process."""
    with suppress(OSError):  # Linux: the name of the process in ps and top
        Path("/proc/self/comm").write_text(f"wb-{name.rpartition(':')[2].lower()}")
    set_up(options["log_level"], options["log_format"])
    return import_from_string(name)(options)


def _end_with_parent() -> None:
    """End this process at once when its parent has ended; solvers go on until the next start."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
