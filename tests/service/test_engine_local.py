"""The local engine with real subprocesses, and the locks it stands on."""

import os
import signal
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.fea.decks import SOFT, WRENCH, component
from tests.service.attempts import asked, ended
from tests.service.conftest import SOLVERS
from tests.until import until
from wrenchbook.fea.deck import solving
from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs import solver_pool
from wrenchbook.service.jobs.attempt import (
    DECK,
    Attempt,
    EngineError,
    Outcome,
    prepare,
    read_outcome,
    read_progress,
    tidy,
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
    with pytest.raises(EngineError, match="already works"):
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


# -- a deck's solver: its files stay with the attempt, and it ends with it -----------------------

ENDLESS = (
    "open('pid.part', 'w').write(str(os.getpid()))\nos.rename('pid.part', 'pid')\nsignal.pause()"
)


def submitted(tmp_path, script):
    """An attempt on a deck solved by `script`, handed to an engine; engine, folder and spec."""
    (tmp_path / "bundle").mkdir()
    bundle = component(tmp_path / "bundle", script)
    write_table(tmp_path / "bundle", bundle)
    spec = Attempt(3, 1, "scripted", str(tmp_path / "bundle"), bundle.fingerprint, tuple(WRENCH))
    folder = tmp_path / "jobs" / "3" / "1"
    prepare(replace(spec, folder=folder))
    engine = LocalEngine(1, grace=60.0)  # a solver on a slow disk is not killed
    engine.submit(asked(folder))
    return engine, folder, spec


def write_table(folder, bundle):
    command = ", ".join(f'"{word}"' for word in bundle.deck.command)
    (folder / "component.toml").write_text(
        'name = "scripted"\ntitle = "Solved by a script"\n'
        f'[deck]\nfile = "job.inp"\nfiles = ["solver.py"]\ncommand = [{command}]\n'
        'output = {reader = "numbers", file = "{job}.out"}\n'
        "[range]\nforce = [10, 10, 10]\nmoment = [50, 50, 50]\n"
    )


def alive(pid):
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return state.stdout.strip()[:1] not in ("", "Z")


def test_the_folder_of_a_deck_stays_with_the_attempt_and_an_unknown_compliance_is_null(tmp_path):
    engine, folder, spec = submitted(tmp_path, SOFT)
    until(lambda: ended(engine, folder))
    outcome = read_outcome(replace(spec, folder=folder))
    assert outcome.status == "done", outcome
    assert outcome.displacement == pytest.approx([1e-6 * load for load in WRENCH])
    assert outcome.compliance is None
    assert outcome.further["strain_energy"] is None
    tidy(folder)
    assert (folder / "deck" / "wrench" / "job.inp").is_file()
    assert solving.FOLDER == DECK


def test_a_failed_deck_is_told_by_its_kind_and_remedy(tmp_path):
    engine, folder, spec = submitted(tmp_path, "print('no licence'); sys.exit(2)")
    until(lambda: ended(engine, folder))
    error = read_outcome(replace(spec, folder=folder)).error
    assert error["kind"] == "solver_failed"
    assert "no licence" in error["message"]
    assert "deck/wrench" in error["remedy"]


def test_a_cancelled_attempt_ends_the_decks_solver(tmp_path):
    engine, folder, spec = submitted(tmp_path, ENDLESS)
    until(lambda: list(folder.rglob("pid")))
    pid = int(next(folder.rglob("pid")).read_text())
    assert alive(pid)
    engine.cancel(asked(folder))
    until(lambda: ended(engine, folder))
    assert read_outcome(replace(spec, folder=folder)) == Outcome("cancelled")
    until(lambda: not alive(pid))
