"""The address a server listens on."""

from __future__ import annotations

import socket


def bind_to(host: str, port: int) -> tuple[socket.socket, str]:
    """Return a socket bound to an address, which nobody listens on yet, and its URL.

    Before anything is opened, so that a taken port changes nothing. Port 0 takes a free one.

    Raises
    ------
    OSError
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
        raise OSError(error.errno, what) from error
    return bound, f"http://{shown}:{bound.getsockname()[1]}"
