"""Running the server: in this process, or as a private one for the length of a command."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import uvicorn

from service.client import Client
from service.files.child import child_command
from service.http.app import create_app
from service.workspace import Settings

START_S = 60.0
STOP_S = 30.0
_ANNOUNCEMENT = "wrenchbook serves "


class ServerDidNotStartError(RuntimeError):
    """The private server ended or hung before it was ready; carries the end of its log."""


def serve(settings: Settings, host: str, port: int, log_level: str = "info") -> None:
    """Serve until SIGINT or SIGTERM; port 0 takes a free one. The address is printed first.

    Raises
    ------
    OSError
        If the address is taken or not this machine's.
    """
    bound = _bind(host, port)
    shown = f"[{host}]" if ":" in host else host
    print(f"{_ANNOUNCEMENT}http://{shown}:{bound.getsockname()[1]}", flush=True)
    logging.basicConfig(
        level=log_level.upper(), format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    config = uvicorn.Config(
        create_app(settings), log_level=log_level, access_log=False, timeout_graceful_shutdown=5
    )
    uvicorn.Server(config).run(sockets=[bound])


@contextmanager
def private_server(folder: Path, solvers: int) -> Iterator[Client]:
    """Start a server of one's own on a data directory and stop it at the end.

    Raises
    ------
    ServerDidNotStartError
        If it is not ready within a minute.
    """
    command = child_command("service.cli.main", "serve", "--data", str(folder))
    command += ["--port", "0", "--solvers", str(solvers), "--log-level", "warning"]
    with tempfile.TemporaryFile("w+") as log:
        server = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, text=True, env=os.environ
        )
        try:
            with Client(_address(server, log), timeout=START_S) as client:
                _wait_until_ready(client, server, log)
                yield client
        finally:
            _stop(server)


def _bind(host: str, port: int) -> socket.socket:
    """Bind before anything is opened, so that a taken port changes nothing."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((host, port))
    except OSError:
        bound.close()
        raise
    return bound


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
