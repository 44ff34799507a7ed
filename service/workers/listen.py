"""The address a server listens on."""

from __future__ import annotations

import socket


class AddressError(OSError):
    """A server cannot listen on the address it was given."""


def bind_to(host: str, port: int) -> tuple[socket.socket, str]:
    """Return a socket bound to an address, not listening yet, and its URL.

    Port 0 takes a free one. A server binds before it opens anything: a taken port changes nothing.

    Raises
    ------
    AddressError
        If the address is taken or not this machine's.
    """
    shown = f"[{host}]" if ":" in host else host
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        what = f"{error.strerror}: {shown}:{port}; name another address with --host and --port"
        raise AddressError(what) from error
    return bound, f"http://{shown}:{bound.getsockname()[1]}"
