"""A key whose time is over, without waiting for its end."""

import json
import time
from pathlib import Path

from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.keys import FILE, Keyring, Scope


def add_expired_key(folder: Path, name: str, scope: Scope) -> str:
    """Add a key to a data directory, let it have expired a minute ago, and return its secret."""
    now = time.time()
    secret = Keyring(folder).add(name, scope, expires=now + 3600.0)
    stored = json.loads((folder / FILE).read_bytes())
    for key in stored["keys"]:
        if key["name"] == name:
            key["expires"] = now - 60.0
    write_atomically(folder / FILE, json.dumps(stored).encode(), mode=0o600)
    return secret
