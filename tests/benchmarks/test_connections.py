"""The main call while others hold connections: idle ones, slow ones, and thousands that wait.

Printed; asserted is that nobody is turned away and that the server goes on answering.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import orjson
import pytest

from tests.benchmarks.test_live import serving
from tests.service.live import add_table, as_rows, clean_wrenches, full_wrenches, moved
from wrenchbook.service.client import Client
from wrenchbook.service.http.server import raise_open_files

IDLE, SLOW, POLLING = 200, 500, 2000
ASKED = 2000
BODY = orjson.dumps({"force": [50.0, 0.0, 0.0], "moment": [0.0, 2.0, 1.0], "on_thin": "estimate"})
QUESTION = (
    b"POST /v1/components/rig/displacement HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    b"Content-Type: application/json\r\nContent-Length: %d\r\n\r\n%b" % (len(BODY), BODY)
)
SLOW_HEAD = (
    b"POST /v1/components/rig/table HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/csv\r\n"
    b"Content-Length: 1000000\r\n\r\n"
)


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Client, int]]:
    """A server in a process of its own, with a table and a job that nobody solves."""
    raise_open_files()
    with serving(tmp_path) as (client, _, _):
        wrenches = np.concatenate([clean_wrenches(), full_wrenches(30)])
        add_table(client, "rig", as_rows(wrenches, moved(wrenches)))
        answer = client.displacement("bar", [0, 0, 1.0], on_thin="queue")
        assert answer.job is not None
        yield client, answer.job.id


def test_the_main_call_beside_idle_slow_and_polling_connections(
    served: tuple[Client, int],
) -> None:
    client, job = served
    address = ("127.0.0.1", int(client.url.rsplit(":", 1)[1]))
    alone = np.concatenate([_latencies(address) for _ in range(3)])
    polls = [socket.create_connection(address) for _ in range(POLLING)]
    for poll in polls:
        poll.sendall(b"GET /v1/jobs/%d?wait_s=600 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" % job)
    stop = threading.Event()
    others = threading.Thread(target=_hold, args=(address, stop), daemon=True)
    others.start()
    time.sleep(5)  # until all are at it: nothing tells
    beside = np.concatenate([_latencies(address) for _ in range(3)])
    stop.set()
    others.join(30)
    started = time.perf_counter()
    client.cancel(job)
    answered = sum(poll.recv(4096).startswith(b"HTTP/1.1 200") for poll in polls)
    lasted = time.perf_counter() - started
    for poll in polls:
        poll.close()
    for name, result in {"alone": alone, "beside": beside}.items():
        p50, p99 = 1e6 * np.quantile(result, [0.5, 0.99])
        print(f"\n{name:>7}: p50 {p50:6.0f} µs, p99 {p99:6.0f} µs", end="")
    ratio = np.quantile(beside, 0.99) / np.quantile(alone, 0.99)
    print(f"\np99 beside {IDLE} idle, {SLOW} slow, {POLLING} polling: {ratio:.2f} of alone")
    print(f"{answered} polls answered within {lasted:.1f} s of the job's end")
    assert answered == POLLING


def _latencies(address: tuple[str, int]) -> np.ndarray:
    """Return the seconds of each of many questions on one connection."""
    lasted = np.empty(ASKED)
    with socket.create_connection(address) as connection:
        for place in range(ASKED):
            started = time.perf_counter()
            connection.sendall(QUESTION)
            assert connection.recv(65536).startswith(b"HTTP/1.1 200")
            lasted[place] = time.perf_counter() - started
    return lasted


def _hold(address: tuple[str, int], stop: threading.Event) -> None:
    """Keep idle connections open, and slow ones that send a byte a second; renew what is closed."""
    idle = [socket.create_connection(address) for _ in range(IDLE)]
    slow = [_slow(address) for _ in range(SLOW)]
    while not stop.wait(1.0):
        for place, connection in enumerate(slow):
            try:
                connection.send(b"1")
            except OSError:
                slow[place] = _slow(address)
    for connection in (*idle, *slow):
        connection.close()


def _slow(address: tuple[str, int]) -> socket.socket:
    connection = socket.create_connection(address)
    connection.sendall(SLOW_HEAD)
    return connection
