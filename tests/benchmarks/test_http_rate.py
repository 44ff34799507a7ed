"""Requests per second of the main call against a bare FastAPI echo route of the same process.

Both routes are asked in turn, with the same body, by one client on one keep-alive connection, many
short rounds each, so that a noisy machine slows both alike. Printed, not asserted beyond sanity.
"""

import socket
import statistics
import threading
import time
from pathlib import Path

import numpy as np
import orjson
import uvicorn
from fastapi import Request
from starlette.responses import Response

from service.client import Client
from service.http.app import create_app
from service.workspace import Settings

ROUNDS, REQUESTS = 15, 400
BODY = orjson.dumps({"force": [120.0, -80.0, -700.0], "moment": [15.0, 25.0, 4.0]})


def _table() -> str:
    """A made-up smooth response on 1,000 rows an axis, as a JSON table."""
    rng = np.random.default_rng(1)
    wrenches = np.zeros((3000, 6))
    for axis, loads in enumerate(((0, 4, 5), (1, 5, 3), (2, 3, 4))):
        block = wrenches[1000 * axis : 1000 * (axis + 1)]
        block[:, loads] = rng.uniform(-1, 1, (1000, 3))
        corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        block[np.ix_(range(8), loads)] = corners
    displacements = 1e-4 * np.tanh(wrenches)
    rows = [
        {"wrench": (1e3 * wrench).tolist(), "displacement": displacement.tolist()}
        for wrench, displacement in zip(wrenches, displacements, strict=True)
    ]
    return orjson.dumps({"rows": rows}).decode()


def _rate(connection: socket.socket, path: str) -> float:
    head = f"POST {path} HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
    request = f"{head}Content-Length: {len(BODY)}\r\n\r\n".encode() + BODY
    started = time.perf_counter()
    for _ in range(REQUESTS):
        connection.sendall(request)
        reply = connection.recv(65536)
        assert reply.startswith(b"HTTP/1.1 200"), reply[:400]
        length = int(reply.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
        while len(reply) - reply.index(b"\r\n\r\n") - 4 < length:
            reply += connection.recv(65536)
    return REQUESTS / (time.perf_counter() - started)


def test_the_query_route_against_a_bare_echo_route(tmp_path: Path) -> None:
    app = create_app(Settings(tmp_path, solvers=0))

    @app.post("/echo")
    async def echo(body: dict) -> dict:
        return body

    @app.post("/raw-echo")
    async def raw_echo(request: Request) -> Response:
        return Response(await request.body(), media_type="application/json")

    bound = socket.create_server(("127.0.0.1", 0))
    port = bound.getsockname()[1]
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    thread.start()
    with Client(f"http://127.0.0.1:{port}") as client:
        deadline = time.monotonic() + 30
        while not client.is_ready() and time.monotonic() < deadline:
            time.sleep(0.05)
        load_range = {"force": [1000.0] * 3, "moment": [1000.0] * 3}
        client.add_component({"name": "smooth", "title": "made up", "range": load_range})
        client.import_table("smooth", _table(), format="json")
        while client.component("smooth")["rows"] < 3000 and time.monotonic() < deadline + 120:
            time.sleep(0.5)
    paths = {
        "query": "/v1/components/smooth/displacement",
        "echo": "/echo",
        "raw echo": "/raw-echo",
    }
    rates: dict[str, list[float]] = {name: [] for name in paths}
    with socket.create_connection(("127.0.0.1", port)) as connection:
        for _ in range(ROUNDS):
            for name, path in paths.items():
                rates[name].append(_rate(connection, path))
    server.should_exit = True
    thread.join(20)
    for name, found in rates.items():
        print(f"\n{name:>9}: {statistics.median(found):8.0f} requests/s", end="")
    for name in ("echo", "raw echo"):
        ratios = [q / e for q, e in zip(rates["query"], rates[name], strict=True)]
        print(f"\nquery / {name}: {statistics.median(ratios):.2f} (median of rounds)", end="")
    print()
    assert min(rates["query"]) > 0
