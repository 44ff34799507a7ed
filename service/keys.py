"""API keys, stored hashed in one file of the data directory that only its owner can read.

Servers and commands on the machine share the file: each change is one rename under a lock, and
readers compare the file's date first.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
import logging
import os
import re
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.lock import take

log = logging.getLogger(__name__)

Scope = Literal["read", "write", "admin"]
SCOPES: Final[tuple[Scope, ...]] = get_args(Scope)
"""From the least to the most: each allows what those before it do."""

FILE: Final = "keys.json"
LOOK_S: Final = 0.5  # between checks of the file: a revoked key is valid at most so long
MAX_KEYS: Final = 1000
OWN_KEY: Final = "WRENCHBOOK_OWN_KEY"  # a private server's, in its environment
PREFIX: Final = "wb_"  # marks a key as one of this program, for secret scanners
RATE: Final = 5000.0
"""Requests a second that a key may send unless said otherwise: a loop of 1 kHz on each of a few
components; a server answers some 10,000."""
MEGABYTES: Final = 512
"""Largest body a key may send unless said otherwise, MiB: that of the largest bundle."""

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_WITHOUT_KEYS: Final = (
    "{host} is reached from other machines, and {folder} has no keys: anybody there could change "
    "tables and run solves. Make a key with: wrenchbook keys add NAME --scope admin --data "
    "{folder}; or start with --first-key, which makes one and prints it once. To serve this "
    "machine alone, leave --host out."
)


class KeysError(ValueError):
    """The keys cannot be read or changed; nothing was changed."""


class KeysNeededError(RuntimeError):
    """A server that other machines reach needs keys, and there are none."""


@dataclass(frozen=True)
class Key:
    """The stored form of a key: its owner's name, its scope, its limits, a digest of its secret.

    The digest is SHA-256, hexadecimal: the secret has 256 random bits, so a slower function gains
    nothing. `rate` is in requests a second, with twice as many at once; `megabytes` the largest
    body, MiB; `created` seconds since the epoch.
    """

    name: str
    scope: Scope
    digest: str
    created: float
    rate: float = RATE
    megabytes: int = MEGABYTES

    def allows(self, scope: Scope) -> bool:
        """Return whether the key's scope includes another."""
        return SCOPES.index(self.scope) >= SCOPES.index(scope)

    def public(self) -> dict[str, Any]:
        """Return all fields but the digest."""
        return {name: value for name, value in asdict(self).items() if name != "digest"}


def digest_of(secret: str) -> str:
    """Return the digest that is stored instead of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


class Keyring:
    """The keys of one data directory; raises KeysError if they cannot be read.

    A server whose keys cannot be read accepts no request.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        self._lock = threading.Lock()
        self._stamp: tuple[int, int, int] | None = None
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
            if self._file_stamp() != self._stamp:
                try:
                    self._read()
                except KeysError as error:
                    log.error("keys stay as they were: %s", error)
        return self.version

    def add(
        self, name: str, scope: Scope, *, rate: float = RATE, megabytes: int = MEGABYTES
    ) -> str:
        """Make a key and return its secret, which is not stored; see `Key`.

        Raises KeysError if the name is taken or a value is invalid.
        """
        secret = PREFIX + secrets.token_urlsafe(32)
        with self._changing() as keys:
            if len(keys) >= MAX_KEYS:
                raise KeysError(f"there are {MAX_KEYS} keys already; revoke some")
            if any(key.name == name for key in keys.values()):
                raise KeysError(f"there is a key {name!r} already; revoke it or take another name")
            fields = {"name": name, "scope": scope, "digest": digest_of(secret)}
            limits = {"rate": rate, "megabytes": megabytes}
            try:
                key = _checked({**fields, "created": time.time(), **limits})
            except ValueError as error:
                raise KeysError(str(error)) from None
            keys[key.digest] = key
        return secret

    def revoke(self, name: str) -> None:
        """Revoke a key, which servers notice within a second; KeysError if there is none."""
        with self._changing() as keys:
            digests = [digest for digest, key in keys.items() if key.name == name]
            if not digests:
                names = ", ".join(sorted(key.name for key in keys.values())) or "none"
                raise KeysError(f"there is no key {name!r}; there are: {names}")
            del keys[digests[0]]

    @contextmanager
    def _changing(self) -> Iterator[dict[str, Key]]:
        """Give the present keys to be changed, and replace the file of all keys afterwards."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = take(self._path.with_name(f"{FILE}.lock"))
        if descriptor is None:
            raise KeysError("another command is changing the keys; do it again")
        try:
            with self._lock:
                self._read()
                keys = dict(self._keys)
                yield keys
                content = json.dumps({"keys": [asdict(key) for key in keys.values()]}, indent=1)
                try:
                    write_whole_bytes(self._path, content.encode(), mode=0o600)
                except OSError as error:
                    raise KeysError(
                        f"{self._path} cannot be written: {error}. The keys stay"
                    ) from error
                self._read()
        finally:
            os.close(descriptor)

    def _read(self) -> None:
        stamp = self._file_stamp()
        try:
            entries = [] if stamp is None else json.loads(self._path.read_bytes())["keys"]
            keys = [_checked(entry) for entry in entries]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise KeysError(
                f"{self._path} cannot be read ({error}). Repair it, or move it away and make new "
                "keys with: wrenchbook keys add NAME --scope admin"
            ) from error
        self._keys, self._stamp = {key.digest: key for key in keys}, stamp
        self.version += 1

    def _file_stamp(self) -> tuple[int, int, int] | None:
        try:
            status = self._path.stat()
        except FileNotFoundError:
            return None
        return status.st_mtime_ns, status.st_size, status.st_ino


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def require_keys(host: str, folder: Path) -> None:
    """Raise KeysNeededError if other machines reach an address and there is no key."""
    if not is_loopback(host) and not len(Keyring(folder)):
        raise KeysNeededError(_WITHOUT_KEYS.format(host=host, folder=folder))


def _checked(fields: dict[str, Any]) -> Key:
    """Return the key of its fields; ValueError if a field is missing, unknown or invalid."""
    try:
        key = Key(**fields)
    except TypeError as error:
        raise ValueError(f"the fields of a key are wrong: {error}") from None
    if not isinstance(key.name, str) or not _NAME.fullmatch(key.name):
        raise ValueError(
            f"{key.name!r} is no name of a key: 1 to 64 letters, digits, '.', '_', '@' and '-', "
            "beginning with a letter or digit"
        )
    if key.scope not in SCOPES:
        raise ValueError(f"{key.scope!r} is no scope; there are {', '.join(SCOPES)}")
    if not (isinstance(key.rate, int | float) and 0 < key.rate < 1e9):
        raise ValueError(f"the rate is a number of requests a second above 0, not {key.rate!r}")
    if not (isinstance(key.megabytes, int) and 0 < key.megabytes < 1 << 20):
        raise ValueError(f"the largest body is a number of MiB above 0, not {key.megabytes!r}")
    if not re.fullmatch(r"[0-9a-f]{64}", str(key.digest)):
        raise ValueError("a digest is 64 hexadecimal digits")
    return key
