"""Running a server that follows another."""

from __future__ import annotations

from pathlib import Path

from threadpoolctl import threadpool_limits

from service.client import Client
from service.following.app import FollowingApp
from service.following.copies import FOLDER, PATIENCE_S, Copies
from service.following.forward import Forwarder
from service.http.door import Door, Opening
from service.http.listen import bind_to
from service.http.server import Server, server_config
from service.keys import Keyring
from service.telemetry.logs import LogFormat, set_up


class OwnDirectoryError(RuntimeError):
    """The data directory is that of a server of its own, or of another that follows."""


def follow(
    url: str,
    folder: Path,
    host: str,
    port: int,
    log_level: str,
    log_format: LogFormat,
    opening: Opening,
) -> None:
    """Follow the server at an address, with copies in a data directory, until a signal.

    Raises
    ------
    OwnDirectoryError
        If the directory has a ledger: its rows and jobs would be hidden behind the other's.
    ValueError
        If the address is none of a server.
    OSError
        If the address to listen on is taken or not this machine's.
    """
    client = Client(url, timeout=PATIENCE_S)
    if (folder / "ledger.sqlite").exists():
        raise OwnDirectoryError(
            f"{folder} has a ledger of its own, which a server that follows {client.url} would "
            "hide; name another directory with --data"
        )
    bound, address = bind_to(host, port)
    set_up(log_level, log_format)
    threadpool_limits(limits=1)
    door = Door(Keyring(folder), opening)
    copies, forwarder = Copies(client, folder / FOLDER), Forwarder(client.url)
    app = FollowingApp(copies, forwarder, client.url, door)
    server = Server(server_config(app, log_level, log_config=None))
    server.address = address
    server.run(sockets=[bound])
