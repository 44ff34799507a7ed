"""How runjob ends an attempt, whatever the solver does."""

import json
import sys
import types
from dataclasses import replace

import numpy as np
import pytest

from wrenchbook.service.jobs import solver as runjob
from wrenchbook.service.jobs.attempt import (
    Attempt,
    BadOutcomeError,
    Outcome,
    Progress,
    prepare,
    read_outcome,
    read_progress,
    tidy,
    write_outcome,
)

SPEC = Attempt(4, 2, "bar", "/bundles/bar", "f1", (1.0, -2.5, 0.1, 0.0, 0.0, 1e-300))


@pytest.fixture
def folder(tmp_path):
    prepare(replace(SPEC, folder=tmp_path / "4" / "2"))
    return tmp_path / "4" / "2"


def error_of(folder):
    outcome = read_outcome(replace(SPEC, folder=folder))
    assert outcome.status == "failed"
    return outcome.error


def test_a_solve_that_succeeds_leaves_its_numbers_bit_for_bit(folder):
    displacement = np.array([1 / 3, -2e-9, 0.1, np.pi, 5e-324, 0])
    answer = {"displacement": displacement, "compliance": np.eye(6) / 3, "unknowns": np.int64(7)}
    assert runjob.run_attempt(folder, lambda spec, report: answer) == 0
    outcome = read_outcome(replace(SPEC, folder=folder))
    assert outcome.status == "done"
    assert outcome.displacement == displacement.tolist()
    assert outcome.compliance == (np.eye(6) / 3).tolist()
    assert outcome.further["unknowns"] == 7
    assert not list(folder.glob(".*"))


def test_a_named_failure_keeps_kind_message_and_remedy(folder, capsys):
    class MechanismError(Exception):
        kind, remedy = "mechanism", "add supports"

    def solve(spec, report):
        raise MechanismError("three rigid motions are free")

    assert runjob.run_attempt(folder, solve) == 1
    assert error_of(folder) == {
        "kind": "mechanism",
        "message": "three rigid motions are free",
        "remedy": "add supports",
    }
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (ZeroDivisionError("by zero"), "internal_error", "ZeroDivisionError: by zero"),
        (KeyError(), "internal_error", "KeyError: KeyError"),
        (MemoryError(), "out_of_memory", "MemoryError"),
    ],
)
def test_any_other_exception_is_a_failure_too(folder, error, kind, message):
    def solve(spec, report):
        raise error

    assert runjob.run_attempt(folder, solve) == 1
    assert (error_of(folder)["kind"], error_of(folder)["message"]) == (kind, message)
    assert error_of(folder)["remedy"]


@pytest.mark.parametrize(
    "displacement", [[0.0, 0, 0, 0, 0, float("nan")], np.full(6, np.inf), [1, 2, 3], None, 3.0]
)
def test_an_answer_that_is_not_six_finite_numbers_is_a_failure(folder, displacement):
    assert runjob.run_attempt(folder, lambda spec, report: {"displacement": displacement}) == 1
    assert error_of(folder)["kind"] == "bad_answer"


@pytest.mark.parametrize(
    ("name", "values", "form"),
    [
        ("displacement", [0.0] * 7, "6"),
        ("displacement", ["1"] * 6, "6"),
        ("displacement", [[0.0] * 6] * 6, "6"),
        ("displacement", [10**400] * 6, "6"),
        ("compliance", 5, "6 x 6"),
        ("compliance", [[0.0] * 5] * 6, "6 x 6"),
        ("curvature", [0.0] * 55, "56"),
    ],
)
def test_an_answer_of_another_form_is_refused_by_the_solver(folder, name, values, form):
    answer = {"displacement": [0.0] * 6, name: values}
    assert runjob.run_attempt(folder, lambda spec, report: answer) == 1
    assert error_of(folder)["kind"] == "bad_answer"
    message = f"the solver's {name} must be a list of {form} numbers, not "
    assert error_of(folder)["message"].startswith(message)


