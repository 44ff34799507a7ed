"""The dispatcher: waiting jobs come to be done, failed or cancelled."""

import os
import signal
from pathlib import Path

import pytest

from tests.service.attempts import wait_for_sweeps
from tests.service.conftest import SOLVERS
from tests.service.ledger_rows import stored
from tests.until import until
from wrenchbook.service.jobs.attempt import EngineError, attempt_folder
from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.jobs.solver_pool import LocalEngine
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError

WRENCH = (1.0, 2.0, 3.0, 0.0, 0.0, 0.5)


class Bench:
    """A ledger, its jobs folder, and dispatchers on them."""

    def __init__(self, folder):
        self.jobs_folder = folder / "jobs"
        self.ledger = Ledger(folder / "ledger.sqlite")
        self.started = []

    def start(self, solver="quick", *, slots=2, bundles=None, engine=None):
        environment = {"WRENCHBOOK_SOLVE": f"stand_in:{solver}", "PYTHONPATH": SOLVERS}
        engine = engine or LocalEngine(slots, environment=environment)
        bundles = bundles or (lambda name: Path("/bundles") / name)
        dispatcher = Dispatcher(self.ledger, engine, bundles, self.jobs_folder)
        self.started.append(dispatcher)
        dispatcher.start()
        return dispatcher

    def accept(self, *wrench):
        return self.ledger.accept("bar", "f1", wrench or WRENCH)[0]

    def until(self, job, status, seconds=60):
        until(lambda: self.ledger.job(job.id).status == status, seconds)
        return self.ledger.job(job.id)

    def end(self, job_id):
        until(lambda: self.ledger.job(job_id).is_final, 120)
        return self.ledger.job(job_id)

    def folder(self, job, attempt=1):
        return attempt_folder(self.jobs_folder, job.id, attempt)

    def go(self, job):
        """Let a solver end that waits for it."""
        (self.folder(job) / "go").touch()

    def solver_pid(self, job, attempt=1):
        lock = self.folder(job, attempt) / "lock"
        until(lambda: lock.exists() and lock.read_text().isdigit())
        return int(lock.read_text())

    def close(self):
        for dispatcher in self.started:
            dispatcher.stop()
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
    until(lambda: not (bench.folder(job) / "progress.json").exists())
    kept = {entry.name for entry in bench.folder(job).iterdir()}
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
    for name in ("LOOK_SECONDS", "RECOVER_SECONDS"):
        monkeypatch.setattr(f"wrenchbook.service.jobs.dispatcher.{name}", 3600.0)
    dispatcher = bench.start()
    until(lambda: dispatcher._next_look)  # the first one
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
    assert "Traceback" in (bench.folder(failed) / "log.txt").read_text()
    assert stored(bench.ledger, "bar") == []


def test_a_solver_that_dies_is_tried_again_and_given_up_after_four_times(bench):
    bench.start("dies")
    failed = bench.end(bench.accept().id)
    assert (failed.status, failed.attempt) == ("failed", 4)
    assert failed.error["kind"] == "solver_died"


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
    assert "solvers end before they begin" in dispatcher.trouble
    monkeypatch.delenv("PYTHONHOME")
    assert bench.end(job.id).status == "done"
    assert dispatcher.trouble is None


def test_solver_and_dispatcher_killed_together_again_and_again_never_fail_a_job(bench):
    """Three kills of both ended an accepted job: nobody had seen the solver die by itself."""
    job = bench.accept()
    for attempt in range(1, 7):
        dispatcher = bench.start("endless")
        pid = bench.solver_pid(job, attempt)
        dispatcher.stop(keep_solvers=True)
        os.kill(pid, signal.SIGKILL)
        until(lambda pid=pid: not Path(f"/proc/{pid}").exists())
    bench.start("quick")
    done = bench.end(job.id)
    assert (done.status, done.lost) == ("done", 0)


def test_a_dispatcher_killed_right_after_its_solver_has_not_seen_it_die(bench, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.jobs.dispatcher.OUTLIVE_SECONDS", 5.0)
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
    bench.until(second, "running")
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


def test_solvers_kept_at_the_stop_are_attached_to_by_the_next_dispatcher(bench):
    dispatcher = bench.start("waits_for_a_word")
    job = bench.accept()
    bench.solver_pid(job)
    dispatcher.stop(keep_solvers=True)
    assert bench.ledger.job(job.id).status == "running"
    bench.start("diverges")
    bench.go(job)
    done = bench.end(job.id)
    assert (done.status, done.attempt) == ("done", 1)


def test_a_result_that_came_while_nobody_looked_is_committed_at_the_start(bench):
    dispatcher = bench.start("waits_for_a_word")
    job = bench.accept()
    bench.solver_pid(job)
    dispatcher.stop(keep_solvers=True)
    bench.go(job)
    until((bench.folder(job) / "result.json").exists)
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


def test_two_dispatchers_share_the_jobs_and_solve_each_once(bench):
    bench.start(slots=1)
    other = Ledger(bench.ledger.path)
    second = Dispatcher(
        other, bench.started[0]._engine, lambda name: Path("/bundles"), bench.jobs_folder
    )
    second.start()
    jobs = [bench.accept(load, 0, 0, 0, 0, 0) for load in range(10)]
    for job in jobs:
        done = bench.end(job.id)
        assert (done.status, done.attempt) == ("done", 1)
    second.stop()
    other.close()
    assert len(stored(bench.ledger, "bar")) == 10


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
    (bench.folder(job) / "result.json").write_text('{"status": "done", "displac')
    until(lambda: bench.ledger.job(job.id).attempt == 2)
    os.kill(bench.solver_pid(job, 1), signal.SIGKILL)
    done = bench.end(job.id)
    assert (done.status, done.lost) == ("done", 1)


def test_starting_twice_is_refused(bench):
    dispatcher = bench.start()
    with pytest.raises(RuntimeError, match="runs already"):
        dispatcher.start()
