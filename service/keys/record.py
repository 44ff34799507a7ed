"""An API key as it is stored: name, scope, limits, and a digest of its secret."""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, get_args

Scope = Literal["read", "write", "admin"]
SCOPES: Final[tuple[Scope, ...]] = get_args(Scope)
"""From the least to the most: each allows what those before it do."""

PREFIX: Final = "wb_"  # marks a key as one of this program, for secret scanners
RATE: Final = 5000.0
"""Requests a second that a key may send unless said otherwise: a loop of 1 kHz on each of a few
components; a server answers some 10,000."""
MEGABYTES: Final = 512
"""Largest body a key may send unless said otherwise, MiB: that of the largest bundle."""

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")


@dataclass(frozen=True)
class Key:
    """One key.

    Attributes
    ----------
    name : str
        Of its owner.
    scope : str
        ``read``, ``write`` or ``admin``.
    digest : str
        SHA-256 of the secret, hexadecimal. The secret has 256 random bits, so a slower function
        gains nothing.
    created : float
        Seconds since the epoch.
    rate : float
        Most requests a second, with twice as many at once.
    megabytes : int
        Largest body, MiB.
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


def new_secret() -> str:
    """Return a secret of 256 random bits."""
    return PREFIX + secrets.token_urlsafe(32)


def digest_of(secret: str) -> str:
    """Return the digest that is stored instead of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


def checked(fields: dict[str, Any]) -> Key:
    """Return the key of its fields.

    Raises
    ------
    ValueError
        If a field is missing, unknown or invalid.
    """
    try:
        key = Key(**fields)
    except TypeError as error:
        raise ValueError(f"a key has the fields of one: {error}") from None
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
