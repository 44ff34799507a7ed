"""What the ledger promises about jobs."""

import os
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from tests.service.ledger_rows import claim, stored
from tests.until import until
from wrenchbook.service import workspace
from wrenchbook.service.ledger import (
    InvalidTransitionError,
    Ledger,
    LedgerError,
    LedgerUnavailableError,
    UnknownJobError,
    connection,
)
from wrenchbook.service.ledger.acknowledged import Acknowledged, Numbers
from wrenchbook.service.ledger.jobs import BACKOFF_SECONDS, FORGOTTEN_SECONDS, TRANSITIONS
from wrenchbook.service.ledger.records import STATUSES
from wrenchbook.service.settings import Settings
from wrenchbook.service.workers.builder import DAY, prune, shorten_log
from wrenchbook.service.workspace import Watcher

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
    claim(ledger, "me")
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
    claim(ledger, "me")
    with pytest.raises(
        ValueError, match=r"displacement of job 1 must be finite, not nan at \(0,\)"
    ):
        ledger.commit(job.id, 1, (float("nan"), 0, 0, 0, 0, 0))
    assert ledger.job(job.id).status == "running"
    assert stored(ledger, "plate") == []


def test_a_job_whose_solver_died_is_not_started_again_at_once(ledger, monkeypatch):
    """Three deaths in three seconds, all of one cause, ended an accepted job."""
    job = accept(ledger)
    now = time.time()
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.time.time", lambda: now)
    for attempt, delay in enumerate(BACKOFF_SECONDS, 1):
        assert claim(ledger, "me").not_before is None
        lost = ledger.lose(job.id, attempt)
        assert (lost.status, lost.not_before) == ("waiting", now + delay)
        now += 0.9 * delay
        assert claim(ledger, "me") is None
        now += 0.2 * delay
    assert BACKOFF_SECONDS == (1, 10, 100)
    assert claim(ledger, "me").attempt == 4


def test_a_job_that_is_not_there_is_named(ledger):
    for call in (ledger.job, ledger.cancel, ledger.retry):
        with pytest.raises(UnknownJobError, match="there is no job 7"):
            call(7)


def test_listeners_hear_of_each_commit_and_not_of_questions(ledger):
    heard = []
    stop = ledger.on_change(lambda: heard.append(ledger.version()))
    job = accept(ledger)
    accept(ledger)
    claim(ledger, "me")
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


