"""A deck's solver as an engine runs it: its files stay with the attempt, and it ends with it."""

import subprocess
from dataclasses import replace

import pytest

from tests.fea.decks import SOFT, WRENCH, component
from tests.service.attempts import asked, ended
from tests.until import until
from wrenchbook.fea.deck import solving
from wrenchbook.service.jobs.attempt import DECK, Attempt, Outcome, prepare, read_outcome, tidy
from wrenchbook.service.jobs.solver_pool import LocalEngine

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
