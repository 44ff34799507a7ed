"""A server of several processes beside one of one: queries a second, new rows, builds, memory.

    make bench NAME=processes

Both servers run all the time and are asked in turn, so that a busy machine slows both alike. What
two processes can do beside one shows only where two cores are free, and the asking takes its share
of them: the processor time of a request is printed as well, which tells what they would do.
"""

from __future__ import annotations

import os
import selectors
import socket
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import orjson
import psutil
import pytest

from tests.benchmarks import test_live as live
from tests.benchmarks.test_http import _tables
from tests.benchmarks.test_live import (
    Asking,
    added,
    as_csv,
    made_up,
    told,
)
from wrenchbook.service.client import Client

ROUNDS, REQUESTS, CONNECTIONS, PROCESSES = 15, 4000, 16, 2
ASKED = {"force": [120.0, -80.0, -700.0], "moment": [15.0, 25.0, 4.0]}


class Served:
    """A server, its client, and what its processes have used."""

    def __init__(self, client: Client, port: int, pid: int) -> None:
        self.root, self.port, self.client = psutil.Process(pid), port, client

    def processes(self) -> list[psutil.Process]:
        return [self.root, *self.root.children(recursive=True)]

    def seconds(self) -> float:
        """Return the processor time used so far, s."""
        return sum(sum(process.cpu_times()[:2]) for process in self.processes())

    def memory(self) -> list[tuple[str, float, float]]:
        """Return each process' memory, MB: what no file is behind, and with its share of files."""
        results = []
        for process in self.processes():
            name = process.name()
            text = Path(f"/proc/{process.pid}/smaps_rollup").read_text()
            own, whole = (int(text.split(f"{key}:")[1].split()[0]) for key in ("Anonymous", "Pss"))
            results.append((name, own / 1e3, whole / 1e3))
        return results


@contextmanager
def serving(folder: Path, processes: int, solvers: int = 0) -> Iterator[Served]:
    words = ["--solvers", str(solvers), "--processes", str(processes)]
    with live.serving(folder, *words) as started:
        yield Served(*started)


def ready(client: Client, version: int) -> None:
    """Wait until each process answers from a version, and quickly."""
    quick, deadline = 0, time.monotonic() + 60
    while quick < 20 and time.monotonic() < deadline:
        client.close()  # the next one meets whichever process takes it
        answer = client.displacement("solved", *ASKED.values(), on_thin="estimate")
        there = answer.table_version == version and answer.coverage == "covered"
        quick = quick + 1 if there and (answer.elapsed_us or 0) < 400 else 0
        time.sleep(0.02)
    assert quick


def request() -> bytes:
    body = orjson.dumps(ASKED)
    head = "POST /v1/components/solved/displacement HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    return (
        f"{head}Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n".encode()
        + body
    )


def rate(connections: list[socket.socket], asked: bytes) -> float:
    """Return the replies a second, with one question on each connection all the time."""
    watched = selectors.DefaultSelector()
    for connection in connections:
        watched.register(connection, selectors.EVENT_READ)
    started, count = time.perf_counter(), 0
    for connection in connections:
        connection.sendall(asked)
    while count < REQUESTS:
        for key, _ in watched.select(10):
            reply = key.fileobj.recv(65536)  # pyright: ignore[reportAttributeAccessIssue]
            assert reply.startswith(b"HTTP/1.1 200"), reply[:300]
            count += 1
            if count <= REQUESTS - len(connections):
                key.fileobj.sendall(asked)  # pyright: ignore[reportAttributeAccessIssue]
            if count == REQUESTS:
                break
    watched.close()
    return REQUESTS / (time.perf_counter() - started)


@pytest.mark.timeout(600)
def test_queries_a_second_of_one_and_of_two_processes(tmp_path: Path) -> None:
    with serving(tmp_path / "one", 1) as one, serving(tmp_path / "two", PROCESSES) as two:
        both, rates, used, answers = (one, two), ([], []), [0.0, 0.0], []
        for server in both:
            added(server.client, "solved")
            version = server.client.import_table("solved", _tables()["solved"], "json")[
                "table_version"
            ]
            ready(server.client, version)
            results = server.client.displacement("solved", *ASKED.values())
            answers.append({**results.raw, "elapsed_us": 0})
        assert answers[0] == answers[1]
        open_ones = [
            [socket.create_connection(("127.0.0.1", server.port)) for _ in range(CONNECTIONS)]
            for server in both
        ]
        for number in range(2 * ROUNDS):
            which = number % 2
            before = both[which].seconds()
            rates[which].append(rate(open_ones[which], request()))
            used[which] += both[which].seconds() - before
        established = [
            sum(results.status == psutil.CONN_ESTABLISHED for results in process.net_connections())
            for process in two.processes()
            if process.name() == "wb-webworker"
        ]
        for connection in (*open_ones[0], *open_ones[1]):
            connection.close()
        each = [1e6 * seconds / ROUNDS / REQUESTS for seconds in used]
        ratios = [b / a for a, b in zip(*rates, strict=True)]
        for name, results, us in zip(("one", "two"), rates, each, strict=True):
            print(
                f"\n{name}: {statistics.median(results):.0f} requests/s, {us:.0f} µs of processor",
                end="",
            )
        print(
            f"\ntwo over one: median {statistics.median(ratios):.2f}, best {max(ratios):.2f} "
            f"(connections {established}; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f})"
        )
        assert min(min(results) for results in rates) > 0


@pytest.mark.timeout(600)
@pytest.mark.parametrize("processes", [1, PROCESSES])
def test_a_new_row_and_p99_while_10000_rows_an_axis_are_built(
    tmp_path: Path, processes: int
) -> None:
    rows = as_csv(*made_up(30_000))
    with serving(tmp_path, processes) as server:
        client = server.client
        added(client, "big")
        version = client.import_table("big", rows)["table_version"]
        with Asking(server.port, "big") as asking:
            asking.until(version, 240)
        time.sleep(5)  # its file is written
        with Asking(server.port, "big") as asking:
            told(f"{processes} process(es), idle", asking.idle(1000))
        for number in range(4):
            row = as_csv(np.array([[10.0 + number, 0, 0, 0, 1, 2]]), np.full((1, 6), 1e-7))
            before = server.seconds()
            version = client.import_table("big", row)["table_version"]
            calls, seconds = asked_until(server, version)
            told("while built", calls)
            used = server.seconds() - before
            print(f"; in use by all after {seconds:.2f} s, {used:.2f} s of processor time", end="")
        for name, own, shared in server.memory():
            print(
                f"\n{name}: {own:.0f} MB of its own, {shared:.0f} MB with its share of files",
                end="",
            )
        print(f"\nload {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def asked_until(server: Served, version: int) -> tuple[list[float], float]:
    """Ask on six connections until each answers from a version; return each call's seconds."""
    started, calls = time.perf_counter(), []
    left = [Asking(server.port, "big") for _ in range(6)]
    while left:
        seconds, reply = left[0].once()
        calls.append(seconds)
        if reply["table_version"] >= version:
            left.pop(0).__exit__()
        else:
            left.append(left.pop(0))
            time.sleep(0.002)
    return calls, time.perf_counter() - started
