"""Running the server: in this process, or as a private one for the length of a command."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import resource
import secrets
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

import uvicorn

from wrenchbook.service.client import Client
from wrenchbook.service.files.program import child_command, keep_few_heaps
from wrenchbook.service.http.access import SecuritySettings
from wrenchbook.service.http.access.security import OWN_KEY, require_keys, security_settings
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.application import Application
from wrenchbook.service.http.listen import bind_to
from wrenchbook.service.http.protocol import FastPathProtocol
from wrenchbook.service.ops.logs import LogFormat, set_up
from wrenchbook.service.sandbox import warm_up
from wrenchbook.service.settings import Settings

log = logging.getLogger(__name__)

START_S = 60.0
STOP_S = 30.0
OPEN_FILES = 10_240  # more than connections and files together may be
FINISH_S = 5  # what requests have to end in once the server stops
# Objects made before the young, the middle and the old are looked through. A look at the old takes
# as long as thousands of answers, which all wait for it: by Python's own (700, 10, 10) each build
# of a large table brings about several.
GARBAGE_AFTER = (10_000, 20, 50)
_ANNOUNCEMENT = "wrenchbook serves "


class ServerDidNotStartError(RuntimeError):
    """The private server ended or hung before it was ready; carries the end of its log."""


def serve(
    settings: Settings,
    host: str,
    port: int,
    log_level: str = "info",
    log_format: LogFormat = "text",
    security: SecuritySettings | None = None,
) -> None:
    """Serve until SIGINT or SIGTERM; port 0 takes a free one. Its address is printed once up.

    A first signal lets requests be finished and solves wait for the next start; a second one ends
    the process at once, and leaves solvers running for the next start to find.

    Raises
    ------
    OSError
        If the address is taken or not this machine's.
    KeysNeededError
        If it is reached from elsewhere, and there is no key.
    """
    security = security or security_settings(host, None, None, os.environ.get(OWN_KEY))
    require_keys(host, settings.folder)
    app = create_app(settings, security)
    raise_open_files()
    bound, address = bind_to(host, port)
    set_up(log_level, log_format)
    config = server_config(app, log_level, log_config=None)
    server = Server(config)
    server.address = address
    if security.own_key is None:  # a command's own server ends before that pays
        warm_up(
            "wrenchbook.service.library.bundle_zip",
            "wrenchbook.service.formats.table_file",
            "wrenchbook.service.http.batch",
        )
    server.run(sockets=[bound])


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
    """uvicorn, settled once started, with listeners to events and those who wait going first.

    Attributes
    ----------
    address : str or None
        Printed once connections to it are taken: who reads it may connect at once.
    """

    address: str | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop at the first signal; at a second one end at once: the ledger survives that."""
        if self._captured_signals:
            log.warning("ended at once by a second signal; solvers that run go on by themselves")
            logging.shutdown()
            os._exit(128 + sig)
        name = signal.Signals(sig).name
        log.info("stopping on %s: finishing requests, for %d s at most", name, FINISH_S)
        super().handle_exit(sig, frame)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and no longer look through what is there to stay for garbage."""
        keep_few_heaps()
        await super().startup(sockets)
        gc.collect()
        gc.freeze()
        gc.set_threshold(*GARBAGE_AFTER)
        if self.address is not None and self.started:
            print(f"{_ANNOUNCEMENT}{self.address}", flush=True)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop serving; uvicorn waits for connections to end, which listeners' would not."""
        app = self.config.app
        if isinstance(app, Application) and (watch := getattr(app.state, "watch", None)):
            watch.feed.close()
            app.state.workspace.let_go()
        await super().shutdown(sockets)
        log.info("stopped; %d requests were answered", self.server_state.total_requests)


@contextmanager
def private_server(folder: Path, solvers: int) -> Iterator[Client]:
    """Start a server of one's own on a data directory and stop it at the end.

    Raises
    ------
    ServerDidNotStartError
        If it is not ready within a minute.
    """
    command = child_command("wrenchbook.service.cli.main", "serve", "--data", str(folder))
    command += ["--port", "0", "--solvers", str(solvers), "--log-level", "warning"]
    key = secrets.token_urlsafe(32)
    with tempfile.TemporaryFile("w+") as log:
        server = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, text=True, env=os.environ | {OWN_KEY: key}
        )
        try:
            with Client(_address(server, log), timeout=START_S, key=key) as client:
                _wait_until_ready(client, server, log)
                yield client
        finally:
            _stop(server)


def raise_open_files() -> None:
    """Let this process have as many connections as the machine allows, not 1024 of them."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    # Where there is no end to them, macOS still takes no more than this.
    wanted = OPEN_FILES if most == resource.RLIM_INFINITY else min(most, OPEN_FILES)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def _address(server: subprocess.Popen[str], log: TextIO) -> str:
    """Read the announced address; a silent server is ended after a minute."""
    assert server.stdout is not None
    watchdog = threading.Timer(START_S, server.kill)
    watchdog.start()
    try:
        for line in server.stdout:
            if line.startswith(_ANNOUNCEMENT):
                return line.removeprefix(_ANNOUNCEMENT).strip()
    finally:
        watchdog.cancel()
    raise _did_not_start(log)


def _wait_until_ready(client: Client, server: subprocess.Popen[str], log: TextIO) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and server.poll() is None:
        if client.is_ready():
            return
        time.sleep(0.05)
    raise _did_not_start(log)


def _did_not_start(log: TextIO) -> ServerDidNotStartError:
    log.seek(0)
    return ServerDidNotStartError(f"The server did not start. Its log ends:\n{log.read()[-2000:]}")


def _stop(server: subprocess.Popen[str]) -> None:
    server.terminate()
    try:
        server.wait(STOP_S)
    except subprocess.TimeoutExpired:
        server.kill()
        server.wait()
    if server.stdout:
        server.stdout.close()
