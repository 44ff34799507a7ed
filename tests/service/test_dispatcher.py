"""The dispatcher: waiting jobs come to be done, failed or cancelled."""

import os
import secrets
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.service.attempts import wait_for_sweeps
from tests.service.conftest import SOLVERS
from tests.service.ledger_rows import claim, stored
from tests.service.simulated import SimulatedEngine
from tests.until import until
from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs.attempt import (
    LOCK,
    Attempt,
    EngineError,
    Outcome,
    attempt_folder,
    prepare,
    write_outcome,
)
from wrenchbook.service.jobs.dispatcher import Dispatcher, Lease, record
from wrenchbook.service.jobs.solver_pool import LocalEngine
from wrenchbook.service.ledger import Heartbeat, Ledger, LedgerUnavailableError, StaleAttemptError

WRENCH = (1.0, 2.0, 3.0, 0.0, 0.0, 0.5)


class Bench:
    """A ledger, its jobs folder, and dispatchers on them."""

    def __init__(self, folder):
        self.folder, self.jobs_folder = folder, folder / "jobs"
        self.ledger = Ledger(folder / "ledger.sqlite")
        self.started, self.engines = [], []

    def start(self, solver="quick", *, slots=2, bundles=None, engine=None):
        """Start a dispatcher of solvers that stand in."""
        environment = {"WRENCHBOOK_SOLVE": f"stand_in:{solver}", "PYTHONPATH": SOLVERS}
        engine = engine or LocalEngine(slots, environment=environment)
        bundles = bundles or (lambda name: Path("/bundles") / name)
        dispatcher = Dispatcher(self.ledger, engine, bundles, self.jobs_folder)
        self.started.append(dispatcher)
        dispatcher.start()
        return dispatcher

    def simulate(self, name="far", seconds=0.05, slots=10):
        """Start a dispatcher of an engine without solvers; return both."""
        engine = SimulatedEngine(slots, lambda _: seconds, name)
        self.engines.append(engine)
        return self.start(engine=engine), engine

    def accept(self, *wrench):
        return self.ledger.accept("bar", "f1", (*(wrench or WRENCH), *[0.0] * 5)[:6])[0]

    def until(self, job, **wanted):
        def as_wanted():
            now = self.ledger.job(job.id)
            return all(getattr(now, name) == value for name, value in wanted.items()) and now

        return until(as_wanted)

    def end(self, job_id):
        until(lambda: self.ledger.job(job_id).is_final)
        return self.ledger.job(job_id)

    def attempt(self, job, attempt=1):
        return attempt_folder(self.jobs_folder, job.id, attempt)

    def go(self, job):
        """Let a solver end that waits for it."""
        (self.attempt(job) / "go").touch()

    def solver_pid(self, job, attempt=1):
        lock = self.attempt(job, attempt) / "lock"
        until(lambda: lock.exists() and lock.read_text().isdigit())
        return int(lock.read_text())

    def close(self):
        for program in self.started:
            program.stop()
        for engine in self.engines:
            engine.close()
        self.ledger.close()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.BACKOFF_SECONDS", (0.01, 0.01, 0.01))
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.OUTLIVE_SECONDS", 0.05)
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.RECOVER_SECONDS", 0.1)
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def test_an_accepted_job_is_solved_and_its_row_is_there(bench):
    bench.start()
    job = bench.accept()
    done = bench.end(job.id)
    assert done.status == "done"
    row = bench.ledger.row(done.row)
    assert row.displacement == pytest.approx([load * 1e-6 for load in WRENCH], rel=1e-15)
    assert (row.job, row.source, row.fingerprint) == (job.id, "fea", "f1")
    until(lambda: not (bench.attempt(job) / "progress.json").exists())
    kept = {entry.name for entry in bench.attempt(job).iterdir()}
    assert kept == {"spec.json", "lock", "log.txt", "result.json"}


def test_jobs_that_waited_before_the_start_are_solved_with_no_more_solvers_than_slots(bench):
    jobs = [bench.accept(load, 0, 0, 0, 0, 0) for load in range(6)]
    most = []
    bench.ledger.on_change(lambda: most.append(len(bench.ledger.running())))
    bench.start("slow", slots=2)
    for job in jobs:
        assert bench.end(job.id).status == "done"
    assert max(most) == 2
    assert len(stored(bench.ledger, "bar")) == 6


