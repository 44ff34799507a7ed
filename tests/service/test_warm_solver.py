"""Solvers that live from one attempt to the next, and everything that can befall them."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.service.attempts import asked, ended
from tests.service.conftest import SOLVERS
from tests.until import until
from wrenchbook.service.jobs import solver, solver_pool
from wrenchbook.service.jobs.attempt import (
    ALIVE,
    Attempt,
    Outcome,
    prepare,
    read_attempt,
    read_outcome,
)
from wrenchbook.service.jobs.solver_pool import LocalEngine

HERE = Path(__file__).parent


class Site:
    """Attempts in folders of their own, and engines that are closed at the end."""

    def __init__(self, folder, monkeypatch):
        self.folder = folder
        self.engines = []
        monkeypatch.setenv("PYTHONPATH", SOLVERS)
        self.setenv = monkeypatch.setenv

    def engine(self, solver="counts", slots=1, **options):
        self.setenv("WRENCHBOOK_SOLVE", f"stand_in:{solver}")
        self.engines.append(LocalEngine(slots, **options))
        return self.engines[-1]

    def prepare(self, number, attempt=1):
        folder = self.folder / str(number) / str(attempt)
        wrench = (float(number), 2.0, 3.0, 0.0, 0.0, 0.0)
        prepare(Attempt(number, attempt, "bar", "/nowhere", "f1", wrench, folder=folder))
        return folder

    def solved(self, engine, number, attempt=1, **needs):
        folder = self.prepare(number, attempt)
        engine.submit(asked(folder, **needs))
        until(lambda: ended(engine, folder))
        return outcome_in(folder)

    def seen(self, engine, number):
        return self.solved(engine, number).further["seen"]


@pytest.fixture
def site(tmp_path, monkeypatch):
    site = Site(tmp_path, monkeypatch)
    yield site
    for engine in site.engines:
        engine.close()


def outcome_in(folder):
    return read_outcome(read_attempt(folder))


def pid_at(folder):
    until(lambda: (folder / "lock").exists() and (folder / "lock").read_text().isdigit())
    return int((folder / "lock").read_text())


def lives(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):  # it may end between open and read
        return False
    return state != "Z"


def test_one_process_answers_attempt_after_attempt_each_with_its_own_log_and_folder(site):
    engine, pids = site.engine(), set()
    for number in range(1, 6):
        seen = site.seen(engine, number)
        assert (seen["answered"], seen["folder"]) == (number, str(site.folder / f"{number}/1"))
        assert (site.folder / f"{number}/1/log.txt").read_text() == f"answered {number}\n"
        pids.add(seen["pid"])
    assert len(pids) == 1


def test_a_solver_is_renewed_after_its_number_of_attempts(site):
    engine = site.engine(max_attempts=2)
    assert [site.seen(engine, number)["answered"] for number in range(1, 6)] == [1, 2, 1, 2, 1]


def test_a_solver_that_leaks_is_renewed(site):
    engine = site.engine("leaks")
    assert [site.seen(engine, number)["answered"] for number in range(1, 5)] == [1, 2, 1, 2]


def test_what_the_environment_says_now_holds_for_the_next_attempt(site):
    engine = site.engine("counts")
    assert "seen" in site.solved(engine, 1).further
    site.setenv("WRENCHBOOK_SOLVE", "stand_in:quick")
    assert "seen" not in site.solved(engine, 2).further


def test_a_solver_killed_between_attempts_costs_none(site):
    engine = site.engine()
    first = site.seen(engine, 1)["pid"]
    os.kill(first, signal.SIGKILL)
    assert site.seen(engine, 2)["pid"] != first


def test_a_solver_stopped_between_attempts_is_replaced(site, monkeypatch):
    monkeypatch.setattr(solver_pool, "CONFIRM_SECONDS", 0.3)
    engine = site.engine()
    first = site.seen(engine, 1)["pid"]
    os.kill(first, signal.SIGSTOP)
    assert site.seen(engine, 2)["pid"] != first
    until(lambda: not lives(first))


def test_a_killed_solver_that_does_not_exit_delays_the_next_attempt_for_a_limited_time(
    site, monkeypatch
):
    for name in ("CONFIRM_SECONDS", "EXIT_SECONDS"):
        monkeypatch.setattr(solver_pool, name, 0.1)
    monkeypatch.setattr(solver_pool, "signal_group", lambda group, number: None)
    engine = site.engine()
    first = site.seen(engine, 1)["pid"]
    os.kill(first, signal.SIGSTOP)
    try:
        submits = threading.Thread(target=engine.submit, args=(asked(site.prepare(2)),))
        submits.start()
        submits.join(30)
        assert not submits.is_alive()
        until(lambda: outcome_in(site.folder / "2" / "1"))
    finally:
        os.kill(first, signal.SIGKILL)


def test_a_solver_killed_at_work_is_lost_with_its_cause_in_the_log(site):
    engine = site.engine("slow_first")
    folder = site.prepare(1)
    engine.submit(asked(folder))
    os.kill(pid_at(folder), signal.SIGKILL)
    until(lambda: ended(engine, folder))
    assert engine.poll(asked(folder)) == "lost"
    until(lambda: "ended by SIGKILL" in (folder / "log.txt").read_text())
    assert site.solved(engine, 1, attempt=2).status == "done"


def test_an_answer_on_the_disk_counts_though_its_solver_died_at_once(site):
    engine = site.engine("answers_and_dies")
    assert site.solved(engine, 1).displacement[0] == 1e-6
    assert site.solved(engine, 2).displacement[0] == 2e-6


def test_a_stopped_solver_is_ended_at_its_deadline_and_fails_its_attempt_by_name(site):
    engine = site.engine("slow_first")
    folder = site.prepare(1)
    attempt = asked(folder, deadline=0.5)
    engine.submit(attempt)
    pid = pid_at(folder)
    os.kill(pid, signal.SIGSTOP)
    until(lambda: engine.poll(attempt) not in ALIVE)
    error = outcome_in(folder).error
    assert (error["kind"], "0.5 s" in error["message"]) == ("deadline", True)
    until(lambda: not lives(pid))
    assert site.solved(engine, 1, attempt=2, deadline=60).status == "done"


def test_a_deadline_counts_from_the_beginning_whoever_looks(site):
    """The server that started it has died: the next one must not begin to count anew."""
    first = site.engine("endless")
    folder = site.prepare(1)
    first.submit(asked(folder))
    pid_at(folder)
    os.utime(folder / "lock", (time.time() - 100,) * 2)
    second = site.engine("endless")
    attempt = asked(folder, deadline=50)
    second.attach(attempt)
    until(lambda: second.poll(attempt) == "finished")
    assert outcome_in(folder).error["kind"] == "deadline"


def test_a_cancelled_solver_ends_and_the_next_attempt_has_another(site):
    engine = site.engine("slow_first", grace=60.0)  # it may be slow to hear
    folder = site.prepare(1)
    engine.submit(asked(folder))
    pid = pid_at(folder)
    engine.cancel(asked(folder))
    until(lambda: ended(engine, folder))
    assert outcome_in(folder) == Outcome("cancelled")
    assert site.solved(engine, 1, attempt=2).further["seen"]["answered"] == 1
    until(lambda: not lives(pid))


def test_no_more_solvers_wait_than_may_work(site):
    engine = site.engine(slots=2)
    folders = [site.prepare(number) for number in range(1, 6)]
    for folder in folders:
        engine.submit(asked(folder))  # more than slots at once, which a dispatcher never does
    until(lambda: all(ended(engine, folder) for folder in folders))
    pids = {outcome_in(folder).further["seen"]["pid"] for folder in folders}
    until(lambda: sum(lives(pid) for pid in pids) <= 2)


def test_a_closed_engine_leaves_no_solver_that_waits(site):
    engine = site.engine()
    pid = site.seen(engine, 1)["pid"]
    engine.close()
    until(lambda: not lives(pid))


def serve(folders, solver):
    environment = dict(os.environ, WRENCHBOOK_SOLVE=f"stand_in:{solver}", PYTHONPATH=SOLVERS)
    command = [sys.executable, str(HERE / "run_engine.py"), *map(str, folders)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    return subprocess.Popen(command, env=environment, **pipes)


def kill(server):
    server.kill()
    server.communicate()


def test_a_solver_whose_server_is_killed_ends_its_attempt_and_then_itself(site):
    folder = site.prepare(1)
    server = serve([folder], "slow")
    assert server.stdout.readline() == b"submitted\n"
    pid = pid_at(folder)
    kill(server)
    until(lambda: (folder / "result.json").exists())
    assert outcome_in(folder).displacement[0] == 1e-6
    until(lambda: not lives(pid))


def test_a_solver_that_has_not_begun_when_its_server_is_killed_begins_all_the_same(site):
    """It is handed over before its interpreter runs: the lock is held all the way."""
    for number in range(1, 4):
        folder = site.prepare(number)
        server = serve([folder], "counts")
        assert server.stdout.readline() == b"submitted\n"
        assert not (folder / "lock").read_text() or number  # most often it has not begun
        kill(server)
        until(lambda folder=folder: (folder / "result.json").exists())


def test_a_solver_that_waits_for_work_ends_when_its_server_is_killed(site):
    folders = [site.prepare(1), site.prepare(2)]
    server = serve(folders, "counts")
    for _ in range(4):
        server.stdout.readline()
    pid = outcome_in(folders[1]).further["seen"]["pid"]
    assert outcome_in(folders[0]).further["seen"]["pid"] == pid
    assert lives(pid)
    kill(server)
    until(lambda: not lives(pid))


def test_an_outcome_waits_for_room_on_a_full_disk(tmp_path, monkeypatch):
    prepare(Attempt(1, 1, "bar", "/nowhere", "f1", (1.0,) * 6, folder=tmp_path / "1"))
    write, refused = solver.write_outcome, []

    def full(*arguments):
        if len(refused) < 2:
            refused.append(arguments)
            raise OSError(28, "No space left on device")
        write(*arguments)

    monkeypatch.setattr(solver, "write_outcome", full)
    monkeypatch.setattr(solver, "_AGAIN_SECONDS", 0.01)
    assert solver.run_attempt(tmp_path / "1", lambda *_: {"displacement": [0.0] * 6}) == 0
    assert outcome_in(tmp_path / "1").status == "done"
    assert len(refused) == 2


def test_a_full_disk_of_progress_and_log_fails_no_solve(tmp_path, monkeypatch):
    """The line of the log that reports it had no room either, and failed the job for good."""
    prepare(Attempt(1, 1, "bar", "/nowhere", "f1", (1.0,) * 6, folder=tmp_path / "1"))

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys, "stderr", SimpleNamespace(write=full))
    monkeypatch.setattr(solver, "write_json", full)

    def solve(_, report):
        report(0.5, "half")
        return {"displacement": [0.0] * 6}

    assert solver.run_attempt(tmp_path / "1", solve) == 0
    assert outcome_in(tmp_path / "1").status == "done"
