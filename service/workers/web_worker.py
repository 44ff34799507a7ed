"""A process that takes requests: it maps tables, and writes what it accepts into the ledger."""

from __future__ import annotations

import asyncio
import json
import socket
import sys

import uvicorn

from wrenchbook.service.http.access.security import security_of_options
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.protocol import FastPathProtocol
from wrenchbook.service.http.server import Server, server_config
from wrenchbook.service.ops.logs import set_up
from wrenchbook.service.settings import settings_of_options
from wrenchbook.service.tables.coordinator_state import FOLDER
from wrenchbook.service.workers.connection_sharing import Acceptor, ConnectionCounts
from wrenchbook.service.workers.heartbeat import BEAT_S, Heartbeat
from wrenchbook.service.workers.supervisor import end_with_supervisor

_OPEN = "connections"  # beside the tables: how many each process has


class WebWorkerServer(Server):
    """A server on a socket that others listen on too; it tells its supervisor once it is up.

    Parameters
    ----------
    config : uvicorn.Config
    counts : ConnectionCounts
    heartbeat : Heartbeat
        Beats from the loop that answers, once it does.
    """

    def __init__(
        self, config: uvicorn.Config, counts: ConnectionCounts, heartbeat: Heartbeat
    ) -> None:
        super().__init__(config)
        self._counts, self._heartbeat = counts, heartbeat
        self._acceptor: Acceptor | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and take connections as the others leave them."""
        await super().startup([])  # uvicorn's own listening takes all there are
        if not self.started or not sockets:
            return
        self._acceptor = Acceptor(
            sockets[0], self._counts, self.server_state.connections, self._speak
        )
        self._acceptor.start()
        self._beat()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take no more connections, then stop as any server."""
        if self._acceptor is not None:
            self._acceptor.stop()
        await super().shutdown([])

    def _beat(self) -> None:
        self._heartbeat.beat()
        asyncio.get_running_loop().call_later(BEAT_S, self._beat)

    def _speak(self) -> asyncio.Protocol:
        return FastPathProtocol(
            self.config, self.server_state, self.lifespan.state, asyncio.get_running_loop()
        )


def main() -> None:
    """Run as a process of the supervisor's."""
    said, number, listening, ready = json.loads(sys.argv[1]), *map(int, sys.argv[2:])
    set_up(said["log_level"], said["log_format"])
    settings = settings_of_options(said, "answering", number)
    app = create_app(settings, security_of_options(said))
    counts = ConnectionCounts(settings.folder / FOLDER / _OPEN, number, said["processes"])
    config = server_config(app, said["log_level"], log_config=None)
    end_with_supervisor()
    WebWorkerServer(config, counts, Heartbeat(ready)).run(sockets=[socket.socket(fileno=listening)])


if __name__ == "__main__":
    main()
