"""Whether an address to listen on needs keys; light, for the parent process of a server."""

from __future__ import annotations

import ipaddress
from pathlib import Path

from wrenchbook.service.keys.keyring import Keyring

OWN_KEY = "WRENCHBOOK_OWN_KEY"  # a private server's, in its environment
_WITHOUT_KEYS = (
    "{host} is reached from other machines, and {folder} has no keys: anybody there could change "
    "tables and run solves. Make a key with: wrenchbook keys add NAME --scope admin --data "
    "{folder}; or start with --first-key, which makes one and prints it once. To serve this "
    "machine alone, leave --host out."
)


class KeysNeededError(RuntimeError):
    """A server that other machines reach needs keys, and there are none."""


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def require_keys(host: str, folder: Path) -> None:
    """Refuse to listen to other machines without keys.

    Raises
    ------
    KeysNeededError
        If other machines reach the address, and the data directory has no key.
    """
    if not is_loopback(host) and not len(Keyring(folder)):
        raise KeysNeededError(_WITHOUT_KEYS.format(host=host, folder=folder))
