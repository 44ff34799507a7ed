"""The sandbox of parsers of untrusted files: processes with limits on memory, time and files.

A fork server imports parsers once, and forks for each request; a fork sets its limits before it
opens the file. It returns JSON and plain arrays in a file of bounded size, never a pickle: at worst
its numbers are wrong.

The fork server is not that of `multiprocessing`, whose processes first run the caller's main module
again: half a second for the command line, while a fork takes 20 ms.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import functools
import importlib
import json
import logging
import math
import mmap
import os
import queue
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO, Final, NoReturn

import numpy as np
import orjson
from numpy.lib import format as npy

log = logging.getLogger(__name__)

MIB: Final = 1 << 20
AT_ONCE: Final = 2  # parsers at once: each file may take a core and its memory
WAIT_S: Final = 60.0  # wait for a free place
# Wall time allowed per second of processor time: a busy machine must not refuse a good file.
ELAPSED: Final = 10.0
GRACE_S: Final = 15.0  # addition to a parser's own deadline: imports and the fork on a busy machine
_OPEN_FILES: Final = 64  # pipes, the file, and further files that an HDF5 or a zip opens
_DISK_ERRORS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
MAX_HEAD: Final = 256 * MIB  # bytes of a part's JSON: the notes and names of a million rows
MAX_PARTS: Final = 100_000
_KINDS: Final = {  # kinds of errors by the signal that ended the parser; any other is a crash
    signal.SIGPROF: "time",
    signal.SIGXCPU: "time",
    signal.SIGALRM: "elapsed",
    signal.SIGKILL: "killed",
}
_MESSAGES: Final = {
    "memory": "Reading it needs more than {memory} MiB of memory, the limit for a file; make it "
    "smaller or send parts.",
    "time": "Reading it needs more than {seconds:g} s of processor time, the limit for a file; "
    "make it smaller or send parts.",
    "elapsed": "Reading it took more than {elapsed:g} s; send it again when the server is less "
    "busy, or send parts.",
    "killed": "The system ended its reader, most likely because the machine had no memory left; "
    "send it again when the server is less busy, or send parts.",
    "size": "Its contents exceed {output} MiB; send it in parts.",
    "crash": "Its reader stopped without an answer (signal {number}), because the file is damaged "
    "or malicious. Write it again with another program.",
}
_ONE_THREAD: Final = {  # forking a multi-threaded process can deadlock
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",
}


@dataclass(frozen=True)
class Limits:
    """Resource limits of one file.

    `memory`: bytes in addition to the process's own at its start: a million rows of a table with
    tangents are 350 MB, with at most two copies at a time. `seconds`: processor time, with
    `ELAPSED` times as much wall time; `output`: bytes of each file that the process writes,
    including its result.
    """

    memory: int = 1024 * MIB
    seconds: float = 60.0
    output: int = 1024 * MIB


class SandboxError(ValueError):
    """A file that cannot be read within its limits; nothing was changed.

    `kind` is ``memory`` (the limit's or the machine's), ``time`` (of the processor), ``elapsed``,
    ``size`` (of its content), ``crash`` (the parser died or its result is malformed), or the name
    of the exception that the parser raised.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class SandboxBusyError(RuntimeError):
    """No place became free within a minute."""


@dataclass(frozen=True)
class Part:
    """JSON fields, and arrays of plain numbers by name.

    The arrays of a result are read-only views of its file; their pages are read on first use.
    """

    fields: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


