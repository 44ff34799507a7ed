"""Imports of a real server: seconds until rows answer, until a million are acknowledged, memory.

Meanwhile another process writes into the same ledger, and the longest it waited is printed.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from pathlib import Path

from tests.benchmarks.test_live import added, as_csv, made_up, serving, waited
from wrenchbook.service.ledger import Ledger

CORNERS = 24  # of three axes: every table that is made up has the same
PAUSE_S = 0.02  # between two writes into the ledger


class Beside:
    """Writes one job after the other into the ledger, and samples the server's memory."""

    def __init__(self, folder: Path, pid: int) -> None:
        self._ledger, self._pid = Ledger(folder / "ledger.sqlite"), pid
        self._ended = threading.Event()
        self.waits: list[float] = []
        self.memory = 0
        self._threads = [threading.Thread(target=item) for item in (self._write, self._watch)]

    def __enter__(self) -> Beside:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()
        self._ledger.close()

    def _write(self) -> None:
        number = 0
        while not self._ended.wait(PAUSE_S):
            number += 1
            started = time.perf_counter()
            self._ledger.accept("plate", "beside", (float(number), 0, 0, 0, 0, 0))
            self.waits.append(time.perf_counter() - started)

    def _watch(self) -> None:
        while not self._ended.wait(0.1):
            self.memory = max(self.memory, sum(map(_pss, _family(self._pid))))


def _family(pid: int) -> list[int]:
    """Return a process and all below it."""
    results = [pid]
    for task in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = task.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(words[1]) in results:
            results.append(int(task.parent.name))
    return results


def _pss(pid: int) -> int:
    """Return the bytes a process holds, what it shares counted in parts."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


@contextmanager
def timed(what: str):
    started = time.perf_counter()
    yield
    print(f"{what}: {time.perf_counter() - started:.1f} s")


def test_a_hundred_thousand_rows_are_in_use_and_a_million_acknowledged(tmp_path):
    content = as_csv(*made_up(100_000)).encode()
    with serving(tmp_path / "data") as (client, port, pid):
        added(client, "hundred")
        added(client, "million")
        client.import_table("million", as_csv(*made_up(24, 3)).encode())  # its readers are there
        started = time.perf_counter()
        reply = client.import_table("hundred", content)
        acknowledged = time.perf_counter() - started
        waited(port, "hundred", reply["table_version"])
        in_use = time.perf_counter() - started
        print(f"\n100,000 rows: acknowledged {acknowledged:.1f} s, in use {in_use:.1f} s")
        content = as_csv(*made_up(1_000_000, 2)).encode()
        with Beside(tmp_path / "data", pid) as beside:
            started = time.perf_counter()
            reply = client.import_table("million", content)
            acknowledged = time.perf_counter() - started
        waits = sorted(beside.waits)
        print(
            f"{reply['inserted']:,} rows, {len(content) >> 20} MB: acknowledged {acknowledged:.1f} "
            f"s, server and readers {beside.memory >> 20} MB; a write beside it waited "
            f"{1e3 * waits[len(waits) // 2]:.0f} ms in the middle, {1e3 * waits[-1]:.0f} ms at most"
        )
    assert reply["rows"]["loaded"] == reply["rows"]["read"]
    assert reply["inserted"] == reply["rows"]["read"] - CORNERS  # the first 24 rows had them
