"""The server that a command asks, and the options that all commands have."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from wrenchbook.service.client import Client

DEFAULT_SERVER = "http://127.0.0.1:8000"

Name = Annotated[str, typer.Argument(help="the component")]
Server = Annotated[
    str, typer.Option(envvar="WRENCHBOOK_SERVER", help="address of a running server")
]
Data = Annotated[
    Path | None,
    typer.Option(help="work on this data directory with a private server of its own instead"),
]
BeyondRange = Annotated[
    bool, typer.Option(help="solve a wrench outside the component's load range all the same")
]
AsJson = Annotated[bool, typer.Option("--json", help="print the server's reply as JSON")]


@contextmanager
def connected(server: str, data: Path | None, solvers: int = 2) -> Iterator[Client]:
    """Give a client of the running server, or of a private one on ``data``."""
    if data is None:
        with Client(server) as client:
            client.retry_s = 0.0  # a person reads at once how a server is started
            yield client
        return
    from wrenchbook.service.http.server import private_server

    with private_server(data, solvers) as client:
        yield client


def print_json(reply: Any) -> None:
    """Print a reply as JSON."""
    sys.stdout.write(json.dumps(reply, indent=2) + "\n")
