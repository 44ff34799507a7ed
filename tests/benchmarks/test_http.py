"""Requests per second of the main call against an echo, and the client's time against http.client.

Echo and tables, of 100 solves and of 3,000 measured rows, are served by one process, and asked in
turn, many short rounds each, so that a noisy machine slows all alike: on one keep-alive connection,
and on eight that keep the server busy.
Printed, not asserted beyond sanity.
"""

import http.client
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import orjson
import pytest

from tests.benchmarks.echo_server import BARE
from wrenchbook.service.client import Client

ROUNDS, REQUESTS, BUSY = 15, 400, 8
FORCE, MOMENT = [120.0, -80.0, -700.0], [15.0, 25.0, 4.0]
CLEAN_FORCE, CLEAN_MOMENT = [120.0, 0.0, 0.0], [0.0, 25.0, 4.0]
BODY = orjson.dumps({"force": FORCE, "moment": MOMENT})
CLEAN = orjson.dumps({"force": CLEAN_FORCE, "moment": CLEAN_MOMENT})
SOLVED = "/v1/components/solved/displacement"
WAYS = {
    "echo": (BARE, BODY),
    "kriging": (SOLVED, BODY),
    "kriging, 3,000 rows": ("/v1/components/clean/displacement", CLEAN),
}


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
    """100 rows of solves with tangents; 3,000 measured rows, 1,000 of each axis."""
    rng = np.random.default_rng(1)
    wrenches = np.zeros((3000, 6))
    for axis, loads in enumerate(((0, 4, 5), (1, 5, 3), (2, 3, 4))):
        block = wrenches[1000 * axis : 1000 * (axis + 1)]
        block[:, loads] = rng.uniform(-1, 1, (1000, 3))
        corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        block[np.ix_(range(8), loads)] = corners
    full = rng.uniform(-1, 1, (100, 6))
    return {"clean": _rows(wrenches, tangents=False), "solved": _rows(full, tangents=True)}


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A server of the application and of the echo, with two tables that cover what is asked."""
    command = [sys.executable, "-m", "tests.benchmarks.echo_server"]
    folder = tmp_path_factory.mktemp("workspace")
    server = subprocess.Popen([*command, str(folder)], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        port = int(server.stdout.readline())
        with Client(f"http://127.0.0.1:{port}") as client:
            _fill(client)
        yield port
    finally:
        server.terminate()
        server.wait(30)
        server.stdout.close()


def _fill(client: Client) -> None:
    """Load the tables, and wait until they answer quickly."""
    deadline = time.monotonic() + 120
    while not client.is_ready() and time.monotonic() < deadline:
        time.sleep(0.05)
    load_range = {"force": [1000.0] * 3, "moment": [1000.0] * 3}
    for name, rows in _tables().items():
        client.add_component({"name": name, "title": "made up", "range": load_range})
        version = client.import_table(name, rows, format="json")["table_version"]
        while client.component(name)["table_version"] < version and time.monotonic() < deadline:
            time.sleep(0.5)
    lasting = [np.inf]
    while min(lasting) > 60 and time.monotonic() < deadline:  # µs
        time.sleep(0.2)
        asked = [client.displacement("solved", FORCE, MOMENT) for _ in range(20)]
        lasting = [answer.elapsed_us for answer in asked if answer.elapsed_us]


def _request(path: str, body: bytes) -> bytes:
    head = f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    return f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body


def _receive(connection: socket.socket) -> bytes:
    reply = connection.recv(65536)
    assert reply.startswith(b"HTTP/1.1 200"), reply[:400]
    length = int(reply.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
    while len(reply) - reply.index(b"\r\n\r\n") - 4 < length:
        reply += connection.recv(65536)
    return reply


def _rate(connections: list[socket.socket], request: bytes) -> float:
    """Return the replies a second, with one question on each connection all the time."""
    started = time.perf_counter()
    for connection in connections:
        connection.sendall(request)
    for count in range(REQUESTS):
        connection = connections[count % len(connections)]
        _receive(connection)
        if count < REQUESTS - len(connections):
            connection.sendall(request)
    return REQUESTS / (time.perf_counter() - started)


@pytest.mark.parametrize("count", [1, BUSY])
def test_the_main_call_against_an_echo(port: int, count: int) -> None:
    rates: dict[str, list[float]] = {name: [] for name in WAYS}
    connections = [socket.create_connection(("127.0.0.1", port)) for _ in range(count)]
    for name, (path, body) in WAYS.items():
        if name != "echo":
            connections[0].sendall(_request(path, body))
            assert b'"coverage":"covered"' in (reported := _receive(connections[0])), reported
            assert b'"method":"%b"' % name.partition(",")[0].encode() in reported, reported
    for _ in range(ROUNDS):
        for name, (path, body) in WAYS.items():
            rates[name].append(_rate(connections, _request(path, body)))
    for connection in connections:
        connection.close()
    print(f"\n{count} connection(s)", end="")
    for name, results in rates.items():
        ratios = [rate / echo for rate, echo in zip(results, rates["echo"], strict=True)]
        reported = f"{statistics.median(results):8.0f} requests/s"
        print(f"\n{name:>19}: {reported}, {statistics.median(ratios):.2f} of the echo", end="")
    print()
    assert min(map(min, rates.values())) > 0


def test_the_client_against_a_bare_http_client(port: int) -> None:
    bare = http.client.HTTPConnection("127.0.0.1", port)

    def round_trip(path: str) -> None:
        bare.request("POST", path, body=BODY, headers={"Content-Type": "application/json"})
        bare.getresponse().read()

    with Client(f"http://127.0.0.1:{port}") as client:
        ways = {
            "client": lambda: client.displacement("solved", FORCE, MOMENT),
            "http.client, same call": lambda: round_trip(SOLVED),
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
    middle = {name: statistics.median(result) for name, result in times.items()}
    for name, result in middle.items():
        print(f"\n{name:>24}: p50 {result:6.0f} µs", end="")
    for name in list(ways)[1:]:
        print(f"\nclient / {name}: {middle['client'] / middle[name]:.2f}", end="")
    print()
    assert middle["client"] > 0
