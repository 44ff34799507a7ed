"""What happens behind the fence: a warm process that is forked for each file.

It has imported the readers, once. For each request a fork of it, the warden, forks the reader
itself, and tells how that ended. The reader holds its limits before it sees the file.

Run as a program with the number of its socket; it ends when the other side closes that.
"""

from __future__ import annotations

import array
import contextlib
import errno
import importlib
import json
import os
import select
import signal
import socket
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final, NoReturn

from service.sandbox.limits import Limits, hold
from service.sandbox.parts import REQUEST_LENGTH, Part, write_parts

_DESCRIPTORS: Final = 2  # where the answer goes, and where the warden tells how it ended
_MOST_TOLD: Final = 64 * 1024
_WARM: Final[set[str]] = set()  # the modules whose `warm_up` has been called
_GRACE_S: Final = 5.0  # after the deadline, before the warden ends the reader itself


def main(number: int) -> None:
    """Fork for each request that comes."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # wardens are nobody's zombies
    with socket.socket(fileno=number) as requests:
        while (request := _next(requests)) is not None:
            asked, descriptors = request
            asked["missing"] = _imported(asked["function"].partition(":")[0])
            if len(descriptors) == _DESCRIPTORS and os.fork() == 0:
                requests.close()
                _watch(asked, *descriptors)
            for descriptor in descriptors:
                os.close(descriptor)


def _next(requests: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Return the next request and its descriptors; None once there will be none."""
    room = socket.CMSG_SPACE(_DESCRIPTORS * array.array("i").itemsize)
    head, told, _, _ = requests.recvmsg(REQUEST_LENGTH.size, room)
    numbers = array.array("i")
    for level, kind, content in told:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
            numbers.frombytes(content)
    while 0 < len(head) < REQUEST_LENGTH.size:
        head += requests.recv(REQUEST_LENGTH.size - len(head))
    if not head:
        return None
    (length,), body = REQUEST_LENGTH.unpack(head), b""
    while len(body) < length:
        piece = requests.recv(length - len(body))
        if not piece:
            return None
        body += piece
    return json.loads(body), list(numbers)


def _imported(module: str) -> str:
    """Import the module of a request before the fork, so that it is done once."""
    try:
        found = importlib.import_module(module)
        if module not in _WARM:
            _WARM.add(module)
            getattr(found, "warm_up", lambda: None)()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def _watch(asked: dict[str, Any], answer: int, told: int) -> NoReturn:
    """Fork the reader, wait for its end, and tell of it."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    mine, its = os.pipe()
    reader = os.fork()
    if reader == 0:
        os.close(mine)
        os.close(told)
        _read(asked, answer, its)
    os.close(its)
    os.close(answer)
    said = _said(mine, asked["limits"]["seconds"] + _GRACE_S)
    if said is None:
        os.kill(reader, signal.SIGKILL)
    status = os.waitpid(reader, 0)[1]
    if os.WIFSIGNALED(status):
        ended: dict[str, Any] = {"signal": os.WTERMSIG(status)}
    else:
        ended = _parsed(said or b"")
    with contextlib.suppress(OSError):  # nobody waits for it any more
        os.write(told, json.dumps(ended).encode())
    os._exit(0)


def _said(pipe: int, seconds: float) -> bytes | None:
    """Return what the reader says, whole, or None if it neither ends nor says it."""
    said = b""
    while select.select([pipe], [], [], seconds)[0]:
        piece = os.read(pipe, _MOST_TOLD)
        if not piece:
            return said[:_MOST_TOLD]
        said = (said + piece)[: _MOST_TOLD + 1]
    return None


def _parsed(said: bytes) -> dict[str, Any]:
    try:
        return dict(json.loads(said))
    except (ValueError, TypeError):
        return {"signal": 0}


def _read(asked: dict[str, Any], answer: int, pipe: int) -> NoReturn:
    """Run the function that is asked for on the file, within its limits; never return."""
    said = _outcome(asked, answer)
    with contextlib.suppress(OSError):
        os.write(pipe, json.dumps(said).encode()[:_MOST_TOLD])
    os._exit(0)


def _outcome(asked: dict[str, Any], answer: int) -> dict[str, Any]:
    try:
        hold(Limits(**asked["limits"]))
        if asked["missing"]:
            raise ImportError(asked["missing"])
        _answer(asked, answer)
    except MemoryError:
        return {"kind": "MemoryError", "message": ""}
    except OSError as error:
        kind = "FileTooLarge" if error.errno == errno.EFBIG else "OSError"
        return {"kind": kind, "message": str(error.strerror or error)[:2000], "errno": error.errno}
    except Exception as error:
        seen = traceback.format_exc(limit=-6)[-4000:]
        return {"kind": type(error).__name__, "message": str(error)[:8000], "traceback": seen}
    return {"done": True}


def _answer(asked: dict[str, Any], answer: int) -> None:
    module, _, name = asked["function"].partition(":")
    function: Callable[..., Iterable[Part]] = getattr(sys.modules[module], name)
    file = asked["file"]
    where = () if file is None else (Path(file),)
    with open(answer, "wb", closefd=False) as written:
        write_parts(written, function(*where, **asked["arguments"]))


if __name__ == "__main__":
    main(int(sys.argv[1]))