class Sandbox:
    """Runs parsers, `AT_ONCE` at a time, each in a process forked for one file.

    With `keep` the processes that have imported the parsers stay for the next file. A fork takes 20
    ms, the imports a second.
    """

    def __init__(self, *, keep: bool = True) -> None:
        self._keep = keep
        # The last freed one is used first, so that a second one only starts for simultaneous files.
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

        It blocks: do not call it in an event loop. `function` is ``module:name`` of a function that
        takes the file's path and `arguments` (JSON values) and yields `Part`. Its module is
        imported once in the fork server, which then calls its ``warm_up()`` if there is one.

        Raises SandboxError if the file exceeds a limit or the parser fails, SandboxBusyError if no
        place becomes free within a minute, and OSError if the disk is full or cannot be written.
        """
        limits = limits or Limits()
        with self.place() as server, tempfile.NamedTemporaryFile(prefix="wrenchbook-") as answer:
            names = {"function": function, "file": file and str(file), "answer": answer.name}
            request = {**names, "arguments": dict(arguments or {}), "limits": asdict(limits)}
            status = server.send(request, ELAPSED * limits.seconds + GRACE_S)
            code = None if status is None else os.waitstatus_to_exitcode(status)
            if code in _DISK_ERRORS:
                raise OSError(code, os.strerror(code))
            parts: list[Part] = []
            if code is None:
                end: dict[str, Any] = {"kind": "elapsed"}
            elif code == 0:
                parts, end = _read(answer.fileno())
            else:
                end = {"signal": -code}
            if end:
                log.info("%s refused a file: %s", function, end.get("traceback", end))
                raise _error(end, limits)
            return parts

    def warm_up(self, *modules: str) -> None:
        """Start a fork server that imports these modules in the background."""
        with self.place() as server:
            server.start(*modules)

    def close(self) -> None:
        """End the fork servers that are free."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._free.get_nowait().close()

    @contextlib.contextmanager
    def place(self) -> Iterator[_ForkServer]:
        """Yield a fork server, once one is free within a minute."""
        try:
            server = self._free.get(timeout=WAIT_S)
        except queue.Empty:
            why = f"{AT_ONCE} other files, the limit, are still being read after {WAIT_S:g} s"
            raise SandboxBusyError(why + "; send this file again in a minute") from None
        try:
            yield server
        finally:
            if not self._keep:
                server.close()
            self._free.put(server)


class _ForkServer:
    """A fork server and the connection to it; started when it is first needed."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    def start(self, *modules: str) -> Connection:
        """Return the connection to the process, started with some modules if none runs."""
        if self._connection is None:
            self._connection, theirs = Pipe()
            code = f"from {__name__} import serve; serve(*__import__('sys').argv[1:])"
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-c", code, str(theirs.fileno()), *modules],
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    env=os.environ | _ONE_THREAD | {"TMPDIR": tempfile.gettempdir()},
                    start_new_session=True,  # Ctrl-C is for the server
                )
        return self._connection

    def send(self, request: Mapping[str, Any], seconds: float) -> int | None:
        """Send a request, and return the wait status of its fork; None after so many seconds.

        A request that was lost with a killed fork server is sent once more, to a new one.
        """
        content = json.dumps(request).encode()
        for _ in range(2):
            connection = self.start()
            try:
                connection.send_bytes(content)
                if connection.poll(seconds):
                    return int(connection.recv_bytes())
            except (EOFError, OSError):
                self.close()
            except BaseException:  # the child's reply would be taken for that of the next request
                self.close()
                raise
            else:
                self.close()
                return None
        return int(signal.SIGKILL)

    def close(self) -> None:
        """End the process and its children."""
        if self._connection is not None and self._process is not None:
            self._connection.close()
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._connection = self._process = None


def _error(end: Mapping[str, Any], limits: Limits) -> Exception:
    """Return the error for a process's end: ``kind`` and ``message``, or the ``signal``."""
    kind = str(end.get("kind"))
    message = str(end.get("message"))
    number = end.get("signal")
    if kind == "OSError" and isinstance(end.get("errno"), int):
        return OSError(end["errno"], message)
    if number is not None:
        kind = _KINDS.get(number, "crash")
    text = _MESSAGES.get(kind)
    if text is None:
        return SandboxError(kind, message)
    limit = {"memory": limits.memory >> 20, "output": limits.output >> 20}
    limit |= {"seconds": limits.seconds, "elapsed": ELAPSED * limits.seconds}
    return SandboxError("memory" if kind == "killed" else kind, text.format(number=number, **limit))


# -- the file of a result: for each part an array of its head (JSON), then its arrays ----------


