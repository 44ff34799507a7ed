"""Ports for servers that are killed and started again at one address."""

import itertools
import os
import secrets
import socket
from pathlib import Path

_RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_OF_A_WORKER = 400  # ports of each worker of pytest-xdist
_WORKERS = 32
_turns = itertools.count(secrets.randbelow(_OF_A_WORKER))


def reserved_port() -> int:
    """Return a port of 127.0.0.1 that is free, and stays so until the test binds it.

    The kernel gives ports of its ephemeral range to any socket at any time: a port below that range
    is used only by a program that names it, and each worker of pytest-xdist has its own ports.
    """
    below = int(_RANGE.read_text().split()[0]) - _WORKERS * _OF_A_WORKER
    first = max(1024, below)  # unprivileged
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]) % _WORKERS
    for turn in itertools.islice(_turns, _OF_A_WORKER):
        port = first + worker * _OF_A_WORKER + turn % _OF_A_WORKER
        with socket.socket() as bound:
            try:
                bound.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"no port of {first} and above is free")
