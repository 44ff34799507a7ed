"""Eight client processes that query, import and solve at once; each answer is checked.

    make bench NAME=clients

The displacement is a linear function of the wrench, so every method must answer it exactly, however
many rows there are meanwhile; an answer that is off by more than its bar and rounding is a failure.
Each client asks 20 times a second: clients that ask without a pause measure their own queue.
"""

from __future__ import annotations

import multiprocessing
import time
from pathlib import Path

import numpy as np

from tests.benchmarks.test_live import Asking, added, as_csv, made_up
from tests.benchmarks.test_processes import serving
from wrenchbook.service.client import Client

CLIENTS, SECONDS, IDLE_SECONDS, PAUSE_S = 8, 60.0, 5.0, 0.05
# m and rad a unit of load, for the loads of made_up: each axis moves by its own three alone.
GAIN = 1e-6 * np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


def ask(address: str, seed: int, seconds: float, alone: bool) -> tuple[list[float], int, int]:
    """Return each query's seconds, how many rows were imported and how many wrenches solved."""
    rng, calls, imported, solved = np.random.default_rng(seed), [], 0, 0
    with Client(address, timeout=60) as client:
        ends, turn = time.monotonic() + seconds, 0
        while time.monotonic() < ends:
            turn += 1
            wrench = rng.uniform(-50, 50, 6)
            started = time.perf_counter()
            answer = client.displacement("big", wrench[:3], wrench[3:], on_thin="estimate")
            calls.append(time.perf_counter() - started)
            assert answer.translation is not None
            assert answer.rotation is not None
            result = np.concatenate([answer.translation, answer.rotation])
            np.testing.assert_allclose(result, GAIN @ wrench, atol=1e-12)
            if not alone and turn % 40 == seed:
                rows = rng.uniform(-60, 60, (10, 6))
                reported = client.import_table("big", as_csv(rows, rows @ GAIN))
                assert reported["inserted"] == 10
                imported += 10
            if not alone and turn % 200 == 20 * seed:
                force = [0.0, 0.0, -10.0 - seed - turn / 1000]
                done = client.displacement("bar", force, [0, 0, 0], on_thin="wait", wait_s=30)
                again = client.displacement("bar", force, [0, 0, 0], on_thin="wait", wait_s=30)
                assert done.translation is not None
                np.testing.assert_allclose(again.translation, done.translation, rtol=1e-6)
                solved += 1
            time.sleep(PAUSE_S)
    return calls, imported, solved


def test_eight_clients_at_once_get_right_answers_about_as_fast_as_one(tmp_path: Path) -> None:
    wrenches, _ = made_up(600)
    with serving(tmp_path, 1, solvers=1) as server:
        added(server.client, "big")
        reported = server.client.import_table("big", as_csv(wrenches, wrenches @ GAIN))
        with Asking(server.port, "big") as asking:
            asking.until(reported["table_version"], 60)
        address = f"http://127.0.0.1:{server.port}"
        with multiprocessing.get_context("spawn").Pool(CLIENTS) as pool:
            idle, _, _ = pool.apply(ask, (address, 0, IDLE_SECONDS, True))
            rows = server.client.component("big", wait_s=60)["rows"]
            results = pool.starmap(
                ask, [(address, seed, SECONDS, False) for seed in range(CLIENTS)]
            )
        calls = [item for each, _, _ in results for item in each]
        imported, solved = (sum(result[place] for result in results) for place in (1, 2))
        assert server.client.component("big", wait_s=60)["rows"] == rows + imported
    alone, together = np.percentile(idle, 99), np.percentile(calls, 99)
    print(
        f"\n{len(calls)} queries, {imported} rows imported, {solved} wrenches solved, all right; "
        f"p99 {1e3 * together:.1f} ms, idle {1e3 * alone:.1f} ms: {together / alone:.1f} x"
    )
