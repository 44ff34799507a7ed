"""Scope and request rate of a key."""

from __future__ import annotations

import fcntl
import os
import time
import weakref
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import Any, Final

from wrenchbook.service.keys import MAX_KEYS, Key, Scope

_AT_ONCE_S: Final = 2.0  # a burst is what this many seconds allow
# Share of a second's requests that a process takes from the common bucket at a time: a lock costs
# 2 µs, an answer 50. What a process has taken and not used is at most half a percent of a burst.
_TAKEN: Final = 0.01
_BUCKET: Final = Struct("=8sd")  # begin of a key's digest; monotonic time at which it is full
_TRIES: Final = 1000  # for the lock, 1 ms; its holder was stopped in the middle of it then
PERMISSION = "wrenchbook.permission"  # its key in a request's scope


class Rates:
    """How many requests each key may send now, counted together by all processes of a server.

    The generic cell rate algorithm (ITU-T I.371): a bucket is the one time at which it is full
    again, and one whose time has passed is as good as none. The others are in a small file under a
    lock. Where a full disk does not take it, each process counts for itself.

    Parameters
    ----------
    path : Path, optional
        The file; one of this process alone if None.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._known: dict[bytes, float] = {}  # what this process has written last
        self._file: int | None = None
        if path is not None:
            with suppress(OSError):
                path.parent.mkdir(parents=True, exist_ok=True)
                self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
                weakref.finalize(self, os.close, self._file)

    def take(self, key: Key) -> tuple[int, float]:
        """Take some requests of a key; return how many, and the seconds until there is one."""
        name, rate, file = bytes.fromhex(key.digest[:16]), key.rate, self._file
        at_once = max(_AT_ONCE_S, 1.0 / rate)
        content, now = b"", time.monotonic()  # the same clock in all processes
        if file is not None:
            for _ in range(_TRIES):
                with suppress(BlockingIOError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
            with suppress(OSError):
                content = os.pread(file, MAX_KEYS * _BUCKET.size, 0)
        whole = len(content) - len(content) % _BUCKET.size
        buckets = {held: full for held, full in _BUCKET.iter_unpack(content[:whole]) if full > now}
        full = max(buckets.get(name, now), self._known.get(name, now))
        if full > now + 2.0 * at_once:  # of an earlier start of the machine
            full = now
        count = min(int((now + at_once - full) * rate + 1e-6), max(1, int(_TAKEN * rate)))
        if count:
            buckets[name] = self._known[name] = full + count / rate
        if file is not None:
            written = b"".join(map(_BUCKET.pack, buckets, buckets.values())) if count else content
            with suppress(OSError):
                if written != content:
                    os.pwrite(file, written, 0)
                if len(written) < len(content):
                    os.ftruncate(file, len(written))
            fcntl.flock(file, fcntl.LOCK_UN)
        return count, full + 1.0 / rate - at_once - now


class Permission:
    """What one key may do, or every caller where no key is needed.

    Parameters
    ----------
    key : Key, optional
        None allows all and counts nothing.
    rates : Rates, optional
        Needed with a key.
    """

    __slots__ = ("_left", "_rates", "key")

    def __init__(self, key: Key | None = None, rates: Rates | None = None) -> None:
        self.key = key
        self._rates = rates
        self._left = 0

    def allows(self, scope: Scope) -> bool:
        """Tell whether it is for a scope."""
        return self.key is None or self.key.allows(scope)

    @property
    def most_bytes(self) -> int | None:
        """The largest body it may send; None for no limit but each call's own."""
        return self.key.megabytes << 20 if self.key else None

    def wait(self) -> float:
        """Count one request; return 0, or the seconds until there is one left."""
        if self.key is None or self._rates is None:
            return 0.0
        if not self._left:
            self._left, seconds = self._rates.take(self.key)
            if not self._left:
                return seconds
        self._left -= 1
        return 0.0


OPEN = Permission()


def permission_of(scope: Any) -> Permission:
    """Return the permission of a request."""
    return scope.get(PERMISSION, OPEN)