def test_a_job_starts_and_is_committed_without_a_look_that_comes_round(bench, monkeypatch):
    for name in ("POLL_SECONDS", "RECOVER_SECONDS"):
        monkeypatch.setattr(f"wrenchbook.service.jobs.dispatcher.{name}", 3600.0)
    dispatcher = bench.start()
    until(lambda: dispatcher._next_poll)  # the first one
    for load in range(5):
        assert bench.end(bench.accept(load, 1, 0, 0, 0, 0).id).status == "done"


def test_a_failure_is_recorded_with_its_reason_and_its_folder_kept_whole(bench):
    bench.start("diverges")
    failed = bench.end(bench.accept().id)
    assert failed.status == "failed"
    assert failed.error == {
        "kind": "not_converged",
        "message": "no equilibrium at load factor 0.5",
        "remedy": "use smaller load steps",
    }
    assert "Traceback" in (bench.attempt(failed) / "log.txt").read_text()
    assert stored(bench.ledger, "bar") == []


def test_a_solver_that_dies_twice_is_in_time_with_the_third_attempt(bench):
    bench.start("dies_twice")
    done = bench.end(bench.accept().id)
    assert (done.status, done.attempt) == ("done", 3)
    assert len(stored(bench.ledger, "bar")) == 1


def test_an_interpreter_that_cannot_start_is_no_dead_solver(bench, monkeypatch):
    """Three such starts, in three seconds, ended an accepted job as failed."""
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.START_AGAIN_SECONDS", 0.1)
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    dispatcher = bench.start()
    job = bench.accept()
    until(lambda: bench.ledger.job(job.id).attempt > 5)
    assert bench.ledger.job(job.id).lost == 0
    assert "solvers stop before they start" in dispatcher.trouble
    monkeypatch.delenv("PYTHONHOME")
    assert bench.end(job.id).status == "done"
    assert dispatcher.trouble is None


