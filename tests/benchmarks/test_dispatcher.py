"""How many jobs a second one dispatcher serves, with 1,000 workers that only wait.

Each job is claimed, gets its folder, is submitted, ends after 2 to 4 s as at a distant worker, and
is committed with its row; ledger and files are real ones on this disk. One core for all of it: the
workers' part, writing 1,000 outcomes durably, is in the same process and counted against it.

    make bench NAME=dispatcher
"""

import os
import random
import time

import pytest

from tests.service.simulated import SimulatedEngine
from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.ledger import Ledger

WORKERS = 1000
JOBS = 5000


@pytest.mark.timeout(300)
def test_a_thousand_workers_are_served_at_200_jobs_a_second_on_one_core(tmp_path):
    if hasattr(os, "sched_setaffinity"):
        usable = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(usable)})
    chance = random.Random(1)
    ledger = Ledger(tmp_path / "ledger.sqlite")
    ledger.accept_many("bar", "f1", [(float(load), 0, 0, 0, 0, 0) for load in range(JOBS)])
    engine = SimulatedEngine(WORKERS, lambda _: chance.uniform(2.0, 4.0))
    dispatcher = Dispatcher(ledger, engine, lambda name: tmp_path / name, tmp_path / "jobs")
    started, used = time.monotonic(), time.process_time()
    most = 0
    dispatcher.start()
    try:
        while (counts := ledger.counts())["done"] < JOBS:
            most = max(most, counts["running"])
            assert time.monotonic() - started < 240, counts
            time.sleep(0.25)
        seconds, used = time.monotonic() - started, time.process_time() - used
    finally:
        dispatcher.stop()
        engine.close()
        ledger.close()
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, usable)
    print(
        f"\n{JOBS} jobs on {WORKERS} simulated workers of 3 s ({WORKERS / 3:.0f} jobs/s at most): "
        f"{JOBS / seconds:.0f} jobs/s, {1e3 * used / JOBS:.2f} ms of processor time a job "
        f"({JOBS / used:.0f} jobs a core-second), at most {most} at once"
    )
    assert most <= WORKERS
    assert len(engine.submitted) == JOBS
    assert JOBS / used >= 200


def test_an_idle_dispatcher_costs_next_to_nothing(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    engine = SimulatedEngine(2, lambda _: 0.0)
    dispatcher = Dispatcher(ledger, engine, lambda name: tmp_path / name, tmp_path / "jobs")
    dispatcher.start()
    time.sleep(0.1)
    before = time.process_time()
    time.sleep(0.5)
    assert time.process_time() - before < 0.05
    dispatcher.stop()
    engine.close()
    ledger.close()