def test_a_ledger_that_became_read_only_names_its_disk_and_is_logged_once(ledger, caplog):
    ledger._writer.execute("PRAGMA query_only = ON")  # as on a disk that was remounted
    for _ in range(3):
        with pytest.raises(LedgerUnavailableError, match="remount it writable"):
            accept(ledger)
    assert len(caplog.records) == 1
    ledger._writer.execute("PRAGMA query_only = OFF")
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
    "running": lambda ledger: claim(ledger, "me"),
    "done": lambda ledger: claim(ledger, "me") and ledger.commit(1, 1, ANSWER),
    "failed": lambda ledger: claim(ledger, "me") and ledger.fail(1, 1, ERROR),
    "cancelled": lambda ledger: ledger.cancel(1),
}
EVENTS = {
    "claim": lambda ledger: claim(ledger, "me"),
    "begin": lambda ledger: ledger.send_heartbeat("me", "local", {(1, 1): 5.0}),
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
        final = "withdraw its row to solve again" if status == "done" else "possible now: "
        stale = "the report of attempt 1 is ignored"
        with pytest.raises(InvalidTransitionError, match=f"is {status}.*({final}|{stale})"):
            EVENTS[event](ledger)
    job = ledger.job(1)
    assert job.status == (expected or status)
    assert (job.owner is not None) == (job.status == "running")
    if expected is None:
        assert job == before


def test_a_cancelled_job_waits_again_where_whoever_asks_reopens_it(ledger):
    job = ledger.cancel(accept(ledger).id)
    assert ledger.accept("plate", "f1", WRENCH, reopen_cancelled=False) == (job, False)
    assert accept(ledger).status == "waiting"


def test_the_table_of_transitions_names_no_event_that_nothing_brings_about():
    assert {event for _, event in TRANSITIONS} == {*EVENTS, "give up"}


def test_the_fourth_lost_attempt_fails_the_job_with_its_cause_and_a_remedy(ledger, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.BACKOFF_SECONDS", (0.0, 0.0, 0.0))
    job = accept(ledger)
    for attempt in range(1, 5):
        claim(ledger, "me")
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
        claimed = claim(directory, "me", "dask")
        assert (claimed.owner, claimed.engine) == ("me", "dask")
        assert claimed.task.startswith(f"{job.id}-1-")
        assert directory.job(job.id) == claimed
        keys.append(claimed.task)
    assert keys[0] != keys[1]
    other.close()


def test_an_attempt_that_is_given_back_with_a_delay_is_not_claimed_at_once(ledger):
    job = accept(ledger)
    claim(ledger, "me")
    ledger.release(job.id, 1, delay=3600.0)
    assert claim(ledger, "me") is None


def test_a_running_attempt_is_adopted_by_one_only_and_keeps_its_first_beginning(ledger):
    job = accept(ledger)
    claim(ledger, "dead")
    for start in (12.5, 99.0):
        ledger.send_heartbeat("dead", "local", {(job.id, 1): start})
    assert ledger.adopt(job.id, 1, "dead", "first").owner == "first"
    assert ledger.adopt(job.id, 1, "dead", "second") is None
    assert (ledger.job(job.id).attempt, ledger.job(job.id).began) == (1, 12.5)


def test_claims_and_beats_make_the_heartbeat_grow(ledger):
    accept(ledger)
    assert ledger.leases() == {}
    claim(ledger, "me", "dask")
    ledger.send_heartbeat("me", "dask")
    lease = ledger.leases()["me"]
    assert (lease.engine, lease.number) == ("dask", 2)
    ledger.end_lease("me")
    assert ledger.leases() == {}


def test_a_lease_left_by_a_kill_goes_after_a_day_unless_its_owner_has_a_job(ledger, monkeypatch):
    accept(ledger)
    claim(ledger, "has a job")
    ledger.send_heartbeat("has none", "local")
    later = time.time() + FORGOTTEN_SECONDS + 1
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.time.time", lambda: later)
    ledger.end_lease("ends now")
    assert ledger.leases().keys() == {"has a job"}


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
    waiting.join(600)
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


# -- threads of processes ------------------------------------------------------------------------

WORK = """
import sys
import threading
from wrenchbook.service.ledger import Ledger
print("ready", flush=True)
sys.stdin.readline()
ledger = Ledger(sys.argv[1])
def commit(name):
    job = next(iter(ledger.claim_many(name, "local", 1)), None)
    if job:
        ledger.commit(job.id, job.attempt, [load * 1e-6 for load in job.wrench])
        print(f"{job.id}\\n", end="")
    return job
def work(name):
    for load in range(int(sys.argv[3])):
        ledger.accept("bar", "f", (load, 0, 0, 0, 0, 0))
        commit(name)
    while commit(name):
        pass
threads = [threading.Thread(target=work, args=(sys.argv[2] + name,)) for name in "ab"]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
ledger.close()
"""


def test_threads_of_processes_that_open_accept_and_claim_at_once_share_each_job_once(tmp_path):
    path, pipe = tmp_path / "ledger.sqlite", subprocess.PIPE
    commands = [[sys.executable, "-c", WORK, str(path), f"worker {n}", "100"] for n in range(3)]
    workers = [
        subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) for command in commands
    ]
    for worker in workers:
        assert worker.stdout.readline() == "ready\n"
    for worker in workers:
        worker.stdin.write("go\n")
        worker.stdin.flush()
    printed = [worker.communicate(timeout=600)[0] for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    claimed = sorted(int(line) for text in printed for line in text.split())
    ledger = Ledger(path)
    assert claimed == sorted(job.id for job in ledger.jobs(status="done", limit=1000))
    assert sorted(row.wrench[0] for row in stored(ledger, "bar")) == list(range(100))
    ledger.close()


# -- the watcher: commits of this and of another process, files, listeners that fail -------------


@pytest.fixture
def watcher(ledger):
    watching = Watcher(ledger)
    watching.start()
    yield watching
    watching.stop()


def test_a_commit_of_this_and_of_another_process_is_noticed_within_a_moment(
    ledger, watcher, tmp_path
):
    noticed = threading.Event()
    watcher.on_change(noticed.set)
    ledger.accept("bar", "f", WRENCH)
    assert noticed.wait(600)
    noticed.clear()
    other = Ledger(tmp_path / "ledger.sqlite")
    claim(other, "another")
    assert noticed.wait(600)
    other.close()


def test_nothing_is_noticed_without_a_commit(ledger, watcher):
    calls = []
    watcher.on_change(lambda: calls.append(1))
    ledger.jobs()
    looks = []
    watcher.on_change(lambda: None, lambda: looks.append(1))
    until(lambda: len(looks) > 5)
    assert not calls


def test_files_are_polled_seldom_while_nothing_is_committed(ledger, monkeypatch):
    """An idle process polled its files fifty times a second."""
    monkeypatch.setattr(workspace, "FOLLOWS_S", 0.0)
    monkeypatch.setattr(workspace, "IDLE_POLL_S", 3600.0)
    polls, looks = [], []
    version = ledger.version
    monkeypatch.setattr(ledger, "version", lambda: polls.append(1) or version())
    watching = Watcher(ledger)
    watching.on_change(lambda: None, lambda: looks.append(1))
    watching.start()
    until(lambda: len(polls) > 10)
    watching.stop()
    assert len(looks) <= 2  # at the subscription, and at the first poll


def test_files_are_polled_often_after_a_commit(ledger, watcher, monkeypatch):
    monkeypatch.setattr(workspace, "IDLE_POLL_S", 3600.0)
    ledger.accept("bar", "f", WRENCH)
    looks = []
    watcher.on_change(lambda: None, lambda: looks.append(1))
    until(lambda: len(looks) > 5)


def test_the_watcher_goes_on_after_a_version_that_could_not_be_read(ledger, monkeypatch):
    monkeypatch.setattr(workspace, "TROUBLE_S", 0.01)
    version, failures = ledger.version, [MemoryError()]
    noticed = threading.Event()
    watching = Watcher(ledger)
    watching.on_change(noticed.set)

    def fail_once():
        if failures:
            raise failures.pop()
        return version()

    monkeypatch.setattr(ledger, "version", fail_once)
    watching.start()
    until(lambda: not failures)
    ledger.accept("bar", "f", WRENCH)
    assert noticed.wait(60)
    watching.stop()


def test_a_file_is_watched_along_until_its_subscription_ends(watcher, tmp_path):
    file = tmp_path / "note"
    noticed = threading.Event()
    end = watcher.on_change(noticed.set, file.exists)
    file.touch()
    assert noticed.wait(600)
    end()
    noticed.clear()
    file.unlink()
    looks = []
    watcher.on_change(lambda: None, lambda: looks.append(1))
    until(lambda: len(looks) > 5)
    assert not noticed.is_set()


def test_a_listener_that_fails_is_called_again_and_keeps_no_other_from_it(
    ledger, watcher, monkeypatch
):
    monkeypatch.setattr(workspace, "TROUBLE_S", 0.05)
    calls, noticed = [], threading.Event()

    def fails():
        calls.append(1)
        if len(calls) < 3:
            raise RuntimeError("no memory")

    watcher.on_change(fails)
    watcher.on_change(noticed.set)
    ledger.accept("bar", "f", WRENCH)
    assert noticed.wait(600)
    until(lambda: len(calls) == 3)


def test_a_ledger_that_cannot_be_read_and_then_can_is_noticed(ledger, watcher, monkeypatch):
    def unreadable():
        raise LedgerUnavailableError("the disk is gone")

    noticed = threading.Event()
    watcher.on_change(noticed.set)
    with monkeypatch.context() as broken:
        broken.setattr(ledger, "version", unreadable)
        assert noticed.wait(600)
        noticed.clear()
    assert noticed.wait(600)


# -- nothing grows without bound, and nothing that is needed goes --------------------------------

NONE = Settings(keep_days=0, keep_count=0, keep_failed_days=0, keep_failed_count=0)


def end_job(ledger, number, *, good=True):
    ledger.accept("rig", "f", [float(number)] * 6)
    job = claim(ledger, "me")
    folder = ledger.path.parent / "jobs" / str(job.id) / str(job.attempt)
    folder.mkdir(parents=True)
    (folder / "result.json").write_text("{}")
    if good:
        ledger.commit(job.id, job.attempt, [number * 1e-6] * 6)
    else:
        error = {"kind": "k", "message": "m", "remedy": "r"}
        ledger.fail(job.id, job.attempt, error)
    return job.id


def test_the_audit_has_a_failed_job_with_its_kind(ledger):
    accept(ledger)
    job = claim(ledger, "me")
    ledger.fail(job.id, job.attempt, ERROR)
    (entry,) = ledger.audit(action="job.fail")
    assert (entry.object, entry.after) == (str(job.id), {"kind": "not_converged"})


def pruned(ledger, settings, *, stopping=False):
    stop = threading.Event()
    if stopping:
        stop.set()
    return prune(ledger, ledger.path.parent / "jobs", settings, stop)


def left(ledger):
    return sorted(int(path.name) for path in (ledger.path.parent / "jobs").iterdir())


def test_the_newest_folders_are_kept_and_failed_ones_longer(ledger):
    done = [end_job(ledger, n) for n in range(6)]
    failed = [end_job(ledger, 10 + n, good=False) for n in range(3)]
    assert pruned(ledger, Settings(keep_count=2, keep_failed_count=2)) == 5
    assert left(ledger) == sorted([*done[-2:], *failed[-2:]])
    assert ledger.counts() | {"done": 6, "failed": 3} == ledger.counts()


def test_folders_are_removed_by_age_and_a_clock_set_back_removes_none(ledger, monkeypatch):
    jobs = [end_job(ledger, n) for n in range(3)]
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now - 1000 * DAY)
    assert pruned(ledger, Settings()) == 0
    monkeypatch.setattr(time, "time", lambda: now + 29 * DAY)
    assert pruned(ledger, Settings()) == 0
    monkeypatch.setattr(time, "time", lambda: now + 31 * DAY)
    assert pruned(ledger, Settings()) == len(jobs)


def test_a_folder_named_by_a_number_that_no_job_can_have_does_not_stop_the_removal(ledger):
    end_job(ledger, 1)
    (ledger.path.parent / "jobs" / "99999999999999999999").mkdir()
    assert pruned(ledger, Settings(keep_count=0)) == 1


def test_what_waits_runs_or_is_unknown_is_left_alone(ledger):
    folder = ledger.path.parent / "jobs"
    reopened = end_job(ledger, 1, good=False)
    ledger.retry(reopened)
    (folder / "owners").mkdir()
    (folder / "4711" / "1").mkdir(parents=True)
    assert pruned(ledger, NONE) == 0
    assert {path.name for path in folder.iterdir()} == {str(reopened), "owners", "4711"}


def test_pruning_ends_when_it_is_told_to(ledger):
    end_job(ledger, 1)
    assert pruned(ledger, NONE, stopping=True) == 0


def test_a_long_log_is_brought_in_and_emptied(ledger):
    ledger.accept_many("rig", "f", [[float(n)] * 6 for n in range(2000)])
    assert ledger.sizes()["log"] > 0
    assert shorten_log(ledger, longest=0)
    assert ledger.sizes()["log"] == 0
    assert ledger.counts()["waiting"] == 2000


def test_a_log_that_somebody_reads_is_left_before_the_reading_ends(ledger):
    ledger.accept("rig", "f", [1.0] * 6)
    with ledger.reading() as db:
        db.execute("SELECT count(*) FROM jobs").fetchone()
        ledger.accept("rig", "f", [2.0] * 6)
        assert not shorten_log(ledger, longest=0)
    assert ledger.accept("rig", "f", [3.0] * 6)[1]


def test_acknowledged_jobs_that_a_cut_log_has_lost_are_told_and_never_renumbered(tmp_path):
    """Half of the log cut off: SQLite opens it without a word."""
    path, log = tmp_path / "l.sqlite", tmp_path / "l.sqlite-wal"
    ledger = Ledger(path)
    for number in range(20):
        ledger.accept("rig", "f", [float(number)] * 6)
    whole, content = path.read_bytes(), log.read_bytes()
    ledger.close()
    path.write_bytes(whole)
    log.write_bytes(content[: len(content) // 2])
    again = Ledger(path)
    kept = again.counts()["waiting"]
    assert 0 < kept < 20
    (said,) = again.losses()
    assert f"jobs {kept + 1} to 20 were acknowledged" in said
    assert again.accept("rig", "f", [99.0] * 6)[0].id == 21
    again.close()
    with closing(Ledger(path)) as third:
        assert len(third.losses()) == 1  # told until somebody settles it, and once


def test_a_note_that_is_damaged_missing_or_unwritable_is_no_loss(ledger):
    ledger.accept("rig", "f", [1.0] * 6)
    ledger.close()
    note = ledger.path.with_name(f"{ledger.path.name}-acknowledged")
    for content in (b"", b"99 99\n12345678", b"\xff" * 40):
        note.write_bytes(content)
        with closing(Ledger(ledger.path)) as again:
            assert again.losses() == []
    note.unlink()
    note.mkdir()
    with closing(Ledger(ledger.path)) as again:
        assert again.accept("rig", "f", [2.0] * 6)[1]


def test_a_note_is_read_again_after_a_commit_over_a_longer_damaged_one(ledger):
    ledger.accept("rig", "f", [1.0] * 6)
    ledger.close()
    note = ledger.path.with_name(f"{ledger.path.name}-acknowledged")
    note.write_bytes(note.read_bytes()[:1] + b"garbage" * 4)
    with closing(Ledger(ledger.path)) as again:
        again.accept("rig", "f", [2.0] * 6)
    assert Acknowledged(ledger.path).read() == Numbers(jobs=2, rows=0)


@pytest.mark.parametrize(
    "damage", [b"\xff\n", b'{"seen": 1e300, "jobs": [1, 2], "rows": [1, 0]}\n']
)
def test_a_damaged_line_of_the_losses_hides_no_other_loss(ledger, damage):
    losses = ledger.path.with_name(f"{ledger.path.name}-lost")
    losses.write_bytes(damage + b'{"seen": 0, "jobs": [3, 4], "rows": [1, 0]}\n')
    (sentence,) = ledger.losses()
    assert sentence.startswith("jobs 3 to 4 were acknowledged")
