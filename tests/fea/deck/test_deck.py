"""Decks: the wrench goes in, the solver runs, the motion comes back; nothing fails in silence."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fea.decks import SOFT, WRENCH, component
from tests.refusals import assert_told, cases
from tests.until import until
from wrenchbook.fea import readers
from wrenchbook.fea.bundle.read import BundleError
from wrenchbook.fea.deck import running
from wrenchbook.fea.deck.running import deck_report, insert_loads
from wrenchbook.fea.deck.solving import LINEAR_GAP
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.readers import NumbersReader, Reading
from wrenchbook.fea.solve import solve
from wrenchbook.fea.spec.schema import DeclaredRange
from wrenchbook.fea.tensors import spin_per_vector
from wrenchbook.surrogate.table.compliance import SAME_LINE

NUMBER = st.floats(allow_nan=False, allow_infinity=False)


def failure(bundle, wrench=WRENCH, folder=None):
    with pytest.raises(SolveFailed) as caught:
        solve(bundle, wrench, folder=folder)
    assert caught.value.remedy.endswith(".")
    return caught.value


@given(st.lists(NUMBER, min_size=6, max_size=6))
def test_a_number_goes_into_the_deck_with_12_decimals_and_20_characters_at_most(loads):
    words = insert_loads(b"$FX,$FY,$FZ\n$MX , $MY,$MZ", loads).replace(b"\n", b",").split(b",")
    assert max(len(word.strip()) for word in words) <= 20
    np.testing.assert_allclose([float(word) for word in words], loads, rtol=1e-12)


def test_other_words_with_a_dollar_stay_and_a_placeholder_may_come_twice():
    deck = b"$FX $FXY $FX $FY $FZ $MX $MY $MZ $A $fx \xff"
    text = insert_loads(deck, [1, 2, 3, 4, 5, 6])
    assert text.startswith(b"1.000000000000e+00 $FXY 1.000000000000e+00 2.0")
    assert text.endswith(b"$A $fx \xff")


def test_a_deck_without_a_placeholder_is_refused_before_anything_runs(tmp_path):
    bundle = component(tmp_path)
    bundle.deck.file.write_text("$FX $FY $FZ $MX $MY")
    result = failure(bundle)
    assert result.kind == "bad_deck"
    assert "no $MZ" in result.message


def test_a_nonlinear_deck_answers_the_displacement_and_knows_no_compliance(tmp_path):
    result = solve(component(tmp_path), WRENCH)
    np.testing.assert_allclose(result.displacement, 1e-6 * np.array(WRENCH), rtol=1e-12)
    assert result.compliance.shape == (6, 6)
    assert np.isnan(result.compliance).all()
    assert np.isnan([result.strain_energy, result.work]).all()
    assert result.wrench.tolist() == WRENCH
    assert result.seconds > 0


def test_a_linear_deck_answers_the_compliance_of_a_load_whose_range_is_0(tmp_path):
    ends = np.array([10.0, 10, 10, 50, 50, 0])
    bundle = replace(component(tmp_path, nonlinear=False), range=DeclaredRange(-ends, ends))
    np.testing.assert_allclose(solve(bundle, WRENCH).compliance, 1e-6 * np.eye(6), atol=1e-15)


def test_a_load_whose_range_is_0_must_be_linear_too(tmp_path):
    ends = np.array([10.0, 10, 10, 50, 50, 0])
    script = "answer(*(1e-6 * load for load in w[:5]), 1e-9 * w[5] ** 2)"
    bundle = replace(component(tmp_path, script, nonlinear=False), range=DeclaredRange(-ends, ends))
    assert failure(bundle).kind == "not_linear"


def test_the_table_takes_as_rounding_what_the_check_of_a_linear_deck_lets_through():
    assert SAME_LINE == LINEAR_GAP


def test_a_linear_deck_answers_its_compliance_as_well(tmp_path):
    script = "answer(w[0] + w[4] / 2, 2 * w[1], 3 * w[2], w[3], w[4] + w[0] / 2, w[5] / 64)"
    reported = []
    result = solve(
        component(tmp_path, script, nonlinear=False),
        [1e-4] * 6,
        lambda fraction, message: reported.append((fraction, message)),
    )
    expected = np.diag([1, 2, 3, 1, 1, 1 / 64])
    expected[0, 4] = expected[4, 0] = 0.5
    np.testing.assert_allclose(result.compliance, expected, atol=1e-15)
    assert result.work == pytest.approx(result.displacement.sum() * 1e-4 / 2)
    assert result.strain_energy == pytest.approx(result.work)
    assert reported[0] == (0.0, "wrench: starting")
    assert reported[-1] == (1.0, "done")
    assert [fraction for fraction, _ in reported] == sorted(fraction for fraction, _ in reported)


def test_a_millimetre_deck_gets_newton_millimetres_and_is_read_in_millimetres(tmp_path):
    in_metres = solve(component(tmp_path, nonlinear=False), WRENCH)
    script = "answer(*(1e-3 * load for load in w[:3]), *(1e-9 * load for load in w[3:]))"
    in_millimetres = solve(component(tmp_path, script, nonlinear=False, unit="mm"), WRENCH)
    np.testing.assert_allclose(in_millimetres.displacement, in_metres.displacement, rtol=1e-12)
    np.testing.assert_allclose(in_millimetres.compliance, in_metres.compliance, atol=1e-18)


@pytest.mark.parametrize("degrees", [0.01, 1, 19.5])
def test_a_conjugate_moment_is_found_for_the_spatial_one_that_was_asked_for(tmp_path, degrees):
    """The script turns like three torsion springs of unequal stiffness, by its own moments."""
    moment = np.array([10.0, 20.0, -30.0])
    soft = np.array([2.0, 1.0, 0.5]) * np.radians(degrees) / 32
    script = f"answer(0, 0, 0, *(c * m for c, m in zip({soft.tolist()}, w[3:])))"
    bundle = component(tmp_path, script, moment="conjugate")
    runs = set()
    result = solve(bundle, [0, 0, 0, *moment], lambda f, m: runs.add(m.split(":")[0]))
    turn = result.displacement[3:]
    assert 0.8 * degrees < np.degrees(np.linalg.norm(turn)) < 1.1 * degrees
    gap = turn - soft * (spin_per_vector(turn).T @ moment)
    assert np.linalg.norm(gap) < 1e-5 * np.linalg.norm(turn)
    assert len(runs - {"done"}) <= (2 if degrees < 0.1 else 5)


def test_a_spatial_moment_and_a_moment_about_the_turn_itself_take_one_run(tmp_path):
    count = f"open({str(tmp_path / 'count')!r}, 'a').write('x')\n"
    solve(component(tmp_path, count + SOFT), WRENCH)
    solve(component(tmp_path, count + SOFT, moment="conjugate"), [0, 0, 0, 0, 30, 0])
    solve(component(tmp_path, count + SOFT, moment="conjugate"), [1, 2, 3, 0, 0, 0])
    assert (tmp_path / "count").read_text() == "xxx"


def test_every_run_keeps_its_folder_with_all_that_was_there(tmp_path):
    bundle = component(tmp_path, "print('hello')\nopen('field.bin', 'w').write('x')\n" + SOFT)
    work = tmp_path / "attempt"
    solve(bundle, WRENCH, folder=work)
    (kept,) = (work / "deck").iterdir()
    assert {file.name for file in kept.iterdir()} == {
        "job.inp", "solver.py", "job.out", "field.bin", "printed.txt",
    }  # fmt: skip
    assert (kept / "printed.txt").read_text() == "hello\n"
    assert (kept / "job.inp").read_text().split()[1] == "-2.000000000000e+00"
    solve(bundle, WRENCH, folder=work)
    assert {each.name for each in work.iterdir()} == {"deck", "deck-2"}


def test_without_a_folder_nothing_is_left(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    solve(component(tmp_path), WRENCH)
    failure(component(tmp_path, "sys.exit(1)"))
    assert not list((tmp_path / "scratch").iterdir())


def test_the_solver_sees_the_threads_it_may_use(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    result = solve(
        component(tmp_path, 'answer(int(os.environ["OMP_NUM_THREADS"]), *[0] * 5)'), WRENCH
    )
    assert result.displacement[0] == 3


@cases(__file__, "runs")
def test_a_run_that_went_wrong_is_a_named_failure(tmp_path, case):
    bundle = component(tmp_path, case.get("script", SOFT), **case.get("deck", {}))
    result = failure(bundle, folder=tmp_path / "attempt")
    assert result.kind == case["kind"]
    assert_told(case, [result.message + result.remedy])
    assert str(tmp_path) not in result.message + result.remedy
    assert list((tmp_path / "attempt").rglob("printed.txt")) or result.kind == "no_solver"


def test_a_missing_ccx_is_told_with_its_debian_package(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    result = failure(component(tmp_path, command=["ccx", "{job}"]))
    assert result.kind == "no_solver"
    assert "calculix-ccx" in result.remedy


def test_a_failed_progress_report_is_no_program_that_cannot_be_started(tmp_path, monkeypatch):
    def progress(_, message):
        if "half" in message:
            raise ConnectionResetError

    monkeypatch.setattr(NumbersReader, "stage", lambda *_: (0.5, "half"))
    with pytest.raises(ConnectionResetError):
        solve(component(tmp_path, "time.sleep(60)"), WRENCH, progress)


def alive(pid):
    """Whether a process runs; one that has ended and waits to be reaped does not."""
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return state.stdout.strip()[:1] not in ("", "Z")


def gone(pid):
    return until(lambda: not alive(pid))


# Starts a program, writes down both process ids, and works on for a minute.
ENDLESS = """
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
open("pids.part", "w").write(f"{os.getpid()} {child.pid}")
os.rename("pids.part", "pids")
time.sleep(60)
"""


def pids_in(folder):
    (file,) = until(lambda: list(folder.rglob("pids")))
    return [int(word) for word in file.read_text().split()]


@pytest.mark.parametrize("deaf", ["", "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"])
def test_a_run_out_of_time_is_ended_with_all_that_it_started(tmp_path, deaf):
    result = failure(component(tmp_path, deaf + ENDLESS, timeout=1.0), folder=tmp_path / "attempt")
    assert result.kind == "timed_out"
    assert "after 1 s" in result.message
    assert all(gone(pid) for pid in pids_in(tmp_path / "attempt"))


def test_a_signal_while_the_solver_is_started_ends_it_too(tmp_path, monkeypatch):
    """Its handler raised before the pid was known: a cancelled solve left ccx running."""

    def cancel(*_):
        raise InterruptedError

    children, start = [], subprocess.Popen

    def started(*arguments, **options):
        children.append(start(*arguments, **options))
        signal.raise_signal(signal.SIGTERM)
        return children[-1]

    monkeypatch.setattr(running.subprocess, "Popen", started)
    before = signal.signal(signal.SIGTERM, cancel)
    try:
        with pytest.raises(InterruptedError):
            running.run_command(["sleep", "100"], tmp_path, tmp_path / "printed.txt", 100)
        assert children[0].returncode is not None
    finally:
        signal.signal(signal.SIGTERM, before)
        children[0].kill()


def test_what_a_solver_leaves_running_is_ended_as_well(tmp_path):
    script = ENDLESS.replace("time.sleep(60)\n", "", -1) + SOFT
    solve(component(tmp_path, script), WRENCH, folder=tmp_path / "attempt")
    assert all(gone(pid) for pid in pids_in(tmp_path / "attempt"))


@pytest.mark.parametrize("how", ["TERM", "KILL"])
def test_the_solver_ends_with_the_program_that_runs_it(tmp_path, how):
    component(tmp_path, ENDLESS)
    code = (
        "import pathlib, sys; from tests.fea import decks; from wrenchbook.fea.solve import solve\n"
        "folder = pathlib.Path(sys.argv[1])\n"
        "solve(decks.component(folder, decks_script := (folder / 'script').read_text()), "
        "decks.WRENCH, folder=folder / 'attempt')"
    )
    (tmp_path / "script").write_text(ENDLESS)
    runner = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)])
    try:
        pids = pids_in(tmp_path / "attempt")
        assert all(alive(pid) for pid in pids)
        runner.send_signal({"TERM": 15, "KILL": 9}[how])
        assert all(gone(pid) for pid in pids)
    finally:
        runner.kill()
        runner.wait()


def test_a_linear_deck_may_hold_freedoms_and_print_roundoff(tmp_path):
    script = "answer(0, 0, 1e-6 * w[2] + 1e-7 * w[5], 1e-22 * w[0], 0, 1e-7 * w[2] + 1e-6 * w[5])"
    result = solve(component(tmp_path, script, nonlinear=False), WRENCH)
    assert result.compliance[2, 5] == pytest.approx(1e-7)


@pytest.mark.parametrize(
    "wrench",
    [[1, 2, 3], [np.nan, 0, 0, 0, 0, 0], [np.inf] * 6, [10**400] * 6, [1, "2", 0, 0, 0, 0]],
)
def test_a_wrench_is_six_finite_numbers(tmp_path, wrench):
    with pytest.raises(ValueError, match="six finite numbers"):
        solve(component(tmp_path), wrench)


def test_the_fingerprint_covers_all_that_can_change_a_decks_answer(tmp_path):
    bundles = [
        component(tmp_path),
        component(tmp_path, SOFT + "\n"),
        component(tmp_path, unit="mm"),
        component(tmp_path, moment="conjugate"),
        component(tmp_path, command=["ccx", "-i", "{job}", "-i"]),
        component(tmp_path, output={"reader": "numbers", "file": "b"}),
        component(tmp_path, nonlinear=False),
    ]
    assert len({bundle.fingerprint for bundle in bundles}) == len(bundles)
    assert component(tmp_path, timeout=5).fingerprint == component(tmp_path).fingerprint


def test_the_reader_chooses_the_moment_unless_the_deck_does(tmp_path):
    ccx = {"reader": "calculix-dat", "point": "REF", "rotation": "ROT"}
    assert component(tmp_path, output=ccx).deck.moment == "conjugate"
    assert component(tmp_path, output=ccx, moment="spatial").deck.moment == "spatial"
    assert component(tmp_path).deck.moment == "spatial"


class Halves(NumbersReader):
    """A reader of another package."""

    keys = ()

    def read(self, run, told):
        return Reading((0.5,) * 3 + (0.125,) * 3)


def test_another_package_can_offer_a_reader(tmp_path, monkeypatch):
    from importlib.metadata import EntryPoint

    entry = EntryPoint("halves", f"{__name__}:Halves", readers.ENTRY_POINTS)
    monkeypatch.setattr(EntryPoint, "load", lambda self: Halves)
    monkeypatch.setattr(readers, "_entry_points", lambda: [entry])
    assert readers.reader_names() == ("calculix-dat", "halves", "numbers")
    result = solve(component(tmp_path, output={"reader": "halves"}), [0] * 6, None)
    assert result.displacement[0] == 0.5


def test_the_check_says_where_the_program_is_and_how_the_deck_is_read(tmp_path):
    reported, warnings = deck_report(component(tmp_path).deck)
    assert warnings == []
    assert reported["program"] == sys.executable
    assert reported["reader"] == "numbers"


def test_the_check_warns_of_a_program_that_is_not_here(tmp_path):
    reported, warnings = deck_report(component(tmp_path, command=["no-such-solver"]).deck)
    assert reported["program"] is None
    assert '"no-such-solver" is not on the PATH' in warnings[0].message


def test_the_check_finds_a_program_that_is_named_by_its_job(tmp_path, monkeypatch):
    program = tmp_path / "job"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    reported, warnings = deck_report(component(tmp_path, command=["{job}"]).deck)
    assert reported["program"] == str(program)
    assert warnings == []


def test_the_check_names_every_missing_placeholder_set_and_include(tmp_path):
    ccx = {"reader": "calculix-dat", "point": "REF", "rotation": "ROT"}
    bundle = component(tmp_path, output=ccx)
    bundle.deck.file.write_text(
        "*INCLUDE, INPUT=mesh.inp\n*node print , TOTALS=YES, nset=ref\nU\n$FX $FY $FZ $MX $MY"
    )
    with pytest.raises(BundleError) as caught:
        deck_report(bundle.deck)
    reported = [problem.message for problem in caught.value.problems]
    assert len(reported) == 3
    for said, message in zip(("no $MZ", 'the set "ROT"', '"mesh.inp"'), reported, strict=True):
        assert said in message
