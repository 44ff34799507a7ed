"""A module run as a program, behind the fence: a fresh interpreter that holds limits.

`fenced` forks a process that has imported little; what needs the finite elements starts anew.
"""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
import threading
from dataclasses import asdict, dataclass
from typing import Final

from service.files.child import child_command
from service.sandbox.errors import FenceBusyError, error_of
from service.sandbox.limits import MIB, Limits

AT_ONCE: Final = 2  # each may take a core and gigabytes
WAIT_S: Final = 60.0
MOST_PRINTED: Final = 16 * MIB
_GRACE_S: Final = 10.0
_places = threading.BoundedSemaphore(AT_ONCE)


@dataclass(frozen=True)
class Printed:
    """What a program has printed, and its exit status."""

    out: str
    err: str
    status: int


def program(module: str, *arguments: str, limits: Limits) -> Printed:
    """Run a module as a program within limits, and return what it printed.

    Raises
    ------
    FenceError
        If it took too long, or a signal ended it.
    FenceBusyError
        If as many programs run as may, for a minute.
    """
    if not _places.acquire(timeout=WAIT_S):
        raise FenceBusyError("Other files are being checked; send it again in a minute")
    try:
        return _run(module, arguments, limits)
    finally:
        _places.release()


def _run(module: str, arguments: tuple[str, ...], limits: Limits) -> Printed:
    words = child_command(
        "service.sandbox.enclosed", json.dumps(asdict(limits)), module, *arguments
    )
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=out, stderr=err)
        try:
            status = child.wait(limits.seconds + _GRACE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            status = -signal.SIGKILL
        if status < 0:
            raise error_of({"signal": -status}, limits)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read(MOST_PRINTED).decode(errors="replace"))
    return Printed(texts[0], texts[1], status)
