"""What can go wrong with a file that is read behind the fence, each by its name."""

from __future__ import annotations

import signal
from typing import Any, Final

from service.sandbox.limits import Limits

_TOO_LONG: Final = (signal.SIGALRM, signal.SIGXCPU)


class FenceError(ValueError):
    """A file could not be read within its limits; nothing was changed."""


class FenceMemoryError(FenceError):
    """Reading it needs more memory than it may take."""


class FenceTimeError(FenceError):
    """Reading it takes longer than it may."""


class FenceSizeError(FenceError):
    """What it holds is larger than it may be."""


class FenceCrashError(FenceError):
    """Its reader died of it."""


class FenceBusyError(RuntimeError):
    """As many files are read as may be at a time; the next one had to wait too long."""


class RaisedInFenceError(FenceError):
    """The function in the child raised; carries the exception's name.

    Attributes
    ----------
    kind : str
        The name of the exception's class.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def error_of(told: dict[str, Any], limits: Limits) -> Exception:
    """Return the error that a child's end is.

    Parameters
    ----------
    told : dict
        ``{"kind", "message", "errno"}`` of an exception, or ``{"signal"}`` that ended it.
    """
    number = told.get("signal")
    if number is not None:
        return _ended(int(number), limits)
    kind, message = str(told.get("kind")), str(told.get("message"))
    if kind == "MemoryError":
        return FenceMemoryError(
            f"Reading it takes more than {limits.memory >> 20} MiB of memory, which is what one "
            "file may take; make it smaller or send parts."
        )
    if kind == "FileTooLarge":
        return FenceSizeError(
            f"What it holds is more than {limits.output >> 20} MiB; send parts of it."
        )
    errno = told.get("errno")
    if kind == "OSError" and isinstance(errno, int):
        return OSError(errno, message)
    return RaisedInFenceError(kind, message)


def _ended(number: int, limits: Limits) -> FenceError:
    if number in _TOO_LONG or number == signal.SIGKILL:  # what follows a limit on processor time
        return FenceTimeError(
            f"Reading it takes longer than {limits.seconds:g} s, which is what one file may take; "
            "make it smaller or send parts."
        )
    return FenceCrashError(
        f"Its reader ended without an answer (signal {number}): the file is damaged, or made to do "
        "that. Write it anew with another program."
    )
