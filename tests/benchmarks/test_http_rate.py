"""Requests per second of the main call against echoes, and the client's time against http.client.

The routes are asked in turn, with the same body, on one keep-alive connection, many short rounds
each, so that a noisy machine slows all alike. Printed, not asserted beyond sanity.
"""

import http.client
import socket
import statistics
import threading
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import orjson
import pytest
import uvicorn
from fastapi import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from service.client import Client
from service.http.app import create_app
from service.workspace import Settings

ROUNDS, REQUESTS = 15, 400
FORCE, MOMENT = [120.0, -80.0, -700.0], [15.0, 25.0, 4.0]
BODY = orjson.dumps({"force": FORCE, "moment": MOMENT, "on_thin": "estimate"})
QUERIES = {name: f"/v1/components/{name}/displacement" for name in ("clean", "solved")}
BARE = "/bare-echo"


def _rows(wrenches: np.ndarray, *, tangents: bool) -> str:
    """A made-up smooth response at wrenches (n, 6), in half ranges, as a JSON table."""
    slopes = 1e-7 / np.cosh(wrenches) ** 2
    rows = [
        {"wrench": (1e3 * wrench).tolist(), "displacement": (1e-4 * np.tanh(wrench)).tolist()}
        | ({"compliance": np.diag(slope).tolist()} if tangents else {})
        for wrench, slope in zip(wrenches, slopes, strict=True)
    ]
    return orjson.dumps({"rows": rows}).decode()


def _tables() -> dict[str, str]:
    """1,000 rows an axis, which griddata answers from; 100 with tangents, which kriging does."""
    rng = np.random.default_rng(1)
    wrenches = np.zeros((3000, 6))
    for axis, loads in enumerate(((0, 4, 5), (1, 5, 3), (2, 3, 4))):
        block = wrenches[1000 * axis : 1000 * (axis + 1)]
        block[:, loads] = rng.uniform(-1, 1, (1000, 3))
        corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        block[np.ix_(range(8), loads)] = corners
    full = rng.uniform(-1, 1, (100, 6))
    return {"clean": _rows(wrenches, tangents=False), "solved": _rows(full, tangents=True)}


async def _bare_echo(receive: Receive, send: Send) -> None:
    """Answer with the body as the bare protocol does it: two messages and nothing else."""
    body = b""
    more = True
    while more:
        message = await receive()
        body, more = body + message.get("body", b""), message.get("more_body", False)
    length = str(len(body)).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", length)]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": body})


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A server of the application and of echoes, in one process, with two tables."""
    app = create_app(Settings(Path(tmp_path_factory.mktemp("workspace")), solvers=0))

    @app.post("/echo")
    async def echo(body: dict) -> dict:
        return body

    @app.post("/raw-echo")
    async def raw_echo(request: Request) -> Response:
        return Response(await request.body(), media_type="application/json")

    async def both(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] == BARE:
            await _bare_echo(receive, send)
        else:
            await app(scope, receive, send)

    bound = socket.create_server(("127.0.0.1", 0))
    port = bound.getsockname()[1]
    server = uvicorn.Server(uvicorn.Config(both, log_level="warning", access_log=False))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    thread.start()
    with Client(f"http://127.0.0.1:{port}") as client:
        deadline = time.monotonic() + 30
        while not client.is_ready() and time.monotonic() < deadline:
            time.sleep(0.05)
        load_range = {"force": [1000.0] * 3, "moment": [1000.0] * 3}
        for name, rows in _tables().items():
            client.add_component({"name": name, "title": "made up", "range": load_range})
            count = client.import_table(name, rows, format="json")["inserted"]
            while client.component(name)["rows"] < count and time.monotonic() < deadline + 120:
                time.sleep(0.5)
            print(f"\n{name}: {client.component(name)['coverage']['method']}", end="")
    yield port
    server.should_exit = True
    thread.join(20)


def _rate(connection: socket.socket, path: str) -> float:
    head = f"POST {path} HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
    request = f"{head}Content-Length: {len(BODY)}\r\n\r\n".encode() + BODY
    started = time.perf_counter()
    for _ in range(REQUESTS):
        connection.sendall(request)
        reply = connection.recv(65536)
        assert reply.startswith((b"HTTP/1.1 200", b"HTTP/1.1 202")), reply[:400]
        length = int(reply.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
        while len(reply) - reply.index(b"\r\n\r\n") - 4 < length:
            reply += connection.recv(65536)
    return REQUESTS / (time.perf_counter() - started)


def test_the_main_call_against_echoes(port: int) -> None:
    paths = {**QUERIES, "bare echo": BARE, "raw echo": "/raw-echo", "echo": "/echo"}
    rates: dict[str, list[float]] = {name: [] for name in paths}
    with socket.create_connection(("127.0.0.1", port)) as connection:
        for _ in range(ROUNDS):
            for name, path in paths.items():
                rates[name].append(_rate(connection, path))
    for name, found in rates.items():
        print(f"\n{name:>9}: {statistics.median(found):8.0f} requests/s", end="")
    for table, echo in product(QUERIES, ("bare echo", "raw echo", "echo")):
        ratios = [q / e for q, e in zip(rates[table], rates[echo], strict=True)]
        print(f"\n{table} / {echo}: {statistics.median(ratios):.2f} (median of rounds)", end="")
    print()
    assert min(rates["solved"]) > 0


def test_the_client_against_a_bare_http_client(port: int) -> None:
    bare = http.client.HTTPConnection("127.0.0.1", port)

    def round_trip(path: str) -> None:
        bare.request("POST", path, body=BODY, headers={"Content-Type": "application/json"})
        bare.getresponse().read()

    with Client(f"http://127.0.0.1:{port}") as client:
        ways = {
            "client": lambda: client.displacement("solved", FORCE, MOMENT, on_thin="estimate"),
            "http.client, same call": lambda: round_trip(QUERIES["solved"]),
            "http.client, bare echo": lambda: round_trip(BARE),
        }
        times: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(ROUNDS):
            for name, way in ways.items():
                for _ in range(REQUESTS // 4):
                    started = time.perf_counter()
                    way()
                    times[name].append(1e6 * (time.perf_counter() - started))
    bare.close()
    middle = {name: statistics.median(found) for name, found in times.items()}
    for name, found in middle.items():
        print(f"\n{name:>24}: p50 {found:6.0f} µs", end="")
    for name in list(ways)[1:]:
        print(f"\nclient / {name}: {middle['client'] / middle[name]:.2f}", end="")
    print()
    assert middle["client"] > 0
