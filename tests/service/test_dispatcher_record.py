"""Every way an attempt can end, as the ledger hears it."""

from dataclasses import replace

import pytest

from tests.service.ledger_rows import stored
from wrenchbook.service.jobs.attempt import Attempt, Outcome, prepare, write_outcome
from wrenchbook.service.jobs.dispatcher import record
from wrenchbook.service.ledger import StaleAttemptError

WRENCH = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(autouse=True)
def _job(ledger):
    ledger.accept("bar", "f1", WRENCH)


def ended(ledger, folder, outcome=None):
    job = ledger.claim("me")
    attempt = Attempt.of(job, folder)
    prepare(attempt)
    if outcome is not None:
        write_outcome(replace(attempt, bundle="/anywhere"), Outcome.of(outcome))
    record(ledger, attempt, ledger.lose)
    return ledger.job(job.id)


def test_an_answer_becomes_a_row(ledger, tmp_path):
    done = ended(ledger, tmp_path / "a", {"status": "done", "displacement": [1e-6] * 6})
    assert done.status == "done"
    assert ledger.row(done.row).displacement == (1e-6,) * 6


@pytest.mark.parametrize(
    ("program", "origin"),
    [("0.2.0+0123456789ab", "job 1, wrenchbook 0.2.0+0123456789ab"), (None, "job 1")],
)
def test_a_solved_row_names_the_code_that_solved_it_where_its_outcome_does(
    ledger, tmp_path, program, origin
):
    outcome = {"status": "done", "displacement": [1e-6] * 6}
    done = ended(ledger, tmp_path / "a", outcome | ({"program": program} if program else {}))
    assert ledger.row(done.row).origin == origin


def test_recording_twice_makes_one_row(ledger, tmp_path):
    job = ledger.claim("me")
    attempt = Attempt.of(job, tmp_path / "a")
    prepare(attempt)
    write_outcome(attempt, Outcome("done", displacement=[1e-6] * 6))
    for _ in range(2):
        record(ledger, attempt, ledger.lose)
    assert len(stored(ledger, "bar")) == 1


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
def test_an_answer_nobody_can_use_fails_the_job(ledger, tmp_path, outcome):
    failed = ended(ledger, tmp_path / "a", outcome)
    assert (failed.status, failed.error["kind"]) == ("failed", "bad_answer")
    assert stored(ledger, "bar") == []


def test_a_solver_that_left_nothing_has_died(ledger, tmp_path):
    waiting = ended(ledger, tmp_path / "a")
    assert (waiting.status, waiting.lost) == ("waiting", 1)


def test_an_attempt_nobody_says_has_died_is_given_back(ledger, tmp_path):
    job = ledger.claim("me")
    attempt = Attempt.of(job, tmp_path / "a")
    prepare(attempt)
    record(ledger, attempt)
    waiting = ledger.job(job.id)
    assert (waiting.status, waiting.lost) == ("waiting", 0)


def test_a_solver_that_was_asked_to_end_is_given_back(ledger, tmp_path):
    waiting = ended(ledger, tmp_path / "a", {"status": "cancelled"})
    assert (waiting.status, waiting.lost) == ("waiting", 0)


def test_an_attempt_the_job_has_left_behind_is_refused(ledger, tmp_path):
    job = ledger.claim("me")
    attempt = Attempt.of(job, tmp_path / "a")
    prepare(attempt)
    write_outcome(attempt, Outcome("done", displacement=[0] * 6))
    ledger.cancel(job.id)
    with pytest.raises(StaleAttemptError):
        record(ledger, attempt, ledger.lose)
    assert stored(ledger, "bar") == []
