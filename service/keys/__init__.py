"""API keys of a server, stored hashed in the data directory."""

from wrenchbook.service.keys.keyring import FILE, Keyring, KeysError
from wrenchbook.service.keys.record import SCOPES, Key, Scope, digest_of

__all__ = ["FILE", "SCOPES", "Key", "Keyring", "KeysError", "Scope", "digest_of"]
