"""The rights of a key, and the number of requests that it may send at a time."""

from __future__ import annotations

import fcntl
import os
import time
import weakref
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import Any, Final

from wrenchbook.service.actors import ANONYMOUS, Caller
from wrenchbook.service.keys import MAX_KEYS, Key, Keyring, Scope

PERMISSION: Final = "wrenchbook.permission"  # key of the permission in a request's scope
_BURST_S: Final = 2.0  # s: a burst is the requests that this time allows
# Part of a second's requests that a process takes from the common bucket at a time: a lock costs 2
# µs, an answer 50. Unused requests of a process are at most half a percent of a burst.
_BATCH: Final = 0.01
_USED_S: Final = 60.0  # s between two notes of a key's use
# Beginning of a key's digest; monotonic time at which the bucket is full.
_BUCKET: Final = Struct("=8sd")
# Attempts for the lock, 1 ms; after them its holder must have been stopped while it had it.
_TRIES: Final = 1000


class Rates:
    """The number of requests that each key may send now, shared by all processes of a server.

    The generic cell rate algorithm (ITU-T I.371): a bucket is the time at which it is full again,
    and a bucket whose time has passed is not stored. The others are in the small file of `share`
    under a lock. Before `share`, or on a full disk, each process counts for itself.
    """

    def __init__(self) -> None:
        self._known: dict[bytes, float] = {}  # the last written content of this process
        self._file: int | None = None

    def share(self, path: Path) -> None:
        """Share the counts with the other processes that use the file, from now on."""
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            weakref.finalize(self, os.close, self._file)

    def take(self, key: Key) -> tuple[int, float]:
        """Take some requests of a key; return their number, and the seconds until the next one."""
        file = self._file
        content = b""
        now = time.monotonic()  # the same clock in all processes
        if file is not None:
            for _ in range(_TRIES):
                with suppress(BlockingIOError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
            with suppress(OSError):
                content = os.pread(file, MAX_KEYS * _BUCKET.size, 0)
        stored = content[: len(content) - len(content) % _BUCKET.size]
        buckets = {name: full for name, full in _BUCKET.iter_unpack(stored) if full > now}

        name = bytes.fromhex(key.digest[:16])
        burst_s = max(_BURST_S, 1.0 / key.rate)  # duration of a full bucket, s
        full = max(buckets.get(name, now), self._known.get(name, now))
        # Written before the machine was restarted, or by a key of this name with another rate.
        if full > now + burst_s + 1.0 / key.rate:
            full = now
        # 1e-6: rounding does not withhold a request that is due.
        due = int((now + burst_s - full) * key.rate + 1e-6)
        count = min(due, max(1, int(_BATCH * key.rate)))
        if count:
            buckets[name] = self._known[name] = full + count / key.rate

        if file is not None:
            written = b"".join(map(_BUCKET.pack, buckets, buckets.values())) if count else content
            with suppress(OSError):
                if written != content:
                    os.pwrite(file, written, 0)
                if len(written) < len(content):
                    os.ftruncate(file, len(written))
            fcntl.flock(file, fcntl.LOCK_UN)
        return count, full + 1.0 / key.rate - burst_s - now


class Permission:
    """The rights of a key that shares `rates`; without a key all rights, and nothing is counted."""

    __slots__ = ("_keyring", "_note_at", "_rates", "_remaining", "caller", "key")

    def __init__(
        self, key: Key | None = None, rates: Rates | None = None, keyring: Keyring | None = None
    ) -> None:
        self.key = key
        self._rates = rates
        self._remaining = 0
        self._keyring = keyring
        self._note_at = 0.0  # when the use of a stored key is noted next
        self.caller = Caller.unlimited(ANONYMOUS)
        if key is not None:
            self.caller = Caller(key.name, key.components, key.allows("admin"))

    def allows(self, scope: Scope) -> bool:
        """Return whether the key has a scope."""
        return self.key is None or self.key.allows(scope)

    def wait(self) -> float:
        """Count one request; return 0, or the seconds until the next request is allowed."""
        if self.key is None or self._rates is None:
            return 0.0
        if self._keyring is not None and time.time() >= self._note_at:
            self._note_at = time.time() + _USED_S
            self._keyring.note_use(self.key, _USED_S)
        if not self._remaining:
            self._remaining, seconds = self._rates.take(self.key)
            if not self._remaining:
                return seconds
        self._remaining -= 1
        return 0.0


OPEN: Final = Permission()


def permission_of(scope: Any) -> Permission:
    """Return the permission of a request."""
    return scope.get(PERMISSION, OPEN)
