"""Who takes over whose attempts: engines, heartbeats, dispatchers that are late."""

import os
import secrets
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.attempts import wait_for_sweeps
from tests.service.conftest import SOLVERS
from tests.service.ledger_rows import stored
from tests.service.simulated import SimulatedEngine
from tests.until import until
from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs.attempt import LOCK, attempt_folder
from wrenchbook.service.jobs.dispatcher import Dispatcher, Lease
from wrenchbook.service.ledger import Beat, Ledger

HERE = Path(__file__).parent


class Bench:
    """A ledger and dispatchers of simulated engines on it."""

    def __init__(self, folder):
        self.folder = folder
        self.ledger = Ledger(folder / "ledger.sqlite")
        self.started = []

    def start(self, name="far", seconds=0.05, slots=10, **options):
        engine = SimulatedEngine(slots, lambda _: seconds, name)
        dispatcher = Dispatcher(
            self.ledger, engine, lambda name: self.folder, self.folder / "jobs", **options
        )
        self.started.append((dispatcher, engine))
        dispatcher.start()
        return dispatcher, engine

    def accept(self, load=1.0):
        return self.ledger.accept("bar", "f1", (load, 0, 0, 0, 0, 0))[0]

    def until(self, job, **wanted):
        def as_wanted():
            now = self.ledger.job(job.id)
            return all(getattr(now, name) == value for name, value in wanted.items())

        until(as_wanted)
        return self.ledger.job(job.id)

    def close(self):
        for dispatcher, engine in self.started:
            dispatcher.stop()
            engine.close()
        self.ledger.close()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.RECOVER_SECONDS", 0.1)
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def beat(number):
    return Beat("far", number, 0.0)


def test_an_owner_whose_lock_is_free_is_lost_at_once_whatever_its_heartbeat(tmp_path):
    mine = Lease(tmp_path)
    os.close(flock.take(tmp_path / "dead.lock"))
    assert mine.is_lost("dead", "far", beat(1))
    assert mine.is_lost("dead", "far", beat(2))
    mine.close()


