"""A server of the application and, in the same process, of echoes to compare it with.

Run as a program on a data directory; prints its port.
"""

from __future__ import annotations

import socket
import sys
from pathlib import Path

from starlette.types import Receive, Scope, Send

import tests.building  # noqa: F401, tables are built beside the application
from wrenchbook.service.http.app import Application, create_app
from wrenchbook.service.http.server import Server, server_config
from wrenchbook.service.workspace import Settings

BARE = "/bare-echo"
REPLY = b'{"told":"' + b"x" * 480 + b'"}'  # as long as an answer


class WithEcho:
    """The application, and beside it the least that an ASGI application can do with a body."""

    def __init__(self, app: Application) -> None:
        self._app = app
        self.fast_path = app.fast_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] == BARE:
            await _bare_echo(receive, send)
        else:
            await self._app(scope, receive, send)


async def _bare_echo(receive: Receive, send: Send) -> None:
    """Read the body and send a JSON of fixed size: two messages and nothing else."""
    body, more = b"", True
    while more:
        message = await receive()
        body, more = body + message.get("body", b""), message.get("more_body", False)
    length = b"%d" % len(REPLY)
    headers = [(b"content-type", b"application/json"), (b"content-length", length)]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": REPLY})


if __name__ == "__main__":
    bound = socket.create_server(("127.0.0.1", 0))
    print(bound.getsockname()[1], flush=True)
    app = create_app(Settings(Path(sys.argv[1]), solvers=0))
    Server(server_config(WithEcho(app))).run(sockets=[bound])
