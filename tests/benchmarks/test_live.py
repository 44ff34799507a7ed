"""Live tables of a real server: imports, memory, and answers while a large table is built.

Printed, not asserted beyond sanity: the numbers depend on what else the machine does.
"""

from __future__ import annotations

import os
import socket
import statistics
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import orjson
import pytest

from tests.service.table_files import write_hdf5
from wrenchbook.service.client import Client
from wrenchbook.service.files.program import child_command
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import LoadRange, Rows

AXES = ((0, 4, 5), (1, 5, 3), (2, 3, 4))
ASKED = {"force": [120.0, -80.0, -700.0], "moment": [15.0, 25.0, 4.0], "on_thin": "estimate"}
BODY = orjson.dumps(ASKED)
SPAN = 1000.0
HEADER = (
    "fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],"
    "ux [m],uy [m],uz [m],rx [rad],ry [rad],rz [rad]"
)


def made_up(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return wrenches and displacements, a third of them clean for each axis."""
    rng, each = np.random.default_rng(seed), count // 3
    wrenches = np.zeros((3 * each, 6))
    corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    for axis, loads in enumerate(AXES):
        block = wrenches[each * axis : each * (axis + 1)]
        block[:, loads] = rng.uniform(-1, 1, (each, 3))
        block[np.ix_(range(8), loads)] = corners
    return SPAN * wrenches, 1e-4 * np.tanh(wrenches)


def as_csv(wrenches: np.ndarray, displacements: np.ndarray) -> str:
    numbers = np.column_stack((wrenches, displacements)).tolist()
    return "\n".join([HEADER, *(",".join(map(repr, line)) for line in numbers)]) + "\n"


def as_hdf5(wrenches: np.ndarray, displacements: np.ndarray) -> bytes:
    rows = Rows.of(wrenches, displacements, source=["measured"] * len(wrenches))
    bound = np.full(6, SPAN)
    return write_hdf5(rows, rows.seq.tolist(), TableMeta("big", 0, LoadRange(-bound, bound)))


@contextmanager
def serving(folder: Path, *texts: str) -> Iterator[tuple[Client, int, int]]:
    """Serve a folder in a process of its own; give a client, its port and the process' number."""
    command = child_command(
        "wrenchbook.service.cli.main", "serve", "--data", str(folder), "--port", "0"
    )
    server = subprocess.Popen(
        [*command, "--solvers", "0", "--log-level", "warning", *texts],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    try:
        address = server.stdout.readline().rsplit(maxsplit=1)[-1]
        with Client(address, timeout=300) as client:
            while not client.is_ready():
                time.sleep(0.02)
            yield client, int(address.rsplit(":", 1)[1]), server.pid
    finally:
        server.terminate()
        server.wait(120)
        server.stdout.close()


def added(client: Client, name: str) -> None:
    load_range = {"force": [SPAN] * 3, "moment": [SPAN] * 3}
    client.add_component({"name": name, "title": "made up", "range": load_range})


def waited(port: int, name: str, version: int, limit: float = 240) -> float:
    """Return the seconds until a version of a table answers."""
    with Asking(port, name) as asking:
        return asking.until(version, limit)[1]


class Asking:
    """One keep-alive connection that asks one table again and again."""

    def __init__(self, port: int, name: str) -> None:
        self._connection = socket.create_connection(("127.0.0.1", port))
        head = f"POST /v1/components/{name}/displacement HTTP/1.1\r\nHost: 127.0.0.1\r\n"
        head += f"Content-Type: application/json\r\nContent-Length: {len(BODY)}\r\n\r\n"
        self._request = head.encode() + BODY

    def __enter__(self) -> Asking:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def once(self) -> tuple[float, dict]:
        """Return the seconds of one call and its reply."""
        started = time.perf_counter()
        self._connection.sendall(self._request)
        reply = self._connection.recv(65536)
        head, _, body = reply.partition(b"\r\n\r\n")
        length = int(head.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
        while len(body) < length:
            body += self._connection.recv(65536)
        return time.perf_counter() - started, orjson.loads(body)

    def until(self, version: int, limit: float) -> tuple[list[float], float]:
        """Ask until a version answers; return each call's seconds, and when that was."""
        started, seconds = time.perf_counter(), []
        while time.perf_counter() - started < limit:
            took, reply = self.once()
            if reply.get("table_version", 0) >= version:
                break
            seconds.append(took)
            time.sleep(0.002)
        return seconds, time.perf_counter() - started

    def idle(self, calls: int = 1500) -> list[float]:
        results = []
        for _ in range(calls):
            results.append(self.once()[0])
            time.sleep(0.002)
        return results


def told(name: str, seconds: list[float]) -> None:
    p50, p99 = statistics.median(seconds), np.percentile(seconds, 99)
    most = max(seconds)
    print(
        f"\n{name}: {len(seconds)} calls, ms: median {1e3 * p50:.2f}, p99 {1e3 * p99:.2f}", end=""
    )
    print(f", most {1e3 * most:.1f}", end="")


def peak_mb(pid: int) -> float:
    """Return the most memory a process has held, MB."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1e3


@pytest.mark.timeout(420)
def test_answers_while_a_table_of_10000_rows_an_axis_is_built(tmp_path: Path) -> None:
    rows = as_csv(*made_up(30_000))
    with serving(tmp_path) as (client, port, pid):
        added(client, "big")
        started = time.perf_counter()
        reply = client.import_table("big", rows)
        print(f"\n30,000 rows: acknowledged {time.perf_counter() - started:.1f} s", end="")
        waited(port, "big", reply["table_version"])
        print(f", in use {time.perf_counter() - started:.1f} s", end="")
        time.sleep(5)  # its file is written
        with Asking(port, "big") as big:
            told("idle", big.idle())
            for number in range(3):
                one = as_csv(np.array([[10.0 + number, 0, 0, 0, 1, 2]]), np.full((1, 6), 1e-7))
                version = client.import_table("big", one, wait_s=0)["table_version"]
                calls, seconds = big.until(version, 60)
                told("while built", calls)
                print(f"; a new row is in use after {seconds:.2f} s", end="")
        added(client, "small")
        version = client.import_table("big", as_csv(*made_up(24, 5)))["table_version"]
        version = client.import_table("small", as_csv(*made_up(24, 6)))["table_version"]
        print(f"\na small table beside it: {waited(port, 'small', version):.2f} s")
        print(f"peak memory {peak_mb(pid):.0f} MB")
    started = time.perf_counter()
    with serving(tmp_path) as (client, port, _):
        waited(port, "small", version)
        print(f"restart: the small table answers after {time.perf_counter() - started:.1f} s")
        waited(port, "big", 1)
        print(f"restart: the large one after {time.perf_counter() - started:.1f} s")


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", ["csv", "hdf5"])
def test_an_import_of_100000_rows(tmp_path: Path, kind: str) -> None:
    count = int(os.environ.get("ROWS", "100000"))
    content = (as_csv if kind == "csv" else as_hdf5)(*made_up(count))
    with serving(tmp_path) as (client, port, pid):
        added(client, "big")
        idle = peak_mb(pid)
        started = time.perf_counter()
        reply = client.import_table("big", content, format=kind)
        acknowledged, at_import = time.perf_counter() - started, peak_mb(pid)
        waited(port, "big", reply["table_version"])
        seconds = time.perf_counter() - started
        print(f"\n{count} rows of {kind}, {len(content) / 1e6:.0f} MB: acknowledged", end="")
        print(f" {acknowledged:.1f} s ({at_import:.0f} MB; started with {idle:.0f})", end="")
        print(f", in use {seconds:.1f} s, {peak_mb(pid):.0f} MB")
        assert reply["inserted"] > 0.99 * count