def test_a_lease_whose_heartbeat_stands_still_is_lost_within_ten_seconds(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.time.monotonic", lambda: now[0])
    mine = Lease(tmp_path)
    assert not mine.is_lost("elsewhere", "far", beat(1))
    now[0] = 7.0
    assert not mine.is_lost("elsewhere", "far", beat(1))
    now[0] = 9.0  # and a look a second
    assert mine.is_lost("elsewhere", "far", beat(1))
    mine.close()


def test_a_heartbeat_that_goes_on_is_life_whatever_the_clocks_say(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.time.monotonic", lambda: now[0])
    mine = Lease(tmp_path)
    for number in range(1, 20):
        now[0] += 7.0
        assert not mine.is_lost("elsewhere", "far", beat(number))
    mine.close()


def test_an_owner_that_ended_its_lease_is_lost_at_once(tmp_path):
    mine = Lease(tmp_path)
    assert mine.is_lost("elsewhere", "far", None)
    assert mine.is_lost("never here", "local", beat(1))
    mine.close()


def test_a_dispatcher_that_is_late_keeps_its_lock_file(tmp_path):
    """It is alive: without the file everything it claims later would be taken from it at once."""
    first, second = Lease(tmp_path), Lease(tmp_path)
    second.remove(first.name)
    assert not second.is_lost(first.name, "local", beat(1))
    first.close()
    assert second.is_lost(first.name, "local", beat(1))
    second.close()


def test_submitted_and_running_are_told_apart(bench):
    bench.start(seconds=None)
    job = bench.accept()
    submitted = bench.until(job, status="running")
    until(lambda: bench.ledger.job(job.id).began)
    running = bench.ledger.job(job.id)
    assert running.engine == "far"
    assert running.task == submitted.task
    assert running.began >= running.started


def test_a_dispatcher_of_another_engine_never_takes_an_attempt_over(bench):
    first, _ = bench.start("far", seconds=None)
    job = bench.accept()
    owner = bench.until(job, status="running").owner
    first.stop(keep_solvers=True)
    near, other = bench.start("near")
    wait_for_sweeps(near, 5)
    kept = bench.ledger.job(job.id)
    assert (kept.status, kept.attempt, kept.owner) == ("running", 1, owner)
    assert other.submitted == []
    bench.start("far")
    until(lambda: bench.ledger.job(job.id).owner != owner)


def test_an_attempt_whose_engine_nobody_serves_any_more_waits_again(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.ABANDONED_SECONDS", 0.3)
    first, _ = bench.start("far", seconds=None)
    job = bench.accept()
    bench.until(job, status="running")
    first.stop(keep_solvers=True)
    bench.start("near")
    done = bench.until(job, status="done")
    assert (done.attempt, done.lost, done.engine) == (2, 0, "near")


def test_a_dispatcher_of_the_same_engine_goes_on_under_the_same_task(bench):
    first, engine = bench.start("far", seconds=None)
    job = bench.accept()
    task = bench.until(job, status="running").task
    first.stop(keep_solvers=True)
    second = Dispatcher(bench.ledger, engine, lambda name: bench.folder, bench.folder / "jobs")
    second.start()
    engine.end_all()
    done = bench.until(job, status="done")
    assert (done.attempt, done.task) == (1, task)
    assert engine.submitted == [task]
    second.stop()


def test_a_dispatcher_that_was_late_lets_go_of_its_attempt_without_ending_it(bench):
    _, engine = bench.start("far", seconds=None)
    job = bench.accept()
    owner = bench.until(job, status="running").owner
    bench.ledger.adopt(job.id, 1, owner, "another dispatcher, long ago")
    dispatcher = bench.started[0][0]
    until(lambda: not dispatcher._attempts)
    assert engine.cancelled == []


def test_heartbeats_are_written_while_there_are_attempts_and_not_without(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.BEAT_SECONDS", 0.1)
    dispatcher, engine = bench.start("far", seconds=None)
    job = bench.accept()
    owner = bench.until(job, status="running").owner
    until(lambda: bench.ledger.leases()[owner].beat >= 4)
    engine.end_all()
    bench.until(job, status="done")
    wait_for_sweeps(dispatcher)
    resting = bench.ledger.leases()[owner].beat
    wait_for_sweeps(dispatcher, 5)
    assert bench.ledger.leases()[owner].beat == resting


def test_a_job_cancelled_while_nobody_looked_is_cancelled_at_its_engine_by_its_task(bench):
    first, _ = bench.start("far", seconds=None)
    job = bench.accept()
    task = bench.until(job, status="running").task
    first.stop(keep_solvers=True)
    bench.ledger.cancel(job.id)
    _, near = bench.start("near")
    _, far = bench.start("far")
    until(lambda: far.cancelled == [task])
    assert near.cancelled == []


def test_two_dispatchers_of_one_engine_solve_each_job_once(bench):
    jobs = [bench.accept(load) for load in range(1, 200)]
    first, second = bench.start("far")[1], bench.start("far")[1]
    for job in jobs:
        done = bench.until(job, status="done")
        assert (done.attempt, done.lost) == (1, 0)
    assert len(first.submitted) + len(second.submitted) == len(jobs)
    assert len(stored(bench.ledger, "bar")) == len(jobs)


def test_a_stopped_server_loses_its_attempts_to_another_and_harms_nothing_when_it_goes_on(
    tmp_path, monkeypatch
):
    """SIGSTOP: its lock is held, only its heartbeat tells. Both look after one solver then."""
    monkeypatch.setenv("WRENCHBOOK_SOLVE", "stand_in:waits_for_a_word")
    monkeypatch.setenv("PYTHONPATH", SOLVERS)
    ledger = Ledger(tmp_path / "ledger.sqlite")
    job = ledger.accept("bar", "f1", (1.0, 0, 0, 0, 0, 0))[0]
    command = [sys.executable, str(HERE / "run_dispatcher.py"), str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    servers = [subprocess.Popen(command, **pipes)]
    try:
        folder = attempt_folder(tmp_path / "jobs", job.id, 1)
        until(lambda: (folder / LOCK).exists() and (folder / LOCK).read_text())
        until(lambda: ledger.job(job.id).began)
        owner = ledger.job(job.id).owner
        servers[0].send_signal(signal.SIGSTOP)
        servers.append(subprocess.Popen(command, **pipes))
        until(lambda: ledger.job(job.id).owner != owner, 120)
        servers[0].send_signal(signal.SIGCONT)
        later = ledger.accept("bar", "f1", (2.0, 0, 0, 0, 0, 0))[0]
        until(lambda: ledger.job(later.id).attempt)
        for one in (job, later):
            where = attempt_folder(tmp_path / "jobs", one.id, 1)
            until(where.exists)
            (where / "go").write_text(secrets.token_hex(2))
        until(lambda: all(one.status == "done" for one in ledger.jobs()))
        assert [one.attempt for one in ledger.jobs()] == [1, 1]
        assert len(stored(ledger, "bar")) == 2
    finally:
        for server in servers:
            server.kill()
            server.communicate()
        ledger.close()
