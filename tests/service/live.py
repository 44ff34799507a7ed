"""A server on a socket of this process, and tables to ask it about."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn

import tests.building  # noqa: F401
from tests.until import until
from wrenchbook.service.client import Client
from wrenchbook.service.http.app import Application, create_app
from wrenchbook.service.http.server import server_config
from wrenchbook.service.workspace import Settings

FULL = np.array([100.0] * 3 + [10.0] * 3)  # N and N·m: the load range of the made-up tables


@contextmanager
def served(folder: Path, solvers: int = 0, key: str | None = None) -> Iterator[Client]:
    """Serve a data directory, without solvers if none are wanted, and give a client of it."""
    bound = socket.create_server(("127.0.0.1", 0))
    app = create_app(Settings(folder, solvers=solvers))
    server = uvicorn.Server(server_config(app))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    thread.start()
    with Client(f"http://127.0.0.1:{bound.getsockname()[1]}", timeout=600, key=key) as client:
        until(client.is_ready)
        yield client
    server.should_exit = True
    thread.join(600)


def moved(wrenches: np.ndarray) -> np.ndarray:
    """A made-up stiffening response, (n, 6), m and rad, to wrenches (n, 6), N and N·m."""
    loads = wrenches / FULL
    return 1e-4 * np.tanh(loads) + 2e-5 * np.roll(loads, 1, axis=1) * loads


def tangents(wrenches: np.ndarray) -> np.ndarray:
    """The derivative of `moved`, (n, 6, 6)."""
    loads = wrenches / FULL
    by_load = np.zeros((len(loads), 6, 6))
    for out in range(6):
        other = (out - 1) % 6
        by_load[:, out, out] += 1e-4 / np.cosh(loads[:, out]) ** 2 + 2e-5 * loads[:, other]
        by_load[:, out, other] += 2e-5 * loads[:, out]
    return by_load / FULL


def full_wrenches(count: int, seed: int = 1) -> np.ndarray:
    """Wrenches of all six loads, (count, 6), N and N·m."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6)) * FULL


def add_table(client: Client, name: str, rows: list[dict], **more: object) -> None:
    """Add a table-only component with rows."""
    load_range = {"force": [100.0] * 3, "moment": [10.0] * 3}
    client.add_component({"name": name, "title": name, "range": load_range, **more})
    add_rows(client, name, rows)


def add_rows(client: Client, name: str, rows: list[dict]) -> None:
    """Import rows, and wait until they answer."""
    import orjson

    reply = client.import_table(name, orjson.dumps({"rows": rows}), format="json")
    assert client.component(name, wait_s=60)["table_version"] >= reply["table_version"]


def as_rows(
    wrenches: np.ndarray, displacements: np.ndarray, compliances: np.ndarray | None = None
) -> list[dict]:
    """Rows of a JSON table; a displacement that is NaN is not measured."""
    rows: list[dict] = [
        {"wrench": wrench, "displacement": [None if np.isnan(u) else u for u in displacement]}
        for wrench, displacement in zip(wrenches.tolist(), displacements.tolist(), strict=True)
    ]
    if compliances is not None:
        for row, compliance in zip(rows, compliances.tolist(), strict=True):
            row["compliance"] = compliance
    return rows


def clean_wrenches() -> np.ndarray:
    """The corners of every axis and zero load, (25, 6), N and N·m."""
    results = [np.zeros(6)]
    for loads in ((0, 4, 5), (1, 5, 3), (2, 3, 4)):
        for corner in np.ndindex(2, 2, 2):
            wrench = np.zeros(6)
            wrench[list(loads)] = 2.0 * np.array(corner) - 1.0
            results.append(wrench * FULL)
    return np.array(results)


def answer_fast(app: Application, component: str, body: bytes) -> bytes | dict[str, Any]:
    """Give the fast path of an application one query, and return what it makes of it."""
    line = f"POST /v1/components/{component}/displacement HTTP/1.1\r\nHost: x\r\n"
    head = app.fast_path.head(f"{line}Content-Length: {len(body)}\r\n\r\n".encode() + body)
    return app.fast_path.answer(head, body)
