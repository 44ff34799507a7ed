"""The fork server: imports parsers once, and forks for each request.

A fork sets its resource limits before it opens the file. Run as a program with the number of its
connection's descriptor and the modules to import; it ends when the server closes the connection.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import importlib
import json
import math
import os
import resource
import signal
import sys
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NoReturn

from wrenchbook.service.sandbox.parts import Limits, write_parts

_OPEN_FILES: Final = 64  # pipes, the file, what an HDF5 or a zip opens in addition
_FIELDS: Final = {"done", "kind", "message", "errno", "traceback"}
_MOST_OUTCOME: Final = 64 * 1024  # bytes, what a pipe holds on Linux


def main(number: int, *modules: str) -> None:
    """Fork for each request that comes."""
    for module in modules:
        _imported(module)
    connection = Connection(number)
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            request = json.loads(connection.recv_bytes())
            connection.send_bytes(json.dumps(_outcome(request, connection)).encode())


@functools.cache
def _imported(module: str) -> ModuleType:
    """Return a module, imported and warmed up before the forks, so that it is done once."""
    found = importlib.import_module(module)
    getattr(found, "warm_up", lambda: None)()
    return found


def _outcome(request: dict[str, Any], connection: Connection) -> dict[str, Any]:
    """Fork for a request, and return how the fork has ended."""
    try:
        _imported(request["function"].partition(":")[0])
    except Exception as error:
        return _described(error)
    outcome, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        connection.close()
        _parse(request, theirs)
    os.close(theirs)
    status = os.waitpid(child, 0)[1]
    os.set_blocking(outcome, False)  # a fork of the fork may hold the other end open
    try:
        if os.WIFSIGNALED(status):
            return {"signal": os.WTERMSIG(status)}
        end = json.loads(os.read(outcome, _MOST_OUTCOME))
        return {key: end[key] for key in end.keys() & _FIELDS if isinstance(end[key], str | int)}
    except (OSError, ValueError, AttributeError, RecursionError):
        return {"signal": 0}
    finally:
        os.close(outcome)


def _parse(request: dict[str, Any], outcome: int) -> NoReturn:
    """Run the requested function within its limits, and end the process."""
    end: dict[str, Any] = {"done": True}
    try:
        os.dup2(1, 2)  # what a file makes a parser print is not for the server's log
        set_limits(Limits(**request["limits"]))
        module, _, name = request["function"].partition(":")
        file = () if request["file"] is None else (Path(request["file"]),)
        with Path(request["answer"]).open("wb") as answer:
            write_parts(answer, getattr(_imported(module), name)(*file, **request["arguments"]))
    except BaseException as error:
        end = _described(error)
    with contextlib.suppress(OSError):
        os.write(outcome, json.dumps(end).encode()[:_MOST_OUTCOME])
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
    """Limit this process and its children, for good.

    The kernel ends the process at the deadline, whatever code it runs then.
    """
    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_FSIZE, limits.output)
    _lower(resource.RLIMIT_NOFILE, _OPEN_FILES)
    _lower(resource.RLIMIT_CPU, math.ceil(limits.seconds))
    with contextlib.suppress(FileNotFoundError):  # no /proc on macOS
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        _lower(resource.RLIMIT_AS, pages * resource.getpagesize() + limits.memory)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM, signal.SIGXCPU})
    signal.setitimer(signal.ITIMER_REAL, limits.seconds)


def _lower(what: int, to: int) -> None:
    """Lower the soft and the hard limit."""
    hard = resource.getrlimit(what)[1]
    if hard != resource.RLIM_INFINITY:
        to = min(to, hard)
    # macOS refuses some limits; time, files and the deadline hold there all the same.
    with contextlib.suppress(*((ValueError, OSError) if sys.platform == "darwin" else ())):
        resource.setrlimit(what, (to, to))


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
