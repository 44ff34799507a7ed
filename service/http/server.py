"""uvicorn's server and its settings for the web application."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import resource
import socket
from math import ceil
from types import FrameType
from typing import Any

import uvicorn

from wrenchbook.service.files.program import keep_few_heaps
from wrenchbook.service.http.app import Application
from wrenchbook.service.http.protocol import FastPathProtocol

log = logging.getLogger(__name__)

TICKS_A_SECOND = 10  # uvicorn's ticks, of which one a second renews the headers
OPEN_FILES = 10_240  # more than connections and files together
FINISH_S = 5  # s for requests to end after SIGTERM
# Time for requests to end, s, after another process has taken over. An import may wait a minute for
# its turn and a minute for the sandbox, is parsed for a minute, and its body may arrive slowly.
RETIRE_S = 600
# Number of objects before the young, the middle and the old generation are collected. A collection
# of the old takes as long as thousands of answers, which all wait for it: Python's own (700, 10,
# 10) collects several times during each build of a large table.
GARBAGE_AFTER = (10_000, 20, 50)


def server_config(app: Any, log_level: str = "warning", **more: Any) -> uvicorn.Config:
    """Return uvicorn's settings for an application."""
    return uvicorn.Config(
        app,
        http=FastPathProtocol,
        ws="none",
        log_level=log_level,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=FINISH_S,
        **more,
    )


class Server(uvicorn.Server):
    """uvicorn's server, with a frozen heap after the start; event streams end before it stops."""

    _loop: asyncio.AbstractEventLoop  # set at the start, before any request

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and exclude existing objects from garbage collection."""
        self._loop = asyncio.get_running_loop()
        keep_few_heaps()
        await super().startup(sockets)
        gc.collect()
        gc.freeze()
        gc.set_threshold(*GARBAGE_AFTER)

    async def on_tick(self, counter: int) -> bool:
        """Update all replies' headers once a second; a replica's have Age (RFC 9111)."""
        ended = await super().on_tick(counter)
        workspace = getattr(getattr(self.config.app, "state", None), "workspace", None)
        if counter % TICKS_A_SECOND == 0 and workspace is not None:
            age = workspace.age()
            if age is not None:
                headers = self.server_state.default_headers
                self.server_state.default_headers = [*headers, (b"age", b"%d" % ceil(age))]
        return ended

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End event streams and long polls, finish requests for a limited time, and stop."""
        limit = self.config.timeout_graceful_shutdown
        log.info("stopping: finishing requests, for %d s at most", limit)
        app = self.config.app
        if isinstance(app, Application) and (events := getattr(app.state, "events", None)):
            events.feed.close()
            app.state.workspace.polls.stop()
        await super().shutdown(sockets)
        log.info("stopped; %d requests were answered", self.server_state.total_requests)

    def retire(self) -> None:
        """Stop, with `RETIRE_S` for requests to end; call it in the loop."""
        self.config.timeout_graceful_shutdown = RETIRE_S
        self.should_exit = True

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop at a signal; end the requests of a retired server after `FINISH_S`."""
        if self.should_exit and hasattr(self, "_loop"):
            self._loop.call_soon_threadsafe(self._loop.call_later, FINISH_S, self._end_requests)
        super().handle_exit(sig, frame)

    def _end_requests(self) -> None:
        for task in self.server_state.tasks:
            task.cancel()


def raise_open_files() -> None:
    """Allow this process as many connections as the machine allows, more than the usual 1024."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    # macOS refuses more than this even if there is no limit.
    limit = OPEN_FILES if hard == resource.RLIM_INFINITY else min(hard, OPEN_FILES)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