def _write(file: BinaryIO, head: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    text = orjson.dumps({**head, "arrays": list(arrays)})
    for array in (np.frombuffer(text, np.uint8), *map(np.ascontiguousarray, arrays.values())):
        npy.write_array_header_1_0(file, npy.header_data_from_array_1_0(array))
        file.write(array.data if array.size else b"")  # np.save's errors have no number


def _read(descriptor: int) -> tuple[list[Part], dict[str, Any]]:
    """Return the parts of a result, and its end if it is an error."""
    parts: list[Part] = []
    if not os.fstat(descriptor).st_size:
        return parts, {"signal": 0}
    content = mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
    try:
        while len(parts) < MAX_PARTS:
            text = _read_array(content)
            head = orjson.loads(text.tobytes() if text.nbytes <= MAX_HEAD else b"")
            if "end" in head:
                return parts, dict(head["end"])
            arrays = {str(name): _read_array(content) for name in head["arrays"]}
            parts.append(Part(dict(head["fields"]), arrays))
        raise SandboxError(
            "crash",
            f"The file has more than {MAX_PARTS} blocks of rows, the limit; send it in parts.",
        )
    except SandboxError:
        raise
    except (ValueError, KeyError, TypeError, OverflowError) as error:  # of a length beyond 2^63
        raise SandboxError(
            "crash",
            "The file's reader gave no valid result. Write the file again with another program.",
        ) from error


def _read_array(content: mmap.mmap) -> np.ndarray:
    """Read the next array in .npy format, without pickles.

    Raises ValueError if its type or shape is not a number array's.
    """
    file: Any = content
    npy.read_magic(file)
    shape, _, dtype = npy.read_array_header_1_0(file)
    if dtype.kind not in "fiub" or min(shape, default=0) < 0:
        raise ValueError("an array is of no known type or shape")
    count = math.prod(shape)
    array = np.frombuffer(content, dtype, count, content.tell()) if count else np.empty(0, dtype)
    content.seek(array.nbytes, os.SEEK_CUR)
    return array.reshape(shape)


# -- in the fork server -----------------------------------------------------------------------


def serve(number: str, *modules: str) -> None:
    """Import modules, then fork for each request on the connection with that number."""
    for module in modules:
        _imported(module)
    connection = Connection(int(number))
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            request = json.loads(connection.recv_bytes())
            with contextlib.suppress(Exception):  # the fork has the same error
                _imported(request["function"].partition(":")[0])
            child = os.fork()
            if child == 0:
                connection.close()
                _parse(request)
            connection.send_bytes(b"%d" % os.waitpid(child, 0)[1])


@functools.cache
def _imported(module: str) -> ModuleType:
    """Return a module, imported and warmed up once before the forks."""
    loaded = importlib.import_module(module)
    getattr(loaded, "warm_up", lambda: None)()
    return loaded


def _parse(request: dict[str, Any]) -> NoReturn:
    """Run the requested function within its limits, and end the process."""
    try:
        try:
            os.dup2(1, 2)  # the output of a parser on a file is not for the server's log
            set_limits(Limits(**request["limits"]))
            module, _, name = request["function"].partition(":")
            file = () if request["file"] is None else (Path(request["file"]),)
            with Path(request["answer"]).open("wb") as answer:
                for part in getattr(_imported(module), name)(*file, **request["arguments"]):
                    _write(answer, {"fields": part.fields}, part.arrays)
                _write(answer, {"end": {}}, {})
        except BaseException as error:
            with Path(request["answer"]).open("wb") as answer:
                _write(answer, {"end": _described(error)}, {})
    except OSError as error:
        os._exit(error.errno or errno.EIO)
    os._exit(0)


def _described(error: BaseException) -> dict[str, Any]:
    """Return an exception as JSON values."""
    if isinstance(error, MemoryError):
        return {"kind": "memory"}
    if isinstance(error, OSError):
        kind = "size" if error.errno == errno.EFBIG else "OSError"
        return {"kind": kind, "message": str(error.strerror or error)[:2000], "errno": error.errno}
    trace = "".join(traceback.format_exception(error, limit=-6))[-4000:]
    return {"kind": type(error).__name__, "message": str(error)[:4000], "traceback": trace}


def set_limits(limits: Limits) -> None:
    """Limit this process and its children permanently.

    The kernel ends the process at the deadline, in any code.
    """
    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_FSIZE, limits.output)
    _lower(resource.RLIMIT_NOFILE, _OPEN_FILES)
    _lower(resource.RLIMIT_CPU, math.ceil(limits.seconds) + 1)  # after SIGPROF: it kills
    with contextlib.suppress(FileNotFoundError):  # no /proc on macOS
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        _lower(resource.RLIMIT_AS, pages * resource.getpagesize() + limits.memory)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, limits.seconds)
    signal.setitimer(signal.ITIMER_REAL, ELAPSED * limits.seconds)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _KINDS)


def _lower(limit: int, to: int) -> None:
    """Lower the soft and the hard limit."""
    hard = resource.getrlimit(limit)[1]
    if hard != resource.RLIM_INFINITY:
        to = min(to, hard)
    # macOS refuses some limits; those of time, files and the deadline work there too.
    with contextlib.suppress(*((ValueError, OSError) if sys.platform == "darwin" else ())):
        resource.setrlimit(limit, (to, to))


_default: Final = Sandbox()
run: Final = _default.run
warm_up: Final = _default.warm_up
