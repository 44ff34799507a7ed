"""API keys, stored hashed in one file of the data directory that only its owner can read.

Servers and commands on the machine share the file: each change is one rename under a lock, and
readers compare the file's date first.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
import logging
import math
import os
import re
import secrets
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

from wrenchbook.service.actors import ANY
from wrenchbook.service.files.durable import NO_ROOM, write_atomically
from wrenchbook.service.files.lock import take

log = logging.getLogger(__name__)

Scope = Literal["read", "write", "admin"]
SCOPES: Final[tuple[Scope, ...]] = get_args(Scope)
"""From the least to the most: each scope includes those before it."""

FILE: Final = "keys.json"
USED: Final = "keys-used"  # folder of a file for each key, whose date is that of its last use
# Time that the old secret of a rotated key is valid: a day's deployments.
OVERLAP_HOURS: Final = 24.0
POLL_S: Final = 0.5  # s between checks of the file: a revoked key is valid for at most this time
MAX_KEYS: Final = 1000
OWN_KEY: Final = "WRENCHBOOK_OWN_KEY"  # a private server's key, in its environment
PREFIX: Final = "wb_"  # marks a key of this program for secret scanners
RATE: Final = 5000.0
"""Default of the requests a second that a key may send: a loop of 1 kHz on each of a few
components; a server answers some 10,000.
"""
MEGABYTES: Final = 512
"""Default of the largest body that a key may send, MiB: that of the largest bundle."""

# Means the same in fnmatch and in SQLite's GLOB.
_PATTERN: Final = re.compile(r"[A-Za-z0-9_*?-]{1,64}")
MAX_PATTERNS: Final = 100
MAX_MEGABYTES: Final = (1 << 20) - 1  # MiB: 1 TiB
NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_EXAMPLE: Final = '["plate_*"]'
_MAX_NAMED: Final = 20  # keys in a message: more would hide its remedy
_MAX_OVERLAP_S: Final = 1e9  # 30 years: a time in milliseconds is a mistake
_FULL: Final = f"{MAX_KEYS} keys, the limit, exist; revoke one with: wrenchbook keys revoke NAME"
_WITHOUT_KEYS: Final = (
    "other machines can reach {host}, but {folder} has no keys, so anybody there could change "
    "tables. Create a key (wrenchbook keys add NAME --scope admin --data {folder}), start with "
    "--first-key, or leave --host out."
)


class KeysError(ValueError):
    """No key was changed; the class itself means an invalid value."""


class KeyExistsError(KeysError):
    """A key has this name already."""


class UnknownKeyError(KeysError, LookupError):
    """No valid key has this name."""


class LastKeyError(KeysError):
    """Without this key the server would need none."""


class KeysBusyError(KeysError):
    """Another process is changing the keys."""


class KeysFullError(KeysError):
    """The largest number of keys is reached."""


class KeysUnavailableError(KeysError):
    """The file of the keys cannot be read or written."""


class KeysNeededError(RuntimeError):
    """A server that other machines reach needs keys, but there are none."""


@dataclass(frozen=True)
class Key:
    """The stored form of a key: its owner's name, its scope, its limits, a digest of its secret.

    The digest is SHA-256, hexadecimal: the secret has 256 random bits, so that a slower function
    gains nothing. `rate` is in requests a second, with twice as many at once; `megabytes` the
    largest body, MiB; `created` and `expires`, the end of its validity, are seconds since the
    epoch. It permits components whose name matches a pattern of `components`. A rotated key has two
    secrets, and so two entries, until the older one expires.
    """

    name: str
    scope: Scope
    digest: str
    created: float
    rate: float = RATE
    megabytes: int = MEGABYTES
    components: tuple[str, ...] = ANY
    expires: float | None = None

    def is_valid(self) -> bool:
        """Return whether the key has not expired."""
        return self.expires is None or time.time() < self.expires

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
    """The keys of one data directory. A server whose keys cannot be read accepts no request.

    Raises KeysError if the keys cannot be read.
    """

    def __init__(self, folder: Path, option: str = "") -> None:
        self._path = folder / FILE
        self._option = option or f"--data {folder}"  # of the commands that messages name
        self._lock = threading.Lock()
        self._stamp: tuple[int, int, int] | None = None
        self._keys: dict[str, Key] = {}
        self._next_poll = 0.0
        self._same_keys = 0.0, 0.0  # interval of the clock in which the same keys are valid
        self.version = 0
        self._read()

    def __len__(self) -> int:
        return len(self._keys)

    def listed(self) -> list[Key]:
        """Return all keys, by name."""
        self.refresh(0.0)
        return sorted(self._keys.values(), key=lambda key: key.name)

    def find(self, secret: str) -> Key | None:
        """Return the key of a secret, expired or not; None if no key has it."""
        # Searched by digest: the duration reveals nothing about the secrets.
        digest = digest_of(secret)
        if digest not in self._keys:
            self.refresh(0.0)  # another process may just have made it
        return self._keys.get(digest)

    def has(self, key: Key) -> bool:
        """Return whether a key is one of these, with the same scope and limits."""
        return self._keys.get(key.digest) == key and key.is_valid()

    def note_use(self, key: Key, every_s: float) -> None:
        """Store that a key is used now, unless a process has stored it in the last `every_s`."""
        path = self._path.with_name(USED) / key.digest[:16]
        with suppress(OSError):  # a key is valid on a full disk
            if abs(time.time() - (self.last_use(key) or 0.0)) >= every_s:
                path.parent.mkdir(mode=0o700, exist_ok=True)
                path.touch(mode=0o600)

    def last_use(self, key: Key) -> float | None:
        """Return the time of a key's last use, seconds since the epoch; None if never."""
        path = self._path.with_name(USED) / key.digest[:16]
        return path.stat().st_mtime if path.exists() else None

    def public(self) -> list[dict[str, Any]]:
        """Return all keys by name, without their digests, with their `last_used`."""
        return [key.public() | {"last_used": self.last_use(key)} for key in self.listed()]

    def refresh(self, patience: float = POLL_S) -> int:
        """Read the file if it was changed; return a number that changes then, or at an expiry."""
        now = time.monotonic()
        if now < self._next_poll and patience:
            return self.version
        self._next_poll = now + patience
        with self._lock:
            try:
                if self._file_stamp() != self._stamp:
                    self._read()
            except KeysError as error:
                log.error("keys stay as they were: %s", error)
        begin, end = self._same_keys
        if not begin <= (clock := time.time()) < end:  # before: the clock was set back
            ends = (key.expires for key in self._keys.values() if key.expires and key.is_valid())
            self._same_keys = clock, min(ends, default=math.inf)
            self.version += 1
        return self.version

    def add(self, name: str, scope: Scope, **limits: Any) -> str:
        """Make a key and return its secret, which is not stored; `limits` are fields of `Key`.

        Raises KeysError if the name is taken or a value is invalid, KeysFullError if there are too
        many keys.
        """
        secret = PREFIX + secrets.token_urlsafe(32)
        with self._changing() as keys:
            if len(keys) >= MAX_KEYS:
                raise KeysFullError(f"{_FULL} {self._option}")
            if any(key.name == name for key in keys.values()):
                taken = f"a key {name!r} exists; choose another name, or revoke it first with: "
                raise KeyExistsError(taken + f"wrenchbook keys revoke {name} {self._option}")
            values = {"name": name, "scope": scope, "digest": digest_of(secret)}
            try:
                key = _checked({**values, "created": time.time(), **limits})
            except ValueError as error:
                raise KeysError(str(error)) from None
            if not key.is_valid():
                past = f"expires {key.expires:.0f} is in the past: now it is {time.time():.0f}"
                raise KeysError(past + " (s since 1970); give a later time, or leave it out")
            keys[key.digest] = key
        return secret

    def rotate(self, name: str, overlap_s: float) -> str:
        """Make a new secret of a key and return it; the old one is valid for `overlap_s` more."""
        secret = PREFIX + secrets.token_urlsafe(32)
        with self._changing() as keys:
            named = [key for key in keys.values() if key.name == name]
            if not named:
                raise _unknown_key(name, keys.values(), self._option)
            known = [key for key in named if key.is_valid()]
            if not known:
                why = f"the key {name!r} has expired, so it cannot be rotated; replace it with: "
                raise UnknownKeyError(
                    f"{why}wrenchbook keys revoke {name} {self._option}; "
                    f"wrenchbook keys add {name} {self._option}"
                )
            if not 0.0 <= overlap_s < _MAX_OVERLAP_S:
                hours = overlap_s / 3600.0
                raise KeysError(f"the overlap must be from 0 to 277777 hours, not {hours:g}")
            if len(keys) >= MAX_KEYS:
                raise KeysFullError(f"{_FULL} {self._option}")
            newest = max(known, key=lambda key: key.created)
            now = time.time()
            for old in known:
                del keys[old.digest]
                end = min(old.expires or math.inf, now + overlap_s)
                if end > now:
                    keys[old.digest] = replace(old, expires=end)
            digest = digest_of(secret)
            keys[digest] = replace(newest, digest=digest, created=now)
        return secret

    def revoke(self, name: str, *, may_be_last: bool = True) -> None:
        """Revoke a key, which servers notice within a second.

        Raises UnknownKeyError if there is no such key, and LastKeyError if there is no other one
        and it must not be the last.
        """
        with self._changing() as keys:
            digests = [digest for digest, key in keys.items() if key.name == name]
            if not digests:
                raise _unknown_key(name, keys.values(), self._option)
            if len(digests) == len(keys) and not may_be_last:
                raise LastKeyError(
                    f"{name!r} is the last key: without keys every user of this machine, and every "
                    "client of a proxy before it, could call the server. Add another key first "
                    "with POST /v1/keys."
                )
            for digest in digests:
                del keys[digest]

    @contextmanager
    def _changing(self) -> Iterator[dict[str, Key]]:
        """Yield the present keys to be changed, and replace the file of all keys afterwards."""
        self._path.parent.mkdir(0o700, parents=True, exist_ok=True)
        descriptor = take(self._path.with_name(f"{FILE}.lock"))
        if descriptor is None:
            raise KeysBusyError(f"another command is changing {FILE}; repeat yours in a second")
        try:
            with self._lock:
                self._read()
                keys = dict(self._keys)
                yield keys
                content = json.dumps({"keys": [asdict(key) for key in keys.values()]}, indent=1)
                try:
                    write_atomically(self._path, content.encode(), mode=0o600)
                except OSError as error:
                    raise _unusable(self._path, "written", error) from error
                self._read()
        finally:
            os.close(descriptor)

    def _read(self) -> None:
        """Read the keys from their file.

        Raises KeysUnavailableError if the file cannot be read or is damaged.
        """
        stamp = self._file_stamp()
        try:
            keys = [] if stamp is None else _stored_keys(self._path.read_bytes())
        except OSError as error:
            raise _unusable(self._path, "read", error) from error
        except ValueError as error:
            raise KeysUnavailableError(
                f"{self._path} is damaged: {error}. Correct it, or move it away and create new "
                f"keys with: wrenchbook keys add NAME --scope admin --data {self._path.parent}"
            ) from error
        self._keys = {key.digest: key for key in keys}
        self._stamp = stamp
        self.version = self.version + 1
        self._same_keys = 0.0, 0.0

    def _file_stamp(self) -> tuple[int, int, int] | None:
        try:
            status = self._path.stat()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise _unusable(self._path, "read", error) from error
        return status.st_mtime_ns, status.st_size, status.st_ino


