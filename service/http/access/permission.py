"""Scope and request rate of a key."""

from __future__ import annotations

import time
from typing import Any

from wrenchbook.service.keys import Key, Scope

_AT_ONCE_S = 2.0  # a burst is what this many seconds allow
PERMISSION = "wrenchbook.permission"  # its key in a request's scope


class Permission:
    """What one key may do, or every caller where no key is needed.

    Parameters
    ----------
    key : Key, optional
        None allows all and counts nothing.
    """

    __slots__ = ("_left", "_seen", "key")

    def __init__(self, key: Key | None = None) -> None:
        self.key = key
        self._left = _AT_ONCE_S * key.rate if key else 0.0
        self._seen = time.monotonic()

    def allows(self, scope: Scope) -> bool:
        """Tell whether it is for a scope."""
        return self.key is None or self.key.allows(scope)

    @property
    def most_bytes(self) -> int | None:
        """The largest body it may send; None for no limit but each call's own."""
        return self.key.megabytes << 20 if self.key else None

    def wait(self) -> float:
        """Count one request; return 0, or the seconds until there is one left."""
        key = self.key
        if key is None:
            return 0.0
        now = time.monotonic()
        left = min(self._left + (now - self._seen) * key.rate, _AT_ONCE_S * key.rate)
        self._seen = now
        if left < 1.0:
            self._left = left
            return (1.0 - left) / key.rate
        self._left = left - 1.0
        return 0.0


OPEN = Permission()


def permission_of(scope: Any) -> Permission:
    """Return the permission of a request."""
    return scope.get(PERMISSION, OPEN)