def test_numbers_that_are_not_finite_never_reach_the_file(folder):
    answer = {
        "displacement": [0.0] * 6,
        "compliance": np.full((6, 6), np.nan),
        "work": float("inf"),
        "history": ((0.5, 1, float("nan")), (1.0, 2, 1e-9)),
    }
    assert runjob.run_attempt(folder, lambda spec, report: answer) == 0
    outcome = read_outcome(replace(SPEC, folder=folder))
    assert (outcome.compliance, outcome.further["work"]) == (None, None)
    assert outcome.further["history"] == [[0.5, 1, None], [1.0, 2, 1e-9]]


def test_progress_is_written_at_most_five_times_a_second(folder, monkeypatch):
    now, written = [0.0], []
    monkeypatch.setattr(runjob, "time", types.SimpleNamespace(monotonic=lambda: now[0]))

    def solve(spec, report):
        for step in range(101):
            now[0] = step / 100
            report(step / 100, f"step {step}")
            written.append(read_progress(folder))
        return {"displacement": [0.0] * 6}

    assert read_progress(folder) is None
    runjob.run_attempt(folder, solve)
    assert written[0] == Progress(0.0, "step 0")
    assert 5 <= len(set(written)) <= 6


def test_a_cancelled_solve_says_so(folder):
    def solve(spec, report):
        raise runjob.Cancelled

    assert runjob.run_attempt(folder, solve) == runjob.CANCELLED
    assert read_outcome(replace(SPEC, folder=folder)) == Outcome("cancelled")