def _unusable(path: Path, done: str, error: OSError) -> KeysUnavailableError:
    """Return the error of a file of keys that cannot be read or written, by the disk's error."""
    user = os.geteuid()
    remedy = NO_ROOM.get(error.errno or 0, "check its disk and how it is mounted")
    if isinstance(error, PermissionError):
        remedy = f"run this as the owner of {path.parent}, or give it to user {user}"
    why = f"{path} cannot be {done} ({error.strerror}); {remedy}, then repeat this"
    return KeysUnavailableError(why + ". No key changed")


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def require_keys(host: str, folder: Path) -> None:
    """Check that an address that other machines reach has keys.

    Raises KeysNeededError without keys, and KeysError if they cannot be read, or the host has no
    address.
    """
    if not len(Keyring(folder)) and not is_loopback(host):
        try:
            socket.getaddrinfo(host, None)
        except OSError:
            why = f"no host has the name {host!r}; give an address of this machine with --host"
            raise KeysError(why) from None
        raise KeysNeededError(_WITHOUT_KEYS.format(host=host, folder=folder))


def _unknown_key(name: str, keys: Iterable[Key], option: str) -> UnknownKeyError:
    names = sorted({key.name for key in keys})
    known = ", ".join(names[:_MAX_NAMED]) + (", ..." if len(names) > _MAX_NAMED else "")
    create = f"create it with: wrenchbook keys add {name} {option}"
    remedy = f"name one of: {known}" if names else create
    return UnknownKeyError(f"there is no key {name!r}; " + remedy)


