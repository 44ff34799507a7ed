"""The server's side: starts fork servers, sends them requests and checks the results.

The fork servers are not those of `multiprocessing`: these import the modules of this project
whatever PYTHONPATH holds, run with one thread, and never run the caller's main module again.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import queue
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from wrenchbook.service.files.program import child_command
from wrenchbook.service.sandbox.parts import (
    Limits,
    Part,
    SandboxBusyError,
    SandboxError,
    read_parts,
)

log = logging.getLogger(__name__)

AT_ONCE: Final = 2  # each file may take a core and its memory
WAIT_S: Final = 60.0  # for a free place
GRACE_S: Final = 15.0  # after a parser's own time limit: imports and the fork on a busy machine
_TIMEOUTS: Final = (signal.SIGALRM, signal.SIGXCPU, signal.SIGKILL)
_MESSAGES: Final = {
    "memory": "Reading it takes more than {memory} MiB of memory, which is what one file may take; "
    "make it smaller or send parts.",
    "time": "Reading it takes longer than {seconds:g} s, which is what one file may take; "
    "make it smaller or send parts.",
    "size": "What it holds is more than {output} MiB; send parts of it.",
    "crash": "Its reader ended without an answer (signal {number}): the file is damaged, or made "
    "to do that. Write it anew with another program.",
}
_ONE_THREAD: Final = {  # forking a multi-threaded process can deadlock
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",
}


class Sandbox:
    """Runs parsers, `AT_ONCE` at a time, each in a process forked for one file.

    Parameters
    ----------
    keep : bool
        Whether the processes that have imported the parsers stay for the next file. A fork takes
        20 ms, the imports a second.
    """

    def __init__(self, *, keep: bool = True) -> None:
        self._keep = keep
        # The last one that was free is taken first: a second one starts only if two files meet.
        self._free: queue.LifoQueue[_ForkServer] = queue.LifoQueue()
        for _ in range(AT_ONCE):
            self._free.put(_ForkServer())
        atexit.register(self.close)

    def run(
        self,
        function: str,
        file: Path | None = None,
        arguments: Mapping[str, Any] | None = None,
        limits: Limits | None = None,
    ) -> list[Part]:
        """Run a parser on an untrusted file in a subprocess with resource limits; return its parts.

        It blocks, so it is not for an event loop.

        Parameters
        ----------
        function : str
            ``module:name`` of a function that takes the file's path and `arguments` and yields
            `Part`. Its module is imported once in the fork server, which then calls the module's
            ``warm_up()`` if there is one.
        file : path, optional
            First argument of the function.
        arguments : mapping, optional
            Keyword arguments of the function; JSON values.
        limits : Limits, optional

        Raises
        ------
        SandboxError
            If the file exceeds a limit or the parser fails.
        SandboxBusyError
            If no place becomes free within a minute.
        OSError
            If the disk is full or cannot be written.
        """
        limits = limits or Limits()
        with self.place() as server, tempfile.NamedTemporaryFile(prefix="wrenchbook-") as answer:
            names = {"function": function, "file": file and str(file), "answer": answer.name}
            request = {**names, "arguments": dict(arguments or {}), "limits": asdict(limits)}
            end = server.send(request, limits.seconds + GRACE_S)
            if end.get("done") is not True:
                log.info("%s refused a file: %s", function, end.get("traceback", end))
                raise _error(end, limits)
            return read_parts(answer.fileno())

    def warm_up(self, *modules: str) -> None:
        """Start a fork server, which imports these modules while the caller goes on."""
        with self.place() as server:
            server.start(*modules)

    def close(self) -> None:
        """End the fork servers that are free."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._free.get_nowait().close()

    @contextlib.contextmanager
    def place(self) -> Iterator[_ForkServer]:
        """Take a fork server, once one is free within a minute."""
        try:
            server = self._free.get(timeout=WAIT_S)
        except queue.Empty:
            message = "Other files are being read; send it again in a minute"
            raise SandboxBusyError(message) from None
        try:
            yield server
        finally:
            if not self._keep:
                server.close()
            self._free.put(server)


class _ForkServer:
    """A process that has imported parsers, and forks for each request; see `child`."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    def start(self, *modules: str) -> Connection:
        """Return the connection to the process, started with some modules if none runs."""
        if self._connection is None:
            self._connection, theirs = Pipe()
            with theirs:
                self.process = subprocess.Popen(
                    child_command(
                        "wrenchbook.service.sandbox.child", str(theirs.fileno()), *modules
                    ),
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    env=os.environ | _ONE_THREAD | {"TMPDIR": tempfile.gettempdir()},
                    start_new_session=True,  # Ctrl-C is for the server
                )
        return self._connection

    def send(self, request: Mapping[str, Any], seconds: float) -> dict[str, Any]:
        """Send a request, and return how its child has ended.

        A request that was lost with a killed fork server is sent once more, to a new one.
        """
        content = json.dumps(request).encode()
        for _ in range(2):
            connection = self.start()
            try:
                connection.send_bytes(content)
                if connection.poll(seconds):
                    return json.loads(connection.recv_bytes())
            except (EOFError, OSError):
                self.close()
            except BaseException:  # its reply would be taken for that of the next request
                self.close()
                raise
            else:
                self.close()
                return {"signal": signal.SIGKILL}
        return {"signal": 0}

    def close(self) -> None:
        """End the process and its children."""
        if self._connection is not None and self.process is not None:
            self._connection.close()
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        self._connection = self.process = None


def _error(end: Mapping[str, Any], limits: Limits) -> Exception:
    """Return the error for a child's end: ``kind`` and ``message``, or the ``signal``."""
    kind, message, number = str(end.get("kind")), str(end.get("message")), end.get("signal")
    if kind == "OSError" and isinstance(end.get("errno"), int):
        return OSError(end["errno"], message)
    if number is not None:
        kind = "time" if number in _TIMEOUTS else "crash"
    text = _MESSAGES.get(kind)
    if text is None:
        return SandboxError(kind, message)
    most = {"memory": limits.memory >> 20, "output": limits.output >> 20}
    return SandboxError(kind, text.format(seconds=limits.seconds, number=number, **most))


_default: Final = Sandbox()
run: Final = _default.run
warm_up: Final = _default.warm_up
