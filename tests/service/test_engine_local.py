"""The local engine with real subprocesses, and the locks it stands on."""

import os
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.service.attempts import asked, ended
from tests.service.conftest import SOLVERS
from tests.until import until
from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs import solver_pool
from wrenchbook.service.jobs.attempt import (
    ALIVE,
    Attempt,
    EngineError,
    Outcome,
    prepare,
    read_outcome,
    read_progress,
)
from wrenchbook.service.jobs.solver_pool import LocalEngine

SPEC = Attempt(1, 1, "bar", "/nowhere", "f1", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0))


def engine_with(solver, **options):
    environment = {"WRENCHBOOK_SOLVE": f"stand_in:{solver}", "PYTHONPATH": SOLVERS}
    return LocalEngine(2, environment=environment, **options)


def attempt(tmp_path):
    folder = tmp_path / "jobs" / "1" / "1"
    prepare(replace(SPEC, folder=folder))
    return folder


def solver_pid(folder):
    until(lambda: (folder / "lock").read_text().isdigit())
    return int((folder / "lock").read_text())


def test_a_submitted_attempt_is_running_at_once_and_then_finished(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("reports_until_go")
    engine.submit(asked(folder))
    assert engine.poll(asked(folder)) in ALIVE
    until(lambda: read_progress(folder))
    assert 0 <= read_progress(folder).fraction < 1
    (folder / "go").touch()
    until(lambda: ended(engine, folder))
    assert engine.poll(asked(folder)) == "finished"
    outcome = read_outcome(replace(SPEC, folder=folder))
    assert outcome.displacement == [1e-6, 2e-6, 3e-6, 0, 0, 0]


def test_a_solver_that_is_killed_is_lost(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("endless")
    engine.submit(asked(folder))
    os.kill(solver_pid(folder), signal.SIGKILL)
    until(lambda: engine.poll(asked(folder)) == "lost")


def test_a_folder_without_a_solver_is_lost(tmp_path):
    assert LocalEngine(1).poll(asked(attempt(tmp_path))) == "lost"
    assert LocalEngine(1).poll(asked(tmp_path / "never" / "made")) == "lost"


def test_another_engine_can_look_after_a_solver_it_did_not_start(tmp_path):
    folder = attempt(tmp_path)
    engine_with("endless").submit(asked(folder))
    other = LocalEngine(1, grace=60.0)  # a solver on a slow disk is not killed
    other.attach(asked(folder))
    assert other.poll(asked(folder)) in ALIVE
    solver_pid(folder)
    other.cancel(asked(folder))
    until(lambda: ended(other, folder))
    assert read_outcome(replace(SPEC, folder=folder)) == Outcome("cancelled")


def test_cancelling_before_the_solver_has_begun_ends_it_as_well(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("endless")
    engine.submit(asked(folder))
    engine.cancel(asked(folder))
    until(lambda: ended(engine, folder))


def test_a_solver_that_does_not_hear_is_killed_after_the_grace(tmp_path, monkeypatch):
    folder, engine = attempt(tmp_path), engine_with("deaf", grace=60.0)
    engine.submit(asked(folder))
    until(lambda: read_progress(folder))
    now = [0.0]
    monkeypatch.setattr(solver_pool, "time", SimpleNamespace(monotonic=lambda: now[0]))
    engine.cancel(asked(folder))
    now[0] = 59.0
    assert not ended(engine, folder)
    assert Path(f"/proc/{solver_pid(folder)}").exists()
    now[0] = 61.0
    until(lambda: ended(engine, folder))
    assert engine.poll(asked(folder)) == "lost"


def test_a_second_solver_in_the_same_folder_is_refused(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("endless")
    engine.submit(asked(folder))
    with pytest.raises(EngineError, match="at work"):
        engine.submit(asked(folder))
    engine.cancel(asked(folder))
    until(lambda: ended(engine, folder))


def test_solvers_use_one_thread_each_low_priority_and_a_session_of_their_own(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("describe")
    engine.submit(asked(folder))
    until(lambda: ended(engine, folder))
    seen = read_outcome(replace(SPEC, folder=folder)).further["seen"]
    assert seen["threads"] == os.environ.get("OPENBLAS_NUM_THREADS", "1")
    assert seen["niceness"] > os.getpriority(os.PRIO_PROCESS, 0)
    assert seen["session"] == seen["pid"] != os.getsid(0)
    assert seen["folder"] == str(folder)


def test_what_the_solver_prints_is_in_its_log(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("diverges")
    engine.submit(asked(folder))
    until(lambda: ended(engine, folder))
    assert "NotConvergedError: no equilibrium" in (folder / "log.txt").read_text()


def test_a_program_the_solver_started_does_not_keep_the_attempt_alive(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("leaves_a_child")
    engine.submit(asked(folder))
    child = None
    try:
        until(lambda: (folder / "child").exists() and (folder / "child").read_text())
        child = int((folder / "child").read_text())
        os.kill(solver_pid(folder), signal.SIGKILL)
        until(lambda: engine.poll(asked(folder)) == "lost")
        os.kill(child, 0)  # it does live
    finally:
        if child:
            os.kill(child, signal.SIGKILL)


def test_ended_solvers_leave_no_zombies(tmp_path):
    folder, engine = attempt(tmp_path), engine_with("endless")
    engine.submit(asked(folder))
    pid = solver_pid(folder)
    os.kill(pid, signal.SIGKILL)
    until(lambda: not Path(f"/proc/{pid}").exists())


def test_a_lock_is_held_until_its_holder_lets_go(tmp_path):
    path = tmp_path / "lock"
    assert not flock.is_locked(path)
    held = flock.take(path)
    assert flock.is_locked(path)
    assert flock.take(path) is None
    os.close(held)
    assert not flock.is_locked(path)
