"""What the ledger promises about jobs."""

import os
import sqlite3
import threading
import time

import numpy as np
import pytest

from tests.service.ledger_rows import stored
from wrenchbook.service.ledger import (
    STATUSES,
    InvalidTransitionError,
    Ledger,
    LedgerError,
    LedgerUnavailableError,
    UnknownJobError,
    connection,
)
from wrenchbook.service.ledger.jobs import BACKOFF_SECONDS, TRANSITIONS

WRENCH = (1.0, -2.0, 3.5, 0.0, 0.0, 1e-3)
ANSWER = (1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6)
ERROR = {"kind": "not_converged", "message": "no equilibrium", "remedy": "smaller steps"}


def accept(ledger, *wrench):
    return ledger.accept("plate", "f1", wrench or WRENCH)[0]


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


def test_a_commit_of_an_answer_that_is_not_finite_leaves_the_job_running(ledger):
    job = accept(ledger)
    ledger.claim("me")
    with pytest.raises(ValueError, match="displacement must be finite"):
        ledger.commit(job.id, 1, (float("nan"), 0, 0, 0, 0, 0))
    assert ledger.job(job.id).status == "running"
    assert stored(ledger, "plate") == []


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


def test_a_job_that_is_not_there_is_named(ledger):
    for call in (ledger.job, ledger.cancel, ledger.retry):
        with pytest.raises(UnknownJobError, match="there is no job 7"):
            call(7)


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


# What brings a job about that is at its first attempt, or in line for it.
BEFORE = {
    "waiting": lambda ledger: None,
    "running": lambda ledger: ledger.claim("me"),
    "done": lambda ledger: ledger.claim("me") and ledger.commit(1, 1, ANSWER),
    "failed": lambda ledger: ledger.claim("me") and ledger.fail(1, 1, ERROR),
    "cancelled": lambda ledger: ledger.cancel(1),
}
EVENTS = {
    "claim": lambda ledger: ledger.claim("me"),
    "begin": lambda ledger: ledger.beat("me", "local", {(1, 1): 5.0}),
    "adopt": lambda ledger: ledger.adopt(1, 1, "me", "you"),
    "commit": lambda ledger: ledger.commit(1, 1, (1e-6,) * 6),
    "fail": lambda ledger: ledger.fail(1, 1, ERROR),
    "lose": lambda ledger: ledger.lose(1, 1),
    "release": lambda ledger: ledger.release(1, 1),
    "cancel": lambda ledger: ledger.cancel(1),
    "retry": lambda ledger: ledger.retry(1),
    "reopen": lambda ledger: accept(ledger),
}


@pytest.mark.parametrize("status", STATUSES)
@pytest.mark.parametrize("event", EVENTS)
def test_an_event_leads_where_the_table_of_transitions_says_or_changes_nothing(
    ledger, status, event
):
    accept(ledger)
    BEFORE[status](ledger)
    if status == "done" and event == "reopen":
        ledger.withdraw("plate", 1)
    before, expected = ledger.job(1), TRANSITIONS.get((status, event))
    assert (before.status, before.error) == (status, ERROR if status == "failed" else None)
    if expected is not None or event in ("claim", "begin", "adopt", "reopen"):
        EVENTS[event](ledger)
    elif (status, event) == ("done", "commit"):  # once more: the row that it has
        assert EVENTS[event](ledger).seq == before.row
    else:
        final = "it is final unless its row is withdrawn" if status == "done" else "possible now: "
        stale = "attempt 1 no longer counts"
        with pytest.raises(InvalidTransitionError, match=f"is {status}.*({final}|{stale})"):
            EVENTS[event](ledger)
    job = ledger.job(1)
    assert job.status == (expected or status)
    assert (job.owner is not None) == (job.status == "running")
    if expected is None:
        assert job == before


def test_the_table_of_transitions_names_no_event_that_nothing_brings_about():
    assert {event for _, event in TRANSITIONS} == {*EVENTS, "give up"}


def test_the_fourth_lost_attempt_fails_the_job_with_its_cause_and_a_remedy(ledger, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.BACKOFF_SECONDS", (0.0, 0.0, 0.0))
    job = accept(ledger)
    for attempt in range(1, 5):
        ledger.claim("me")
        ended = ledger.lose(job.id, attempt, f"killed by SIGSEGV, attempt {attempt}")
    assert (ended.status, ended.error["kind"]) == ("failed", "solver_died")
    assert ended.error["message"].endswith("the last time: killed by SIGSEGV, attempt 4")
    assert "log.txt" in ended.error["remedy"]
    again = ledger.retry(job.id)
    assert (again.status, again.lost, again.error) == ("waiting", 0, None)


def test_a_task_key_names_the_attempt_and_differs_between_data_directories(ledger, tmp_path):
    other = Ledger(tmp_path / "other")
    keys = []
    for directory in (ledger, other):
        job = accept(directory)
        claimed = directory.claim("me", "dask")
        assert (claimed.owner, claimed.engine) == ("me", "dask")
        assert claimed.task.startswith(f"{job.id}-1-")
        assert directory.job(job.id) == claimed
        keys.append(claimed.task)
    assert keys[0] != keys[1]
    other.close()


def test_an_attempt_that_is_given_back_with_a_delay_is_not_claimed_at_once(ledger):
    job = accept(ledger)
    ledger.claim("me")
    ledger.release(job.id, 1, delay=3600.0)
    assert ledger.claim("me") is None


def test_claims_and_beats_make_the_heartbeat_grow(ledger):
    accept(ledger)
    assert ledger.leases() == {}
    ledger.claim("me", "dask")
    ledger.beat("me", "dask")
    lease = ledger.leases()["me"]
    assert (lease.engine, lease.beat) == ("dask", 2)
    ledger.end_lease("me")
    assert ledger.leases() == {}


# -- writers that wait for each other ------------------------------------------------------------


@pytest.fixture
def other(ledger):
    """Hold the ledger by another connection, inside a transaction."""
    other = connection.connect(ledger.path)
    other.execute("BEGIN IMMEDIATE")
    yield other
    other.close()


def test_a_writer_that_waits_begins_once_the_other_has_ended(ledger, other):
    waiting = threading.Thread(target=lambda: accept(ledger))
    waiting.start()
    assert ledger.jobs() == []
    other.execute("COMMIT")
    waiting.join(60)
    assert [job.wrench for job in ledger.jobs()] == [WRENCH]


def test_a_ledger_that_stays_busy_is_told_of_and_usable_afterwards(ledger, other, monkeypatch):
    monkeypatch.setattr(connection, "BUSY_SECONDS", 0.05)
    with pytest.raises(LedgerUnavailableError, match="locked"):
        accept(ledger)
    monkeypatch.undo()
    other.execute("ROLLBACK")
    assert accept(ledger).id == 1


def test_what_is_no_lock_is_told_at_once(other):
    with pytest.raises(sqlite3.OperationalError, match="within a transaction"):
        connection.begin(other)
    assert other.execute("PRAGMA busy_timeout").fetchone() == (30_000,)