def _stored_keys(content: bytes) -> list[Key]:
    """Return the keys of the file's JSON.

    Raises ValueError with the place of a mistake in it.
    """
    try:
        document = json.loads(content)
    except ValueError as error:
        raise ValueError(f"it is not valid JSON ({error})") from None
    entries = document.get("keys") if isinstance(document, dict) else None
    if not isinstance(entries, list):
        raise ValueError('it has no list "keys"')
    is_needed = {item.name: item.default is MISSING for item in fields(Key)}
    keys = []
    for number, entry in enumerate(entries):
        names = entry.keys() if isinstance(entry, dict) else ()
        lacking = [name for name, needed in is_needed.items() if needed and name not in names]
        wrong = lacking or [name for name in names if name not in is_needed]
        try:
            if wrong:
                raise ValueError(f"the field {wrong[0]!r} is {'missing' if lacking else 'unknown'}")
            patterns = entry.get("components", [])
            if not isinstance(patterns, list):
                raise ValueError(f"components must be a list such as {_EXAMPLE}, not {patterns!r}")
            keys.append(_checked(entry))
        except ValueError as error:
            raise ValueError(f"keys[{number}]: {error}") from None
    return keys


def checked_name(name: Any) -> str:
    """Return a valid name of a key; raises ValueError for any other."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ValueError(
            f"{name!r} is not a valid key name; use 1 to 64 letters, digits, '.', '_', '@' and "
            "'-', beginning with a letter or digit"
        )
    return name


def _checked(values: dict[str, Any]) -> Key:
    """Return the key of its fields.

    Raises ValueError if a value is invalid.
    """
    key = Key(**{**values, "components": tuple(values.get("components", ANY))})
    checked_name(key.name)
    if key.scope not in SCOPES:
        raise ValueError(f"the scope must be one of {', '.join(SCOPES)}, not {key.scope!r}")
    if not (isinstance(key.rate, int | float) and 1e-6 <= key.rate < 1e9):
        raise ValueError(f"the rate must be 1e-6 to 1e9 requests a second, not {key.rate!r}")
    if not (isinstance(key.megabytes, int) and 0 < key.megabytes <= MAX_MEGABYTES):
        bound = f"megabytes must be whole and 1 to {MAX_MEGABYTES}"
        raise ValueError(f"{bound}, not {key.megabytes!r}")
    if not 0 < len(key.components) <= MAX_PATTERNS:
        raise ValueError(
            f"give 1 to {MAX_PATTERNS} patterns of components, not {len(key.components)}"
        )
    for name in key.components:
        if not (isinstance(name, str) and _PATTERN.fullmatch(name)):
            why = f"the pattern {name!r} must have 1 to 64 letters, digits, _ - * and ?, such as "
            raise ValueError(why + "plate_*")
    # Before the year 5138: a time in milliseconds is a mistake.
    end = 1 if key.expires is None else key.expires
    if not (isinstance(end, int | float) and 0 < end < 1e11):
        raise ValueError(
            f"expires is {end!r}, but must be in seconds since 1970 (now {time.time():.0f}); "
            "divide milliseconds by 1000, or leave it out for no end"
        )
    if not re.fullmatch(r"[0-9a-f]{64}", str(key.digest)):
        raise ValueError(f"digest must be 64 hexadecimal digits, not {key.digest!r}")
    return key