@pytest.mark.parametrize("name", ["no_colon", "no.such.module:solve", "json:no_such_function"])
def test_a_solver_that_cannot_be_found_is_named(folder, monkeypatch, name):
    monkeypatch.setenv("WRENCHBOOK_SOLVE", name)
    assert runjob.run_attempt(folder) == 1
    assert error_of(folder)["kind"] == "no_solver"
    assert name in error_of(folder)["message"]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("None.solve", "the module broken cannot be imported: AttributeError: 'NoneType'"),
        ("def", "the module broken cannot be imported: SyntaxError: invalid syntax"),
        ("solve = 3", "the module broken has no function 'solve'"),
    ],
)
def test_a_solver_whose_module_fails_is_told_by_the_cause(
    folder, tmp_path, monkeypatch, content, why
):
    (tmp_path / "broken.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "broken", raising=False)
    monkeypatch.setenv("WRENCHBOOK_SOLVE", "broken:solve")
    assert runjob.run_attempt(folder) == 1
    assert why in error_of(folder)["message"]


def embedded(monkeypatch, fingerprint, fields=None):
    """Put stand-ins in the place of the finite-element room; `fields` is what a solve leaves."""
    solution = types.SimpleNamespace(
        displacement=np.arange(6.0), compliance=np.eye(6), curvature=None, strain_energy=1.0,
        work=2.0, seconds=0.1, unknowns=30, history=(), notes=("a note",),
    )  # fmt: skip
    bundle = types.SimpleNamespace(fingerprint=fingerprint, deck="solved by another program")
    reading = types.SimpleNamespace(read_bundle=lambda folder: bundle)

    def solve(bundle, wrench, progress, folder, on_fields):
        if fields is not None:
            on_fields(fields)
        return solution

    solving = types.SimpleNamespace(solve=solve)
    monkeypatch.setitem(sys.modules, "wrenchbook.fea.bundle.read", reading)
    monkeypatch.setitem(sys.modules, "wrenchbook.fea.solve", solving)
    monkeypatch.delenv("WRENCHBOOK_SOLVE", raising=False)


def test_the_embedded_solver_gives_all_numbers_of_its_solution(folder, monkeypatch):
    embedded(monkeypatch, "f1")
    assert runjob.run_attempt(folder) == 0
    outcome = read_outcome(replace(SPEC, folder=folder))
    assert outcome.displacement == [0, 1, 2, 3, 4, 5]
    assert (outcome.further["work"], outcome.further["unknowns"], outcome.further["history"]) == (
        2.0,
        30,
        [],
    )


def test_a_surface_that_cannot_be_kept_costs_the_answer_nothing(folder, monkeypatch, capsys):
    flat = np.zeros((1, 3))
    fields = types.SimpleNamespace(
        linear=False, weight=False, vertices=flat, triangles=flat, full_vertices=1, places=flat,
        materials=flat, regions=("all",), displacement=flat * np.nan,
        displacement_slopes=flat, stress=flat, stress_slopes=flat, largest=1.0,
        largest_at=(0.0, 0.0, 0.0), largest_region="all",
    )  # fmt: skip
    embedded(monkeypatch, "f1", fields)
    assert runjob.run_attempt(folder) == 0
    assert read_outcome(replace(SPEC, folder=folder)).status == "done"
    assert "3 of the 3 numbers of displacement are not finite" in capsys.readouterr().err
    assert not list(folder.glob("*.fields"))


def test_a_component_that_changed_since_the_job_was_accepted_is_not_solved(folder, monkeypatch):
    embedded(monkeypatch, "f2")
    assert runjob.run_attempt(folder) == 1
    assert error_of(folder)["kind"] == "component_changed"
    assert "ask for the wrench again" in error_of(folder)["remedy"]


def test_an_outcome_of_another_attempt_or_a_torn_one_is_not_taken(folder):
    runjob.run_attempt(folder, lambda spec, report: {"displacement": [0.0] * 6})
    with pytest.raises(BadOutcomeError, match="the answer of another attempt: it differs in"):
        read_outcome(replace(SPEC, attempt=3, folder=folder))
    (folder / "result.json").write_text('{"status": "done", "displ')
    with pytest.raises(BadOutcomeError, match="cannot be read"):
        read_outcome(replace(SPEC, folder=folder))


def test_an_outcome_with_a_number_that_damage_made_infinite_is_not_taken(folder):
    runjob.run_attempt(folder, lambda spec, report: {"displacement": [1e-9] * 6})
    content = (folder / "result.json").read_text()
    (folder / "result.json").write_text(content.replace("1e-09", "1e909", 1))
    with pytest.raises(BadOutcomeError, match="its checksum is wrong"):
        read_outcome(replace(SPEC, folder=folder))


def test_an_outcome_does_not_depend_on_where_the_component_is(folder):
    runjob.run_attempt(folder, lambda spec, report: {"displacement": [0.0] * 6})
    moved = Attempt(4, 2, "bar", "/elsewhere/bar", "f1", SPEC.wrench)
    assert read_outcome(replace(moved, folder=folder)).status == "done"


def test_a_folder_left_by_a_ledger_that_is_gone_is_moved_aside(folder):
    runjob.run_attempt(folder, lambda spec, report: {"displacement": [0.0] * 6})
    prepare(replace(SPEC, folder=folder))
    assert read_outcome(replace(SPEC, folder=folder)) is None
    assert len(list(folder.parent.glob("2.old-*/result.json"))) == 1


def test_a_done_attempt_is_left_with_spec_log_and_outcome(folder):
    (folder / "log.txt").write_text("all well")
    (folder / "progress.json").write_text("{}")
    (folder / "mesh").mkdir()
    (folder / "mesh" / "big.vtu").write_text("...")
    runjob.run_attempt(folder, lambda spec, report: {"displacement": [0.0] * 6})
    tidy(folder)
    assert {entry.name for entry in folder.iterdir()} == {"spec.json", "log.txt", "result.json"}
    assert json.loads((folder / "spec.json").read_text())["component"] == "bar"


def test_an_answer_with_a_flipped_bit_is_no_answer(tmp_path):
    """One damaged digit between solver and ledger would have been a wrong row for good."""
    answer = Outcome("done", displacement=[1.25e-6, 0.1, -3.0, 0.0, 1e-300, 7.0])
    prepare(replace(SPEC, folder=tmp_path / "a"))
    write_outcome(replace(SPEC, folder=tmp_path / "a"), answer)
    path = tmp_path / "a" / "result.json"
    whole = path.read_bytes()
    assert read_outcome(replace(SPEC, folder=tmp_path / "a")) == answer
    for place in range(len(whole)):
        for bit in (1, 4):
            damaged = bytearray(whole)
            damaged[place] ^= bit
            path.write_bytes(damaged)
            try:
                assert read_outcome(replace(SPEC, folder=tmp_path / "a")) == answer
            except BadOutcomeError:
                continue
