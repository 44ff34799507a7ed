"""A server's start on a directory of built tables: seconds until ready, and memory.

    make bench NAME=start    COMPONENTS=20 ROWS=20000

Printed, not asserted beyond sanity: the numbers depend on what else the machine does. The first
start builds every table; the second one maps the packed files.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.benchmarks.test_live import SPAN, made_up, serving
from tests.service.ledger_rows import NewRow, insert
from wrenchbook.service.client import Client
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.library import Library

COMPONENTS = int(os.environ.get("COMPONENTS", "4"))
ROWS = int(os.environ.get("ROWS", "5000"))
WRENCH = [120.0, -80.0, -700.0], [15.0, 25.0, 4.0]
FULL = 0.1  # of the rows: full wrenches; the others are clean


def rows_of(seed: int) -> list[NewRow]:
    """Return rows of a smooth response, clean ones and full ones."""
    rng, count = np.random.default_rng(seed), int(FULL * ROWS)
    wrenches, _ = made_up(ROWS - count, seed)
    wrenches = np.concatenate((wrenches, rng.uniform(-SPAN, SPAN, (count, 6))))
    loads = wrenches / SPAN
    moved = 1e-4 * np.tanh(loads) + 1e-5 * np.roll(loads, 1, axis=1) * loads
    pairs = zip(wrenches.tolist(), moved.tolist(), strict=True)
    return [NewRow(tuple(wrench), tuple(displacement)) for wrench, displacement in pairs]


def filled(folder: Path) -> None:
    """Make a data directory of components whose rows are in the ledger alone."""
    ledger = Ledger(folder / "ledger.sqlite")
    library = Library(folder / "components", folder / "none")
    span = [[-SPAN, SPAN]] * 3
    for number in range(COMPONENTS):
        library.add_table_only(
            name=f"part{number}", title="made up", range={"force": span, "moment": span}
        )
        insert(ledger, f"part{number}", "", rows_of(number))
    ledger.close()


@contextmanager
def started(folder: Path, processes: int) -> Iterator[tuple[Client, psutil.Process, float]]:
    """Serve a folder; give a client, the process and the seconds until all tables answer.

    With several processes the first one that answers tells that.
    """
    began = time.perf_counter()
    with serving(folder, "--processes", str(processes)) as (client, _, pid):
        while client.call_json("GET", "/health/ready")["building"]:
            time.sleep(0.02)
        yield client, psutil.Process(pid), time.perf_counter() - began


@pytest.mark.timeout(1800)
def test_a_second_start_maps_what_the_first_has_built(tmp_path: Path) -> None:
    given = os.environ.get("DATA")
    folder = Path(given) if given else tmp_path
    if not (folder / "ledger.sqlite").exists():
        filled(folder)
    answers = []
    for name, processes in (("first", 1), ("second", 1), ("of two processes", 2)):
        with started(folder, processes) as (client, server, seconds):
            family = [server, *server.children(recursive=True)]
            used = sum(sum(item.cpu_times()[:2]) for item in family)
            memory = [item.memory_info() for item in family]
            private = [item.memory_full_info().uss for item in family]
            results = [
                client.displacement(
                    f"part{number}", [120, -80, -700], [15, 25, 4], on_thin="estimate"
                )
                for number in range(COMPONENTS)
            ]
            answers.append([(result.translation.tolist(), result.coverage) for result in results])
            sizes = ", ".join(
                f"{one.rss / 1e6:.0f} MB resident ({own / 1e6:.0f} MB its own)"
                for one, own in zip(memory, private, strict=True)
            )
            print(f"\n{name} start: {seconds:.1f} s, {used:.1f} s of processor time", end="")
            print(f"; {sizes}", end="")
    size = sum(path.stat().st_size for path in (folder / "tables").glob("*.wbt"))
    print(f"\n{COMPONENTS} components of {ROWS} rows, packed {size / 1e6:.0f} MB")
    assert answers[0] == answers[1] == answers[2]
