"""What the ledger promises about jobs."""

import os
import threading
import time

import numpy as np
import pytest

from tests.service.ledger_rows import stored
from wrenchbook.service.ledger import (
    InvalidTransitionError,
    Ledger,
    LedgerError,
    LedgerUnavailableError,
    StaleAttemptError,
    UnknownJobError,
)
from wrenchbook.service.ledger.jobs import BACKOFF_SECONDS

WRENCH = (1.0, -2.0, 3.5, 0.0, 0.0, 1e-3)
ANSWER = (1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6)
ERROR = {"kind": "not_converged", "message": "no equilibrium", "remedy": "smaller steps"}


@pytest.fixture
def no_backoff(monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.BACKOFF_SECONDS", (0.0, 0.0, 0.0))


def accept(ledger, *wrench):
    return ledger.accept("plate", "f1", wrench or WRENCH)[0]


def test_an_accepted_job_is_there_after_the_ledger_is_opened_again(ledger, tmp_path):
    job, created = ledger.accept("plate", "f1", WRENCH)
    ledger.close()
    again = Ledger(tmp_path / "ledger.sqlite")
    assert created
    assert again.job(job.id) == job
    assert (job.status, job.wrench, job.attempt) == ("waiting", WRENCH, 0)
    again.close()


def test_the_same_wrench_is_the_same_job_however_often_it_is_asked(ledger):
    first, created = ledger.accept("plate", "f1", WRENCH)
    second, created_again = ledger.accept("plate", "f1", np.array(WRENCH))
    assert (created, created_again) == (True, False)
    assert first == second
    assert ledger.counts() == dict.fromkeys(("running", "done", "failed", "cancelled"), 0) | {
        "waiting": 1
    }


def test_minus_zero_is_zero_and_the_last_bit_counts(ledger):
    job = accept(ledger, 0.0, 1.0, 0, 0, 0, 0)
    assert accept(ledger, -0.0, 1.0, 0, 0, 0, 0).id == job.id
    assert accept(ledger, 0.0, np.nextafter(1.0, 2.0), 0, 0, 0, 0).id != job.id


def test_another_component_or_fingerprint_is_another_job(ledger):
    ids = {
        ledger.accept(component, fingerprint, WRENCH)[0].id
        for component in ("plate", "bar")
        for fingerprint in ("f1", "f2")
    }
    assert len(ids) == 4


@pytest.mark.parametrize(
    "wrench",
    [
        (1, 2, 3),
        (float("nan"), 0, 0, 0, 0, 0),
        (0, 0, float("inf"), 0, 0, 0),
    ],
)
def test_a_wrench_of_fewer_than_six_finite_numbers_is_refused_and_changes_nothing(ledger, wrench):
    with pytest.raises(ValueError, match="wrench"):
        ledger.accept("plate", "f1", wrench)
    with pytest.raises(ValueError, match="wrench"):
        ledger.accept_many("plate", "f1", [WRENCH, wrench])
    assert ledger.jobs() == []


def test_the_status_is_no_part_of_the_key(ledger):
    job = accept(ledger)
    ledger.claim("me")
    assert accept(ledger).status == "running"
    ledger.fail(job.id, 1, ERROR)
    failed = accept(ledger)
    assert (failed.id, failed.status, failed.error) == (job.id, "failed", ERROR)
    ledger.retry(job.id)
    ledger.claim("me")
    row = ledger.commit(job.id, 2, ANSWER)
    done = accept(ledger)
    assert (done.id, done.status, done.row) == (job.id, "done", row.seq)


def test_a_cancelled_job_waits_again_when_its_wrench_is_asked_for_again(ledger):
    job = accept(ledger)
    ledger.cancel(job.id)
    assert ledger.accept("plate", "f1", WRENCH, reopen_cancelled=False)[0].status == "cancelled"
    assert ledger.accept("plate", "f1", WRENCH) == (ledger.job(job.id), False)
    assert ledger.job(job.id).status == "waiting"


def test_many_are_accepted_in_their_order_with_one_job_for_equal_ones(ledger):
    wrenches = [(i % 3, 0, 0, 0, 0, 0) for i in range(6)]
    jobs = ledger.accept_many("plate", "f1", wrenches)
    assert [job.wrench[0] for job in jobs] == [0, 1, 2, 0, 1, 2]
    assert len({job.id for job in jobs}) == len(ledger.jobs()) == 3
    assert ledger.accept_many("plate", "f1", []) == []


def test_the_oldest_waiting_job_is_claimed_first_and_urgent_ones_before_it(ledger):
    first, second, third = (accept(ledger, i, 0, 0, 0, 0, 0) for i in range(3))
    urgent, created = ledger.accept("plate", "f1", third.wrench, priority=1)
    assert (urgent.id, created) == (third.id, False)
    order = [ledger.claim("me").id for _ in range(3)]
    assert order == [third.id, first.id, second.id]
    assert ledger.claim("me") is None


def test_a_claimed_job_runs_its_next_attempt_under_its_owner(ledger):
    accept(ledger)
    job = ledger.claim("me")
    assert (job.status, job.attempt, job.owner) == ("running", 1, "me")
    assert job.started >= job.created
    assert ledger.running() == [job]


def test_a_commit_writes_row_and_status_together(ledger):
    job = accept(ledger)
    ledger.claim("me")
    compliance = np.arange(36.0).reshape(6, 6)
    row = ledger.commit(job.id, 1, ANSWER, compliance=compliance, origin="job 1")
    assert stored(ledger, "plate") == [row] == [ledger.row(row.seq)]
    assert (row.wrench, row.displacement, row.source) == (WRENCH, ANSWER, "fea")
    assert np.array_equal(row.compliance, compliance)
    assert (row.uncertainty, row.job, row.origin) == (None, job.id, "job 1")
    done = ledger.job(job.id)
    assert (done.status, done.row, done.owner) == ("done", row.seq, None)
    assert done.finished >= done.started


def test_a_second_commit_returns_the_row_there_is(ledger):
    job = accept(ledger)
    ledger.claim("me")
    row = ledger.commit(job.id, 1, ANSWER)
    assert ledger.commit(job.id, 1, (9, 9, 9, 9, 9, 9)) == row
    assert stored(ledger, "plate") == [row]


def test_a_commit_of_an_answer_that_is_not_finite_leaves_the_job_running(ledger):
    job = accept(ledger)
    ledger.claim("me")
    with pytest.raises(ValueError, match="displacement must be finite"):
        ledger.commit(job.id, 1, (float("nan"), 0, 0, 0, 0, 0))
    assert ledger.job(job.id).status == "running"
    assert stored(ledger, "plate") == []


def test_what_a_stale_attempt_says_does_not_count(ledger, no_backoff):
    job = accept(ledger)
    ledger.claim("me")
    ledger.lose(job.id, 1)
    for report in (
        lambda: ledger.commit(job.id, 1, ANSWER),
        lambda: ledger.fail(job.id, 1, ERROR),
        lambda: ledger.lose(job.id, 1),
        lambda: ledger.release(job.id, 1),
    ):
        with pytest.raises(StaleAttemptError, match="attempt 1"):
            report()
    assert ledger.claim("me").attempt == 2
    with pytest.raises(StaleAttemptError, match="no longer counts"):
        ledger.commit(job.id, 1, ANSWER)
    assert stored(ledger, "plate") == []


def test_the_fourth_lost_attempt_fails_the_job_and_says_what_to_do(ledger, no_backoff):
    job = accept(ledger)
    for attempt in (1, 2, 3):
        ledger.claim("me")
        assert ledger.lose(job.id, attempt).status == "waiting"
    ledger.claim("me")
    failed = ledger.lose(job.id, 4)
    assert (failed.status, failed.error["kind"]) == ("failed", "solver_died")
    assert "log.txt" in failed.error["remedy"]
    again = ledger.retry(job.id)
    assert (again.status, again.lost, again.error) == ("waiting", 0, None)


def test_a_job_whose_solver_died_is_not_started_again_at_once(ledger, monkeypatch):
    """Three deaths in three seconds, all of one cause, ended an accepted job."""
    job = accept(ledger)
    now = time.time()
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.time.time", lambda: now)
    for attempt, delay in enumerate(BACKOFF_SECONDS, 1):
        assert ledger.claim("me").not_before is None
        lost = ledger.lose(job.id, attempt)
        assert (lost.status, lost.not_before) == ("waiting", now + delay)
        now += 0.9 * delay
        assert ledger.claim("me") is None
        now += 0.2 * delay
    assert BACKOFF_SECONDS == (1, 10, 100)
    assert ledger.claim("me").attempt == 4


def test_an_attempt_given_back_does_not_count_as_lost(ledger):
    job = accept(ledger)
    for attempt in range(1, 6):
        ledger.claim("me")
        assert ledger.release(job.id, attempt).status == "waiting"
    assert ledger.job(job.id).lost == 0


def test_a_running_attempt_can_be_adopted_by_one_only(ledger):
    job = accept(ledger)
    ledger.claim("dead")
    assert ledger.adopt(job.id, 1, "dead", "first").owner == "first"
    assert ledger.adopt(job.id, 1, "dead", "second") is None
    assert ledger.job(job.id).attempt == 1


def test_a_cancelled_job_takes_no_answer(ledger):
    job = accept(ledger)
    ledger.claim("me")
    assert ledger.cancel(job.id).status == "cancelled"
    with pytest.raises(StaleAttemptError):
        ledger.commit(job.id, 1, ANSWER)
    assert ledger.cancel(job.id).status == "cancelled"


def test_a_done_job_can_be_neither_cancelled_nor_retried(ledger):
    job = accept(ledger)
    ledger.claim("me")
    ledger.commit(job.id, 1, ANSWER)
    for forbidden in (ledger.cancel, ledger.retry):
        with pytest.raises(InvalidTransitionError, match="it is final unless its row is withdrawn"):
            forbidden(job.id)
    assert ledger.job(job.id).status == "done"


def test_a_refused_change_names_what_is_possible(ledger):
    job = accept(ledger)
    with pytest.raises(
        InvalidTransitionError, match="cannot retry it; possible now: cancel, claim"
    ):
        ledger.retry(job.id)


def test_a_job_that_is_not_there_is_named(ledger):
    for call in (ledger.job, ledger.cancel, ledger.retry):
        with pytest.raises(UnknownJobError, match="there is no job 7"):
            call(7)


def test_jobs_are_listed_newest_first_and_by_component_and_status(ledger):
    ids = [accept(ledger, i, 0, 0, 0, 0, 0).id for i in range(4)]
    other, _ = ledger.accept("bar", "f1", WRENCH)
    ledger.cancel(ids[1])
    assert [job.id for job in ledger.jobs()] == [other.id, *reversed(ids)]
    assert [job.id for job in ledger.jobs("plate", limit=2)] == [ids[3], ids[2]]
    assert [job.id for job in ledger.jobs("plate", "cancelled")] == [ids[1]]
    assert ledger.counts("plate")["waiting"] == 3
    assert ledger.counts("spring")["waiting"] == 0


def test_listeners_hear_of_each_commit_and_not_of_questions(ledger):
    heard = []
    stop = ledger.on_change(lambda: heard.append(ledger.version()))
    job = accept(ledger)
    accept(ledger)
    ledger.claim("me")
    ledger.commit(job.id, 1, ANSWER)
    assert len(heard) == len(set(heard)) == 3
    stop()
    stop()
    accept(ledger, 9, 9, 9, 9, 9, 9)
    assert len(heard) == 3


def test_a_listener_that_fails_does_not_make_the_commit_look_failed(ledger, caplog):
    ledger.on_change(lambda: 1 / 0)
    assert accept(ledger).status == "waiting"
    assert "a listener of the ledger failed" in caplog.text


def test_a_full_disk_is_named_and_nothing_is_accepted(ledger):
    pages = ledger._writer.execute("PRAGMA page_count").fetchone()[0]
    ledger._writer.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(LedgerUnavailableError, match="full"):
        ledger.accept_many("plate", "f1", [(i, 0, 0, 0, 0, 0) for i in range(1000)])
    assert ledger.jobs() == []
    ledger._writer.execute("PRAGMA max_page_count = 1000000")
    assert accept(ledger).status == "waiting"


def test_a_closed_ledger_says_so(ledger):
    ledger.close()
    ledger.close()
    for call in (ledger.jobs, ledger.version, lambda: accept(ledger)):
        with pytest.raises(LedgerError, match="closed"):
            call()


def test_many_threads_accept_and_claim_each_job_once(ledger):
    wrenches = [(i, 0, 0, 0, 0, 0) for i in range(20)]
    claimed = []

    def work(name):
        for wrench in wrenches:
            ledger.accept("plate", "f1", wrench)
        while job := ledger.claim(name):
            claimed.append(job.id)
            ledger.commit(job.id, job.attempt, ANSWER)

    threads = [threading.Thread(target=work, args=(f"t{i}",)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(claimed) == sorted(set(claimed)) == sorted(job.id for job in ledger.jobs())
    assert len(stored(ledger, "plate")) == len(ledger.jobs(status="done")) == 20


@pytest.mark.parametrize("before", [None, 0o644, 0o660])
def test_a_ledger_and_its_log_are_no_ones_but_their_owners(tmp_path, before):
    """Everybody on the machine could read them; one of an earlier version is closed too."""
    path, umask = tmp_path / "ledger.sqlite", os.umask(0)
    try:
        if before is not None:
            Ledger(path).close()
            path.chmod(before)
        ledger = Ledger(path)
        ledger.accept("rig", "f", (1.0, 0, 0, 0, 0, 0))
        modes = {file.name: file.stat().st_mode & 0o777 for file in tmp_path.iterdir()}
        ledger.close()
    finally:
        os.umask(umask)
    assert modes.keys() >= {path.name, f"{path.name}-wal"}
    assert modes.pop("ledger.sqlite-acknowledged") == 0o600
    # A group that was let in on purpose stays.
    assert set(modes.values()) == {0o660 if before == 0o660 else 0o600}
