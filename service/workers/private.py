"""A private server for the duration of a command."""

from __future__ import annotations

import os
import secrets
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TextIO

from wrenchbook.service.client import Client
from wrenchbook.service.files.program import child_command
from wrenchbook.service.keys import OWN_KEY
from wrenchbook.service.workers.supervisor import in_use

CALL_S: Final = 60.0  # timeout, twice a client's default: the server shares cores with its solvers
STOP_S: Final = 30.0  # time to end after SIGTERM, as of a server's processes
POLL_S: Final = 0.05  # pause between checks whether the server is ready: a start takes seconds
_LOG_CHARACTERS: Final = 2000  # characters of the log's end in a message: a traceback
_ANNOUNCEMENT: Final = "wrenchbook serves "


class ServerDidNotStartError(RuntimeError):
    """The private server ended before it was ready; the message has the end of its log."""


@contextmanager
def private_server(folder: Path, solvers: int) -> Iterator[Client]:
    """Start a server on a data directory for the duration of a command.

    Raises ServerDidNotStartError if it ends before it is ready, or another server uses `folder`.
    """
    if used := in_use(folder):
        raise ServerDidNotStartError(used)
    command = child_command("wrenchbook.service.cli.main", "serve", "--data", str(folder))
    command += ["--port", "0", "--solvers", str(solvers), "--log-level", "warning"]
    key = secrets.token_urlsafe(32)
    with tempfile.TemporaryFile("w+") as log:
        server = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=os.environ | {OWN_KEY: key},
            process_group=0,  # Ctrl-C must end the command alone, which cancels its jobs
        )
        assert server.stdout is not None
        try:
            lines = (line for line in server.stdout if line.startswith(_ANNOUNCEMENT))
            address = next(lines, "").removeprefix(_ANNOUNCEMENT).strip()
            if not address:
                raise _did_not_start(log)
            with Client(address, timeout=CALL_S, key=key) as client:
                while not client.is_ready():
                    if server.poll() is not None:
                        raise _did_not_start(log)
                    time.sleep(POLL_S)
                yield client
        finally:
            server.terminate()
            try:
                server.wait(STOP_S)
            except subprocess.TimeoutExpired:
                server.kill()
                server.wait()
            server.stdout.close()


def _did_not_start(log: TextIO) -> ServerDidNotStartError:
    log.seek(0)
    why = "The server of this command did not start; remove the cause that its log ends with"
    return ServerDidNotStartError(why + f":\n{log.read()[-_LOG_CHARACTERS:]}")
