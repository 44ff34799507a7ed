"""The keys of a data directory, in one file that only its owner can read.

Servers and commands on the machine share it: each change is one rename under a lock, and readers
compare the file's date first.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Final

from wrenchbook.service.files.durable import sync_folder
from wrenchbook.service.files.lock import take
from wrenchbook.service.keys.record import (
    MEGABYTES,
    RATE,
    Key,
    Scope,
    checked,
    digest_of,
    new_secret,
)

log = logging.getLogger(__name__)

FILE: Final = "keys.json"
LOOK_S: Final = 0.5  # between checks of the file: a revoked key is valid at most so long
MOST_KEYS: Final = 1000

_Stamp = tuple[int, int, int] | None


class KeysError(ValueError):
    """The keys cannot be read or changed; nothing was changed."""


class Keyring:
    """The keys of one data directory.

    Parameters
    ----------
    folder : Path
        The data directory.

    Raises
    ------
    KeysError
        If there are keys that cannot be read: then no request is accepted.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        self._lock = threading.Lock()
        self._stamp: _Stamp = None
        self._keys: dict[str, Key] = {}
        self._next_look = 0.0
        self.version = 0
        self._read()

    def __len__(self) -> int:
        return len(self._keys)

    def listed(self) -> list[Key]:
        """Return all keys, by name."""
        self.look(0.0)
        return sorted(self._keys.values(), key=lambda key: key.name)

    def find(self, secret: str) -> Key | None:
        """Return the key of a secret; None if there is none."""
        # Looked up by digest: the time it takes reveals nothing about the secrets.
        return self._keys.get(digest_of(secret))

    def has(self, key: Key) -> bool:
        """Return whether a key is one of these, with the same scope and limits."""
        return self._keys.get(key.digest) == key

    def look(self, patience: float = LOOK_S) -> int:
        """Read the file if commands have changed it; return a number that differs then."""
        now = time.monotonic()
        if now < self._next_look and patience:
            return self.version
        self._next_look = now + patience
        with self._lock:
            if _stamp(self._path) != self._stamp:
                try:
                    self._read()
                except KeysError as error:
                    log.error("keys stay as they were: %s", error)
        return self.version

    def add(
        self, name: str, scope: Scope, *, rate: float = RATE, megabytes: int = MEGABYTES
    ) -> str:
        """Make a key and return its secret, which is not stored.

        Parameters
        ----------
        name : str
            Of its owner; unique.
        scope : {"read", "write", "admin"}
            What it allows.
        rate : float
            Most requests a second.
        megabytes : int
            Largest body, MiB.

        Raises
        ------
        KeysError
            If the name is taken or a value is invalid.
        """
        secret = new_secret()
        with self._changing() as keys:
            if len(keys) >= MOST_KEYS:
                raise KeysError(f"there are {MOST_KEYS} keys already; revoke some")
            if any(key.name == name for key in keys.values()):
                raise KeysError(f"there is a key {name!r} already; revoke it or take another name")
            fields = {"name": name, "scope": scope, "digest": digest_of(secret)}
            limits = {"rate": rate, "megabytes": megabytes}
            try:
                key = checked({**fields, "created": time.time(), **limits})
            except ValueError as error:
                raise KeysError(str(error)) from None
            keys[key.digest] = key
        return secret

    def revoke(self, name: str) -> None:
        """Revoke a key; servers notice within a second.

        Raises
        ------
        KeysError
            If there is no such key.
        """
        with self._changing() as keys:
            found = [digest for digest, key in keys.items() if key.name == name]
            if not found:
                names = ", ".join(sorted(key.name for key in keys.values())) or "none"
                raise KeysError(f"there is no key {name!r}; there are: {names}")
            del keys[found[0]]

    @contextmanager
    def _changing(self) -> Iterator[dict[str, Key]]:
        """Give the present keys to be changed, and write them afterwards."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = take(self._path.with_name(f"{FILE}.lock"))
        if descriptor is None:
            raise KeysError("another command is changing the keys; do it again")
        try:
            with self._lock:
                self._read()
                keys = dict(self._keys)
                yield keys
                self._write(keys)
                self._read()
        finally:
            os.close(descriptor)

    def _write(self, keys: dict[str, Key]) -> None:
        """Replace the file of all keys at once."""
        partial = self._path.with_name(f".{FILE}.{os.getpid()}")
        content = json.dumps({"keys": [asdict(key) for key in keys.values()]}, indent=1)
        try:
            descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            with open(descriptor, "w", encoding="utf-8") as file:  # noqa: PTH123 (a descriptor)
                file.write(content)
                file.flush()
                os.fsync(descriptor)
            partial.replace(self._path)
            sync_folder(self._path.parent)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise KeysError(f"{self._path} cannot be written: {error}. The keys stay") from error

    def _read(self) -> None:
        stamp = _stamp(self._path)
        keys = {} if stamp is None else _keys_in(self._path)
        self._keys, self._stamp = keys, stamp
        self.version += 1


def _stamp(path: Path) -> _Stamp:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def _keys_in(path: Path) -> dict[str, Key]:
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))["keys"]
        keys = [checked(one) for one in entries]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise KeysError(
            f"{path} cannot be read ({error}). Mend it, or move it away and make new keys with: "
            "wrenchbook keys add NAME --scope admin"
        ) from error
    return {key.digest: key for key in keys}
