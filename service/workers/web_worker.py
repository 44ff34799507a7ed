"""A process that answers requests: it maps tables, and writes accepted jobs and rows to the ledger.

uvicorn accepts all waiting connections at once: one process of two got eight of eight. So a web
worker accepts one at a time, and waits longer the more connections it has.
"""

from __future__ import annotations

import asyncio
import shutil
import socket
import threading
from typing import Final

from wrenchbook.service.files.scratch import take_scratch
from wrenchbook.service.http.access import security_settings
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.protocol import FastPathProtocol
from wrenchbook.service.http.proxy import proxy_trust
from wrenchbook.service.http.server import Server, raise_open_files, server_config
from wrenchbook.service.sandbox import warm_up
from wrenchbook.service.settings import Settings
from wrenchbook.service.workers.supervisor import RETIRE

# Delay for each open connection before the next is accepted, in which a worker with fewer
# connections accepts it; and the longest delay, which a caller does not notice.
DELAY_S: Final = 0.001
MAX_DELAY_S: Final = 0.01
# Open connections for each one that is accepted at once beside the first: for bursts of thousands.
CONNECTIONS_EACH: Final = 8
PARSERS: Final = (  # modules that parse uploads, in sandboxes
    "wrenchbook.service.library.bundles",
    "wrenchbook.service.formats.read",
    "wrenchbook.service.http.batch",
)


class WebWorker(Server):
    """A server on a socket on which the other web workers listen too."""

    def __init__(self, settings: Settings, ready: threading.Event) -> None:
        self._ready = ready
        raise_open_files()
        self._scratch = take_scratch()
        names = settings.host, settings.allow_host, settings.allow_origin
        security = security_settings(*names, proxy_trust(settings))
        app = create_app(settings, security)
        super().__init__(server_config(app, settings.log_level, log_config=None))
        # Not for a command's private server, which ends soon; each process takes 90 MB.
        self._warms_up = security.server_key is None and settings.processes == 1
        self._has_others = settings.processes > 1
        self._timer: asyncio.TimerHandle | None = None
        self._begun: set[asyncio.Task[None]] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and accept connections from then on."""
        await super().startup([])
        if self.started and sockets:
            self._listening = sockets[0]
            self._listening.setblocking(False)
            self._listening.listen(self.config.backlog)
            self._loop.add_signal_handler(RETIRE, self.retire)
            self._loop.add_reader(self._listening, self._accept)
            self._ready.set()
            if self._warms_up:
                warm_up(*PARSERS)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept the waiting connections, stop listening, and finish the requests."""
        if self._timer is not None:
            self._timer.cancel()
        self._loop.remove_reader(self._listening)
        self._accept_up_to(self.config.backlog)
        self._listening.close()
        await asyncio.gather(*self._begun)
        await super().shutdown([])
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _accept(self) -> None:
        """Accept waiting connections after a delay, in which other web workers can accept them."""
        count = len(self.server_state.connections) + len(self._begun)
        if not (self._has_others and count):
            self._accept_up_to(1 + count // CONNECTIONS_EACH)
            return
        self._loop.remove_reader(self._listening)

        def accept() -> None:
            self._timer = None
            self._accept_up_to(1 + count // CONNECTIONS_EACH)
            self._loop.add_reader(self._listening, self._accept)

        self._timer = self._loop.call_later(min(count * DELAY_S, MAX_DELAY_S), accept)

    def _accept_up_to(self, most: int) -> None:
        """Accept at most `most` of the waiting connections."""
        for _ in range(most):
            try:
                accepted, _ = self._listening.accept()
            except OSError:
                return  # another web worker has accepted it, or its caller has disconnected
            accepted.setblocking(False)
            accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            task = self._loop.create_task(self._begin(accepted))
            self._begun.add(task)
            task.add_done_callback(self._begun.discard)

    async def _begin(self, peer: socket.socket) -> None:
        arguments = self.config, self.server_state, self.lifespan.state, self._loop
        try:
            await self._loop.connect_accepted_socket(lambda: FastPathProtocol(*arguments), peer)
        except OSError:
            peer.close()


def run(settings: Settings, started: threading.Event, bound: socket.socket) -> None:
    """Answer requests until SIGTERM; `started` is set once connections are accepted."""
    WebWorker(settings, started).run([bound])
