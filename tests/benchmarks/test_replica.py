"""A lost machine ten times, and a read-only server beside its main server.

make bench NAME=replica
"""

from __future__ import annotations

import shutil
import socket
import statistics
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.benchmarks import test_live as live
from tests.benchmarks.test_http import _tables
from tests.benchmarks.test_live import added, as_csv, made_up
from tests.benchmarks.test_processes import ASKED, CONNECTIONS, REQUESTS, Served, rate, request
from wrenchbook.service.client import ProblemError
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ops.restore import restore

LOSSES, INTERVAL_S, LIVED_S, ROUNDS = 10, 2.0, 5.0, 15


def a_row(number: int) -> dict[str, list[float]]:
    loads = (np.random.default_rng(number).uniform(-1, 1, 6) * 900).tolist()
    return {"wrench": loads, "displacement": [1e-9 * load for load in loads]}


@pytest.mark.timeout(900)
def test_a_lost_machine_costs_at_most_the_rows_of_the_last_interval(tmp_path: Path) -> None:
    gaps = []
    for number in range(LOSSES):
        folder, url, acknowledged = tmp_path / "data", f"file://{tmp_path}/replica{number}", []
        words = "--replicate", url, "--replicate-interval", str(INTERVAL_S)
        with live.serving(folder, *words) as (client, _, pid):
            added(client, "solved")
            begun = time.monotonic()
            while time.monotonic() - begun < LIVED_S + 0.37 * number:
                client.append("solved", "run", a_row(len(acknowledged)))
                acknowledged.append(time.time())
            processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
            killed = time.time()
            for process in processes:
                process.kill()
            psutil.wait_procs(processes)
        shutil.rmtree(folder)
        manifest, _ = restore(url, folder)
        state, ledger = manifest.state, Ledger(folder / "ledger.sqlite")
        rows = ledger.count_rows("solved")
        ledger.close()
        shutil.rmtree(folder)
        assert rows == state["rows"] == state["last_row"]
        assert rows >= sum(when <= state["created"] for when in acknowledged)
        lost = acknowledged[rows:]
        gaps.append(killed - lost[0] if lost else 0.0)
        print(
            f"\n{len(acknowledged)} rows acknowledged, {rows} restored (up to {state['last_row']}, "
            f"state {killed - state['created']:.2f} s before the kill); the oldest lost one was "
            f"acknowledged {gaps[-1]:.2f} s before it",
            end="",
        )
    print(f"\nlost at most the last {max(gaps):.2f} s; the interval is {INTERVAL_S} s")
    assert max(gaps) <= INTERVAL_S


@pytest.mark.timeout(600)
def test_a_read_only_server_answers_as_often_as_its_main_server(tmp_path: Path) -> None:
    url = f"file://{tmp_path}/replica"
    words = "--replicate", url, "--replicate-interval", str(INTERVAL_S)
    with live.serving(tmp_path / "main", *words) as main:
        added(main[0], "solved")
        version = main[0].import_table("solved", _tables()["solved"], "json")["table_version"]
        with live.serving(tmp_path / "reader", "--read-only", url) as reader:
            servers = Served(*main), Served(*reader)
            wait_for(servers[1], version)
            answers = [server.client.displacement("solved", *ASKED.values()) for server in servers]
            first, second = ({**answer.raw, "elapsed_us": 0} for answer in answers)
            assert first == second
            connections = [
                [socket.create_connection(("127.0.0.1", server.port)) for _ in range(CONNECTIONS)]
                for server in servers
            ]
            rates: tuple[list[float], list[float]] = [], []
            used = [0.0, 0.0]
            for number in range(2 * ROUNDS):
                which = number % 2
                before = servers[which].seconds()
                rates[which].append(rate(connections[which], request()))
                used[which] += servers[which].seconds() - before
            for connection in (*connections[0], *connections[1]):
                connection.close()
            stale = []
            added(main[0], "big")
            main[0].import_table("big", as_csv(*made_up(300)))
            for number in range(10):
                row = as_csv(np.array([[10.0 + number, 0, 0, 0, 1, 2]]), np.full((1, 6), 1e-7))
                version = main[0].import_table("big", row)["table_version"]  # it answers there
                begun = time.monotonic()
                wait_for(servers[1], version, "big")
                stale.append(time.monotonic() - begun)
    ratios = [b / a for a, b in zip(*rates, strict=True)]
    for name, result, seconds in zip(("main", "read-only"), rates, used, strict=True):
        us = 1e6 * seconds / ROUNDS / REQUESTS
        print(f"\n{name}: {statistics.median(result):.0f} requests/s, {us:.0f} us of processor")
    print(f"read-only over main: median {statistics.median(ratios):.2f}")
    print(f"stale after a row: median {statistics.median(stale):.2f} s, most {max(stale):.2f} s")
    assert max(stale) <= 2 * INTERVAL_S


def wait_for(server: Served, version: int, name: str = "solved") -> None:
    """Wait until a read-only server answers from a version."""
    while True:
        try:
            answer = server.client.displacement(name, *ASKED.values(), on_thin="estimate")
        except ProblemError:  # the component is not there yet
            time.sleep(0.1)
            continue
        if answer.table_version >= version:
            return
        time.sleep(0.01)