def test_a_dispatcher_killed_right_after_its_solver_has_not_seen_it_die(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.OUTLIVE_SECONDS", 3600.0)
    job = bench.accept()
    for attempt in range(1, 6):
        dispatcher = bench.start("endless")
        os.kill(bench.solver_pid(job, attempt), signal.SIGKILL)
        until(lambda d=dispatcher: [each for each in d._attempts.values() if each.died])
        dispatcher.stop(keep_solvers=True)
        assert bench.ledger.job(job.id).lost == 0
    bench.start("quick")
    assert bench.end(job.id).status == "done"


def test_a_solver_seen_alive_by_the_dispatcher_that_took_it_over_dies_by_itself(bench):
    first = bench.start("endless")
    job = bench.accept()
    pid = bench.solver_pid(job)
    first.stop(keep_solvers=True)
    second = bench.start("endless")
    until(lambda: second._attempts)
    os.kill(pid, signal.SIGKILL)
    until(lambda: bench.ledger.job(job.id).lost == 1)


def test_cancelling_ends_the_solver_and_frees_its_slot(bench):
    bench.start("endless", slots=1)
    first, second = bench.accept(1, 0, 0, 0, 0, 0), bench.accept(2, 0, 0, 0, 0, 0)
    pid = bench.solver_pid(first)
    assert bench.ledger.job(second.id).status == "waiting"
    bench.ledger.cancel(first.id)
    until(lambda: not Path(f"/proc/{pid}").exists())
    bench.until(second, status="running")
    assert bench.ledger.job(first.id).status == "cancelled"


def test_a_job_cancelled_and_asked_for_again_is_solved_by_a_new_attempt(bench):
    dispatcher = bench.start("endless", slots=1)
    job = bench.accept()
    bench.solver_pid(job)
    bench.ledger.cancel(job.id)
    assert bench.accept().id == job.id
    until(lambda: bench.ledger.job(job.id).attempt == 2)
    dispatcher.stop()
    bench.start("quick")
    assert bench.end(job.id).status == "done"


def test_stopping_ends_the_solvers_and_their_jobs_wait_for_the_next_dispatcher(bench):
    dispatcher = bench.start("endless")
    job = bench.accept()
    pid = bench.solver_pid(job)
    dispatcher.stop()
    dispatcher.stop()
    until(lambda: not Path(f"/proc/{pid}").exists())
    waiting = bench.ledger.job(job.id)
    assert (waiting.status, waiting.lost) == ("waiting", 0)
    bench.start("quick")
    assert bench.end(job.id).status == "done"


def test_a_result_that_came_while_nobody_looked_is_committed_at_the_start(bench):
    dispatcher = bench.start("waits_for_a_word")
    job = bench.accept()
    bench.solver_pid(job)
    dispatcher.stop(keep_solvers=True)
    bench.go(job)
    until((bench.attempt(job) / "result.json").exists)
    assert bench.ledger.job(job.id).status == "running"
    bench.start("diverges")
    assert bench.end(job.id).status == "done"


def test_a_solver_whose_job_was_cancelled_while_nobody_looked_is_ended_at_the_start(bench):
    dispatcher = bench.start("endless")
    job = bench.accept()
    pid = bench.solver_pid(job)
    dispatcher.stop(keep_solvers=True)
    bench.ledger.cancel(job.id)
    assert Path(f"/proc/{pid}").exists()
    bench.start()
    until(lambda: not Path(f"/proc/{pid}").exists())


def test_a_living_dispatchers_jobs_are_left_to_it(bench):
    bench.start("waits_for_a_word")
    job = bench.accept()
    bench.solver_pid(job)
    owner = bench.ledger.job(job.id).owner
    wait_for_sweeps(bench.start("diverges"))
    assert bench.ledger.job(job.id).owner == owner
    bench.go(job)
    done = bench.end(job.id)
    assert (done.status, done.attempt) == ("done", 1)


def test_a_running_dispatcher_takes_over_from_one_that_ended(bench):
    first = bench.start("waits_for_a_word")
    job = bench.accept()
    bench.solver_pid(job)
    second = bench.start("diverges")
    first.stop(keep_solvers=True)
    bench.go(job)
    done = bench.end(job.id)
    assert (done.status, done.attempt) == ("done", 1)
    second.stop()


def test_a_component_that_is_gone_fails_its_jobs_with_what_to_do(bench):
    def bundles(name):
        raise KeyError(name)

    bench.start(bundles=bundles)
    failed = bench.end(bench.accept().id)
    assert failed.error["kind"] == "component_missing"
    assert "bar" in failed.error["message"]


class Unwilling(LocalEngine):
    """Refuses the first attempts, as a machine without free processes would."""

    refusals = 1

    def submit(self, attempt):
        if self.refusals:
            self.refusals -= 1
            raise EngineError("no process to be had")
        super().submit(attempt)


def test_a_job_the_engine_could_not_start_waits_and_is_not_counted_as_lost(bench, monkeypatch):
    monkeypatch.setenv("WRENCHBOOK_SOLVE", "stand_in:quick")
    monkeypatch.setenv("PYTHONPATH", SOLVERS)
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.TROUBLE_SECONDS", 0.2)
    dispatcher = bench.start(engine=Unwilling(2))
    job = bench.accept()
    until(lambda: dispatcher.trouble)
    assert dispatcher.trouble == "no process to be had"
    done = bench.end(job.id)
    assert (done.status, done.lost) == ("done", 0)
    until(lambda: dispatcher.trouble is None)


def test_an_answer_the_ledger_cannot_take_now_is_taken_later(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.TROUBLE_SECONDS", 0.1)
    commit, refused = bench.ledger.commit, []

    def full(*arguments, **options):
        if len(refused) < 2:
            refused.append(arguments)
            raise LedgerUnavailableError("database or disk is full")
        return commit(*arguments, **options)

    monkeypatch.setattr(bench.ledger, "commit", full)
    bench.start()
    done = bench.end(bench.accept().id)
    assert (done.status, done.attempt, len(refused)) == ("done", 1, 2)


def test_a_torn_result_is_a_lost_attempt(bench):
    bench.start("slow_first", slots=1)
    job = bench.accept()
    os.kill(bench.solver_pid(job), signal.SIGSTOP)
    (bench.attempt(job) / "result.json").write_text('{"status": "done", "displac')
    until(lambda: bench.ledger.job(job.id).attempt == 2)
    os.kill(bench.solver_pid(job, 1), signal.SIGKILL)
    done = bench.end(job.id)
    assert (done.status, done.lost) == ("done", 1)


def test_starting_twice_is_refused(bench):
    dispatcher = bench.start()
    with pytest.raises(RuntimeError, match="already running"):
        dispatcher.start()


# -- every way an attempt can end, as the ledger hears it ----------------------------------------


@pytest.fixture
def one_job(ledger):
    """A ledger with one waiting job."""
    ledger.accept("bar", "f1", WRENCH)
    return ledger


def ended(ledger, folder, outcome=None):
    job = claim(ledger, "me")
    attempt = Attempt.of(job, folder)
    prepare(attempt)
    if outcome is not None:
        write_outcome(replace(attempt, bundle="/anywhere"), Outcome.of(outcome))
    record(ledger, attempt, ledger.lose)
    return ledger.job(job.id)


@pytest.mark.parametrize(
    ("program", "origin"),
    [("0.2.0+0123456789ab", "job 1, wrenchbook 0.2.0+0123456789ab"), (None, "job 1")],
)
def test_an_answer_becomes_a_row_that_names_the_code_where_its_outcome_does(
    one_job, tmp_path, program, origin
):
    outcome = {"status": "done", "displacement": [1e-6] * 6}
    done = ended(one_job, tmp_path / "a", outcome | ({"program": program} if program else {}))
    row = one_job.row(done.row)
    assert (done.status, row.displacement, row.origin) == ("done", (1e-6,) * 6, origin)


def test_recording_twice_makes_one_row(one_job, tmp_path):
    job = claim(one_job, "me")
    attempt = Attempt.of(job, tmp_path / "a")
    prepare(attempt)
    write_outcome(attempt, Outcome("done", displacement=[1e-6] * 6))
    for _ in range(2):
        record(one_job, attempt, one_job.lose)
    assert len(stored(one_job, "bar")) == 1


@pytest.mark.parametrize(
    "outcome",
    [
        {"status": "done"},
        {"status": "done", "displacement": [1, 2, 3]},
        {"status": "done", "displacement": [None] * 6},
        {"status": "done", "displacement": "abcdef"},
        {"status": "done", "displacement": [0] * 6, "compliance": [[1]]},
        {"status": "failed"},
        {"status": "failed", "error": {"kind": "half"}},
    ],
)
def test_an_answer_nobody_can_use_fails_the_job(one_job, tmp_path, outcome):
    failed = ended(one_job, tmp_path / "a", outcome)
    assert (failed.status, failed.error["kind"]) == ("failed", "bad_answer")
    assert stored(one_job, "bar") == []


def test_a_solver_that_left_nothing_has_died(one_job, tmp_path):
    job = ended(one_job, tmp_path / "a")
    assert (job.status, job.lost) == ("waiting", 1)


def test_an_attempt_nobody_says_has_died_or_that_was_asked_to_end_is_given_back(one_job, tmp_path):
    job = ended(one_job, tmp_path / "a", {"status": "cancelled"})
    assert (job.status, job.lost) == ("waiting", 0)
    attempt = Attempt.of(claim(one_job, "me"), tmp_path / "b")
    prepare(attempt)
    record(one_job, attempt)
    job = one_job.job(job.id)
    assert (job.status, job.lost) == ("waiting", 0)


def test_an_attempt_the_job_has_left_behind_is_refused(one_job, tmp_path):
    job = claim(one_job, "me")
    attempt = Attempt.of(job, tmp_path / "a")
    prepare(attempt)
    write_outcome(attempt, Outcome("done", displacement=[0] * 6))
    one_job.cancel(job.id)
    with pytest.raises(StaleAttemptError):
        record(one_job, attempt, one_job.lose)
    assert stored(one_job, "bar") == []


# -- who takes over whose attempts: engines, heartbeats, dispatchers that are late ---------------

HERE = Path(__file__).parent


def heartbeat(number):
    return Heartbeat("far", number, 0.0)


def test_an_owner_whose_lock_is_free_is_lost_at_once_whatever_its_heartbeat(tmp_path):
    mine = Lease(tmp_path)
    os.close(flock.take(tmp_path / "dead.lock"))
    assert mine.is_lost("dead", "far", heartbeat(1))
    assert mine.is_lost("dead", "far", heartbeat(2))
    mine.close()


def test_a_lease_whose_heartbeat_stands_still_is_lost_within_ten_seconds(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.time.monotonic", lambda: now[0])
    mine = Lease(tmp_path)
    assert not mine.is_lost("elsewhere", "far", heartbeat(1))
    now[0] = 7.0
    assert not mine.is_lost("elsewhere", "far", heartbeat(1))
    now[0] = 9.0  # and a look a second
    assert mine.is_lost("elsewhere", "far", heartbeat(1))
    mine.close()


def test_a_heartbeat_that_goes_on_is_life_whatever_the_clocks_say(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.time.monotonic", lambda: now[0])
    mine = Lease(tmp_path)
    for number in range(1, 20):
        now[0] += 7.0
        assert not mine.is_lost("elsewhere", "far", heartbeat(number))
    mine.close()


def test_an_owner_that_ended_its_lease_is_lost_at_once(tmp_path):
    mine = Lease(tmp_path)
    assert mine.is_lost("elsewhere", "far", None)
    assert mine.is_lost("never here", "local", heartbeat(1))
    mine.close()


def test_a_dispatcher_that_is_late_keeps_its_lock_file(tmp_path):
    """It is alive: without the file everything it claims later would be taken from it at once."""
    first, second = Lease(tmp_path), Lease(tmp_path)
    second.remove(first.name)
    assert not second.is_lost(first.name, "local", heartbeat(1))
    first.close()
    assert second.is_lost(first.name, "local", heartbeat(1))
    second.close()


def test_submitted_and_running_are_told_apart(bench):
    bench.simulate(seconds=None)
    job = bench.accept()
    submitted = bench.until(job, status="running")
    until(lambda: bench.ledger.job(job.id).began)
    running = bench.ledger.job(job.id)
    assert running.engine == "far"
    assert running.task == submitted.task
    assert running.began >= running.started


def test_a_dispatcher_of_another_engine_never_takes_an_attempt_over(bench):
    first, _ = bench.simulate("far", seconds=None)
    job = bench.accept()
    owner = bench.until(job, status="running").owner
    first.stop(keep_solvers=True)
    near, other = bench.simulate("near")
    wait_for_sweeps(near, 5)
    kept = bench.ledger.job(job.id)
    assert (kept.status, kept.attempt, kept.owner) == ("running", 1, owner)
    assert other.submitted == []
    bench.simulate("far")
    until(lambda: bench.ledger.job(job.id).owner != owner)


def test_an_attempt_whose_engine_nobody_serves_any_more_waits_again(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.ABANDONED_SECONDS", 0.3)
    first, _ = bench.simulate("far", seconds=None)
    job = bench.accept()
    bench.until(job, status="running")
    first.stop(keep_solvers=True)
    bench.simulate("near")
    done = bench.until(job, status="done")
    assert (done.attempt, done.lost, done.engine) == (2, 0, "near")


def test_a_dispatcher_of_the_same_engine_goes_on_under_the_same_task(bench):
    first, engine = bench.simulate("far", seconds=None)
    job = bench.accept()
    task = bench.until(job, status="running").task
    first.stop(keep_solvers=True)
    second = Dispatcher(bench.ledger, engine, lambda name: bench.folder, bench.folder / "jobs")
    second.start()
    engine.end_all()
    done = bench.until(job, status="done")
    assert (done.attempt, done.task) == (1, task)
    assert engine.submitted == engine.attached == [task]
    second.stop()


def test_a_dispatcher_that_was_late_lets_go_of_its_attempt_without_ending_it(bench):
    _, engine = bench.simulate("far", seconds=None)
    job = bench.accept()
    owner = bench.until(job, status="running").owner
    bench.ledger.adopt(job.id, 1, owner, "another dispatcher, long ago")
    dispatcher = bench.started[0]
    until(lambda: not dispatcher._attempts)
    assert engine.cancelled == []


def test_heartbeats_are_written_while_there_are_attempts_and_not_without(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.HEARTBEAT_SECONDS", 0.1)
    dispatcher, engine = bench.simulate("far", seconds=None)
    job = bench.accept()
    owner = bench.until(job, status="running").owner
    until(lambda: bench.ledger.leases()[owner].number >= 4)
    engine.end_all()
    bench.until(job, status="done")
    wait_for_sweeps(dispatcher)
    resting = bench.ledger.leases()[owner].number
    wait_for_sweeps(dispatcher, 5)
    assert bench.ledger.leases()[owner].number == resting


def test_a_job_cancelled_while_nobody_looked_is_cancelled_at_its_engine_by_its_task(bench):
    first, _ = bench.simulate("far", seconds=None)
    job = bench.accept()
    task = bench.until(job, status="running").task
    first.stop(keep_solvers=True)
    bench.ledger.cancel(job.id)
    _, near = bench.simulate("near")
    _, far = bench.simulate("far")
    until(lambda: far.cancelled == [task])
    assert near.cancelled == []


def test_two_dispatchers_of_one_engine_solve_each_job_once(bench):
    jobs = [bench.accept(load) for load in range(1, 200)]
    first, second = bench.simulate("far")[1], bench.simulate("far")[1]
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
        until(lambda: ledger.job(job.id).owner != owner)
        servers[0].send_signal(signal.SIGCONT)
        later = ledger.accept("bar", "f1", (2.0, 0, 0, 0, 0, 0))[0]
        until(lambda: ledger.job(later.id).attempt)
        for item in (job, later):
            where = attempt_folder(tmp_path / "jobs", item.id, 1)
            until(where.exists)
            (where / "go").write_text(secrets.token_hex(2))
        until(lambda: all(item.status == "done" for item in ledger.jobs()))
        assert [item.attempt for item in ledger.jobs()] == [1, 1]
        assert len(stored(ledger, "bar")) == 2
    finally:
        for server in servers:
            server.kill()
            server.communicate()
        ledger.close()
