"""The server's side of the fence: send a file's name in, get parts or a named error out."""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import socket
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from service.files.child import child_command
from service.sandbox.errors import FenceBusyError, FenceCrashError, error_of
from service.sandbox.limits import Limits
from service.sandbox.parts import REQUEST_LENGTH, AnswerError, Part, read_parts

log = logging.getLogger(__name__)

# Files that are read at once: each may take a core and its memory.
AT_ONCE: Final = 2
WAIT_S: Final = 60.0
_GRACE_S: Final = 15.0  # the warden's own grace, twice, and what starting a child takes
_UNKNOWN_END: Final = {"signal": 0}
_FROM_PARENT: Final = {
    "OMP_NUM_THREADS": "1",  # a process with threads cannot be forked with a good conscience
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",
}


def fenced(
    function: str,
    file: Path | None = None,
    arguments: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
) -> list[Part]:
    """Run a function on a file in a child with limits, and return the parts it answers.

    It blocks: nothing for an event loop.

    Parameters
    ----------
    function : str
        ``module:name`` of a function in these rooms that takes the file's path and `arguments` and
        gives `Part`, one after the other. Its module is imported once; a ``warm_up()`` in it is
        called once as well.
    file : path, optional
        Given to it as first argument.
    arguments : mapping, optional
        What JSON holds, by name.
    limits : Limits, optional
        What it may take.

    Raises
    ------
    FenceError
        If the file takes too much, ends its reader, or the function raises.
    FenceBusyError
        If as many files are read as may be, for a minute.
    OSError
        If the disk is full or cannot be written.
    """
    limits = limits or Limits()
    asked = {
        "function": function,
        "file": None if file is None else str(file),
        "arguments": dict(arguments or {}),
        "limits": asdict(limits),
    }
    return _answered(asked, limits)


def _answered(asked: Mapping[str, Any], limits: Limits) -> list[Part]:
    """Send a request in once there is a place for it, and return its parts."""
    if not _places.acquire(timeout=WAIT_S):
        raise FenceBusyError("Other files are being read; send it again in a minute")
    try:
        with tempfile.TemporaryFile(prefix="wrenchbook-") as answer:
            told = _asked(asked, answer.fileno(), limits)
            if not told.get("done"):
                _note(asked["function"], told)
                raise error_of(told, limits)
            return read_parts(answer.fileno())
    except AnswerError as error:
        raise FenceCrashError(f"Its reader's answer cannot be used: {error}.") from error
    finally:
        _places.release()


def warm_up(*modules: str) -> None:
    """Start the process that children are forked of, and let it import modules meanwhile."""
    for module in modules:
        _zygote.send({"function": f"{module}:", "limits": {}}, [])


class _Zygote:
    """The warm process, started when it is first needed and again when it has died."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._of = 0

    def send(self, asked: Mapping[str, Any], descriptors: list[int]) -> None:
        """Send a request; a process that has died is replaced, once."""
        body = json.dumps(asked).encode()
        with self._lock:
            try:
                self._send(body, descriptors)
            except OSError:
                self.close()
                self._send(body, descriptors)

    def _send(self, body: bytes, descriptors: list[int]) -> None:
        if self._socket is None or self._of != os.getpid():
            self._start()
        assert self._socket is not None
        socket.send_fds(self._socket, [REQUEST_LENGTH.pack(len(body))], descriptors)
        self._socket.sendall(body)

    def _start(self) -> None:
        mine, its = socket.socketpair()
        with its:
            self._child = subprocess.Popen(
                child_command("service.sandbox.child", str(its.fileno())),
                pass_fds=[its.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=os.environ | _FROM_PARENT,
                start_new_session=True,  # a Ctrl-C is the server's to hear
            )
        self._socket, self._of = mine, os.getpid()

    def close(self) -> None:
        """Let the process end."""
        if self._socket is not None:
            self._socket.close()
        if self._child is not None and self._of == os.getpid():
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.wait(_GRACE_S)
        self._socket = self._child = None


_zygote = _Zygote()
_places = threading.BoundedSemaphore(AT_ONCE)
atexit.register(_zygote.close)


def _asked(asked: Mapping[str, Any], answer: int, limits: Limits) -> dict[str, Any]:
    """Send a request in, and return how its child has ended.

    Nothing is told of a request that was lost with the warm process; it is sent once more.
    """
    said = _exchanged(asked, answer, limits)
    if not said:
        os.ftruncate(answer, 0)
        os.lseek(answer, 0, os.SEEK_SET)
        said = _exchanged(asked, answer, limits)
    try:
        return dict(json.loads(said))
    except ValueError:
        return dict(_UNKNOWN_END)


def _exchanged(asked: Mapping[str, Any], answer: int, limits: Limits) -> bytes:
    """Send a request in, and return what its warden says: nothing if it died before it could."""
    mine, its = socket.socketpair()
    with mine:
        with its:
            _zygote.send(asked, [answer, its.fileno()])
        mine.settimeout(limits.seconds + _GRACE_S)
        said = b""
        try:
            while piece := mine.recv(65536):
                said += piece
        except TimeoutError:
            return json.dumps(_UNKNOWN_END).encode()  # at work, and not again for as long
    return said


def _note(function: str, told: Mapping[str, Any]) -> None:
    """Put into the log what is for no reply."""
    if seen := told.get("traceback"):
        log.info("%s refused a file:\n%s", function, seen)
